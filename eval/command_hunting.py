"""`railenv hunting`: amplitude against speed of the nonlinear vehicle, and its critical speeds."""

import argparse
from typing import Any

import numpy as np

from eval.arguments import parse_number, parse_output, parse_whole, print_json, progress_bar
from eval.bifurcation_plot import plot_bifurcation
from eval.chart_plot import check_drawing
from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.simulation.bifurcation import BifurcationDiagram, SpeedRamp, bifurcation_diagram
from railenv.simulation.full_hunting import FullHunting
from railenv.simulation.full_stepping import DERAILMENT_SHIFT
from railenv.simulation.linear_speed import LinearCriticalSpeed, linear_critical_speed
from railenv.simulation.settling import Settling
from railenv.units import FloatArray, from_kmh
from railenv.vehicle.nonlinear import ContactSettings, FullVehicle, full50

_MOST_SPEEDS = 200
_SCAN_STEP = 10.0  # [km/h]
_WIDTH = 0.5  # [km/h] to which the nonlinear critical speed is bracketed
_SMALL = 0.2  # small disturbance over the bound for rest

# Blocks hold two periods of the slowest hunting, some 0.5 Hz, and 25 samples of one of 20 Hz, so
# that peaks are met within 1 %. After a minute of waiting motion counts as not settled.
_BLOCK, _SAMPLES, _DRIFT, _MOST_BLOCKS = 4.0, 2000, 3e-3, 15


def command_hunting(options: argparse.Namespace) -> None:
    """Run both ramps, print what was seen and draw it."""
    speeds_kmh = _speeds(options)
    plot = parse_output(options.plot, (".png", ".svg", ".pdf"))
    if plot is not None:
        check_drawing()
    rest = 1e-3 * _positive("rest_mm", options.rest_mm)
    start = 1e-3 * _positive("start_mm", options.start_mm)
    if start > DERAILMENT_SHIFT:
        raise ArgumentError(
            f"start_mm = {1e3 * start:g} is off the rails; give {1e3 * DERAILMENT_SHIFT:g} or less"
        )
    if rest >= start:
        raise ArgumentError(
            f"rest_mm = {1e3 * rest:g} must be below start_mm = {1e3 * start:g}; what begins "
            "as rest cannot hunt"
        )
    threads = parse_whole("threads", options.threads)
    vehicle = _vehicle(options)
    system = FullHunting(vehicle, threads=threads)
    unstable, linear = _linear(system, speeds_kmh)
    settling = Settling(
        rest=rest, block=_BLOCK, samples=_SAMPLES, drift=_DRIFT, most_blocks=_MOST_BLOCKS
    )
    with progress_bar(options, None, "block") as bar:
        diagram = bifurcation_diagram(
            _Counted(system, bar),
            speeds_kmh / 3.6,
            system.aside(_SMALL * rest),
            system.aside(start),
            settling,
            linear=linear,
            tolerance=_WIDTH / 3.6,
        )
    if plot is not None:
        plot_bifurcation(
            diagram, plot, title=_title(options), kmh=True,
            output="leading wheelset's lateral amplitude",
        )  # fmt: skip
    if options.json:
        print_json(_record(options, diagram, unstable))
        return
    _print(options, diagram, unstable)
    if plot is not None:
        print(f"  written: {plot}")


class _Counted:
    """A hunting system that moves a progress bar on."""

    def __init__(self, system: FullHunting, bar: Any) -> None:
        self._system, self._bar = system, bar

    @property
    def state_size(self) -> int:
        return self._system.state_size

    def advance(
        self, states: FloatArray, speeds: FloatArray, durations: FloatArray, samples: int
    ) -> tuple[FloatArray, FloatArray]:
        moved = self._system.advance(states, speeds, durations, samples)
        self._bar.set_postfix_str(f"{3.6 * float(speeds[0]):.0f} km/h", refresh=False)
        self._bar.update(1)
        return moved


def _positive(name: str, text: str) -> float:
    return check_positive(name, parse_number(name, text))


def _speeds(options: argparse.Namespace) -> FloatArray:
    """Return the ramps' speeds [km/h]; the last one is the highest asked for."""
    low, high, step = (
        _positive(name, getattr(options, name)) for name in ("from_kmh", "to_kmh", "step_kmh")
    )
    count = (high - low) / step
    if not 1.0 <= count <= _MOST_SPEEDS:
        raise ArgumentError(
            f"from_kmh = {low:g}, to_kmh = {high:g} and step_kmh = {step:g} make {count:.3g} "
            f"steps; give 1 to {_MOST_SPEEDS}"
        )
    speeds = low + step * np.arange(int(count + 1e-9) + 1, dtype=np.float64)
    return speeds if speeds[-1] > high - 1e-6 * step else np.append(speeds, [high])


def _vehicle(options: argparse.Namespace) -> FullVehicle:
    contact = ContactSettings(
        wheel=options.wheel,
        rail=options.rail,
        friction=check_not_negative("friction", parse_number("friction", options.friction)),
        law=options.creep_law,
    )
    return full50(options.vehicle, options.layout, float(options.from_kmh), contact)


def _linear(system: FullHunting, speeds_kmh: FloatArray) -> tuple[bool, LinearCriticalSpeed | None]:
    """Return whether the straight run is unstable at the lowest speed, else where it becomes so."""
    low, high = from_kmh(float(speeds_kmh[0])), from_kmh(float(speeds_kmh[-1]))
    if float(np.linalg.eigvals(system.linearisation(low)).real.max()) >= 0.0:
        return True, None
    count = max(1, round(float(speeds_kmh[-1] - speeds_kmh[0]) / _SCAN_STEP))
    return False, linear_critical_speed(system.linearisation, low, high, count)


def _title(options: argparse.Namespace) -> str:
    return (
        f"50-coordinate vehicle {options.vehicle}, layout {options.layout}: {options.wheel} on "
        f"{options.rail}, friction {options.friction}, creep by {options.creep_law}"
    )


def _record(
    options: argparse.Namespace, diagram: BifurcationDiagram, unstable: bool
) -> dict[str, Any]:
    """Return the result in plain values; null where there is none."""
    linear = diagram.linear
    # Hunting down to the lowest speed asked for ends below it, nobody knows where.
    found = bool(np.isfinite(diagram.hunting_speed)) and diagram.rest_speed > 0.0
    return {
        "wheel": options.wheel,
        "rail": options.rail,
        "layout": options.layout,
        "vehicle": options.vehicle,
        "friction": float(options.friction),
        "creep_law": options.creep_law,
        "unstable_at_lowest_speed": unstable,
        "linear_critical_speed_kmh": None if linear is None else 3.6 * linear.speed,
        "linear_frequency_hz": None if linear is None else linear.frequency,
        "nonlinear_critical_speed_kmh": 3.6 * diagram.hunting_speed if found else None,
        "rest_speed_kmh": 3.6 * diagram.rest_speed,
        "hunting_amplitude_m": diagram.hunting_amplitude if found else None,
        "hysteresis_kmh": [3.6 * speed for speed in diagram.hysteresis],
        "kind": diagram.kind.value,
        "reason": diagram.reason,
        "up": _ramp(diagram.up),
        "down": _ramp(diagram.down),
    }


def _ramp(ramp: SpeedRamp) -> dict[str, Any]:
    return {
        "speed_kmh": (3.6 * ramp.speeds).tolist(),
        "amplitude_m": [a if np.isfinite(a) else None for a in ramp.amplitudes.tolist()],
        "frequency_hz": ramp.frequencies.tolist(),
        "settled": ramp.settled.tolist(),
        "hunting": ramp.hunting.tolist(),
    }


def _print(options: argparse.Namespace, diagram: BifurcationDiagram, unstable: bool) -> None:
    print(_title(options))
    print("  leading wheelset, amplitude [mm] and frequency [Hz]; * not settled")
    print(f"  {'km/h':>6}{'up from rest':>22}{'down from hunting':>22}")
    up, down = diagram.up, diagram.down
    last = len(up.speeds) - 1
    for k, speed in enumerate(up.speeds):
        cells = _cell(up, k) + _cell(down, last - k)
        print(f"  {3.6 * speed:>6.0f}{cells}")
    linear = diagram.linear
    if linear is not None:
        print(f"  linear critical speed     {_kmh(linear.speed)}, {linear.frequency:.2f} Hz")
    elif unstable:
        print("  linear critical speed     below the lowest speed")
    else:
        print("  linear critical speed     none up to the highest speed")
    print(f"  nonlinear critical speed  {_nonlinear(diagram)}")
    print(f"  {diagram.kind.value}: {diagram.reason}")


def _nonlinear(diagram: BifurcationDiagram) -> str:
    if not np.isfinite(diagram.hunting_speed):
        return "none: no hunting at the highest speed"
    if not np.isfinite(diagram.hunting_amplitude):
        return "unknown: the motion left all bounds (derailment) on the way down"
    if diagram.rest_speed == 0.0:
        return f"below the lowest speed, {_kmh(diagram.hunting_speed)}"
    amplitude = f"amplitude {1e3 * diagram.hunting_amplitude:.2f} mm"
    return f"{_kmh(diagram.hunting_speed)} ({amplitude}; at rest at {_kmh(diagram.rest_speed)})"


def _kmh(speed: float) -> str:
    return f"{3.6 * speed:.1f} km/h"


def _cell(ramp: SpeedRamp, k: int) -> str:
    amplitude = float(ramp.amplitudes[k])
    if not np.isfinite(amplitude):
        return f"{'left all bounds':>22}"
    if not ramp.hunting[k]:
        return f"{'rest':>22}" if ramp.settled[k] else f"{'rest*':>22}"
    mark = "" if ramp.settled[k] else "*"
    return f"{f'{1e3 * amplitude:.2f}{mark}':>13}{ramp.frequencies[k]:>9.2f}"
