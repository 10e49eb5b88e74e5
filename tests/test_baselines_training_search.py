"""The search of hyper-parameters: what it tries, what it finds, and going on after a kill."""

import json
import subprocess
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from test_baselines_training_run_lock import HOLDER

from baselines.training.method import METHODS
from baselines.training.search import Search
from baselines.training.settings import TrainingSettings, load_settings, settings_from
from railenv.errors import ArgumentError, InputFileError, RailenvError

pytest.importorskip("torch")
pytest.importorskip("optuna")


@dataclass(frozen=True)
class GainSettings:
    gain: float = 0.0
    places: tuple[int, ...] = (0, 1)


class Killed(BaseException):
    """A process that ends at once: nothing of the library catches it."""


class Given:
    """A policy of one number: a gain from velocity to action; nothing is learnt."""

    name = "given"
    killed_at = -1
    """Trial, counted over all runs, whose second update does not come back."""
    begun = 0

    def __init__(self, settings: TrainingSettings, seed: int) -> None:
        self.history, self.hyper, self.steps = settings.history(), settings.hyper, 0
        Given.begun += 1
        self.number = Given.begun

    @classmethod
    def hyper_parameters(cls, name: str) -> type[GainSettings]:
        return GainSettings

    def begin(self) -> None:
        pass

    def update(self) -> dict[str, float]:
        self.steps += 100
        if self.number == Given.killed_at and self.steps == 200:
            raise Killed
        return {"gain": self.hyper.gain}

    def module(self) -> Any:
        import torch

        from baselines.policies.torch_modules import LinearModule

        module = LinearModule(self.history, dtype=torch.float64)
        with torch.no_grad():
            for place in self.hyper.places:
                module.weights[0, place, place] = -self.hyper.gain
        return module

    def state(self) -> tuple[dict[str, Any], dict[str, Any]]:
        return {}, {"steps": self.steps}

    def restore(self, arrays: dict[str, Any], plain: dict[str, Any]) -> None:
        self.steps = plain["steps"]


@pytest.fixture(autouse=True)
def given(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "given", f"{__name__}:Given")
    monkeypatch.setattr(Given, "begun", 0)
    monkeypatch.setattr(Given, "killed_at", -1)


def settings(ranges: dict[str, Any], trials: int = 6) -> TrainingSettings:
    values = {
        "description": "a gain",
        "seed": 1,
        "steps": 1000,
        "environment": {"track": "german_low", "max_delay": 0.1, "start": "controlled"},
        "policy": {
            "class": "linear",
            "sensors": ["carbody_lateral_velocity_1", "carbody_lateral_velocity_4"],
            "sensor_lags": [0],
            "action_lags": [],
            "told_knots": [],
            "control_period": 0.05,
        },
        "method": {"name": "given"},
        "checkpoints": {
            "every": 100,
            "delays": [0.0, 0.1],
            "dev_tracks": 1,
            "dev_seconds": 3.0,
            "skip_seconds": 1.0,
        },
        "search": {"trials": trials, "steps": 200, "ranges": ranges},
    }
    return settings_from(values, "test")


GAIN = {"method.gain": {"low": -0.1, "high": 0.2}}


@pytest.mark.slow
def test_the_search_finds_the_sign_of_damping_and_writes_a_whole_configuration(
    tmp_path: Path,
) -> None:
    found = Search(settings(GAIN), tmp_path / "s").run()
    assert found["values"]["method.gain"] > 0.0
    assert 1 <= found["stable"] < found["trials"] == 6
    best = load_settings(tmp_path / "s" / "best.toml")
    assert best.hyper.gain == found["values"]["method.gain"]
    assert best.steps == 1000
    assert best.search is None
    runs = (tmp_path / "s" / "trials").glob("*/run.json")
    gains = {json.loads(run.read_text())["config"]["method"]["gain"] for run in runs}
    assert len(gains) == 6  # every trial has a proposal of its own


@pytest.mark.slow
def test_a_killed_search_goes_on_with_the_trial_it_was_at(tmp_path: Path) -> None:
    whole = Search(settings(GAIN, trials=4), tmp_path / "whole").run()
    Given.begun, Given.killed_at = 0, 3
    with pytest.raises(Killed):
        Search(settings(GAIN, trials=4), tmp_path / "s").run()
    Given.killed_at = -1
    assert (tmp_path / "s" / "trials" / "002" / "checkpoints" / "000000000100").is_dir()
    again = Search(settings(GAIN, trials=4), tmp_path / "s").run(resume=True)
    assert again == whole
    best = [(tmp_path / name / "best.toml").read_text() for name in ("whole", "s")]
    assert best[0] == best[1]


@pytest.mark.slow
def test_a_finished_search_can_be_given_more_trials(tmp_path: Path) -> None:
    Search(settings(GAIN, trials=2), tmp_path / "s").run()
    begun = Given.begun
    found = Search(settings(GAIN, trials=2), tmp_path / "s", trials=3).run(resume=True)
    assert found["trials"] == 3
    assert Given.begun == begun + 1


@pytest.mark.slow
def test_choices_may_be_lists_and_whole_numbers_stay_whole(tmp_path: Path) -> None:
    ranges = {
        "method.places": {"choices": [[0], [0, 1]]},
        "policy.sensor_lags": {"choices": [[0], [0, 1]]},
        "environment.track_pool": {"low": 1, "high": 8, "log": True},
    }
    Search(settings(ranges, trials=3), tmp_path / "s").run()
    best = tomllib.loads((tmp_path / "s" / "best.toml").read_text())
    assert best["method"]["places"] in ([0], [0, 1])
    assert best["policy"]["sensor_lags"] in ([0], [0, 1])
    assert isinstance(best["environment"]["track_pool"], int)


@pytest.mark.slow
def test_a_search_without_a_stable_policy_says_so(tmp_path: Path) -> None:
    ranges = {"method.gain": {"low": -2.0, "high": -1.0}}
    with pytest.raises(RailenvError, match="none of 2 trials gave a policy that is stable"):
        Search(settings(ranges, trials=2), tmp_path / "s").run()


def test_a_search_over_what_does_not_exist_is_refused_before_it_begins(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="unknown key 'gian'"):
        Search(settings({"method.gian": {"low": 0.0, "high": 1.0}}), tmp_path / "s")
    assert not (tmp_path / "s").exists()


def test_a_folder_with_something_else_in_it_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ArgumentError, match=r"--resume.*--out"):
        Search(settings(GAIN), tmp_path).run()
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.slow
def test_a_search_with_other_ranges_is_not_resumed(tmp_path: Path) -> None:
    Search(settings(GAIN, trials=1), tmp_path / "s").run()
    other = settings({"method.gain": {"low": 0.0, "high": 0.3}}, trials=1)
    with pytest.raises(
        ArgumentError, match=r"search\.ranges\.method\.gain\.high: 0\.2 there, 0\.3"
    ):
        Search(other, tmp_path / "s").run(resume=True)


@pytest.mark.slow
def test_a_second_search_in_a_folder_is_refused_until_the_first_is_gone(tmp_path: Path) -> None:
    first = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(tmp_path)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert first.stdout is not None
    assert first.stdout.readline() == "held\n"
    for resume in (False, True):
        with pytest.raises(ArgumentError, match="in use by another training or search"):
            Search(settings(GAIN), tmp_path).run(resume)
    first.kill()  # SIGKILL: nothing of its own can give the lock back
    first.communicate()
    # The lock that was left does not make the folder used: now it gets as far as the first trial.
    Given.killed_at = 1
    with pytest.raises(Killed):
        Search(settings(GAIN), tmp_path).run()


def test_a_damaged_search_json_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "search.json").write_text('{"config"')
    with pytest.raises(InputFileError, match=r"search\.json is not valid JSON"):
        Search(settings(GAIN), tmp_path).run(resume=True)
