"""Regions of the complex plane that no root may enter, and the contours around them."""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from flint import arb

from railenv.errors import ArgumentError, check_finite, check_positive
from railenv.stability.modes import Mode
from railenv.stability.proof.contour import Quasipolynomial
from railenv.stability.proof.counting import (
    Contour,
    axis_contour,
    double_above,
    far_radius,
    wedge_contour,
)


@dataclass(frozen=True)
class Region:
    """Roots to the right of Re s = -decay_rate, or a frequency-capped wedge of low damping.

    A damping ratio as such cannot be asked of a delay system: it has infinitely many roots, and
    their damping ratios tend to zero as their frequencies grow. So the wedge has a height.

    Attributes:
        decay_rate: Roots with real part above its negative are excluded [1/s].
        damping_ratio: If given, roots with a damping ratio below it (the unstable ones included)
            are excluded instead, in [0, 1).
        max_frequency_hz: Up to this damped frequency |Im s| / (2 pi) [Hz].
    """

    decay_rate: float = 0.0
    damping_ratio: float | None = None
    max_frequency_hz: float | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "decay_rate", check_finite("decay_rate", self.decay_rate, "1/s"))
        if self.damping_ratio is None:
            if self.max_frequency_hz is not None:
                raise ArgumentError(
                    f"max_frequency_hz = {self.max_frequency_hz} caps a damping ratio; "
                    "give damping_ratio as well"
                )
            return
        ratio = check_finite("damping_ratio", self.damping_ratio, "1")
        if not 0.0 <= ratio < 1.0:
            raise ArgumentError(f"damping_ratio = {ratio} must be at least 0 and below 1")
        if self.decay_rate != 0.0:
            raise ArgumentError("give decay_rate or damping_ratio, not both")
        if self.max_frequency_hz is None:
            raise ArgumentError(
                "damping_ratio needs max_frequency_hz: a delay system has infinitely many roots "
                "whose damping ratios tend to zero, so the rule is meant up to a frequency"
            )
        object.__setattr__(self, "damping_ratio", ratio)
        cap = check_positive("max_frequency_hz", self.max_frequency_hz, "Hz")
        object.__setattr__(self, "max_frequency_hz", cap)

    def contains(self, mode: Mode) -> bool:
        """Whether an estimated root lies in the region."""
        if self.damping_ratio is None or self.max_frequency_hz is None:
            return mode.root.real > -self.decay_rate
        return (
            mode.damping_ratio < self.damping_ratio
            and mode.damped_frequency_hz <= self.max_frequency_hz
        )

    def contour(
        self, h: Quasipolynomial, degree: int, unit: Any, longest: Sequence[Any]
    ) -> Contour:
        """Return the contour in the polynomials' unit of time.

        Args:
            h: The function.
            degree: Number of states n.
            unit: Unit of time [s].
            longest: Longest delay of each group, in that unit.
        """
        if self.damping_ratio is None or self.max_frequency_hz is None:
            shift = arb(self.decay_rate) * unit
            sizes = [
                (shift * sum(k * tau for k, tau in zip(exponents, longest, strict=True))).exp()
                if self.decay_rate > 0.0
                else arb(1)
                for exponents in h.exponents
            ]
            return axis_contour(far_radius(h, degree, sizes), degree, shift)
        radius = far_radius(h, degree, [arb(1)] * len(h.exponents))
        height = 2 * arb.pi() * arb(self.max_frequency_hz) * unit
        return wedge_contour(radius, degree, self.damping_ratio, double_above(height))

    def to_plain(self) -> dict[str, float | None]:
        """Return the region in plain values."""
        return {
            "decay_rate": self.decay_rate,
            "damping_ratio": self.damping_ratio,
            "max_frequency_hz": self.max_frequency_hz,
        }
