"""Measures of runs: the numbers of known signals, and what counts as diverged."""

import numpy as np
import pytest

from eval.measures import measure
from eval.rollout import ACCELERATIONS
from railenv.simulation import Trajectory

RATE = 200.0


def made(floor: np.ndarray, force: np.ndarray | None = None) -> Trajectory:
    """A trajectory of one lane with the same signal everywhere."""
    names = (*ACCELERATIONS, "actuator_force_1")
    pushed = np.zeros_like(floor) if force is None else force
    values = np.stack([floor, floor, floor, floor, pushed], axis=-1)[None]
    return Trajectory(np.arange(1, len(floor) + 1) / RATE, names, values)


def sine(seconds: float, amplitude: float = 0.5, frequency: float = 1.0) -> np.ndarray:
    time = np.arange(1, round(seconds * RATE) + 1) / RATE
    return amplitude * np.sin(2 * np.pi * frequency * time)


def test_a_sine_has_its_published_ride_index() -> None:
    lane = measure(made(sine(30.0)), 5.0, 30e3).lane(0)
    assert lane["ride_index_front"] == pytest.approx(2.8358, abs=5e-5)
    assert lane["floor_rms_rear"] == pytest.approx(0.5 / np.sqrt(2), rel=1e-12)


def test_the_skipped_start_does_not_count() -> None:
    signal = sine(30.0)
    signal[: int(5 * RATE)] *= 100.0
    assert measure(made(signal), 5.0, 30e3).lane(0)["ride_index_front"] == pytest.approx(
        2.8358, abs=5e-5
    )


def test_a_steady_motion_has_not_diverged() -> None:
    assert measure(made(sine(30.0)), 5.0, 30e3).lane(0)["diverged"] is False


def test_a_motion_that_grows_by_more_than_two_between_thirds_has_diverged() -> None:
    time = np.arange(1, 6001) / RATE
    # thirds are 8.3 s of 25 s: exp(0.05 * 16.7) = 2.3
    assert measure(made(sine(30.0) * np.exp(0.05 * time)), 5.0, 30e3).lane(0)["diverged"] is True
    assert measure(made(sine(30.0) * np.exp(0.03 * time)), 5.0, 30e3).lane(0)["diverged"] is False


def test_forces_at_the_limit_have_diverged_and_are_counted() -> None:
    force = np.clip(60e3 * np.sin(2 * np.pi * np.arange(6000) / RATE), -30e3, 30e3)
    lane = measure(made(sine(30.0), force), 5.0, 30e3).lane(0)
    # |sin| above one half two thirds of the time
    assert lane["saturated_share"] == pytest.approx(2 / 3, abs=0.01)
    assert lane["diverged"] is True
    assert lane["force_peak"] == 30e3


def test_a_lane_that_blew_up_has_no_numbers_but_says_so() -> None:
    signal = sine(30.0)
    signal[3000:] = np.nan
    lane = measure(made(signal), 5.0, 30e3).lane(0)
    assert lane["diverged"] is True
    assert lane["ride_index_front"] is None
    assert lane["bogie_rms"] is None
