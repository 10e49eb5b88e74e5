"""The vehicle as a problem of H-infinity control: what disturbs it, what is to stay small.

    x' = A x + B1 w + B2 u,   z = (C1 x, u),   y = C2 x + v

in scaled quantities, so that w, v and z count alike. u is the force of sway and of yaw
(`baselines.modal_signals`) times `force_weight` [m/s^2/N]; y is carbody velocity at damper level
and stroke, of sway and of yaw, over the density of their noise; v is that noise, white; w is white
noise too, which a filter turns into the alignment under each bogie; C1 x is the acceleration of the
front and of the rear floor, seen through Sperling's comfort filter.

The track's filter has the density of German low exactly. The two bogies are taken to run on tracks
of their own, so that nothing is foreseen, and both wheelsets of a bogie to see the same. Cross
level is left out. The delay between command and force is Pade's approximation
(`railenv.stability.pade`).
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from baselines.modal_signals import ModalSignals, modal_signals
from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.stability.loops import LinearSystem
from railenv.stability.pade import pade_block, required_order
from railenv.track import german_low
from railenv.track.spectra import RationalDensity
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, state_space
from railenv.vehicle.coordinates import WHEELSETS, bogie_of_wheelset

LONGEST_DELAY = 1.0
"""Longest delay that a law is designed for [s]."""

FLOORS = ("floor_front_lateral_acceleration", "floor_rear_lateral_acceleration")

STROKE_TIME = 0.3
"""Noise of the stroke over that of the velocity [s]: the two are worth the same at 0.53 Hz, the
frequency of lower sway."""

_HIGHEST = 6.0
"""Frequency up to which the Pade approximation is to be good [Hz]; bogie hunting is at 3.6 Hz."""

_REACHED = 1e-9
"""States with less than this share of the largest Hankel value are not told from rounding."""

_SHIFT = 0.5
"""Distance of the shifted plant's slowest root from the imaginary axis [1/s]."""


@dataclass(frozen=True, eq=False)
class GeneralisedPlant:
    """A problem of H-infinity control; D11 and D22 are zero, D12 and D21 pick u and v.

    Attributes:
        A: Shape (n, n).
        B1: From the track's white noise, shape (n, 2).
        B2: From the command, shape (n, 2).
        C1: To the weighted floor accelerations, shape (2, n).
        C2: To the readings, shape (p, n).
    """

    A: FloatArray
    B1: FloatArray
    B2: FloatArray
    C1: FloatArray
    C2: FloatArray

    def changed(self, into: FloatArray, back: FloatArray) -> "GeneralisedPlant":
        """Return the plant with states x_new = into x and x = back x_new, of the same or fewer."""
        return GeneralisedPlant(
            into @ self.A @ back, into @ self.B1, into @ self.B2, self.C1 @ back, self.C2 @ back
        )


@dataclass(frozen=True, eq=False)
class Design:
    """A generalised plant, and what turns its command and readings into newtons and sensors.

    Attributes:
        plant: In scaled quantities.
        signals: Sensors and actuators of the two modes.
        force_weight: Weight of a modal force [m/s^2/N].
        noise: Density of each reading's noise, shape (p,) [unit of the reading/sqrt(Hz)].
    """

    plant: GeneralisedPlant
    signals: ModalSignals
    force_weight: float
    noise: FloatArray


def generalised_plant(
    vehicle: LateralVehicle, delay: float, force_weight: float, noise: float
) -> Design:
    """Return the vehicle on German low with a delayed command.

    Args:
        vehicle: With two or four actuators.
        delay: Between command and force [s], zero or more.
        force_weight: Weighted acceleration that a newton of sway or yaw is worth [m/s^2/N].
        noise: Two-sided density of the velocity readings' noise [m/s/sqrt(Hz)], above zero.

    Raises:
        ArgumentError: A value is out of its range, or the vehicle has no actuator.
    """
    tau = check_padeable(delay)
    weight = check_positive("force_weight", force_weight, "m/s^2/N")
    density = check_positive("noise", noise, "m/s per square root of Hz")
    if not vehicle.num_actuators:
        raise ArgumentError("layout = 'passive' has no actuator for a controller; choose 2 or 4")
    system = state_space(vehicle)
    m = system.num_actuators
    signals = modal_signals(vehicle.layout, ("velocity", "stroke"))
    scale = np.array([density * (STROKE_TIME if "stroke" in n else 1.0) for n in signals.names])
    C2 = signals.readings @ system.output_rows(signals.sensors)[0] / scale[:, None]
    floors, direct = system.output_rows(FLOORS)

    # Alignment of bogies 1 and 2, then its rate, to the inputs of their wheelsets.
    bogies = np.array([[float(bogie_of_wheelset(w) == j) for j in (1, 2)] for w in WHEELSETS])
    share = np.zeros((system.B.shape[1] - m, 4))
    half = share.shape[0] // 2
    share[: len(WHEELSETS), :2] = bogies
    share[half : half + len(WHEELSETS), 2:] = bogies
    track = _two(track_filter(vehicle.speed))
    n, r = len(system.A), len(track.A)
    ride = _two(ride_system())
    forced = system.B[:, :m] @ signals.forces / weight
    plant = GeneralisedPlant(
        np.block(
            [
                [system.A, system.B[:, m:] @ share @ track.C, np.zeros((n, len(ride.A)))],
                [np.zeros((r, n)), track.A, np.zeros((r, len(ride.A)))],
                [ride.B @ floors, ride.B @ direct[:, m:] @ share @ track.C, ride.A],
            ]
        ),
        np.vstack([np.zeros((n, 2)), track.B, np.zeros((len(ride.A), 2))]),
        np.vstack(
            [forced, np.zeros((r, 2)), ride.B @ direct[:, :m] @ signals.forces / weight],
        ),
        np.hstack([np.zeros((2, n + r)), ride.C]),
        np.hstack([C2, np.zeros((len(C2), r + len(ride.A)))]),
    )
    return Design(delayed(plant, tau), signals, weight, scale)


def track_filter(speed: float) -> LinearSystem:
    """Return the filter from white noise to alignment of German low [m] and its rate [m/s].

    G(s) = sqrt(pi a v^3) / ((s + c1 v) (s + c2 v)) has |G|^2 equal to half the one-sided density
    a / ((Omega^2 + c1^2) (Omega^2 + c2^2)), taken per hertz at speed v, Omega = omega / v.

    Args:
        speed: Running speed v [m/s].
    """
    density = german_low().alignment
    assert isinstance(density, RationalDensity)
    first, second = (corner * speed for corner in density.corners)
    gain = math.sqrt(math.pi * density.amplitude * speed**3)
    A = np.array([[0.0, 1.0], [-first * second, -first - second]])
    return LinearSystem(A, np.array([[0.0], [gain]]), np.eye(2), np.zeros((2, 1)))


def ride_system() -> LinearSystem:
    """Return Sperling's lateral comfort filter in continuous time, |H(j 2 pi f)| = B(f).

    H = 0.737 q (sqrt(1.911) + 0.25 q) / (1 + 1.563 q + 0.277 q^2 + 0.0368 q^3), q = s / (2 pi); see
    `railenv.metrics.ride_filter` and `sperling_filter` there.
    """
    hertz = 2.0 * math.pi
    over = 0.737 * np.array([0.0, math.sqrt(1.911) / hertz, 0.25 / hertz**2])
    under = np.array([1.0, 1.563 / hertz, 0.277 / hertz**2, 0.0368 / hertz**3])
    A = np.zeros((3, 3))
    A[0, 1] = A[1, 2] = 1.0
    A[2] = -under[:3] / under[3]
    return LinearSystem(A, np.array([[0.0], [0.0], [1.0]]), over[None] / under[3], np.zeros((1, 1)))


def check_padeable(delay: float) -> float:
    """Return a delay [s] that a Pade model of moderate order can stand for.

    Raises:
        ArgumentError: It is negative, not finite, or longer than `LONGEST_DELAY`.
    """
    tau = check_not_negative("delay", delay, "seconds")
    if tau > LONGEST_DELAY:
        raise ArgumentError(
            f"delay = {tau:g} s is too long for a Pade model; give {LONGEST_DELAY:g} s or less"
        )
    return tau


def delayed(plant: GeneralisedPlant, delay: float) -> GeneralisedPlant:
    """Return the plant with Pade's approximation of a delay before the command.

    Args:
        plant: The plant; no path leads from its command straight to an output.
        delay: The delay [s]; zero leaves the plant as it is.
    """
    if delay == 0.0:
        return plant
    A, B, C, D = pade_block(required_order(delay, _HIGHEST), delay)
    eye = np.eye(2)
    size = 2 * len(A)
    entry = np.asarray(np.kron(eye, B[:, None]), dtype=np.float64)
    whole = np.block(
        [
            [plant.A, plant.B2 @ np.kron(eye, C[None])],
            [np.zeros((size, len(plant.A))), np.kron(eye, A)],
        ]
    )
    return GeneralisedPlant(
        whole,
        np.vstack([plant.B1, np.zeros((size, plant.B1.shape[1]))]),
        np.vstack([D * plant.B2, entry]),
        np.hstack([plant.C1, np.zeros((len(plant.C1), size))]),
        np.hstack([plant.C2, np.zeros((len(plant.C2), size))]),
    )


def balanced(plant: GeneralisedPlant, states: int) -> tuple[GeneralisedPlant, float]:
    """Return the plant on balanced coordinates, truncated (Moore 1981).

    The Gramians are those of the plant shifted to the left, A - sigma I, so that a plant with slow
    or unstable modes has some too. The error of the shifted plant, which is the plant's own on a
    line right of the imaginary axis, is at most twice the sum of the Hankel values left out (Glover
    1984); what it means to the loop is found from the loop with the whole plant.

    Args:
        plant: The whole plant.
        states: Number kept, at most.

    Returns:
        The truncated plant, and the bound on the shifted error [scaled].
    """
    shift = max(0.0, float(linalg.eigvals(plant.A).real.max())) + _SHIFT
    A = plant.A - shift * np.eye(len(plant.A))
    B, C = np.hstack([plant.B1, plant.B2]), np.vstack([plant.C1, plant.C2])
    reach = _root(np.asarray(linalg.solve_continuous_lyapunov(A, -B @ B.T), dtype=np.float64))
    seen = _root(np.asarray(linalg.solve_continuous_lyapunov(A.T, -C.T @ C), dtype=np.float64))
    U, sizes, V = linalg.svd(seen.T @ reach)
    kept = min(states, int(np.sum(sizes > _REACHED * sizes[0])))
    root = np.sqrt(sizes[:kept])
    into = (seen @ U[:, :kept] / root).T
    return plant.changed(into, reach @ V[:kept].T / root), 2.0 * float(sizes[kept:].sum())


def _root(gramian: FloatArray) -> FloatArray:
    sizes, vectors = linalg.eigh((gramian + gramian.T) / 2.0)
    return np.asarray(vectors * np.sqrt(np.maximum(sizes, 0.0)))


def _two(system: LinearSystem) -> LinearSystem:
    """Return two copies side by side; outputs are ordered by kind, then by copy."""
    A, B, C, D = (
        np.asarray(np.kron(np.eye(2), matrix), dtype=np.float64)
        for matrix in (system.A, system.B, system.C, system.D)
    )
    outputs = system.C.shape[0]
    order = [copy * outputs + kind for kind in range(outputs) for copy in range(2)]
    return LinearSystem(A, B, C[order], D[order])
