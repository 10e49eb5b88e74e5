"""A scenario: the vehicle, the track and the channel that a controller is run on.

Its key names it for good, `v0/lateral17/nominal/4/300/german_low/constant:100/3`: version of the
suites, model, vehicle, layout, speed [km/h], spectrum, channel, number of the test track.
"""

from dataclasses import dataclass
from functools import cache

from eval.scenarios.channel import Channel, number_text
from eval.simulations import Vehicle
from railenv.errors import (
    ArgumentError,
    check_count,
    check_positive,
    check_text,
    unknown_name,
)
from railenv.track import make_track, spectrum_names
from railenv.track.irregularity import parse_spec
from railenv.units import Dimensionless, KilometrePerHour
from railenv.vehicle import LateralVehicle, VehicleParameters, get_vehicle, lateral17
from railenv.vehicle.coordinates import parse_layout
from railenv.vehicle.nonlinear import FullParameters, full50

MODELS = ("lateral17", "full50")
"""Vehicle models."""

VEHICLES = ("nominal", "laden", "worn", "soft", "stiff")
"""Vehicles: nominal; full of people; worn wheels; a secondary suspension that is softer or stiffer
than nominal in all directions, by what manufacture, temperature and age do."""

NOMINAL = "paper_fit"
LOAD: Dimensionless = 1.25
"""10 t of passengers on a carbody of 40 t; they do not change the radii of gyration."""
WORN: Dimensionless = 0.3
"""Equivalent conicity of worn wheels; new ones have 0.17. It is a number of the linear vehicle: on
the nonlinear one conicity follows from profiles, and no worn one is in the catalogue."""
SOFT, STIFF = 0.8, 1.25
"""Factors on stiffness and damping of the secondary suspension (air springs and their dampers, not
the yaw and lateral dampers)."""

_LONGEST_SEED = 9
_CARBODY = ("carbody_mass", "carbody_yaw_inertia", "carbody_roll_inertia")
_SUSPENSION = (
    "secondary_longitudinal_stiffness",
    "secondary_lateral_stiffness",
    "secondary_vertical_stiffness",
    "secondary_lateral_damping",
    "secondary_vertical_damping",
)


def vehicle_parameters(name: str) -> VehicleParameters:
    """Return the parameters of one of `VEHICLES`.

    Raises:
        ArgumentError: There is no such vehicle.
    """
    own = get_vehicle(NOMINAL).parameters
    if name == "laden":
        return own.replace(**{field: LOAD * getattr(own, field) for field in _CARBODY})
    if name == "worn":
        return own.replace(conicity=WORN)
    if name in ("soft", "stiff"):
        factor = SOFT if name == "soft" else STIFF
        return own.replace(**{field: factor * getattr(own, field) for field in _SUSPENSION})
    if name != "nominal":
        raise unknown_name("vehicle of the benchmark", name, VEHICLES)
    return own


def full_parameters(name: str) -> FullParameters:
    """Return the parameters of one of `VEHICLES` as the nonlinear vehicle.

    Raises:
        ArgumentError: There is no such vehicle, or not as a nonlinear one.
    """
    if name == "worn":
        raise ArgumentError(
            "vehicle 'worn' has a conicity, which full50 takes from profiles instead; run it as "
            "lateral17, or choose another vehicle"
        )
    own = FullParameters(lateral=vehicle_parameters(name))
    if name == "laden":
        return own.replace(carbody_pitch_inertia=LOAD * own.carbody_pitch_inertia)
    return own


@dataclass(frozen=True)
class Scenario:
    """One scenario.

    Attributes:
        version: Version of the suites that it belongs to, e.g. "v0".
        model: One of `MODELS`.
        vehicle: One of `VEHICLES`.
        layout: "2" or "4" actuators.
        speed_kmh: Running speed [km/h].
        track: A spectrum.
        channel: Delay and how it varies.
        seed: Number of the test track, from 0.

    Raises:
        ArgumentError: A value is none of those that exist.
    """

    version: str
    model: str
    vehicle: str
    layout: str
    speed_kmh: KilometrePerHour
    track: str
    channel: Channel
    seed: int

    def __post_init__(self) -> None:
        if self.model not in MODELS:
            raise unknown_name("model", self.model, MODELS)
        _check_vehicle(self.model, self.vehicle)
        if not self.version or "/" in self.version or not self.version.isprintable():
            raise ArgumentError(f"version = {self.version!r} is no version; give one as v0")
        if parse_layout(self.layout) == "passive":
            raise ArgumentError(
                'layout = "passive" has no actuators; scenarios have layout "2" or "4", on which '
                "the controller passive runs with its dampers in their place"
            )
        check_positive("speed_kmh", self.speed_kmh, "km/h")
        check_count("seed", self.seed, minimum=0)
        _check_track(self.track)

    @staticmethod
    def of(key: str) -> "Scenario":
        """Read a key.

        Raises:
            ArgumentError: It is none.
        """
        parts = key.split("/")
        if len(parts) != 8:
            raise ArgumentError(
                f"cell {key!r} is not understood; a key has eight parts, as "
                "v0/lateral17/nominal/4/300/german_low/constant:100/3"
            )
        version, model, vehicle, layout, speed, track, channel, seed = parts
        if not (seed.isascii() and seed.isdecimal()) or len(seed) > _LONGEST_SEED:
            raise ArgumentError(f"cell {key!r}: the track's number {seed!r} is no whole number")
        kmh = check_text(f"cell {key!r}: speed", speed, "km/h")
        found = Scenario(
            version, model, vehicle, layout, kmh, track, Channel.of(channel), int(seed)
        )
        if found.key != key:
            raise ArgumentError(f"cell {key!r} is written {found.key!r}; write it so")
        return found

    @property
    def key(self) -> str:
        """The name for good."""
        return f"{self.family}/{self.seed}"

    @property
    def family(self) -> str:
        """The key without the seed: scenarios that differ in the track alone."""
        head = f"{self.version}/{self.model}/{self.vehicle}/{self.layout}"
        return f"{head}/{number_text(self.speed_kmh)}/{self.track}/{self.channel.key}"

    @property
    def place(self) -> tuple[str, str, str, float]:
        """What scenarios must share to run side by side: model, vehicle, layout, speed."""
        return self.model, self.vehicle, self.layout, self.speed_kmh

    def made(self, layout: str | None = None) -> Vehicle:
        """Return the vehicle.

        Args:
            layout: Another layout than the scenario's own, e.g. "passive".
        """
        return vehicle_of(self.place, layout)


@cache
def _check_vehicle(model: str, vehicle: str) -> None:
    vehicle_parameters(vehicle)
    if model == "full50":
        full_parameters(vehicle)


@cache
def _check_track(track: str) -> None:
    """Raise unless a track is a spectrum.

    A file is the same for all seeds, and on flat track nothing can be gained.
    """
    if parse_spec(track)[0] not in spectrum_names():
        raise unknown_name("spectrum", track, spectrum_names())
    make_track(track, 1000.0, 0)


def vehicle_of(place: tuple[str, str, str, float], layout: str | None = None) -> Vehicle:
    """Return the vehicle of a place; see `Scenario.place` and `Scenario.made`."""
    model, vehicle, own, speed = place
    if model == "full50":
        return full50(full_parameters(vehicle), layout or own, speed)
    return lateral_of(place, layout)


def lateral_of(place: tuple[str, str, str, float], layout: str | None = None) -> LateralVehicle:
    """Return the linear vehicle with the lateral numbers of a place."""
    _, vehicle, own, speed = place
    return lateral17(vehicle_parameters(vehicle), layout or own, speed)
