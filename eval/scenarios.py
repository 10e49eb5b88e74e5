"""Benchmark suites: which controllers run on which vehicles, tracks and delays; versioned.

A suite is a TOML file in `configs/benchmark`. Each of its cells is named by a stable key. A change
of a suite's content is a new version.
"""

from collections.abc import Iterator
from dataclasses import dataclass

from eval.rollout import Stepping
from railenv.actuation import ActuatorSpec
from railenv.config import config_path, from_mapping, load_toml
from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.simulation import whole_multiple
from railenv.track import make_track
from railenv.units import KilometrePerHour, Newton, Second
from railenv.vehicle import get_vehicle
from railenv.vehicle.coordinates import parse_layout


@dataclass(frozen=True)
class Suite:
    """A benchmark suite.

    Attributes:
        version: Name and version, e.g. "quick-v0".
        vehicle: Name of a catalogued vehicle.
        controllers: Controller SPECs.
        layouts: Layouts that controllers with actuators run on.
        speeds_kmh: Running speeds [km/h].
        tracks: Track descriptions.
        seeds: Seeds of the track realisations.
        delays_ms: Delays, the same for all channels [ms].
        duration: Length of a run [s].
        skip: Time left out of the measures at the start [s].
        control_period: Time between commands [s].
        time_step: Physics step [s].
        force_limit: Actuators' force limit [N].

    Raises:
        ArgumentError: A value is out of range or a name unknown.
    """

    version: str
    vehicle: str
    controllers: tuple[str, ...]
    layouts: tuple[str, ...]
    speeds_kmh: tuple[KilometrePerHour, ...]
    tracks: tuple[str, ...]
    seeds: tuple[int, ...]
    delays_ms: tuple[float, ...]
    duration: Second
    skip: Second
    control_period: Second
    time_step: Second
    force_limit: Newton

    def __post_init__(self) -> None:
        get_vehicle(self.vehicle)
        for layout in self.layouts:
            parse_layout(layout)
        for speed in self.speeds_kmh:
            check_positive("speeds_kmh", speed, "km/h")
        for delay in self.delays_ms:
            check_not_negative("delays_ms", delay, "ms")
        for track in self.tracks:
            if not track.endswith(".csv"):
                make_track(track, 1000.0, 0)
        check_positive("force_limit", self.force_limit, "N")
        whole_multiple("control_period", self.control_period, "time_step", self.time_step)
        whole_multiple("duration", self.duration, "control_period", self.control_period)
        check_not_negative("skip", self.skip, "seconds")
        if self.duration < self.skip + 5.0:
            raise ArgumentError(
                f"duration = {self.duration:g} s leaves less than one 5 s segment after "
                f"skip = {self.skip:g} s; make the run longer"
            )
        for name in ("controllers", "layouts", "speeds_kmh", "tracks", "seeds", "delays_ms"):
            if not getattr(self, name):
                raise ArgumentError(f"{name} is empty; give at least one")

    def stepping(self) -> Stepping:
        """Return how runs of this suite are stepped."""
        return Stepping(
            self.control_period, self.time_step, ActuatorSpec(force_limit=self.force_limit)
        )

    @property
    def delays(self) -> tuple[float, ...]:
        """Delays [s]."""
        return tuple(delay / 1000.0 for delay in self.delays_ms)

    def groups(self) -> Iterator[tuple[str, str, float]]:
        """Yield (controller, layout, speed in km/h); a group's cells run as one batch."""
        for controller in self.controllers:
            name = controller.partition(":")[0]
            for layout in ("passive",) if name == "passive" else self.layouts:
                for speed in self.speeds_kmh:
                    yield controller, layout, speed


def load_suite(name: str) -> Suite:
    """Load a named suite.

    Raises:
        ArgumentError: No suite has that name, or its file holds a bad entry.
    """
    path = config_path("benchmark", name)
    return from_mapping(Suite, load_toml(path), f"suite {name!r}")


def cell_key(
    controller: str, layout: str, speed_kmh: float, track: str, seed: int, delay: float
) -> str:
    """Return the stable name of a cell."""
    return f"{controller}|layout={layout}|{speed_kmh:g}km/h|{track}|seed={seed}|{1000 * delay:g}ms"
