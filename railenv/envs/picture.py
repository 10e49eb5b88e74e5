"""What a renderer is shown of the lanes: kept only where a render mode was chosen."""

from typing import Any

import numpy as np

from railenv.envs.episode_lanes import BoolArray, EpisodeLanes, IntArray
from railenv.errors import unknown_name
from railenv.rendering import View, Window, draw_frame, draw_text
from railenv.units import FloatArray

RENDER_MODES = ("human", "rgb_array", "ansi")

SHOWN_SECONDS = 4.0
"""Length of the strip charts [s]."""

_AHEAD = np.linspace(-25.0, 25.0, 201)
"""Where the track is shown, from the carbody's centre [m]."""


def check_render_mode(mode: str | None) -> str | None:
    """Return a render mode.

    Raises:
        ArgumentError: It does not exist.
    """
    if mode is not None and mode not in RENDER_MODES:
        raise unknown_name("render_mode", str(mode), RENDER_MODES)
    return mode


class Pictures:
    """Past accelerations and commands of every lane, and the pictures made of them.

    Args:
        lanes: The lanes.
    """

    def __init__(self, lanes: EpisodeLanes) -> None:
        self._lanes = lanes
        s, n = lanes.settings, lanes.num_lanes
        self._past: FloatArray = np.zeros((n, round(SHOWN_SECONDS / s.record_period()), 2))
        periods = int(s.max_delay / s.control_period) + 1
        self._sent: FloatArray = np.zeros((n, periods, lanes.here.true_delay.shape[1]))
        self._reward: FloatArray = np.zeros(n)
        self._windows: dict[int, Window] = {}

    def begin(self, lanes: IntArray) -> None:
        """Forget the past of some lanes."""
        self._past[lanes] = 0.0
        self._sent[lanes] = 0.0
        self._reward[lanes] = 0.0

    def note(self, active: BoolArray, reward: FloatArray) -> None:
        """Note the last period of the lanes that took part in it."""
        recorded, commands = self._lanes.last_period()
        new = np.nan_to_num(recorded[active, :, :2][:, -self._past.shape[1] :])
        kept = self._past[active, new.shape[1] :]
        self._past[active] = np.concatenate([kept, new], axis=1)
        sent = np.concatenate([commands[active, None], self._sent[active, :-1]], axis=1)
        self._sent[active] = sent
        self._reward[active] = reward[active]

    def view(self, lane: int) -> View:
        """Return what there is to see of one lane."""
        lanes, s = self._lanes, self._lanes.settings
        info = {name: values[lane] for name, values in lanes.info().items()}
        alignment, cross_level = lanes.track_around(lane, _AHEAD)
        samples, periods = self._past.shape[1], self._sent.shape[1]
        ages = s.control_period * np.arange(1.0, periods + 1.0, dtype=np.float64)
        past = s.record_period() * np.arange(1.0 - samples, 1.0, dtype=np.float64)
        return View(
            time=float(info["time"]),
            speed=float(info["speed"]),
            layout=str(lanes.episodes.vehicles[0].layout),
            **lanes.pictured(lane),
            force=info["force"],
            command=info["command"],
            force_limit=s.force_limit,
            delay=lanes.episodes.delay[lane].copy(),
            max_delay=s.max_delay,
            pipe_age=ages,
            pipe_command=self._sent[lane].copy(),
            track_distance=_AHEAD.copy(),
            track_alignment=alignment,
            track_cross_level=cross_level,
            history_time=past,
            history_acceleration=self._past[lane].copy(),
            ride_index=info["ride_index"],
            reward=float(self._reward[lane]),
            ended_by=str(info["ended_by"]),
            parameters=lanes.episodes.vehicles[int(info["vehicle"])].parameters,
        )

    def render(self, mode: str) -> tuple[Any, ...] | None:
        """Return one picture per lane; None after showing them in windows."""
        views = [self.view(lane) for lane in range(self._lanes.num_lanes)]
        if mode == "ansi":
            return tuple(draw_text(view) for view in views)
        frames = tuple(draw_frame(view) for view in views)
        if mode == "rgb_array":
            return frames
        for lane, frame in enumerate(frames):
            if lane not in self._windows:
                fps = round(1.0 / self._lanes.settings.control_period)
                self._windows[lane] = Window(fps=fps)
            self._windows[lane].show(frame)
        return None

    def close(self) -> None:
        """Close the windows."""
        for window in self._windows.values():
            window.close()
        self._windows.clear()
