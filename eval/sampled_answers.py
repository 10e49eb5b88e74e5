"""The oracle's answers about laws that exist from sample to sample only, in plain values.

A delay-aware law is often unstable without delay and stable around the one that it was designed
for; the answer is its stable windows, not one critical delay.
"""

import inspect
from collections.abc import Callable
from itertools import pairwise
from math import isfinite
from typing import Any

from baselines.controller import users_own_code
from eval.stability_answers import shown_name
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError, ControllerError, RailenvError
from railenv.stability import SampledLoop, certify, sampled_windows
from railenv.stability.sampled_windows import RESOLUTION
from railenv.units import Second
from railenv.vehicle import LateralVehicle

LONGEST_SCAN: Second = 0.6
"""Longest delay searched unless another is asked for: the work grows with its fourth power."""

NOTE = "a sampled law has no continuous critical delay"

_DIRECTIONS = {1: "unstable", -1: "stable"}


def sampled_loop(
    controller: object,
    vehicle: LateralVehicle,
    period: float,
    actuator: ActuatorSpec | None = None,
) -> SampledLoop:
    """Return the loop of a controller that has a `to_sampled_loop`, actuator included.

    Args:
        controller: The controller.
        vehicle: The vehicle.
        period: Control period [s].
        actuator: Its lag becomes part of the plant.

    Raises:
        ArgumentError: The controller has no `to_sampled_loop`, is stepped with another period, or
            knows no actuator and there is a lag.
        ControllerError: The controller's own code failed, or returned something else.
    """
    convert: Callable[..., Any] | None = getattr(controller, "to_sampled_loop", None)
    if convert is None:
        raise ArgumentError(
            f"controller {type(controller).__name__} has no to_sampled_loop, and "
            "the oracle cannot judge it; ask critical-delay with --method simulation"
        )
    spec = ActuatorSpec() if actuator is None else actuator
    given: tuple[Any, ...] = (vehicle, period, spec)
    try:
        inspect.signature(convert).bind(*given)
    except (TypeError, ValueError):
        # A controller of the user's own that knows no actuators.
        if spec.lag > 0.0:
            raise ArgumentError(
                f"actuator_lag = {spec.lag:g} s is not known to the controller's "
                "to_sampled_loop; give it a third argument, actuator, or drop --actuator-lag"
            ) from None
        given = (vehicle, period)
    try:
        with users_own_code("the controller's to_sampled_loop"):
            loop = convert(*given)
    except ControllerError as error:
        # What the library itself refuses (another period, another layout) is said in its own words.
        if isinstance(error.__cause__, RailenvError):
            raise error.__cause__ from None
        raise
    if not isinstance(loop, SampledLoop):
        raise ControllerError(
            f"the controller's to_sampled_loop returned {type(loop).__name__}; "
            "it must return a SampledLoop"
        )
    return loop


def design_delays(controller: object, longest: float) -> tuple[float, ...]:
    """Return the delay a law says it is designed for, its attribute `delay`, if that is searched.

    Args:
        controller: The controller.
        longest: Longest delay searched [s].
    """
    delay = getattr(controller, "delay", None)
    if not isinstance(delay, int | float) or not isfinite(delay) or not 0.0 <= delay <= longest:
        return ()
    return (float(delay),)


def windows_answer(
    loop: SampledLoop,
    vehicle: LateralVehicle | None,
    max_delay: float = LONGEST_SCAN,
    also: tuple[float, ...] = (),
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Answer the question for the critical delay of a sampled loop with its stable windows.

    Args:
        loop: The loop.
        vehicle: Names the modes; None for a loop that is no vehicle's.
        max_delay: Longest delay searched [s].
        also: Delays to look at beside the evenly spread ones [s].
        progress: Called with each delay looked at [s].

    Returns:
        Plain values under the keys of the command line's JSON. `critical_delay_sampled_s` is the
        first loss of stability from no delay on: zero for a loop that is unstable without delay.
    """
    found = sampled_windows(loop, max_delay, also=also, progress=progress)
    first = found.first
    return {
        "critical_delay_s": None,
        "critical_delay_sampled_s": found.critical_delay,
        "control_period_s": loop.period,
        "frequency_hz": None if first is None else first.frequency_hz,
        "mode": None if first is None else shown_name(vehicle, first.mode),
        "crossings": [
            {
                "delay_s": c.delay,
                "frequency_hz": c.frequency_hz,
                "direction": _DIRECTIONS[c.direction],
                "mode": shown_name(vehicle, c.mode),
                "unstable_roots_after": c.unstable_after,
                "jump": c.jump,
            }
            for c in found.crossings
        ],
        "stable_windows_s": [list(window) for window in found.stable_windows],
        "unstable_roots_without_delay": found.unstable_without_delay,
        "max_delay_s": found.max_delay,
        "resolution_s": found.resolution,
        "method": "sampled",
        "note": NOTE,
        "proved": found.proved,
        "reason": f"windows shorter than {1000 * RESOLUTION:g} ms can be missed",
    }


def proofs_inside(
    loop: SampledLoop, answer: dict[str, Any], progress: Callable[[float], None] | None = None
) -> list[dict[str, Any]]:
    """Prove the verdict at one delay within every window and every gap: at its middle.

    A proof over a whole window takes minutes for a law of 200 states; `certify` does it on demand.

    Args:
        loop: The loop.
        answer: What `windows_answer` returned for it.
        progress: Called with each delay [s].

    Returns:
        Delay [s], verdict, number of unstable eigenvalues and reason of each proof.
    """
    ends = [0.0, *(crossing["delay_s"] for crossing in answer["crossings"]), answer["max_delay_s"]]
    proofs: list[dict[str, Any]] = []
    for low, high in pairwise(ends):
        if low == high:
            continue
        delay = (low + high) / 2.0
        if progress is not None:
            progress(delay)
        found = certify(loop, delay)
        proofs.append(
            {
                "delay_s": delay,
                "verdict": found.verdict,
                "unstable_roots": found.unstable_roots,
                "reason": found.reason,
            }
        )
    return proofs
