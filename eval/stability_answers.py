"""The oracle's answers in plain values: one form for command line, records and report."""

from collections.abc import Callable
from typing import Any

import numpy as np

from baselines.controller import Controller, users_own_code
from baselines.policies import GatedPolicy
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError, ControllerError, RailenvError
from railenv.stability import (
    CriticalDelays,
    DelaySystem,
    EnclosedRoots,
    Mode,
    critical_delays,
    follow,
    pade_critical_delays,
    required_order,
    rightmost_roots,
    sampled_critical_delay,
)
from railenv.vehicle import LateralVehicle, mode_name

_DIRECTIONS = {1: "unstable", -1: "stable", 0: "touches"}

LOCUS_DELAYS_MS = tuple(range(0, 301, 4))
"""Delays of a root locus [ms]."""

LOCUS_ROOTS = 20
"""Rightmost roots looked at for each delay of a root locus."""

LOCUS_DEPTH = -12.0
"""Branches that never come to the right of this are left out [1/s]."""

LOCUS_STEP = 0.5
"""Largest cost of following a root from one delay to the next; see `follow`."""


def is_sampled_only(controller: object) -> bool:
    """Whether a law is linear, but only from sample to sample: no continuous loop has it in it.

    A law says so with an attribute `sampled`, or by a `to_sampled_loop` without a
    `to_delay_system`. A policy that is told the delay and is not linear is another law at rest for
    every told delay, and no one loop.
    """
    if not hasattr(controller, "to_sampled_loop"):
        return False
    if _is_many_laws(controller):
        return False
    return getattr(controller, "sampled", False) is True or not hasattr(
        controller, "to_delay_system"
    )


def _is_many_laws(controller: object) -> bool:
    told = getattr(controller, "is_told", False)
    return bool(told) and not getattr(controller, "is_linear", True)


def words_of_rest(controller: object) -> str | None:
    """Say that an answer about a policy that is not linear holds at rest; None for a linear law.

    The loop of such a policy is that of its linearisation at rest: it decides whether small motion
    dies out or grows, and says nothing of large motion.
    """
    if getattr(controller, "is_linear", True):
        return None
    gates = ", the gates at rest" if isinstance(controller, GatedPolicy) else ""
    return (
        f"{type(controller).__name__} is not linear; this is its law at rest{gates}, and holds for "
        "small motion"
    )


def delay_system(
    controller: Controller, vehicle: LateralVehicle, actuator: ActuatorSpec | None = None
) -> DelaySystem:
    """Return the loop of a linear controller.

    Raises:
        ArgumentError: The controller is not linear (it has no `to_delay_system`), or is a sampled
            law, or is told the delay and not linear.
    """
    if _is_many_laws(controller):
        raise ArgumentError(
            f"controller {type(controller).__name__} is told the delay and is not linear: at rest "
            "it is another law for every told delay, and no one loop; ask critical-delay with "
            "--method simulation, or railenv score, which judges it at rest as it is told"
        )
    if is_sampled_only(controller):
        raise ArgumentError(
            f"controller {type(controller).__name__} is a sampled law and has no continuous loop; "
            "ask critical-delay or roots with --method exact, or certify with --control-period"
        )
    convert = getattr(controller, "to_delay_system", None)
    if convert is None:
        raise ArgumentError(
            f"controller {type(controller).__name__} is not linear: it has no to_delay_system, and "
            "the oracle cannot judge it; ask critical-delay with --method simulation"
        )
    try:
        with users_own_code("the controller's to_delay_system"):
            system = convert(vehicle) if actuator is None else convert(vehicle, actuator)
    except ControllerError as error:
        # What the oracle itself refuses (a neutral loop, another layout) is said in its own words.
        if isinstance(error.__cause__, RailenvError):
            raise error.__cause__ from None
        raise
    if not isinstance(system, DelaySystem):
        raise ControllerError(
            f"the controller's to_delay_system returned {type(system).__name__}; "
            "it must return a DelaySystem"
        )
    return system


def critical_delay_answer(
    system: DelaySystem,
    vehicle: LateralVehicle | None,
    period: float | None,
    max_delay: float,
    pade_order: int | None = None,
    progress: Callable[[float], None] | None = None,
) -> dict[str, Any]:
    """Answer the question for the critical delay, continuous and sampled.

    Args:
        system: The loop.
        vehicle: Names the modes; None for a loop that is no vehicle's, whose modes have no name.
        period: Control period for the sampled answer [s]; None for no such answer.
        max_delay: Longest delay searched [s].
        pade_order: Order of the Pade model that answers instead of the exact crossings; the sampled
            answer is the exact one in either case.
        progress: Called with each delay the sampled answer looks at [s].

    Returns:
        Plain values under the keys of the command line's JSON.
    """
    exact = critical_delays(system, max_delay)
    result = exact if pade_order is None else pade_critical_delays(system, pade_order, max_delay)
    first = result.first
    beside = {} if pade_order is None else _beside_exact(result, exact)
    after = result.unstable_without_delay + 2 * np.cumsum([c.direction for c in result.crossings])
    return {
        "critical_delay_s": result.critical_delay,
        "critical_delay_sampled_s": None
        if period is None
        else sampled_critical_delay(system, exact, period, progress),
        "control_period_s": period,
        "frequency_hz": None if first is None else first.frequency_hz,
        "mode": None if first is None else shown_name(vehicle, first.mode),
        "crossings": [
            {
                "delay_s": c.delay,
                "frequency_hz": c.frequency_hz,
                "direction": _DIRECTIONS[c.direction],
                "mode": shown_name(vehicle, c.mode),
                "unstable_roots_after": int(after[index]),
            }
            for index, c in enumerate(result.crossings)
        ],
        "stable_windows_s": [list(window) for window in result.stable_windows],
        "unstable_roots_without_delay": result.unstable_without_delay,
        "max_delay_s": max_delay,
        "method": "exact" if pade_order is None else f"pade:{pade_order}",
        "proved": result.proved,
        "marginal_roots": result.marginal,
        "delay_independent": result.delay_independent,
        "reason": result.reason,
        **beside,
    }


def _beside_exact(pade: CriticalDelays, exact: CriticalDelays) -> dict[str, Any]:
    """Set the exact answer beside a Pade model's, and the order the rule of the paper asks for."""
    error = None
    if pade.critical_delay and exact.critical_delay:
        error = pade.critical_delay / exact.critical_delay - 1.0
    first = exact.first
    return {
        "exact_critical_delay_s": exact.critical_delay,
        "relative_error": error,
        "order_by_the_rule": None
        if first is None
        else required_order(first.delay, first.frequency_hz),
    }


def root_answers(modes: list[Mode], vehicle: LateralVehicle | None) -> list[dict[str, Any]]:
    """Return roots as plain values; without a vehicle the modes have no name."""
    return [
        {
            "re": mode.root.real,
            "im": mode.root.imag,
            "frequency_hz": mode.frequency_hz,
            "damped_frequency_hz": mode.damped_frequency_hz,
            "damping_ratio": mode.damping_ratio,
            "mode": shown_name(vehicle, mode),
        }
        for mode in modes
    ]


def enclosed_root_answers(
    found: EnclosedRoots, vehicle: LateralVehicle | None
) -> list[dict[str, Any]]:
    """Return enclosed roots as plain values, each with the radius of its ball [1/s]."""
    answers: list[dict[str, Any]] = []
    for root in found.roots:
        plain = root_answers([root.mode], vehicle)[0]
        answers += [{**plain, "radius": root.radius}] * root.multiplicity
    return answers


def root_locus(system: DelaySystem, vehicle: LateralVehicle) -> dict[str, Any]:
    """Follow the oscillating roots near the imaginary axis through the delays.

    Returns:
        `delay_s`, and `modes`: one entry per branch with `name`, `re` and `im` over the delays,
        None where the branch does not exist. A branch is named where it comes farthest to the
        right; some are born far to the left from the delay itself, and some end on the real axis.
    """
    weight = np.diag(vehicle.mass)
    delays = [delay / 1000.0 for delay in LOCUS_DELAYS_MS]
    branches: list[list[Mode | None]] = []
    for step, delay in enumerate(delays):
        roots = rightmost_roots(system, delay, LOCUS_ROOTS)
        candidates = [mode for mode in roots if mode.root.imag > 0.0]
        alive = [branch for branch in branches if branch[-1] is not None]
        last = [branch[-1] for branch in alive]
        matched = follow([m for m in last if m is not None], candidates, weight, LOCUS_STEP)
        for branch in branches:
            branch.append(None)
        for branch, mode in zip(alive, matched, strict=True):
            branch[-1] = mode
        taken = {id(mode) for mode in matched}
        branches += [[None] * step + [m] for m in candidates if id(m) not in taken]
    modes: list[dict[str, Any]] = []
    for branch in branches:
        rightmost = max((m for m in branch if m is not None), key=lambda m: m.root.real)
        if rightmost.root.real > LOCUS_DEPTH:
            modes.append(
                {
                    "name": shown_name(vehicle, rightmost),
                    "re": [None if m is None else m.root.real for m in branch],
                    "im": [None if m is None else m.root.imag for m in branch],
                }
            )
    return {"delay_s": delays, "modes": modes}


def shown_name(vehicle: LateralVehicle | None, mode: Mode) -> str | None:
    """Return a mode's name; a loop that is no vehicle's has modes without one."""
    if vehicle is None:
        return None
    # A mode in which the vehicle does not move has no name of a vehicle's mode.
    return mode_name(vehicle, mode.root, mode.shape) if mode.shape.any() else "of the law"
