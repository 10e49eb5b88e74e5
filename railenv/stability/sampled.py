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
from railenv.errors import check_count, check_positive
from railenv.stability.crossings import CriticalDelays
from railenv.stability.delay_system import DelaySystem
from railenv.stability.modes import Mode, normalised
from railenv.units import ComplexArray, FloatArray

# Besides the places that the continuous crossings predict, this many evenly spread delays are
# looked at, so that a loop whose sampling changes its character is not taken for its limit.
_CHECKS = 8


def lifted_matrix(system: DelaySystem, delay: float | Sequence[float], period: float) -> FloatArray:
    """Return the exact one-period map of the sampled loop.

    Args:
        system: The loop.
        delay: One delay for all channels or one per channel [s].
        period: Control period T [s].

    Returns:
        Square matrix; the leading n states are x_k.
    """
    T = check_positive("period", period, "seconds")
    delays = system.delays(delay)
    n = system.num_states
    Phi = linalg.expm(system.A * T)
    matrix = Phi
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
    by half a period) and at evenly spread delays; the first change of sign is then located.

    Args:
        system: The loop.
        continuous: The same loop's crossings without sampling.
        period: Control period T [s].
        progress: Called with each delay looked at [s]; the work grows with (delay / period)^3.

    Returns:
        The delay [s]; 0 if unstable without delay, None if none was found up to the longest delay
        of `continuous`. Located numerically, not proved.
    """
    T = check_positive("period", period, "seconds")
    longest = continuous.max_delay
    shifted = [c.delay - T / 2 for c in continuous.crossings if 0.0 < c.delay - T / 2 < longest]
    edges = np.array([0.0, *shifted, longest])
    places = np.unique(
        np.concatenate(
            [[0.0], (edges[1:] + edges[:-1]) / 2, longest * np.arange(1, _CHECKS + 1) / _CHECKS]
        )
    )
    scaled = system.scaled

    def growth(delay: float) -> float:
        return sampled_growth_rate(scaled, delay, T)

    stable = None
    for place in places:
        if progress is not None:
            progress(float(place))
        if growth(float(place)) >= 0.0:
            if stable is None:
                return 0.0
            return float(brentq(growth, stable, float(place), xtol=1e-10))
        stable = float(place)
    return None
