"""Limit cycles themselves, stable or not, followed along the speed by shooting.

An orbit is a state z, a period T and a speed V with flow(z, V, T) = z. The branch is followed by
pseudo-arclength (H. B. Keller 1977): a step along the tangent, then Newton's method at right angles
to it, so that the branch may turn back. Where it turns, two orbits meet and vanish: the fold, which
is the nonlinear critical speed without the bias of a ramp. Eigenvalues of the period map, the
Floquet multipliers, tell stability; one of them is 1, along the orbit.

For systems of few states: each Newton step runs as many lanes as there are states, and three more.
Derivatives are differences. Where a force has a kink (a flange's clearance) the multipliers are
good to about the share of the period that a step takes, speeds and amplitudes to its square. The
branch does not end at the Hopf point, it passes through it: end it by `least_amplitude`.
"""

from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from railenv.errors import ArgumentError, RailenvError, check_count, check_positive
from railenv.simulation.bifurcation import HuntingSystem
from railenv.units import ComplexArray, Dimensionless, FloatArray, MetrePerSecond, Second


@dataclass(frozen=True, eq=False)
class Orbit:
    """One limit cycle.

    Attributes:
        state: A state on it, shape (n,).
        period: Its duration.
        speed: Running speed.
        amplitude: Half of peak to peak of the output, in its units.
        multipliers: Floquet multipliers, largest first, shape (n,).
    """

    state: FloatArray
    period: Second
    speed: MetrePerSecond
    amplitude: Dimensionless
    multipliers: ComplexArray

    @property
    def stable(self) -> bool:
        """Whether no multiplier but the one along the orbit lies outside the unit circle."""
        along = int(np.argmin(abs(self.multipliers - 1.0)))
        return bool(np.all(abs(np.delete(self.multipliers, along)) < 1.0))


@dataclass(frozen=True, eq=False)
class OrbitBranch:
    """Orbits in the order in which they were found; estimated to `residual`.

    Attributes:
        orbits: The branch.
        folds: Where the speed turns back, located between their neighbours.
        residual: Largest |flow(z) - z| over the scale of each state.
    """

    orbits: tuple[Orbit, ...]
    folds: tuple[Orbit, ...]
    residual: Dimensionless


class _Shooting:
    """Unknowns scaled to the order of one: state, period and speed over those of the start."""

    def __init__(
        self, system: HuntingSystem, state: FloatArray, period: float, speed: float, samples: int
    ) -> None:
        self.system = system
        self.samples = samples
        self.n = len(state)
        peak, at = abs(state), state[None]
        for _ in range(_PHASES):
            at, _ = system.advance(at, np.array([speed]), np.array([period / _PHASES]), samples)
            peak = np.maximum(peak, abs(at[0]))
        # A state that the motion leaves at rest (by symmetry, say) still needs a scale.
        floor = 1e-3 * float(peak.max())
        self.scale = np.concatenate([np.maximum(peak, floor), [period, _SPEED_SCALE * speed]])

    def moved(self, points: FloatArray) -> FloatArray:
        """State after one period less the state, scaled, shape (points, n)."""
        raw = points * self.scale
        z, period, speed = raw[:, : self.n], raw[:, self.n], raw[:, self.n + 1]
        if np.any(period <= 0.0) or np.any(speed <= 0.0):
            return np.full_like(z, np.inf)
        after, _ = self.system.advance(z, speed, period, self.samples)
        return (after - z) / self.scale[: self.n]

    def jacobian(self, point: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Residual and its derivatives, shapes (n,) and (n, n + 2); None out of bounds."""
        points = np.tile(point, (self.n + 3, 1))
        points[1:] += _DIFFERENCE * np.eye(self.n + 2)
        moved = self.moved(points)
        if not np.all(np.isfinite(moved)):
            return None
        return moved[0], (moved[1:] - moved[0]).T / _DIFFERENCE

    def flow_direction(self, point: FloatArray) -> FloatArray:
        """Direction of the motion at a point, among the unknowns; length one in scaled states."""
        raw = (point * self.scale)[None]
        short = raw[:, self.n] * 1e-4
        z, _ = self.system.advance(raw[:, : self.n], raw[:, self.n + 1], short, 1)
        direction = np.zeros(self.n + 2)
        direction[: self.n] = (z[0] - raw[0, : self.n]) / self.scale[: self.n]
        return direction / np.linalg.norm(direction)

    def correct(
        self, guess: FloatArray, anchor: FloatArray, tangent: FloatArray
    ) -> tuple[FloatArray, FloatArray] | None:
        """Newton's method across `tangent`; the phase is held by not moving along the orbit."""
        ahead, point = self.flow_direction(anchor), guess.copy()
        for _ in range(_NEWTON_STEPS):
            linear = self.jacobian(point)
            if linear is None:
                return None
            residual, J = linear
            right = np.concatenate(
                [residual, [ahead @ (point - anchor), tangent @ (point - guess)]]
            )
            try:
                step = np.linalg.solve(np.vstack([J, ahead, tangent]), -right)
            except np.linalg.LinAlgError:
                return None
            point = point + step
            if float(abs(step).max()) < _CONVERGED:
                return point, J
        return None

    def tangent(self, point: FloatArray, J: FloatArray, before: FloatArray) -> FloatArray:
        """Direction of the branch, on the side of `before`."""
        rows = np.vstack([J, self.flow_direction(point), before])
        right = np.zeros(self.n + 2)
        right[-1] = 1.0
        direction = np.linalg.solve(rows, right)
        return direction / np.linalg.norm(direction)

    def orbit(self, point: FloatArray, J: FloatArray) -> Orbit:
        """Return the orbit in its own units."""
        raw = point * self.scale
        z, period, speed = raw[: self.n], float(raw[self.n]), float(raw[self.n + 1])
        _, outputs = self.system.advance(
            z[None], np.array([speed]), np.array([period]), self.samples
        )
        multipliers = np.linalg.eigvals(J[:, : self.n] + np.eye(self.n)).astype(np.complex128)
        multipliers = multipliers[np.argsort(-abs(multipliers), kind="stable")]
        amplitude = 0.5 * float(outputs.max() - outputs.min())
        return Orbit(z, period, speed, amplitude, multipliers)


_PHASES = 32  # places on the starting orbit at which scales are taken
_SPEED_SCALE = 0.1  # of the starting speed: a step of the branch is a few per cent of that
_DIFFERENCE = 1e-6  # of a scaled unknown: squared it is at the rounding of the flow
_NEWTON_STEPS = 10
_CONVERGED = 1e-9
_SHORTEST_STEP = 1e-6


def follow_orbits(
    system: HuntingSystem,
    state: FloatArray,
    period: Second,
    speed: MetrePerSecond,
    *,
    lowest: MetrePerSecond,
    highest: MetrePerSecond,
    least_amplitude: Dimensionless = 0.0,
    step: Dimensionless = 0.05,
    most_orbits: int = 200,
    samples: int = 600,
) -> OrbitBranch:
    """Follow the branch of a limit cycle, first towards lower speeds.

    Args:
        system: What hunts.
        state: A state near the orbit, from a settled simulation, shape (n,).
        period: Its period, roughly [s].
        speed: Speed of that simulation [m/s]; the first orbit is there.
        lowest: Speed at which to stop on the way down [m/s].
        highest: Speed at which to stop on the way up [m/s].
        least_amplitude: Amplitude below which to stop, so as not to pass through the Hopf point.
        step: Longest step along the branch; one is the size of the starting orbit.
        most_orbits: Orbits after which to stop.
        samples: Outputs in a period, at least; a system with a step of its own should divide the
            period by this number and not need more.

    Raises:
        ArgumentError: The state does not fit, or speeds are not in order.
        RailenvError: No orbit was found near the state.
    """
    period, speed = check_positive("period", period, "s"), check_positive("speed", speed, "m/s")
    state = np.array(state, dtype=np.float64)
    if state.shape != (system.state_size,) or not np.any(state):
        raise ArgumentError(
            f"state has the shape {state.shape}; give {system.state_size} numbers on the orbit"
        )
    if not 0.0 < lowest <= speed <= highest:
        raise ArgumentError(
            f"speed = {speed:g} m/s must lie between lowest = {lowest:g} above zero and "
            f"highest = {highest:g} m/s"
        )
    longest = check_positive("step", step)
    shooting = _Shooting(system, state, period, speed, check_count("samples", samples, 50))
    n = shooting.n
    tangent = np.zeros(n + 2)
    tangent[-1] = -1.0
    start = np.concatenate([state, [period, speed]]) / shooting.scale
    found = shooting.correct(start, start, tangent)
    # The straight run repeats itself with any period, but there the equations are singular.
    if found is None:
        raise RailenvError(
            f"no limit cycle near the state given at {speed:g} m/s: settle it for longer, or "
            "check the period"
        )
    point, jacobian = found
    orbits, folds = [shooting.orbit(point, jacobian)], list[Orbit]()
    residual = float(abs(shooting.moved(point[None])).max())
    tangent = shooting.tangent(point, jacobian, tangent)
    length = longest / 4
    while len(orbits) < check_count("most_orbits", most_orbits):
        found = shooting.correct(point + length * tangent, point, tangent)
        ahead = None if found is None else shooting.tangent(*found, tangent)
        # A sharp bend is taken in shorter steps.
        if found is None or ahead is None or float(ahead @ tangent) < 0.9:
            length /= 2
            if length < _SHORTEST_STEP:
                break
            continue
        if tangent[-1] * ahead[-1] < 0.0:
            folds.append(_fold(shooting, point, tangent, length))
        point, jacobian = found
        tangent = ahead
        orbits.append(shooting.orbit(point, jacobian))
        residual = max(residual, float(abs(shooting.moved(point[None])).max()))
        length = min(longest, 1.3 * length)
        if not lowest <= orbits[-1].speed <= highest or orbits[-1].amplitude < least_amplitude:
            break
    return OrbitBranch(tuple(orbits), tuple(folds), residual)


def _fold(shooting: _Shooting, point: FloatArray, tangent: FloatArray, length: float) -> Orbit:
    """Find the orbit between two at which the branch runs across the speed."""

    def at(distance: float) -> tuple[FloatArray, FloatArray, float]:
        found = shooting.correct(point + distance * tangent, point, tangent)
        if found is None:
            raise RailenvError("the fold could not be located: follow the branch in shorter steps")
        return *found, float(shooting.tangent(*found, tangent)[-1])

    distance = float(brentq(lambda s: at(s)[2], 0.0, length, xtol=1e-7 * length))
    where, jacobian, _ = at(distance)
    return shooting.orbit(where, jacobian)
