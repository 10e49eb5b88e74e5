"""Random vehicles: parameters drawn from ranges, each draw a vehicle that runs straight by itself.

A controller that is trained or tested on one vehicle knows that vehicle. `draw_vehicles` draws
others around it: passengers, springs, dampers, wheel profiles, friction and speed.

Every drawn vehicle must be sound: with all its lateral dampers and no actuator (layout "passive")
it is stable, each root with a damping ratio above 0.005 (`LEAST_DAMPING`). Otherwise it is
the plant that hunts, and no ride number of any controller means anything. What limits the ranges is
bogie hunting: of the parameters here creep, conicity, yaw dampers, primary stiffness and speed
decide on it, the others hardly. The layouts with actuators are not asked: what they are without
control is what they are.

Measured on both catalogued vehicles: over the 1024 corners of "wide" the least damping ratio is
0.025 (hunting at 3.9 Hz, in the corner of the highest speed, conicity and primary stiffness and the
least creep and yaw damping) and the linear critical speed 335 km/h; in 2000 draws the ratio is
0.042 or more. Over the corners of "narrow" the ratio is 0.053 at 300 km/h and 0.015 at 350 km/h,
the critical speed 370 km/h.

Not modelled: a change of the centre of gravity's height with load, creep coefficients that follow
the axle load (their factor is a range of its own), and differences between the bogies or the
elements of one vehicle.

Sources of the named ranges, cited by the words in brackets:

[chen] Chen, Shi, Yu, J. Vib. Control, doi 10.1177/10775463261463161, Appendix 2: the base.
[published sets] Math. Probl. Eng. 2019, 7163732, Table 2; Shock Vib. 2020, 6878252, Table 2;
    CRH380A sets of public multibody models; Velaro E (Goicolea, UPM): they differ by more than 20 %
    in stiffness and by a factor of two in damping.
[profiles] Rigid-contact integration after EN 15302 at 1435 mm gauge, amplitudes of 2 to 5 mm: 0.10
    for LMB10 on CN60, 0.22 to 0.15 for S1002 moved by 3 mm (as S1002CN) on CN60.
[hertz-kalker] Spread of Kalker's coefficients over contact ellipses from a cone to a worn wheel:
    f_22 from 0.87e7 to 1.17e7 N, f_11 from 0.88e7 to 1.45e7 N.
[assumed] Chosen by this project.
[hunting] Cut short because the corners of the box would hunt at its highest speed.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any

import numpy as np

from railenv.errors import ArgumentError, check_count, check_positive, unknown_name
from railenv.units import FloatArray, from_kmh
from railenv.vehicle.coordinates import parse_layout
from railenv.vehicle.linear import LateralVehicle
from railenv.vehicle.parameters import VehicleParameters
from railenv.vehicle.statespace import state_space

Range = tuple[float, float]
"""Lowest and highest value, both included."""

LEAST_DAMPING = 0.005
"""Least damping ratio, -Re(s) / |s|, of a drawn vehicle without control [1]. With it, hunting at
4 Hz is at a fortieth after 30 s. A ratio, not a rate: at walking pace all of hunting is slow. The
base vehicles' least ratio at 200 to 300 km/h is 0.057; at 1 km/h, where creep nearly locks the
wheels on the rails, it is 0.006."""

_SCALED: Mapping[str, tuple[str, ...]] = MappingProxyType(
    {
        "load": ("carbody_mass", "carbody_yaw_inertia", "carbody_roll_inertia"),
        "primary_stiffness": (
            "primary_longitudinal_stiffness",
            "primary_lateral_stiffness",
            "primary_vertical_stiffness",
        ),
        "primary_damping": ("primary_lateral_damping", "primary_vertical_damping"),
        "secondary_stiffness": (
            "secondary_longitudinal_stiffness",
            "secondary_lateral_stiffness",
            "secondary_vertical_stiffness",
            "antiroll_stiffness",
        ),
        "secondary_damping": ("secondary_lateral_damping", "secondary_vertical_damping"),
        "yaw_damper": ("yaw_damper_stiffness", "yaw_damper_damping"),
        "lateral_damper": ("lateral_damper_stiffness", "lateral_damper_damping"),
        "creep": ("creep_longitudinal", "creep_lateral", "creep_lateral_spin", "creep_spin"),
    }
)
"""The parameters that a factor multiplies."""


def _checked(name: str, given: Any) -> Range:
    try:
        first, second = given
    except (TypeError, ValueError):
        raise ArgumentError(f"{name} = {given!r} is not a range; give a pair (low, high)") from None
    low, high = check_positive(f"{name}[0]", first), check_positive(f"{name}[1]", second)
    if low > high:
        raise ArgumentError(f"{name} = ({low:g}, {high:g}) falls; give the lower value first")
    return low, high


@dataclass(frozen=True, kw_only=True)
class VehicleRanges:
    """Ranges from which vehicles are drawn; each a (low, high) pair, both included.

    All but `conicity` and `speed_kmh` are factors on the base vehicle [1].

    Attributes:
        load: Passengers: carbody mass and, with the radii of gyration kept (people spread over the
            floor as the carbody is), its yaw and roll inertia. The axle load follows.
        primary_stiffness: Springs between axle box and bogie frame, all three directions.
        primary_damping: Dashpots there, lateral and vertical.
        secondary_stiffness: Springs between bogie frame and carbody, all three directions, and the
            anti-roll bars.
        secondary_damping: Dashpots there, lateral and vertical, without the lateral dampers.
        yaw_damper: Damping and series stiffness of the yaw dampers; their relaxation time stays.
        lateral_damper: The same of the lateral dampers, where the layout has any.
        conicity: Equivalent conicity itself [1]; None keeps the base's.
        creep: All four creep coefficients.
        speed_kmh: Running speed [km/h]; None keeps the speed that is given.

    Raises:
        ArgumentError: A range is not two finite numbers above zero in rising order.
    """

    load: Range = (1.0, 1.0)
    primary_stiffness: Range = (1.0, 1.0)
    primary_damping: Range = (1.0, 1.0)
    secondary_stiffness: Range = (1.0, 1.0)
    secondary_damping: Range = (1.0, 1.0)
    yaw_damper: Range = (1.0, 1.0)
    lateral_damper: Range = (1.0, 1.0)
    conicity: Range | None = None
    creep: Range = (1.0, 1.0)
    speed_kmh: Range | None = None

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            given = getattr(self, field.name)
            if given is not None or field.default is not None:
                object.__setattr__(self, field.name, _checked(field.name, given))

    @property
    def single(self) -> bool:
        """Whether the ranges hold one vehicle only, each a point or None."""
        ranges = (getattr(self, field.name) for field in dataclasses.fields(self))
        return all(r is None or r[0] == r[1] for r in ranges)


NAMED_RANGES: Mapping[str, VehicleRanges] = MappingProxyType(
    {
        # One vehicle: the base.
        "none": VehicleRanges(),
        # A vehicle of the same type in good repair, at any speed: scatter of making and measuring.
        "narrow": VehicleRanges(
            load=(1.0, 1.05),  # 2 t of passengers on 40 t [assumed]
            primary_stiffness=(0.95, 1.05),  # scatter of making [assumed]
            primary_damping=(0.95, 1.05),
            secondary_stiffness=(0.95, 1.05),
            secondary_damping=(0.95, 1.05),
            yaw_damper=(0.95, 1.05),
            lateral_damper=(0.95, 1.05),
            conicity=(0.16, 0.18),  # around the 0.17 of [chen]
            creep=(0.95, 1.05),  # well inside [hertz-kalker]
        ),
        # The types and states of repair that one controller may have to serve.
        "wide": VehicleRanges(
            load=(1.0, 1.25),  # empty to 10 t of passengers on 40 t [assumed]
            primary_stiffness=(0.9, 1.1),  # [published sets] spread more; [hunting]
            primary_damping=(0.7, 1.3),  # inside [published sets]
            secondary_stiffness=(0.8, 1.2),  # inside [published sets]
            secondary_damping=(0.7, 1.3),  # inside [published sets]
            yaw_damper=(0.9, 1.1),  # wear and temperature [assumed]; [hunting]
            lateral_damper=(0.7, 1.3),  # wear and temperature [assumed]
            conicity=(0.10, 0.20),  # [profiles]; more than 0.20 needs less speed [hunting]
            creep=(0.9, 1.1),  # most of f_22 of [hertz-kalker]; [hunting]
            speed_kmh=(200.0, 300.0),  # high-speed operation up to the speed of [chen]; [hunting]
        ),
    }
)
"""Ranges by name; see `get_ranges`."""


def get_ranges(name: str) -> VehicleRanges:
    """Return named ranges: "none", "narrow" or "wide".

    Raises:
        ArgumentError: No ranges have that name.
    """
    if name not in NAMED_RANGES:
        raise unknown_name("vehicle ranges", name, NAMED_RANGES)
    return NAMED_RANGES[name]


def draw_vehicles(
    base: VehicleParameters,
    layout: object,
    speed_kmh: float,
    ranges: VehicleRanges,
    number: int,
    seed: int,
) -> list[LateralVehicle]:
    """Draw vehicles, uniformly and independently in each range.

    Vehicle k depends on the seed and k alone: the first 16 of 64 are the 16 of 16. A range that is
    changed does not change what is drawn for the others.

    Args:
        base: The vehicle that the factors multiply.
        layout: "passive", 2 or 4, for all of them.
        speed_kmh: Speed of all vehicles if the ranges hold none [km/h].
        ranges: Where to draw from.
        number: How many, at least one.
        seed: Of the random numbers, zero or more.

    Returns:
        The vehicles; a single one, whatever `number` is, if the ranges hold no other.

    Raises:
        ArgumentError: An argument breaks one of the rules above, or the passive form of a vehicle
            drawn is not stable with the margin of `LEAST_DAMPING`; the message names its point.
    """
    form = parse_layout(layout)
    speed = check_positive("speed_kmh", speed_kmh, "km/h")
    count = check_count("number", number)
    root = check_count("seed", seed, minimum=0)
    vehicles: list[LateralVehicle] = []
    for k in range(1 if ranges.single else count):
        stream = np.random.SeedSequence(root, spawn_key=(k,))
        shares = np.random.Generator(np.random.PCG64(stream)).random(
            len(dataclasses.fields(ranges))
        )
        point = _point(ranges, shares)
        parameters = _parameters(base, point)
        passive = LateralVehicle(parameters, "passive", from_kmh(point.get("speed_kmh", speed)))
        _check_sound(passive, k, point)
        vehicles.append(LateralVehicle(parameters, form, passive.speed))
    return vehicles


def _point(ranges: VehicleRanges, shares: FloatArray) -> dict[str, float]:
    """Value of each range at a share of it, from 0 (low) to 1 (high); no entry for None."""
    point: dict[str, float] = {}
    for field, share in zip(dataclasses.fields(ranges), shares, strict=True):
        ends: Range | None = getattr(ranges, field.name)
        if ends is not None:
            point[field.name] = ends[0] + float(share) * (ends[1] - ends[0])
    return point


def _parameters(base: VehicleParameters, point: Mapping[str, float]) -> VehicleParameters:
    changes = {
        name: point[factor] * getattr(base, name)
        for factor, names in _SCALED.items()
        for name in names
    }
    if "conicity" in point:
        changes["conicity"] = point["conicity"]
    return base.replace(**changes)


def _check_sound(passive: LateralVehicle, k: int, point: Mapping[str, float]) -> None:
    roots = np.linalg.eigvals(state_space(passive).A)
    # Not as a quotient: a vehicle with conicity 0 is free to drift and has a double root at zero.
    excess = roots.real + LEAST_DAMPING * np.abs(roots)
    worst = complex(roots[np.argmax(excess)])
    if excess.max() >= 0.0:
        shown = {**point, "conicity": passive.parameters.conicity, "speed_kmh": 3.6 * passive.speed}
        listed = ", ".join(f"{name} {value:.4g}" for name, value in shown.items())
        raise ArgumentError(
            f"vehicle {k} of the draw ({listed}) hunts or drifts without control: it has a root at "
            f"{worst.real:.3g} {abs(worst.imag):+.3g}i 1/s and must be stable with damping ratios "
            f"above {LEAST_DAMPING:g}: narrow the ranges towards more creep, less conicity (above "
            "0), stronger yaw dampers or less speed"
        )
