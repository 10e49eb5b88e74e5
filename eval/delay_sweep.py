"""Critical delay in the time domain, for any controller (section 5.3 of the source paper).

A section of irregular track excites the vehicle and ends; what is left decays or grows
(`eval.delay_probe`, and `eval.full50_probe` for the nonlinear vehicle). The delay is scanned
coarsely (stability can return at longer delays) and every change between two delays of the scan is
then bracketed by repeated subdivision (two changes within one step stay unseen). Stable is what
tends to zero; everything else is called unstable.

The answer includes the controller's sampling. It is a bracket, called an estimate.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from baselines.controller import Controller
from eval.delay_probe import Probe
from eval.full50_probe import FullProbe
from eval.rollout import Stepping
from eval.simulations import Vehicle
from railenv.errors import ArgumentError, check_positive
from railenv.vehicle import LateralVehicle

COARSE_STEP = 0.02
"""Spacing of the coarse scan [s]."""

MOST_COARSE = 500
"""Delays of the longest coarse scan."""

RESOLUTION = 0.0005
"""Width at which a bracket is narrow enough [s]."""

_SUBDIVISION = 9


def simulated_critical_delay(
    controller: Controller,
    vehicle: Vehicle,
    *,
    stepping: Stepping | None = None,
    max_delay: float = 2.0,
    track: str = "tb3352",
    seed: int = 0,
    resolution: float = RESOLUTION,
    coarse_step: float = COARSE_STEP,
    first_only: bool = False,
    progress: Callable[[str], None] | None = None,
) -> dict[str, Any]:
    """Estimate the critical delay of any controller by simulation.

    Args:
        controller: The controller.
        vehicle: The vehicle.
        stepping: Steps, limits and lag; noise of the sensors is left out, as with it nothing decays
            to zero.
        max_delay: Longest delay searched [s].
        track: Irregularity that excites.
        seed: Seed of the irregularity, and given to the controller.
        resolution: Width of the final brackets [s].
        coarse_step: Spacing of the coarse scan [s].
        first_only: Look no further than the first change to unstable: later changes are not
            bracketed and the limit cycle is not run.
        progress: Called with a word on every batch of runs that starts.

    Returns:
        Plain values under the keys of the command line's JSON. `critical_delay_sampled_s` is the
        middle of `bracket_s`; the continuous one is unknown to this method and None. The nonlinear
        vehicle's answer also has `hunting_hz`, the frequency of what it does by itself, or None.

    Raises:
        ControllerError: The controller broke the protocol.
        ArgumentError: A setting is out of range.
    """
    steps = replace(stepping or Stepping(), sensor_noise=0.0)
    longest = check_positive("max_delay", max_delay, "seconds")
    check_positive("resolution", resolution, "seconds")
    coarse = check_positive("coarse_step", coarse_step, "seconds")
    if longest > MOST_COARSE * coarse:
        raise ArgumentError(
            f"max_delay = {longest:g} s is too long to simulate; "
            f"give {MOST_COARSE * coarse:g} s or less"
        )
    kind = Probe if isinstance(vehicle, LateralVehicle) else FullProbe
    probe = kind(controller, vehicle, steps, track, seed)
    tell = progress or (lambda _: None)
    tell("coarse scan")
    count = max(2, int(np.ceil(longest / coarse)) + 1) if vehicle.num_actuators else 1
    delays = np.linspace(0.0, longest, count)
    stable = probe.stable(delays)
    brackets: list[dict[str, Any]] = []
    changes = np.flatnonzero(stable[1:] != stable[:-1])
    if first_only:
        # Without a stable start there is no critical delay to bracket.
        changes = changes[:1] if stable[0] else changes[:0]
    for k in changes:
        low, high = float(delays[k]), float(delays[k + 1])
        while high - low > resolution:
            tell(f"{1000 * low:.1f} to {1000 * high:.1f} ms")
            inner = np.linspace(low, high, _SUBDIVISION + 2)
            verdicts = np.concatenate([[stable[k]], probe.stable(inner[1:-1]), [stable[k + 1]]])
            change = int(np.flatnonzero(verdicts[1:] != verdicts[:-1])[0])
            low, high = float(inner[change]), float(inner[change + 1])
        direction = "stable" if stable[k + 1] else "unstable"
        brackets.append({"bracket_s": [low, high], "direction": direction})
    answer: dict[str, Any] = {
        "critical_delay_s": None,
        "critical_delay_sampled_s": None,
        "control_period_s": steps.control_period,
        "frequency_hz": None,
        "mode": None,
        "crossings": [],
        "bracket_s": None,
        "limit_cycle": None,
        "max_delay_s": longest,
        "method": "simulation",
        "note": "the continuous critical delay is not computed by simulation",
        "proved": False,
    }
    if isinstance(probe, FullProbe):
        answer["hunting_hz"] = probe.hunting.frequency or None
    for bracket in brackets:
        low, high = bracket["bracket_s"]
        unstable = high if bracket["direction"] == "unstable" else low
        tell("shape at the change")
        frequency, name = probe.oscillation(unstable)
        answer["crossings"].append(
            {"delay_s": (low + high) / 2, "frequency_hz": frequency, "mode": name, **bracket}
        )
    if not stable[0]:
        answer["critical_delay_sampled_s"] = 0.0
        return answer
    first = next((c for c in answer["crossings"] if c["direction"] == "unstable"), None)
    if first is not None:
        answer["critical_delay_sampled_s"] = first["delay_s"]
        answer["bracket_s"] = first["bracket_s"]
        answer["frequency_hz"], answer["mode"] = first["frequency_hz"], first["mode"]
        if not first_only:
            tell("limit cycle")
            beyond = float(delays[np.flatnonzero(~stable)[0]])
            answer["limit_cycle"] = probe.limit_cycle(beyond)
    return answer
