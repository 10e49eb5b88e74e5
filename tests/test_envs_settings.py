"""Every setting is documented and checked, and both checkers pass with every one of them."""

import dataclasses
import re
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import railenv  # noqa: F401  (registers the ids)
from railenv.actuation import DelaySpec
from railenv.envs.rail_env import Lateral17Env
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError
from railenv.vehicle.randomisation import VehicleRanges

NUMBER = ("much", None, np.nan, np.inf, -1.0, True, [1.0, 2.0, 3.0])
POSITIVE = (*NUMBER, 0.0)
COUNT = (0, -1, 1.5, "2", None, True)
WORD = ("other", 3, None, ["each"], ("sensors",))
FLAG = (1, 0.0, "yes", None)

BAD: dict[str, tuple[Any, ...]] = {
    "layout": (3, "passive", None, True, "four", -4),
    "speed_kmh": (*POSITIVE, 1e7),
    "vehicle": WORD,
    "vehicle_ranges": ("wider", 5, None, (0.9, 1.1), {"load": (1.0, 1.1)}),
    "vehicle_pool": COUNT,
    "track": ("tb3353", 3, None, (), ("tb3352", 3), "absent.csv", "tb3352:level=-1"),
    "track_pool": COUNT,
    "track_level": (1.0, (1.0,), (2.0, 1.0), (-1.0, 1.0), ("a", 1.0), "12", None, (0.0, np.inf)),
    "pool_seed": (-1, 1.5, "2", None, True),
    "delay": (*NUMBER, 0.31, (0.2, 0.1), (0.1, 0.4), (0.1,), DelaySpec((0.1, 0.2)), DelaySpec(0.4)),
    "delay_per_channel": FLAG,
    "sensor_delay": (*NUMBER, 0.31, (0.2, 0.1)),
    "jitter": (*NUMBER, 0.31),
    "common_jitter": FLAG,
    "dropout": (*NUMBER, 1.0, 1.5),
    "sensor_dropout": (*NUMBER, 1.0, 1.5),
    "sensor_noise": NUMBER,
    "max_delay": (*NUMBER, 11.0),
    "delay_observed": FLAG,
    "told_error": (*NUMBER, 0.01),
    "observation": WORD,
    "observation_scale": WORD,
    "observation_history": (-1, 1.5, "2", None, True),
    "action_history": (-1, 1.5, "2", True),
    "action": WORD,
    "start": WORD,
    "control_period": (*POSITIVE, 0.0125, 0.004),
    "time_step": (*POSITIVE, 0.003, 0.02, 1e-6),
    "episode_seconds": (*POSITIVE, 0.015, 4000.0),
    "action_scale": POSITIVE,
    "force_limit": tuple(value for value in POSITIVE if value is not None),
    "rate_limit": tuple(value for value in POSITIVE if value is not None),
    "actuator_lag": (*NUMBER, 1e-9),
    "comfort_reference": POSITIVE,
    "comfort_cap": POSITIVE,
    "effort_weight": NUMBER,
    "stroke_weight": NUMBER,
    "stroke_reference": POSITIVE,
    "divergence_penalty": tuple(value for value in NUMBER if value is not None),
    "gauge_limit": POSITIVE,
    "acceleration_limit": POSITIVE,
}
# What the message calls a setting that another module checks.
ALSO_CALLED = {
    "actuator_lag": "lag",
    "track": "spectrum|track|level|absent",
    "speed_kmh": "speed",
    "sensor_delay": "delay .* in all",
    "jitter": "delay .* in all",
}


def test_every_setting_has_bad_values_here() -> None:
    assert list(BAD) == [field.name for field in dataclasses.fields(EnvSettings)]


@pytest.mark.parametrize(
    ("name", "value"), [(name, value) for name, values in BAD.items() for value in values]
)
def test_a_bad_setting_is_refused_by_its_name(name: str, value: Any) -> None:
    words = name.replace("_", "[_ ]") + "|" + ALSO_CALLED.get(name, name)
    with pytest.raises(ValueError, match=words) as caught:
        Lateral17Env(**{"episode_seconds": 1.0, name: value})
    # on purpose, in one line
    assert type(caught.value).__module__ == "railenv.errors"
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", [f.name for f in dataclasses.fields(EnvSettings)])
def test_the_vectorised_environment_refuses_it_too(name: str) -> None:
    with pytest.raises(ValueError, match=r"\w"):
        Lateral17VectorEnv(2, **{name: BAD[name][0]})


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"delayy": 0.1}, "did you mean 'delay'"),
        ({"num_lanes": 3}, "environment setting"),
        ({"delay": DelaySpec(0.1), "jitter": 0.1}, "jitter .* beside a DelaySpec"),
        ({"delay": DelaySpec(0.1), "sensor_delay": 0.1}, "sensor_delay .* beside a DelaySpec"),
        ({"delay": DelaySpec(0.1), "delay_per_channel": True}, "delay_per_channel"),
        ({"delay": 0.2, "sensor_delay": 0.2}, "max_delay"),
        ({"delay": 0.2, "jitter": 0.2}, "max_delay"),
        ({"jitter": 0.1, "actuator_lag": 1e-5}, "jitter"),
        ({"render_mode": "gif"}, "render_mode"),
    ],
)
def test_settings_that_do_not_go_together_are_refused(settings: dict, message: str) -> None:
    for make in (Lateral17Env, lambda **s: Lateral17VectorEnv(2, **s)):
        with pytest.raises(ArgumentError, match=message):
            make(**settings)


def test_every_setting_has_a_sentence_of_its_own() -> None:
    doc = EnvSettings.__doc__ or ""
    entries = re.findall(r"^        (\w+): (\S.*)$", doc, flags=re.MULTILINE)
    fields = [field.name for field in dataclasses.fields(EnvSettings)]
    assert [name for name, _ in entries if name != "ArgumentError"] == fields


def test_the_documentation_follows_gymnasiums_order() -> None:
    headings = re.findall(r"^    ## (.+)$", Lateral17Env.__doc__ or "", flags=re.MULTILINE)
    order = [
        "Description",
        "Action space",
        "Observation space",
        "Rewards",
        "Start state",
        "Termination and truncation",
        "Arguments",
        "Version history",
    ]
    assert [heading for heading in headings if heading != "Info"] == order


def test_every_key_of_info_is_documented() -> None:
    doc = (Lateral17Env.__doc__ or "").partition("## Info")[2].partition("##")[0]
    env = Lateral17Env(episode_seconds=1.0, track_pool=1, delay_observed=True)
    info = env.reset(seed=0)[1]
    documented = set(re.findall(r"`(\w+)`", doc))
    assert set(info) <= documented
    assert set(env.step(np.zeros(4))[4]) == set(info)


SMALL: dict[str, Any] = {"episode_seconds": 1.0, "track_pool": 2, "vehicle_pool": 2}
CHECKED: tuple[Any, ...] = (
    {"delay": 0.1},
    {"delay": (0.0, 0.2), "jitter": 0.05, "dropout": 0.1, "delay_observed": True},
    {"delay": DelaySpec((0.0, 0.1, 0.05, 0.2), sensor_delay=0.01), "delay_observed": True},
    {"delay": (0.0, 0.2), "delay_per_channel": True, "sensor_delay": (0.0, 0.1), "layout": 2},
    {"delay": (0.0, 0.1), "delay_observed": True, "told_error": 0.05, "sensor_dropout": 0.2},
    {"observation": "state", "observation_scale": "si", "observation_history": 2},
    {"observation": "state", "layout": 2, "action_history": 0, "actuator_lag": 0.02},
    {"action": "bogies", "action_history": 3, "rate_limit": 1e5, "observation_history": 1},
    {"start": "controlled", "vehicle_ranges": "wide", "track_level": (0.5, 2.0)},
    {"vehicle_ranges": VehicleRanges(load=(1.0, 1.1)), "track": ("tb3352", "german_low", "flat")},
    {"gauge_limit": 1e-4, "acceleration_limit": 1e-3},
    {"sensor_noise": 0.5, "observation_history": 1},
    {"render_mode": "ansi"},
    {"render_mode": "rgb_array", "vehicle_ranges": "narrow", "delay": 0.05},
)


@pytest.mark.parametrize("settings", CHECKED)
def test_both_checkers_pass_without_a_warning(settings: dict[str, Any]) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        env = gym.make("railenv/Lateral17-v0", **{**SMALL, **settings})
        assert env.spec is not None
        # Without a spec it would make no further environments by render mode, windows among them.
        check_env(Lateral17Env(**{**SMALL, **settings}), skip_render_check=True)
        checker.check_env(Lateral17Env(**{**SMALL, **settings}), skip_render_check=False)
        env.reset(seed=0)
        env.step(env.action_space.sample())
        env.render() if env.render_mode else None
        env.close()


def test_render_modes_give_pixels_and_text() -> None:
    frames = {}
    for mode in ("rgb_array", "ansi"):
        env = Lateral17Env(**SMALL, render_mode=mode)
        env.reset(seed=0)
        env.step(np.full(4, 0.5))
        frames[mode] = env.render()
        env.close()
    assert frames["rgb_array"].shape == (480, 640, 3)
    assert frames["rgb_array"].dtype == np.uint8
    assert isinstance(frames["ansi"], str)
