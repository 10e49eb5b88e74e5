"""How the characteristic roots of a controller's loop move as its commands come later.

Asked in the same way as for the critical delay (`eval.benchmark_stability`), so that the picture
goes with the number beside it. Estimates in floating point; nothing here is proved.
"""

from typing import Any

import numpy as np

from eval.cells import is_linear
from eval.policy_score_oracle import has_oracle
from eval.stability_answers import LOCUS_STEP, delay_system, is_sampled_only
from eval.told_designs import ToldDesigns
from railenv.errors import RailenvError
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.stability import Mode, follow, rightmost_roots
from railenv.stability.lifted_roots import lifted_roots
from railenv.units import Second
from railenv.vehicle import LateralVehicle

LOCUS_DELAYS: tuple[Second, ...] = tuple(k / 100.0 for k in range(31))
"""Delays of a locus [s]."""

DESIGN_DELAYS: tuple[Second, ...] = (0.0, 0.1, 0.2, 0.3)
"""The same of a family of designs, each of which takes its time [s]."""

FASTEST_HZ = 6.0
"""Slower roots are those of the vehicle's modes; of faster ones only those that grow are kept."""

DEEPEST = -6.0
"""Roots farther left are left out [1/s]."""

_CONTINUOUS, _SAMPLED = 10, 80
"""Rightmost roots looked at. A sampled law has its own memory's among them, dozens of them fast."""

_NOT_LINEAR = "the law is not linear, so that its loop has no characteristic roots"


def root_motion(controller: Any, vehicle: LateralVehicle) -> dict[str, Any]:
    """Return the loop's roots by delay.

    Args:
        controller: The controller, for the vehicle's layout.
        vehicle: The vehicle.

    Returns:
        `kind`: "exact" (continuous law), "sampled" (s = ln(z)/T of the map from sample to sample,
        a law that is told the delay told the truth), "designs" (one law per delay), "passive" (no
        actuators, so no delay); `delays_s`; and `branches`, each with `first`, the number of its
        first delay, and `roots`, [real, imaginary] [1/s] from delay to delay, imaginary parts from
        zero up. Only roots that `_kept` are there. Where the oracle does not know the law: `none`,
        the reason in words.
    """
    try:
        return _root_motion(controller, vehicle)
    except RailenvError as error:
        return {"none": str(error)}


def _root_motion(controller: Any, vehicle: LateralVehicle) -> dict[str, Any]:
    if hasattr(controller, "to_delay_system") and not is_sampled_only(controller):
        system = delay_system(controller, vehicle)
        if not vehicle.num_actuators:
            return _answer("passive", (0.0,), [rightmost_roots(system, 0.0, _CONTINUOUS)], vehicle)
        found = [rightmost_roots(system, delay, _CONTINUOUS) for delay in LOCUS_DELAYS]
        return _answer("exact", LOCUS_DELAYS, found, vehicle)
    if not is_linear(controller) or not has_oracle(controller):
        return {"none": _NOT_LINEAR}
    period: float = getattr(controller, "control_period", None) or DEFAULT_CONTROL_PERIOD

    def roots_at(delay: Second) -> list[Mode]:
        law = controller.law_at(delay) if hasattr(controller, "law_at") else controller
        return lifted_roots(law.to_sampled_loop(vehicle, period), delay, _SAMPLED)

    if isinstance(controller, ToldDesigns):
        return _answer("designs", DESIGN_DELAYS, [roots_at(d) for d in DESIGN_DELAYS], vehicle)
    return _answer("sampled", LOCUS_DELAYS, [roots_at(d) for d in LOCUS_DELAYS], vehicle)


def _answer(
    kind: str, delays: tuple[Second, ...], found: list[list[Mode]], vehicle: LateralVehicle
) -> dict[str, Any]:
    kept = [[mode for mode in modes if _kept(mode)] for modes in found]
    # Designs for two delays are two laws: no root of one becomes a root of the other.
    branches = _branches(kept, np.diag(vehicle.mass), LOCUS_STEP if kind != "designs" else -1.0)
    plain = [
        {"first": first, "roots": [[_short(m.root.real), _short(m.root.imag)] for m in modes]}
        for first, modes in branches
    ]
    return {"kind": kind, "delays_s": list(delays), "branches": plain}


def _kept(mode: Mode) -> bool:
    """Whether a root is shown: it grows, or it is slow and not far left."""
    root = mode.root
    slow = abs(root.imag) <= 2.0 * np.pi * FASTEST_HZ
    return bool(root.real >= 0.0 or (root.real > DEEPEST and slow))


def _branches(found: list[list[Mode]], weight: Any, limit: float) -> list[tuple[int, list[Mode]]]:
    """Follow roots from delay to delay; each is in one branch, alone if it could not be followed.

    Returns:
        Number of the first delay and the roots from there on.
    """
    branches: list[tuple[int, list[Mode]]] = []
    alive: list[tuple[int, list[Mode]]] = []
    for step, candidates in enumerate(found):
        matched = follow([modes[-1] for _, modes in alive], candidates, weight, limit)
        going: list[tuple[int, list[Mode]]] = []
        for branch, mode in zip(alive, matched, strict=True):
            if mode is not None:
                branch[1].append(mode)
                going.append(branch)
        taken = {id(mode) for mode in matched}
        born = [(step, [mode]) for mode in candidates if id(mode) not in taken]
        branches += born
        alive = going + born
    return branches


def _short(value: float) -> float:
    """Return a number with six digits after the point: more than the roots are accurate to draw."""
    return round(float(value), 6) + 0.0
