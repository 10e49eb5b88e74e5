"""What the oracle and the time domain say of a policy: growth, stable windows, critical delay.

A linear policy is judged as it is; a network by its linearisation at rest, so that the answer is
local. Eigenvalues of the sampled loop, without proof: `railenv certify` proves.
"""

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from baselines.controller import Controller
from eval.delay_sweep import COARSE_STEP, simulated_critical_delay
from eval.rollout import Stepping
from eval.simulations import Vehicle
from railenv.errors import check_finite, check_not_negative, check_positive
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.stability.lifted_roots import at_multiple, just_before
from railenv.vehicle import LateralVehicle

LONGEST = 0.6
"""No end of a stable window is looked for beyond [s]."""

LONGEST_NONLINEAR = 0.3
"""The same in simulations of the nonlinear vehicle, which take minutes [s]."""

SCAN_STEP = 0.0025
"""Distance between the delays of the scan for stable windows [s]; a narrower gap is not seen."""

FINEST = 5e-4
"""Width to which the end of a window is bracketed [s]."""


def is_told(controller: Controller) -> bool:
    """Whether a controller is told the delay and takes notice of it."""
    return bool(getattr(controller, "is_told", hasattr(controller, "tell")))


def has_oracle(controller: Controller) -> bool:
    """Whether the oracle can judge a controller: it is linear, or can be linearised at rest."""
    return hasattr(controller, "law_at") or hasattr(controller, "to_sampled_loop")


def growth(controller: Controller, vehicle: LateralVehicle, delay: float, told: float) -> float:
    """Return the largest growth rate of the sampled loop at one delay [1/s]; not proved.

    At a whole multiple of the control period, where a loop with acceleration sensors jumps, the
    larger one of both sides.

    Args:
        controller: A controller that `has_oracle`.
        vehicle: The vehicle.
        delay: True delay [s].
        told: Delay that the controller is told [s].
    """
    law_at: Callable[[float], Any] | None = getattr(controller, "law_at", None)
    law: Any = controller if law_at is None else law_at(told)
    period: float = getattr(controller, "control_period", None) or DEFAULT_CONTROL_PERIOD
    loop = law.to_sampled_loop(vehicle, period)
    place = at_multiple(check_not_negative("delay", delay, "seconds"), period)
    rate = loop.growth_rate(place)
    if place > 0.0 and place == at_multiple(round(place / period) * period, period):
        rate = max(rate, loop.growth_rate(just_before(place, period)))
    return rate


def growth_rates(
    controller: Controller,
    vehicle: LateralVehicle,
    delays: Sequence[float],
    told_error: float = 0.0,
    progress: Callable[[str], None] | None = None,
) -> list[float]:
    """Return the growth rate at each delay, the controller told that and an error, cut at zero."""
    error = check_finite("told_error", told_error, "seconds")
    rates: list[float] = []
    for delay in delays:
        if progress is not None:
            progress(f"growth rate at {1000 * delay:g} ms, told {1000 * error:+g} ms")
        rates.append(growth(controller, vehicle, delay, max(0.0, delay + error)))
    return rates


def stable_windows(
    controller: Controller,
    vehicle: LateralVehicle,
    longest: float = LONGEST,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Return over which delays the loop is stable, the controller told the true delay.

    The scan has a step of `SCAN_STEP`; each change of its verdict is bracketed to `FINEST`.

    Args:
        controller: A controller that `has_oracle`.
        vehicle: The vehicle.
        longest: Longest delay [s].
        progress: Called with a word on every delay.

    Returns:
        `windows_s`, pairs of first and last stable delay; `critical_delay_s`, the end of the window
        that begins without delay: zero if there is none, None if it ends beyond `longest`;
        `longest_s`; `proved`, which is false.
    """
    number = int(np.ceil(check_positive("longest", longest, "seconds") / SCAN_STEP)) + 1
    delays = [float(d) for d in np.linspace(0.0, longest, number)]
    rates = growth_rates(controller, vehicle, delays, progress=progress)
    edges = [
        _edge(controller, vehicle, delays[k], delays[k + 1], rates[k] < 0.0)
        for k in range(number - 1)
        if (rates[k] < 0.0) != (rates[k + 1] < 0.0)
    ]
    if rates[0] < 0.0:
        edges.insert(0, 0.0)
    if rates[-1] < 0.0:
        edges.append(longest)
    windows = [(edges[k], edges[k + 1]) for k in range(0, len(edges), 2)]
    critical: float | None = 0.0
    if rates[0] < 0.0:
        critical = None if windows[0][1] == longest else windows[0][1]
    return {
        "windows_s": windows,
        "critical_delay_s": critical,
        "longest_s": longest,
        "proved": False,
    }


def _edge(
    controller: Controller, vehicle: LateralVehicle, first: float, last: float, stable: bool
) -> float:
    """Return the last stable delay before a change of the verdict, or the first one after it."""
    low, high = first, last
    while high - low > FINEST:
        middle = (low + high) / 2.0
        if (growth(controller, vehicle, middle, middle) < 0.0) == stable:
            low = middle
        else:
            high = middle
    return low if stable else high


def time_domain(
    controller: Controller,
    vehicle: Vehicle,
    longest: float = LONGEST,
    progress: Callable[[str], None] | None = None,
    resolution: float = 2.0 * FINEST,
    coarse_step: float = COARSE_STEP,
) -> dict[str, Any]:
    """Return the critical delay by simulation, the controller told the true delay.

    Args:
        controller: The controller.
        vehicle: The vehicle.
        longest: Longest delay [s].
        progress: Called with a word on every batch of runs.
        resolution: Width of the bracket [s].
        coarse_step: Spacing of the scan before [s]; a loss that ends within it is not seen.

    Returns:
        `critical_delay_s` (None if none is found up to `longest_s`), `bracket_s`, `frequency_hz`
        and `mode` of the motion beyond it, and `longest_s`.
    """
    period: float = getattr(controller, "control_period", None) or DEFAULT_CONTROL_PERIOD
    found = simulated_critical_delay(
        controller,
        vehicle,
        stepping=Stepping(control_period=period),
        max_delay=longest,
        resolution=resolution,
        coarse_step=coarse_step,
        first_only=True,
        progress=progress,
    )
    answer = {key: found[key] for key in ("bracket_s", "frequency_hz", "mode")}
    return {"critical_delay_s": found["critical_delay_sampled_s"], **answer, "longest_s": longest}
