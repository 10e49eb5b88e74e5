"""How a benchmark's cells are grouped for work: packages of about a second.

A package is one controller on scenarios that share model, vehicle, layout and speed, which run side
by side in one batch. Packages follow from suite and controller alone, not from what is missing or
how many workers there are; so whoever runs them, their numbers are the same to the last bit.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from eval.scenarios import Channel, Scenario, Suite
from eval.scenarios.channel import number_text

PASSIVE = "passive"
"""Controller that comfort is gained over."""

REFERENCE = "reference"
"""Controller that stands for a comfort gain of one; see `eval.scoring.gain`."""

_LANES = {"lateral17": 256, "full50": 4}
# A second or so on one core: some 10,000 times real time for the linear vehicle, 40 to 60 times for
# the nonlinear one.


@dataclass(frozen=True)
class Package:
    """One controller on some scenarios.

    Attributes:
        name: Names it within the controller, e.g. "lateral17/nominal/4/300#0".
        controller: SPEC.
        scenarios: Scenarios that share a place.
    """

    name: str
    controller: str
    scenarios: tuple[Scenario, ...]


def packages_of(
    suite: Suite, controller: str, layout: str | None = None, models: Sequence[str] | None = None
) -> Iterator[Package]:
    """Yield the packages of a controller; of passive and reference those without delay alone.

    Args:
        suite: The suite.
        controller: SPEC.
        layout: The only layout that it acts on; None for all.
        models: Vehicle models that it acts on; None for all.
    """
    scenarios = tuple(
        s
        for s in suite.scenarios
        if layout in (None, s.layout) and (models is None or s.model in models)
    )
    if controller in (PASSIVE, REFERENCE):
        scenarios = references_of(suite)
    places: dict[tuple[str, str, str, float], list[Scenario]] = {}
    for scenario in scenarios:
        places.setdefault(scenario.place, []).append(scenario)
    for place, members in places.items():
        most = _LANES[place[0]]
        for number, first in enumerate(range(0, len(members), most)):
            model, vehicle, layout, speed = place
            name = f"{model}/{vehicle}/{layout}/{number_text(speed)}#{number}"
            yield Package(name, controller, tuple(members[first : first + most]))


def references_of(suite: Suite) -> tuple[Scenario, ...]:
    """Return the scenarios of passive and reference: every vehicle and track, without delay."""
    return tuple(dict.fromkeys(reference_scenario(scenario) for scenario in suite.scenarios))


def reference_scenario(scenario: Scenario) -> Scenario:
    """Return the scenario without delay on the same vehicle and track."""
    s = scenario
    free = Channel("constant", 0.0)
    return Scenario(s.version, s.model, s.vehicle, s.layout, s.speed_kmh, s.track, free, s.seed)
