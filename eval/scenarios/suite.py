"""Suites: which scenarios a benchmark runs; versioned.

A suite is a TOML file in `configs/benchmark`: how long a run is, and blocks, each the product of
its lists. A scenario that is in two blocks is run once. A change of what a scenario means or of a
suite's content is a new version: scores of different versions are not comparable.
"""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

from baselines.design.model import DESIGN_NOISE
from eval.rollout import Stepping
from eval.scenarios.channel import JITTER, Channel
from eval.scenarios.scenario import Scenario
from railenv.actuation import ActuatorSpec
from railenv.config import config_path, from_mapping, load_toml
from railenv.errors import ArgumentError, check_count, check_not_negative, check_positive
from railenv.simulation import DEFAULT_CONTROL_PERIOD, whole_multiple
from railenv.units import Dimensionless, KilometrePerHour, Newton, Second

_SEGMENT: Second = 5.0
_LONGEST_RUN: Second = 600.0
_MOST_SCENARIOS = 1_000_000
_SPEEDS: tuple[KilometrePerHour, KilometrePerHour] = (50.0, 1000.0)
LONGEST_DELAY_MS = 300.0
"""Longest delay of a scenario [ms]; the score is a mean up to it. What a controller sees of its own
past actions reaches back so far in every suite, so that a cell is the same cell in all of them."""
_LISTS = ("models", "vehicles", "layouts", "speeds_kmh", "tracks", "channels", "delays_ms")


@dataclass(frozen=True)
class Block:
    """A product of lists.

    Attributes:
        name: What it is for.
        models: Vehicle models.
        vehicles: Vehicles.
        layouts: Layouts.
        speeds_kmh: Running speeds [km/h].
        tracks: Spectra.
        channels: Kinds of channels.
        delays_ms: Delays [ms].
        seeds: Number of test tracks, from the first one.

    Raises:
        ArgumentError: A list is empty.
    """

    name: str
    models: tuple[str, ...]
    vehicles: tuple[str, ...]
    layouts: tuple[str, ...]
    speeds_kmh: tuple[KilometrePerHour, ...]
    tracks: tuple[str, ...]
    channels: tuple[str, ...]
    delays_ms: tuple[float, ...]
    seeds: int

    def __post_init__(self) -> None:
        where = f"block {self.name!r}: "
        for field in _LISTS:
            values = getattr(self, field)
            if not values:
                raise ArgumentError(f"{where}{field} is empty; give at least one")
            if len(set(values)) < len(values):
                raise ArgumentError(f"{where}{field} has an entry twice; give it once")
        check_count(f"{where}seeds", self.seeds)
        for delay in self.delays_ms:
            # Not a number is not below it either.
            if not delay <= LONGEST_DELAY_MS:
                raise ArgumentError(
                    f"{where}delays_ms has {delay:g}; give {LONGEST_DELAY_MS:g} or less"
                )
        for speed in self.speeds_kmh:
            if not _SPEEDS[0] <= speed <= _SPEEDS[1]:
                raise ArgumentError(
                    f"{where}speeds_kmh has {speed:g}; give {_SPEEDS[0]:g} to {_SPEEDS[1]:g}"
                )

    @property
    def number(self) -> int:
        """How many scenarios there are."""
        return math.prod(len(getattr(self, field)) for field in _LISTS) * self.seeds

    def scenarios(self, version: str) -> list[Scenario]:
        """Return the block's scenarios."""
        lists = (
            self.models,
            self.vehicles,
            self.layouts,
            self.speeds_kmh,
            self.tracks,
            itertools.product(self.channels, self.delays_ms),
            range(self.seeds),
        )
        return [
            Scenario(version, model, vehicle, layout, speed, track, Channel(*channel), seed)
            for model, vehicle, layout, speed, track, channel, seed in itertools.product(*lists)
        ]


@dataclass(frozen=True)
class Suite:
    """A benchmark suite.

    Attributes:
        name: E.g. "quick".
        version: Version of all suites, e.g. "v0".
        controllers: SPECs that are run if none are given; "shipped" stands for all shipped
            policies. In a SPEC {delay} stands for the scenario's delay [s].
        blocks: The scenarios.
        seconds: Length that is measured on the linear vehicle [s].
        full_seconds: The same on the nonlinear one, which takes a hundred times as long [s].
        skip: Time left out before it [s].
        sensor_noise: Standard deviation of the readings' noise, in units of the controlled
            response [1].
        time_step: Time between records [s].
        force_limit: Actuators' force limit [N].

    Raises:
        ArgumentError: A value is out of range or a name unknown.
    """

    name: str
    version: str
    controllers: tuple[str, ...]
    blocks: tuple[Block, ...]
    seconds: Second
    full_seconds: Second = 20.0
    skip: Second = 10.0
    sensor_noise: Dimensionless = DESIGN_NOISE
    time_step: Second = 0.005
    force_limit: Newton = 30e3

    def __post_init__(self) -> None:
        if not self.blocks:
            raise ArgumentError("the suite has no [[blocks]]; give at least one")
        check_positive("force_limit", self.force_limit, "N")
        check_not_negative("sensor_noise", self.sensor_noise)
        step = "time_step", self.time_step
        whole_multiple("control_period", DEFAULT_CONTROL_PERIOD, *step)
        if not self.name.isprintable() or "/" in self.name or self.name[:1] in ("", "."):
            # It names a folder.
            raise ArgumentError(f"name = {self.name!r} is no name of a suite; give a word")
        check_not_negative("skip", self.skip, "seconds")
        for name in ("seconds", "full_seconds"):
            if check_positive(name, getattr(self, name), "seconds") < _SEGMENT:
                raise ArgumentError(
                    f"{name} = {getattr(self, name):g} s is too short; give {_SEGMENT:g} or more, "
                    "the ride index is a mean over segments of that length"
                )
            if getattr(self, name) > _LONGEST_RUN:
                raise ArgumentError(
                    f"{name} = {getattr(self, name):g} s is too long; give {_LONGEST_RUN:g} or less"
                )
        for name in ("seconds", "full_seconds", "skip"):
            if getattr(self, name) > 0.0:
                whole_multiple(name, getattr(self, name), "control_period", DEFAULT_CONTROL_PERIOD)
        number = sum(block.number for block in self.blocks)
        if number > _MOST_SCENARIOS:
            raise ArgumentError(
                f"the blocks make {number} scenarios; give {_MOST_SCENARIOS} or fewer"
            )
        _check_whole(self.scenarios)

    @cached_property
    def scenarios(self) -> tuple[Scenario, ...]:
        """All scenarios, in the blocks' order, each once."""
        found = [s for block in self.blocks for s in block.scenarios(self.version)]
        return tuple(dict.fromkeys(found))

    def __getstate__(self) -> dict[str, Any]:
        """Leave the scenarios out: they follow from the blocks, and each package takes a suite."""
        return {name: value for name, value in self.__dict__.items() if name != "scenarios"}

    def duration(self, model: str) -> Second:
        """Return the length of a run [s]."""
        return self.skip + (self.full_seconds if model == "full50" else self.seconds)

    def stepping(self, control_period: Second | None = None) -> Stepping:
        """Return how a run is stepped.

        Args:
            control_period: The controller's own; None for the usual one [s].
        """
        return Stepping(
            control_period or DEFAULT_CONTROL_PERIOD,
            self.time_step,
            ActuatorSpec(force_limit=self.force_limit),
            max_delay=LONGEST_DELAY_MS / 1000.0 + JITTER,
            sensor_noise=self.sensor_noise,
        )


def _check_whole(scenarios: Sequence[Scenario]) -> None:
    """Raise unless every track of a condition is run at every delay of the condition.

    The score of a track is a mean over delays: with fewer of them it would be another number.
    """
    found: dict[tuple[object, ...], dict[int, set[float]]] = {}
    for s in scenarios:
        condition = (*s.place, s.track, s.channel.kind)
        found.setdefault(condition, {}).setdefault(s.seed, set()).add(s.channel.delay_ms)
    for condition, seeds in found.items():
        if len({frozenset(delays) for delays in seeds.values()}) > 1:
            place = "/".join(str(part) for part in condition)
            raise ArgumentError(
                f"blocks give {place} other delays on some tracks than on others; give every track "
                "of a condition the same delays"
            )


def load_suite(name: str) -> Suite:
    """Load a suite by its name, or from the path of a TOML file.

    Raises:
        ArgumentError: No suite has that name, or its file holds a bad entry.
    """
    path = Path(name) if name.endswith(".toml") else config_path("benchmark", name)
    return from_mapping(Suite, load_toml(path), f"suite {name!r}")
