"""The nonlinear vehicle put together: elements, contact, and arrays for compiled equations."""

import dataclasses
from dataclasses import dataclass
from functools import cached_property, lru_cache

import numpy as np

from railenv.contact.creep_laws import CREEP_LAWS, make_creep_table
from railenv.contact.creep_table import CreepTable
from railenv.contact.geometry import WheelRail
from railenv.contact.hertz import SHEAR_MODULUS
from railenv.contact.profiles import get_profile, profile_names
from railenv.contact.table import ContactArrays, contact_arrays
from railenv.errors import check_not_negative, check_positive, unknown_name
from railenv.units import Dimensionless, FloatArray, Metre, MetrePerSecond
from railenv.vehicle.coordinates import WHEELSETS, Layout, actuator_positions
from railenv.vehicle.nonlinear.coordinates import (
    COORDINATES,
    NUM_COORDINATES,
    coordinate_index,
)
from railenv.vehicle.nonlinear.elements import (
    Damper,
    actuator_rows,
    dampers,
    geometric_stiffness,
    linear_elements,
    stops,
)
from railenv.vehicle.nonlinear.parameters import FullParameters
from railenv.vehicle.nonlinear.rates import GIVEN, FrameArrays, FullArrays

_KINDS = ("wheel", "rail")

LAWS = (*CREEP_LAWS, "given")
"""Creep laws by name; "given" is linear with the coefficients of the lateral parameters."""


@dataclass(frozen=True, kw_only=True)
class ContactSettings:
    """Wheel on rail.

    Attributes:
        wheel: Profile of the wheels, by name; see `railenv.contact.profiles`. The source paper's
            wheel is taken as S1002 for a back-to-back distance of 1353 mm.
        rail: Profile of the rails, by name.
        back_to_back: Distance between the wheels' backs.
        gauge: Of the track, `gauge_depth` below the top.
        gauge_depth: Where the gauge is taken.
        cant: Slope of the rails' inward tilt.
        rail_lateral: Distance of a rail's axis of symmetry from the track's centre; None for where
            the gauge puts it. For profiles that have no gauge face, such as round heads.
        friction: Coefficient of friction between wheel and rail; 0 for none.
        law: "fastsim-table", "fastsim", "polach", "shen-hedrick-elkins", "linear" (Kalker's
            coefficients, no limit) or "given" (the lateral parameters' coefficients, no limit).
        polach_adhesion: k_A of Polach's law.
        polach_slip: k_S of Polach's law.
        damping: Damping of the normal force, N (1 + damping p') [s/m]; about 5 % of critical.

    Raises:
        ArgumentError: A name or value is not allowed.
    """

    wheel: str = "s1002cn"
    rail: str = "cn60"
    back_to_back: Metre = 1.353
    gauge: Metre = 1.435
    gauge_depth: Metre = 0.016
    cant: Dimensionless = 1.0 / 40.0
    rail_lateral: Metre | None = None
    friction: Dimensionless = 0.3
    law: str = "fastsim-table"
    polach_adhesion: Dimensionless = 1.0
    polach_slip: Dimensionless = 0.4
    damping: float = 1.5

    def __post_init__(self) -> None:
        every = {each.partition(":")[0] for kind in _KINDS for each in profile_names(kind)}
        for kind in _KINDS:
            given = getattr(self, kind)
            if given.partition(":")[0] not in every:
                raise unknown_name(f"{kind} profile", given[:60], profile_names(kind))
        if self.law not in LAWS:
            raise unknown_name("creep law", self.law, LAWS)
        check_not_negative("friction", self.friction)
        check_not_negative("damping", self.damping, "s/m")
        for name in ("polach_adhesion", "polach_slip"):
            check_positive(name, getattr(self, name))


@dataclass(frozen=True)
class FullVehicle:
    """The 50-coordinate vehicle at a speed.

    Attributes:
        parameters: Its numbers.
        layout: "passive", "2" or "4": which lateral dampers are actuators.
        speed: Running speed.
        contact: Wheel on rail.
        gravity_coupling: Whether the springs' preloads act on displaced and tilted bodies (pendulum
            term and its kin), which the 17-coordinate model leaves out.
        roll_coupling: Whether a wheelset's roll is felt: by its contact points (they move
            sideways), by the springs above it and by the gyroscopic moments. The 17-coordinate
            model leaves it out.
        blow_off: Whether dampers soften beyond their break; without, they are linear.
        actuator_lag: Time constant between command and force [s]; 0 for none.

    Raises:
        ArgumentError: The speed is not above zero.
    """

    parameters: FullParameters
    layout: Layout
    speed: MetrePerSecond
    contact: ContactSettings = ContactSettings()
    gravity_coupling: bool = True
    roll_coupling: bool = True
    blow_off: bool = True
    actuator_lag: float = 0.0

    def __post_init__(self) -> None:
        check_positive("speed", self.speed, "m/s")
        check_not_negative("actuator_lag", self.actuator_lag, "s")

    @property
    def num_actuators(self) -> int:
        """Number of actuator channels."""
        return len(actuator_positions(self.layout))

    @cached_property
    def dampers(self) -> tuple[Damper, ...]:
        """All dampers, those with a spring in series last."""
        found = dampers(self.parameters, self.layout)
        return tuple(dataclasses.replace(damper, row=self._felt(damper.row)) for damper in found)

    def _felt(self, row: FloatArray) -> FloatArray:
        """A row without the wheelsets' roll where that is left out."""
        if self.roll_coupling:
            return row
        felt = row.copy()
        felt[[coordinate_index(f"wheelset{i}_roll") for i in WHEELSETS]] = 0.0
        return felt

    @property
    def nodes(self) -> tuple[Damper, ...]:
        """Dampers with a spring in series; each has a node in the state."""
        return tuple(damper for damper in self.dampers if damper.stiffness > 0.0)

    @property
    def wheelset_setback(self) -> tuple[float, float, float, float]:
        """Distance of every wheelset behind the leading one [m]."""
        p = self.parameters.lateral
        base, spacing = 2.0 * p.half_wheelbase, 2.0 * p.half_bogie_spacing
        return 0.0, base, spacing, spacing + base

    @property
    def num_states(self) -> int:
        """Length of the state."""
        lagged = self.num_actuators if self.actuator_lag > 0.0 else 0
        return 2 * NUM_COORDINATES + len(self.nodes) + lagged

    @property
    def states(self) -> tuple[str, ...]:
        """Name of every state."""
        lagged = actuator_positions(self.layout) if self.actuator_lag > 0.0 else ()
        return (
            *COORDINATES,
            *(f"{name}_velocity" for name in COORDINATES),
            *(f"{damper.name}_node" for damper in self.nodes),
            *(f"actuator_force_{position}" for position in lagged),
        )

    @cached_property
    def stiffness(self) -> FloatArray:
        """K of springs, and of preloads where these are coupled, shape (50, 50)."""
        total = np.zeros((NUM_COORDINATES, NUM_COORDINATES))
        for element in linear_elements(self.parameters):
            row = self._felt(element.row)
            total += element.stiffness * np.outer(row, row)
        if self.gravity_coupling:
            total += geometric_stiffness(self.parameters)
        return _without_rounding(total)

    @cached_property
    def damping(self) -> FloatArray:
        """C of dashpots beside springs; dampers of their own are not in it, shape (50, 50)."""
        total = np.zeros((NUM_COORDINATES, NUM_COORDINATES))
        for element in linear_elements(self.parameters):
            row = self._felt(element.row)
            total += element.damping * np.outer(row, row)
        for row in actuator_rows(self.parameters, self.layout):
            total += self.parameters.actuator_residue * np.outer(row, row)
        return _without_rounding(total)

    @property
    def wheel_rail(self) -> WheelRail:
        """Profiles and how they stand to each other."""
        return _wheel_rail(self.contact, self.parameters.lateral.wheel_radius)

    @cached_property
    def contact_arrays(self) -> ContactArrays:
        """Contact of the right wheel by table."""
        # Whatever does not change the geometry must not make another table.
        plain = ContactSettings()
        alike = dataclasses.replace(
            self.contact,
            friction=plain.friction,
            law=plain.law,
            polach_adhesion=plain.polach_adhesion,
            polach_slip=plain.polach_slip,
            damping=plain.damping,
        )
        return _table(alike, self.parameters.lateral.wheel_radius)

    @cached_property
    def creep_arrays(self) -> CreepTable:
        """What the creep law needs besides the patch."""
        c = self.contact
        law = "linear" if c.law == "given" else c.law
        return make_creep_table(
            law, adhesion_reduction=c.polach_adhesion, slip_reduction=c.polach_slip
        )

    @cached_property
    def arrays(self) -> FullArrays:
        """What the compiled equations read."""
        p = self.parameters
        K, C = self.stiffness, self.damping
        filled = (K != 0.0) | (C != 0.0)
        own = [*(d.row for d in self.dampers), *(stop.row for stop in stops(p))]
        rows = np.array([*own, *actuator_rows(p, self.layout)])
        load = np.zeros(NUM_COORDINATES)
        for wheelset in range(1, 5):
            load[coordinate_index(f"wheelset{wheelset}_vertical")] = p.lateral.axle_load
        given = (
            p.lateral.creep_longitudinal,
            p.lateral.creep_lateral,
            p.lateral.creep_lateral_spin,
            p.lateral.creep_spin,
        )
        c = self.contact
        nodes = len(self.nodes)
        return FullArrays(
            mass=p.masses,
            load=load,
            start=np.concatenate([[0], np.cumsum(filled.sum(axis=1))]).astype(np.int64),
            column=np.nonzero(filled)[1].astype(np.int64),
            stiffness=K[filled],
            damping=C[filled],
            row_start=np.concatenate([[0], np.cumsum((rows != 0.0).sum(axis=1))]).astype(np.int64),
            row_column=np.nonzero(rows)[1].astype(np.int64),
            row_value=rows[rows != 0.0],
            damper=np.array([self._damper(d) for d in self.dampers]).reshape(-1, 5),
            stop=np.array(p.bump_stop),
            counts=np.array([len(self.dampers) - nodes, nodes, len(stops(p)), self.num_actuators]),
            scalars=np.array(
                [
                    self.speed,
                    p.lateral.wheel_radius,
                    p.wheelset_pitch_inertia,
                    c.damping,
                    c.friction,
                    SHEAR_MODULUS,
                    self.actuator_lag,
                    *given,
                    float(self.roll_coupling),
                ]
            ),
            law=GIVEN if c.law == "given" else CREEP_LAWS[c.law],
        )

    def _damper(self, damper: Damper) -> tuple[float, float, float, float, float]:
        d = damper
        if not self.blow_off:
            return d.damping, np.inf, np.inf, d.damping, d.stiffness
        return d.damping, d.break_force, d.break_force / d.damping, d.beyond, d.stiffness

    def replace(self, **changes: object) -> "FullVehicle":
        """Return a copy with some fields changed."""
        names = {field.name for field in dataclasses.fields(self)}
        for name in changes:
            if name not in names:
                raise unknown_name("vehicle setting", name, names)
        return dataclasses.replace(self, **changes)  # type: ignore[arg-type]


def _without_rounding(matrix: FloatArray) -> FloatArray:
    """Return a matrix whose entries that cancel are zero, not rounding.

    So vehicles of one structure have the same entries, whatever their numbers.
    """
    size = np.sqrt(np.abs(np.diag(matrix)))
    return np.where(np.abs(matrix) <= 1e-13 * np.outer(size, size), 0.0, matrix)


def _wheel_rail(contact: ContactSettings, wheel_radius: float) -> WheelRail:
    c = contact
    return WheelRail(
        wheel=get_profile(c.wheel),
        rail=get_profile(c.rail),
        wheel_radius=wheel_radius,
        back_to_back=c.back_to_back,
        gauge=c.gauge,
        gauge_depth=c.gauge_depth,
        cant=c.cant,
        rail_lateral=c.rail_lateral,
    )


@lru_cache(maxsize=8)
def _table(contact: ContactSettings, wheel_radius: float) -> ContactArrays:
    """The vehicles of a pool share one table, which takes longer to make than the rest of them."""
    return contact_arrays(_wheel_rail(contact, wheel_radius))


def straight() -> FrameArrays:
    """Return the frame of straight track."""
    none = np.zeros(0)
    return FrameArrays(none, none, none, none)
