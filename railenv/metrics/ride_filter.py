"""Ride index on line: a causal filter whose running mean square follows Sperling's index.

`ride_index.sperling` needs the spectrum of a whole segment; a reward needs a number at every step.
The mean square of this filter's output, over any time, gives an estimate of the index over that
time: `ride_index_from_mean_square`.

Why a mean square can do that. The amplitude form of GB/T 5599 is, per segment,

    Wz = 3.57 (sum_i A_i^3 F(f_i) / f_i)^0.1.

Wz grows with A^0.3, and so with p^0.15 for a mean square p. For a single sine it is exactly such a
power once the signal is weighted with (F/f)^(1/3), which rises with f^(1/3) up to 5.4 Hz and falls
with 1/f above. No filter of finite order rises with f^(1/3), but the comfort weighting B(f) of the
original index (`ride_index.sperling_filter`) follows it closely, and B is the magnitude of a
rational function with stable poles and no zero in the right half plane: with q = s / (2 pi) in Hz,

    H(s) = k q (sqrt(1.911) + 0.25 q) / (1 + 1.563 q + 0.277 q^2 + 0.0368 q^3),

|H| = B for k = 0.737 (lateral), accelerations in m/s^2 here. Vertically k is 0.546, the lateral one
times the cube root of the ratio of the two F(f)/f below their breaks, 0.325/0.8, where the original
index has 0.588: so that one constant turns both mean squares into the index.

What is lost. A sum of cubes is no function of a sum of squares: of two signals with equal mean
square the one with fewer lines has the higher index. The estimate is scaled to vehicles on random
track and reads a pure sine 7 to 13 % low from 0.6 to 25 Hz. Measured on the front floor in 200
random runs (vehicle, 150 to 330 km/h, passive or sky-hook with 0 to 0.1 s delay, four spectra with
levels 1/4 to 4, seconds 5 to 30; true index 0.95 to 3.78), each weighting scaled to these runs::

    weighting before the mean square        Pearson    Spearman    largest error
    B comfort (this filter)                  0.9984      0.9982        0.15
    (F/f)^(1/3), 0.5 to 40 Hz, not causal    0.9985      0.9981        0.14
    none                                     0.9905      0.9905        0.34
    B quality                                0.972       0.974         0.53
    Wd of EN 12299                           0.944       0.950         0.75

Sixteen free weights of frequency bands, fitted to the same runs, reach 0.9988: what remains is the
cube, not the weighting. The band limits of the index are not in the filter; a high-pass at 0.4 Hz
changes the first line by one in its last digit. Between the indices of single 5 s segments and
the mean square over the same 5 s the correlation is 0.997; with an exponential mean of time
constant 3 s in place of the segment's, the best of 1 to 5 s, it is 0.993. The same signals taken
for vertical ones follow the vertical index as well: 0.9984, 0.9982, 0.13.

Signs do not matter. The module does not know over which time a caller averages.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from railenv.errors import ArgumentError, unknown_name
from railenv.metrics.ride_index import SPERLING_BAND, weighting
from railenv.metrics.sampling import float_if_single, sampled_above
from railenv.units import Dimensionless, FloatArray, Hertz

_NUMERATOR = (math.sqrt(1.911), 0.25)
"""Factors of q and q^2 in H, before the gain k [s, s^2] (SimulinkMatlab of janiex, sperling.m)."""
_DENOMINATOR = (1.0, 1.563, 0.277, 0.0368)
"""Factors of 1, q, q^2, q^3 in H [s^n] (the same)."""
_LATERAL_GAIN: Dimensionless = 0.737
"""Gain k of the lateral comfort weighting (the same)."""

_MATCHED: Hertz = 20.0
"""Second frequency at which the digital section has the analog magnitude; the first is that of its
poles. With 15, 25, 30 or 40 Hz the error up to 20 Hz at 200 Hz is 2.7 to 18 times as large."""

_FASTEST: Hertz = 1e5
"""Highest sample rate: from 4e5 Hz the differences that make the numerator are lost to rounding."""

_EXPONENT = 0.15
"""Power of a mean square that grows as an index does: half of 3 times 0.1 (GB/T 5599)."""

_SCALE: Dimensionless = 4.01
"""Estimate of the index at a weighted mean square of 1 (m/s^2)^2: geometric mean of index over
p^0.15 in the 200 runs above, 4.005 on the front floor and 4.009 on both. A pure sine with weighting
B would need 1e4^0.15 2^0.15 = 4.417, the original index's own constant."""

_DIRECTIONS = ("lateral", "vertical")


def ride_filter(sample_rate: float, direction: str = "lateral") -> FloatArray:
    """Digital ride filter, as second-order sections.

    Step by step, keep the state between calls of SciPy's `sosfilt`, one per signal of a batch with
    shape (batch,)::

        sections = ride_filter(200.0)
        state = np.zeros((len(sections), batch, 2))
        out, state = scipy.signal.sosfilt(sections, samples, axis=-1, zi=state)

    The first section is the bilinear transform of the real pole, a high-pass at 0.724 Hz, its
    corner kept in place. The second, the complex poles at 6.13 Hz and the zero, has the analog
    poles s at exp(s/sample_rate) and the numerator that gives the analog magnitude at 0 Hz, 6.13 Hz
    and 20 Hz (after Vicanek, Matched second order digital filters, 2016, who takes 0 Hz, the poles'
    frequency and Nyquist). Largest relative error of the magnitude, measured, beside that of the
    plain bilinear transform::

        sample rate    0.5 to 20 Hz    20 to 40 Hz    bilinear, 0.5 to 20 Hz
             100 Hz       0.09 %          8.3 %               15 %
             200 Hz       0.005 %         0.41 %              3.7 %
             500 Hz       0.0007 %        0.010 %             0.59 %
            1000 Hz       0.0002 %        0.0008 %            0.15 %

    The filter starts at rest: a constant acceleration rings for a second or so, then is gone.

    Args:
        sample_rate: Samples per second [Hz], above 80, as the index itself needs, to 100 000.
        direction: "lateral" or "vertical".

    Returns:
        Sections as SciPy takes them (b0, b1, b2, 1, a1, a2), shape (2, 6).

    Raises:
        ArgumentError: The direction is unknown, or the sample rate does not resolve 40 Hz or is
            too high to compute with.
    """
    if direction not in _DIRECTIONS:
        raise unknown_name("direction", direction, _DIRECTIONS)
    rate = sampled_above(sample_rate, SPERLING_BAND[1])
    if rate > _FASTEST:
        raise ArgumentError(
            f"sample_rate = {rate:g} Hz is above {_FASTEST:g} Hz, where rounding spoils the "
            "coefficients; use every n-th sample"
        )
    roots = np.roots(_DENOMINATOR[::-1])
    real_pole = -float(roots[np.abs(roots.imag).argmin()].real)
    pair = complex(roots[roots.imag.argmax()])

    # H = gain q / (q + real pole) times a section that is 1 at 0 Hz.
    gain = _gain(direction) * _NUMERATOR[0] / (_DENOMINATOR[3] * abs(pair) ** 2)
    high_pass = _digital_high_pass(real_pole, rate)
    low_pass = _digital_pair(pair, _NUMERATOR[1] / _NUMERATOR[0], rate)
    sections = np.array([high_pass, low_pass], dtype=np.float64)
    sections[0, :3] *= gain
    return sections


def ride_index_from_mean_square(mean_square: ArrayLike) -> FloatArray | float:
    """Estimate Sperling's index from the mean square of the ride filter's output.

    Wz = 4.01 p^0.15 with p in (m/s^2)^2; the text of the module says how good that is.

    Args:
        mean_square: Mean squares p of filtered accelerations [(m/s^2)^2], any shape, not negative.

    Returns:
        Estimates of the index `ride_index.sperling` [1], same shape; a float for a number.

    Raises:
        ArgumentError: A mean square is negative or not finite.
    """
    try:
        p = np.asarray(mean_square, dtype=np.float64)
    except (TypeError, ValueError):
        raise ArgumentError(
            "mean_square is not an array of numbers; give values in (m/s^2)^2"
        ) from None
    if not bool(np.all(np.isfinite(p) & (p >= 0.0))):
        raise ArgumentError(
            "mean_square holds a value that is negative or not finite; give means of squares "
            "in (m/s^2)^2"
        )
    return float_if_single(np.asarray(_SCALE * p**_EXPONENT, dtype=np.float64))


def _gain(direction: str) -> float:
    """Gain k of a direction: the lateral one, scaled as (F/f)^(1/3) is below the breaks."""
    ratio = float(weighting(1.0, direction)) / float(weighting(1.0, "lateral"))
    return _LATERAL_GAIN * math.cbrt(ratio)


def _digital_high_pass(corner: float, sample_rate: float) -> list[float]:
    """Bilinear transform of q / (q + corner), its corner [Hz] kept in place."""
    t = math.tan(math.pi * corner / sample_rate)
    scale = 1.0 / (1.0 + t)
    return [scale, -scale, 0.0, 1.0, (t - 1.0) * scale, 0.0]


def _digital_pair(pole: complex, zero_time: float, sample_rate: float) -> list[float]:
    """Digital section of (1 + zero_time q) |pole|^2 / ((q - pole)(q - conjugate)).

    With x = sin^2(pi f / sample_rate), the squared magnitude of b0 + b1/z + b2/z^2 is
    B0 (1 - x) + B1 x + 4 B2 x (1 - x), linear in B0 = (b0 + b1 + b2)^2, B1 = (b0 - b1 + b2)^2 and
    B2 = -4 b0 b2 (Vicanek 2016). B0 follows from 0 Hz, B1 and B2 from two more frequencies. Of
    the numerators with those values, the one with its zeros inside the unit circle is taken.

    Args:
        pole: Analog pole in the upper half plane, in q [Hz].
        zero_time: Factor of q in the numerator [s].
        sample_rate: Samples per second [Hz].

    Returns:
        The section (b0, b1, b2, 1, a1, a2).
    """
    digital_pole = np.exp(2.0 * math.pi * pole / sample_rate)
    a1, a2 = -2.0 * float(digital_pole.real), float(abs(digital_pole)) ** 2

    frequency = np.array([abs(pole), _MATCHED])
    q = 1j * frequency
    analog = (1.0 + zero_time * q) * abs(pole) ** 2 / ((q - pole) * (q - pole.conjugate()))
    z = np.exp(-2j * np.pi * frequency / sample_rate)
    x = np.sin(np.pi * frequency / sample_rate) ** 2
    target = np.abs(analog * (1.0 + a1 * z + a2 * z**2)) ** 2
    at_zero = (1.0 + a1 + a2) ** 2
    columns = np.stack([x, 4.0 * x * (1.0 - x)], axis=-1)
    at_nyquist, curve = (float(v) for v in np.linalg.solve(columns, target - at_zero * (1.0 - x)))

    even = 0.5 * (math.sqrt(at_zero) + math.sqrt(at_nyquist))
    b0 = 0.5 * (even + math.sqrt(even**2 + curve))
    b1 = 0.5 * (math.sqrt(at_zero) - math.sqrt(at_nyquist))
    b2 = -0.25 * curve / b0
    return [b0, b1, b2, 1.0, a1, a2]
