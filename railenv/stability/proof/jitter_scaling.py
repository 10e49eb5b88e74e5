"""Which weight to try: the scaled gain of the jitter loop in floating point. Nothing here proves.

The weight Y = (D^T D)^-1 has a block for each block of channels: D commutes with what those share,
their delay and their jitter. D is looked for by minimising the largest scaled gain over the
frequencies where it is large.
"""

import itertools
import math
from typing import Any

import numpy as np
from scipy import linalg, optimize

from railenv.stability.proof.jitter_loop import JitterLoop
from railenv.units import ComplexArray, FloatArray

_POINTS = 1200
_ACTIVE = 24
_ROUNDS = 4
_SETTLED = 1e-4
_EVALUATIONS = 150
"""Evaluations of the largest gain per parameter and round."""


def propose_weight(loop: JitterLoop) -> tuple[FloatArray, float]:
    """Propose Y and estimate the largest scaled gain that it leaves.

    Returns:
        Y, and the estimate of sup |D T(j omega) D^-1| [1/s].
    """
    response = _Response(loop)
    grid = response.grid
    parameters = _Parameters(response.start, loop.sizes)
    active = np.zeros(0)
    for _ in range(_ROUNDS):
        present = parameters.matrix(parameters.values)
        active = np.unique(np.concatenate([active, response.peaks(present, grid)]))
        if parameters.count < 2:
            break
        samples = response.at(active)

        def largest(x: FloatArray, samples: ComplexArray = samples) -> float:
            return float(_gains(samples, parameters.matrix(x)).max())

        found = optimize.minimize(
            largest,
            parameters.values,
            method="Nelder-Mead",
            options={"maxfev": _EVALUATIONS * parameters.count, "xatol": 1e-5, "fatol": 0.0},
        )
        before, after = (response.largest(D, grid) for D in (present, parameters.matrix(found.x)))
        if not after < before:
            continue
        parameters.values = found.x
        if before - after < _SETTLED * before:
            break
    D = parameters.matrix(parameters.values)
    inverse = np.linalg.inv(D)
    weight = inverse @ inverse.T
    weight = (weight + weight.T) / 2 * parameters.mask
    return weight / np.abs(weight).max(), response.largest(D, grid) / response.unit


class _Parameters:
    """D as upper triangles, one per block: logarithms of the diagonal, ratios beside it."""

    def __init__(self, D: FloatArray, sizes: list[int]) -> None:
        self.mask: FloatArray = linalg.block_diag(*(np.ones((size, size)) for size in sizes))
        self._above = np.nonzero(np.triu(self.mask, 1))
        self._size = len(D)
        diagonal = np.diag(D)
        self.values = np.concatenate([np.log(diagonal), (D / diagonal[:, None])[self._above]])
        self.count = len(self.values)

    def matrix(self, values: FloatArray) -> FloatArray:
        """Return D."""
        shape = np.eye(self._size)
        shape[self._above] = values[self._size :]
        return np.exp(np.clip(values[: self._size], -300.0, 300.0))[:, None] * shape


class _Response:
    """T(j omega) in the loop's unit of time."""

    def __init__(self, loop: JitterLoop) -> None:
        self.unit = float(loop.unit.p) / float(loop.unit.q)
        self._A, self._L, self._R = (_floats(M) for M in (loop.A, loop.L, loop.R))
        self._tau = np.repeat(loop.delays, loop.sizes) / self.unit
        closed = self._A - self._L @ self._R
        both = np.array([np.linalg.eigvals(self._A), np.linalg.eigvals(closed)])
        poles: ComplexArray = both.ravel().astype(np.complex128)
        sizes: FloatArray = np.abs(poles[np.abs(poles) > 1e-12 * np.abs(poles).max(initial=1e-300)])
        low, high = float(np.min(sizes, initial=1.0)) / 1e2, float(np.max(sizes, initial=1.0)) * 1e2
        spread = np.exp(np.linspace(math.log(low), math.log(high), _POINTS))
        self.grid = np.unique(np.concatenate([spread, sizes]))
        self._start(loop)

    def _start(self, loop: JitterLoop) -> None:
        """Begin with the channels' own units, balanced where the gain is largest."""
        own = [linalg.qr(_floats(P), mode="r")[0][: P.ncols()] for P in loop.mixers]
        D: FloatArray = linalg.block_diag(*(r * np.sign(np.diag(r))[:, None] for r in own))
        samples = self.at(self.grid)
        worst = np.abs(samples[np.argmax(_gains(samples, D))])
        edges = [0, *np.cumsum(loop.sizes).tolist()]
        blocks = [range(a, b) for a, b in itertools.pairwise(edges)]
        for _ in range(20):
            size = np.abs(D) @ worst @ np.abs(np.linalg.inv(D))
            for block in blocks:
                others = [k for k in range(len(D)) if k not in block]
                column = size[np.ix_(others, block)].sum()
                row = size[np.ix_(block, others)].sum()
                if row > 0.0 and column > 0.0:
                    D[block] *= np.sqrt(column / row)
                    size = np.abs(D) @ worst @ np.abs(np.linalg.inv(D))
        self.start = D

    def at(self, omega: FloatArray) -> ComplexArray:
        """Return T at frequencies, shape (len(omega), r, r)."""
        s = 1j * omega[:, None, None]
        late = self._L * np.exp(-s * self._tau)
        M = s * np.eye(len(self._A)) - self._A + late @ self._R
        return np.asarray(s * (self._R @ np.linalg.solve(M, np.broadcast_to(self._L, late.shape))))

    def peaks(self, D: FloatArray, grid: FloatArray) -> FloatArray:
        """Return the frequencies of the largest local maxima, refined."""
        gains = _gains(self.at(grid), D)
        inside = np.concatenate([[0.0], gains, [0.0]])
        top = np.flatnonzero((gains >= inside[:-2]) & (gains >= inside[2:]))
        top = top[np.argsort(-gains[top])][:_ACTIVE]
        found = [float(grid[-1])]
        for k in top.tolist():
            a, b = float(grid[max(k - 1, 0)]), float(grid[min(k + 1, len(grid) - 1)])

            def lower(omega: float) -> float:
                return -float(_gains(self.at(np.array([omega])), D)[0])

            better = optimize.minimize_scalar(lower, bounds=(a, b), method="bounded")
            found += [float(grid[k]), float(better.x)]
        return np.array(found)

    def largest(self, D: FloatArray, grid: FloatArray) -> float:
        """Return the largest scaled gain, the limit at infinite frequency included."""
        limit = float(_gains((self._R @ self._L)[None], D)[0])
        return max(limit, float(_gains(self.at(self.peaks(D, grid)), D).max()))


def _gains(samples: Any, D: FloatArray) -> FloatArray:
    """Return the largest singular value of D T D^-1 for each sample."""
    scaled = D @ samples @ np.linalg.inv(D)
    return np.asarray(np.linalg.norm(scaled, 2, axis=(-2, -1)))


def _floats(matrix: Any) -> FloatArray:
    shape = (matrix.nrows(), matrix.ncols())
    return np.array([float(v.p) / float(v.q) for v in matrix.entries()]).reshape(shape)
