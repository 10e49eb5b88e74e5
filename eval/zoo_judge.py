"""What oracle and covariance say of a law of the zoo at one delay: damping, window, distance."""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from baselines import LinearDynamic, LinearFeedback
from baselines.controller import Controller
from baselines.design.cost import loop_cost
from baselines.design.model import design_model
from baselines.design.optimum import perfect_knowledge
from baselines.design.yardstick import optimum_at_force
from railenv.errors import RailenvError
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.stability import SampledLoop, critical_delays, sampled_windows
from railenv.stability.lifted_roots import lifted_roots, unstable_at
from railenv.vehicle import LateralVehicle, lateral17

HIGHEST_HZ = 5.0
"""Modes up to here count for the damping margin: carbody and bogies; beyond come a law's own."""

LONGEST_WINDOW = 0.6
"""No end of a stable window is looked for beyond [s]."""

_FIRST_STEP = 2.5e-3
_LONGEST_STEP = 1e-2
_FINEST = 1e-3
_ALL_ROOTS = 10_000


def first_critical_delay(law: Controller, vehicle: LateralVehicle) -> dict[str, Any]:
    """Return the critical delay of a linear law; nothing for any other.

    Proved for a continuous law; for a sampled one the first loss of stability that was found.
    """
    if isinstance(law, LinearDynamic) and law.sampled:
        loop = law.to_sampled_loop(vehicle, DEFAULT_CONTROL_PERIOD)
        found = sampled_windows(loop, LONGEST_WINDOW).critical_delay
        return {"critical_delay_s": found, "critical_delay_proved": False}
    convert: Callable[..., Any] | None = getattr(law, "to_delay_system", None)
    if convert is None:
        return {}
    found = critical_delays(convert(vehicle), 2.0)
    return {
        "critical_delay_s": 0.0 if found.unstable_without_delay else found.critical_delay,
        "critical_delay_proved": found.proved,
    }


def judged(
    law: Controller, vehicle: LateralVehicle, delay: float, *, window: bool
) -> dict[str, Any]:
    """Return what the oracle says of a linear law at one delay; nothing of any other.

    Args:
        law: The law.
        vehicle: The vehicle.
        delay: Between measurement and force [s].
        window: Whether the stable window around the delay is looked for, if there is one.
    """
    if not isinstance(law, LinearFeedback | LinearDynamic):
        return {}
    loop = law.to_sampled_loop(vehicle, DEFAULT_CONTROL_PERIOD)
    unstable = unstable_at(loop, delay)
    roots = [mode.root for mode in lifted_roots(loop, delay, _ALL_ROOTS)]
    damping = [
        -root.real / abs(root)
        for root in roots
        if root.imag > 0.0 and abs(root) < 2.0 * np.pi * HIGHEST_HZ
    ]
    answer: dict[str, Any] = {
        "unstable_roots": unstable,
        "damping": min(damping, default=None),
        "growth": max(root.real for root in roots),
    }
    if window and unstable == 0:
        answer["window_s"] = window_around(loop, delay)
    return answer


def window_around(loop: SampledLoop, delay: float) -> tuple[float, float]:
    """Return the ends of the stable window that holds a delay, to a millisecond [s].

    Steps away from the delay double, up to 10 ms, until the loop is unstable; a gap between two
    steps would be missed.
    """

    def end(sign: float, last: float) -> float:
        stable, step = delay, _FIRST_STEP
        while True:
            place = delay + sign * step
            if (place - last) * sign >= 0.0:
                place = last
            if unstable_at(loop, place) > 0:
                break
            if place == last:
                return last
            stable, step = place, step + min(step, _LONGEST_STEP)
        outside = place
        while abs(outside - stable) > _FINEST:
            middle = (outside + stable) / 2.0
            if unstable_at(loop, middle) > 0:
                outside = middle
            else:
                stable = middle
        return stable

    return end(-1.0, 0.0), end(1.0, LONGEST_WINDOW)


def distances(
    law: Controller, vehicle: LateralVehicle, delay: float, noise: float, cell: dict[str, Any]
) -> dict[str, Any]:
    """Set the weighted acceleration beside that of the optimum with the same force.

    `apart`: every wheelset on its own track, optimum without preview. `in_a_row`: one track for
    all, optimum with preview. By covariance for linear laws, from the run for others.
    """
    answer: dict[str, Any] = {}
    for key, preview in (("apart", False), ("in_a_row", True)):
        model = design_model(vehicle, delay, preview=preview)
        if isinstance(law, LinearFeedback | LinearDynamic):
            try:
                cost = loop_cost(model, law, noise)
            except RailenvError:
                continue
            own, force = cost.weighted_acceleration, cost.force_rms
        elif preview and not cell["diverged"]:
            own, force = cell["weighted"], cell["force_rms"]
        else:
            continue
        answer |= distance(key, own, force, vehicle, delay, preview=preview)
    return answer


def distance(
    key: str, own: float, force: float, vehicle: LateralVehicle, delay: float, *, preview: bool
) -> dict[str, Any]:
    """Return a weighted acceleration over the optimum's at the same force, and the optimum's."""
    if not np.isfinite(force) or force <= 0.0:
        return {}
    model = design_model(vehicle, delay, preview=preview)
    best = optimum_at_force(model, perfect_knowledge(model), force)
    if best is None:
        return {}
    return {
        f"{key}_weighted": own,
        f"{key}_force": force,
        f"{key}_optimum": best.weighted_acceleration,
        f"{key}_distance": own / best.weighted_acceleration,
    }


def yardstick(
    layout: str, speed_kmh: float, delays: Sequence[float], forces: Sequence[float], preview: bool
) -> list[list[float | None]]:
    """Return the least weighted acceleration for each force (rows) and delay (columns) [m/s^2]."""
    vehicle = lateral17("paper_fit", layout, speed_kmh)
    models = [design_model(vehicle, delay, preview=preview) for delay in delays]
    rows: list[list[float | None]] = []
    for force in forces:
        found = [optimum_at_force(model, perfect_knowledge(model), force) for model in models]
        rows.append([None if best is None else best.weighted_acceleration for best in found])
    return rows
