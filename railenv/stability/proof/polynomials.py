"""Zeros of real polynomials with exact coefficients: right half-plane counts, positive zeros.

Both decide by signs of balls at rising precision. A sign that stays undecided at the highest
precision raises `UndecidedError`: an answer is exact or none.
"""

from collections.abc import Callable
from typing import Any, TypeVar

from flint import arb, arb_poly, fmpq, fmpq_poly, fmpz_poly

from railenv.stability.proof.precision import precision

Polynomial = Any
Ball = Any
_T = TypeVar("_T")

_FIRST_BITS = 256
_MOST_BITS = 1 << 15
# A bisection deeper than this separates zeros closer than any double tells apart.
_DEEPEST = 4000


class UndecidedError(Exception):
    """A question that balls cannot decide; the text says which."""


def at_rising_precision(attempt: Callable[[], _T], first: int = _FIRST_BITS) -> _T:
    """Run `attempt` with twice the bits each time until it raises `UndecidedError` no more."""
    bits = first
    while True:
        with precision(bits):
            try:
                return attempt()
            except UndecidedError:
                if bits >= _MOST_BITS:
                    raise
        bits *= 4


def sign(value: Ball) -> int:
    """Return the sign of a ball.

    Raises:
        UndecidedError: The ball holds zero and more.
    """
    if value > 0:
        return 1
    if value < 0:
        return -1
    if value.is_zero():
        return 0
    raise UndecidedError("a sign is not decided at this precision")


def unstable_zeros(polynomial: Polynomial) -> tuple[int, int, Polynomial]:
    """Count the zeros of an exact real polynomial by half-plane, multiplicities included.

    Zeros that are mirrored in the imaginary axis are split off exactly (the common divisor of even
    and odd part); what is left has a regular Routh array, if need be after a known factor s + c.

    Returns:
        Zeros with positive real part, zeros on the imaginary axis, and the polynomial e(w) whose
        positive zeros w = omega^2 belong to the latter (zeros at the origin left out).
    """
    origin = 0
    while polynomial[0] == 0:
        polynomial = polynomial.right_shift(1)
        origin += 1
    coefficients = polynomial.coeffs()
    even, odd = fmpq_poly(coefficients[0::2]), fmpq_poly(coefficients[1::2])
    # In s^2: the polynomial is even(s^2) + s odd(s^2).
    mirrored = even.gcd(odd) if not odd.is_zero() else even
    rest = polynomial // mirrored(fmpq_poly([0, 0, 1]))
    on_axis = mirrored(fmpq_poly([0, -1]))
    pairs = sum(
        power * len(positive_zeros(factor)) for factor, power in squarefree_factors(on_axis)
    )
    return (
        int(mirrored.degree()) - pairs + _routh(rest),
        2 * pairs + origin,
        on_axis,
    )


def _routh(polynomial: Polynomial) -> int:
    """Return the number of zeros with positive real part; none is mirrored in the axis."""
    for shift in range(12):
        # The further zero -shift is stable and moves a vanishing entry of the array elsewhere.
        regular = polynomial * fmpq_poly([shift, 1]) if shift else polynomial

        def attempt(regular: Polynomial = regular) -> int:
            return _routh_signs(regular)

        try:
            return at_rising_precision(attempt)
        except UndecidedError:
            continue
    raise UndecidedError("the zeros of a polynomial cannot be told from the imaginary axis")


def _routh_signs(polynomial: Polynomial) -> int:
    coefficients = [arb(c) for c in reversed(polynomial.coeffs())]
    above, row = coefficients[0::2], coefficients[1::2]
    changes, last = 0, sign(above[0])
    while row:
        leading = sign(row[0])
        if leading == 0:
            raise UndecidedError("an entry of the Routh array vanishes")
        changes += int(leading != last)
        last = leading
        ratio = above[0] / row[0]
        below = [
            above[k + 1] - ratio * (row[k + 1] if k + 1 < len(row) else 0)
            for k in range(len(above) - 1)
        ]
        above, row = row, below
    return changes


def squarefree_factors(polynomial: Polynomial) -> list[tuple[Polynomial, int]]:
    """Return squarefree factors with integer coefficients and their powers; none if constant."""
    whole = polynomial if isinstance(polynomial, fmpz_poly) else polynomial.numer()
    if whole.degree() < 1:
        return []
    return [(f, int(e)) for f, e in whole.factor_squarefree()[1]]


def positive_zeros(polynomial: Polynomial) -> list[tuple[Any, Any]]:
    """Isolate the positive zeros of a squarefree polynomial by Descartes' rule of signs.

    Args:
        polynomial: Squarefree, rational or integer coefficients.

    Returns:
        Disjoint open intervals (low, high) with rational ends by rising value, one zero in each
        and none outside; no end is a zero.
    """
    whole = polynomial if isinstance(polynomial, fmpz_poly) else polynomial.numer()
    while whole.degree() > 0 and whole[0] == 0:
        whole = whole.right_shift(1)
    if whole.degree() < 1:
        return []
    bound = _largest_zero(whole)

    def attempt() -> list[tuple[Any, Any]]:
        return _isolate(whole, bound)

    return sorted(at_rising_precision(attempt))


def _largest_zero(polynomial: Any) -> Any:
    """Return a power of two above every zero's modulus (Fujiwara's bound)."""
    coefficients = polynomial.coeffs()
    degree = len(coefficients) - 1
    leading = abs(coefficients[-1])
    exponent = max(
        (
            -(-(_bits(coefficients[k]) - _bits(leading) + 1) // (degree - k))
            for k in range(degree)
            if coefficients[k] != 0
        ),
        default=0,
    )
    return fmpq(2) ** (exponent + 1)


def _bits(value: Any) -> int:
    return int(abs(value)).bit_length()


def _isolate(polynomial: Any, bound: Any) -> list[tuple[Any, Any]]:
    found: list[tuple[Any, Any]] = []
    work = [(fmpq(0), bound, 0)]
    balls = arb_poly(polynomial)
    while work:
        low, high, depth = work.pop()
        changes = _sign_changes(balls, low, high)
        if changes == 0:
            continue
        if changes == 1:
            found.append((low, high))
            continue
        if depth > _DEEPEST:
            raise UndecidedError("zeros of a polynomial are too close to be told apart")
        middle = (low + high) / 2
        while polynomial(middle) == 0:
            middle = (2 * low + middle) / 3
        work += [(low, middle, depth + 1), (middle, high, depth + 1)]
    return found


def _sign_changes(balls: Any, low: Any, high: Any) -> int:
    """Return the sign changes of (1 + x)^d p((low + high x) / (1 + x)): bounds the zeros within."""
    shifted = balls(arb_poly([arb(low), arb(high - low)]))
    coefficients = [shifted[k] for k in range(balls.degree() + 1)]
    moved = arb_poly(coefficients[::-1])(arb_poly([1, 1]))
    changes, last = 0, 0
    for k in range(balls.degree() + 1):
        value = sign(moved[k])
        if value and last and value != last:
            changes += 1
        last = value or last
    return changes


def refined(polynomial: Any, low: Any, high: Any, bits: int) -> Ball:
    """Return a ball around the one zero in (low, high), narrow to about this many bits.

    Newton's iteration proposes, a change of sign proves; where it does not, the interval is halved.
    """
    whole = polynomial if isinstance(polynomial, fmpz_poly) else polynomial.numer()
    while whole[0] == 0:
        whole = whole.right_shift(1)  # as in the isolation: zero itself is no positive zero
    lower = _exact_sign(whole, low)
    with precision(2 * bits + 64):
        values, slopes = arb_poly(whole), arb_poly(whole.derivative())
        while True:
            ball = _proposed(values, slopes, arb(low), arb(high), lower, bits)
            if ball is not None:
                return ball
            middle = (low + high) / 2
            value = _exact_sign(whole, middle)
            if value == 0:
                return arb(middle)
            if value == lower:
                low = middle
            else:
                high = middle


def _exact_sign(polynomial: Any, at: Any) -> int:
    value = polynomial(at)
    return 0 if value == 0 else (1 if value > 0 else -1)


def _proposed(
    values: Any, slopes: Any, low: Ball, high: Ball, lower: int, bits: int
) -> Ball | None:
    """Run Newton's iteration from the middle; a ball with a proved change of sign, or None."""
    x = ((low + high) / 2).mid()
    for _ in range(8 + bits.bit_length()):
        slope = slopes(x)
        if slope.contains(0):
            return None
        moved = (x - values(x) / slope).mid()
        if not (low < moved < high):
            return None
        done = abs(moved - x) <= abs(moved) * arb(2) ** -bits
        x = moved
        if done:
            break
    width = abs(x) * arb(2) ** (4 - bits)
    for _ in range(3):
        left, right = (x - width).lower(), (x + width).upper()
        if not (low < left and right < high):
            return None
        if lower * values(left) > 0 and lower * values(right) < 0:
            return left.union(right)
        width *= 256
    return None
