"""Quiet lanes: vehicles on a track that is smoother than all others by a factor.

A policy that is not linear acts in small motion otherwise than in large, and what it has only ever
seen large it may do wrong when small. The vehicle is linear: motion, noise and commands of a lane
of amplitude alpha are those of a lane of amplitude one times alpha. So it is the policy that sees
alpha times what the simulation says, and its actions count 1 / alpha times; the comfort that the
loss sees is then in units of alpha of itself, and a quiet lane counts as much as a loud one.
"""

from dataclasses import dataclass

import numpy as np

from railenv.errors import ArgumentError, check_not_negative
from railenv.units import Dimensionless, FloatArray


@dataclass(frozen=True)
class QuietLanes:
    """From what the amplitudes of an episode's lanes are drawn.

    Attributes:
        share: Share of the lanes that are quiet [1].
        quietest: Smallest amplitude; those of quiet lanes are drawn evenly in the logarithm from it
            to 1 [1].

    Raises:
        ArgumentError: A value is out of its range.
    """

    share: Dimensionless
    quietest: Dimensionless

    def __post_init__(self) -> None:
        if check_not_negative("quiet_share", self.share) > 1.0:
            raise ArgumentError(
                f"quiet_share = {self.share:g} is a share of the lanes; give 0 to 1"
            )
        if not 0.0 < self.quietest < 1.0:
            raise ArgumentError(
                f"quietest = {self.quietest:g} must be an amplitude above 0 and below 1"
            )

    def draw(self, lanes: int, generator: np.random.Generator) -> FloatArray:
        """Return the amplitude of every lane, shape (lanes,)."""
        quiet = generator.permutation(lanes) < round(self.share * lanes)
        return np.where(quiet, self.quietest ** generator.random(lanes), 1.0)
