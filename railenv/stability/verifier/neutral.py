"""Re-checks that a neutral loop under one common delay has infinitely many unstable roots."""

from typing import Any

import flint

from railenv.stability.verifier.claim import Claim
from railenv.stability.verifier.quasipolynomial import RejectedError, System, rational

_BITS = 192
_MOST_CHANNELS = 150
"""Above, the exact minimal polynomial takes minutes."""


def check_neutral(verdict: Any, unstable_roots: Any, claim: Claim, system: System) -> None:
    """Check that det(I + z F) has a zero inside the unit circle, for one delay above zero.

    Then the difference part's roots form a chain at Re s = -ln|z| / tau > 0 to infinite frequency,
    and by Rouche's theorem the loop's own roots come arbitrarily near to it. A region that lies to
    the right of the axis, or below a frequency, may hold none of them.

    Raises:
        RejectedError: It is not shown.
    """
    if (
        verdict != "UNSTABLE"
        or unstable_roots is not None
        or len(claim.groups) != 1
        or not rational(claim.high[0]) > 0
    ):
        raise RejectedError("a neutral loop proves instability under one delay above zero only")
    if claim.region.damping_ratio is not None or not claim.region.decay_rate >= 0:
        raise RejectedError("the chain of a neutral loop's roots is not shown to be in the region")
    m = system.F.nrows()
    if not 0 < m <= _MOST_CHANNELS:
        raise RejectedError(f"feedthrough has {m} rows; 1 to {_MOST_CHANNELS} can be checked")
    before = flint.ctx.prec
    flint.ctx.prec = _BITS
    try:
        # z is -1 over an eigenvalue of F; those are the zeros of its minimal polynomial.
        polynomial: Any = system.F.minpoly()
        if not any(
            abs(root) > 1
            for factor, _ in polynomial.numer().factor()[1]
            for root, _ in factor.complex_roots()
        ):
            raise RejectedError("the difference part is not shown to be unstable")
    finally:
        flint.ctx.prec = before
