"""H-infinity control of sway and yaw: the worst amplification of track and noise is made small.

What counts, and its weights, are in `baselines.hinfinity_plant`: Sperling-weighted floor
acceleration and force out of track and sensor noise, with the delay as Pade's approximation. Of the
controllers that keep the largest singular value of that closed loop below a level gamma at every
frequency, the central one is taken (Doyle, Glover, Khargonekar and Francis, IEEE Trans. Automatic
Control 34, 1989, 831-847, theorem 3). With X and Y the stabilising solutions of

    A'X + X A - X (B2 B2' - B1 B1'/gamma^2) X + C1'C1 = 0
    A Y + Y A' - Y (C2'C2 - C1'C1/gamma^2) Y + B1 B1' = 0

both positive semidefinite and rho(X Y) < gamma^2, it is

    F = -B2'X,  L = -Y C2',  Z = (I - Y X/gamma^2)^-1
    xc' = (A + B1 B1' X/gamma^2 + B2 F + Z L C2) xc - Z L y,   u = F xc.

gamma is `slack` times the smallest level, found by bisection.

Loop shaping (`baselines.hinfinity_shaping`) shapes the loop from force to velocity, and rides as a
good sky-hook does. What brings comfort lies between track and floor, above 2 Hz, and is in no shape
of that loop; so it is the problem from track to floor that is solved here.

The plant is reduced first, so that the law has at most `STATES` states, and the loop with the whole
plant is checked afterwards. With two or three times the weight of force, or of noise, the law grows
gentler, and worse at its own delay. A law for one delay is not made for others: that for 0.1 s is
stable up to 0.54 s, and worse than sky-hook 15 kN s/m at 0 and from 0.15 to 0.25 s.
"""

from dataclasses import dataclass

import numpy as np
from scipy import linalg

from baselines.hinfinity_plant import Design, GeneralisedPlant, balanced, generalised_plant
from baselines.linear_dynamic import LinearDynamic
from baselines.registered import OF_THE_RUN, Registered, designed_for
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import ArgumentError, check_finite
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.stability.loops import LinearSystem
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle

STATES = 40
"""Most states of the law; with 40 the loops with the whole and with the reduced plant have the same
norm to 0.1 %, with 32 to 1.5 %."""

DELAY, FORCE_WEIGHT, NOISE, SLACK = 0.1, 1e-4, 3e-3, 1.1

# A Riccati equation without stabilising solution is answered with a residual of 1e-4, one with a
# solution with 1e-12: roots of its Hamiltonian on the imaginary axis are split at random.
_SOLVED = 1e-8
_NOT_NEGATIVE = 1e-8
_LEVELS = (1e-6, 1e6)
_BISECTION = 1e-3


@dataclass(frozen=True, eq=False)
class CentralController:
    """xc' = A xc + B y, u = C xc, in the scaled quantities of the plant.

    Attributes:
        level: gamma, which the largest singular value of the closed loop stays below.
        A: Shape (n, n).
        B: Shape (n, readings).
        C: Shape (2, n).
        residuals: Relative residuals of the two Riccati equations.
    """

    level: float
    A: FloatArray
    B: FloatArray
    C: FloatArray
    residuals: tuple[float, float]

    def around(self, plant: GeneralisedPlant) -> LinearSystem:
        """Close the loop: (track noise, sensor noise) to (floor accelerations, command)."""
        n, k, p = len(plant.A), len(self.A), plant.C2.shape[0]
        A = np.block([[plant.A, plant.B2 @ self.C], [self.B @ plant.C2, self.A]])
        B = np.block([[plant.B1, np.zeros((n, p))], [np.zeros((k, plant.B1.shape[1])), self.B]])
        C = np.block([[plant.C1, np.zeros((len(plant.C1), k))], [np.zeros((2, n)), self.C]])
        return LinearSystem(A, B, C, np.zeros((C.shape[0], B.shape[1])))


def central_controller(plant: GeneralisedPlant, level: float) -> CentralController | None:
    """Return the central controller of a level, or None if no controller reaches it.

    Args:
        plant: The problem.
        level: gamma, above zero.
    """
    first = _stabilising(plant.A, plant.B1, plant.B2, plant.C1, level)
    if first is None:
        return None
    second = _stabilising(plant.A.T, plant.C1.T, plant.C2.T, plant.B1.T, level)
    if second is None:
        return None
    (X, left), (Y, right) = first, second
    if float(np.abs(linalg.eigvals(X @ Y)).max()) >= level**2:
        return None
    F, L = -plant.B2.T @ X, -Y @ plant.C2.T
    ZL = linalg.solve(np.eye(len(X)) - Y @ X / level**2, L)
    A = plant.A + plant.B1 @ (plant.B1.T @ X) / level**2 + plant.B2 @ F + ZL @ plant.C2
    return CentralController(level, A, -ZL, F, (left, right))


def smallest_level(plant: GeneralisedPlant) -> float:
    """Return the smallest level that a controller reaches, from above and to 0.1 %.

    Raises:
        ArgumentError: None up to 1e6 can be found.
    """
    low, high = _LEVELS
    if central_controller(plant, high) is None:
        raise ArgumentError(
            "no controller is found for any level: the Riccati equations have no stabilising "
            "solution; give another force_weight or noise"
        )
    while high / low > 1.0 + _BISECTION:
        level = float(np.sqrt(low * high))
        if central_controller(plant, level) is None:
            low = level
        else:
            high = level
    return high


class HInfinity(LinearDynamic):
    """H-infinity law for sway and yaw, from carbody velocities and strokes.

    Args:
        vehicle: What it is designed for, with two or four actuators.
        delay: Delay it is designed for [s], zero or more.
        force_weight: Weighted acceleration that a newton per actuator is worth [m/s^2/N].
        noise: Density of the velocity readings' noise [m/s/sqrt(Hz)]; strokes have 0.3 s times it.
        slack: Level over the smallest one, above 1.
        action_scale: Force of an action of one [N].
        control_period: Time between actions [s].

    Attributes:
        design: The problem, with its whole plant.
        central: The controller in scaled quantities.
        smallest: The smallest level of the reduced plant.
        reduction: Bound on the error of the reduced plant, see `hinfinity_plant.balanced`.

    Raises:
        ArgumentError: A value is out of its range, or the law does not stabilise the whole plant.
    """

    def __init__(
        self,
        vehicle: LateralVehicle,
        delay: float = DELAY,
        force_weight: float = FORCE_WEIGHT,
        noise: float = NOISE,
        slack: float = SLACK,
        action_scale: float = DEFAULT_ACTION_SCALE,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        share = check_finite("slack", slack)
        if share <= 1.0:
            raise ArgumentError(f"slack = {share:g} must be above 1; 1.1 is close to the optimum")
        self.design: Design = generalised_plant(vehicle, delay, force_weight, noise)
        reduced, self.reduction = balanced(self.design.plant, STATES)
        self.smallest = smallest_level(reduced)
        central = central_controller(reduced, share * self.smallest)
        if central is None:
            raise ArgumentError(f"slack = {share:g} gives no controller; give a larger one")
        growth = float(linalg.eigvals(central.around(self.design.plant).A).real.max())
        if growth >= 0.0:
            raise ArgumentError(
                f"the H-infinity law does not stabilise the whole plant (growth {growth:.2g} 1/s); "
                "give a larger force_weight or slack"
            )
        self.central: CentralController = central
        signals = self.design.signals
        # Out of scaled quantities, and u = -law(y).
        super().__init__(
            (
                central.A,
                central.B / self.design.noise @ signals.readings,
                -signals.forces @ central.C / self.design.force_weight,
                np.zeros((len(signals.forces), len(signals.sensors))),
            ),
            signals.sensors,
            vehicle.layout,
            action_scale,
            control_period,
        )


def _stabilising(
    A: FloatArray, B1: FloatArray, B2: FloatArray, C1: FloatArray, level: float
) -> tuple[FloatArray, float] | None:
    """Solve A'X + X A - X (B2 B2' - B1 B1'/gamma^2) X + C1'C1 = 0, with its relative residual."""
    ones = np.concatenate([-(level**2) * np.ones(B1.shape[1]), np.ones(B2.shape[1])])
    constant = C1.T @ C1
    try:
        X = linalg.solve_continuous_are(A, np.hstack([B1, B2]), constant, np.diag(ones))
    except ValueError:  # no ordering of the pencil's roots; LinAlgError is one of these
        return None
    linear = A.T @ X + X @ A
    rest = linear - X @ (B2 @ B2.T - B1 @ B1.T / level**2) @ X + constant
    residual = float(linalg.norm(rest) / linalg.norm(linear))
    sizes = linalg.eigvalsh(X)
    if residual > _SOLVED or sizes[0] < -_NOT_NEGATIVE * sizes[-1]:
        return None
    return np.asarray(X, dtype=np.float64), residual


HINFINITY = Registered(
    "hinf",
    "H-infinity: floor acceleration and force against track and noise, for a known delay",
    "Doyle, Glover, Khargonekar, Francis 1989",
    {
        "delay": (DELAY, "s"),
        "force_weight": (FORCE_WEIGHT, "m/s^2/N"),
        "noise": (NOISE, "m/s/sqrt(Hz)"),
        "slack": (SLACK, "1"),
        "design_kmh": (OF_THE_RUN, "km/h"),
    },
    lambda vehicle, delay, force_weight, noise, slack, design_kmh: HInfinity(
        designed_for(vehicle, design_kmh), delay, force_weight, noise, slack
    ),
)
