"""Sperling's ride index: published constants, closed forms of a sine and of white noise, errors."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import integrate
from scipy import signal as scipy_signal

from railenv.errors import ArgumentError
from railenv.metrics import (
    WINDOW_NAMES,
    grade,
    sperling,
    sperling_filter,
    sperling_original,
    sperling_segments,
    weighting,
)
from railenv.metrics.sampling import window_samples
from railenv.units import STANDARD_GRAVITY

RATE = 200.0
ROUNDING = 1e-12
"""Relative rounding of an FFT of a thousand samples, with a margin of hundred."""
PRINTED = 0.51e-4
"""Half of the last of four printed digits."""


def sine(frequency, amplitude, duration=5.0, rate=RATE):
    time = np.arange(round(duration * rate)) / rate
    return amplitude * np.sin(2.0 * np.pi * frequency * time + 0.3)


def noise(*shape):
    return np.random.default_rng(7).normal(size=shape)


# 1.323 Hz is no line of a 5 s segment; a sine on a line has the same index at any length.
@pytest.mark.parametrize(
    ("frequency", "amplitude", "duration", "lateral", "vertical"),
    [
        (1.0, 0.5, 5.0, 2.8358, 2.5915),
        (1.323, 0.5, 1000.0, 2.9162, 2.6650),
        (1.323, 0.1, 1000.0, 1.7994, 1.6444),
        (5.4, 0.2, 5.0, 2.5383, 2.3303),
        (26.0, 0.2, 5.0, 1.5903, None),
    ],
)
def test_sine_on_a_line_has_the_index_computed_by_hand(
    frequency, amplitude, duration, lateral, vertical
):
    signal = sine(frequency, amplitude, duration)
    index = sperling(signal, RATE, segment=duration)
    assert index == pytest.approx(lateral, abs=PRINTED)
    if vertical is not None:
        index = sperling(signal, RATE, segment=duration, direction="vertical")
        assert index == pytest.approx(vertical, abs=PRINTED)


@pytest.mark.parametrize(
    ("frequency", "value"),
    [
        (0.5, 0.4219), (1.0, 0.6131), (1.323, 0.6766), (2.0, 0.7647), (4.0, 0.9686),
        (5.0, 1.0188), (6.0, 0.9929), (8.0, 0.8013), (10.0, 0.6179), (20.0, 0.2682),
        (30.0, 0.1723),
    ],
)  # fmt: skip
def test_lateral_comfort_filter_follows_its_table(frequency, value):
    assert sperling_filter(frequency, "comfort", "lateral") == pytest.approx(value, abs=PRINTED)


def test_comfort_filters_differ_only_by_their_gains():
    f = np.linspace(0.5, 40.0, 50)
    ratio = sperling_filter(f, "comfort", "lateral") / sperling_filter(f, "comfort", "vertical")
    np.testing.assert_allclose(ratio, 0.737 / 0.588, rtol=ROUNDING)


def test_quality_filter_at_one_hertz_is_the_formula_worked_by_hand():
    # Numerator (0.944^2 + 0.645^2) 3.55, denominator (0.748^2 + 1.54256^2) 4.55.
    by_hand = 1.14 * np.sqrt(1.307161 * 3.55 / ((0.559504 + 2.3794913536) * 4.55))
    assert sperling_filter(1.0, "quality", "vertical") == pytest.approx(by_hand, rel=ROUNDING)


@pytest.mark.parametrize(
    ("direction", "frequency", "value"),
    [
        ("lateral", 2.0, 3.2),
        ("lateral", 5.4, 650.0 / 5.4**2),
        ("lateral", 10.0, 6.5),
        ("lateral", 26.0, 1.0),
        ("lateral", 30.0, 1.0),
        ("vertical", 2.0, 1.3),
        ("vertical", 5.9, 400.0 / 5.9**2),
        ("vertical", 10.0, 4.0),
        ("vertical", 30.0, 1.0),
    ],
)
def test_weighting_takes_the_upper_branch_at_a_break(direction, frequency, value):
    assert weighting(frequency, direction) == pytest.approx(value, rel=ROUNDING)


def test_break_frequency_holds_for_a_line_one_rounding_below_it():
    line = np.nextafter(5.4, 0.0)
    assert weighting(line, "lateral") == pytest.approx(650.0 / 5.4**2, rel=1e-9)


def test_constants_for_g_and_centimetres_are_the_same_index():
    # 7.08, 0.896 and 3.57 are rounded to three digits: 0.7, 0.6 and 1.4 parts in a thousand.
    index = sperling(sine(30.0, 1.0), RATE) * 30.0**0.1
    assert index * STANDARD_GRAVITY**0.3 == pytest.approx(7.08, rel=2.1e-3)
    assert index / 100.0**0.3 == pytest.approx(0.896, rel=2.1e-3)


@settings(max_examples=25, deadline=None)
@given(scale=st.floats(1e-3, 1e3), line=st.integers(3, 199))
def test_index_of_a_sine_grows_with_amplitude_to_the_power_0_3(scale, line):
    one, scaled = (sperling(sine(line / 5.0, a), RATE) for a in (1.0, scale))
    # The sine's leaked rounding on other lines is 1e-15 of it, cubed: nothing.
    assert scaled == pytest.approx(one * scale**0.3, rel=1e-9)


def test_batch_equals_a_loop_over_its_lanes():
    signals = noise(2, 3, 2500)
    looped = [[sperling(lane, RATE) for lane in row] for row in signals]
    np.testing.assert_allclose(sperling(signals, RATE), looped, rtol=ROUNDING)


def test_single_signal_gives_a_float():
    assert type(sperling(noise(1000), RATE)) is float


def test_offset_of_a_segment_does_not_count():
    # The flat top would spread an offset up to 0.8 Hz, into the band.
    still, shifted = (sperling(noise(1000) + a, RATE, window="flattop") for a in (0.0, 9.81))
    # Removing an offset of ten costs a digit of the sixteen.
    assert shifted == pytest.approx(still, rel=1e-11)


@pytest.mark.parametrize("window", WINDOW_NAMES)
def test_windows_are_those_of_scipy(window):
    # The flat top's printed coefficients have nine digits in both.
    expected = scipy_signal.get_window(window, 250)
    np.testing.assert_allclose(window_samples(window, 250), expected, atol=1e-12)


@pytest.mark.parametrize("window", WINDOW_NAMES)
def test_window_correction_shows_a_sine_with_its_amplitude(window):
    # A band of one line: the index is that line's, and the line must hold the full amplitude.
    index = sperling(sine(8.0, 0.3), RATE, window=window, band=(7.95, 8.05))
    by_hand = 3.57 * (0.3**3 * 650.0 / 8.0**2 / 8.0) ** 0.1
    assert index == pytest.approx(by_hand, rel=1e-9)


def test_hann_window_raises_the_index_of_a_sine_by_its_side_lines():
    # Lines at half the amplitude on both sides: 1 + 1/8 + 1/8, each with its own F(f)/f = 1/f.
    index = sperling(sine(30.0, 0.3), RATE, window="hann")
    side_lines = 1.0 / 30.0 + (1.0 / 29.8 + 1.0 / 30.2) / 8.0
    assert index == pytest.approx(3.57 * (0.3**3 * side_lines) ** 0.1, rel=1e-9)


def test_lines_below_and_above_the_band_do_not_count():
    outside = sine(0.4, 5.0) + sine(40.2, 5.0)
    # What is left is rounding, 1e-15 of the amplitude on each line, to the power 0.3.
    assert sperling(outside, RATE) < 1e-3


def test_band_includes_its_upper_end():
    by_hand = 3.57 * (0.2**3 / 40.0) ** 0.1
    assert sperling(sine(40.0, 0.2), RATE) == pytest.approx(by_hand, rel=1e-9)


def test_lines_add_up_to_the_tenth_root_of_tenth_powers():
    parts = [sperling(sine(f, a), RATE) for f, a in ((2.0, 0.2), (9.0, 0.4))]
    together = sperling(sine(2.0, 0.2) + sine(9.0, 0.4), RATE)
    assert together == pytest.approx((parts[0] ** 10 + parts[1] ** 10) ** 0.1, rel=1e-9)


def test_segments_are_combined_by_mean_unless_the_maximum_is_asked():
    signal = np.concatenate([sine(2.0, 0.1), sine(2.0, 0.4), noise(10)])
    segments = sperling_segments(signal, RATE)
    assert segments.shape == (2,)
    assert sperling(signal, RATE) == pytest.approx(segments.mean(), rel=ROUNDING)
    batch = np.stack([signal, 2.0 * signal, signal])
    largest = segments[1] * np.array([1.0, 2.0**0.3, 1.0])
    np.testing.assert_allclose(sperling(batch, RATE, aggregate="max"), largest, rtol=ROUNDING)


def test_overlap_repeats_part_of_a_segment():
    signal = noise(2000)
    segments = sperling_segments(signal, RATE, overlap=0.8)
    assert segments.shape == (6,)
    assert segments[1] == pytest.approx(sperling(signal[200:1200], RATE), rel=ROUNDING)


@pytest.mark.parametrize("kind", ["comfort", "quality"])
def test_original_line_form_of_a_sine_is_its_closed_form(kind):
    index = sperling_original(sine(3.0, 0.2), RATE, kind=kind, direction="vertical")
    by_hand = (20.0 * sperling_filter(3.0, kind, "vertical")) ** 0.3
    assert index == pytest.approx(by_hand, rel=1e-9)


@pytest.mark.parametrize("window", ["boxcar", "hann"])
def test_integral_form_of_a_sine_holds_its_squared_amplitude(window):
    index = sperling_original(sine(30.0, 0.2), RATE, form="integral", window=window)
    by_hand = (20.0 * sperling_filter(30.0)) ** (2.0 / 6.67)
    # Under Hann the side lines take B at 29.8 and 30.2 Hz, which is 1e-5 off B at 30 Hz.
    assert index == pytest.approx(by_hand, rel=1e-5)


def test_integral_form_of_a_flat_spectrum_is_the_integral_of_the_filter():
    # An impulse of one sample has the density 2 a^2 / (rate samples) at every frequency.
    signal = np.zeros(4000)
    signal[100] = 3.0
    density = 2.0 * 300.0**2 / (RATE * 4000)
    power = integrate.quad(lambda f: sperling_filter(f) ** 2, 0.5, 40.0, limit=200)[0]
    index = sperling_original(signal, RATE, form="integral", segment=20.0)
    # The sum counts both end lines in full: 0.05 Hz times half of B^2 at the ends is 5e-4 of the
    # integral, 8e-5 after the root.
    assert index == pytest.approx((2.0 * density * power) ** (1.0 / 6.67), rel=1e-4)


def test_integral_form_uses_the_density_of_welch():
    signal = noise(6000)
    f, density = scipy_signal.welch(signal, RATE, window="hann", nperseg=1000, noverlap=500)
    inside = (f >= 0.5) & (f <= 40.0)
    power = 2.0 * np.sum(density[inside] * 1e4 * sperling_filter(f[inside]) ** 2) * 0.2
    index = sperling_original(signal, RATE, form="integral", window="hann", overlap=0.5)
    assert index == pytest.approx(power ** (1.0 / 6.67), rel=ROUNDING)


@pytest.mark.parametrize(
    ("index", "words"),
    [
        (0.0, "excellent"),
        (2.49, "excellent"),
        (2.5, "good"),
        (2.75, "qualified"),
        (3.0, "qualified"),
        (3.01, "outside the grades"),
    ],
)
def test_grade_names_the_range_of_an_index(index, words):
    assert grade(index) == words


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"direction": "latteral"}, "did you mean 'lateral'"),
        ({"window": "han"}, "did you mean 'hann'"),
        ({"aggregate": "maxx"}, "did you mean 'max'"),
        ({"segment": 4.999}, "not a whole number; use 5 s"),
        ({"segment": 0.0}, "above zero"),
        ({"segment": 0.02}, "no spectral line"),
        ({"segment": 60.0}, "one segment takes 12000"),
        ({"overlap": 0.9995}, "not a whole number"),
        ({"overlap": 1.0}, "out of range"),
        ({"sample_rate": 80.0}, "Nyquist"),
        ({"band": (3.0, 2.0)}, "not a band"),
        ({"acceleration": [0.0, np.nan]}, "1 of 2 samples"),
        ({"acceleration": 3.0}, "single number"),
        ({"acceleration": np.zeros((2, 0))}, "no sample"),
        ({"acceleration": [1j]}, "real numbers"),
        ({"acceleration": ["a"]}, "real numbers"),
    ],
)
def test_bad_argument_is_named_in_one_line(change, message):
    arguments = {"acceleration": noise(1000), "sample_rate": RATE} | change
    with pytest.raises(ArgumentError, match=message) as caught:
        sperling(**arguments)
    assert "\n" not in str(caught.value)


def test_integral_form_refuses_an_aggregate():
    with pytest.raises(ArgumentError, match="averages spectra"):
        sperling_original(noise(1000), RATE, form="integral", aggregate="max")


@pytest.mark.parametrize("name", ["kind", "form", "direction"])
def test_original_form_names_an_unknown_choice(name):
    with pytest.raises(ArgumentError, match=f"unknown {name} 'x'"):
        sperling_original(noise(1000), RATE, **{name: "x"})
