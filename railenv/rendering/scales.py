"""Scales of a picture: exaggeration that stays inside its panel, round axis limits, numbers.

Lateral motions are millimetres on a vehicle of metres, so they are drawn `factor` times too large.
So that a diverging vehicle stays in its panel, what is drawn is L x / (1 + |x|) with
x = factor y / L: the stated factor for small y, never more than the limit L, and a larger motion is
always drawn larger.
"""

import math

_ROUND = (1.0, 2.0, 5.0, 10.0)
_LARGEST = 1e300
"""Round limits stop here, below the largest double, so that none becomes infinite."""


def exaggerated(value: float, factor: float, limit: float) -> float:
    """Return L x / (1 + |x|) with x = factor value / L.

    Args:
        value: What is to be shown, e.g. a displacement [m].
        factor: Exaggeration of small values [1].
        limit: Bound L of what is drawn, in the value's unit.
    """
    x = max(-_LARGEST, min(_LARGEST, factor * value / limit))
    return limit * x / (1.0 + abs(x))


def round_limit(largest: float, least: float) -> float:
    """Return the smallest of 1, 2, 5, 10, 20, ... times a power of ten that holds both numbers."""
    wanted = min(max(abs(largest), least), _LARGEST)
    power = 10.0 ** math.floor(math.log10(wanted))
    # A limit that was chosen is chosen again: 0.3 / 0.1 is a little above 3.
    return next(power * step for step in _ROUND if power * step >= wanted * (1.0 - 1e-12))


def fraction_of(value: float, limit: float) -> float:
    """Return value / limit within -1 to 1; it only passes 1 where `round_limit` has its end."""
    return max(-1.0, min(1.0, value / limit))


def signed(value: float, digits: int = 2) -> str:
    """Write a number with its sign, short whatever its size: +0.94, -12.00, +1.2e+07."""
    if abs(value) < 1000.0:
        return f"{value:+.{digits}f}"
    return f"{value:+.1e}"


def plain(value: float, digits: int = 2) -> str:
    """Write a number without a plus, short whatever its size."""
    return signed(value, digits).removeprefix("+")


def round_steps(largest: float, most: int) -> list[float]:
    """Return 0, s, 2 s, ... up to `largest`, with the smallest round step s giving `most` steps."""
    step = round_limit(largest / most, 1e-9)
    return [step * number for number in range(math.floor(largest / step * (1.0 + 1e-12)) + 1)]


def kilonewtons(force: float) -> str:
    """Write a force that labels a scale, given in newtons: 0.5 kN, 20 kN."""
    return f"{force / 1000.0:.3g} kN"
