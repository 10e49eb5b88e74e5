"""The nonlinear vehicle's environment: the linear one's interface, checkers, delays, settings."""

import dataclasses
import pickle
import re
import warnings
from typing import Any

import gymnasium as gym
import numpy as np
import pytest
from gymnasium.utils.env_checker import check_env

import railenv  # noqa: F401  (registers the ids)
from railenv.actuation import DelaySpec
from railenv.envs.full_env import Full50Env, Full50VectorEnv
from railenv.envs.full_settings import FullSettings
from railenv.envs.rail_env import Lateral17Env
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError

ID = "railenv/Full50-v0"
SMALL: dict[str, Any] = {"track_pool": 1, "episode_seconds": 2.0}
VARIANTS = (
    {"delay": (0.0, 0.3), "delay_observed": True},
    {"layout": 2, "observation": "state", "actuator_lag": 0.02, "curve": (7000.0, 0.15)},
)


def make(**settings: Any) -> Full50Env:
    env = gym.make(ID, **{**SMALL, **settings}).unwrapped
    assert isinstance(env, Full50Env)
    return env


@pytest.mark.parametrize("settings", VARIANTS)
def test_gymnasiums_checker_passes_without_a_warning(settings: dict) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        check_env(make(**settings))


@pytest.mark.parametrize("settings", VARIANTS)
def test_stable_baselines_checker_passes_without_a_warning(settings: dict) -> None:
    checker = pytest.importorskip("stable_baselines3.common.env_checker")
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        checker.check_env(make(**settings))


@pytest.mark.parametrize(
    "settings",
    [
        {},
        {"layout": 2, "observation_history": 2, "delay_observed": True},
        {"action": "bogies", "observation_scale": "si", "action_history": 3},
    ],
)
def test_a_policy_of_the_linear_vehicle_finds_the_same_columns(settings: dict) -> None:
    mine, linear = make(**settings), Lateral17Env(**settings)
    assert mine.observation_names == linear.observation_names
    assert mine.observation_space == linear.observation_space
    assert mine.action_space == linear.action_space
    np.testing.assert_array_equal(mine.observation_scales, linear.observation_scales)


def test_info_has_the_linear_vehicles_keys_and_those_of_safety() -> None:
    mine, linear = make().reset(seed=0)[1], Lateral17Env(**SMALL).reset(seed=0)[1]
    safety = ["derailment_quotient", "wheel_unloading", "wheelset_shift", "guiding_force"]
    assert list(mine) == [*linear, *safety]
    assert {name: type(value) for name, value in mine.items() if name in linear} == {
        name: type(value) for name, value in linear.items()
    }


def test_a_linear_policy_rides_alike_on_both_vehicles() -> None:
    # A sky-hook that reads the first columns. The nonlinear wheels guide otherwise than the linear
    # ones, and the rails move vertically as well: some twenty per cent in the ride index.
    def ride(env: Any) -> np.ndarray:
        gain = 20e3 * env.observation_scales[:4] / env.settings.action_scale
        observation, _ = env.reset(seed=3, options={"track_seed": 5})
        for _ in range(400):
            observation, _, _, _, info = env.step(-gain * observation[:4])
        return info["ride_index"]

    settings = {"delay": 0.05, "episode_seconds": 4.0, "track_pool": 1}
    np.testing.assert_allclose(ride(make(**settings)), ride(Lateral17Env(**settings)), rtol=0.3)


@pytest.mark.parametrize(("delay", "calms"), [(0.05, True), (0.28, False)])
def test_a_sky_hook_calms_the_carbody_until_its_critical_delay(delay: float, calms: bool) -> None:
    # 35 kN s/m: the paper's critical delay is about 0.2 s for a motion that it damps well before.
    env = make(track="flat", delay=delay, episode_seconds=10.0)
    gain = 35e3 * env.observation_scales[:4] / env.settings.action_scale
    env.reset(seed=0)
    for _ in range(20):
        observation = env.step(np.ones(4))[0]
    size: list[float] = []
    for _ in range(300):
        observation = env.step(-gain * observation[:4])[0]
        size.append(float(np.abs(observation[:4]).max()))
    assert (max(size[-80:]) < 0.1 * max(size[:80])) == calms


@pytest.mark.parametrize("delay", [0.0, 0.0132, 0.1])
def test_the_force_arrives_when_info_says(delay: float) -> None:
    env = make(delay=delay, track="flat")
    _, info = env.reset(seed=0)
    assert info["delay"].tolist() == [delay] * 4
    arrival = None
    for k in range(20):
        before = info["time"]
        info = env.step(np.ones(4) if k == 0 else np.zeros(4))[4]
        if info["force"][0] != 0.0 and arrival is None:
            arrival = before
    # force is seen at the ends of control periods: the command arrives within the one before
    assert arrival is not None
    assert arrival - 1e-12 <= delay < arrival + 0.01


def test_an_impulse_moves_the_carbody_as_in_the_linear_vehicle() -> None:
    # Half a period of 10 ms after a force of 4 x 3 kN on 40 t that lasts 10 ms: its momentum is
    # still the carbody's, less what the bogie springs have taken over (under a per cent).
    env = make(track="flat", observation_scale="si")
    env.reset(seed=0)
    velocity = env.step(np.ones(4))[0][:4].mean()
    mass = env.vehicle.parameters.lateral.carbody_mass
    sway = 4 * 3000.0 * 0.01 / mass
    roll_inertia = env.vehicle.parameters.lateral.carbody_roll_inertia
    lever = env.vehicle.parameters.lateral.carbody_to_damper_height
    expected = sway * (1.0 + mass * lever**2 / roll_inertia)
    assert velocity == pytest.approx(expected, rel=0.01)


def test_two_seeded_rollouts_are_bitwise_equal_and_another_seed_differs() -> None:
    env, used = (make(delay=(0.0, 0.2), jitter=0.05, track_level=(0.5, 2.0)) for _ in range(2))

    def played(env: Full50Env, seed: int) -> tuple[list[np.ndarray], list[Any]]:
        rng = np.random.default_rng(1)
        steps = [env.reset(seed=seed)] + [env.step(rng.uniform(-1, 1, 4)) for _ in range(60)]
        infos = [{n: np.asarray(v).tolist() for n, v in step[-1].items()} for step in steps]
        return [step[0] for step in steps], infos

    other = played(used, 8)
    first, again = played(env, 7), played(used, 7)
    np.testing.assert_array_equal(again[0], first[0])
    assert again[1] == first[1]
    assert not np.array_equal(other[0], first[0])


def test_an_environment_survives_pickling_in_mid_episode() -> None:
    env = make(delay=0.1)
    env.reset(seed=4)
    for _ in range(30):
        env.step(np.full(4, -0.2))
    copy = pickle.loads(pickle.dumps(env))
    for _ in range(30):
        np.testing.assert_array_equal(env.step(np.ones(4))[0], copy.step(np.ones(4))[0])


def test_the_vehicles_of_the_pool_are_nonlinear_and_as_drawn() -> None:
    settings = {"vehicle_ranges": "wide", "vehicle_pool": 3}
    mine, linear = make(**settings).vehicles, Lateral17Env(**settings, track_pool=1).vehicles
    assert [car.parameters.lateral for car in mine] == [car.parameters for car in linear]
    assert [car.speed for car in mine] == [car.speed for car in linear]
    assert len({car.speed for car in mine}) == 3


BAD: tuple[tuple[dict[str, Any], str], ...] = (
    ({"start": "controlled"}, "start"),
    ({"wheel": "s1003"}, "s1002"),
    ({"wheel": "cn60"}, "profile of a rail"),
    ({"rail": "lma"}, "profile of a wheel"),
    ({"wheel": 3}, "wheel = 3"),
    ({"friction": -0.1}, "friction"),
    ({"creep_law": "fastsym"}, "fastsim"),
    ({"creep_law": 3}, "creep_law"),
    ({"record_step": 0.0007}, "whole multiple"),
    ({"record_step": 0.02}, "40 Hz"),
    ({"record_step": 0.003}, "whole multiple"),
    ({"time_step": 0.002, "record_step": 0.01}, "too long"),
    ({"curve": 500.0}, "curve"),
    ({"curve": (0.0, 0.1)}, "radius"),
    ({"curve": (10.0, 0.1)}, "sharper than 100 m"),
    ({"curve": (500.0, np.nan)}, "cant"),
    ({"curve": (500.0, 1.0)}, "cant"),
    ({"curve": (500.0, 0.1), "curve_transition": 0.0}, "curve_transition"),
    ({"curve_start": -1.0}, "curve_start"),
    ({"frictoin": 0.3}, "did you mean 'friction'"),
    ({"delay": 0.4}, "max_delay"),
)


@pytest.mark.parametrize(("settings", "message"), BAD, ids=lambda value: str(value)[:40])
def test_a_bad_setting_is_refused_by_name(settings: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        Full50Env(**{**SMALL, **settings})
    with pytest.raises(ArgumentError, match=message):
        Full50VectorEnv(2, **{**SMALL, **settings})


def test_every_setting_of_its_own_is_documented_with_its_default() -> None:
    text = Full50Env.__doc__ or ""
    own = {f.name: f for f in dataclasses.fields(FullSettings)}
    for field in dataclasses.fields(EnvSettings):
        if own[field.name].default == field.default:
            del own[field.name]
    assert set(own) >= {"time_step", "wheel", "rail", "friction", "creep_law", "curve"}
    for name, field in own.items():
        rows = [line for line in text.splitlines() if re.match(rf"\s*\|.*`{name}`.*\|", line)]
        assert len(rows) == 1, name
        wanted = str(field.default).removesuffix(".0")
        assert wanted in rows[0], (name, wanted)


def test_the_docstring_has_gymnasiums_parts_in_order() -> None:
    headings = re.findall(r"^ *## (.*)$", Full50Env.__doc__ or "", flags=re.MULTILINE)
    assert headings == re.findall(r"^ *## (.*)$", Lateral17Env.__doc__ or "", flags=re.MULTILINE)


def test_a_delay_is_drawn_fixed_and_told_as_of_the_linear_vehicle() -> None:
    settings = {**SMALL, "delay": (0.0, 0.3), "delay_per_channel": True, "delay_observed": True}
    mine, linear = Full50Env(**settings), Lateral17Env(**settings)
    assert mine.observation_names[-1] == "told_delay_4"
    for options in (None, {"delay": 0.07}, {"delay": DelaySpec((0.1, 0.0, 0.2, 0.3))}):
        found, expected = (env.reset(seed=9, options=options) for env in (mine, linear))
        np.testing.assert_array_equal(found[1]["delay"], expected[1]["delay"])
        np.testing.assert_array_equal(found[0][-4:], expected[0][-4:])
        assert np.ptp(found[0][-4:]) > 0.0 or options == {"delay": 0.07}
