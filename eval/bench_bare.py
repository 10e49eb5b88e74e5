"""The bare array update: what no environment of this plant can do without, by numpy.

    x <- x Phi + u Gamma

for all lanes once per physics step, x the 38 states and u 8 track inputs and 4 forces, constant
over the step, in double precision. No delay, no outputs, no reward, no observation. The rows are
shared among Python threads (numpy lets go of the interpreter inside a product), which meet after
every environment step, as those of the vector environment do.
"""

import os
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise

import numpy as np

from railenv.actuation import held_input
from railenv.units import FloatArray
from railenv.vehicle import lateral17
from railenv.vehicle.statespace import state_space
from railenv.vehicle.suspension import NUM_TRACK

TIME_STEP = 0.005
"""Physics step [s]."""

SUBSTEPS = 2
"""Physics steps in an environment step."""


class BareUpdate:
    """The update of a number of lanes.

    Args:
        lanes: Rows of x.
        threads: Among how many threads they are shared.

    Attributes:
        x: States, shape (lanes, 38).
        u: Inputs, shape (lanes, 12).
        transition: Phi, transposed for rows of states, shape (38, 38).
        gamma: Gamma likewise, shape (12, 38).
        note: What is updated, in words.
    """

    def __init__(self, lanes: int, threads: int) -> None:
        system = state_space(lateral17("paper_fit", 4, 300.0))
        # Columns of B: forces, track inputs, their rates; the rates are left out here.
        inputs = system.B[:, : system.num_actuators + NUM_TRACK]
        transition, gamma = held_input(system.A, inputs, TIME_STEP)
        self.transition = np.ascontiguousarray(transition.T)
        self.gamma = np.ascontiguousarray(gamma.T)
        rng = np.random.default_rng(0)
        self.x: FloatArray = 1e-3 * rng.standard_normal((lanes, len(transition)))
        self.u: FloatArray = 1e-3 * rng.standard_normal((lanes, len(self.gamma)))
        self._next = np.empty_like(self.x)
        self._work = np.empty_like(self.x)
        self._edges = [lanes * t // threads for t in range(threads + 1)]
        self._workers = ThreadPoolExecutor(threads - 1) if threads > 1 else None
        blas = os.environ.get("OPENBLAS_NUM_THREADS", "as many as the library takes")
        self.note = (
            f"{len(transition)} states and {len(self.gamma)} inputs (8 track, 4 forces), float64, "
            f"{SUBSTEPS} substeps per environment step, nothing else; threads of the matrix "
            f"library: {blas}"
        )

    def step(self, call: int = 0) -> int:
        """Update all lanes by one environment step; return how many lanes there are."""
        del call
        parts = list(pairwise(self._edges))
        if self._workers is None:
            self._part(*parts[0])
        else:
            others = [self._workers.submit(self._part, *part) for part in parts[1:]]
            self._part(*parts[0])
            for other in others:
                other.result()
        if SUBSTEPS % 2:
            self.x, self._next = self._next, self.x
        return len(self.x)

    def _part(self, first: int, end: int) -> None:
        here, there = self.x[first:end], self._next[first:end]
        work, u = self._work[first:end], self.u[first:end]
        for _ in range(SUBSTEPS):
            np.matmul(here, self.transition, out=there)
            np.matmul(u, self.gamma, out=work)
            there += work
            here, there = there, here

    def close(self) -> None:
        """Stop the threads."""
        if self._workers is not None:
            self._workers.shutdown()
