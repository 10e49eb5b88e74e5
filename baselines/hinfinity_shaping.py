"""H-infinity loop shaping of sway and yaw: a shape for the loop, and the most robust law for it.

The plant G from modal force to modal carbody velocity (`baselines.modal_signals`), its delay as
Pade's approximation, is shaped as sky-hook damping would, with band limits,

    W(s) = gain * s / (s + w_high) * w_low / (s + w_low)        in sway and in yaw.

With G W = M^-1 N, normalised coprime factors, the law K of the least gamma in

    || [K; I] (I - G W K)^-1 M^-1 || <= gamma

stands every perturbation of N and M smaller than 1/gamma. The least gamma has a closed form, with
X and Z the solutions of the shaped plant's Riccati equations of control and filtering,

    gamma_min = sqrt(1 + rho(X Z))
    K: xc' = (A + B F + gamma^2 L'^-1 Z C'C) xc + gamma^2 L'^-1 Z C' y,   u = B'X xc
    F = -B'X,  L = (1 - gamma^2) I + X Z

(McFarlane and Glover, Robust Controller Design Using Normalized Coprime Factor Plant Descriptions,
1990, for a strictly proper plant). gamma below 4 counts as a shape that can be had.

The ride is that of the best sky-hook gain; the critical delay is longer, for the law knows of the
delay. What brings comfort lies between track and floor, and not in the shape of this loop: see
`baselines.hinfinity`.
"""

import math

import numpy as np
from scipy import linalg

from baselines.hinfinity_plant import GeneralisedPlant, balanced, check_padeable, delayed
from baselines.linear_dynamic import LinearDynamic
from baselines.modal_signals import modal_signals
from baselines.registered import OF_THE_RUN, Registered, designed_for
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.errors import ArgumentError, check_finite, check_positive
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.stability.loops import LinearSystem
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, state_space

STATES = 24
"""Most states of the shaped plant; with 32 the least gamma differs by 0.3 % at most."""

DELAY, GAIN, HIGHPASS_HZ, LOWPASS_HZ, SLACK = 0.1, 20e3, 0.3, 5.0, 1.05


def coprime_law(plant: LinearSystem, slack: float) -> tuple[LinearSystem, float, float]:
    """Return the law that stands the largest perturbation of normalised coprime factors.

    Args:
        plant: The shaped plant, strictly proper, u to y.
        slack: gamma over the least one, above 1.

    Returns:
        K with u = K y (positive feedback), its gamma, and the least one.
    """
    A, B, C = plant.A, plant.B, plant.C
    X = linalg.solve_continuous_are(A, B, C.T @ C, np.eye(B.shape[1]))
    Z = linalg.solve_continuous_are(A.T, C.T, B @ B.T, np.eye(C.shape[0]))
    least = math.sqrt(1.0 + float(np.abs(linalg.eigvals(X @ Z)).max()))
    gamma = slack * least
    L = (1.0 - gamma**2) * np.eye(len(A)) + X @ Z
    entry: FloatArray = np.asarray(gamma**2 * linalg.solve(L.T, Z @ C.T), dtype=np.float64)
    leave: FloatArray = np.asarray(B.T @ X, dtype=np.float64)
    law = LinearSystem(A - B @ leave + entry @ C, entry, leave, np.zeros((B.shape[1], C.shape[0])))
    return law, gamma, least


def shape(gain: float, highpass_hz: float, lowpass_hz: float) -> LinearSystem:
    """Return the weight W of both modes.

    Args:
        gain: Between the corners [N s/m].
        highpass_hz: Lower corner [Hz].
        lowpass_hz: Upper corner [Hz].
    """
    high, low = 2.0 * math.pi * highpass_hz, 2.0 * math.pi * lowpass_hz
    A = np.array([[-high, 0.0], [-high, -low]])
    B, C = np.array([1.0, 1.0]), np.array([0.0, gain * low])
    none = np.zeros((2, 2))
    return LinearSystem(
        np.block([[A, none], [none, A]]),
        np.stack([np.concatenate([B, 0 * B]), np.concatenate([0 * B, B])], axis=1),
        np.stack([np.concatenate([C, 0 * C]), np.concatenate([0 * C, C])]),
        none,
    )


class HInfinityShaping(LinearDynamic):
    """H-infinity loop-shaping law for sway and yaw, from carbody velocities.

    Args:
        vehicle: What it is designed for, with two or four actuators.
        delay: Delay it is designed for [s], zero or more.
        gain: Sky-hook gain of the shape, per actuator [N s/m].
        highpass_hz: Lower corner of the shape [Hz].
        lowpass_hz: Upper corner of the shape [Hz], above the lower one.
        slack: gamma over the least one, above 1.
        action_scale: Force of an action of one [N].
        control_period: Time between actions [s].

    Attributes:
        shaped: The reduced shaped plant.
        law_of_shaped: K, with positive feedback.
        gamma: Level of the design; 1/gamma is the perturbation of the coprime factors it stands.
        least_gamma: The least one, from its closed form.

    Raises:
        ArgumentError: A value is out of its range, or the law does not stabilise the whole plant.
    """

    def __init__(
        self,
        vehicle: LateralVehicle,
        delay: float = DELAY,
        gain: float = GAIN,
        highpass_hz: float = HIGHPASS_HZ,
        lowpass_hz: float = LOWPASS_HZ,
        slack: float = SLACK,
        action_scale: float = DEFAULT_ACTION_SCALE,
        control_period: float = DEFAULT_CONTROL_PERIOD,
    ) -> None:
        tau = check_padeable(delay)
        low = check_positive("highpass_hz", highpass_hz, "Hz")
        high = check_positive("lowpass_hz", lowpass_hz, "Hz")
        if high <= low:
            raise ArgumentError(f"lowpass_hz = {high:g} must be above highpass_hz = {low:g}")
        share = check_finite("slack", slack)
        if share <= 1.0:
            raise ArgumentError(f"slack = {share:g} must be above 1; 1.05 is close to the optimum")
        weight = shape(check_positive("gain", gain, "N s/m"), low, high)
        if not vehicle.num_actuators:
            raise ArgumentError(
                "layout = 'passive' has no actuator for a controller; choose 2 or 4"
            )
        signals = modal_signals(vehicle.layout, ("velocity",))
        system = state_space(vehicle)
        C = signals.readings @ system.output_rows(signals.sensors)[0]
        whole = _plain(system.A, system.actuator_input @ signals.forces, C)
        whole = delayed(whole, tau)
        n, k = len(whole.A), len(weight.A)
        shaped = _plain(
            np.block([[whole.A, whole.B2 @ weight.C], [np.zeros((k, n)), weight.A]]),
            np.vstack([np.zeros((n, 2)), weight.B]),
            np.hstack([whole.C2, np.zeros((2, k))]),
        )
        reduced, _ = balanced(shaped, STATES)
        self.shaped = LinearSystem(reduced.A, reduced.B2, reduced.C2, np.zeros((2, 2)))
        law, self.gamma, self.least_gamma = coprime_law(self.shaped, share)
        self.law_of_shaped: LinearSystem = law
        loop = np.block([[shaped.A, shaped.B2 @ law.C], [law.B @ shaped.C2, law.A]])
        growth = float(linalg.eigvals(loop).real.max())
        if growth >= 0.0:
            raise ArgumentError(
                f"the shaped law does not stabilise the whole plant (growth {growth:.2g} 1/s); "
                "give a smaller gain or a larger slack"
            )
        # The weight is the law's last part; u = -law(y).
        p = len(law.A)
        super().__init__(
            (
                np.block([[law.A, np.zeros((p, k))], [weight.B @ law.C, weight.A]]),
                np.vstack([law.B, np.zeros((k, 2))]) @ signals.readings,
                np.hstack([np.zeros((len(signals.forces), p)), -signals.forces @ weight.C]),
                np.zeros((len(signals.forces), len(signals.sensors))),
            ),
            signals.sensors,
            vehicle.layout,
            action_scale,
            control_period,
        )


def _plain(A: FloatArray, B: FloatArray, C: FloatArray) -> GeneralisedPlant:
    """Return a plant without disturbance and without weighted outputs."""
    return GeneralisedPlant(A, np.zeros((len(A), 0)), B, np.zeros((0, len(A))), C)


HINFINITY_SHAPING = Registered(
    "hinf-shaping",
    "H-infinity loop shaping of modal velocities, for a known delay",
    "McFarlane, Glover 1990",
    {
        "delay": (DELAY, "s"),
        "gain": (GAIN, "N s/m"),
        "highpass_hz": (HIGHPASS_HZ, "Hz"),
        "lowpass_hz": (LOWPASS_HZ, "Hz"),
        "slack": (SLACK, "1"),
        "design_kmh": (OF_THE_RUN, "km/h"),
    },
    lambda vehicle, design_kmh, **settings: HInfinityShaping(
        designed_for(vehicle, design_kmh), **settings
    ),
)
