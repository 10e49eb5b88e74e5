"""Training configurations: what they take, what they refuse, and that they come back whole."""

import copy
from typing import Any

import pytest

from baselines.training import settings as module
from baselines.training.method import METHODS, episode_seed
from baselines.training.settings import TrainingSettings, load_settings, settings_from
from baselines.training.toml_text import toml_text
from railenv.config import config_names, config_path
from railenv.errors import ArgumentError
from railenv.track.seed_domains import TRAINING_POOLS, TRAINING_SEEDS
from railenv.vehicle.coordinates import actuator_positions

pytest.importorskip("torch")

PLAIN: dict[str, Any] = {
    "description": "a linear policy",
    "seed": 1,
    "steps": 1000,
    "environment": {"track": "german_low", "delay": [0.0, 0.3], "told_error": 0.02},
    "policy": {"class": "linear"},
    "method": {"name": "apg"},
    "search": {
        "trials": 3,
        "steps": 500,
        "ranges": {
            "method.learning_rate": {"low": 1e-4, "high": 1e-2, "log": True},
            "policy.base": {"choices": ["", "skyhook:gain=4e3"]},
        },
    },
}


def changed(path: str, value: Any) -> dict[str, Any]:
    """PLAIN with one entry replaced."""
    plain = copy.deepcopy(PLAIN)
    place = plain
    *tables, key = path.split("/")
    for table in tables:
        place = place.setdefault(table, {})
    place[key] = value
    return plain


def test_settings_come_back_whole_from_what_they_are_written_as() -> None:
    settings = settings_from(PLAIN, "test")
    assert settings_from(settings.to_plain(), "again") == settings


def test_settings_come_back_whole_from_toml(tmp_path: Any) -> None:
    settings = settings_from(PLAIN, "test")
    path = tmp_path / "settings.toml"
    path.write_text(toml_text(settings.to_plain(), "a comment\nof two lines"))
    assert load_settings(path) == settings


def test_odd_texts_and_numbers_survive_toml(tmp_path: Any) -> None:
    import tomllib

    values = {
        "text": 'a "quoted" \\ back\tslash\x7f\n\u00e4',
        "small": 5e-324,
        "large": 1.7976931348623157e308,
        "whole": 1e22,
        "negative": -0.0,
        "list": [1, 2.5, "x", [True, False]],
        "table": {"a.b": {"x y": 1}},
    }
    assert tomllib.loads(toml_text(values)) == values


def test_the_environment_observes_what_the_policy_sees() -> None:
    settings = settings_from(PLAIN, "test")
    environment, history = settings.environment, settings.history()
    assert environment.observation_history == max(history.sensor_lags)
    assert environment.action_history == max(history.action_lags)
    assert environment.control_period == history.control_period
    assert environment.delay_observed
    assert len(actuator_positions(history.layout)) == history.num_channels


def test_a_hidden_delay_is_not_observed() -> None:
    plain = changed("policy/told_knots", [])
    del plain["environment"]["told_error"]
    assert not settings_from(plain, "test").environment.delay_observed


@pytest.mark.parametrize(
    ("path", "value", "message"),
    [
        ("budget", 3, "unknown key 'budget'"),
        ("seed", 1.5, "seed = 1.5 must be of type int"),
        ("seed", -1, "seed = -1 is too small"),
        ("steps", 0, "steps = 0 is too small"),
        ("environment/trak", "flat", "did you mean 'track'"),
        ("environment/layout", 2, r"layout follows from what the policy sees.*\[policy\]"),
        ("environment/control_period", 0.02, "control_period follows"),
        ("environment/pool_seed", TRAINING_SEEDS, "judge and score"),
        ("environment/pool_seed", TRAINING_POOLS, "judge and score"),
        ("policy/class", "quadratic", "unknown class of policy 'quadratic'"),
        ("policy/hidden", [8], "hidden = .8. does not fit class = 'linear'"),
        ("policy/sensors", ["speedometer"], "unknown sensor 'speedometer'"),
        ("policy/sensor_lags", [0, 3, 2], "sensor_lags"),
        ("method/name", "apgg", "did you mean 'apg'"),
        ("method/learningrate", 1.0, "did you mean 'learning_rate'"),
        ("method", 3, r"must be a table \[method\]"),
        ("checkpoints/delays", [0.1, 0.0], "must be a rising list"),
        ("checkpoints/told_errors", [0.02], "must have 0 among them"),
        ("checkpoints/skip_seconds", 15.0, "leaves nothing"),
        ("search/ranges", {}, "ranges is empty"),
        ("search/ranges/seed", {"low": 0, "high": 9}, "nothing to search over"),
        ("search/ranges/method.lanes", {"low": 9, "high": 2}, "low = 9 must be below"),
        ("search/ranges/method.lanes", {"low": 0, "high": 2, "log": True}, "low = 0 must be above"),
        ("search/ranges/method.lanes", {"min": 2}, "'min' is unknown"),
    ],
)
def test_a_bad_entry_is_refused_and_named(path: str, value: Any, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        settings_from(changed(path, value), "test")


@pytest.mark.parametrize("key", ["description", "seed", "steps", "policy", "method", "environment"])
def test_what_is_missing_is_named(key: str) -> None:
    plain = copy.deepcopy(PLAIN)
    del plain[key]
    with pytest.raises(ArgumentError, match=f"missing {key}"):
        settings_from(plain, "test")


def test_every_shipped_configuration_loads() -> None:
    names = config_names("train")
    assert "smoke" in names
    for name in names:
        settings = load_settings(config_path("train", name))
        assert isinstance(settings, TrainingSettings)
        assert settings.method in METHODS


def test_seeds_of_episodes_stay_below_those_of_scoring_and_differ() -> None:
    seeds = [
        episode_seed(seed, word, number)
        for seed in range(5)
        for word in ("apg", "ppo")
        for number in range(20)
    ]
    assert all(0 <= seed < TRAINING_POOLS for seed in seeds)
    # 200 draws of 900 000: two equal ones have a chance of 2 %, and the draws are fixed.
    assert len(set(seeds)) == len(seeds)


def test_a_method_that_is_not_installed_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setitem(METHODS, "apg", "a_package_that_is_not_there:Method")
    with pytest.raises(ArgumentError, match=r"a_package_that_is_not_there.*railenv\[train\]"):
        module.settings_from(PLAIN, "test")
