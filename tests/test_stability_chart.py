"""Stability charts: closed forms, failures kept, one result on any number of workers."""

import json
import multiprocessing
import time
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from railenv.errors import ArgumentError, RailenvError
from railenv.stability import DelaySystem, critical_delays
from railenv.stability.chart import StabilityChart, stability_chart

STIFFNESS = 40.0


def oscillator(damping: float, gain: float) -> DelaySystem:
    """x'' + damping x' + 40 x = -gain x'(t - tau)."""
    A = np.array([[0.0, 1.0], [-STIFFNESS, -damping]])
    return DelaySystem(A, np.array([[0.0], [1.0]]), np.array([[0.0, gain]]))


def picky(damping: float, gain: float) -> DelaySystem:
    if gain > 5.0:
        raise ArgumentError(f"gain = {gain:g} is refused")
    return oscillator(damping, gain)


def slow(damping: float, gain: float) -> DelaySystem:
    time.sleep(0.05)
    return oscillator(damping, gain)


def broken(damping: float, gain: float) -> DelaySystem:
    raise TypeError("a fault of the function itself")


def skyhook(gain: float, speed_kmh: float) -> DelaySystem:
    from baselines import SkyHook  # here, so that workers need not load it
    from railenv.vehicle import lateral17

    return SkyHook(gain, 4).to_delay_system(lateral17("paper_fit", 4, speed_kmh))


def oscillator_chart(**options) -> StabilityChart:
    # no gain equals a damping: roots on the imaginary axis without delay, or touching it
    dampings, gains = np.linspace(-1.0, 3.0, 9), np.linspace(0.35, 8.05, 12)
    return stability_chart(
        partial(oscillator), "damping", dampings, "gain", gains, max_delay=10.0, **options
    )


def test_every_point_of_an_oscillators_chart_is_its_closed_form() -> None:
    chart = oscillator_chart()
    c, g = np.meshgrid(chart.x_values, chart.y_values)
    crosses = g > np.abs(c)
    root = np.sqrt(np.where(crosses, g**2 - c**2, 0.0))
    omega = (root + np.sqrt(root**2 + 4 * STIFFNESS)) / 2
    tau = np.arccos(np.where(crosses, -c / g, 0.0)) / omega
    expected = np.where(crosses, tau, np.where(c + g < 0.0, 0.0, np.inf))
    # the oracle's own accuracy; Newton's iteration leaves some 1e-14
    np.testing.assert_allclose(chart.critical_delay, expected, rtol=1e-9)
    np.testing.assert_allclose(
        chart.frequency_hz, np.where(crosses, omega, 0.0) / (2 * np.pi), rtol=1e-9
    )
    assert set(chart.status.ravel()) == {"critical", "unstable", "always"}


def test_the_vehicles_critical_delays_stand_in_the_chart() -> None:
    chart = stability_chart(skyhook, "gain", [35e3, 60e3], "speed_kmh", [300.0])
    assert 1000 * chart.critical_delay == pytest.approx(np.array([[202.026, 141.884]]), abs=1e-3)


def test_rows_are_y_and_columns_are_x() -> None:
    chart = stability_chart(oscillator, "damping", [0.1, 0.2, 0.3], "gain", [1.0, 2.0])
    assert chart.critical_delay.shape == (2, 3)
    there = critical_delays(oscillator(0.3, 1.0))
    assert chart.critical_delay[0, 2] == there.critical_delay
    assert chart.stable_windows[0, 2] == len(there.stable_windows)
    assert bool(chart.proved[0, 2]) is there.proved


def test_falling_values_are_an_axis_too() -> None:
    chart = stability_chart(oscillator, "damping", [0.3, 0.2], "gain", [1.0])
    assert chart.critical_delay[0, 0] == critical_delays(oscillator(0.3, 1.0)).critical_delay


def test_stability_that_comes_back_is_marked() -> None:
    chart = oscillator_chart()
    again = chart.stable_again
    assert again.any()
    for row, column in np.argwhere(again)[:5]:
        c, g = float(chart.x_values[column]), float(chart.y_values[row])
        windows = critical_delays(oscillator(c, g), 10.0).stable_windows
        assert windows[-1][0] > chart.critical_delay[row, column]
    quiet = np.isposinf(chart.critical_delay)
    assert np.all(chart.stable_windows[quiet] == 1)
    assert not again[quiet].any()


def test_a_point_that_is_refused_keeps_its_reason_and_the_others_their_answer() -> None:
    chart = stability_chart(picky, "damping", [0.1, 0.2], "gain", [4.0, 6.0])
    assert chart.failures == {(1, 0): "gain = 6 is refused", (1, 1): "gain = 6 is refused"}
    assert list(chart.status[1]) == ["failed", "failed"]
    assert list(chart.status[0]) == ["critical", "critical"]


def test_no_array_holds_nan_and_no_comparison_takes_a_failed_point_for_stable() -> None:
    chart = stability_chart(picky, "damping", [0.1], "gain", [0.05, 4.0, 6.0])
    assert not np.isnan(chart.critical_delay).any()
    assert list((chart.critical_delay > 0.001).ravel()) == [True, True, False]


def test_a_fault_of_the_function_itself_stops_the_chart() -> None:
    with pytest.raises(TypeError, match="fault"):
        stability_chart(broken, "damping", [0.1], "gain", [1.0])


@pytest.mark.slow
def test_the_chart_does_not_depend_on_the_number_of_workers() -> None:
    one, two = oscillator_chart(), oscillator_chart(jobs=2)
    for name in ("critical_delay", "frequency_hz", "stable_windows", "proved", "status"):
        np.testing.assert_array_equal(getattr(one, name), getattr(two, name))
    assert multiprocessing.active_children() == []


def test_progress_counts_every_point() -> None:
    told: list[tuple[int, int]] = []
    oscillator_chart(progress=lambda done, total: told.append((done, total)))
    assert told == [(k, 108) for k in range(1, 109)]


@pytest.mark.slow
def test_an_interruption_leaves_no_worker() -> None:
    def interrupt(done: int, total: int) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        stability_chart(
            slow, "damping", np.linspace(0, 1, 50), "gain", [1.0, 2.0], jobs=2, progress=interrupt
        )
    assert multiprocessing.active_children() == []


def test_the_arrays_of_a_chart_cannot_be_changed() -> None:
    chart = stability_chart(oscillator, "damping", [0.1], "gain", [1.0])
    with pytest.raises(ValueError, match="read-only"):
        chart.critical_delay[0, 0] = 1.0


def test_a_saved_chart_can_be_read_without_unpickling(tmp_path: Path) -> None:
    chart = stability_chart(picky, "damping", [0.1, 0.2], "gain", [4.0, 6.0])
    chart.save(tmp_path / "chart.npz", {"what": "oscillator"})
    with np.load(tmp_path / "chart.npz", allow_pickle=False) as archive:
        np.testing.assert_array_equal(archive["critical_delay"], chart.critical_delay)
        assert str(archive["x_name"]) == "damping"
        assert archive["failed_points"].tolist() == [[1, 0], [1, 1]]
        assert archive["failed_reasons"].tolist() == ["gain = 6 is refused"] * 2
        assert json.loads(str(archive["settings"])) == {"what": "oscillator"}


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"x_values": []}, "x_values has 0 values"),
        ({"x_values": [1.0, 1.0]}, "sorted, none twice"),
        ({"y_values": [1.0, 3.0, 2.0]}, "y_values has 3 values"),
        ({"y_values": [1.0, float("nan")]}, "y_values"),
        ({"max_delay": 0.0}, "max_delay = 0"),
        ({"jobs": 0}, "jobs = 0"),
        ({"make_system": lambda x, y: oscillator(x, y), "jobs": 2}, "cannot be sent to a worker"),
    ],
)
def test_bad_arguments_are_named(changes: dict, words: str) -> None:
    usual = {"make_system": oscillator, "x_name": "damping", "x_values": [0.1, 0.2]}
    with pytest.raises(ArgumentError, match=words):
        stability_chart(**{**usual, "y_name": "gain", "y_values": [1.0], **changes})


def leave(damping: float, gain: float) -> DelaySystem:
    import os

    os._exit(3)


@pytest.mark.slow
def test_a_worker_that_dies_is_an_error_and_leaves_no_other() -> None:
    with pytest.raises(RailenvError, match="worker process of the chart died"):
        stability_chart(leave, "damping", [0.1, 0.2], "gain", [1.0], jobs=2)
    assert multiprocessing.active_children() == []
