"""The difference part of a neutral loop, f(t) = -F f(t - tau) at infinite frequency.

With one common delay its roots are s = -ln(z) / tau + 2 pi j k / tau over the zeros z of
det(I + z F). A zero inside the unit circle gives a chain of them to the right of the axis, and the
loop's own roots come arbitrarily near to the chain: infinitely many are unstable.
"""

from typing import Any

from flint import acb_poly, fmpq_mat

from railenv.stability.proof.characteristic import exact
from railenv.stability.proof.precision import precision
from railenv.units import FloatArray

_BITS = 256


def difference_part_is_unstable(feedthrough: FloatArray) -> bool:
    """Whether balls prove a zero of det(I + z F) inside the unit circle."""
    m = feedthrough.shape[0]
    F: Any = fmpq_mat([[-exact(feedthrough[i, j]) for j in range(m)] for i in range(m)])
    reversed_polynomial = F.charpoly()
    # det(I + z F) has the zeros 1 / lambda over the eigenvalues lambda of -F.
    with precision(_BITS):
        for factor, _ in reversed_polynomial.numer().factor_squarefree()[1]:
            try:
                roots = acb_poly(factor).roots()
            except ValueError:
                continue
            if any(abs(root) > 1 for root in roots):
                return True
    return False
