"""The adapter to stable-baselines3 against the vector and the single environment, and its users."""

import os
import pickle
from typing import Any

import gymnasium as gym
import numpy as np
import pytest

pytest.importorskip("stable_baselines3")

import torch
from stable_baselines3 import PPO, SAC
from stable_baselines3.common.evaluation import evaluate_policy
from stable_baselines3.common.monitor import Monitor
from stable_baselines3.common.vec_env import (
    VecCheckNan,
    VecMonitor,
    VecNormalize,
    VecVideoRecorder,
)

from baselines.sb3 import StableBaselinesEnv, make_vec_env
from eval.bench_ppo import ppo_rate
from railenv.envs.rail_env import Lateral17Env
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.errors import ArgumentError

# Importing stable-baselines3 alone takes seconds.
pytestmark = pytest.mark.slow

# 20 actions to an episode. A floor moves by a millimetre within some of them under full actions of
# one direction: with this clearance some episodes end by the gauge and others by their length.
SHORT: dict[str, Any] = {"episode_seconds": 0.2, "max_delay": 0.05, "delay": (0.0, 0.05)}
TINY = {**SHORT, "gauge_limit": 2e-3, "track_pool": 2}
LANES = 5
STEPS = 70


def pushes(steps: int = STEPS, lanes: int = LANES) -> np.ndarray:
    """Actions of one sign per lane and decade of steps, so that some floors are pushed far."""
    rng = np.random.default_rng(5)
    held = rng.uniform(-1, 1, (steps // 10 + 1, lanes, 1)).repeat(10, axis=0)[:steps]
    return np.clip(held + rng.uniform(-0.1, 0.1, (steps, lanes, 4)), -1, 1).astype(np.float32)


def same(one: Any, other: Any) -> bool:
    """Whether two dictionaries are equal, NaN with NaN and types included."""
    if set(one) != set(other):
        return False
    for name, value in one.items():
        if type(value) is not type(other[name]):
            return False
        np.testing.assert_array_equal(value, other[name])
    return True


@pytest.fixture(scope="module")
def side_by_side() -> list[tuple[Any, Any]]:
    """What the adapter and the vector environment return for one seed and the same actions."""
    adapter = make_vec_env(LANES, seed=3, **TINY)
    vector = Lateral17VectorEnv(LANES, autoreset_mode="same_step", **TINY)
    adapter.reset()
    vector.reset(seed=3)
    steps = [(adapter.step(action), vector.step(action)) for action in pushes()]
    ends = {(bool(t[k]), bool(o[k])) for _, (_, _, t, o, _) in steps for k in range(LANES)}
    assert {(True, False), (False, True), (False, False)} <= ends, "the test needs both endings"
    return steps


def test_reset_returns_the_observations_alone_and_leaves_the_infos() -> None:
    adapter = make_vec_env(3, seed=1, **SHORT)
    observations = adapter.reset()
    single = Lateral17Env(**SHORT)
    first, info = single.reset(seed=3)
    np.testing.assert_array_equal(observations[2], first)
    assert same(adapter.reset_infos[2], info)


def test_steps_return_the_vector_environments_numbers(side_by_side: list[Any]) -> None:
    for (observations, rewards, dones, _), (seen, reward, terminated, truncated, _) in side_by_side:
        np.testing.assert_array_equal(observations, seen)
        assert observations.dtype == np.float32
        assert rewards.dtype == np.float32
        np.testing.assert_array_equal(rewards, reward.astype(np.float32))
        np.testing.assert_array_equal(dones, terminated | truncated)


def test_the_flag_of_truncation_is_true_where_length_alone_ended_it(
    side_by_side: list[Any],
) -> None:
    for (_, _, _, infos), (_, _, terminated, truncated, _) in side_by_side:
        flags = [info["TimeLimit.truncated"] for info in infos]
        assert flags == [bool(o and not t) for o, t in zip(truncated, terminated, strict=True)]
        assert {type(flag) for flag in flags} == {bool}


def test_an_episode_that_fails_in_its_last_step_is_not_called_truncated() -> None:
    # One action to an episode: it reaches its length and breaks this limit in the same step.
    adapter = make_vec_env(1, seed=0, episode_seconds=0.01, acceleration_limit=1e-9)
    adapter.reset()
    _, _, dones, infos = adapter.step(np.ones((1, 4), dtype=np.float32))
    assert dones[0]
    assert infos[0]["ended_by"] == "divergence"
    assert infos[0]["TimeLimit.truncated"] is False


def test_the_penalty_of_a_divergence_arrives_unclipped() -> None:
    adapter = make_vec_env(1, seed=0, acceleration_limit=1e-9)
    adapter.reset()
    _, rewards, _, _ = adapter.step(np.ones((1, 4), dtype=np.float32))
    # At most 5 + 0.01 + 0.05 per step come on top of (5 + 0.01 + 0.05) * 2000.
    assert -10_126 < rewards[0] <= -10_120


def test_every_lane_ends_its_episodes_as_the_single_environment_does(
    side_by_side: list[Any],
) -> None:
    for lane in range(LANES):
        single = Lateral17Env(**TINY)
        single.reset(seed=3 + lane)
        total, length, ended = 0.0, 0, 0
        for action, ((_, _, dones, infos), _) in zip(pushes(), side_by_side, strict=True):
            seen, reward, terminated, truncated, info = single.step(action[lane])
            total, length = total + reward, length + 1
            assert dones[lane] == (terminated or truncated)
            if not dones[lane]:
                continue
            last = dict(infos[lane])
            np.testing.assert_array_equal(last.pop("terminal_observation"), seen)
            episode = last.pop("episode")
            assert (episode["r"], episode["l"]) == (total, length)
            last.pop("TimeLimit.truncated")
            assert same(last, info)
            single.reset()
            total, length, ended = 0.0, 0, ended + 1
        assert ended >= 3  # 70 steps, at most 20 per episode


def test_a_lane_that_goes_on_tells_nothing_but_that_by_default(side_by_side: list[Any]) -> None:
    for (_, _, dones, infos), _ in side_by_side:
        for done, info in zip(dones, infos, strict=True):
            assert done or info == {"TimeLimit.truncated": False}


def test_no_dictionary_is_handed_out_twice(side_by_side: list[Any]) -> None:
    given = [info for (_, _, _, infos), _ in side_by_side for info in infos]
    assert len({id(info) for info in given}) == len(given)


@pytest.mark.parametrize("lane_infos", [False, True])
def test_what_was_handed_out_stays_as_it_is(lane_infos: bool) -> None:
    adapter = make_vec_env(LANES, seed=3, lane_infos=lane_infos, **TINY)
    adapter.reset()
    kept = [adapter.step(action) for action in pushes(40)]
    before = pickle.dumps(kept)
    for action in pushes(30):
        adapter.step(action)
    assert pickle.dumps(kept) == before


def test_with_lane_infos_a_lane_that_goes_on_tells_what_the_single_environment_does() -> None:
    adapter = make_vec_env(3, seed=4, lane_infos=True, **SHORT)
    adapter.reset()
    single = Lateral17Env(**SHORT)
    single.reset(seed=5)
    for action in pushes(8, 3):
        infos = adapter.step(action)[3]
        info = single.step(action[1])[4]
        assert infos[1].pop("TimeLimit.truncated") is False
        assert same(infos[1], info)


def test_infos_of_the_next_episodes_start_are_kept() -> None:
    adapter = make_vec_env(2, seed=3, **SHORT)
    adapter.reset()
    single = Lateral17Env(**SHORT)
    single.reset(seed=4)
    for action in pushes(20, 2):
        adapter.step(action)
        single.step(action[1])
    assert same(adapter.reset_infos[1], single.reset()[1])


def test_a_seed_counts_for_one_reset() -> None:
    adapter = make_vec_env(2, **SHORT)
    adapter.seed(7)
    adapter.reset()
    first = adapter.reset_infos
    adapter.reset()
    other = adapter.reset_infos
    adapter.seed(7)
    adapter.reset()
    assert same(adapter.reset_infos[1], first[1])
    assert other[1]["delay"].tolist() != first[1]["delay"].tolist()


def test_options_fix_the_delay_of_one_reset() -> None:
    adapter = make_vec_env(2, seed=0, **SHORT)
    adapter.set_options({"delay": 0.02})
    adapter.reset()
    assert [info["delay"].tolist() for info in adapter.reset_infos] == [[0.02] * 4] * 2
    adapter.reset()
    assert adapter.reset_infos[0]["delay"].tolist() != [0.02] * 4


def test_options_may_differ_from_lane_to_lane_also_in_kind() -> None:
    # Four lanes and four channels: the four numbers are channels, not lanes.
    adapter = make_vec_env(4, seed=0, **SHORT)
    each = (0.01, 0.02, 0.03, 0.04)
    adapter.set_options([{"delay": each}, {"delay": 0.05}, {"delay": 0.0}, {"delay": each}])
    adapter.reset()
    assert [tuple(info["delay"]) for info in adapter.reset_infos] == [
        each,
        (0.05,) * 4,
        (0.0,) * 4,
        each,
    ]


def test_options_of_a_refused_reset_are_forgotten() -> None:
    adapter = make_vec_env(2, seed=0, **SHORT)
    adapter.set_options({"delay": 9.0})
    with pytest.raises(ArgumentError, match="raise max_delay"):
        adapter.reset()
    assert adapter.reset().shape == (2, *adapter.observation_space.shape)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ([{}], "1 dictionaries for 2 lanes"),
        ([{"delay": 0.0}, {}], "name the same"),
        ({"reset_mask": [True, False]}, "leave it out"),
        ([3, 4], "must be a dictionary"),
    ],
)
def test_options_that_do_not_fit_are_refused(options: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        make_vec_env(2, **SHORT).set_options(options)


@pytest.mark.parametrize("mode", ["next_step", "disabled"])
def test_another_autoreset_mode_is_refused_with_the_way_out(mode: str) -> None:
    with pytest.raises(ArgumentError, match='make it with autoreset_mode="same_step"'):
        StableBaselinesEnv(Lateral17VectorEnv(2, autoreset_mode=mode, **SHORT))
    with pytest.raises(ArgumentError, match='make it with autoreset_mode="same_step"'):
        make_vec_env(2, autoreset_mode=mode, **SHORT)


def test_another_environment_is_refused() -> None:
    with pytest.raises(ArgumentError, match="Lateral17Env is not a Lateral17VectorEnv"):
        StableBaselinesEnv(Lateral17Env(**SHORT))  # type: ignore[arg-type]


def test_an_unknown_setting_is_refused_with_the_nearest_name() -> None:
    with pytest.raises(ArgumentError, match="did you mean 'delay'"):
        make_vec_env(2, delays=0.1)


def test_steps_out_of_turn_are_refused() -> None:
    adapter = make_vec_env(1, **SHORT)
    with pytest.raises(ArgumentError, match="call reset first"):
        adapter.step(np.zeros((1, 4)))
    adapter.reset()
    with pytest.raises(ArgumentError, match="call step_async first"):
        adapter.step_wait()


def test_stable_baselines3_refuses_the_vector_environment_itself() -> None:
    vector = Lateral17VectorEnv(2, autoreset_mode="same_step", **SHORT)
    with pytest.raises(ValueError, match="not a Gymnasium environment"):
        PPO("MlpPolicy", vector, device="cpu")  # type: ignore[arg-type]


def test_attributes_are_those_of_single_lanes() -> None:
    adapter = make_vec_env(3, seed=5, **SHORT)
    adapter.reset()
    assert adapter.get_attr("observation_space", 1) == [adapter.observation_space]
    assert adapter.get_attr("np_random_seed", [2, 0]) == [7, 5]
    assert len(adapter.get_attr("observation_names")) == 3
    assert adapter.get_attr("render_mode") == [None] * 3
    assert adapter.has_attr("settings")
    assert not adapter.has_attr("setting")
    assert not adapter.has_attr("_lanes")


def test_the_specification_makes_the_environment_of_one_lane() -> None:
    adapter = make_vec_env(2, seed=8, **SHORT)
    single = gym.make(adapter.get_attr("spec")[0])
    np.testing.assert_array_equal(adapter.reset()[1], single.reset(seed=9)[0])


def test_attributes_that_are_set_belong_to_their_lanes() -> None:
    adapter = make_vec_env(3, **SHORT)
    adapter.set_attr("stage", 1)
    adapter.set_attr("stage", 2, indices=[1])
    assert adapter.get_attr("stage") == [1, 2, 1]
    with pytest.raises(ArgumentError, match="settings is fixed"):
        adapter.set_attr("settings", None)
    with pytest.raises(ArgumentError, match="indices go from 0 to 2"):
        adapter.set_attr("stage", 1, indices=3)


def test_methods_are_called_once_and_those_of_episodes_refused() -> None:
    adapter = make_vec_env(2, **SHORT)
    adapter.reset()
    one, other = adapter.env_method("checkpoint")
    assert one is other
    with pytest.raises(AttributeError, match="no public attribute 'compute_reward'"):
        adapter.env_method("compute_reward")
    with pytest.raises(AttributeError, match="is no method"):
        adapter.env_method("settings")
    with pytest.raises(ArgumentError, match="would pass by the adapter"):
        adapter.env_method("reset")


def test_a_pickled_adapter_goes_on_identically() -> None:
    adapter = make_vec_env(LANES, seed=3, **TINY)
    adapter.reset()
    for action in pushes(15):
        adapter.step(action)
    twin = pickle.loads(pickle.dumps(adapter))
    for action in pushes(30):
        one, other = adapter.step(action), twin.step(action)
        np.testing.assert_array_equal(one[0], other[0])
        for mine, its in zip(one[3], other[3], strict=True):
            assert mine.get("episode", {}).get("r") == its.get("episode", {}).get("r")


def test_pictures_are_tiled_and_recorded(tmp_path: Any) -> None:
    pytest.importorskip("pygame")
    adapter = make_vec_env(4, render_mode="rgb_array", **SHORT)
    adapter.reset()
    images = adapter.get_images()
    assert len(images) == 4
    tiled = adapter.render()
    assert tiled is not None
    assert tiled.shape == (2 * images[0].shape[0], 2 * images[0].shape[1], 3)
    np.testing.assert_array_equal(adapter.env_method("render", indices=2)[0], images[2])


def test_videos_are_recorded(tmp_path: Any) -> None:
    pytest.importorskip("pygame")
    pytest.importorskip("moviepy")
    adapter = make_vec_env(1, render_mode="rgb_array", **SHORT)
    recorder = VecVideoRecorder(adapter, str(tmp_path), lambda step: step == 0, video_length=2)
    assert recorder.frames_per_sec == 100  # one picture per control period of 10 ms
    recorder.reset()
    for _ in range(2):
        recorder.step(np.zeros((1, 4)))
    recorder.close()
    assert [file.suffix for file in tmp_path.iterdir()] == [".mp4"]


def test_no_pictures_without_their_mode() -> None:
    with pytest.raises(ArgumentError, match='render_mode="rgb_array"'):
        make_vec_env(1, **SHORT).get_images()


def test_ppo_learns_and_reads_returns_and_lengths() -> None:
    adapter = make_vec_env(4, **SHORT)
    model = PPO("MlpPolicy", adapter, n_steps=25, batch_size=50, n_epochs=1, seed=0, device="cpu")
    model.learn(100)
    assert model.ep_info_buffer is not None
    # 25 steps in 4 lanes hold one episode each, of 20 steps.
    assert [episode["l"] for episode in model.ep_info_buffer] == [20] * 4


def test_sac_keeps_the_terminal_observation_of_each_episode() -> None:
    adapter = make_vec_env(2, seed=0, **SHORT)
    small = {"net_arch": [8]}
    model = SAC(
        "MlpPolicy", adapter, learning_starts=30, buffer_size=100, policy_kwargs=small, device="cpu"
    )
    model.learn(60)
    buffer = model.replay_buffer
    assert buffer is not None
    # Step 20 ends both episodes: what follows it in the buffer is no start of a new one.
    assert buffer.dones[19].all()
    assert buffer.timeouts[19].all()
    assert not np.array_equal(buffer.next_observations[19], buffer.observations[20])
    np.testing.assert_array_equal(buffer.next_observations[18], buffer.observations[19])


def test_learning_repeats_itself_with_a_seed() -> None:
    weights = []
    for _ in range(2):
        adapter = make_vec_env(3, **SHORT)
        model = PPO("MlpPolicy", adapter, n_steps=8, batch_size=24, seed=2, device="cpu")
        model.learn(48)
        weights.append(torch.cat([p.detach().flatten() for p in model.policy.parameters()]))
    assert torch.equal(*weights)


class Still:
    """A policy that does nothing."""

    def predict(self, observation: np.ndarray, **_: Any) -> tuple[np.ndarray, None]:
        return np.zeros((len(observation), 4), dtype=np.float32), None


@pytest.mark.parametrize("normalised", [False, True])
def test_policies_are_evaluated_on_whole_episodes_without_a_warning(normalised: bool) -> None:
    adapter = make_vec_env(3, seed=4, **SHORT)
    # The normaliser changes rewards; what is reported are the environment's own all the same.
    env = VecNormalize(adapter, training=False) if normalised else adapter
    rewards, lengths = evaluate_policy(Still(), env, 4, return_episode_rewards=True)  # type: ignore
    single = Lateral17Env(**SHORT)
    single.reset(seed=6)
    by_hand = sum(single.step(np.zeros(4))[1] for _ in range(20))
    assert lengths == [20] * 4
    # Four episodes in three lanes: the last lane has to play the second.
    assert rewards[2] == by_hand


def test_the_work_of_a_monitor_is_claimed_where_it_is_done() -> None:
    assert make_vec_env(2, **SHORT).env_is_wrapped(Monitor) == [True, True]
    assert make_vec_env(2, monitor=False, **SHORT).env_is_wrapped(Monitor) == [False, False]
    assert make_vec_env(2, **SHORT).env_is_wrapped(gym.Wrapper, 0) == [False]


def test_stable_baselines3s_own_monitor_counts_the_same(tmp_path: Any) -> None:
    own = make_vec_env(LANES, seed=3, **TINY)
    bare = make_vec_env(LANES, seed=3, monitor=False, **TINY)
    theirs = VecMonitor(bare, str(tmp_path / "run"), info_keywords=("ended_by",))
    own.reset()
    theirs.reset()
    for action in pushes():
        mine, counted = own.step(action)[3], theirs.step(action)[3]
        for one, other in zip(mine, counted, strict=True):
            assert ("episode" in one) == ("episode" in other)
            if "episode" in one:
                assert one["episode"]["l"] == other["episode"]["l"]
                # Their sum of up to 20 float32 is off by up to 20 rounding errors of 6e-8.
                assert one["episode"]["r"] == pytest.approx(other["episode"]["r"], rel=2e-6)
    theirs.close()
    assert '"env_id": "railenv/Lateral17-v0"' in (tmp_path / "run.monitor.csv").read_text()


def test_a_second_monitor_is_warned_of() -> None:
    with pytest.warns(UserWarning, match="already wrapped with a `Monitor`"):
        VecMonitor(make_vec_env(1, **SHORT))


def test_normaliser_and_nan_checker_wrap_and_learn() -> None:
    adapter = make_vec_env(4, seed=0, **SHORT)
    env = VecCheckNan(VecNormalize(adapter), raise_exception=True)
    model = PPO("MlpPolicy", env, n_steps=25, batch_size=100, n_epochs=1, device="cpu")
    model.learn(100)
    assert model.num_timesteps == 100


def test_the_rate_of_ppo_is_measured_and_the_thread_count_left_alone() -> None:
    before = torch.get_num_threads()
    torch.set_num_threads(1 + (os.cpu_count() or 1))
    try:
        # Between ten steps a second and ten million: a rate per second, not per rollout.
        assert 10.0 < ppo_rate(4, 0.01) < 1e7
        assert torch.get_num_threads() == 1 + (os.cpu_count() or 1)
    finally:
        torch.set_num_threads(before)
