"""Critical delays of a loop with one common delay, in floating point.

The answer for loops that are too large for the proof (`railenv.stability.critical_delay`), and its
independent check.

A root s = j omega at delay tau satisfies M(j omega) v = 0 with z = exp(-j omega tau) on the unit
circle. With V = v v^H this gives the matrix equation

    (z - z_0) A_1 V + (1/z - 1/z_0) V A_1^T + (A_0 + z_0 A_1) V + V (A_0 + z_0 A_1)^H = 0

for A_0 = A, A_1 = -B K and any z_0 on the unit circle. Solving the last two terms (a Lyapunov
operator) and keeping only what the rank-r factor of B K sees leaves a generalised eigenvalue
problem of size 2 n r in z. Its eigenvalues near the unit circle are candidates; each is corrected
by Newton's iteration on (omega, tau) with the full matrices and kept only if it converges to a true
crossing.

Crossings repeat with period 2 pi / omega. Each moves the number of unstable roots by 2 in a
direction that does not depend on the repetition (omega > 0 has its conjugate), so that the count
for every delay follows from the count without delay. All of this is floating point and not proved.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.linalg import lapack

from railenv.errors import ArgumentError, RailenvError, check_positive
from railenv.stability.delay_system import DelaySystem
from railenv.stability.modes import Mode, normalised
from railenv.units import ComplexArray, FloatArray

MOST_CROSSINGS = 10_000
"""More crossings than this are not listed."""

# Candidates this close to the unit circle are tried; near-tangent pairs sit within the square root
# of rounding, and Newton rejects what is no crossing.
_CIRCLE_WIDTH = 1e-4
_NEWTON_STEPS = 50
# Convergence is quadratic: after a relative step of this size only rounding is left.
_LAST_STEP = 1e-8
# Two candidates this close (relative, and in phase) have converged to one crossing.
_SAME = 1e-8
# Singular values below this share of the largest span the null space at a crossing: Newton leaves
# some 1e-14, and two different crossings this close together are one for every purpose.
_NULL = 1e-10
# Roots mirrored in the imaginary axis up to this share are too close for the real shift.
_SEPARATE = 1e-9
# Real parts below this share of the largest root lie on the imaginary axis.
_ON_AXIS = 1e-13
# A crossing whose speed |Re ds/dtau| is below this share of |ds/dtau| is a touch, not a crossing.
_TANGENT = 1e-7


@dataclass(frozen=True, eq=False)
class Crossing:
    """One root passing through the imaginary axis at one delay.

    Attributes:
        delay: Delay at which it happens [s].
        mode: The root j omega, omega > 0, with its shape.
        direction: +1 if the pair turns unstable as the delay grows, -1 if it turns stable, 0 if it
            touches the axis and goes back.
        speed: ds/dtau there [1/s^2].
    """

    delay: float
    mode: Mode
    direction: int
    speed: complex

    @property
    def frequency_hz(self) -> float:
        """Crossing frequency omega / (2 pi) [Hz]."""
        return self.mode.root.imag / (2 * np.pi)


@dataclass(frozen=True, eq=False)
class CriticalDelays:
    """Every crossing up to the longest delay, and what follows from them.

    Attributes:
        crossings: By rising delay.
        unstable_without_delay: Number of unstable roots at delay zero.
        max_delay: Longest delay searched [s].
        marginal: Number of roots that stay on the imaginary axis whatever the delay; with any, the
            loop is never asymptotically stable.
        proved: Whether the answer is a proof: no crossing is missing, none is wrong.
        delay_independent: Whether it is proved that no root meets the axis for any delay at all.
        reason: Why there is no proof.
    """

    crossings: tuple[Crossing, ...]
    unstable_without_delay: int
    max_delay: float
    marginal: int = 0
    proved: bool = False
    delay_independent: bool = False
    reason: str = ""

    @property
    def critical_delay(self) -> float | None:
        """Delay at which stability is first lost [s]; 0 if not stable without delay, None if never.

        None means: not up to `max_delay`.
        """
        if self.unstable_without_delay > 0 or self.marginal > 0:
            return 0.0
        first = self.first
        return None if first is None else first.delay

    @property
    def first(self) -> Crossing | None:
        """The crossing at which stability is first lost, if the loop is stable without delay."""
        if self.unstable_without_delay > 0 or self.marginal > 0:
            return None
        return next((c for c in self.crossings if c.direction >= 0), None)

    def unstable_roots(self, delay: float) -> int:
        """Return the number of unstable roots at a delay that is no crossing, up to `max_delay`."""
        if delay > self.max_delay:
            raise ArgumentError(
                f"delay = {delay:g} is beyond the searched {self.max_delay:g} s; raise max_delay"
            )
        passed = sum(2 * c.direction for c in self.crossings if c.delay < delay)
        return self.unstable_without_delay + passed

    @property
    def stable_windows(self) -> tuple[tuple[float, float], ...]:
        """Open delay intervals without unstable roots, up to `max_delay` [s]."""
        windows: list[tuple[float, float]] = []
        if self.marginal > 0:
            return ()
        start, unstable = 0.0, self.unstable_without_delay
        for crossing in self.crossings:
            if unstable == 0 and crossing.delay > start:
                windows.append((start, crossing.delay))
            start, unstable = crossing.delay, unstable + 2 * crossing.direction
        if unstable == 0:
            windows.append((start, self.max_delay))
        return tuple(windows)


def estimated_critical_delays(system: DelaySystem, max_delay: float = 2.0) -> CriticalDelays:
    """Find every crossing of the imaginary axis for one common delay in (0, max_delay].

    A root on the imaginary axis without delay counts by where the first bit of delay moves it.

    Args:
        system: The loop; all channels share the delay.
        max_delay: Longest delay searched [s].

    Returns:
        The crossings with directions; floating point, not proved.

    Raises:
        ArgumentError: `max_delay` is not above zero or holds more than `MOST_CROSSINGS` crossings,
            or a root stays on the imaginary axis whatever the delay, so that no count exists.
    """
    system.require_retarded("estimated_critical_delays")
    longest = check_positive("max_delay", max_delay, "seconds")
    unstable = _unstable_without_delay(system)
    basic = _basic_crossings(system)
    refuse_too_many([omega for omega, *_ in basic], longest)
    found = [
        Crossing(tau, mode, direction, speed)
        for omega, first, direction, speed, mode in basic
        for tau in _repetitions(first, 2 * np.pi / omega, longest)
    ]
    found.sort(key=lambda c: c.delay)
    return CriticalDelays(tuple(found), unstable, longest)


def refuse_too_many(frequencies: Sequence[float], longest: float) -> None:
    """Raise `ArgumentError` if crossings at these frequencies repeat too often to be listed."""
    number = sum(longest * omega / (2 * np.pi) for omega in frequencies)
    if number > MOST_CROSSINGS:
        raise ArgumentError(
            f"max_delay = {longest:g} s holds about {number:.0f} crossings, more than "
            f"{MOST_CROSSINGS}; give a shorter one"
        )


def _unstable_without_delay(system: DelaySystem) -> int:
    """Count the unstable roots just above delay zero."""
    scaled = system.scaled
    roots = linalg.eigvals(scaled.undelayed)
    on_axis = np.abs(roots.real) <= _ON_AXIS * float(np.abs(roots).max())
    count = int(np.sum(roots.real[~on_axis] > 0.0))
    places: list[complex] = []
    for root in roots[on_axis]:
        s = complex(0.0, root.imag)
        if root.imag < 0.0 or any(abs(s - p) <= _SAME * abs(s) for p in places):
            continue  # with its conjugate, or with the others of a multiple root
        places.append(s)
        for speed, _ in crossing_speeds(scaled, s.imag, 0.0):
            if abs(speed.real) <= _TANGENT * max(abs(speed), abs(s) ** 2):
                raise ArgumentError(
                    f"the loop has a root s = {s.imag:.4g}j on the imaginary axis that a small "
                    "delay does not move off it; stability cannot be counted from there: remove "
                    "the free motion from the model, or change a parameter slightly"
                )
            count += 2 if speed.real > 0.0 else 0
    return count


def _repetitions(first: float, period: float, longest: float) -> list[float]:
    """Delays first, first + period, ... up to the longest; none at zero itself."""
    if first <= _SAME * period:
        first += period
    return [first + k * period for k in range(int(np.floor((longest - first) / period)) + 1)]


def crossing_candidates(system: DelaySystem) -> ComplexArray:
    """Return every z near the unit circle that may belong to a crossing; see the module's text."""
    n = system.num_states
    L, R = system.factor(list(range(system.num_channels)))
    r = L.shape[1]
    if r == 0:
        return np.empty(0, dtype=np.complex128)
    z0 = _best_shift(system)
    base = system.A - z0 * (system.B @ system.K)
    solve = _lyapunov_solver(base)
    # Unknowns P = R V (r x n) and Q = -V R^T / (z_0 z) (n x r); A_1 = -L R.
    size = 2 * r * n
    response = np.empty((size, size), dtype=base.dtype)
    for column in range(size):
        unknown = np.zeros(size)
        unknown[column] = 1.0
        P, Q = unknown[: r * n].reshape(r, n), unknown[r * n :].reshape(n, r)
        V = solve(-(L @ P) if column < r * n else -(Q @ L.T))
        response[:, column] = np.concatenate([(R @ V).ravel(), (V @ R.T).ravel()])
    upper: NDArray[np.bool_] = np.arange(size, dtype=np.int64) < r * n
    # P + (z - z_0) R V = 0 and z Q - (z - z_0) V R^T / z_0 = 0, as E + z F.
    sign = np.where(upper, 1.0, -1.0 / z0)[:, None]
    F = sign * response + np.diag(np.where(upper, 0.0, 1.0))
    E = -z0 * sign * response + np.diag(np.where(upper, 1.0, 0.0))
    alpha, beta = linalg.eigvals(E, -F, homogeneous_eigvals=True)
    near = np.abs(np.abs(alpha) - np.abs(beta)) <= _CIRCLE_WIDTH * np.abs(beta)
    return alpha[near] / beta[near]


def _basic_crossings(
    system: DelaySystem,
) -> list[tuple[float, float, int, complex, Mode]]:
    """Crossings with omega tau in (0, 2 pi]: omega, tau, direction, ds/dtau, mode."""
    scaled = system.scaled
    found: list[tuple[float, float, int, complex, Mode]] = []
    for z in crossing_candidates(scaled):
        roots = linalg.eigvals(scaled.A - z * (scaled.B @ scaled.K))
        # The candidate z fixes its root up to rounding times the problem's conditioning.
        width = 1e-3 * np.maximum(np.abs(roots), 1e-3 * np.abs(roots).max())
        for s in roots[(np.abs(roots.real) <= width) & (roots.imag > 0.0)]:
            omega = float(s.imag)
            tau = float(-np.angle(z) % (2 * np.pi)) / omega
            corrected = _newton(scaled, omega, tau)
            if corrected is None:
                continue
            omega, tau = corrected
            tau = tau % (2 * np.pi / omega)
            if any(abs(omega - o) <= _SAME * o and abs(tau - t) * o <= _SAME for o, t, *_ in found):
                continue
            for speed, vector in crossing_speeds(scaled, omega, tau):
                touches = abs(speed.real) <= _TANGENT * abs(speed)
                direction = 0 if touches else int(np.sign(speed.real))
                mode = Mode(1j * omega, normalised(vector * system.state_scale))
                found.append((omega, tau, direction, speed, mode))
    return [item for item in found if item[2] != 0]


def crossing_speeds(
    system: DelaySystem, omega: float, tau: float
) -> list[tuple[complex, ComplexArray]]:
    """Return ds/dtau and the shape of every root that passes through j omega at this delay.

    A semisimple k-fold root (identical loops side by side) leaves in k directions: with U, V the
    null spaces of M, the speeds are the eigenvalues of -(U^H M_s V)^-1 U^H M_tau V.
    """
    s, delays = 1j * omega, np.full(system.num_channels, tau)
    U, sizes, V = linalg.svd(system.characteristic_matrix(s, delays))
    count = max(1, int(np.sum(sizes <= _NULL * sizes[0])))
    left, right = U[:, -count:], np.conj(V[-count:]).T
    by_s = left.conj().T @ system.characteristic_derivative(s, delays) @ right
    by_tau = left.conj().T @ _delay_derivative(system, s, tau) @ right
    speeds, mixes = linalg.eig(-by_tau, by_s)
    return [(complex(speeds[k]), right @ mixes[:, k]) for k in range(count)]


def _delay_derivative(system: DelaySystem, s: complex, tau: float) -> ComplexArray:
    """Return dM/dtau = -s sum_i b_i K_i exp(-s tau), shape (n, n)."""
    return (system.B * (-s * np.exp(-s * tau))) @ system.K


def _newton(system: DelaySystem, omega: float, tau: float) -> tuple[float, float] | None:
    """Solve M(j omega; tau) v = 0 for real (omega, tau) by Newton's iteration."""
    start = omega, tau
    for _ in range(_NEWTON_STEPS):
        delays = np.full(system.num_channels, tau)
        s = 1j * omega
        U, sizes, V = linalg.svd(system.characteristic_matrix(s, delays))
        u, v = U[:, -1], np.conj(V[-1])
        by_s = np.vdot(u, system.characteristic_derivative(s, delays) @ v)
        by_tau = np.vdot(u, _delay_derivative(system, s, tau) @ v)
        # sigma + by_s j d_omega + by_tau d_tau = 0: two real equations, for the steps in
        # d_omega / omega and omega d_tau, so that the unit of time does not matter.
        columns = np.array([1j * by_s * omega, by_tau / omega])
        matrix = np.array([columns.real, columns.imag])
        if abs(np.linalg.det(matrix)) <= 1e-14 * np.linalg.norm(matrix) ** 2:
            return None
        relative, phase = np.linalg.solve(matrix, [-sizes[-1], 0.0])
        omega, tau = float(omega * (1.0 + relative)), float(tau + phase / omega)
        if not 0.0 < omega < 10 * start[0] or abs(tau - start[1]) * start[0] > 1.0:
            return None
        if abs(relative) <= _LAST_STEP and abs(phase) <= _LAST_STEP:
            return omega, tau
    return None


def _best_shift(system: DelaySystem) -> float | complex:
    """Choose z_0 so that the Lyapunov operator of A_0 + z_0 A_1 is far from singular.

    It is singular where two roots are mirrored in the imaginary axis. Real numbers are quicker, so
    +1 and -1 are left only if both come close to that.
    """

    def separation(z0: float | complex) -> float:
        roots = linalg.eigvals(system.A - z0 * (system.B @ system.K))
        mirrored = np.abs(roots[:, None] + np.conj(roots)[None, :])
        return float(mirrored.min() / max(float(np.abs(roots).max()), np.finfo(float).tiny))

    real = max((1.0, -1.0), key=separation)
    if separation(real) > _SEPARATE:
        return real
    best = max((complex(np.exp(1j * angle)) for angle in (0.5, 1.0, 1.7, 2.4)), key=separation)
    if separation(best) <= 1e-12:
        raise RailenvError(
            "the loop has roots mirrored in the imaginary axis that the feedback does not move; "
            "its crossings cannot be searched by this method: perturb a parameter slightly"
        )
    return best


def _lyapunov_solver(base: FloatArray | ComplexArray) -> Callable[[FloatArray], ComplexArray]:
    """Return a function that solves base X + X base^H = right-hand side."""
    T, Z = linalg.schur(base, output="complex")
    trsyl: Any = lapack.ztrsyl  # type: ignore[attr-defined]
    real = not np.iscomplexobj(base)

    def solve(right: FloatArray) -> ComplexArray:
        # info only tells of a perturbed solve; Newton's correction judges every candidate anyway.
        X, scale, _ = trsyl(T, T, Z.conj().T @ right @ Z, trana="N", tranb="C")
        solution = Z @ (X / scale) @ Z.conj().T
        return solution.real if real else solution

    return solve
