"""Cooperrider's bogie: seven coordinates, a published test case of nonlinear hunting.

Two wheelsets (lateral, yaw) and a frame (lateral, yaw, roll) run at constant speed V on straight,
perfect track below a carbody that does not move. Wheels are cones, creep forces saturate after
Vermeulen and Johnson, and a stiff spring behind a clearance stands for each flange. Model: N. K.
Cooperrider, J. Eng. Ind. 94 (1972) 752; numbers: C. Kaas-Petersen, "Chaos in a railway bogie",
Acta Mechanica 61 (1986) 89, called [kp] below. The equations here are our own from Newton's laws:
every spring's and damper's elongation is a linear form e in the coordinates and acts as -e k e.

    creepages        xi_x = a psi' / V + lambda y / r0,    xi_y = y' / V - psi
    reduced creep    u = G pi a_e b_e sqrt((xi_x / phi)^2 + (xi_y / chi)^2) / (mu N)
    its force        F = mu N (u - u^2/3 + u^3/27) for u < 3, else mu N
    shared as        F_x : F_y = xi_x / phi : xi_y / chi
    on a wheelset    -2 F_y - F_flange(y) laterally, -2 a F_x in yaw

Lateral is positive to the left, yaw turns forward into left, roll is the angle that lifts the
left side. Heights are "centre of gravity minus element". Left out: spin creep, gravity's
stiffness, vertical motion.

Creep forces are once differentiable at rest and no more (u^2/3), so that amplitudes leave a Hopf
point in proportion to the speed difference and not to its root.
"""

import dataclasses
from dataclasses import dataclass

import numpy as np

from railenv.errors import (
    ArgumentError,
    check_count,
    check_not_negative,
    check_positive,
    unknown_name,
)
from railenv.units import (
    Dimensionless,
    FloatArray,
    Kilogram,
    KilogramSquareMetre,
    Metre,
    Newton,
    NewtonMetrePerRadian,
    NewtonPerMetre,
    NewtonSecondPerMetre,
)
from railenv.vehicle.cooperrider_rates import BogieNumbers, advance_bogies, bogie_rate

COORDINATES = (
    "wheelset1_lateral",
    "wheelset1_yaw",
    "wheelset2_lateral",
    "wheelset2_yaw",
    "frame_lateral",
    "frame_yaw",
    "frame_roll",
)
_DEGREES = len(COORDINATES)
_MAY_BE_ZERO = frozenset(
    {
        "primary_lateral_stiffness",
        "primary_longitudinal_stiffness",
        "primary_vertical_stiffness",
        "secondary_lateral_stiffness",
        "secondary_vertical_stiffness",
        "secondary_yaw_stiffness",
        "secondary_vertical_damping",
        "secondary_lateral_damping",
        "conicity",
        "creep_stiffness",
        "flange_stiffness",
        "frame_to_primary_height",
        "frame_to_secondary_height",
    }
)


@dataclass(frozen=True, kw_only=True)
class CooperriderParameters:
    """Numbers of the bogie; the defaults are the published ones, symbols of [kp] behind them.

    Where they come from: [a] printed in public input files of the Cooperrider vehicle
    (daniele-bigoni/dytsi, which has 2918.9 kg for the frame); [b] printed by B. Hassard,
    bifurcation.de, from [kp]; [c] recalled from [kp], which we could not read. For [c] speaks
    that the straight run loses its stability at 68.64 m/s here and at 68.66 in the example of
    bifurcation.de. That comparison also decided which creep divisor is longitudinal; exchanged,
    the speed is 65.29 m/s. A Hopf point at 66.61 m/s and a fold at 62.02 m/s are recalled of the
    literature on this bogie; we found them printed nowhere, and these numbers do not give them
    (68.64 and 66.66 m/s here). Springs and dampers are one of a pair, primary ones of two pairs.

    Raises:
        ArgumentError: A value is not finite, or not above zero where it has to be.
    """

    wheelset_mass: Kilogram = 1022.0  # m_w [a]
    frame_mass: Kilogram = 2918.0  # m_f [c]
    wheelset_yaw_inertia: KilogramSquareMetre = 678.0  # I_wy [a]
    frame_yaw_inertia: KilogramSquareMetre = 6780.0  # I_fy [a]
    frame_roll_inertia: KilogramSquareMetre = 6780.0  # I_fr [a]
    primary_lateral_stiffness: NewtonPerMetre = 1.823e6  # k_1 [a]
    primary_longitudinal_stiffness: NewtonPerMetre = 3.646e6  # k_2 [a]
    primary_vertical_stiffness: NewtonPerMetre = 3.646e6  # k_3 [a]
    secondary_lateral_stiffness: NewtonPerMetre = 0.1823e6  # k_4 [a]
    secondary_vertical_stiffness: NewtonPerMetre = 0.3333e6  # k_5 [a]
    secondary_yaw_stiffness: NewtonMetrePerRadian = 2.710e6  # k_6, one per bogie [c]
    secondary_vertical_damping: NewtonSecondPerMetre = 20.0e3  # D_1 [a]
    secondary_lateral_damping: NewtonSecondPerMetre = 29.2e3  # D_2 [a]
    half_contact_spacing: Metre = 0.716  # a [c]
    half_wheelbase: Metre = 1.074  # b [a]
    half_primary_spacing: Metre = 0.620  # d_1 [a]
    half_secondary_spacing: Metre = 0.680  # d_2 [a]
    frame_to_primary_height: Metre = 0.0762  # h_1 [a]
    frame_to_secondary_height: Metre = 0.6584  # h_2, above the centre of gravity [a]
    conicity: Dimensionless = 0.05  # lambda [c]
    wheel_radius: Metre = 0.4572  # r_0 [c]
    creep_stiffness: Newton = 6.563e6  # G pi a_e b_e, per wheel [b]
    creep_divisor_longitudinal: Dimensionless = 0.60252  # phi [c]
    creep_divisor_lateral: Dimensionless = 0.54219  # chi, psi in [kp] [c]
    friction_coefficient: Dimensionless = 0.15  # mu [a]
    wheel_load: Newton = 66670.0  # N [c]
    flange_stiffness: NewtonPerMetre = 14.60e6  # k_0 [c]
    flange_clearance: Metre = 0.0091  # delta [c]

    def __post_init__(self) -> None:
        for field in dataclasses.fields(self):
            check = check_not_negative if field.name in _MAY_BE_ZERO else check_positive
            object.__setattr__(self, field.name, check(field.name, getattr(self, field.name)))

    @property
    def friction_limit(self) -> float:
        """Largest creep force of a wheel, mu N [N]."""
        return self.friction_coefficient * self.wheel_load


class CooperriderBogie:
    """The bogie as a system of first order, many lanes at a time, none of which feels another.

    A state holds the seven `COORDINATES` [m or rad] and then their rates.

    Args:
        parameters: Numbers of the bogie; the published ones unless given.
        output: Name of the coordinate that `advance` records.
        time_step: Longest step of the Runge-Kutta method of fourth order [s]. At 0.5 ms the
            amplitude of the limit cycle at 70 m/s has a relative error below 2e-6.

    Raises:
        ArgumentError: `output` is no coordinate, or `time_step` is not above zero.
    """

    def __init__(
        self,
        parameters: CooperriderParameters | None = None,
        *,
        output: str = "wheelset1_lateral",
        time_step: float = 5e-4,
    ) -> None:
        if output not in COORDINATES:
            raise unknown_name("coordinate of the bogie", output, COORDINATES)
        self.parameters = CooperriderParameters() if parameters is None else parameters
        self.output = output
        self.time_step = check_positive("time_step", time_step, "s")
        self._numbers = _numbers(self.parameters)

    @property
    def state_size(self) -> int:
        """Length of a state, 14."""
        return 2 * _DEGREES

    def rate(self, states: FloatArray, speeds: FloatArray) -> FloatArray:
        """Return the rates of change of all states.

        Args:
            states: Shape (lanes, 14).
            speeds: Running speeds, shape (lanes,) [m/s].

        Returns:
            Shape (lanes, 14).

        Raises:
            ArgumentError: Shapes do not fit, or a speed is not above zero.
        """
        states, speeds = self._checked(states, speeds)
        rates = np.empty_like(states)
        for lane in range(len(states)):
            bogie_rate(self._numbers, states[lane], float(speeds[lane]), rates[lane])
        return rates

    def advance(
        self, states: FloatArray, speeds: FloatArray, durations: FloatArray, samples: int
    ) -> tuple[FloatArray, FloatArray]:
        """Move every lane on by its duration.

        Args:
            states: Shape (lanes, 14); not changed.
            speeds: Shape (lanes,) [m/s].
            durations: Shape (lanes,) [s].
            samples: How many outputs to record, equally spaced, the last one at the end.

        Returns:
            The states at the end, shape (lanes, 14), and the outputs, shape (lanes, samples).

        Raises:
            ArgumentError: Shapes do not fit, or a speed or duration is not above zero.
        """
        states, speeds = self._checked(states, speeds)
        durations = np.asarray(durations, dtype=np.float64)
        if durations.shape != speeds.shape or not np.all(durations > 0.0):
            raise ArgumentError(
                f"durations = {durations!r} does not fit; give one time above zero [s] per lane"
            )
        samples = check_count("samples", samples)
        end = states.copy()
        outputs = np.empty((len(states), samples))
        index = COORDINATES.index(self.output)
        advance_bogies(self._numbers, end, speeds, durations, self.time_step, index, outputs)
        return end, outputs

    def linearisation(self, speed: float) -> FloatArray:
        """Return the system matrix of small motions, shape (14, 14).

        Raises:
            ArgumentError: `speed` [m/s] is not above zero.
        """
        speed = check_positive("speed", speed, "m/s")
        p = self._numbers
        b, h1, h2 = p.half_wheelbase, p.primary_height, p.secondary_height
        # Elongation of each element by unit coordinates, its stiffness and its damping.
        elements: list[tuple[list[float], float, float]] = [
            ([1, 0, 0, 0, -1, -b, -h1], p.primary_lateral, 0.0),
            ([0, 0, 1, 0, -1, b, -h1], p.primary_lateral, 0.0),
            ([0, 1, 0, 0, 0, -1, 0], p.primary_yaw, 0.0),
            ([0, 0, 0, 1, 0, -1, 0], p.primary_yaw, 0.0),
            ([0, 0, 0, 0, 1, 0, -h2], p.secondary_lateral, p.secondary_lateral_damping),
            ([0, 0, 0, 0, 0, 1, 0], p.secondary_yaw, 0.0),
            ([0, 0, 0, 0, 0, 0, 1], p.roll, p.roll_damping),
        ]
        stiffness = np.zeros((_DEGREES, _DEGREES))
        damping = np.zeros((_DEGREES, _DEGREES))
        for direction, k, d in elements:
            e = np.array(direction)
            stiffness += k * np.outer(e, e)
            damping += d * np.outer(e, e)
        a = p.half_contact_spacing
        along = 2 * p.creep_stiffness / p.divisor_longitudinal
        across = 2 * p.creep_stiffness / p.divisor_lateral
        for y, psi in ((0, 1), (2, 3)):
            damping[y, y] += across / speed
            stiffness[y, psi] -= across
            damping[psi, psi] += a * along * a / speed
            stiffness[psi, y] += a * along * p.steer
        wheelset, frame = p[:2], p[2:5]  # masses and inertias, in the order of the coordinates
        mass = np.array([*wheelset, *wheelset, *frame])
        A = np.zeros((2 * _DEGREES, 2 * _DEGREES))
        A[:_DEGREES, _DEGREES:] = np.eye(_DEGREES)
        A[_DEGREES:, :_DEGREES] = -stiffness / mass[:, None]
        A[_DEGREES:, _DEGREES:] = -damping / mass[:, None]
        return A

    def _checked(self, states: FloatArray, speeds: FloatArray) -> tuple[FloatArray, FloatArray]:
        states = np.ascontiguousarray(states, dtype=np.float64)
        speeds = np.ascontiguousarray(speeds, dtype=np.float64)
        if states.ndim != 2 or states.shape[1] != self.state_size:
            raise ArgumentError(
                f"states has the shape {states.shape}; give (lanes, {self.state_size})"
            )
        if speeds.shape != (len(states),) or not np.all(speeds > 0.0):
            raise ArgumentError(
                f"speeds = {speeds!r} does not fit; give one speed above zero [m/s] per lane"
            )
        return states, speeds


def _numbers(p: CooperriderParameters) -> BogieNumbers:
    primary, secondary = p.half_primary_spacing**2, p.half_secondary_spacing**2
    return BogieNumbers(
        wheelset_mass=p.wheelset_mass,
        wheelset_yaw_inertia=p.wheelset_yaw_inertia,
        frame_mass=p.frame_mass,
        frame_yaw_inertia=p.frame_yaw_inertia,
        frame_roll_inertia=p.frame_roll_inertia,
        primary_lateral=2 * p.primary_lateral_stiffness,
        primary_yaw=2 * p.primary_longitudinal_stiffness * primary,
        secondary_lateral=2 * p.secondary_lateral_stiffness,
        secondary_lateral_damping=2 * p.secondary_lateral_damping,
        secondary_yaw=p.secondary_yaw_stiffness,
        roll=2 * (p.secondary_vertical_stiffness * secondary)
        + 4 * p.primary_vertical_stiffness * primary,
        roll_damping=2 * p.secondary_vertical_damping * secondary,
        half_contact_spacing=p.half_contact_spacing,
        half_wheelbase=p.half_wheelbase,
        primary_height=p.frame_to_primary_height,
        secondary_height=p.frame_to_secondary_height,
        steer=p.conicity / p.wheel_radius,
        creep_stiffness=p.creep_stiffness,
        divisor_longitudinal=p.creep_divisor_longitudinal,
        divisor_lateral=p.creep_divisor_lateral,
        friction_limit=p.friction_limit,
        flange_stiffness=p.flange_stiffness,
        flange_clearance=p.flange_clearance,
    )
