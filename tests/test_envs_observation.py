"""Columns of the observation: scales, bounds, histories, and what the documentation says."""

import re
from typing import Any

import numpy as np
import pytest

from railenv.envs.observation import bound, pipe_length
from railenv.envs.rail_env import Lateral17Env
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.vehicle import state_space

SHORT: dict[str, Any] = {"episode_seconds": 2.0, "track_pool": 2}
VELOCITIES = tuple(f"carbody_lateral_velocity_{k}" for k in (1, 2, 3, 4))


@pytest.fixture(scope="module", params=["sensors", "state"])
def controlled(request: pytest.FixtureRequest) -> dict[str, float]:
    """Root mean squares under sky-hook 10 kN s/m on track German low, by column, as observed."""
    kind = request.param
    settings: dict[str, Any] = {"track": "german_low", "action_history": 0}
    env = Lateral17VectorEnv(64, observation=kind, **settings)
    names = env.observation_names
    scales = env._lanes.scales
    C, D = state_space(env._lanes.episodes.vehicles[0]).output_rows(VELOCITIES)
    assert not np.any(D)
    to_velocity = np.eye(len(names))[:4] if kind == "sensors" else C
    observations = env.reset(seed=0)[0]
    squares = np.zeros(len(names))
    for period in range(1000):
        actions = -10e3 * (observations * scales) @ to_velocity.T / 3000.0
        observations, _, ended, _, _ = env.step(np.clip(actions, -1.0, 1.0))
        assert not ended.any()
        # the start at rest is over after 3 s
        if period >= 300:
            squares += (observations.astype(float) ** 2).mean(axis=0) / 700
    return dict(zip(names, np.sqrt(squares), strict=True))


def test_every_column_of_the_controlled_vehicle_is_about_one(controlled: dict[str, float]) -> None:
    assert len(controlled) in (16, 38)
    # one scale serves like sensors at several places, and is rounded
    for name, rms in controlled.items():
        assert 0.7 < rms < 1.4, name


@pytest.mark.parametrize("kind", ["sensors", "state"])
def test_scaled_and_unscaled_observations_are_the_same_readings(kind: str) -> None:
    settings = {**SHORT, "observation": kind, "delay_observed": True, "delay": (0.0, 0.3)}
    scaled = Lateral17Env(**settings)
    plain = Lateral17Env(**settings, observation_scale="si")
    assert scaled.observation_names == plain.observation_names
    assert np.all(plain.observation_scales == 1.0)
    for env in (scaled, plain):
        env.reset(seed=1)
    for _ in range(50):
        action = np.array([0.3, -0.2, 0.1, 0.5])
        seen, meant = (env.step(action)[0].astype(float) for env in (scaled, plain))
        # each rounded to float32 once
        np.testing.assert_allclose(seen * scaled.observation_scales, meant, rtol=2e-7, atol=1e-30)


def test_bounds_are_those_of_the_transducers_in_units_of_the_scale() -> None:
    env = Lateral17Env(**SHORT)
    space = env.observation_space
    for column, name in enumerate(env.observation_names[:16]):
        limit, _, scale = bound(name)
        assert space.high[column] == np.float32(limit / scale)
        assert space.low[column] == -space.high[column]
    assert np.all(space.high[16:] == 1.0)


def test_changing_the_returned_scales_changes_nothing() -> None:
    env = Lateral17Env(**SHORT)
    env.observation_scales[:] = 0.0
    assert np.all(env.observation_scales > 0.0)


def test_past_measurements_follow_the_newest_one() -> None:
    env = Lateral17Env(**SHORT, observation_history=3, action_history=0)
    seen = [env.reset(seed=0)[0]]
    assert not np.any(seen[0][16:])
    for _ in range(10):
        seen.append(env.step(np.full(4, 0.2))[0])
        for age in range(1, 4):
            earlier = seen[-1 - age][:16] if len(seen) > age else np.zeros(16)
            np.testing.assert_array_equal(seen[-1][16 * age : 16 * (age + 1)], earlier)


def test_a_column_of_the_past_is_named_after_its_age() -> None:
    env = Lateral17Env(**SHORT, observation_history=2, action_history=1)
    names = env.observation_names
    assert len(names) == len(set(names)) == 3 * 16 + 4
    assert names[16] == "carbody_lateral_velocity_1_ago_1"
    assert names[32] == "carbody_lateral_velocity_1_ago_2"
    assert names[48:] == tuple(f"action_1_ago_{a}" for a in (1, 2, 3, 4))


def test_the_past_of_an_episode_is_not_in_the_next_one() -> None:
    env = Lateral17Env(**SHORT, observation_history=2)
    env.reset(seed=0)
    for _ in range(20):
        env.step(np.ones(4))
    assert not np.any(env.reset(seed=0)[0][16:])


@pytest.mark.parametrize(("given", "expected"), [(None, 30), (0, 0), (1, 1), (7, 7), (40, 40)])
def test_as_many_past_actions_are_observed_as_are_asked_for(given: Any, expected: int) -> None:
    env = Lateral17Env(**SHORT, action_history=given)
    assert env.observation_space.shape == (16 + 4 * expected,)
    env.reset(seed=0)
    actions = np.random.default_rng(0).uniform(-1, 1, (50, 4)).astype(np.float32)
    for action in actions:
        observation = env.step(action)[0]
    newest_first = actions[::-1][:expected].ravel()
    np.testing.assert_array_equal(observation[16:], newest_first)


def test_two_actions_drive_the_bogies_of_four_actuators() -> None:
    env = Lateral17Env(**SHORT, action="bogies", action_history=2)
    env.reset(seed=0)
    observation, _, _, _, info = env.step(np.array([0.5, -0.25], dtype=np.float32))
    assert info["command"].tolist() == [1500.0, 1500.0, -750.0, -750.0]
    assert observation[16:].tolist() == [0.5, -0.25, 0.0, 0.0]
    assert env.observation_names[16:18] == ("action_1_ago_1", "action_1_ago_2")


def test_layout_two_has_one_actuator_per_bogie_either_way() -> None:
    for action in ("each", "bogies"):
        env = Lateral17Env(**SHORT, layout=2, action=action)
        env.reset(seed=0)
        info = env.step(np.array([0.5, -0.25]))[4]
        assert info["command"].tolist() == [1500.0, -750.0]


def test_effort_is_the_mean_square_of_the_actions_whatever_their_number() -> None:
    for action, num in (("each", 4), ("bogies", 2)):
        env = Lateral17Env(**SHORT, action=action)
        env.reset(seed=0)
        given = np.linspace(0.2, 0.8, num)
        effort = env.step(given)[4]["reward_effort"]
        assert effort == pytest.approx(-0.01 * np.mean(given**2), rel=1e-14)


def test_the_pipe_holds_every_action_that_can_be_on_its_way() -> None:
    assert [pipe_length(d, 0.01) for d in (0.0, 0.005, 0.01, 0.3, 0.301)] == [0, 1, 1, 30, 31]


def test_the_documented_table_is_the_observation() -> None:
    """Rows of sensors in the class's documentation: index for layout 4, bounds, unit, scale."""
    doc = Lateral17Env.__doc__ or ""
    rows = re.findall(
        r"\((\d+)(?:[-, ]+(\d+))?\) \|[^|]+\| (-?[\d.]+) \| ([\d.]+) \| (\S+) \| ([\d.]+) \|", doc
    )
    covered: list[int] = []
    names = Lateral17Env(**SHORT).observation_names
    for first, last, low, high, unit, scale in rows:
        columns = list(range(int(first), int(last or first) + 1))
        if columns[0] >= 16:
            continue
        covered += columns
        for column in columns:
            assert bound(names[column]) == (float(high), unit, float(scale)), names[column]
            assert float(low) == -float(high)
    assert covered == list(range(16))


@pytest.mark.parametrize(
    ("name", "unit"),
    [
        ("wheelset1_lateral", "m"),
        ("bogie1_roll", "rad"),
        ("carbody_yaw_velocity", "rad/s"),
        ("bogie2_lateral_velocity", "m/s"),
        ("bogie1_yaw_damper_left_node", "m"),
        ("carbody_roll_rate", "rad/s"),
    ],
)
def test_a_column_has_the_unit_that_its_name_says(name: str, unit: str) -> None:
    assert bound(name)[1] == unit


def test_every_state_of_both_layouts_has_a_scale_of_its_own_kind() -> None:
    for layout, number in ((4, 38), (2, 40)):
        env = Lateral17Env(**SHORT, layout=layout, observation="state", action_history=0)
        assert env.observation_space.shape == (number,)
        assert env.observation_names == state_space(env.vehicle).states
        assert np.all((env.observation_scales > 1e-4) & (env.observation_scales < 0.1))
