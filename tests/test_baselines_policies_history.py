"""What policies see and remember, and what they are told."""

from dataclasses import replace

import numpy as np
import pytest
from policy_examples import (
    VEHICLE,
    history,
    linear,
    played,
    small_readings,
)

from baselines import SkyHook
from baselines.policies import History, LinearPolicy
from baselines.policies.realisation import gains_by_age
from eval.rollout import ControlledBatch, Stepping, rollout
from railenv.errors import ArgumentError, ControllerError


def test_the_features_are_readings_by_age_and_then_actions_by_age() -> None:
    seen = History.of(
        4, ("carbody_roll_rate", "carbody_yaw_rate"), sensor_lags=(0, 2), action_lags=(1, 3)
    )
    assert seen.feature_names == (
        "carbody_roll_rate",
        "carbody_yaw_rate",
        "carbody_roll_rate_ago_2",
        "carbody_yaw_rate_ago_2",
        "action_1_ago_1",
        "action_1_ago_2",
        "action_3_ago_1",
        "action_3_ago_2",
    )
    assert seen.num_features == 8


def test_a_policy_plays_the_sum_over_its_history_written_out() -> None:
    policy = linear(action_lags=(1, 3))
    seen, told = policy.history, np.array([0.04, 0.17])
    readings = small_readings(policy, 12, 2, 0.3)
    actions = played(policy, readings, told)
    past = np.zeros((12, 2, 2))
    for step in range(12):
        for lane in range(2):
            gains = policy.gains_at(float(told[lane]))
            G, F = gains_by_age(seen, gains)
            total = sum(G[h] @ readings[step - h, lane] for h in range(len(G)) if h <= step)
            total = total + sum(
                F[h - 1] @ past[step - h, lane] for h in range(1, len(F) + 1) if h <= step
            )
            past[step, lane] = np.clip(total, -1.0, 1.0)
    # Sums of some hundred terms of order one in another order.
    np.testing.assert_allclose(actions, np.repeat(past, 2, axis=2), atol=1e-13)


def test_gains_between_knots_are_interpolated_and_constant_beyond() -> None:
    policy = linear()
    np.testing.assert_allclose(
        policy.gains_at(0.025), 0.75 * policy.weights[0] + 0.25 * policy.weights[1], rtol=1e-15
    )
    np.testing.assert_array_equal(policy.gains_at(0.9), policy.weights[2])
    hat = policy.history.hat(np.array([0.0, 0.2, 0.3, 0.5]))
    expected = [[1, 0, 0], [0, 0.5, 0.5], [0, 0, 1], [0, 0, 1]]
    np.testing.assert_allclose(hat, expected, atol=1e-15)  # 0.2 is no binary number


def test_the_cut_is_what_is_remembered() -> None:
    policy = linear(size=1.0)
    readings = small_readings(policy, 8, 1, 5.0)
    actions = played(policy, readings, np.array([0.1]))
    assert np.abs(actions).max() == 1.0
    np.testing.assert_array_equal(np.abs(policy._actions) <= 1.0, True)


def test_a_policy_that_needs_to_be_told_and_was_not_says_so() -> None:
    policy = linear()
    policy.reset(2, 0)
    with pytest.raises(ArgumentError, match="call tell"):
        policy.act(np.zeros((2, 16)))
    policy.tell(np.zeros(2))
    policy.act(np.zeros((2, 16)))
    policy.reset(2, 0)
    with pytest.raises(ArgumentError, match="call tell"):
        policy.act(np.zeros((2, 16)))
    with pytest.raises(ArgumentError, match="one number per lane"):
        policy.tell(np.zeros(3))
    with pytest.raises(ArgumentError, match="zero or more"):
        policy.tell(np.array([0.1, -0.1]))


class Listener:
    """Notes what it is told."""

    def __init__(self) -> None:
        self.told: list[np.ndarray] = []

    def reset(self, num_lanes: int, seed: int) -> None:
        self.told.append(np.zeros(0))

    def tell(self, delays: np.ndarray) -> None:
        self.told.append(delays)

    def act(self, observations: np.ndarray) -> np.ndarray:
        return np.zeros((len(observations), 4))


@pytest.mark.slow
def test_a_rollout_tells_the_mean_of_the_channels_and_the_error_after_the_reset() -> None:
    delays = np.array([[0.1, 0.1, 0.1, 0.1], [0.0, 0.1, 0.2, 0.3], [0.01, 0.01, 0.01, 0.01]])
    for error, expected in ((0.0, [0.1, 0.15, 0.01]), (-0.02, [0.08, 0.13, 0.0])):
        listener = Listener()
        rollout(listener, VEHICLE, delays, 0.02, stepping=replace(Stepping(), told_error=error))
        before, told = listener.told
        assert len(before) == 0
        np.testing.assert_allclose(told, expected, atol=1e-16)


def test_a_told_policy_in_a_rollout_plays_the_gains_of_the_told_delay() -> None:
    policy = linear()
    delays = np.repeat(np.array([[0.1], [0.1]]), 4, axis=1)
    runs = [
        rollout(
            policy,
            VEHICLE,
            delays,
            0.5,
            seed=1,
            stepping=Stepping(told_error=error, sensor_noise=0.1),
        ).values
        for error in (0.0, 0.05)
    ]
    assert np.abs(runs[0] - runs[1]).max() > 1e-3


@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"sensor_lags": (1, 2)}, "must begin with 0"),
        ({"sensor_lags": (0, 2, 2)}, "must rise"),
        ({"action_lags": (0, 1)}, "too small"),
        ({"action_lags": (1, 10**9)}, "10000 are the most"),
        ({"told_knots": (0.1, 0.2)}, "rise from 0"),
        ({"told_knots": (0.0, float("nan"))}, "must be finite"),
        ({"action": "wheels"}, "unknown action"),
        ({"layout": "passive"}, "no actuator"),
        ({"control_period": 0.0}, "above zero"),
        ({"action_scale": True}, "not a number"),
    ],
)
def test_a_history_that_cannot_be_is_refused_by_name(fields: dict[str, object], match: str) -> None:
    with pytest.raises(ArgumentError, match=match):
        history(**fields)


def test_a_policy_with_weights_that_do_not_fit_is_refused() -> None:
    seen = history()
    with pytest.raises(ArgumentError, match="weights has shape"):
        LinearPolicy(seen, np.zeros((3, 2, 5)))
    bad = np.zeros((3, 2, seen.num_features))
    bad[0, 0, 0] = np.nan
    with pytest.raises(ArgumentError, match="not finite"):
        LinearPolicy(seen, bad)
    with pytest.raises(ArgumentError, match="layout 2"):
        LinearPolicy(seen, np.zeros(bad.shape), SkyHook(1e4, 2))
    with pytest.raises(ArgumentError, match="period"):
        linear().to_sampled_loop(VEHICLE, 0.02)
    with pytest.raises(ControllerError, match="call reset"):
        ControlledBatch(_Forgetful(), VEHICLE, (), Stepping()).reset(np.zeros((1, 4)))


class _Forgetful(Listener):
    """Is told before it is ready."""

    def tell(self, delays: np.ndarray) -> None:
        raise ValueError("call reset")
