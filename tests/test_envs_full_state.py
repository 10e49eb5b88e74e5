"""The nonlinear vehicle's own states as observation: columns, scales, what they hold."""

from typing import Any

import numpy as np
import pytest

from railenv.envs.full_env import Full50Env
from railenv.envs.full_observation import bound_of
from railenv.envs.observation import bound
from railenv.vehicle import lateral17, state_space
from railenv.vehicle.nonlinear import full50

SMALL: dict[str, Any] = {"track_pool": 1, "episode_seconds": 2.0, "observation": "state"}


@pytest.mark.parametrize(("layout", "lag", "own"), [(4, 0.0, 104), (2, 0.0, 106), (4, 0.02, 104)])
def test_the_measured_columns_are_the_states_of_bodies_and_dampers(
    layout: int, lag: float, own: int
) -> None:
    env = Full50Env(**SMALL, layout=layout, actuator_lag=lag, action_history=0)
    assert env.observation_names == env.vehicle.states[:own]
    assert env.observation_space.shape == (own,)


def test_the_columns_hold_the_states() -> None:
    env = Full50Env(**SMALL, observation_scale="si", action_history=0, actuator_lag=0.02)
    observation, _ = env.reset(seed=0)
    for _ in range(20):
        np.testing.assert_array_equal(observation, env._lanes.state(0)[:104].astype(np.float32))
        observation = env.step(np.full(4, 0.5))[0]


def test_info_tells_the_force_behind_the_lag() -> None:
    lag, force = 0.02, 3000.0
    env = Full50Env(track="flat", actuator_lag=lag)
    env.reset(seed=0)
    found = [env.step(np.ones(4))[4]["force"][0] for _ in range(3)]
    expected = force * (1.0 - np.exp(-0.01 * np.arange(1, 4) / lag))
    # fourth order in step over lag, (0.0005 / 0.02)^4 / 120 and less
    np.testing.assert_allclose(found, expected, rtol=1e-8)


def test_a_state_that_both_vehicles_have_is_scaled_alike() -> None:
    shared = set(state_space(lateral17("paper_fit", 2, 300.0)).states)
    shared &= set(full50("paper_fit", 2, 300.0).states)
    assert len(shared) > 36
    for name in shared:
        assert bound_of(name) == bound(name), name


def test_every_state_has_its_unit() -> None:
    units = {name: bound_of(name)[1] for name in full50("paper_fit", 4, 300.0).states}
    assert units["wheelset1_vertical"] == "m"
    assert units["axle_box4_right_pitch"] == "rad"
    assert units["bogie2_longitudinal_velocity"] == "m/s"
    assert units["carbody_pitch_velocity"] == "rad/s"
    assert units["bogie1_yaw_damper_left_node"] == "m"


@pytest.mark.slow
def test_a_column_in_units_of_its_scale_is_about_one() -> None:
    # What the scales were taken from. Some stand for both ends of the vehicle or for two bodies:
    # within a factor of two.
    env = Full50Env(track="german_low", track_pool=1, observation="state", episode_seconds=20.0)
    names = [f"carbody_{motion}_velocity" for motion in ("lateral", "yaw", "roll")]
    columns = [env.observation_names.index(name) for name in names]
    scales = env.observation_scales
    vehicle = env.vehicle.parameters.lateral
    places = np.array(
        [
            s * vehicle.half_bogie_spacing + e * vehicle.damper_offset
            for s in (1, -1)
            for e in (1, -1)
        ]
    )
    seen = []
    observation, _ = env.reset(seed=0)
    for _ in range(2000):
        lateral, yaw, roll = observation[columns] * scales[columns]
        velocity = lateral + places * yaw - vehicle.carbody_to_damper_height * roll
        observation = env.step(-10e3 * velocity / env.settings.action_scale)[0]
        seen.append(observation[:104])
    size = np.sqrt(np.mean(np.square(seen[200:]), axis=0))
    for name, value in zip(env.observation_names, size, strict=False):
        assert 0.5 < value < 2.0, (name, value)
