"""The first critical delay of a sampled loop, between proved stability and proved instability."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from railenv.errors import check_positive
from railenv.stability.proof.sampled import SampledProof, prove_sampled
from railenv.stability.sampled_loop import SampledLoop
from railenv.units import Second

# Delays at which the growth rate is looked at: every half period, but not more than this many.
_LOOKS = 120
# The bracket is this share of the delay unless another width is asked for.
_SHARE = 1e-3
# How often the bracket is doubled where the asked one cannot be proved.
_WIDENINGS = 4


@dataclass(frozen=True)
class SampledCriticalDelay:
    """Proved bracket of the delay at which a sampled loop first loses stability.

    Attributes:
        low: Proved stable from no delay up to here [s]; None if not even without delay.
        high: Proved unstable here [s]; None if no instability was found.
        stable: Proof of stability on [0, low], if any.
        unstable: Proof of instability at `high`, if any.
        reason: Why a side is missing, or empty.
    """

    low: Second | None
    high: Second | None
    stable: SampledProof | None
    unstable: SampledProof | None
    reason: str = ""


def proved_critical_delay(
    loop: SampledLoop,
    max_delay: float,
    width: float | None = None,
    progress: Callable[[float], None] | None = None,
) -> SampledCriticalDelay:
    """Bracket the first critical delay; a scheduled controller is told the true delay.

    Args:
        loop: The loop.
        max_delay: Longest common delay to look at [s].
        width: Width of the bracket [s]; by default a thousandth of the critical delay. It is
            doubled, a few times, where the proof does not succeed.
        progress: Called with each delay up to which stability is proved [s].

    Returns:
        The bracket. With low = 0 = high the loop is proved unstable without delay; with high None
        and no reason it is proved stable up to `max_delay`.

    Raises:
        ArgumentError: An argument is not above zero, or the delay spans too many periods.
    """
    longest = check_positive("max_delay", max_delay, "seconds")
    wanted = None if width is None else check_positive("width", width, "seconds")
    guess = _first_unstable(loop, longest)
    if guess == 0.0:
        start = prove_sampled(loop, 0.0)
        unstable = start if start.verdict == "UNSTABLE" else None
        side = None if unstable is None else 0.0
        return SampledCriticalDelay(None, side, None, unstable, start.reason)
    stable: SampledProof | None = None
    unstable: SampledProof | None = None
    reason = ""
    for attempt in range(_WIDENINGS + 1):
        half = 0.0 if guess is None else (wanted or _SHARE * guess) / 2 * 2.0**attempt
        if unstable is None and guess is not None:
            after = prove_sampled(loop, min(guess + half, longest))
            unstable = after if after.verdict == "UNSTABLE" else None
            reason = after.reason
        before = longest if guess is None else max(guess - half, 0.0)
        found = prove_sampled(loop, 0.0, before, progress=progress)
        if found.verdict == "STABLE":
            stable = found
        elif found.verdict == "UNSTABLE" and isinstance(found.witness, float):
            # The look missed an earlier loss of stability.
            unstable, guess = found, _between(loop, 0.0, found.witness)
        else:
            reason = found.reason
            if guess is None:
                break
        if stable is not None and (unstable is not None or guess is None):
            reason = ""
            break
    # Both are answers about common delays: plain numbers.
    low = stable.high if stable is not None and isinstance(stable.high, float) else None
    found_at = None if unstable is None else unstable.witness
    high = found_at if isinstance(found_at, float) else None
    return SampledCriticalDelay(low, high, stable, unstable, reason)


def _first_unstable(loop: SampledLoop, longest: float) -> float | None:
    """Return where the growth rate first changes its sign, in floating point."""
    looks = int(min(_LOOKS, np.ceil(2.0 * longest / loop.period))) + 1
    stable = 0.0
    for place in np.linspace(0.0, longest, looks).tolist():
        if loop.growth_rate(place) > 0.0:
            return 0.0 if place == 0.0 else _between(loop, stable, place)
        stable = place
    return None


def _between(loop: SampledLoop, stable: float, unstable: float) -> float:
    if loop.growth_rate(stable) > 0.0:
        return 0.0
    return float(brentq(loop.growth_rate, stable, unstable, xtol=1e-12 * unstable))
