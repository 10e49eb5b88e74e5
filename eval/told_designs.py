"""Laws that are designed for a delay, as one controller that is told it: one design per delay.

A SPEC with {delay} in it, as `lqg-delay:delay={delay}`, stands for such a family.
"""

import re
from collections.abc import Callable
from functools import cache

import numpy as np
from numpy.typing import NDArray

from baselines.controller import Controller
from railenv.errors import ArgumentError
from railenv.units import FloatArray

PLACE = "{delay}"
"""What stands in a SPEC for the delay in seconds."""

_ATTRIBUTES = ("layout", "measures", "action_scale", "control_period", "damper")


_HERE = re.compile(r"[:,]delay=\{delay\}(?=,|$)")


def check_place(spec: str) -> None:
    """Raise `ArgumentError` unless {delay} stands in a SPEC once, as all of its parameter delay."""
    if len(_HERE.findall(spec)) != 1 or spec.count(PLACE) != 1:
        raise ArgumentError(
            f"controller {spec!r}: {PLACE} stands for the delay that a law is designed for, once "
            f"and as the whole value of its parameter delay, as in lqg-delay:delay={PLACE}; give "
            "a number elsewhere"
        )


class ToldDesigns:
    """A family of laws; every lane runs the one that is designed for its delay.

    Args:
        made: Makes the law for a delay in seconds, called once for each. All measure the same
            columns and act alike.

    Attributes:
        is_told: That the controller knows the delay.
    """

    is_told = True

    def __init__(self, made: Callable[[float], Controller]) -> None:
        self._made = cache(made)
        self._laws: list[tuple[Controller, NDArray[np.intp]]] = []
        self._lanes, self._seed = 0, 0
        first = self._made(0.0)
        for name in _ATTRIBUTES:
            if hasattr(first, name):
                setattr(self, name, getattr(first, name))

    def reset(self, num_lanes: int, seed: int) -> None:
        """Start a run; `tell` must follow."""
        self._lanes, self._seed, self._laws = num_lanes, seed, []

    def tell(self, delays: FloatArray) -> None:
        """Design a law for every delay there is and start it with its lanes.

        Args:
            delays: Shape (lanes,) [s].
        """
        self._laws = []
        for delay in np.unique(delays):
            rows = np.flatnonzero(delays == delay)
            law = self._made(float(delay))
            law.reset(len(rows), self._seed)
            self._laws.append((law, rows))

    def law_at(self, told: float) -> Controller:
        """Return the law that is designed for a delay [s], for the oracle."""
        return self._made(told)

    def act(self, observations: FloatArray) -> FloatArray:
        """Return actions, every lane's by its law."""
        if not self._laws:
            raise ArgumentError("the designs have not been told a delay; call tell after reset")
        actions: list[FloatArray] = [law.act(observations[rows]) for law, rows in self._laws]
        whole = np.empty((self._lanes, actions[0].shape[1]))
        for (_, rows), own in zip(self._laws, actions, strict=True):
            whole[rows] = own
        return whole
