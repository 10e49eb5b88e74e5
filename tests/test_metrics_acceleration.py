"""Plain measures of an acceleration: closed forms and errors."""

import subprocess
import sys

import numpy as np
import pytest

from railenv.errors import ArgumentError
from railenv.metrics import peak, percentile_abs, rms

PHASE = 2.0 * np.pi * np.arange(1000) / 100.0


def test_rms_of_a_sine_over_whole_periods_is_its_amplitude_by_root_two():
    assert rms(3.0 * np.sin(PHASE)) == pytest.approx(3.0 / np.sqrt(2.0), rel=1e-12)  # rounding


def test_rms_is_about_zero_and_not_about_the_mean():
    assert rms([2.0, 2.0]) == 2.0


def test_peak_is_the_largest_magnitude_of_either_sign():
    assert peak([1.0, -4.0, 3.0]) == 4.0


def test_percentile_is_of_magnitudes_and_interpolates():
    assert percentile_abs([0.0, -1.0, 2.0, -3.0, 4.0], 95.0) == pytest.approx(3.8, rel=1e-12)


@pytest.mark.parametrize("measure", [rms, peak, lambda a: percentile_abs(a, 50.0)])
def test_time_is_the_last_axis_of_a_batch(measure):
    signals = np.random.default_rng(1).normal(size=(2, 3, 40))
    looped = [[measure(lane) for lane in row] for row in signals]
    np.testing.assert_allclose(measure(signals), looped, rtol=1e-12)  # order of summation


@pytest.mark.parametrize("measure", [rms, peak])
def test_single_signal_gives_a_float(measure):
    assert type(measure([1.0, 2.0])) is float


@pytest.mark.parametrize("measure", [rms, peak, lambda a: percentile_abs(a, 50.0)])
def test_sample_that_is_not_finite_is_an_error(measure):
    with pytest.raises(ArgumentError, match="1 of 3 samples"):
        measure([0.0, np.inf, 1.0])


def test_percentage_out_of_range_is_an_error():
    with pytest.raises(ArgumentError, match="from 0 to 100"):
        percentile_abs([1.0], 101.0)


def test_importing_the_metrics_loads_no_heavy_package():
    code = (
        "import sys, railenv.metrics;"
        "print([m for m in ('scipy.signal', 'matplotlib', 'torch', 'numba')"
        " if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
