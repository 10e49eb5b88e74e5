"""Sperling's ride index Wz of a measured or simulated acceleration.

Two families, each as published:

* `sperling`, the amplitude form of the Chinese standard GB/T 5599 with the constants and the 5 s
  segments of its 2019 edition [S1]; acceleration in m/s^2.
* `sperling_original`, the form of the German school with the filter B(f) [S2]; inside, the
  acceleration is in cm/s^2, as the filter's gain requires. Callers still give m/s^2.

The index depends on how the spectrum is made, because amplitudes are cubed before they are summed:
shorter segments and tapered windows both raise it [S3]. Two indices compare only when all of this
agrees, and so it is fixed here:

* each segment has its mean removed, then the window is applied;
* a line's amplitude is single-sided and corrected for the window's coherent gain, so that a sine on
  an FFT line shows its amplitude there. A tapered window spreads a sine over neighbouring lines all
  the same: under a Hann window the cubes of its three lines add up to 1.25, and the index comes out
  about 2 % higher than under the default "boxcar";
* segments do not overlap unless asked; samples after the last whole segment are not used;
* a record's index is the mean of its segments' indices, or the largest ("max");
* both ends of the band belong to it; at a break frequency of F(f) the upper branch holds.

Signs do not matter, and an acceleration in g must be converted first. The module does not know
which floor position or track length a standard wants.

Sources: [S1] GB/T 5599-2019 (the constants also in the public package vtda 1.5.3; the text of the
standard was not at hand). [S2] The public programs comfpy (wz, filters) and SimulinkMatlab of
janiex (sperling.m); Sperling's papers were not at hand. [S3] Zhang Z. et al., Journal of Tongji
University, September 2023, doi 10.11908/j.issn.0253-374x.22146.
"""

import numpy as np
from numpy.typing import ArrayLike

from railenv.errors import ArgumentError, check_finite, check_not_negative, unknown_name
from railenv.metrics.sampling import (
    as_frequency,
    as_signal,
    cut,
    float_if_single,
    sampled_above,
    segment_step,
    whole_samples,
    window_samples,
)
from railenv.units import FloatArray

SPERLING_BAND: tuple[float, float] = (0.5, 40.0)
"""Frequencies that count, both ends included [Hz] (GB/T 5599-2019)."""

SPERLING_SEGMENT: float = 5.0
"""Length of one segment [s] (GB/T 5599-2019; the 1985 edition took 18 to 20 s)."""

_INDEX_CONSTANT = 3.57
"""Factor of the index for amplitudes in m/s^2 (GB/T 5599-2019). The same index is written with 7.08
for amplitudes in g and with 0.896 for cm/s^2; the three agree within their printed digits."""

_INTEGRAL_ROOT = 6.67
"""The integral form takes this root of a weighted square [S2]: 20/3 as the sources print it."""

_CENTIMETRES = 100.0
"""cm in a metre; B(f) is scaled for accelerations in cm/s^2 [S2]."""

_DIRECTIONS = ("lateral", "vertical")
_KINDS = ("comfort", "quality")
_FORMS = ("lines", "integral")
_AGGREGATES = ("mean", "max")

_BREAKS: dict[str, tuple[float, float]] = {"lateral": (5.4, 26.0), "vertical": (5.9, 20.0)}
"""Break frequencies of F(f) [Hz] (GB/T 5599-2019)."""
_RISE: dict[str, float] = {"lateral": 0.8, "vertical": 0.325}
"""F = rise f^2 below the first break [1/Hz^2] (GB/T 5599-2019)."""
_FALL: dict[str, float] = {"lateral": 650.0, "vertical": 400.0}
"""F = fall / f^2 between the breaks [Hz^2] (GB/T 5599-2019)."""

_COMFORT_GAIN: dict[str, float] = {"lateral": 0.737, "vertical": 0.588}
"""Gain k of the comfort filter B(f) [S2]."""
_QUALITY_GAIN = 1.14
"""Gain of the ride quality filter B(f), the same in both directions [S2]."""

_EDGE = 1.0 - 1e-12
"""A line this close below a break or a band edge counts as on it: its frequency k/T is a rounded
quotient, and 5.4 Hz computed is to be 5.4 Hz written."""

_GRADES: tuple[tuple[float, str], ...] = ((2.5, "excellent"), (2.75, "good"))
_LAST_GRADE = (3.0, "qualified")
_NO_GRADE = "outside the grades"


def weighting(frequency: ArrayLike, direction: str = "lateral") -> FloatArray | float:
    """Frequency weighting F(f) of the amplitude form (GB/T 5599-2019).

    Lateral: 0.8 f^2 below 5.4 Hz, 650/f^2 below 26 Hz, then 1. Vertical: 0.325 f^2 below 5.9 Hz,
    400/f^2 below 20 Hz, then 1. At a break the upper branch holds; the lateral branches do not
    quite meet (23.33 and 22.29 at 5.4 Hz, 0.96 and 1 at 26 Hz). The branches are not cut at
    the ends of the band: `sperling` leaves the lines outside it out.

    Args:
        frequency: Frequencies [Hz], any shape, not negative.
        direction: "lateral" or "vertical".

    Returns:
        The weighting [1], same shape; a float for a number.

    Raises:
        ArgumentError: The direction is unknown or a frequency is negative or not finite.
    """
    _known("direction", direction, _DIRECTIONS)
    f = as_frequency(frequency)
    low, high = (_EDGE * f_break for f_break in _BREAKS[direction])
    fall = _FALL[direction] / np.maximum(f, low) ** 2
    return float_if_single(
        np.where(f < low, _RISE[direction] * f**2, np.where(f < high, fall, 1.0))
    )


def sperling_filter(
    frequency: ArrayLike, kind: str = "comfort", direction: str = "lateral"
) -> FloatArray | float:
    """Weighting B(f) of the original ride index, for accelerations in cm/s^2 [S2].

    Comfort, with k = 0.737 lateral and 0.588 vertical::

        B = k sqrt((1.911 f^2 + (0.25 f^2)^2)
                   / ((1 - 0.277 f^2)^2 + (1.563 f - 0.0368 f^3)^2))

    Ride quality, the same in both directions::

        B = 1.14 sqrt((((1 - 0.056 f^2)^2 + (0.645 f)^2) 3.55 f^2)
                      / (((1 - 0.252 f^2)^2 + (1.547 f - 0.00444 f^3)^2) (1 + 3.55 f^2)))

    In sperling.m of [S2] the factor 3.55 f^2 multiplies (0.645 f)^2 alone. That would weigh a
    constant acceleration with 1.14, where a ride filter must go to zero as the comfort filter does,
    so it is taken for a misplaced bracket.

    Args:
        frequency: Frequencies [Hz], any shape, not negative.
        kind: "comfort" (what a passenger feels) or "quality" (how the vehicle runs).
        direction: "lateral" or "vertical"; makes no difference to "quality".

    Returns:
        The weighting, same shape; a float for a number.

    Raises:
        ArgumentError: A name is unknown, or a frequency is negative or not finite.
    """
    _known("kind", kind, _KINDS)
    _known("direction", direction, _DIRECTIONS)
    f = as_frequency(frequency)
    f2 = f**2
    if kind == "comfort":
        rise = 1.911 * f2 + (0.25 * f2) ** 2
        fall = (1.0 - 0.277 * f2) ** 2 + (1.563 * f - 0.0368 * f**3) ** 2
        return float_if_single(np.asarray(_COMFORT_GAIN[direction] * np.sqrt(rise / fall)))
    rise = ((1.0 - 0.056 * f2) ** 2 + (0.645 * f) ** 2) * 3.55 * f2
    fall = ((1.0 - 0.252 * f2) ** 2 + (1.547 * f - 0.00444 * f**3) ** 2) * (1.0 + 3.55 * f2)
    return float_if_single(np.asarray(_QUALITY_GAIN * np.sqrt(rise / fall)))


def sperling_segments(
    acceleration: ArrayLike,
    sample_rate: float,
    *,
    direction: str = "lateral",
    segment: float = SPERLING_SEGMENT,
    overlap: float = 0.0,
    window: str = "boxcar",
    band: tuple[float, float] = SPERLING_BAND,
) -> FloatArray:
    """Ride index of every segment of a signal, amplitude form (GB/T 5599-2019).

    W = (sum W_i^10)^0.1 with W_i = 3.57 (A_i^3 F(f_i) / f_i)^0.1 over the FFT lines in the band,
    A_i the single-sided amplitude [m/s^2]. See the module's text for what is fixed besides.

    Args:
        acceleration: Signal [m/s^2], shape (..., time).
        sample_rate: Samples per second [Hz], above twice the upper end of the band.
        direction: "lateral" or "vertical".
        segment: Length of a segment [s], a whole number of samples.
        overlap: Share of a segment repeated by the next, from 0 to below 1, in whole samples.
        window: "boxcar", "hann", "hamming", "blackman" or "flattop".
        band: Lowest and highest frequency that count, both included [Hz].

    Returns:
        The index of each segment [1], shape (..., segments).

    Raises:
        ArgumentError: An argument breaks one of the rules above, a sample is not finite, or the
            signal is shorter than one segment.
    """
    _known("direction", direction, _DIRECTIONS)
    spectrum = _Spectrum(acceleration, sample_rate, segment, overlap, window, band)
    f = spectrum.frequency
    total = np.sum(spectrum.amplitude() ** 3 * (weighting(f, direction) / f), axis=-1)
    return np.asarray(_INDEX_CONSTANT * total**0.1, dtype=np.float64)


def sperling(
    acceleration: ArrayLike,
    sample_rate: float,
    *,
    direction: str = "lateral",
    segment: float = SPERLING_SEGMENT,
    overlap: float = 0.0,
    window: str = "boxcar",
    aggregate: str = "mean",
    band: tuple[float, float] = SPERLING_BAND,
) -> FloatArray | float:
    """Sperling's ride index Wz of a signal, amplitude form (GB/T 5599-2019).

    The indices of the segments, `sperling_segments`, combined over the record.

    Args:
        acceleration: Signal [m/s^2], shape (..., time).
        sample_rate: Samples per second [Hz], above twice the upper end of the band.
        direction: "lateral" or "vertical".
        segment: Length of a segment [s], a whole number of samples.
        overlap: Share of a segment repeated by the next, from 0 to below 1, in whole samples.
        window: "boxcar", "hann", "hamming", "blackman" or "flattop".
        aggregate: "mean" of the segments' indices, or "max".
        band: Lowest and highest frequency that count, both included [Hz].

    Returns:
        The index [1], shape (...); a float for a single signal.

    Raises:
        ArgumentError: An argument breaks one of the rules above, a sample is not finite, or the
            signal is shorter than one segment.
    """
    _known("aggregate", aggregate, _AGGREGATES)
    segments = sperling_segments(
        acceleration,
        sample_rate,
        direction=direction,
        segment=segment,
        overlap=overlap,
        window=window,
        band=band,
    )
    return _combined(segments, aggregate)


def sperling_original(
    acceleration: ArrayLike,
    sample_rate: float,
    *,
    kind: str = "comfort",
    direction: str = "lateral",
    form: str = "lines",
    segment: float = SPERLING_SEGMENT,
    overlap: float = 0.0,
    window: str = "boxcar",
    aggregate: str | None = None,
    band: tuple[float, float] = SPERLING_BAND,
) -> FloatArray | float:
    """Sperling's ride index Wz in its original forms, with the filter B(f) [S2].

    With a in cm/s^2, "lines" is Wz = (sum a_i^3 B_i^3)^0.1 per segment, a_i the single-sided
    amplitude of a line. "integral" is Wz = (2 integral of G(f) B(f)^2 df)^(1/6.67), G the single-
    sided power spectral density after Welch (mean over all segments), as a sum over the lines in
    the band. The factor 2 stands in both programs of [S2]: G holds half the square of an amplitude,
    and with the factor both forms give a sine the same index, (a B)^0.3. Where it is left out, the
    index is 0.90 of this one.

    On anything but a sine the two are different indices. The integral form hardly depends on the
    segments' length, the line form does. The sources stop at 30 Hz or not at all; B is small there.

    Args:
        acceleration: Signal [m/s^2], shape (..., time); converted to cm/s^2 inside.
        sample_rate: Samples per second [Hz], above twice the upper end of the band.
        kind: "comfort" or "quality", see `sperling_filter`.
        direction: "lateral" or "vertical"; makes no difference to "quality".
        form: "lines" or "integral".
        segment: Length of a segment [s], a whole number of samples.
        overlap: Share of a segment repeated by the next, from 0 to below 1, in whole samples.
        window: "boxcar", "hann", "hamming", "blackman" or "flattop".
        aggregate: For "lines": "mean" of the segments' indices (also if None), or "max". The
            integral form averages spectra, not indices; it takes None only.
        band: Lowest and highest frequency that count, both included [Hz].

    Returns:
        The index [1], shape (...); a float for a single signal.

    Raises:
        ArgumentError: An argument breaks one of the rules above, a sample is not finite, or the
            signal is shorter than one segment.
    """
    _known("form", form, _FORMS)
    if aggregate is not None:
        _known("aggregate", aggregate, _AGGREGATES)
        if form == "integral":
            raise ArgumentError(
                f"aggregate = {aggregate!r} has no meaning with form = 'integral', which averages "
                "spectra; leave it out or use form = 'lines'"
            )
    _known("kind", kind, _KINDS)
    _known("direction", direction, _DIRECTIONS)
    spectrum = _Spectrum(acceleration, sample_rate, segment, overlap, window, band)
    b = sperling_filter(spectrum.frequency, kind, direction)
    if form == "lines":
        lines = np.sum((_CENTIMETRES * spectrum.amplitude() * b) ** 3, axis=-1) ** 0.1
        return _combined(np.asarray(lines, dtype=np.float64), aggregate or "mean")
    density = np.mean(spectrum.density(), axis=-2) * _CENTIMETRES**2
    power = 2.0 * np.sum(density * np.square(b), axis=-1) * spectrum.spacing
    return float_if_single(np.asarray(power ** (1.0 / _INTEGRAL_ROOT), dtype=np.float64))


def grade(index: float) -> str:
    """Name the grade of a ride index (GB/T 5599, passenger vehicles).

    Below 2.5 "excellent", from 2.5 "good", from 2.75 up to and including 3.0 "qualified", above
    that "outside the grades". To which side a limit itself belongs is this project's reading.

    Args:
        index: Ride index of `sperling` [1], not negative.

    Returns:
        The grade in words.

    Raises:
        ArgumentError: The index is negative or not finite.
    """
    value = check_not_negative("index", index)
    for limit, name in _GRADES:
        if value < limit:
            return name
    limit, name = _LAST_GRADE
    return name if value <= limit else _NO_GRADE


class _Spectrum:
    """The FFT lines in the band of every segment of a signal.

    Attributes:
        frequency: Frequencies of the lines in the band [Hz], shape (lines,).
        spacing: Distance of two lines [Hz].
    """

    def __init__(
        self,
        acceleration: ArrayLike,
        sample_rate: float,
        segment: float,
        overlap: float,
        window: str,
        band: tuple[float, float],
    ) -> None:
        signal = as_signal("acceleration", acceleration)
        lower, upper = _checked_band(band)
        self._sample_rate = sampled_above(sample_rate, upper)
        length = whole_samples("segment", segment, self._sample_rate)
        step = segment_step(overlap, length)
        self._window = window_samples(window, length)
        pieces = cut("acceleration", signal, length, step)
        frequency = np.arange(length // 2 + 1) * self._sample_rate / length
        inside = (frequency >= lower * _EDGE) & (frequency <= upper / _EDGE)
        if not bool(np.any(inside)):
            raise ArgumentError(
                f"segment = {segment:g} s has no spectral line from {lower:g} to {upper:g} Hz; "
                "use longer segments"
            )
        self.frequency: FloatArray = frequency[inside]
        self.spacing = self._sample_rate / length
        centred = pieces - np.mean(pieces, axis=-1, keepdims=True)
        # Neither the zero line nor the one at Nyquist is inside, so each has its mirror image: x2.
        self._magnitude: FloatArray = np.abs(np.fft.rfft(centred * self._window)[..., inside])

    def amplitude(self) -> FloatArray:
        """Single-sided amplitudes [m/s^2], shape (..., segments, lines)."""
        return 2.0 * self._magnitude / np.sum(self._window)

    def density(self) -> FloatArray:
        """Single-sided power spectral densities [m^2/s^4/Hz], shape (..., segments, lines)."""
        return 2.0 * self._magnitude**2 / (self._sample_rate * np.sum(self._window**2))


def _checked_band(band: tuple[float, float]) -> tuple[float, float]:
    if len(band) != 2:
        raise ArgumentError(f"band = {band!r} needs two frequencies; give (lowest, highest) in Hz")
    lower = check_finite("band[0]", band[0], "Hz")
    upper = check_finite("band[1]", band[1], "Hz")
    if not 0.0 < lower < upper:
        raise ArgumentError(
            f"band = ({lower:g}, {upper:g}) is not a band; give 0 < lowest < highest in Hz"
        )
    return lower, upper


def _combined(segments: FloatArray, aggregate: str) -> FloatArray | float:
    reduced = np.max(segments, axis=-1) if aggregate == "max" else np.mean(segments, axis=-1)
    return float_if_single(np.asarray(reduced, dtype=np.float64))


def _known(kind: str, name: str, names: tuple[str, ...]) -> None:
    if name not in names:
        raise unknown_name(kind, name, names)
