"""`railenv simulate --video`: a run as a film, drawn while it runs.

Frames follow real time: at 25 frames per second a control period of 10 ms is shown every fourth
time. The encoder (`imageio-ffmpeg`, brought by `pip install "railenv[render]"`) writes beside the
film's own name, which it takes only when the film is whole.

Commands are drawn as forces. Those to semi-active dampers are coefficients: in their place stands
the force that each would give at the stroke rate of the instant shown.
"""

import importlib
import shutil
import tempfile
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy.signal import sosfilt

from eval.rollout import ControlledBatch, Stepping
from eval.simulations import SemiActiveRuns, Vehicle, lateral_twin
from railenv.errors import ArgumentError, OutputError
from railenv.files import replacing
from railenv.metrics.ride_filter import ride_filter, ride_index_from_mean_square
from railenv.rendering import View, draw_frame
from railenv.track import Track
from railenv.units import FloatArray
from railenv.vehicle import state_space
from railenv.vehicle.coordinates import actuator_positions

FRAMES_PER_SECOND = 25
SIZE = (640, 480)

_SHOWN_SECONDS = 5.0
"""Length of the strip charts [s]."""

_AROUND = np.linspace(-25.0, 25.0, 201)
"""Where the track is shown, from the carbody's centre [m]."""


class Film:
    """Collects what a picture shows of a run, and draws it.

    Args:
        vehicle: The vehicle, with actuators.
        track: The track it runs on, from distance 0.
        delays: Delay of every channel, shape (channels,) [s].
        stepping: Steps, and the force limit.
        write: Takes a frame, shape (height, width, 3).
    """

    def __init__(
        self,
        vehicle: Vehicle,
        track: Track,
        delays: FloatArray,
        stepping: Stepping,
        write: Any,
    ) -> None:
        if vehicle.num_actuators == 0:
            raise ArgumentError("video shows forces on their way; take layout 2 or 4")
        self._vehicle, self._track, self._delays = vehicle, track, delays
        self._control_period, self._time_step = stepping.control_period, stepping.time_step
        self._force_limit, self._write = stepping.actuator.force_limit, write
        # The axis of the pipe: the longest delay and some room, in whole tens of milliseconds.
        self._max_delay = max(0.1, 0.01 * float(np.ceil(125.0 * delays.max())))
        periods = int(self._max_delay / self._control_period) + 1
        self._sent = np.zeros((periods, vehicle.num_actuators))
        self._past = np.zeros((round(_SHOWN_SECONDS / self._time_step), 2))
        self._sections = ride_filter(1.0 / self._time_step)
        self._memory = np.zeros((len(self._sections), 2, 2))
        self._energy = np.zeros(2)
        self._periods, self._frames = 0, 0

    def watch(self, batch: ControlledBatch, outputs: FloatArray) -> None:
        """Note one control period of lane 0 and draw it if a frame is due.

        Args:
            batch: The running batch, after the period.
            outputs: What was recorded in it, floor accelerations first, (lanes, steps, outputs).
        """
        floor = np.nan_to_num(outputs[0, :, :2])
        self._past = np.concatenate([self._past, floor])[len(floor) :]
        self._sent = np.concatenate([batch.commands[:1], self._sent[:-1]])
        filtered, self._memory = sosfilt(self._sections, floor.T, axis=-1, zi=self._memory)
        self._energy += np.square(filtered).sum(axis=1)
        self._newest = np.nan_to_num(outputs[0, -1])
        self._periods += 1
        time = self._periods * self._control_period
        # Half a microsecond forgives the rounding of the product.
        if time + 5e-7 < self._frames / FRAMES_PER_SECOND:
            return
        self._frames += 1
        self._write(draw_frame(self._view(batch, time), SIZE))

    def _view(self, batch: ControlledBatch, time: float) -> View:
        vehicle = self._vehicle
        centre = vehicle.speed * time - 0.5 * float(vehicle.wheelset_setback[-1])
        places = np.clip(centre + _AROUND, None, self._track.length)
        names = list(batch.record)
        forces = np.array([name.startswith("actuator_force") for name in names])
        samples = len(self._past)
        return View(
            time=time,
            speed=vehicle.speed,
            layout=vehicle.layout,
            coordinates=np.nan_to_num(batch.simulation.lateral[0]),
            force=self._newest[forces],
            command=self._forces(batch, batch.commands[:1])[0],
            force_limit=self._force_limit,
            delay=self._delays.copy(),
            max_delay=self._max_delay,
            pipe_age=self._control_period * np.arange(1.0, len(self._sent) + 1.0),
            pipe_command=self._forces(batch, self._sent),
            track_distance=_AROUND.copy(),
            track_alignment=self._track.sample("alignment", places),
            track_cross_level=self._track.sample("cross_level", places),
            history_time=self._time_step * np.arange(1.0 - samples, 1.0),
            history_acceleration=self._past.copy(),
            ride_index=np.asarray(
                ride_index_from_mean_square(self._energy * self._time_step / time)
            ),
            reward=None,
            ended_by="",
            parameters=lateral_twin(vehicle).parameters,
        )

    def _forces(self, batch: ControlledBatch, commands: FloatArray) -> FloatArray:
        """Return commands as forces, a new array, (rows, channels) [N]; see above of dampers."""
        simulation = batch.simulation
        if not isinstance(simulation, SemiActiveRuns):
            return commands.copy()
        names = tuple(
            f"suspension_stroke_rate_{k}" for k in actuator_positions(self._vehicle.layout)
        )
        rows, _ = state_space(simulation.vehicle).output_rows(names)
        force = -simulation.damper.limited(commands) * (rows @ simulation.state[0])
        limit = self._force_limit
        return force if limit is None else np.clip(force, -limit, limit)


@contextmanager
def film_file(path: Path) -> Generator[Any, None, None]:
    """Open a film for writing.

    Args:
        path: The `.mp4` file.

    Yields:
        A function that takes a frame, shape (480, 640, 3), uint8.

    Raises:
        ArgumentError: The encoder is not installed.
        OutputError: The film cannot be written; what stood there before is untouched.
    """
    try:
        encoder = importlib.import_module("imageio_ffmpeg")
    except ImportError:
        raise ArgumentError(
            'video needs the drawing and film packages; pip install "railenv[render]"'
        ) from None
    with tempfile.TemporaryDirectory(prefix="railenv-") as folder:
        unfinished = Path(folder) / "film.mp4"
        writer = encoder.write_frames(
            str(unfinished), SIZE, fps=FRAMES_PER_SECOND, macro_block_size=16, quality=7
        )
        writer.send(None)
        try:
            yield lambda frame: writer.send(np.ascontiguousarray(frame))  # pyright: ignore
        finally:
            writer.close()
        if not unfinished.is_file():
            raise OutputError(f"cannot write {path}: the encoder made no film")
        with unfinished.open("rb") as source, replacing(path) as stream:
            shutil.copyfileobj(source, stream)
