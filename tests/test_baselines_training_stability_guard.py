"""The guard: growth rates against eigenvalues, gradients against differences, what is drawn."""

import numpy as np
import pytest

from baselines.policies import History, LinearPolicy
from baselines.skyhook import SkyHook
from baselines.training.stability_guard import GuardedDelays, StabilityGuard
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, lateral17

KNOTS = (0.0, 0.1, 0.3)


@pytest.fixture(scope="module")
def vehicle() -> LateralVehicle:
    return lateral17("paper_fit", 4, 300.0)


def policy(scale: float = 0.02, seed: int = 3, **fields: object) -> LinearPolicy:
    history = History.of(4, sensor_lags=(0, 2), action_lags=(1, 2, 5), told_knots=KNOTS)
    shape = (history.num_knots, history.num_actions, history.num_features)
    weights = scale * np.random.default_rng(seed).standard_normal(shape)
    return LinearPolicy(history, weights, **fields)  # pyright: ignore


def guard(vehicle: LateralVehicle, lag: float = 0.0, **fields: float) -> StabilityGuard:
    chosen = {"low": 0.0, "high": 0.3, "told_error": 0.02, **fields}
    return StabilityGuard(vehicle, ActuatorSpec(lag=lag), GuardedDelays(**chosen))  # pyright: ignore


def moved(given: LinearPolicy, change: FloatArray) -> LinearPolicy:
    """Change the gains that are in use at a told delay, at all knots alike."""
    return LinearPolicy(given.history, given.weights + change, base=given.base)


# Without delay, right before and after a whole period, and told wrong; with an actuator's lag too.
@pytest.mark.parametrize("lag", [0.0, 0.02])
@pytest.mark.parametrize(
    ("delay", "told"), [(0.0, 0.0), (0.09 - 1e-6, 0.1), (0.09 + 1e-6, 0.07), (0.234, 0.25)]
)
def test_the_gradient_is_that_of_the_growth_rate(
    vehicle: LateralVehicle, delay: float, told: float, lag: float
) -> None:
    own = guard(vehicle, lag)
    given = policy(base=SkyHook(10e3, 4))
    rate, gradient = own.growth(given, delay, told)
    law = given.law_at(told)
    loop = law.to_sampled_loop(vehicle, given.control_period, ActuatorSpec(lag=lag))
    assert rate == pytest.approx(loop.growth_rate(delay), abs=1e-9)
    change = 1e-7 * np.random.default_rng(5).standard_normal(gradient.shape)
    up, down = (own.growth(moved(given, s * change), delay, told)[0] for s in (1, -1))
    # Central differences of steps of 1e-7 are off by rounding of eigenvalues, some 1e-11 1/s.
    expected = (up - down) / 2.0
    assert abs(expected) > 1e-8
    assert np.sum(gradient * change) == pytest.approx(expected, rel=2e-3, abs=1e-10)


def test_a_policy_that_does_nothing_has_no_gradient_and_no_warning(vehicle: LateralVehicle) -> None:
    rate, gradient = guard(vehicle).growth(policy(scale=0.0), 0.1, 0.1)
    assert rate == pytest.approx(-0.006, abs=1e-3)  # the vehicle alone is all but undamped
    assert not gradient.any()


@pytest.mark.slow
def test_following_the_gradient_makes_unstable_loops_stable(vehicle: LateralVehicle) -> None:
    given, own = policy(scale=0.1, base=SkyHook(10e3, 4)), guard(vehicle, looks=6, margin=0.1)
    generator = np.random.default_rng(0)
    first, _ = own.gradient(given, generator)
    assert first > 1.0
    weights = given.weights.copy()
    for _ in range(60):
        _, gradient = own.gradient(LinearPolicy(given.history, weights, base=given.base), generator)
        size = np.linalg.norm(gradient)
        weights = weights - (0.02 * gradient / size if size > 0.0 else 0.0)
    last, _ = own.gradient(LinearPolicy(given.history, weights, base=given.base), generator)
    assert last < first / 2.0


def test_only_rates_beyond_the_margin_count(vehicle: LateralVehicle) -> None:
    calm = policy(scale=0.0, base=SkyHook(10e3, 4))
    near = guard(vehicle, high=0.1, margin=1e-3)
    largest, gradient = near.gradient(calm, np.random.default_rng(1))
    assert largest < -1e-3
    assert not gradient.any()
    _, gradient = guard(vehicle, high=0.1, margin=50.0).gradient(calm, np.random.default_rng(1))
    assert gradient.any()


def test_the_worst_pairs_are_watched_and_the_new_ones_reach_every_edge(
    vehicle: LateralVehicle,
) -> None:
    own = guard(vehicle, looks=200, margin=0.1)
    pairs = own._drawn(policy(), np.random.default_rng(2))
    delay, told = pairs.T
    off = delay / 0.01 - np.round(delay / 0.01)
    beside = np.isclose(np.abs(off), 1e-4, atol=1e-6)
    assert {-1.0, 1.0} <= set(np.sign(off[beside]))
    assert 0.4 < beside.mean() < 0.9
    error = told - delay
    assert delay.min() >= 0.0
    assert delay.max() <= 0.3
    assert told.min() >= 0.0
    assert np.isclose(error, 0.02).any()
    assert np.isclose(error, -0.02).any()
    assert np.abs(error).max() <= 0.02 + 1e-12
    few = guard(vehicle, looks=3, margin=0.1)
    generator = np.random.default_rng(2)
    given = policy(base=SkyHook(10e3, 4))
    few.gradient(given, generator)
    kept = few.watched.copy()
    rates = [few.growth(given, d, t)[0] for d, t in kept]
    assert rates == sorted(rates, reverse=True)
    few.gradient(given, generator)
    assert max(few.growth(given, d, t)[0] for d, t in few.watched) >= rates[0]


def test_a_range_that_is_upside_down_is_refused() -> None:
    with pytest.raises(ArgumentError, match="upside down"):
        GuardedDelays(0.2, 0.1, 0.0)
