import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad

from railenv.errors import ArgumentError
from railenv.track import (
    CHANNELS,
    fra,
    german_high,
    german_low,
    get_spectrum,
    percentile_level,
    spectrum_names,
    tb3352_ballastless,
)
from railenv.track.spectra import PowerLawDensity

TWO_PI = 2.0 * math.pi

# RMS of TB/T 3352-2014 over 2 to 200 m [mm], as a public implementation tests it: 8 digits.
TB3352_FULL_BAND = {
    "vertical": 1.2203026,
    "alignment": 0.6677926,
    "cross_level": 0.5235391,
    "gauge": 0.3437111,
}

# The same in narrower bands [mm], computed apart from this project's code: 3 digits.
TB3352_BANDS = {
    (2.0, 120.0): (0.715, 0.534, 0.449, 0.326),
    (3.0, 25.0): (0.286, 0.261, 0.288, 0.246),
    (25.0, 70.0): (0.362, 0.327, 0.246, 0.173),
    (70.0, 150.0): (0.765, 0.412, 0.285, 0.138),
}

# High level in GENSYS, user's manual, program TRC_IPSD, "ORE B176 high level" [m^2/(1/m)]:
# 1/314.16, 0.02, 0.1 and 0.2 1/m.
GENSYS_WAVENUMBERS = (1.0 / 314.16, 0.02, 0.1, 0.2)
GENSYS_ALIGNMENT = (4.6657e-03, 2.3194e-04, 6.1608e-06, 7.3333e-07)
GENSYS_VERTICAL = (8.2268e-03, 4.0897e-04, 1.0863e-05, 1.2931e-06)


def band_edges(shortest: float = 2.0, longest: float = 200.0) -> tuple[float, float]:
    """Angular wavenumbers of a band [rad/m]."""
    return TWO_PI / longest, TWO_PI / shortest


@pytest.mark.parametrize("channel", CHANNELS)
def test_tb3352_has_the_published_rms_between_2_and_200_m(channel: str) -> None:
    rms_mm = 1e3 * tb3352_ballastless().rms(channel, 2.0, 200.0)
    # half a unit of the last printed digit
    assert rms_mm == pytest.approx(TB3352_FULL_BAND[channel], abs=0.5e-7)


@pytest.mark.parametrize("wavelengths", TB3352_BANDS)
def test_tb3352_has_the_tabulated_rms_in_narrow_bands(wavelengths: tuple[float, float]) -> None:
    channels = ("vertical", "alignment", "cross_level", "gauge")
    rms_mm = [1e3 * tb3352_ballastless().rms(channel, *wavelengths) for channel in channels]
    # half a unit of the last printed digit
    assert rms_mm == pytest.approx(TB3352_BANDS[wavelengths], abs=0.5e-3)


@pytest.mark.parametrize("channel", CHANNELS)
def test_tb3352_rms_equals_the_closed_form_of_its_power_laws(channel: str) -> None:
    law = getattr(tb3352_ballastless(), channel)
    edges = [1.0 / 200.0, *law.breaks, 1.0 / 2.0]
    variance_mm2 = sum(
        amplitude * (high ** (1.0 - n) - low ** (1.0 - n)) / (1.0 - n)
        for low, high, amplitude, n in zip(
            edges[:-1], edges[1:], law.amplitudes_mm, law.exponents, strict=True
        )
    )
    # rounding of about 70 summands
    assert tb3352_ballastless().rms(channel) == pytest.approx(
        1e-3 * math.sqrt(variance_mm2), rel=1e-13
    )


@pytest.mark.parametrize("channel", CHANNELS)
def test_tb3352_segments_meet_at_their_breaks(channel: str) -> None:
    breaks = np.array(getattr(tb3352_ballastless(), channel).breaks)
    below = tb3352_ballastless().density(channel, breaks * (1.0 - 1e-12))
    above = tb3352_ballastless().density(channel, breaks * (1.0 + 1e-12))
    # The coefficients are printed to five digits and the breaks to three or four; at exponents up
    # to 3.4 the largest mismatch is 0.4 % (vertical, 0.0187 1/m).
    np.testing.assert_allclose(below, above, rtol=0.005)


def test_power_law_is_evaluated_segment_by_segment() -> None:
    law = PowerLawDensity(breaks=(1.0,), amplitudes_mm=(2.0, 3.0), exponents=(1.0, 2.0))
    density_mm = 1e6 * law(np.array([0.5, 1.0, 2.0]))
    # three roundings each
    np.testing.assert_allclose(density_mm, [4.0, 3.0, 0.75], rtol=1e-15)


@pytest.mark.parametrize(
    ("spectrum", "expected_mm"),
    [(german_low(), (2.36, 3.26, 1.85, 0.34)), (german_high(), (4.02, 5.33, 3.03, 0.47))],
    ids=["low", "high"],
)
def test_german_spectrum_has_the_tabulated_rms(spectrum, expected_mm) -> None:
    rms_mm = [1e3 * spectrum.rms(channel) for channel in CHANNELS]
    # half a unit of the last printed digit
    assert rms_mm == pytest.approx(expected_mm, abs=0.5e-2)


@pytest.mark.parametrize(
    ("channel", "expected"), [("alignment", GENSYS_ALIGNMENT), ("vertical", GENSYS_VERTICAL)]
)
def test_german_high_equals_the_values_in_the_gensys_manual(channel: str, expected) -> None:
    density = german_high().density(channel, GENSYS_WAVENUMBERS)
    # five printed digits; the manual's corner wavenumbers are rounded in the fourth
    np.testing.assert_allclose(density, expected, rtol=2e-4)


def test_german_alignment_equals_its_closed_form_integral() -> None:
    corner_c, corner_r = 0.8246, 0.0206

    def integral(angular: float) -> float:
        return math.atan(angular / corner_r) / corner_r - math.atan(angular / corner_c) / corner_c

    low, high = band_edges()
    factor = 2.119e-7 * corner_c**2 / (corner_c**2 - corner_r**2)
    expected = math.sqrt(factor * (integral(high) - integral(low)))
    # rounding; the closed form takes differences of numbers near 70
    assert german_low().rms("alignment") == pytest.approx(expected, rel=1e-12)


@pytest.mark.parametrize("spectrum", [german_low(), german_high()], ids=["low", "high"])
def test_german_cross_level_is_the_published_angle_times_the_rail_distance(spectrum) -> None:
    amplitude = {"german_low": 4.032e-7, "german_high": 1.080e-6}[spectrum.name]

    def angle_density(angular: float) -> float:
        squares = angular**2
        bottom = (squares + 0.0206**2) * (squares + 0.8246**2) * (squares + 0.4380**2)
        return amplitude / 0.75**2 * 0.8246**2 * squares / bottom

    angle_variance = quad(angle_density, *band_edges(), epsrel=1e-10)[0]
    # accuracy asked of the quadrature
    assert spectrum.rms("cross_level") == pytest.approx(1.5 * math.sqrt(angle_variance), rel=1e-8)


FRA = {
    # class: Omega_s [rad/m], A_v and A_a [cm^2 rad/m]
    1: (0.6046, 1.2107, 3.3634),
    2: (0.9308, 1.0181, 1.2107),
    3: (0.8520, 0.6816, 0.4128),
    4: (1.1312, 0.5376, 0.3027),
    5: (0.8209, 0.2095, 0.0762),
    6: (0.4380, 0.0339, 0.0339),
}


@pytest.mark.parametrize("channel", ["alignment", "vertical"])
@pytest.mark.parametrize("number", FRA)
def test_fra_alignment_and_vertical_equal_their_closed_form(number: int, channel: str) -> None:
    amplitude_cm = FRA[number][2 if channel == "alignment" else 1]
    corner = 0.8245

    def integral(angular: float) -> float:
        return -1.0 / angular - math.atan(angular / corner) / corner

    low, high = band_edges()
    expected_cm = math.sqrt(0.25 * amplitude_cm * (integral(high) - integral(low)))
    # rounding
    assert fra(number).rms(channel) == pytest.approx(1e-2 * expected_cm, rel=1e-12)


@pytest.mark.parametrize("channel", ["cross_level", "gauge"])
@pytest.mark.parametrize("number", FRA)
def test_fra_cross_level_and_gauge_equal_their_closed_form(number: int, channel: str) -> None:
    corner_s, amplitude_cm, _ = FRA[number]
    corner_c = 0.8245

    def integral(angular: float) -> float:
        return math.atan(angular / corner_s) / corner_s - math.atan(angular / corner_c) / corner_c

    low, high = band_edges()
    factor = 4.0 * 0.25 * amplitude_cm * corner_c**2 / (corner_c**2 - corner_s**2)
    expected_cm = math.sqrt(factor * (integral(high) - integral(low)))
    # class 5 has its two corners 0.4 % apart, which costs the closed form three digits
    assert fra(number).rms(channel) == pytest.approx(1e-2 * expected_cm, rel=1e-10)


def test_a_better_fra_class_is_smoother() -> None:
    rms = [fra(number).rms("alignment") for number in range(1, 7)]
    assert rms == sorted(rms, reverse=True)


@pytest.mark.parametrize("number", [0, 7, 2.0, True])
def test_fra_refuses_a_class_that_does_not_exist(number) -> None:
    with pytest.raises(ArgumentError, match="track_class"):
        fra(number)


@pytest.mark.parametrize("name", spectrum_names())
def test_integral_over_angular_wavenumber_is_the_same_variance(name: str) -> None:
    spectrum = get_spectrum(name)
    variance = quad(
        lambda angular: spectrum.angular_density("cross_level", angular),
        *band_edges(3.0, 8.0),
        epsrel=1e-10,
    )[0]
    # accuracy asked of the quadrature; no break of any formula lies between 3 and 8 m
    assert math.sqrt(variance) == pytest.approx(spectrum.rms("cross_level", 3.0, 8.0), rel=1e-8)


@settings(deadline=None)
@given(wavelength=st.floats(2.0, 200.0), name=st.sampled_from(spectrum_names()))
def test_density_over_angular_wavenumber_is_smaller_by_two_pi(wavelength, name) -> None:
    spectrum = get_spectrum(name)
    angular = spectrum.angular_density("gauge", TWO_PI / wavelength)
    # rounding of the wavenumber, times the exponent
    assert TWO_PI * angular == pytest.approx(spectrum.density("gauge", 1.0 / wavelength), rel=1e-13)


@settings(deadline=None)
@given(split=st.floats(2.5, 190.0), channel=st.sampled_from(CHANNELS))
def test_variances_of_adjoining_bands_add_up(split: float, channel: str) -> None:
    spectrum = tb3352_ballastless()
    parts = spectrum.rms(channel, 2.0, split) ** 2 + spectrum.rms(channel, split, 200.0) ** 2
    # rounding of about 130 summands
    assert parts == pytest.approx(spectrum.rms(channel, 2.0, 200.0) ** 2, rel=1e-12)


@pytest.mark.parametrize(
    ("probability", "level"),
    [(0.1, 0.105), (0.25, 0.288), (0.5, 0.693), (0.75, 1.386), (0.9, 2.303), (0.95, 2.996)],
)
def test_percentile_level_is_the_tabulated_factor(probability: float, level: float) -> None:
    # half a unit of the last printed digit
    assert percentile_level(probability) == pytest.approx(level, abs=0.5e-3)


def test_the_mean_spectrum_is_the_632_per_mille_level() -> None:
    # one rounding
    assert percentile_level(1.0 - math.exp(-1.0)) == pytest.approx(1.0, rel=1e-15)


@pytest.mark.parametrize("probability", [-0.1, 1.0, math.nan])
def test_percentile_level_refuses_what_is_no_probability(probability: float) -> None:
    with pytest.raises(ArgumentError, match="probability"):
        percentile_level(probability)


def test_level_multiplies_the_density() -> None:
    half = german_low().at_level(0.25).at_level(2.0)
    # powers of two, exact
    assert half.density("gauge", 0.1) == 0.5 * german_low().density("gauge", 0.1)


def test_rms_grows_with_the_square_root_of_the_level() -> None:
    # powers of four; one rounding in the root
    assert german_low().at_level(4.0).rms("gauge") == pytest.approx(
        2.0 * german_low().rms("gauge"), rel=1e-15
    )


@pytest.mark.parametrize("wavenumber", [0.0, -0.1, math.nan, math.inf])
def test_density_refuses_a_wavenumber_that_is_not_positive(wavenumber: float) -> None:
    with pytest.raises(ArgumentError, match="wavenumber"):
        fra(6).density("vertical", [0.1, wavenumber])


def test_an_empty_band_is_refused() -> None:
    with pytest.raises(ArgumentError, match="shortest_wavelength"):
        fra(6).rms("vertical", 20.0, 20.0)


def test_an_unknown_channel_names_the_nearest() -> None:
    with pytest.raises(ArgumentError, match="'cross_level'"):
        fra(6).density("crosslevel", 0.1)


def test_every_registered_name_is_the_name_of_its_spectrum() -> None:
    assert [get_spectrum(name).name for name in spectrum_names()] == spectrum_names()


def test_the_registry_holds_these_spectra() -> None:
    fra_names = [f"fra{number}" for number in range(1, 7)]
    assert spectrum_names() == [*fra_names, "german_high", "german_low", "tb3352"]


def test_an_unknown_spectrum_names_the_nearest() -> None:
    with pytest.raises(ArgumentError, match=r"unknown track spectrum 'tb3325'.*'tb3352'"):
        get_spectrum("tb3325")


@pytest.mark.parametrize("name", spectrum_names())
def test_a_spectrum_survives_pickling(name: str) -> None:
    assert pickle.loads(pickle.dumps(get_spectrum(name))) == get_spectrum(name)
