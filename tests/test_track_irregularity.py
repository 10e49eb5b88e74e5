import math
import pickle

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.signal import welch

from railenv.errors import ArgumentError
from railenv.track import CHANNELS, Track, flat, get_spectrum, make_track, realise

TB3352 = get_spectrum("tb3352")
# Most of one period (32768 m at the default spacing), so that almost only the band's own,
# deterministic variance remains.
ALMOST_A_PERIOD = 32_500.0


@pytest.fixture(scope="module")
def long_track() -> Track:
    return realise(TB3352, ALMOST_A_PERIOD, seed=5, taper=0.0)


def sine(wavelength: float, spacing: float, length: float = 40.0, phase: float = 0.3) -> Track:
    distance = spacing * np.arange(round(length / spacing) + 1)
    return Track("sine", spacing, {"vertical": np.sin(2 * np.pi * distance / wavelength + phase)})


@pytest.mark.parametrize("channel", CHANNELS)
def test_realised_rms_is_the_spectrums(long_track: Track, channel: str) -> None:
    rms = math.sqrt(float(np.mean(long_track.channels[channel] ** 2)))
    # The missing 0.8 % of the period may hold three times its share of the variance.
    assert rms == pytest.approx(TB3352.rms(channel), rel=0.012)


@pytest.mark.parametrize("channel", CHANNELS)
def test_realised_density_is_the_spectrums_in_every_octave(long_track: Track, channel) -> None:
    wavenumber, density = welch(
        long_track.channels[channel], fs=1.0 / long_track.spacing, nperseg=4096
    )
    for upper in (0.48, 0.24, 0.12, 0.06, 0.03):
        octave = (wavenumber > 0.5 * upper) & (wavenumber <= upper)
        ratio = float(np.mean(density[octave] / TB3352.density(channel, wavenumber[octave])))
        # 8 or more lines of 1/512 m, each averaged over 126 overlapping segments (about 65 free
        # ones): a standard deviation of at most 1 / sqrt(8 * 65) = 4.4 %, taken three times
        assert ratio == pytest.approx(1.0, abs=0.13)


def test_realised_density_vanishes_beyond_the_band(long_track: Track) -> None:
    wavenumber, density = welch(
        long_track.channels["alignment"], fs=1.0 / long_track.spacing, nperseg=4096
    )
    beyond = density[wavenumber > 0.52]
    # leakage of the Hann window ten lines away, with ample room
    assert np.max(beyond) < 1e-3 * TB3352.density("alignment", 0.5)


def test_the_band_of_wavelengths_decides_the_rms() -> None:
    track = realise(
        TB3352, ALMOST_A_PERIOD, 1, shortest_wavelength=3.0, longest_wavelength=25.0, taper=0.0
    )
    rms = math.sqrt(float(np.mean(track.channels["gauge"] ** 2)))
    # near one period of 49152 m or 24576 m; thousands of waves, so the share left out hardly counts
    assert rms == pytest.approx(TB3352.rms("gauge", 3.0, 25.0), rel=0.02)


@given(seed=st.integers(0, 2**64))
@settings(max_examples=10, deadline=None)
def test_the_same_seed_gives_the_same_track_bit_for_bit(seed: int) -> None:
    first, second = (realise(TB3352, 300.0, seed).channels["gauge"] for _ in range(2))
    assert first.tobytes() == second.tobytes()


@given(seed=st.integers(0, 2**64))
@settings(max_examples=10, deadline=None)
def test_another_seed_gives_another_track(seed: int) -> None:
    first = realise(TB3352, 300.0, seed).channels["vertical"]
    second = realise(TB3352, 300.0, seed + 1).channels["vertical"]
    assert np.max(np.abs(first - second)) > 1e-5


def test_a_seed_sequence_serves_as_a_seed() -> None:
    whole = realise(TB3352, 300.0, 7).channels["gauge"]
    sequence = realise(TB3352, 300.0, np.random.SeedSequence(7)).channels["gauge"]
    assert whole.tobytes() == sequence.tobytes()


def test_spawned_seed_sequences_give_different_tracks() -> None:
    first, second = np.random.SeedSequence(7).spawn(2)
    gauges = [realise(TB3352, 300.0, seed).channels["gauge"] for seed in (first, second)]
    assert np.max(np.abs(gauges[0] - gauges[1])) > 1e-5


@pytest.mark.parametrize("channel", CHANNELS)
def test_a_channel_does_not_depend_on_which_others_are_drawn(channel: str) -> None:
    alone = realise(TB3352, 300.0, 3, channels=[channel]).channels[channel]
    assert alone.tobytes() == realise(TB3352, 300.0, 3).channels[channel].tobytes()


def test_channels_of_one_track_are_uncorrelated(long_track: Track) -> None:
    correlation = np.corrcoef([long_track.channels[channel] for channel in CHANNELS])
    # steep spectra have few free waves: some 160 below 1/200 + 1/200 1/m carry the vertical's
    # variance, so a standard deviation of 1 / sqrt(160) = 0.08, taken three times
    assert np.max(np.abs(correlation - np.eye(4))) < 0.24


@given(length=st.floats(1.0, 9000.0))
@settings(max_examples=20, deadline=None)
def test_a_realised_track_covers_the_length_asked_for(length: float) -> None:
    track = realise(TB3352, length, 0, channels=["gauge"])
    # a grid point more at most, and rounding
    assert length - 1e-6 <= track.length <= max(length, 0.125) + 0.125


def test_a_longer_track_of_the_same_period_begins_like_the_shorter() -> None:
    short, long = (realise(TB3352, length, 2).channels["gauge"] for length in (500.0, 3000.0))
    assert short.tobytes() == long[: len(short)].tobytes()


def test_taper_weighs_half_at_its_middle() -> None:
    full, tapered = (realise(TB3352, 300.0, 4, taper=taper) for taper in (0.0, 100.0))
    # rounding of one product
    assert tapered.sample("gauge", 50.0) == pytest.approx(
        0.5 * full.sample("gauge", 50.0), rel=1e-12
    )


def test_taper_begins_at_zero_and_leaves_the_rest_alone() -> None:
    full, tapered = (realise(TB3352, 300.0, 4, taper=t).channels["gauge"] for t in (0.0, 100.0))
    np.testing.assert_array_equal(full[800:], tapered[800:])
    assert tapered[0] == 0.0


def test_taper_has_level_ends() -> None:
    ramp = Track("one", 0.125, {"gauge": np.ones(1000)}).begun(100.0).channels["gauge"]
    slopes = np.diff(ramp)[[0, 798, 799]] / 0.125
    # half a step from its end the cosine's slope is pi^2 / (2 taper^2) * dx / 2 = 3e-5 1/m, one
    # step further three times that; the steepest part has 1.6e-2
    assert np.max(np.abs(slopes)) < 1.2e-4


@pytest.mark.parametrize("phase", [0.0, 0.4, 1.1])
def test_the_spline_reproduces_a_2_m_wave_at_the_default_spacing(phase: float) -> None:
    track = sine(2.0, realise(TB3352, 1.0, 0).spacing, phase=phase)
    distance = np.linspace(10.0, 30.0, 20_001)
    # what the default spacing was chosen for
    np.testing.assert_allclose(
        track.sample("vertical", distance), np.sin(np.pi * distance + phase), rtol=0, atol=1e-4
    )


def test_the_spline_converges_with_fourth_order() -> None:
    distance = np.linspace(10.0, 30.0, 20_001)
    coarse, fine = (
        np.max(np.abs(sine(2.0, h).sample("vertical", distance) - np.sin(np.pi * distance + 0.3)))
        for h in (0.125, 0.0625)
    )
    # the next order of the error is (pi h)^2 = 15 % of the first at the coarser spacing
    assert math.log2(coarse / fine) == pytest.approx(4.0, abs=0.1)


def test_a_realised_track_returns_its_grid_values() -> None:
    track = realise(TB3352, 200.0, 1)
    grid = track.spacing * np.arange(track.points)
    # a spline passes through its points, to rounding
    np.testing.assert_allclose(
        track.sample("alignment", grid), track.channels["alignment"], rtol=0, atol=1e-17
    )


def test_before_its_beginning_the_track_is_straight() -> None:
    before = sine(2.0, 0.125).sample("vertical", [-1e-9, -5.0, -math.inf])
    np.testing.assert_array_equal(before, 0.0)


def test_the_sample_has_the_shape_of_the_distance() -> None:
    assert sine(2.0, 0.125).sample("vertical", np.zeros((3, 4))).shape == (3, 4)


@pytest.mark.parametrize("distance", [40.001, math.inf, math.nan])
def test_beyond_the_end_is_an_error_that_names_the_length(distance: float) -> None:
    with pytest.raises(ArgumentError, match=r"ends at 40 m; make the track longer"):
        sine(2.0, 0.125).sample("vertical", [0.0, distance])


def test_rounding_at_the_end_is_no_error() -> None:
    # speed times time need not hit 3 times 0.1 m in its last digits
    assert Track("t", 0.1, {"gauge": np.ones(4)}).sample("gauge", 0.30000000000001) == 1.0


def test_an_absent_channel_is_zero() -> None:
    np.testing.assert_array_equal(sine(2.0, 0.125).sample("gauge", [0.0, 7.0]), 0.0)


def test_a_channel_that_does_not_exist_names_the_nearest() -> None:
    with pytest.raises(ArgumentError, match="'alignment'"):
        flat(10.0).sample("alignement", 1.0)


@settings(deadline=None)
@given(length=st.floats(1e-3, 1e6), share=st.floats(-1.0, 1.0))
def test_a_flat_track_is_zero_over_its_length(length: float, share: float) -> None:
    assert flat(length).sample("vertical", share * length) == 0.0


def test_ended_leaves_what_comes_before() -> None:
    track = realise(TB3352, 400.0, 1)
    ended = track.ended(200.0, 50.0)
    np.testing.assert_array_equal(ended.channels["gauge"][:1601], track.channels["gauge"][:1601])


def test_ended_is_zero_after_the_taper() -> None:
    ended = realise(TB3352, 400.0, 1).ended(200.0, 50.0)
    np.testing.assert_array_equal(ended.channels["gauge"][2000:], 0.0)


def test_between_grid_points_ended_is_zero_soon_after_the_taper() -> None:
    ended = realise(TB3352, 400.0, 1).ended(200.0, 50.0)
    # The spline's ripple starts below 1e-8 m and shrinks by 0.268 per step of 0.125 m: 1e-14 of it
    # is left after 3 m.
    assert np.max(np.abs(ended.sample("vertical", np.linspace(253.0, 400.0, 9999)))) < 1e-20


def test_ended_weighs_half_in_the_middle_of_its_taper() -> None:
    ended = Track("one", 0.125, {"gauge": np.ones(1601)}).ended(100.0, 50.0)
    # rounding of the cosine
    assert ended.sample("gauge", 125.0) == pytest.approx(0.5, rel=1e-12)


@pytest.mark.parametrize(("length", "expected"), [(1000.0, 1000.0), (260.0, 260.0), (None, 400.0)])
def test_ended_takes_any_length_beyond_its_taper(length, expected) -> None:
    assert realise(TB3352, 400.0, 1).ended(200.0, 50.0, length).length == expected


@pytest.mark.parametrize(
    ("distance", "taper", "length", "named"),
    [(-1.0, 5.0, None, "distance"), (1.0, 0.0, None, "taper"), (38.0, 5.0, None, "end at 40 m"),
     (10.0, 5.0, 14.0, "length")],
)  # fmt: skip
def test_ended_refuses_what_does_not_fit(distance, taper, length, named) -> None:
    with pytest.raises(ArgumentError, match=named):
        sine(2.0, 0.125).ended(distance, taper, length)


@settings(deadline=None)
@given(factor=st.floats(-10.0, 10.0), distance=st.floats(0.0, 40.0))
def test_scaling_scales_every_sample(factor: float, distance: float) -> None:
    track = sine(3.0, 0.125)
    # rounding of the spline's four terms, each at most about the amplitude
    assert track.scaled(factor).sample("vertical", distance) == pytest.approx(
        factor * track.sample("vertical", distance), abs=1e-13
    )


def test_a_tracks_values_cannot_be_changed() -> None:
    with pytest.raises(ValueError, match="read-only"):
        flat(10.0).channels["gauge"][0] = 1.0


def test_a_track_survives_pickling() -> None:
    track = realise(TB3352, 50.0, 1)
    again = pickle.loads(pickle.dumps(track))
    assert again.sample("gauge", 20.0) == track.sample("gauge", 20.0)


@pytest.mark.parametrize(
    ("values", "named"),
    [({}, "no channel"), ({"gage": np.zeros(9)}, "'gauge'"), ({"gauge": np.zeros(1)}, "2 points"),
     ({"gauge": np.zeros((3, 3))}, "1-D"), ({"gauge": np.array([0.0, math.nan])}, "point 1"),
     ({"gauge": np.zeros(9), "vertical": np.zeros(8)}, "one length")],
)  # fmt: skip
def test_a_track_refuses_unusable_channels(values, named: str) -> None:
    with pytest.raises(ArgumentError, match=named):
        Track("t", 0.25, values)


@pytest.mark.parametrize(
    ("settings", "named"),
    [({"length": 0.0}, "length"), ({"seed": -1}, "seed"), ({"seed": 1.5}, "seed"),
     ({"spacing": 0.3}, "at most 0.25 m"), ({"taper": -1.0}, "taper"), ({"length": 1e9}, "shorter"),
     ({"channels": ["gage"]}, "'gauge'"), ({"longest_wavelength": 2.0}, "shortest_wavelength")],
)  # fmt: skip
def test_realise_refuses_settings_out_of_range(settings, named: str) -> None:
    with pytest.raises(ArgumentError, match=named):
        realise(TB3352, **{"length": 10.0, "seed": 0, **settings})


def test_make_track_knows_a_flat_track() -> None:
    assert make_track("flat", 12.0, 0).length == 12.0


def test_make_track_realises_a_spectrum() -> None:
    made = make_track("german_low", 300.0, 9).channels["vertical"]
    assert (
        made.tobytes()
        == realise(get_spectrum("german_low"), 300.0, 9).channels["vertical"].tobytes()
    )
