"""The critical delay of every controller of a benchmark: nominal vehicle, 300 km/h, each layout."""

from dataclasses import dataclass
from typing import Any

from eval.cells import controller_for, grows, is_linear
from eval.policy_score_oracle import LONGEST, has_oracle, stable_windows, time_domain
from eval.scenarios.scenario import lateral_of
from eval.stability_answers import critical_delay_answer, delay_system, is_sampled_only
from eval.told_designs import ToldDesigns
from railenv.errors import ArgumentError
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.units import Second
from railenv.vehicle import LateralVehicle

VEHICLE, SPEED_KMH = "nominal", 300.0
RESOLUTION: Second = 6e-3
"""Largest width of the brackets of simulated critical delays [s], one subdivision of the scan;
finer ones take minutes."""

COARSE_STEP: Second = 0.05
"""Spacing of the scan before [s]: the grid of the delays that the suites run."""

LONGEST_DESIGN: Second = 0.3
"""Longest delay simulated of a family of designs [s]: every delay is a law of its own to step."""

MAX_DELAY = 2.0
"""Longest delay searched for crossings of continuous laws [s]."""

SCAN_PERIODS = 5
"""Control periods between the designs of a family that are asked first."""


@dataclass(frozen=True)
class StabilityWork:
    """The question for one controller's critical delay.

    Attributes:
        controller: SPEC.
        layout: "2" or "4".
    """

    controller: str
    layout: str

    @property
    def place(self) -> tuple[str, str, str, float]:
        """What the answer is kept by: controller, layout, vehicle, speed [km/h]."""
        return self.controller, self.layout, VEHICLE, SPEED_KMH


def stability_answer(work: StabilityWork) -> dict[str, Any]:
    """Return how long a controller lives with a growing delay, told the truth if it is told.

    Returns:
        `method`: "exact" (continuous law: every crossing, proved where `proved` says so), "sampled"
        (law from sample to sample: stable windows by eigenvalues, not proved; of a design per delay
        see `design_answer`) or "simulation" (bracketed); `critical_delay_s` (None: none found up to
        `longest_s`), `proved` and what else the method tells.

    Raises:
        ArgumentError: The controller does not run on this layout.
        ControllerError: It failed.
    """
    place = ("lateral17", VEHICLE, work.layout, SPEED_KMH)
    controller = controller_for(work.controller, place)
    vehicle = lateral_of(place, getattr(controller, "layout", None))
    if not vehicle.num_actuators:
        return {"method": "exact", "critical_delay_s": None, "proved": False, "longest_s": None}
    period: float = getattr(controller, "control_period", None) or DEFAULT_CONTROL_PERIOD
    if hasattr(controller, "to_delay_system") and not is_sampled_only(controller):
        answer = critical_delay_answer(
            delay_system(controller, vehicle), vehicle, period, MAX_DELAY
        )
        return {"method": "exact", "longest_s": MAX_DELAY, **answer}
    if isinstance(controller, ToldDesigns) and is_linear(controller):
        return {"method": "sampled", **design_answer(controller, vehicle, period)}
    if is_linear(controller) and has_oracle(controller):
        return {"method": "sampled", **stable_windows(controller, vehicle)}
    longest = LONGEST_DESIGN if isinstance(controller, ToldDesigns) else LONGEST
    found = time_domain(
        controller, vehicle, longest, resolution=RESOLUTION, coarse_step=COARSE_STEP
    )
    return {"method": "simulation", "proved": False, **found}


def design_answer(
    controller: ToldDesigns, vehicle: LateralVehicle, period: Second
) -> dict[str, Any]:
    """Return up to which delay designs hold the vehicle, each at the delay that it is made for.

    Asked at whole control periods: a loop with accelerations fed back jumps there, and a design for
    such a delay need not hold right beside it. `SCAN_PERIODS` apart first, then between the last
    design that holds and the first that does not, or that cannot be made; what fails only between
    two that hold is not seen.

    Args:
        controller: The family of designs.
        vehicle: The vehicle, with actuators.
        period: Control period [s].
    """
    most = int(LONGEST / period + 1e-9)
    steps = [*range(0, most, SCAN_PERIODS), most]

    def lost(number: int) -> bool:
        try:
            return grows(controller, vehicle, number * period)
        except ArgumentError:
            return True  # there is no design for so long a delay

    first = next((n for n in steps if lost(n)), None)
    critical: float | None = None
    if first == 0:
        critical = 0.0
    elif first is not None:
        low, high = steps[steps.index(first) - 1], first
        while high - low > 1:
            middle = (low + high) // 2
            if lost(middle):
                high = middle
            else:
                low = middle
        critical = low * period
    return {"critical_delay_s": critical, "longest_s": most * period, "proved": False}
