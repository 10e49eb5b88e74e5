"""Learners of stable-baselines3: what they are shown, what is exported, what a resume restores."""

import dataclasses
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("sb3_contrib")
torch = pytest.importorskip("torch")

from baselines.policies.torch_modules import policy_of  # noqa: E402
from baselines.sb3 import make_vec_env  # noqa: E402
from baselines.training.method import method_class  # noqa: E402
from baselines.training.sb3_columns import PolicyColumns, mild_drive, whitening  # noqa: E402
from baselines.training.settings import TrainingSettings, load_settings, settings_from  # noqa: E402
from railenv.errors import ArgumentError  # noqa: E402

CONFIGS = Path(__file__).parent.parent / "configs" / "train"
ON, OFF = ("ppo", "recurrent_ppo"), ("sac", "td3", "tqc")
MEMORY = {"warm_up": 12, "actor_after": 16, "minibatch": 8, "gradient_steps": 1, "replay": 64}
SMALL: dict[str, dict[str, int]] = {
    "ppo": {"rollout": 8, "minibatch": 16, "epochs": 2},
    "recurrent_ppo": {"rollout": 8, "minibatch": 16, "epochs": 2},
    **{name: {**MEMORY, "periods": 8, "returns": 3} for name in OFF},
}


def settings_of(name: str, kind: str | None = None, **policy: Any) -> TrainingSettings:
    """A tiny run of a method: 4 lanes, episodes of 2 s, three lags."""
    kind = kind or ("recurrent" if name == "recurrent_ppo" else "network")
    hidden = {"linear": (), "network": (6, 5), "recurrent": (5,)}[kind]
    values = {
        "description": "a test",
        "seed": 3,
        "steps": 1000,
        "environment": {
            "track": "german_low",
            "track_pool": 1,
            "delay": (0.0, 0.3),
            "sensor_noise": 0.1,
            "start": "controlled",
            "episode_seconds": 2.0,
            "divergence_penalty": 20.0,
        },
        "policy": {
            "class": kind,
            "hidden": hidden,
            "control_period": 0.05,
            "sensor_lags": (0, 1, 3),
            "action_lags": (1, 2),
            "told_knots": (0.0, 0.1, 0.3),
            **policy,
        },
        "method": {
            "name": name,
            "lanes": 4,
            "critic_hidden": (8,),
            "whitening_seconds": 1.0,
            **SMALL[name],
        },
    }
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return settings_from(values, "test")


def method_of(settings: TrainingSettings, seed: int = 3) -> Any:
    method: Any = method_class(settings.method)(settings, seed)
    method.begin()
    return method


def shaken(method: Any) -> None:
    """Give the acting module weights that move the vehicle and leave the loop bounded."""
    generator = torch.Generator().manual_seed(5)
    with torch.no_grad():
        for weight in method._actor.module.parameters():
            weight.add_(0.01 * torch.randn(weight.shape, generator=generator))
    method._follow()


def raw_env(settings: TrainingSettings, lanes: int = 4) -> Any:
    return make_vec_env(lanes, seed=1, **settings.environment_fields())


def test_every_feature_is_the_column_of_its_name() -> None:
    settings = settings_of("ppo")
    history, raw = settings.history(), raw_env(settings)
    names = list(raw.get_attr("observation_names")[0])
    env = PolicyColumns(raw, history, 0.98)
    observations = np.arange(len(names), dtype=float)[None] + np.zeros((4, 1))
    picked = env.features(observations)[0].astype(int)
    assert [names[i] for i in picked] == list(history.feature_names)
    # The oldest age is three; the environment observes age two as well, which is left out.
    assert not any(name.endswith("_ago_2") for name in history.feature_names if "carbody" in name)


def test_the_told_delay_is_in_seconds() -> None:
    settings = settings_of("ppo")
    raw = raw_env(settings)
    env = PolicyColumns(raw, settings.history(), 0.98)
    raw.set_options({"delay": 0.13})
    told = env.told(raw.reset())
    # float32 of 0.13 / 0.3
    np.testing.assert_allclose(told, 0.13, rtol=1e-6)


def test_a_hidden_delay_is_not_shown() -> None:
    settings = settings_of("ppo", told_knots=())
    raw = raw_env(settings)
    env = PolicyColumns(raw, settings.history(), 0.98)
    seen = [env.reset()[:, -1]]
    raw.set_options({"delay": 0.3})
    seen.append(env.reset()[:, -1])
    assert np.ptp(seen) == 0.0


def test_whitened_features_of_the_record_have_unit_covariance() -> None:
    generator = np.random.default_rng(0)
    record = generator.standard_normal((5000, 6)) @ generator.standard_normal((6, 6))
    seen = record @ whitening(1e-12, record).T
    # Exact but for the ridge and rounding.
    np.testing.assert_allclose(seen.T @ seen / len(seen), np.eye(6), atol=1e-6)


def test_the_ridge_bounds_what_a_direction_without_motion_is_multiplied_by() -> None:
    record = np.array([[3.0, 0.0], [-3.0, 0.0]])
    matrix = whitening(1e-2, record)
    # Variances 9 and 0, their mean 4.5: 1 / sqrt(0.045) for the direction at rest.
    np.testing.assert_allclose(matrix[1, 1], 1.0 / np.sqrt(0.045), rtol=1e-12)


def test_a_record_at_rest_is_refused() -> None:
    with pytest.raises(ArgumentError, match="no motion"):
        whitening(1e-3, np.zeros((5, 3)))


def test_rewards_are_shifted_and_scaled_and_nothing_else() -> None:
    settings = settings_of("ppo")
    plain, seen = raw_env(settings), raw_env(settings)
    env = PolicyColumns(seen, settings.history(), discount=0.9, reward_offset=1.5, reward_scale=2.0)
    for each in (plain, env):
        each.seed(7)
        each.reset()
    actions = np.full((4, 2), 0.1, dtype=np.float32)
    total = 0.0
    for _ in range(5):
        rewards, ours = plain.step(actions)[1], env.step(actions)[1]
        # float32 on both sides.
        np.testing.assert_allclose(ours, (rewards + 1.5) * 0.2, rtol=1e-5, atol=1e-6)
        total += float(rewards.mean()) / 5
    assert env.mean_reward() == pytest.approx(total, rel=1e-6)


def test_the_last_observation_of_an_episode_is_shown_like_all_others() -> None:
    settings = settings_of("ppo")
    env = PolicyColumns(raw_env(settings), settings.history(), 0.98)
    env.reset()
    still = np.zeros((4, 2), dtype=np.float32)
    for _ in range(39):
        env.step(still)
    _, _, dones, infos = env.step(still)
    assert dones.all()
    assert infos[0]["terminal_observation"].shape == env.observation_space.shape


def test_the_mild_drive_is_a_sky_hook_on_the_bogies() -> None:
    settings = settings_of("ppo")
    env = PolicyColumns(raw_env(settings), settings.history(), 0.98)
    record = mild_drive(env, 1.0, 6e3, exploration=0.0, seed=2).reshape(20, 4, -1)
    names = settings.history().feature_names
    speed = {k: record[:-1, :, names.index(f"carbody_lateral_velocity_{k}")] for k in (1, 2, 3, 4)}
    for action, (k, j) in enumerate(((1, 2), (3, 4)), start=1):
        issued = record[1:, :, names.index(f"action_1_ago_{action}")]
        # 6 kN s/m over 3 kN, speeds in units of 0.02 m/s; float32 in the observation.
        np.testing.assert_allclose(issued, -2.0 * 0.02 * (speed[k] + speed[j]) / 2, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", [*ON, *OFF])
def test_the_exported_policy_is_the_acting_one(name: str) -> None:
    settings = settings_of(name, base="skyhook:gain=4e3")
    method = method_of(settings)
    shaken(method)
    policy = policy_of(method.module())
    raw = raw_env(settings)
    env, model = method.env, method._model
    observations = raw.reset()
    names = raw.get_attr("observation_names")[0]
    scales = raw.get_attr("observation_scales")[0]
    order = [list(names).index(each) for each in policy.measures]
    policy.reset(4, 0)
    policy.tell(env.told(observations))
    state, largest = None, 0.0
    for _ in range(30):
        given: Any = {} if name != "recurrent_ppo" else {"state": state}
        acted, state = model.predict(env.seen(observations), deterministic=True, **given)
        exported = policy.act(observations[:, order] * scales[order])[:, ::2]
        # Whitening and network in single precision on one side, double on the other.
        np.testing.assert_allclose(exported, acted, atol=1e-6)
        largest = max(largest, float(np.abs(acted).max()))
        observations = raw.step(acted)[0]
    assert 0.02 < largest < 0.98


@pytest.mark.slow
@pytest.mark.parametrize("name", [*ON, *OFF])
def test_a_restored_run_goes_on_bit_for_bit(name: str) -> None:
    settings = settings_of(name)
    first = method_of(settings)
    first.update()
    first.update()
    arrays, plain = first.state()
    kept = {key: value.copy() for key, value in arrays.items()}
    second = method_of(settings)
    second.restore(arrays, plain)
    for method in (first, second):
        method.begin()
    numbers = [(method.update(), method.update()) for method in (first, second)]
    assert numbers[0] == numbers[1]
    assert first.steps == second.steps == 4 * 32
    after, other = first.state()[0], second.state()[0]
    assert after.keys() == other.keys()
    assert all(np.array_equal(after[key], other[key]) for key in after)
    # What was handed out is a copy, and training has moved something.
    assert all(np.array_equal(arrays[key], kept[key]) for key in kept)
    moved = [key for key in kept if not np.array_equal(after[key], kept[key])]
    assert any("module" in key for key in moved)


@pytest.mark.parametrize("name", ON)
def test_actions_do_not_depend_on_where_an_observation_lies_in_memory(name: str) -> None:
    method = method_of(settings_of(name))
    shaken(method)
    seen = method.env.reset()
    found: set[bytes] = set()
    for offset in range(0, 64, 4):
        memory = np.zeros(seen.nbytes + 128, dtype=np.uint8)
        begin = -memory.ctypes.data % 64 + offset
        moved = memory[begin : begin + seen.nbytes].view(np.float32).reshape(seen.shape)
        moved[:] = seen
        with torch.no_grad():
            mean, _ = method._actor.mean(torch.as_tensor(moved))
            value = method._model.policy.critic(torch.as_tensor(moved))
        found.add(mean.numpy().tobytes() + value.numpy().tobytes())
    assert len(found) == 1


@pytest.mark.slow
@pytest.mark.parametrize("name", ["ppo", "sac"])
def test_another_seed_gives_another_policy(name: str) -> None:
    settings = settings_of(name)
    weights = []
    for seed in (3, 3, 4):
        method = method_of(settings, seed)
        method.update()
        method.update()
        weights.append(policy_of(method.module()).weights)
    assert np.array_equal(weights[0], weights[1])
    assert not np.array_equal(weights[0], weights[2])


def test_training_leaves_the_global_generators_alone() -> None:
    method = method_of(settings_of("ppo"))
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002
    expected = torch.rand(3), np.random.rand(3)  # noqa: NPY002
    torch.manual_seed(1)
    np.random.seed(1)  # noqa: NPY002
    method.update()
    assert torch.equal(torch.rand(3), expected[0])
    assert np.array_equal(np.random.rand(3), expected[1])  # noqa: NPY002


def test_the_actor_s_rate_follows_the_divergence_and_the_critic_s_does_not() -> None:
    settings = settings_of("ppo")
    method = method_of(settings)
    method._rate = 1e-3
    for kl, rate in ((1.0, 1e-3 / 1.5), (0.0, 1e-3), (0.0, 1.5e-3), (0.01, 1.5e-3)):
        method._steer(kl)
        assert method._rate == pytest.approx(rate)
    for _ in range(10):
        method._steer(0.0)
    assert method._rate == settings.hyper.largest_learning_rate
    optimiser = method._model.policy.optimizer
    method._model._update_learning_rate(optimiser)
    assert [group["lr"] for group in optimiser.param_groups] == [method._rate, 1e-3]


def test_the_deviation_does_not_fall_below_its_floor() -> None:
    method = method_of(settings_of("ppo"))
    with torch.no_grad():
        method._actor.log_std.fill_(-9.0)
    seen = torch.zeros((2000, method.env.observation_space.shape[0]))
    with torch.random.fork_rng(devices=[]):
        torch.manual_seed(0)
        actions, _, _ = method._model.policy(seen)
    # The mean at rest is zero; 4000 draws tell the deviation to 1.1 %, five times that.
    assert float(actions.detach().std()) == pytest.approx(0.05, rel=0.06)


def test_the_mean_of_weights_lags_behind_them() -> None:
    settings = settings_of("ppo")
    hyper = dataclasses.replace(settings.hyper, averaging=0.75)
    method = method_of(settings.replace(hyper=hyper))
    with torch.no_grad():
        method._actor.module.weights.fill_(1.0)
    before = method._average.weights.detach().clone()
    method._follow()
    after = method._average.weights.detach()
    # A quarter of the way, in single precision.
    np.testing.assert_allclose(after, 0.75 * before + 0.25, rtol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("name", OFF)
def test_an_off_policy_learner_takes_some_hundred_steps(name: str) -> None:
    method = method_of(settings_of(name, "linear"))
    numbers = [method.update() for _ in range(10)]
    assert method.steps == 320
    assert all(np.isfinite(list(each.values())).all() for each in numbers)
    assert all(each.keys() == numbers[0].keys() for each in numbers)
    # 64 transitions are kept, so the memory has gone round.
    assert method.state()[1]["full"]


def test_targets_do_not_reach_over_the_start_of_new_episodes() -> None:
    method = method_of(settings_of("sac"))
    method.update()
    method.begin()
    memory = method._model.replay_buffer
    memory.rewards[:9] = 1.0
    method._model.collect_rollouts(
        method.env, method._callback, method._model.train_freq, memory, log_interval=None
    )
    memory.rewards[8] = 100.0
    samples = memory._get_samples(np.array([5, 6, 7]))
    gamma = 0.97
    # Returns over up to three periods, of which the eighth is the last before the new start.
    np.testing.assert_allclose(
        samples.rewards.numpy()[:, 0], [1 + gamma + gamma**2, 1 + gamma, 1.0], rtol=1e-6
    )
    np.testing.assert_allclose(
        samples.discounts.numpy()[:, 0], [gamma**3, gamma**2, gamma], rtol=1e-6
    )
    # They go on by the critics, as the vehicle would have.
    assert not samples.dones.any()


@pytest.mark.slow
def test_the_actor_waits_for_the_critics() -> None:
    settings = settings_of("sac")
    hyper = dataclasses.replace(settings.hyper, actor_after=64)
    method = method_of(settings.replace(hyper=hyper))
    weights = [method._actor.module.weights.detach().clone()]
    for _ in range(3):
        method.update()
        weights.append(method._actor.module.weights.detach().clone())
    assert torch.equal(weights[0], weights[2])
    assert not torch.equal(weights[2], weights[3])


@pytest.mark.parametrize(
    "name", ["ppo-linear", "ppo-network", "ppo-recurrent", "sac", "td3", "tqc"]
)
def test_the_settings_on_file_are_those_of_a_method(name: str) -> None:
    settings = load_settings(CONFIGS / f"{name}.toml")
    assert settings.method == {"ppo-recurrent": "recurrent_ppo"}.get(name, name.partition("-")[0])
    # An end by divergence costs at least what the worst way to go on does.
    worst = settings.environment.comfort_cap / (1.0 - settings.hyper.discount)
    assert settings.environment.penalty() >= worst * (1.0 - 1e-12)


def test_a_method_says_which_class_of_policy_it_trains() -> None:
    for name, kind in (("ppo", "recurrent"), ("recurrent_ppo", "linear"), ("sac", "recurrent")):
        with pytest.raises(ArgumentError, match="does not train class"):
            method_of(settings_of(name, kind))


@pytest.mark.parametrize(
    ("name", "change", "message"),
    [
        ("ppo", {"minibatch": 5}, "minibatch = 5 does not divide"),
        ("ppo", {"trace": 1.1}, "trace"),
        ("ppo", {"discount": 1.0}, "discount"),
        ("ppo", {"averaging": 1.0}, "averaging"),
        ("ppo", {"exploration": 0.0}, "exploration"),
        ("ppo", {"kl": -1.0}, "kl"),
        ("sac", {"replay": 3}, "replay"),
        ("sac", {"target_share": 1.5}, "target_share"),
        ("td3", {"warm_up": -1}, "warm_up"),
    ],
)
def test_a_hyper_parameter_out_of_its_range_is_refused(
    name: str, change: dict[str, Any], message: str
) -> None:
    settings = settings_of(name)
    with pytest.raises(ArgumentError, match=message):
        dataclasses.replace(settings.hyper, **change)
