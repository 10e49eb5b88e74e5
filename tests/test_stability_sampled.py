"""Sampled loops: the lifted map against hand-made maps, and critical delays under sampling."""

import numpy as np
import pytest

from railenv.errors import ArgumentError
from railenv.stability import (
    DelaySystem,
    critical_delays,
    rightmost_roots,
    sampled_critical_delay,
    sampled_growth_rate,
    sampled_roots,
)
from railenv.stability.sampled import _followed, lifted_matrix


def integrator(k: float) -> DelaySystem:
    """x' = -k x(t - tau)."""
    return DelaySystem([[0.0]], [[1.0]], [[k]])


def test_a_held_integrator_without_delay_has_its_known_pole() -> None:
    # x+ = (1 - k T) x
    assert np.abs(np.linalg.eigvals(lifted_matrix(integrator(2.0), 0.0, 0.1))).max() == (
        pytest.approx(0.8, rel=1e-14)
    )


@pytest.mark.parametrize("whole", [0, 1, 3])
@pytest.mark.parametrize("rest", [0.0, 0.25, 0.999])
def test_a_fractional_delay_splits_the_hold(whole: int, rest: float) -> None:
    T, k = 0.1, 3.0
    z = np.linalg.eigvals(lifted_matrix(integrator(k), (whole + rest) * T, T))
    z = z[np.abs(z) > 1e-3]
    # z^(d+2) - z^(d+1) + k T ((1 - r) z + r) = 0
    polynomial = z ** (whole + 2) - z ** (whole + 1) + k * T * ((1 - rest) * z + rest)
    np.testing.assert_allclose(polynomial, 0.0, atol=1e-12)


def test_the_sampled_integrator_goes_unstable_at_two_over_gain() -> None:
    # 1 - k T = -1 without delay; the continuous loop crosses at pi / (2 k)
    k = 4.0
    system = integrator(k)
    continuous = critical_delays(system)
    assert sampled_critical_delay(system, continuous, 2.1 / k) == 0.0
    assert (
        sampled_growth_rate(system, 0.0, 1.9 / k) < 0.0 < sampled_growth_rate(system, 0.0, 2.1 / k)
    )


def test_ten_milliseconds_of_hold_turn_202_into_197_ms(
    loop: DelaySystem,
) -> None:
    continuous = critical_delays(loop)
    assert sampled_critical_delay(loop, continuous, 0.01) == pytest.approx(0.19705, abs=2e-5)


@pytest.mark.parametrize(("period", "error"), [(0.002, 5e-6), (0.005, 1e-5), (0.01, 5e-5)])
def test_sampling_costs_half_a_period_up_to_its_square(
    loop: DelaySystem, period: float, error: float
) -> None:
    continuous = critical_delays(loop, 0.5)
    sampled = sampled_critical_delay(loop, continuous, period)
    assert continuous.critical_delay is not None
    assert sampled == pytest.approx(continuous.critical_delay - period / 2, abs=error)


def test_at_the_sampled_critical_delay_the_growth_is_zero(loop: DelaySystem) -> None:
    delay = sampled_critical_delay(loop, critical_delays(loop, 0.5), 0.02)
    assert delay is not None
    # d(growth)/d(delay) is about 14 1/s^2, the delay is located to 1e-10 s
    assert sampled_growth_rate(loop, delay, 0.02) == pytest.approx(0.0, abs=1e-8)


def test_fast_sampling_tends_to_the_continuous_root(loop: DelaySystem) -> None:
    continuous = rightmost_roots(loop, 0.1, 1)[0].root
    errors = [
        abs(sampled_roots(loop, 0.1 - period / 2, period, 1)[0].root - continuous)
        for period in (0.01, 0.005)
    ]
    # halving the period quarters what is left after half a period of delay
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.1)


def test_no_crossing_within_the_search_is_none() -> None:
    slow = integrator(0.1)
    assert sampled_critical_delay(slow, critical_delays(slow, 1.0), 0.05) is None


@pytest.mark.parametrize("period", [0.0, -0.01, np.nan])
def test_a_bad_period_is_refused(loop: DelaySystem, period: float) -> None:
    with pytest.raises(ArgumentError, match="period"):
        lifted_matrix(loop, 0.1, period)


def test_following_the_crossing_gives_what_the_lifted_map_gives(loop: DelaySystem) -> None:
    continuous = critical_delays(loop, 0.5)
    assert continuous.first is not None
    lifted = sampled_critical_delay(loop, continuous, 0.01)
    assert _followed(loop.scaled, continuous.first, 0.01) == pytest.approx(lifted, rel=1e-11)


def test_a_short_period_follows_the_crossing_at_half_a_period_less(loop: DelaySystem) -> None:
    continuous = critical_delays(loop, 0.5)
    assert continuous.critical_delay is not None
    # 0.1 ms: a map of four thousand rows is not built; the hold's second order is 1e-9 s
    sampled = sampled_critical_delay(loop, continuous, 1e-4)
    assert sampled == pytest.approx(continuous.critical_delay - 0.5e-4, abs=1e-8)


def test_a_map_of_any_size_is_refused_and_not_built(loop: DelaySystem) -> None:
    with pytest.raises(ArgumentError, match="too many parts"):
        lifted_matrix(loop, 0.2, 1e-9)
    with pytest.raises(ArgumentError, match="too short"):
        sampled_critical_delay(loop, critical_delays(loop, 0.5), 1e-12)
