"""What delay every lane of a training episode has, and what delay it is told.

The law of the draw matters as much as its range: a policy that is only ever told the exact delay
leans on it, one that never is gives comfort away, and the ends of a range are seen by few lanes.
Draws are stratified: in every episode the lanes share the range evenly, so that the mean over them
scatters less than with independent draws.
"""

from dataclasses import dataclass

import numpy as np

from railenv.actuation import DelaySpec
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError, check_not_negative
from railenv.units import Dimensionless, FloatArray, Second

_BESIDE: Second = 1e-6
# Far above rounding, far below anything the vehicle notices.


@dataclass(frozen=True)
class DelayLaw:
    """From what the delays of an episode's lanes are drawn.

    Attributes:
        low: Shortest delay [s].
        high: Longest delay [s].
        told_error: Largest error of the told delay [s].
        exact_share: Share of the lanes that are told the exact delay [1].
        shortest_share: Share of the lanes at the shortest delay [1].
        longest_share: Share of the lanes at the longest delay [1].
        edge_share: Share of the lanes at the edges of what a proof has to cover: within a
            microsecond of a whole control period, where readings begin to see an older force, and
            told exactly or with the largest error either way [1].
        period: Control period, for `edge_share` [s].

    Raises:
        ArgumentError: A share is outside of [0, 1], or both ends together have more than all lanes.
    """

    low: Second
    high: Second
    told_error: Second
    exact_share: Dimensionless = 0.0
    shortest_share: Dimensionless = 0.0
    longest_share: Dimensionless = 0.0
    edge_share: Dimensionless = 0.0
    period: Second = 0.01

    def __post_init__(self) -> None:
        for name in ("exact_share", "shortest_share", "longest_share", "edge_share"):
            if check_not_negative(name, getattr(self, name)) > 1.0:
                raise ArgumentError(
                    f"{name} = {getattr(self, name):g} is a share of the lanes; give 0 to 1"
                )
        ends = self.shortest_share + self.longest_share
        if ends > 1.0:
            raise ArgumentError(
                f"shortest_share + longest_share = {ends:g} is more than all lanes; give 1 or less"
            )

    @staticmethod
    def of(
        environment: EnvSettings,
        exact_share: float = 0.0,
        shortest_share: float = 0.0,
        longest_share: float = 0.0,
        edge_share: float = 0.0,
    ) -> "DelayLaw":
        """Read range and error off an environment's settings.

        Raises:
            ArgumentError: The environment's delays are not one range for all channels.
        """
        draw, given = environment.delays(), environment.delay
        if isinstance(given, DelaySpec) or draw.per_channel or draw.sensor != (0.0, 0.0):
            raise ArgumentError(
                "delay_per_channel, sensor_delay and a DelaySpec have no place in training on the "
                "model; give delay = [low, high] in seconds, one delay for all channels"
            )
        low, high = float(draw.low[0]), float(draw.high[0])
        return DelayLaw(
            low,
            high,
            environment.told_error,
            exact_share,
            shortest_share,
            longest_share,
            edge_share,
            environment.control_period,
        )

    def draw(
        self, lanes: int, generator: np.random.Generator, multiple_of: Second | None = None
    ) -> tuple[FloatArray, FloatArray]:
        """Draw an episode.

        As in the environment, the error is drawn from [-told_error, told_error], or from
        [-delay, told_error] where the delay is shorter.

        Args:
            lanes: Number of lanes.
            generator: Random stream.
            multiple_of: What delays are multiples of, each in the range as likely as the others;
                None for any delay in the range [s].

        Returns:
            The delay of every lane and what it is told, both of shape (lanes,) [s].

        Raises:
            ArgumentError: The range does not begin and end at a multiple.
        """
        place, chance, error = (_stratified(lanes, generator) for _ in range(3))
        middle = 1.0 - self.shortest_share - self.longest_share
        inside = np.clip((place - self.shortest_share) / max(middle, 1e-12), 0.0, 1.0)
        delay = self.low + (self.high - self.low) * inside
        if multiple_of is not None:
            first, last = (_times(end, multiple_of) for end in (self.low, self.high))
            chosen = np.floor(first + (last + 1 - first) * inside)
            delay = np.minimum(chosen, last) * multiple_of
        lowest = -np.minimum(self.told_error, delay)
        wrong = lowest + (self.told_error - lowest) * error
        told = delay + np.where(chance < self.exact_share, 0.0, wrong)
        if self.edge_share == 0.0:
            return delay, told
        # Drawn last, so that a share of zero leaves the other draws as they are.
        edge = _stratified(lanes, generator) < self.edge_share
        side, sign = (generator.integers(0, 2, lanes), generator.integers(-1, 2, lanes))
        near = np.round(delay / self.period) * self.period + _BESIDE * (2 * side - 1)
        near = np.clip(near, self.low, self.high)
        extreme = np.maximum(near + self.told_error * sign, 0.0)
        return np.where(edge, near, delay), np.where(edge, extreme, told)


def _times(delay: float, unit: float) -> int:
    times = round(delay / unit)
    if abs(times * unit - delay) > 1e-9 * unit:
        raise ArgumentError(
            f"delay = {delay:g} s must be a whole number of control periods of {unit:g} s here; "
            "change the ends of the range"
        )
    return times


def _stratified(lanes: int, generator: np.random.Generator) -> FloatArray:
    """Return numbers from [0, 1), one in each of as many equal parts, in random order."""
    return (generator.permutation(lanes) + generator.random(lanes)) / lanes
