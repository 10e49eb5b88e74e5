"""The guard: growth rates against eigenvalues, gradients against differences, what is drawn."""

import numpy as np
import pytest

from baselines.policies import History, LinearPolicy
from baselines.skyhook import SkyHook
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, lateral17

torch = pytest.importorskip("torch")

from torch import Tensor  # noqa: E402

from baselines.policies.gated_module import GatedModule  # noqa: E402
from baselines.policies.torch_modules import (  # noqa: E402
    NetworkModule,
    PolicyModule,
    RecurrentModule,
    module_of,
    policy_of,
)
from baselines.training.stability_guard import GuardedDelays, StabilityGuard  # noqa: E402

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


def slope_of(
    own: StabilityGuard, module: PolicyModule, generator: np.random.Generator
) -> tuple[float, Tensor]:
    """Guard a policy near rest."""
    return own.slope(module.history, module.gains_at_rest, module.base, generator)


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
    module = module_of(policy(scale=0.1, base=SkyHook(10e3, 4)))
    own, generator = guard(vehicle, looks=6, margin=0.1), np.random.default_rng(0)
    first, slope = slope_of(own, module, generator)
    assert first > 1.0
    last = first
    for _ in range(60):
        if slope.requires_grad:
            (gradient,) = torch.autograd.grad(slope, module.weights)
            with torch.no_grad():
                module.weights -= 0.02 * gradient / gradient.norm()
        last, slope = slope_of(own, module, generator)
    assert last < first / 2.0


def test_only_rates_beyond_the_margin_count(vehicle: LateralVehicle) -> None:
    calm = module_of(policy(scale=0.0, base=SkyHook(10e3, 4)))
    near = guard(vehicle, high=0.1, margin=1e-3)
    largest, slope = slope_of(near, calm, np.random.default_rng(1))
    assert largest < -1e-3
    assert not slope.requires_grad
    _, slope = slope_of(guard(vehicle, high=0.1, margin=50.0), calm, np.random.default_rng(1))
    assert slope.requires_grad


def nonlinear(kind: str) -> PolicyModule:
    """A policy that is not linear, with weights large enough to bend near rest."""
    knots = () if kind == "gated" else KNOTS
    history = History.of(4, sensor_lags=(0, 2), action_lags=(1, 2, 5), told_knots=knots)
    module: PolicyModule = (
        GatedModule(history, 3, 2, dtype=torch.float64, base=SkyHook(10e3, 4))
        if kind == "gated"
        else NetworkModule(history, (5, 4), dtype=torch.float64, base=SkyHook(10e3, 4))
    )
    generator = torch.Generator().manual_seed(4)
    with torch.no_grad():
        for name, weight in module.named_parameters():
            gains = name in ("weights", "experts") or weight.shape[-1] == history.num_features
            weight.normal_(std=0.02 if gains else 0.5, generator=generator)
    return module


@pytest.mark.parametrize("kind", ["network", "gated"])
def test_policies_that_are_not_linear_are_guarded_near_rest(
    vehicle: LateralVehicle, kind: str
) -> None:
    module = nonlinear(kind)
    own = guard(vehicle, margin=50.0, looks=1)
    own.watched = np.zeros((0, 2))
    pairs = own._drawn(module.history, np.random.default_rng(6))
    policy = policy_of(module)
    # The oracle's own law at rest, which is put together elsewhere.
    loop = policy.law_at(float(pairs[0, 1])).to_sampled_loop(vehicle, 0.01, ActuatorSpec())
    rate, slope = slope_of(own, module, np.random.default_rng(6))
    assert rate == pytest.approx(loop.growth_rate(float(pairs[0, 0])), abs=1e-7)
    weights = dict(module.named_parameters())
    gradient = torch.autograd.grad(slope, list(weights.values()), allow_unused=True)
    generator = torch.Generator().manual_seed(7)
    for (name, weight), own_slope in zip(weights.items(), gradient, strict=True):
        change = torch.randn(weight.shape, generator=generator, dtype=torch.float64) * 1e-5
        rates: list[float] = []
        for sign in (1, -1):
            with torch.no_grad():
                weight += sign * change
                law = policy_of(module).law_at(float(pairs[0, 1]))
                weight -= sign * change
            near = law.to_sampled_loop(vehicle, 0.01, ActuatorSpec())
            rates.append(near.growth_rate(float(pairs[0, 0])))
        expected = (rates[0] - rates[1]) / 2.0
        found = 0.0 if own_slope is None else float((own_slope * change).sum())
        # Rounding of eigenvalues is some 1e-11 1/s, curvature some 1e-10.
        assert found == pytest.approx(expected, rel=1e-3, abs=2e-9), name


def test_recurrent_policies_have_no_gains_near_rest(vehicle: LateralVehicle) -> None:
    history = History.of(4, sensor_lags=(0,), action_lags=(1,), told_knots=())
    with pytest.raises(ArgumentError, match="states near rest"):
        slope_of(guard(vehicle), RecurrentModule(history, 2), np.random.default_rng(0))


def test_the_worst_pairs_are_watched_and_the_new_ones_reach_every_edge(
    vehicle: LateralVehicle,
) -> None:
    own = guard(vehicle, looks=200, margin=0.1)
    pairs = own._drawn(policy().history, np.random.default_rng(2))
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
    slope_of(few, module_of(given), generator)
    kept = few.watched.copy()
    rates = [few.growth(given, d, t)[0] for d, t in kept]
    assert rates == sorted(rates, reverse=True)
    slope_of(few, module_of(given), generator)
    assert max(few.growth(given, d, t)[0] for d, t in few.watched) >= rates[0]


def test_a_range_that_is_upside_down_is_refused() -> None:
    with pytest.raises(ArgumentError, match="upside down"):
        GuardedDelays(0.2, 0.1, 0.0)
