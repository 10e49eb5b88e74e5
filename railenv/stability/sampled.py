"""Sampled controllers: the loop with hold and computational delay, lifted exactly.

u_k = -K x(t_k) takes force at t_k + tau_i and is held for one control period T. With tau_i = d_i T
+ r_i, d_i whole and r_i in [0, T),

    x_(k+1) = Phi x_k + sum_i [ G_i(T - r_i) u_(k-d_i) + (G_i(T) - G_i(T - r_i)) u_(k-d_i-1) ]

with Phi = exp(A T) and G_i(s) the integral of exp(A q) b_i over q in [0, s]. The state is x_k with
the past values of the independent measured signals R x (B K factored by its rank). An eigenvalue z
belongs to the growth rate ln(z) / T. The hold adds about T / 2 to the delay: the critical delay is
the continuous one minus T / 2 plus terms of order T^2.
"""

from collections.abc import Callable, Sequence

import numpy as np
from scipy import linalg
from scipy.optimize import brentq

from railenv.actuation.hold import held_input
from railenv.errors import ArgumentError, check_count, check_positive
from railenv.stability.crossings import CriticalDelays, Crossing
from railenv.stability.delay_system import DelaySystem
from railenv.stability.modes import Mode, normalised
from railenv.units import ComplexArray, FloatArray

# Besides the places that the continuous crossings predict, this many evenly spread delays are
# looked at, so that a loop whose sampling changes its character is not taken for its limit.
_CHECKS = 8
# Rows of the largest lifted map whose eigenvalues are computed (some 2 s); larger ones are refused
# where they are asked for, and avoided in the search for the critical delay.
_LARGEST_MAP = 900
_REFUSED_MAP = 6000
# Below this product of period and loop size, exp(A T) differs from the identity by rounding only.
_SHORTEST_PERIOD = 1e-4


def lifted_matrix(system: DelaySystem, delay: float | Sequence[float], period: float) -> FloatArray:
    """Return the exact one-period map of the sampled loop.

    Args:
        system: The loop.
        delay: One delay for all channels or one per channel [s].
        period: Control period T [s].

    Returns:
        Square matrix; the leading n states are x_k.
    """
    system.require_retarded("the sampled loop")
    T = check_positive("period", period, "seconds")
    delays = system.delays(delay)
    n = system.num_states
    rows = n + system.num_channels * (float(delays.max(initial=0.0)) / T + 2.0)
    if rows > _REFUSED_MAP:
        raise ArgumentError(
            f"period = {T:g} s cuts delay = {delays.max():g} s into too many parts "
            f"({rows:.3g} states); give a longer period"
        )
    matrix = np.asarray(linalg.expm(system.A * T))
    for tau in np.unique(delays):
        L, R = system.factor([k for k in range(system.num_channels) if delays[k] == tau])
        rank = R.shape[0]
        whole = int(np.floor(tau / T))
        rest = min(max(tau - whole * T, 0.0), T)
        _, full = held_input(system.A, L, T)
        _, late = held_input(system.A, L, T - rest)
        size = matrix.shape[0]
        grown = np.zeros((size + rank * (whole + 1), size + rank * (whole + 1)))
        grown[:size, :size] = matrix
        # Signals R x of ages 0 (now, from x), 1, ..., whole + 1 periods; age a >= 1 is a state.
        grown[size : size + rank, :n] = R
        shifted = rank * whole
        grown[size + rank :, size : size + shifted] = np.eye(shifted)
        for age, effect in ((whole, late), (whole + 1, full - late)):
            if age == 0:
                grown[:n, :n] -= effect @ R
            else:
                start = size + rank * (age - 1)
                grown[:n, start : start + rank] -= effect
        matrix = grown
    return matrix


def sampled_roots(
    system: DelaySystem, delay: float | Sequence[float], period: float, count: int = 10
) -> list[Mode]:
    """Return the dominant modes of the sampled loop as growth rates ln(z) / T.

    Args:
        system: The loop.
        delay: One delay for all channels or one per channel [s].
        period: Control period T [s].
        count: How many, at most; a conjugate pair counts once.

    Returns:
        Modes by falling real part; the imaginary part lies in [0, pi / T]. Not proved.
    """
    number = check_count("count", count)
    z, vectors = linalg.eig(lifted_matrix(system.scaled, delay, period))
    chosen = [k for k in range(len(z)) if z[k].imag >= 0.0 and z[k] != 0.0]
    chosen.sort(key=lambda k: -abs(z[k]))
    n, scale = system.num_states, system.state_scale
    rates: ComplexArray = np.log(z[chosen[:number]].astype(np.complex128)) / period
    return [
        Mode(complex(s), normalised(vectors[:n, k] * scale))
        for s, k in zip(rates, chosen, strict=False)
    ]


def sampled_growth_rate(
    system: DelaySystem, delay: float | Sequence[float], period: float
) -> float:
    """Return the largest growth rate ln|z| / T of the sampled loop [1/s]; not proved."""
    z = linalg.eigvals(lifted_matrix(system.scaled, delay, period))
    return float(np.log(np.abs(z).max()) / period)


def sampled_critical_delay(
    system: DelaySystem,
    continuous: CriticalDelays,
    period: float,
    progress: Callable[[float], None] | None = None,
) -> float | None:
    """Return the delay at which the sampled loop first loses stability.

    The growth rate is looked at between all crossings that the continuous answer predicts (shifted
    by half a period) and at evenly spread delays; the first change of sign is then located. Delays
    of so many periods that the lifted map becomes large are not looked at: there the continuous
    crossing itself is followed, by Newton's iteration on the sampled characteristic equation.

    Args:
        system: The loop.
        continuous: The same loop's crossings without sampling.
        period: Control period T [s].
        progress: Called with each delay looked at [s]; the work grows with (delay / period)^3.

    Returns:
        The delay [s]; 0 if unstable without delay, None if none was found up to the longest delay
        of `continuous`. Located numerically, not proved.

    Raises:
        ArgumentError: The period is not above zero, or too short against the loop's own times.
    """
    T = check_positive("period", period, "seconds")
    scaled = system.scaled
    if T * float(np.linalg.norm(scaled.undelayed)) < _SHORTEST_PERIOD:
        raise ArgumentError(
            f"period = {T:g} s is too short against the loop's own times; "
            "take the continuous answer"
        )
    rank = scaled.factor(list(range(scaled.num_channels)))[1].shape[0]
    reach = T * max(1.0, (_LARGEST_MAP - scaled.num_states) / max(rank, 1) - 2.0)
    longest = continuous.max_delay
    shifted = [c.delay - T / 2 for c in continuous.crossings if 0.0 < c.delay - T / 2 < longest]
    edges = np.array([0.0, *shifted, longest])
    spread = longest * np.arange(1, _CHECKS + 1) / _CHECKS
    places = np.unique(np.concatenate([[0.0], (edges[1:] + edges[:-1]) / 2, spread]))

    def growth(delay: float) -> float:
        return sampled_growth_rate(scaled, delay, T)

    stable = None
    for place in places[places <= reach]:
        if progress is not None:
            progress(float(place))
        if growth(float(place)) > 0.0:
            if stable is None:
                return 0.0
            return float(brentq(growth, stable, float(place), xtol=1e-12 * longest))
        stable = float(place)
    later = [c for c in continuous.crossings if c.direction > 0 and c.delay - T / 2 > (stable or 0)]
    if not later or later[0].delay - T / 2 > longest:
        return None
    return _followed(scaled, later[0], T)


def _followed(system: DelaySystem, crossing: Crossing, period: float) -> float:
    """Return the delay at which a continuous crossing's root is on the axis when sampled."""
    guess = crossing.delay - period / 2

    def real_part(delay: float) -> float:
        return _sampled_root(system, delay, period, crossing.mode.root).real

    # The hold shifts a crossing by half a period and terms of its square.
    width = min(period / 2, guess)
    low, high = guess - width, guess + width
    if real_part(low) * real_part(high) > 0.0:
        raise ArgumentError(
            f"period = {period:g} s is out of proportion to the loop's own times; "
            "its sampled critical delay cannot be located"
        )
    return float(brentq(real_part, low, high, xtol=1e-12 * guess))


def _sampled_root(system: DelaySystem, delay: float, period: float, seed: complex) -> complex:
    """Solve z - Phi + (late z^-d + (full - late) z^-(d+1)) K = 0, z = exp(s T), by Newton."""
    n, K = system.num_states, system.K
    whole = int(np.floor(delay / period))
    rest = min(max(delay - whole * period, 0.0), period)
    Phi, full = held_input(system.A, system.B, period)
    _, late = held_input(system.A, system.B, period - rest)
    s = seed
    for _ in range(50):
        z = complex(np.exp(s * period))
        now, before = late * z**-whole, (full - late) * z ** -(whole + 1)
        M: ComplexArray = z * np.eye(n) - Phi + (now + before) @ K
        slope: ComplexArray = period * (z * np.eye(n) - (whole * now + (whole + 1) * before) @ K)
        U, sizes, V = linalg.svd(M)
        step = sizes[-1] / np.vdot(U[:, -1], slope @ np.conj(V[-1]))
        s = complex(s - step)
        if abs(step) <= 1e-10 * abs(s):
            break
    return s
