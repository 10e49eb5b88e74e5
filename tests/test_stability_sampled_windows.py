"""Stable windows of sampled loops, against closed forms and the proved continuous answer."""

import numpy as np
import pytest

from baselines import SkyHook
from baselines.passive import Passive
from railenv.errors import ArgumentError
from railenv.stability import (
    DelaySystem,
    SampledLoop,
    critical_delays,
    lifted_roots,
    sampled_critical_delay,
    sampled_roots,
    sampled_windows,
    unstable_at,
)
from railenv.stability.lifted_roots import at_multiple, just_before
from railenv.vehicle import lateral17

PERIOD = 0.01
VEHICLE = lateral17("paper_fit", 4, 300.0)


def static(A, B, gain, period: float = PERIOD) -> SampledLoop:
    return SampledLoop.from_delay_system(
        DelaySystem(np.array(A), np.array(B), np.array(gain)), period
    )


def integrator(periods: int) -> SampledLoop:
    """x_(k+1) = x_k - a x_(k-d) with the gain at which d periods of delay are critical."""
    gain = 2.0 * np.sin(np.pi / (2 * (2 * periods + 1))) / PERIOD
    return static([[0.0]], [[1.0]], [[gain]])


def oscillator(damping: float, gain: float, period: float) -> tuple[DelaySystem, SampledLoop]:
    """x'' + 20^2 x = -damping x' + gain x'(t - tau): unstable for gain > damping without delay."""
    system = DelaySystem(
        np.array([[0.0, 1.0], [-400.0, -damping]]),
        np.array([[0.0], [1.0]]),
        np.array([[0.0, -gain]]),
    )
    return system, SampledLoop.from_delay_system(system, period)


def pipe() -> SampledLoop:
    """A law that expects its command of two samples ago in the reading, u_k = 1.5 (u_(k-2) - y_k).

    The plant all but ignores the force, and the reading is the acting force, y_k = u_(k-1-d) after
    d periods of delay. So d = 1 cancels to u_k = 0, and any other d leaves z^2 + 1.5 z - 1.5 = 0
    (d = 0), z^3 - 1.5 z + 1.5 = 0 (d = 2) and so on, with roots outside the unit circle.
    """
    return SampledLoop(
        A=np.array([[-1.0]]),
        B=np.array([[1e-9]]),
        C=np.zeros((1, 1)),
        D=np.ones((1, 1)),
        period=PERIOD,
        Ac=np.array([[0.0, 1.5], [1.0, 0.0]]),
        Bc=np.array([[-1.5], [0.0]]),
        Cc=np.array([[0.0, 1.5]]),
        Dc=np.array([[-1.5]]),
    )


@pytest.mark.parametrize("periods", [1, 2, 5, 9])
def test_a_sampled_integrator_is_lost_at_its_textbook_delay(periods: int) -> None:
    found = sampled_windows(integrator(periods), 0.12)
    # Brent's method stops at 1e-12 of the delay; the root's speed and rounding leave a little more.
    assert found.critical_delay == pytest.approx(periods * PERIOD, rel=1e-6)
    assert found.first is not None
    assert found.first.frequency_hz == pytest.approx(
        1.0 / (2.0 * (2 * periods + 1) * PERIOD), rel=1e-6
    )
    assert (found.first.direction, found.first.unstable_after, found.first.jump) == (1, 2, False)


def test_windows_are_the_proved_continuous_ones_less_half_a_period() -> None:
    period = 5e-3
    system, loop = oscillator(0.4, 2.0, period)
    exact = critical_delays(system, 0.6)
    found = sampled_windows(loop, 0.5)
    wanted = [(low, high) for low, high in exact.stable_windows if high < 0.5]
    assert exact.proved
    assert found.unstable_without_delay == exact.unstable_without_delay == 2
    # The hold adds half a period and terms of T (omega T)^2, here some 1e-5 s.
    np.testing.assert_allclose(
        np.array(found.stable_windows[: len(wanted)]), np.array(wanted) - period / 2, atol=4e-5
    )
    assert len(wanted) >= 1
    assert found.critical_delay == 0.0


def test_a_mode_at_a_crossing_stands_on_the_unit_circle() -> None:
    _, loop = oscillator(0.4, 2.0, 5e-3)
    for crossing in sampled_windows(loop, 0.5).crossings:
        # Located to the width of the circle, 1e-9 in ln z, and rounding.
        assert abs(crossing.mode.root.real) * loop.period < 1e-8


def test_without_delay_the_first_loss_is_that_of_the_other_lifted_map() -> None:
    system = SkyHook(35e3, 4).to_delay_system(VEHICLE)
    loop = SkyHook(35e3, 4).to_sampled_loop(VEHICLE, PERIOD)
    wanted = sampled_critical_delay(system, critical_delays(system, 0.25), PERIOD)
    # Both stop at 1e-12 of the delay; the eigenvalues carry some 1e-9 of rounding.
    assert sampled_windows(loop, 0.25).critical_delay == pytest.approx(wanted, rel=1e-7)


def test_a_law_that_counts_on_one_delay_is_stable_from_that_jump_to_the_next() -> None:
    found = sampled_windows(pipe(), 0.05)
    assert found.stable_windows == ((PERIOD, 2 * PERIOD),)
    assert [crossing.jump for crossing in found.crossings] == [True, True]
    # z^2 + 1.5 z - 1.5 = 0 has one root outside, -2.19, an alternation; so has d = 2, -1.60.
    assert found.unstable_without_delay == 1
    assert [crossing.unstable_after for crossing in found.crossings] == [0, 1]
    assert [crossing.frequency_hz for crossing in found.crossings] == pytest.approx([50.0, 50.0])


def test_a_jump_belongs_to_the_window_that_it_opens_and_not_to_the_one_it_ends() -> None:
    loop = pipe()
    inside = [PERIOD, just_before(2 * PERIOD, PERIOD)]
    beside = [just_before(PERIOD, PERIOD), 2 * PERIOD]
    assert all(loop.growth_rate(delay) < 0.0 for delay in inside)
    assert all(loop.growth_rate(delay) > 0.0 for delay in beside)
    assert [unstable_at(loop, k * PERIOD) for k in range(3)] == [1, 0, 1]


def test_a_window_between_two_looks_is_found_only_where_one_asks() -> None:
    # Negative damping leaves the half period, 157 ms, a window of some 20 ms less 25 ms of hold.
    _, loop = oscillator(-1.86, 2.0, 0.05)
    missed = sampled_windows(loop, 0.25, resolution=0.05)
    found = sampled_windows(loop, 0.25, resolution=0.05, also=(0.132,))
    assert missed.stable_windows == ()
    assert len(found.stable_windows) == 1
    low, high = found.stable_windows[0]
    assert 0.1 < low < 0.132 < high < 0.15
    finer = sampled_windows(loop, 0.25).stable_windows
    np.testing.assert_allclose(finer, found.stable_windows, rtol=1e-9)


def test_decimal_delays_are_the_periods_they_mean() -> None:
    for number in range(1, 300):
        place = at_multiple(number / 100, PERIOD)
        assert np.floor(place / PERIOD) == number
        assert place == pytest.approx(number / 100, rel=1e-15)
        assert np.floor(just_before(place, PERIOD) / PERIOD) == number - 1
    assert at_multiple(0.1234, PERIOD) == 0.1234
    assert at_multiple(0.0, PERIOD) == 0.0


def test_a_delay_that_rounding_puts_before_its_multiple_is_read_as_the_multiple() -> None:
    # 0.29 / 0.01 < 29 as doubles; the law that counts on 29 periods is stable from there on.
    states = 30
    shift = np.eye(states, k=-1)
    shift[0, -1] = 1.5
    inward, outward = np.zeros((states, 1)), np.zeros((1, states))
    inward[0], outward[0, -1] = -1.5, 1.5
    small = pipe()
    loop = SampledLoop(small.A, small.B, small.C, small.D, PERIOD, shift, inward, outward, small.Dc)
    assert unstable_at(loop, 0.29) == 0
    assert unstable_at(loop, 0.289999) > 0
    assert sampled_windows(loop, 0.31).stable_windows[0] == pytest.approx((0.29, 0.3))


def test_roots_of_static_feedback_are_those_of_the_other_lifted_map() -> None:
    system = SkyHook(35e3, 4).to_delay_system(VEHICLE)
    loop = SkyHook(35e3, 4).to_sampled_loop(VEHICLE, PERIOD)
    for delay in (0.123, (0.05, 0.07, 0.05, 0.12)):
        first, second = lifted_roots(loop, delay, 6), sampled_roots(system, delay, PERIOD, 6)
        # Eigenvalues of two differently balanced maps agree to some 1e-8.
        np.testing.assert_allclose(
            [mode.root for mode in first], [mode.root for mode in second], rtol=1e-6
        )
        assert np.abs(first[0].shape).max() == 1.0
        np.testing.assert_allclose(first[0].shape, second[0].shape, atol=1e-5)


def test_the_dominant_root_has_the_growth_rate_of_the_loop() -> None:
    loop = SkyHook(35e3, 4).to_sampled_loop(VEHICLE, PERIOD)
    # One eigenvalue routine gives vectors and the other does not: rounding.
    assert lifted_roots(loop, 0.2)[0].root.real == pytest.approx(loop.growth_rate(0.2), rel=1e-7)


def test_a_mode_of_the_law_alone_has_no_shape_on_the_plant() -> None:
    plant = pipe()
    loop = SampledLoop(
        plant.A,
        plant.B,
        plant.C,
        np.zeros((1, 1)),
        PERIOD,
        np.array([[0.9]]),
        np.ones((1, 1)),
        np.zeros((1, 1)),
        np.zeros((1, 1)),
    )
    law, own = lifted_roots(loop, 0.0, 2)[::-1]
    assert not law.shape.any()
    assert own.root.real == pytest.approx(-1.0)


def test_a_marginal_loop_is_not_called_stable() -> None:
    found = sampled_windows(static([[0.0]], [[1.0]], [[0.0]]), 0.05)
    assert found.unstable_without_delay == 1
    assert found.stable_windows == ()


def test_without_channels_one_look_serves_every_delay() -> None:
    loop = Passive().to_sampled_loop(lateral17("paper_fit", "passive", 300.0), PERIOD)
    found = sampled_windows(loop, 0.5)
    assert (found.looks, found.stable_windows, found.critical_delay) == (1, ((0.0, 0.5),), None)


def test_nothing_is_said_to_be_proved() -> None:
    assert not sampled_windows(integrator(1), 0.02).proved


def test_the_longest_delay_need_not_be_a_whole_number_of_periods() -> None:
    delays: list[float] = []
    sampled_windows(integrator(5), 0.0137, progress=delays.append)
    assert delays[0] == 0.0
    assert delays[-1] == 0.0137
    assert np.diff(delays).max() <= 2.5e-3 + 1e-12


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"max_delay": 0.0}, "max_delay"),
        ({"max_delay": float("nan")}, "max_delay"),
        ({"max_delay": 0.1, "resolution": -1.0}, "resolution"),
        ({"max_delay": 0.1, "also": (0.2,)}, "beyond max_delay"),
        ({"max_delay": 0.1, "also": (-0.2,)}, "also"),
        ({"max_delay": 50.0}, "give 12 s or less"),
    ],
)
def test_bad_arguments_are_refused_by_name(settings: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        sampled_windows(integrator(1), **settings)
