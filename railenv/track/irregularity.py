"""Track irregularity along the line: realised from a spectrum, measured, or none.

A `Track` holds the channels of `railenv.track.spectra` on a uniform grid of distance, which starts
at 0 [m]; between grid points a cubic spline runs, and before 0 the track is straight and level.
Signs are those of the channels: alignment and gauge as sideways lengths, vertical as height,
cross level as the right rail's drop below the left, all in metres.

This module does not know vehicles, speeds or which side alignment counts as positive: that is the
vehicle's choice of axes. It knows no curve and no cant either.
"""

import math
import os
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from types import MappingProxyType
from zlib import crc32

import numpy as np
from numpy.typing import ArrayLike
from scipy.interpolate import CubicSpline

from railenv.errors import (
    ArgumentError,
    check_count,
    check_finite,
    check_not_negative,
    check_positive,
    unknown_name,
)
from railenv.track.measured import read_columns
from railenv.track.spectra import (
    CHANNELS,
    Spectrum,
    band,
    check_channel,
    get_spectrum,
    spectrum_names,
)
from railenv.units import FloatArray, Metre

# A cubic spline through n points per wavelength misses a sine by about (2 pi / n)^4 / 384 of its
# amplitude. Measured on the 2 m wave: 1.2e-3 at n = 8 (0.25 m), 6.4e-5 at n = 16 (0.125 m).
_POINTS_PER_SHORTEST_WAVE = 16
_FEWEST_POINTS_PER_WAVE = 8
# The grid repeats after at least this many of the longest waves, so that its lowest harmonics
# resolve the steep lower end of the band. For 200 m it comes to 4096 m at the default spacing.
_LONGEST_WAVES_PER_PERIOD = 20
_MOST_POINTS = 2**27
"""Largest realisable grid: 1 GiB per channel."""
_END_TOLERANCE = 1e-6
"""Share of a grid step by which a position may exceed the end, as rounding in v t does."""


@dataclass(frozen=True, eq=False)
class Track:
    """Track irregularity on a uniform grid of distance.

    Attributes:
        name: What the track is, for records.
        spacing: Distance between grid points [m].
        channels: Channel name to its values [m] at 0, spacing, 2 spacing, ...; all of one length.
            They are copied and made read-only. A channel that is absent is zero.

    Raises:
        ArgumentError: A channel is unknown, not one-dimensional, not finite, too short or not as
            long as the others.
    """

    name: str
    spacing: Metre
    channels: Mapping[str, FloatArray]

    def __post_init__(self) -> None:
        check_positive("spacing", self.spacing, "m")
        if not self.channels:
            raise ArgumentError(f"track {self.name!r} has no channel; give at least one")
        frozen = {
            check_channel(channel): np.array(values, dtype=np.float64)
            for channel, values in self.channels.items()
        }
        shape = next(iter(frozen.values())).shape
        for channel, values in frozen.items():
            if values.ndim != 1 or values.shape != shape or len(values) < 2:
                raise ArgumentError(
                    f"channel {channel!r} has shape {values.shape}; give all channels as 1-D "
                    "arrays of one length, 2 points or more"
                )
            finite = np.isfinite(values)
            if not bool(np.all(finite)):
                raise ArgumentError(
                    f"channel {channel!r} is not finite at point {int(np.argmin(finite))}; "
                    "give finite lengths in m"
                )
            values.setflags(write=False)
        object.__setattr__(self, "channels", MappingProxyType(frozen))

    def __reduce__(self) -> tuple[type["Track"], tuple[str, float, dict[str, FloatArray]]]:
        return Track, (self.name, self.spacing, dict(self.channels))

    @property
    def points(self) -> int:
        """Number of grid points."""
        return len(next(iter(self.channels.values())))

    @property
    def length(self) -> Metre:
        """Distance of the last grid point [m]."""
        return (self.points - 1) * self.spacing

    def sample(self, channel: str, distance: ArrayLike) -> FloatArray:
        """Return a channel's irregularity at any positions.

        Args:
            channel: One of `CHANNELS`; zero everywhere if this track does not hold it.
            distance: Positions [m], any shape; negative ones lie on straight level track.

        Returns:
            The irregularity [m], in the shape of `distance`.

        Raises:
            ArgumentError: The channel does not exist, or a position is not a number or lies beyond
                the end of the track.
        """
        check_channel(channel)
        positions = np.asarray(distance, dtype=np.float64)
        if positions.size == 0:
            return np.zeros(positions.shape)
        # written so that a NaN, which no comparison holds for, is refused as well
        if not bool(np.all(positions <= self.length + _END_TOLERANCE * self.spacing)):
            raise ArgumentError(
                f"distance = {float(np.max(positions)):g} m must not lie beyond the track "
                f"{self.name!r}, which ends at {self.length:g} m; make the track longer"
            )
        if channel not in self.channels:
            return np.zeros(positions.shape)
        inside = np.clip(positions, 0.0, self.length)
        return np.where(positions < 0.0, 0.0, self._spline(channel)(inside))

    def scaled(self, factor: float) -> "Track":
        """Return a track with every irregularity multiplied by `factor` [1].

        Raises:
            ArgumentError: The factor is not finite.
        """
        by = check_finite("factor", factor)
        values = {channel: by * values for channel, values in self.channels.items()}
        return Track(f"{self.name}, times {by:g}", self.spacing, values)

    def begun(self, taper: float) -> "Track":
        """Return a track that grows from zero to the full irregularity over its first metres.

        Args:
            taper: Distance over which the weight rises, as half a cosine wave, from 0 to 1 [m]; 0
                changes nothing.

        Raises:
            ArgumentError: The taper is negative.
        """
        over = check_not_negative("taper", taper, "m")
        if over == 0.0:
            return self
        return self._weighted(self.name, _rise(self._grid() / over))

    def ended(self, distance: float, taper: float, length: float | None = None) -> "Track":
        """Return a track that is brought smoothly to zero and stays straight and level.

        The weight falls from 1 to 0 as half a cosine wave. Beyond it every grid point is exactly
        zero; the spline's own ripple there dies down fourfold per grid step.

        Args:
            distance: Where the weight begins to fall [m].
            taper: Distance over which it falls [m].
            length: Length of the new track [m], filled with zeros; default, as long as this one.

        Raises:
            ArgumentError: A value is out of range, or the fall does not end on this track.
        """
        begin = check_not_negative("distance", distance, "m")
        over = check_positive("taper", taper, "m")
        if begin + over > self.length + _END_TOLERANCE * self.spacing:
            raise ArgumentError(
                f"distance + taper = {begin + over:g} m must not lie beyond the track's end at "
                f"{self.length:g} m; end it earlier or make the track longer"
            )
        name = f"{self.name}, ended at {begin:g} m"
        track = self._weighted(name, 1.0 - _rise((self._grid() - begin) / over))
        if length is None:
            return track
        if check_positive("length", length, "m") < begin + over:
            raise ArgumentError(
                f"length = {length:g} m must reach the end of the taper at {begin + over:g} m; "
                "give a longer one"
            )
        points = _points_for(length, self.spacing)
        values = {
            channel: np.pad(values[:points], (0, max(0, points - self.points)))
            for channel, values in track.channels.items()
        }
        return Track(name, self.spacing, values)

    @cached_property
    def _splines(self) -> dict[str, CubicSpline]:
        return {}

    def _grid(self) -> FloatArray:
        return self.spacing * np.arange(self.points, dtype=np.float64)

    def _weighted(self, name: str, weight: FloatArray) -> "Track":
        values = {channel: weight * values for channel, values in self.channels.items()}
        return Track(name, self.spacing, values)

    def _spline(self, channel: str) -> CubicSpline:
        if channel not in self._splines:
            self._splines[channel] = CubicSpline(self._grid(), self.channels[channel])
        return self._splines[channel]


def realise(
    spectrum: Spectrum,
    length: float,
    seed: int | np.random.SeedSequence,
    spacing: float | None = None,
    shortest_wavelength: float = 2.0,
    longest_wavelength: float = 200.0,
    taper: float = 100.0,
    channels: Sequence[str] = CHANNELS,
) -> Track:
    """Draw a random track that has a given spectrum.

    Inverse FFT with random phases: on a grid of N points that repeats after N dx, harmonic k has
    |X_k| = sqrt(S_2 N / dx) with the two-sided density S_2 = S / 2, taken as the mean of S over
    the harmonic's share of the band. Only the phases are random, so over one period the variance
    is the band's own. The period exceeds the track by one longest wave or more.

    Every channel draws from its own stream, derived from the seed and the channel's name: what one
    channel looks like does not depend on which others are drawn. Tracks of one seed and different
    lengths agree where both exist as long as they share the period (4096 m, 8192 m, ... by
    default); otherwise they are different draws.

    Args:
        spectrum: What to realise.
        length: Length of the track [m]; rounded up to a grid point.
        seed: Whole number from 0, or a `SeedSequence`; the same seed gives the same track.
        spacing: Grid step [m]; default, a sixteenth of the shortest wavelength (see the comment at
            the top of the module for the spline's accuracy).
        shortest_wavelength: Lower end of the band [m].
        longest_wavelength: Upper end of the band [m].
        taper: Distance over which the irregularity grows from zero [m]; 0 switches it off.
        channels: The channels to draw.

    Returns:
        The track.

    Raises:
        ArgumentError: A value is out of range.
    """
    reach = check_positive("length", length, "m") + longest_wavelength
    step, period = one_period(
        spectrum, reach, seed, spacing, shortest_wavelength, longest_wavelength, channels
    )
    values = {channel: heights[: _points_for(length, step)] for channel, heights in period.items()}
    return Track(spectrum.name, step, values).begun(taper)


def one_period(
    spectrum: Spectrum,
    reach: float,
    seed: int | np.random.SeedSequence,
    spacing: float | None = None,
    shortest_wavelength: float = 2.0,
    longest_wavelength: float = 200.0,
    channels: Sequence[str] = CHANNELS,
) -> tuple[float, dict[str, FloatArray]]:
    """Realise one whole period of a spectrum, without a beginning and without an end.

    Args:
        spectrum: What to realise.
        reach: Shortest period wanted [m].
        seed: See `realise`.
        spacing: Grid step [m]; see `realise`.
        shortest_wavelength: Lower end of the band [m].
        longest_wavelength: Upper end of the band [m].
        channels: The channels to draw.

    Returns:
        The grid step [m] and, by channel, the irregularity [m] on a grid that goes on with its own
        first point after the last.

    Raises:
        ArgumentError: A value is out of range.
    """
    lower, upper = band(shortest_wavelength, longest_wavelength)
    step = shortest_wavelength / _POINTS_PER_SHORTEST_WAVE
    if spacing is not None:
        step = check_positive("spacing", spacing, "m")
    if step > shortest_wavelength / _FEWEST_POINTS_PER_WAVE:
        raise ArgumentError(
            f"spacing = {step:g} m is too coarse for waves of {shortest_wavelength:g} m; give at "
            f"most {shortest_wavelength / _FEWEST_POINTS_PER_WAVE:g} m"
        )
    wanted = check_positive("reach", reach, "m")
    period = max(wanted, _LONGEST_WAVES_PER_PERIOD * longest_wavelength)
    if period > _MOST_POINTS * step:
        raise ArgumentError(
            f"a track of {reach:g} m needs more than {_MOST_POINTS} grid points; give a shorter "
            "track or a coarser spacing"
        )
    points = 2 ** math.ceil(math.log2(period / step))
    harmonic_step = 1.0 / (points * step)
    first, last = round(lower / harmonic_step), round(upper / harmonic_step)
    harmonics = np.arange(first, last + 1, dtype=np.intp)
    edges_below = np.clip((harmonics - 0.5) * harmonic_step, lower, upper)
    edges_above = np.clip((harmonics + 0.5) * harmonic_step, lower, upper)
    values: dict[str, FloatArray] = {}
    for channel in channels:
        variance = spectrum.variance(channel, edges_below, edges_above)
        phase = _stream(seed, channel).uniform(0.0, 2.0 * math.pi, len(harmonics))
        transform = np.zeros(points // 2 + 1, dtype=np.complex128)
        # sqrt(S_2 N / dx), with S_2 = variance / (2 harmonic_step)
        transform[harmonics] = points * np.sqrt(0.5 * variance) * np.exp(1j * phase)
        values[channel] = np.fft.irfft(transform, points)
    return step, values


def flat(length: float) -> Track:
    """Return a straight level track of a given length [m].

    Raises:
        ArgumentError: The length is not positive.
    """
    spacing = check_positive("length", length, "m") / 8.0
    return Track("flat", spacing, {channel: np.zeros(9) for channel in CHANNELS})


def read_csv(path: str | os.PathLike[str]) -> Track:
    """Read a measured track; see `railenv.track.measured` for the file's format.

    The first row becomes distance 0, and nothing is resampled, filtered or tapered: a record that
    does not start at zero is a step for the vehicle that enters it (see `Track.begun`).

    Raises:
        InputFileError: The file cannot be read or does not follow the format.
    """
    spacing, columns = read_columns(path)
    return Track(os.fspath(path), spacing, columns)


def make_track(spec: str, length: float, seed: int | np.random.SeedSequence) -> Track:
    """Make a track from its description in one line.

    ``flat``; a spectrum's name; or the path of a measured file, ending in ``.csv``. The last two
    take settings, ``tb3352:level=0.693`` or ``section.csv:taper=0,level=4``: ``level`` multiplies
    the power spectral density, and so the heights by its square root (default 1); ``taper`` is the
    distance [m] over which the irregularity grows from zero (default 100 for a spectrum; 0, the
    record as it stands, for a file).

    Args:
        spec: The description.
        length: Length that is needed [m]; a measured file may be longer, and is kept whole.
        seed: See `realise`; without effect on a flat or a measured track.

    Returns:
        The track, named by `spec`.

    Raises:
        ArgumentError: The description is not understood, or a measured file is too short.
        InputFileError: A measured file cannot be used.
    """
    needed = check_positive("length", length, "m")
    name, settings = parse_spec(spec)
    if name.lower().endswith(".csv"):
        track = read_csv(name)
        if track.length + _END_TOLERANCE * track.spacing < needed:
            raise ArgumentError(
                f"track {name!r} is {track.length:g} m long and {needed:g} m are needed; give a "
                "longer file or a shorter run"
            )
        track = track.begun(settings.get("taper", 0.0)).scaled(math.sqrt(settings["level"]))
    elif name in spectrum_names():
        spectrum = get_spectrum(name).at_level(settings["level"])
        track = realise(spectrum, needed, seed, taper=settings.get("taper", 100.0))
    elif name == "flat":
        if spec != "flat":
            raise ArgumentError(f"track {spec!r}: a flat track has no settings; give 'flat'")
        track = flat(needed)
    else:
        known = ["flat", *spectrum_names(), "<a path ending in .csv>"]
        raise unknown_name("track", name, known)
    return Track(spec, track.spacing, track.channels)


def parse_spec(spec: str) -> tuple[str, dict[str, float]]:
    """Split a track's description into its name and its settings.

    Args:
        spec: See `make_track`; a path may hold colons of its own.

    Returns:
        Name, and by setting its value; "level" always, "taper" if given.

    Raises:
        ArgumentError: A setting is unknown, given twice or no number.
    """
    measured = re.fullmatch(r"(.*\.csv)(?:(:)(.*))?", spec, re.IGNORECASE | re.DOTALL)
    name, colon, text = measured.groups("") if measured else spec.partition(":")
    settings = {"level": 1.0}
    given: set[str] = set()
    for item in text.split(",") if colon else []:
        key, equals, value = item.partition("=")
        key = key.strip()
        if not equals:
            raise ArgumentError(f"track {spec!r}: {item!r} must be a setting such as level=0.693")
        if key not in ("level", "taper"):
            raise ArgumentError(
                f"track {spec!r}: {unknown_name('setting', key, ['level', 'taper'])}"
            )
        if key in given:
            raise ArgumentError(f"track {spec!r}: {key} is given twice; give it once")
        given.add(key)
        try:
            settings[key] = float(value)
        except ValueError:
            raise ArgumentError(
                f"track {spec!r}: {key} = {value!r} is not a number; give one"
            ) from None
        check_not_negative(f"track {spec!r}: {key}", settings[key])
    return name, settings


def _stream(seed: int | np.random.SeedSequence, channel: str) -> np.random.Generator:
    """Return the random stream of one channel.

    The channel enters by a checksum of a phrase, not by 0, 1, 2, ..., so that the streams are none
    of those which the caller gets by spawning from the same seed.
    """
    if not isinstance(seed, np.random.SeedSequence):
        seed = np.random.SeedSequence(check_count("seed", seed, minimum=0))
    key = crc32(f"track irregularity: {channel}".encode())
    child = np.random.SeedSequence(seed.entropy, spawn_key=(*seed.spawn_key, key))
    return np.random.Generator(np.random.PCG64(child))


def _rise(share: FloatArray) -> FloatArray:
    """Return a weight that rises from 0 at 0 to 1 at 1, with level ends (half a cosine wave)."""
    return 0.5 - 0.5 * np.cos(math.pi * np.clip(share, 0.0, 1.0))


def _points_for(length: float, spacing: float) -> int:
    """Return how many grid points reach `length`; rounding does not add one."""
    return max(2, math.ceil(length / spacing - _END_TOLERANCE) + 1)
