"""Power spectral densities of track irregularity, one function per published source.

A spectrum gives, for each of four channels, the one-sided power spectral density over the cyclic
wavenumber f = 1 / wavelength [1/m], in m^2/(1/m). Its integral over f is the variance.

Channels, all lengths in metres:

- ``alignment``: sideways position of the track's centre line;
- ``vertical``: height of the track's centre line (longitudinal level);
- ``cross_level``: the right rail's drop below the left;
- ``gauge``: widening of the distance between the rails.

Sources written over the angular wavenumber Omega = 2 pi f [rad/m] are converted by
S(f) = 2 pi S(Omega).

This module does not know phases, seeds or distances (see `railenv.track.irregularity`), and it
does not refuse wavelengths outside a source's band: there the formula is merely extrapolated.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from types import MappingProxyType
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from railenv.errors import (
    ArgumentError,
    check_count,
    check_finite,
    check_not_negative,
    check_positive,
    unknown_name,
)
from railenv.units import Dimensionless, FloatArray, Metre

CHANNELS: tuple[str, ...] = ("alignment", "vertical", "cross_level", "gauge")
"""The names of the irregularity channels."""

# Eight nodes per interval: the power laws are straight lines and the rational forms smooth curves
# in the logarithm of the wavenumber, so over the narrow intervals used here the rule is exact to
# rounding.
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(8)
_INTERVALS = 64


class ChannelDensity(Protocol):
    """One-sided density of one channel over the cyclic wavenumber."""

    @property
    def breaks(self) -> tuple[float, ...]:
        """Wavenumbers [1/m] at which the formula changes."""
        ...

    def __call__(self, wavenumber: FloatArray) -> FloatArray:
        """Return the density [m^2/(1/m)] at positive wavenumbers [1/m]."""
        ...


@dataclass(frozen=True)
class PowerLawDensity:
    """Density that is a power law between breaks: S(f) = A_i / f^n_i.

    Attributes:
        breaks: Wavenumbers [1/m] where one segment ends and the next begins, ascending.
        amplitudes_mm: A_i of each segment [mm^2 (1/m)^(n_i - 1)].
        exponents: n_i of each segment [1].
    """

    breaks: tuple[float, ...]
    amplitudes_mm: tuple[float, ...]
    exponents: tuple[float, ...]

    def __call__(self, wavenumber: FloatArray) -> FloatArray:
        """Return the density [m^2/(1/m)] at positive wavenumbers [1/m]."""
        segment = np.searchsorted(np.array(self.breaks), wavenumber, side="right")
        amplitude = 1e-6 * np.array(self.amplitudes_mm)[segment]  # mm^2 to m^2
        return amplitude * wavenumber ** -np.array(self.exponents)[segment]


@dataclass(frozen=True)
class RationalDensity:
    """Density over Omega = 2 pi f: S(Omega) = a Omega^z / prod_i (Omega^2 + corner_i^2).

    Attributes:
        amplitude: a [m^2 (rad/m)^(2 len(corners) - z - 1)].
        corners: Corner wavenumbers [rad/m]; 0 makes a factor 1 / Omega^2.
        zeros: z, the power of Omega in the numerator, 0 or 2.
    """

    amplitude: float
    corners: tuple[float, ...]
    zeros: int = 0

    @property
    def breaks(self) -> tuple[float, ...]:
        """Wavenumbers [1/m] at which the formula changes: none."""
        return ()

    def __call__(self, wavenumber: FloatArray) -> FloatArray:
        """Return the density [m^2/(1/m)] at positive wavenumbers [1/m]."""
        angular = 2.0 * math.pi * wavenumber
        density = np.full_like(angular, self.amplitude)
        density *= angular**self.zeros
        for corner in self.corners:
            density /= angular**2 + corner**2
        return 2.0 * math.pi * density


@dataclass(frozen=True)
class Spectrum:
    """Power spectral densities of the four channels of track irregularity.

    Attributes:
        name: Name in the registry.
        description: What track it stands for, and what reading of the source was chosen.
        source: Where formula and numbers come from.
        shortest_wavelength: Lower end of the band it is used for [m].
        longest_wavelength: Upper end of the band it is used for [m].
        alignment: Density of the alignment.
        vertical: Density of the vertical irregularity.
        cross_level: Density of the cross level.
        gauge: Density of the gauge.
        level: Factor on all four densities [1]; heights grow with its square root.
    """

    name: str
    description: str
    source: str
    shortest_wavelength: Metre
    longest_wavelength: Metre
    alignment: ChannelDensity
    vertical: ChannelDensity
    cross_level: ChannelDensity
    gauge: ChannelDensity
    level: Dimensionless = 1.0

    def density(self, channel: str, wavenumber: ArrayLike) -> FloatArray:
        """Return the one-sided power spectral density over the cyclic wavenumber.

        Args:
            channel: One of `CHANNELS`.
            wavenumber: Cyclic wavenumber f [1/m], any shape, above zero.

        Returns:
            S(f) [m^2/(1/m)], in the shape of `wavenumber`.

        Raises:
            ArgumentError: The channel does not exist or a wavenumber is not positive.
        """
        channel_density = self._channel(channel)
        values = np.asarray(wavenumber, dtype=np.float64)
        if not bool(np.all((values > 0.0) & np.isfinite(values))):
            raise ArgumentError(
                "wavenumber must be above zero and finite everywhere; give 1 / wavelength [1/m]"
            )
        return self.level * channel_density(values)

    def angular_density(self, channel: str, angular_wavenumber: ArrayLike) -> FloatArray:
        """Return the one-sided density over the angular wavenumber, S(Omega) = S(f) / (2 pi).

        Args:
            channel: One of `CHANNELS`.
            angular_wavenumber: Omega = 2 pi f [rad/m], any shape, above zero.

        Returns:
            S(Omega) [m^2/(rad/m)], in the shape of `angular_wavenumber`.

        Raises:
            ArgumentError: The channel does not exist or a wavenumber is not positive.
        """
        angular = np.asarray(angular_wavenumber, dtype=np.float64)
        return self.density(channel, angular / (2.0 * math.pi)) / (2.0 * math.pi)

    def variance(
        self, channel: str, lower_wavenumber: ArrayLike, upper_wavenumber: ArrayLike
    ) -> FloatArray:
        """Integrate the density over intervals of cyclic wavenumber, each by one Gauss rule.

        Accurate to rounding where an interval spans a small ratio and no break of the formula; see
        `rms` for a wide band.

        Args:
            channel: One of `CHANNELS`.
            lower_wavenumber: Lower ends [1/m], above zero.
            upper_wavenumber: Upper ends [1/m], of the same shape, not below the lower ends.

        Returns:
            The variance within each interval [m^2].

        Raises:
            ArgumentError: The channel does not exist or a wavenumber is not positive.
        """
        lower = np.log(np.asarray(lower_wavenumber, dtype=np.float64))[..., np.newaxis]
        upper = np.log(np.asarray(upper_wavenumber, dtype=np.float64))[..., np.newaxis]
        wavenumber = np.exp(0.5 * (lower + upper) + 0.5 * (upper - lower) * _NODES)
        # df = f d(ln f)
        integrand = self.density(channel, wavenumber) * wavenumber
        return np.sum(0.5 * (upper - lower) * _WEIGHTS * integrand, axis=-1)

    def rms(
        self, channel: str, shortest_wavelength: float = 2.0, longest_wavelength: float = 200.0
    ) -> float:
        """Return the root mean square of a channel within a band of wavelengths.

        Args:
            channel: One of `CHANNELS`.
            shortest_wavelength: Lower end of the band [m].
            longest_wavelength: Upper end of the band [m].

        Returns:
            The square root of the integral of S(f) over the band [m].

        Raises:
            ArgumentError: The channel does not exist or the band is empty.
        """
        lower, upper = band(shortest_wavelength, longest_wavelength)
        breaks = [edge for edge in self._channel(channel).breaks if lower < edge < upper]
        edges = np.union1d(np.geomspace(lower, upper, _INTERVALS + 1), breaks)
        return math.sqrt(float(np.sum(self.variance(channel, edges[:-1], edges[1:]))))

    def at_level(self, level: float) -> "Spectrum":
        """Return this spectrum with every density multiplied by `level` (see `percentile_level`).

        Raises:
            ArgumentError: The level is negative or not finite.
        """
        return replace(self, level=self.level * check_not_negative("level", level))

    def _channel(self, channel: str) -> ChannelDensity:
        densities = {
            "alignment": self.alignment,
            "vertical": self.vertical,
            "cross_level": self.cross_level,
            "gauge": self.gauge,
        }
        return densities[check_channel(channel)]


def check_channel(channel: str) -> str:
    """Return `channel`, or raise `ArgumentError` unless it is one of `CHANNELS`."""
    if channel not in CHANNELS:
        raise unknown_name("track channel", channel, CHANNELS)
    return channel


def band(shortest_wavelength: float, longest_wavelength: float) -> tuple[float, float]:
    """Return the lowest and the highest cyclic wavenumber [1/m] of a band of wavelengths [m].

    Raises:
        ArgumentError: A wavelength is not positive, or the shortest is not below the longest.
    """
    shortest = check_positive("shortest_wavelength", shortest_wavelength, "m")
    longest = check_positive("longest_wavelength", longest_wavelength, "m")
    if shortest >= longest:
        raise ArgumentError(
            f"shortest_wavelength = {shortest:g} m must be below "
            f"longest_wavelength = {longest:g} m; exchange or widen them"
        )
    return 1.0 / longest, 1.0 / shortest


def percentile_level(probability: float) -> float:
    """Return the level below which a given share of track lies, relative to the mean spectrum.

    At one wavenumber the periodogram is the mean density times half a chi-squared variable with
    two degrees of freedom, so S_p = S_mean (-ln(1 - p)) (Liu, Li and Wang 2014,
    doi 10.4203/ccp.104.97).

    Args:
        probability: Share p of the track, 0 <= p < 1; 0.5 is the median, 0.693 times the mean.

    Returns:
        The factor on the mean density [1].

    Raises:
        ArgumentError: The probability is outside 0 <= p < 1.
    """
    share = check_finite("probability", probability)
    if not 0.0 <= share < 1.0:
        raise ArgumentError(f"probability = {share:g} must be at least 0 and below 1; e.g. 0.5")
    return -math.log1p(-share)


def tb3352_ballastless() -> Spectrum:
    """Mean spectrum of Chinese high-speed ballastless track, TB/T 3352-2014.

    S(f) = A_i / f^n_i per segment, S in mm^2/(1/m), f in 1/m, one-sided as published.

    The coefficients are those on which three public implementations agree; the standard's own text
    was not at hand.
    """
    return Spectrum(
        name="tb3352",
        description=(
            "Chinese high-speed ballastless track, mean level; published for 300 to 350 km/h and "
            "wavelengths from 2 m, beyond 120 m an extrapolation; one-sided over cyclic wavenumber"
        ),
        source="TB/T 3352-2014",
        shortest_wavelength=2.0,
        longest_wavelength=200.0,
        alignment=PowerLawDensity(
            breaks=(0.0450, 0.1234),
            amplitudes_mm=(3.9513e-3, 1.1047e-2, 7.5633e-4),
            exponents=(1.8670, 1.5354, 2.8171),
        ),
        vertical=PowerLawDensity(
            breaks=(0.0187, 0.0474, 0.1533),
            amplitudes_mm=(1.0544e-5, 3.5588e-3, 1.9784e-2, 3.9488e-4),
            exponents=(3.3891, 1.9271, 1.3643, 3.4516),
        ),
        cross_level=PowerLawDensity(
            breaks=(0.0258, 0.1163),
            amplitudes_mm=(3.6148e-3, 4.3685e-2, 4.5867e-3),
            exponents=(1.7278, 1.0461, 2.0939),
        ),
        gauge=PowerLawDensity(
            breaks=(0.1090, 0.2938),
            amplitudes_mm=(5.4978e-2, 5.0701e-3, 1.8778e-4),
            exponents=(0.8282, 1.9037, 4.5948),
        ),
    )


def german_low() -> Spectrum:
    """German spectrum of low interference (high-speed track), ERRI B176; see `german_high`."""
    return _german("german_low", "low", align=2.119e-7, vert=4.032e-7, gauge=5.32e-8)


def german_high() -> Spectrum:
    """German spectrum of high interference (ordinary track), ERRI B176.

    With corners Omega_c, Omega_r, Omega_s [rad/m] and amplitudes A [m^2 rad/m]:

    - alignment, vertical: S = A Omega_c^2 / ((Omega^2 + Omega_r^2) (Omega^2 + Omega_c^2));
    - gauge: S = A_g Omega_c^2 Omega^2 / (the same two factors times (Omega^2 + Omega_s^2));
    - cross level: published as the angle's density with A_v / b^2 in the place of A_g, b = 0.75 m
      half the distance of the rails; the height difference is 2 b times the angle, so the density
      is multiplied by (2 b)^2.

    Authors read these as one-sided or as two-sided. Here they are one-sided in the angular
    wavenumber, the integral over Omega > 0 alone being the variance; the two-sided reading would
    double every density, and make every RMS larger by the square root of two.
    """
    return _german("german_high", "high", align=6.125e-7, vert=1.080e-6, gauge=1.032e-7)


def _german(name: str, interference: str, align: float, vert: float, gauge: float) -> Spectrum:
    corner_c, corner_r, corner_s = 0.8246, 0.0206, 0.4380  # rad/m
    half_rail_distance = 0.75  # b [m]
    angle = vert / half_rail_distance**2
    wide = (corner_r, corner_c)
    narrow = (corner_r, corner_c, corner_s)
    return Spectrum(
        name=name,
        description=(
            f"German track of {interference} interference; read as one-sided over the angular "
            "wavenumber; the source states no band, 2 to 200 m is the project's"
        ),
        source="ERRI B176 (German spectra)",
        shortest_wavelength=2.0,
        longest_wavelength=200.0,
        alignment=RationalDensity(align * corner_c**2, wide),
        vertical=RationalDensity(vert * corner_c**2, wide),
        cross_level=RationalDensity(
            (2.0 * half_rail_distance) ** 2 * angle * corner_c**2, narrow, zeros=2
        ),
        gauge=RationalDensity(gauge * corner_c**2, narrow, zeros=2),
    )


_FRA_COEFFICIENTS: Mapping[int, tuple[float, float, float]] = MappingProxyType(
    {
        # class: Omega_s [rad/m], A_v [cm^2 rad/m], A_a [cm^2 rad/m]
        1: (0.6046, 1.2107, 3.3634),
        2: (0.9308, 1.0181, 1.2107),
        3: (0.8520, 0.6816, 0.4128),
        4: (1.1312, 0.5376, 0.3027),
        5: (0.8209, 0.2095, 0.0762),
        6: (0.4380, 0.0339, 0.0339),
    }
)


def fra(track_class: int) -> Spectrum:
    """Spectrum of a track class of the Federal Railroad Administration (United States).

    - alignment, vertical: S = k A Omega_c^2 / (Omega^2 (Omega^2 + Omega_c^2));
    - cross level, gauge: S = 4 k A_v Omega_c^2 / ((Omega^2 + Omega_c^2) (Omega^2 + Omega_s^2)).

    S in cm^2/(rad/m), converted to m^2 by 1e-4; k = 0.25, Omega_c = 0.8245 rad/m; read as
    one-sided in the angular wavenumber. Some texts print k = 1, which is `at_level(4.0)`.

    Args:
        track_class: 1 (worst) to 6 (best).

    Returns:
        The spectrum.

    Raises:
        ArgumentError: The class does not exist.
    """
    number = check_count("track_class", track_class)
    if number not in _FRA_COEFFICIENTS:
        raise ArgumentError(f"track_class = {number} does not exist; give 1 to 6")
    corner_s, vert, align = _FRA_COEFFICIENTS[number]
    corner_c, factor = 0.8245, 0.25  # Omega_c [rad/m], k [1]
    scale = 1e-4 * factor * corner_c**2  # cm^2 to m^2
    both_rails = RationalDensity(4.0 * scale * vert, (corner_c, corner_s))
    return Spectrum(
        name=f"fra{number}",
        description=(
            f"United States track of class {number}, k = 0.25; read as one-sided over the angular "
            "wavenumber; 2 to 200 m is the project's band"
        ),
        source="FRA classes, Omega_c form with k = 0.25 as tabulated in textbooks",
        shortest_wavelength=2.0,
        longest_wavelength=200.0,
        alignment=RationalDensity(scale * align, (0.0, corner_c)),
        vertical=RationalDensity(scale * vert, (0.0, corner_c)),
        cross_level=both_rails,
        gauge=both_rails,
    )


_REGISTRY: Mapping[str, Callable[[], Spectrum]] = MappingProxyType(
    {
        "german_high": german_high,
        "german_low": german_low,
        "tb3352": tb3352_ballastless,
        **{f"fra{number}": partial(fra, number) for number in _FRA_COEFFICIENTS},
    }
)


def spectrum_names() -> list[str]:
    """List the names of all spectra, sorted."""
    return sorted(_REGISTRY)


def get_spectrum(name: str) -> Spectrum:
    """Return the spectrum of a name.

    Raises:
        ArgumentError: No spectrum has that name.
    """
    if name not in _REGISTRY:
        raise unknown_name("track spectrum", name, _REGISTRY)
    return _REGISTRY[name]()
