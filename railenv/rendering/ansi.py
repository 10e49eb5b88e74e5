"""The running vehicle as a panel of plain ASCII text, for terminals and logs."""

import math

import numpy as np

from railenv.rendering.charts import FLOOR_NAMES, INDEX_LIMIT
from railenv.rendering.pipe import axis_length
from railenv.rendering.scales import fraction_of, plain, round_limit, signed
from railenv.rendering.scene import ENDING_WORDS, delay_words, full_scale_force
from railenv.rendering.view import View
from railenv.vehicle.coordinates import BOGIES, bogie_sign

_HALF_RULER = 20  # characters on either side of a ruler's middle
_PIPE = 40  # characters of the pipe
_SWAY_LIMIT = 0.01
"""Smallest limit of the rulers of displacement [m]."""
_INDEX = 20  # characters of the ride index's bar
_SMALL, _LARGE = 0.05, 0.5
"""Shares of the full scale from which a command is written as small and as large."""


def draw_text(view: View) -> str:
    """Return the view as text: rulers of sway, forces, the delay pipe, accelerations, ride index.

    Args:
        view: What is shown.

    Returns:
        At most 30 lines of at most 100 ASCII characters, without a line feed at the end.
    """
    lines = [_heading(view), *_motions(view), "", *_pipe(view), "", *_floors(view)]
    return "\n".join(line.rstrip() for line in lines)


def _heading(view: View) -> str:
    reward = "" if view.reward is None else f"reward {signed(view.reward)} | "
    state = f"{ENDING_WORDS[view.ended_by]}: episode over" if view.ended_by else "running"
    return (
        f"t {view.time:.2f} s | {plain(3.6 * view.speed, 0)} km/h | "
        f"delay {delay_words(view)} | {reward}{state}"
    )


def _motions(view: View) -> list[str]:
    reach = view.parameters.half_bogie_spacing
    motions: list[tuple[str, float]] = []
    for number, end in zip(BOGIES, FLOOR_NAMES, strict=True):
        motions.append((f"carbody {end}", view.lateral("carbody", bogie_sign(number) * reach)))
        motions.append((f"bogie {end}", view.coordinate(f"bogie{number}_lateral")))
    limit = round_limit(max(abs(value) for _, value in motions), _SWAY_LIMIT)
    lines = [f"lateral [mm], ruler +-{plain(1000.0 * limit, 0)} mm, right is right"]
    for name, value in motions:
        lines.append(f"  {name:<14} {_ruler(value, limit)} {signed(1000.0 * value):>9}")
    roll, yaw = (1000.0 * view.coordinate(f"carbody_{m}") for m in ("roll", "yaw"))
    lines.append(f"  carbody roll {signed(roll)} mrad, yaw {signed(yaw)} mrad")
    return lines


def _ruler(value: float, limit: float) -> str:
    marks = ["-"] * (2 * _HALF_RULER + 1)
    marks[_HALF_RULER] = "|"
    marks[_HALF_RULER + round(_HALF_RULER * fraction_of(value, limit))] = "O"
    return "[" + "".join(marks) + "]"


def _pipe(view: View) -> list[str]:
    longest, full = axis_length(view), full_scale_force(view)
    lines = [
        f"commands on their way, age 0 to {1000.0 * longest:g} ms, now and acting [kN]",
        f"  r, R right, l, L left (capital from {plain(_LARGE * full / 1000.0)} kN), ! acts",
    ]
    for channel, place in enumerate(view.places):
        cells = [_cell(view, channel, longest * n / _PIPE, full) for n in range(_PIPE + 1)]
        cells[round(_PIPE * min(float(view.delay[channel]) / longest, 1.0))] = "!"
        command, force = (float(a[channel]) / 1000.0 for a in (view.command, view.force))
        lines.append(
            f"  actuator {place}     [{''.join(cells)}] {signed(command):>9} {signed(force):>9}"
        )
    return lines


def _cell(view: View, channel: int, age: float, full: float) -> str:
    """Return the letter of the command that was held at an age; a blank where none is known."""
    # A command is held from its own age to that of the next newer one; the margin is rounding.
    held = int(np.searchsorted(view.pipe_age, age * (1.0 - 1e-9)))
    if held == len(view.pipe_age):
        return " "
    share = float(view.pipe_command[held, channel]) / full
    if abs(share) < _SMALL:
        return "."
    letter = "r" if share > 0.0 else "l"
    return letter.upper() if abs(share) >= _LARGE else letter


def _floors(view: View) -> list[str]:
    lines: list[str] = []
    for floor, name in enumerate(FLOOR_NAMES):
        past = view.history_acceleration[:, floor]
        present, largest = float(past[-1]), float(abs(past).max())
        value = float(view.ride_index[floor])
        known = not math.isnan(value)
        filled = round(_INDEX * fraction_of(value, INDEX_LIMIT)) if known else 0
        bar = "#" * filled + "." * (_INDEX - filled)
        index = plain(value) if known else "--"
        lines.append(
            f"floor {name:<6} {signed(present):>9} m/s^2, largest {plain(largest):>8} m/s^2, "
            f"ride index [{bar}] {index}"
        )
    return lines
