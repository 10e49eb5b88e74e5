"""Measures of runs: the numbers of known signals, and what counts as diverged.

Every signal has its own amplitude and frequency, so that no field can stand for another.
"""

import math

import numpy as np
import pytest

from eval.measures import RunMeasures, measure
from eval.rollout import ACCELERATIONS
from railenv.simulation import Trajectory

RATE = 200.0
SECONDS, SKIP = 30.0, 5.0
FRONT, REAR, BOGIE1, BOGIE2 = ACCELERATIONS
FORCES = ("actuator_force_1", "actuator_force_2")
LIMIT = 30e3

# Amplitude and frequency of each sine; on lines of 5 s, so that none leaks into another.
TONES = {
    FRONT: ((0.5, 1.0), (0.3, 3.0)),
    REAR: ((0.7, 1.6), (0.2, 4.0)),
    BOGIE1: ((1.1, 3.0),),
    BOGIE2: ((0.9, 4.2),),
    FORCES[0]: ((4e3, 1.0),),
    FORCES[1]: ((7e3, 2.0),),
}
TIME = np.arange(1, round(SECONDS * RATE) + 1) / RATE


def sine(amplitude: float = 0.5, frequency: float = 1.0) -> np.ndarray:
    return amplitude * np.sin(2 * np.pi * frequency * TIME)


def signals() -> dict[str, np.ndarray]:
    return {name: sum(sine(*tone) for tone in tones) for name, tones in TONES.items()}


def measured(limit: float | None = LIMIT, **changed: np.ndarray) -> RunMeasures:
    """Measures of one lane with some signals changed."""
    lane = {**signals(), **changed}
    values = np.stack(list(lane.values()), axis=-1)[None]
    return measure(Trajectory(TIME, tuple(lane), values), SKIP, limit)


def filter_of_sperling(f: float) -> float:
    """B(f) for lateral comfort, for cm/s^2."""
    rise = 1.911 * f**2 + (0.25 * f**2) ** 2
    return 0.737 * math.sqrt(rise / ((1 - 0.277 * f**2) ** 2 + (1.563 * f - 0.0368 * f**3) ** 2))


def amplitude_form(name: str) -> float:
    """GB/T 5599 below 5.4 Hz: F = 0.8 f^2."""
    return 3.57 * sum(a**3 * 0.8 * f**2 / f for a, f in TONES[name]) ** 0.1


def integral_form(name: str) -> float:
    """The sum of the weighted squares, to the power 1 / 6.67."""
    return sum((100.0 * a * filter_of_sperling(f)) ** 2 for a, f in TONES[name]) ** (1 / 6.67)


def rms_of(name: str) -> float:
    return math.sqrt(sum(a**2 for a, _ in TONES[name]) / 2)


@pytest.mark.parametrize(
    ("field", "expected"),
    [
        ("ride_index_front", amplitude_form(FRONT)),
        ("ride_index_rear", amplitude_form(REAR)),
        ("ride_index_original_front", integral_form(FRONT)),
        ("ride_index_original_rear", integral_form(REAR)),
        ("floor_rms_front", rms_of(FRONT)),
        ("floor_rms_rear", rms_of(REAR)),
        ("bogie_rms", rms_of(BOGIE1)),
        # The square is averaged over both actuators: (4^2 + 7^2) / 2 / 2.
        ("force_rms", 1e3 * math.sqrt(65.0 / 4.0)),
        ("force_peak", 7e3),
        ("saturated_share", 0.0),
    ],
)
def test_every_field_has_the_number_of_its_own_signal(field: str, expected: float) -> None:
    # whole periods in whole segments: nothing but rounding
    assert measured().lane(0)[field] == pytest.approx(expected, rel=1e-9)


def test_a_sine_has_the_ride_index_worked_by_hand() -> None:
    # 3.57 (0.5^3 * 0.8)^0.1, worked to four digits
    assert measured(**{FRONT: sine()}).lane(0)["ride_index_front"] == pytest.approx(
        2.8358, abs=5e-5
    )


def test_the_worse_bogie_counts_whichever_it_is() -> None:
    swapped = {BOGIE1: signals()[BOGIE2], BOGIE2: signals()[BOGIE1]}
    # whole periods: nothing but rounding
    assert measured(**swapped).lane(0)["bogie_rms"] == pytest.approx(rms_of(BOGIE1), rel=1e-9)


# Wd at the octaves, ISO 2631-1 table 3.
WD = {1.0: 1.011, 2.0: 0.890, 4.0: 0.512}
# Five blocks of 5 s after the start that is left out: the last one is three times as strong.
BLOCKS = np.repeat([1.0, 1.0, 1.0, 1.0, 1.0, 3.0], round(5 * RATE))


def uneven() -> dict[str, float | bool | None]:
    """Measures of a front floor at 2 Hz and a rear floor at 4 Hz that grow in the last block."""
    changed = {FRONT: BLOCKS * sine(0.5, 2.0), REAR: BLOCKS * sine(0.8, 4.0)}
    return measured(**changed).lane(0)


@pytest.mark.parametrize(
    ("end", "amplitude", "frequency"), [("front", 0.5, 2.0), ("rear", 0.8, 4.0)]
)
def test_comfort_is_the_mean_of_the_blocks(end: str, amplitude: float, frequency: float) -> None:
    expected = WD[frequency] * amplitude / math.sqrt(2) * (4 * 1.0 + 3.0) / 5
    # the table's third digit, and the filter ringing at start and step: 0.2 to 0.4 % measured
    assert uneven()[f"comfort_{end}"] == pytest.approx(expected, rel=0.01)


@pytest.mark.parametrize(
    ("end", "amplitude", "frequency"), [("front", 0.5, 2.0), ("rear", 0.8, 4.0)]
)
def test_mean_comfort_is_six_times_the_95th_percentile_of_the_lateral_blocks(
    end: str, amplitude: float, frequency: float
) -> None:
    # The percentile of (1, 1, 1, 1, 3) lies 0.95 * 4 = 3.8 steps up: 1 + 0.8 * 2.
    expected = 6.0 * WD[frequency] * amplitude / math.sqrt(2) * 2.6
    # the table's third digit, and the filter ringing at start and step: 0.2 to 0.4 % measured
    assert uneven()[f"mean_comfort_{end}"] == pytest.approx(expected, rel=0.01)


def test_the_skipped_start_does_not_count() -> None:
    changed = {name: np.where(TIME <= SKIP, 100.0 * s, s) for name, s in signals().items()}
    assert measured(**changed).lane(0) == measured().lane(0)


def test_the_sample_at_the_end_of_the_skipped_start_does_not_count() -> None:
    late = signals()[FRONT]
    late[round(SKIP * RATE) - 1] = 1e3
    assert measured(**{FRONT: late}).lane(0) == measured().lane(0)


def test_the_first_sample_after_the_skipped_start_counts() -> None:
    late = signals()[FRONT]
    late[round(SKIP * RATE)] = 1e3
    assert measured(**{FRONT: late}).lane(0)["floor_rms_front"] > 10.0


def test_a_steady_motion_has_not_diverged() -> None:
    assert measured().lane(0)["diverged"] is False


@pytest.mark.parametrize("name", [FRONT, REAR])
@pytest.mark.parametrize(("rate", "diverged"), [(0.05, True), (0.03, False)])
def test_one_floor_that_grows_by_more_than_two_between_thirds_has_diverged(
    name: str, rate: float, diverged: bool
) -> None:
    # thirds are 8.3 s of 25 s: exp(0.05 * 16.7) = 2.3 and exp(0.03 * 16.7) = 1.6
    grown = {name: signals()[name] * np.exp(rate * TIME)}
    assert measured(**grown).lane(0)["diverged"] is diverged


@pytest.mark.parametrize("name", [FRONT, REAR])
def test_a_floor_that_decays_has_not_diverged(name: str) -> None:
    decaying = {name: signals()[name] * np.exp(-0.1 * TIME)}
    assert measured(**decaying).lane(0)["diverged"] is False


def test_bogies_that_grow_do_not_make_a_run_diverged() -> None:
    grown = {BOGIE1: signals()[BOGIE1] * np.exp(0.1 * TIME)}
    assert measured(**grown).lane(0)["diverged"] is False


def clipped() -> np.ndarray:
    """A force that is at the limit two thirds of the time: |sin| above one half."""
    return np.clip(sine(2 * LIMIT), -LIMIT, LIMIT)


@pytest.mark.parametrize("name", FORCES)
def test_the_share_at_the_limit_is_taken_over_all_actuators(name: str) -> None:
    # samples of 1 Hz at 200 Hz fall on the edge or beside it: one in a hundred
    assert measured(**{name: clipped()}).lane(0)["saturated_share"] == pytest.approx(
        1 / 3, abs=0.01
    )


@pytest.mark.parametrize(("limit", "diverged"), [(LIMIT, True), (LIMIT + 1.0, False)])
def test_a_run_at_its_own_limit_has_diverged(limit: float, diverged: bool) -> None:
    assert measured(limit, **{FORCES[0]: clipped()}).lane(0)["diverged"] is diverged


@pytest.mark.parametrize(("share", "diverged"), [(0.015, True), (0.005, False)])
def test_more_than_a_hundredth_at_the_limit_has_diverged(share: float, diverged: bool) -> None:
    # both actuators at the limit at once, so that the share of the samples is that of the time
    pushed = np.where(SECONDS - share * (SECONDS - SKIP) < TIME, LIMIT, 0.0)
    found = measured(**dict.fromkeys(FORCES, pushed))
    assert found.lane(0)["diverged"] is diverged


def test_without_a_limit_nothing_is_saturated() -> None:
    assert measured(None, **{FORCES[0]: clipped()}).lane(0)["saturated_share"] == 0.0


def test_the_peak_force_counts_in_both_directions() -> None:
    one_sided = {FORCES[0]: -np.abs(sine(9e3))}
    assert measured(**one_sided).lane(0)["force_peak"] == 9e3


def test_without_actuators_the_forces_are_zero() -> None:
    values = np.stack([signals()[name] for name in ACCELERATIONS], axis=-1)[None]
    lane = measure(Trajectory(TIME, ACCELERATIONS, values), SKIP, LIMIT).lane(0)
    assert [lane[k] for k in ("force_rms", "force_peak", "saturated_share")] == [0.0, 0.0, 0.0]


def blown() -> RunMeasures:
    """A whole lane beside one whose rear floor blew up after half the time."""
    good = np.stack(list(signals().values()), axis=-1)
    bad = good.copy()
    bad[3000:, 1] = np.nan
    return measure(Trajectory(TIME, tuple(TONES), np.stack([good, bad])), SKIP, LIMIT)


def test_a_lane_that_blew_up_has_no_numbers_but_says_so() -> None:
    lane = blown().lane(1)
    assert lane.pop("diverged") is True
    assert set(lane.values()) == {None}


def test_a_lane_beside_one_that_blew_up_keeps_its_numbers() -> None:
    assert blown().lane(0) == measured().lane(0)


@pytest.mark.parametrize(("skip", "diverged"), [(5.0, True), (4.9, False), (0.0, False)])
def test_a_run_that_rises_from_rest_is_no_growth(skip: float, diverged: bool) -> None:
    # The last third is eight times the first: growth, unless the start is in it.
    rise = (TIME / SECONDS) ** 2
    values = np.stack([rise * sine() for _ in ACCELERATIONS], axis=-1)[None]
    found = measure(Trajectory(TIME, ACCELERATIONS, values), skip, None)
    assert bool(found.diverged[0]) is diverged
