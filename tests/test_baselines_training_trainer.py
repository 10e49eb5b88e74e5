"""Training runs: what they leave, and that nothing but steps is lost by a kill.

The method here is a random walk of a linear policy's gains: its result depends on everything that a
trainer has to keep right (weights, counters, the seeds of episodes), and a run takes a second.
"""

import csv
import json
import os
import shutil
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.policies import load_trained
from baselines.training.checkpoint import WRITING, read_checkpoint
from baselines.training.judge import Judgement, better
from baselines.training.method import METHODS, episode_seed
from baselines.training.outcome import Outcome
from baselines.training.settings import TrainingSettings, settings_from
from baselines.training.trainer import Trainer
from railenv.errors import ArgumentError, RailenvError

pytest.importorskip("torch")

EVERY = 300


@dataclass(frozen=True)
class WalkSettings:
    step: float = 1e-3
    stopped_at: int = 0
    diverged_at: int = 0


class Killed(BaseException):
    """A process that ends at once: nothing of the library catches it."""


class Walk:
    """Gains that walk at random; one update is 100 lane-steps."""

    name = "walk"
    obedient = True
    """Whether `begin` draws new episodes; the fault that a test plants."""

    def __init__(self, settings: TrainingSettings, seed: int) -> None:
        self.history, self.hyper, self.seed = settings.history(), settings.hyper, seed
        shape = (self.history.num_knots, self.history.num_actions, self.history.num_features)
        self.gains = np.zeros(shape)
        self.steps = 0
        self.draws = np.random.default_rng(seed)

    @classmethod
    def hyper_parameters(cls, name: str) -> type[WalkSettings]:
        return WalkSettings

    def begin(self) -> None:
        if self.obedient:
            self.draws = np.random.default_rng(episode_seed(self.seed, "walk", self.steps))

    def update(self) -> dict[str, float]:
        self.gains = self.gains + self.hyper.step * self.draws.standard_normal(self.gains.shape)
        self.steps += 100
        if self.steps == self.hyper.stopped_at:
            os.kill(os.getpid(), signal.SIGINT)
        size = float(np.abs(self.gains).max())
        return {"size": np.nan if self.steps == self.hyper.diverged_at else size}

    def module(self) -> Any:
        import torch

        from baselines.policies.torch_modules import LinearModule

        module = LinearModule(self.history, dtype=torch.float64)
        with torch.no_grad():
            module.weights.copy_(torch.tensor(self.gains))
        return module

    def state(self) -> tuple[dict[str, Any], dict[str, Any]]:
        return {"gains": self.gains.copy()}, {"steps": self.steps}

    def restore(self, arrays: dict[str, Any], plain: dict[str, Any]) -> None:
        self.gains, self.steps = arrays["gains"].copy(), plain["steps"]


@pytest.fixture(autouse=True)
def walk(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(METHODS, "walk", f"{__name__}:Walk")


def settings(steps: int = 900, seed: int = 3, **hyper: Any) -> TrainingSettings:
    values = {
        "description": "a walk",
        "seed": seed,
        "steps": steps,
        "environment": {"track": "german_low", "delay": [0.0, 0.1], "max_delay": 0.1},
        "policy": {
            "class": "linear",
            "sensors": ["carbody_lateral_velocity_1", "carbody_lateral_velocity_4"],
            "sensor_lags": [0],
            "action_lags": [1],
            "told_knots": [0.0, 0.1],
            "control_period": 0.05,
        },
        "method": {"name": "walk", **hyper},
        "checkpoints": {
            "every": EVERY,
            "keep": 2,
            "delays": [0.0, 0.1],
            "dev_tracks": 1,
            "dev_seconds": 1.0,
            "skip_seconds": 0.5,
        },
    }
    return settings_from(values, "test")


def trained(folder: Path, resume: bool = False, **chosen: Any) -> Outcome:
    return Trainer(settings(**chosen), folder, with_references=False).run(resume)


def killed(folder: Path, at: int, resume: bool = False) -> None:
    """A run that ends at once, as by SIGKILL, after some lane-steps."""
    killing = Trainer(settings(), folder, with_references=False)
    Walk.update, whole = _killing(at), Walk.update
    try:
        with pytest.raises(Killed):
            killing.run(resume)
    finally:
        Walk.update = whole


def _killing(at: int) -> Any:
    whole = Walk.update

    def update(self: Walk) -> dict[str, float]:
        metrics = whole(self)
        if self.steps == at:
            raise Killed
        return metrics

    return update


def policy_bytes(folder: Path) -> tuple[bytes, bytes]:
    return (folder / "policy.safetensors").read_bytes(), (folder / "card.json").read_bytes()


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in (folder / "checkpoints").iterdir())


@pytest.mark.slow
def test_a_run_leaves_the_policy_of_its_best_checkpoint(tmp_path: Path) -> None:
    outcome = trained(tmp_path / "run")
    kept = tmp_path / "run" / "checkpoints" / f"{outcome.best_steps:012d}" / "policy"
    assert policy_bytes(tmp_path / "run") == policy_bytes(kept)
    np.testing.assert_array_equal(
        load_trained(tmp_path / "run").weights,
        read_checkpoint(kept.parent).arrays["gains"],
    )


@pytest.mark.slow
def test_the_best_checkpoint_has_the_lowest_rank_of_all_judged(tmp_path: Path) -> None:
    outcome = trained(tmp_path / "run", steps=1500, step=0.05)
    with (tmp_path / "run" / "learning.csv").open() as stream:
        rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(stream)]
    ranks = [
        (0, r["cost"]) if r["stable"] else (1 + (r["worst_growth"] >= 0), r["worst_growth"])
        for r in rows
    ]
    assert [r["steps"] for r in rows] == [300, 600, 900, 1200, 1500]
    assert rows[ranks.index(min(ranks))]["steps"] == outcome.best_steps


@pytest.mark.slow
def test_one_seed_gives_one_policy_and_another_seed_another(tmp_path: Path) -> None:
    for name, seed in (("one", 3), ("two", 3), ("three", 4)):
        trained(tmp_path / name, seed=seed)
    one, two, three = (policy_bytes(tmp_path / name) for name in ("one", "two", "three"))
    assert one == two
    assert one[0] != three[0]


@pytest.mark.slow
@pytest.mark.parametrize("at", [100, 500, 600])
def test_a_killed_and_resumed_run_gives_the_undisturbed_policy(tmp_path: Path, at: int) -> None:
    trained(tmp_path / "whole")
    killed(tmp_path / "run", at)
    assert not (tmp_path / "run" / "policy.safetensors").exists()
    trained(tmp_path / "run", resume=True)
    assert policy_bytes(tmp_path / "run") == policy_bytes(tmp_path / "whole")


@pytest.mark.slow
def test_a_run_killed_three_times_gives_the_undisturbed_curve(tmp_path: Path) -> None:
    trained(tmp_path / "whole")
    for place, at in enumerate((200, 500, 700)):
        killed(tmp_path / "run", at, resume=place > 0)
    trained(tmp_path / "run", resume=True)
    curves = []
    for name in ("whole", "run"):
        with (tmp_path / name / "learning.csv").open() as stream:
            curves.append([{**row, "seconds": ""} for row in csv.DictReader(stream)])
    assert curves[0] == curves[1]


@pytest.mark.slow
def test_a_method_that_goes_on_after_a_checkpoint_unseeded_is_found_out(tmp_path: Path) -> None:
    # The fault that `begin` is there for: the same comparison as above must see it.
    Walk.obedient = False
    try:
        trained(tmp_path / "whole")
        killed(tmp_path / "run", 500)
        trained(tmp_path / "run", resume=True)
    finally:
        Walk.obedient = True
    last = [
        read_checkpoint(tmp_path / name / "checkpoints" / "000000000900").arrays["gains"]
        for name in ("whole", "run")
    ]
    assert not np.array_equal(*last)


@pytest.mark.slow
def test_time_goes_on_after_a_resume(tmp_path: Path) -> None:
    killed(tmp_path / "run", 700)
    first = read_checkpoint(tmp_path / "run" / "checkpoints" / "000000000600")
    # As if the first part had taken a thousand seconds.
    path = tmp_path / "run" / "checkpoints" / "000000000600" / "checkpoint.json"
    body = json.loads(path.read_text())
    body["plain"]["progress"]["seconds"] = 1000.0
    del body["sha256_of_this"]  # the content is no longer what it was summed over
    path.write_text(json.dumps(body))
    outcome = trained(tmp_path / "run", resume=True)
    assert first.plain["progress"]["seconds"] < 100.0
    assert 1000.0 < outcome.seconds < 1100.0


@pytest.mark.slow
def test_a_truncated_newest_checkpoint_falls_back_to_the_one_before(tmp_path: Path) -> None:
    trained(tmp_path / "whole")
    killed(tmp_path / "run", 700)
    newest = tmp_path / "run" / "checkpoints" / "000000000600" / "arrays.npz"
    newest.write_bytes(newest.read_bytes()[:-50])
    warnings: list[str] = []
    Trainer(settings(), tmp_path / "run", with_references=False, warn=warnings.append).run(True)
    assert len(warnings) == 1
    assert "000000000600" in warnings[0]
    assert "the one before" in warnings[0]
    assert policy_bytes(tmp_path / "run") == policy_bytes(tmp_path / "whole")


@pytest.mark.slow
@pytest.mark.parametrize("part", ["arrays.npz", "checkpoint.json", "policy/policy.safetensors"])
def test_any_flipped_byte_of_a_checkpoint_is_found(tmp_path: Path, part: str) -> None:
    killed(tmp_path / "run", 400)
    path = tmp_path / "run" / "checkpoints" / "000000000300" / part
    content = bytearray(path.read_bytes())
    content[len(content) // 2] ^= 0xFF
    path.write_bytes(content)
    with pytest.raises(RailenvError, match="000000000300"):
        read_checkpoint(path.parent if "/" not in part else path.parent.parent)


@pytest.mark.slow
def test_a_half_written_checkpoint_does_not_count(tmp_path: Path) -> None:
    trained(tmp_path / "whole")
    killed(tmp_path / "run", 500)
    left = tmp_path / "run" / "checkpoints" / f"{WRITING}abc"
    shutil.copytree(tmp_path / "run" / "checkpoints" / "000000000300", left)
    (left / "checkpoint.json").unlink()
    trained(tmp_path / "run", resume=True)
    assert all(name.isdecimal() for name in names(tmp_path / "run"))
    assert policy_bytes(tmp_path / "run") == policy_bytes(tmp_path / "whole")


@pytest.mark.slow
def test_only_the_newest_checkpoints_and_the_best_of_each_stay(tmp_path: Path) -> None:
    outcome = trained(tmp_path / "run", steps=2400, step=0.05)
    stay = {f"{steps:012d}" for steps in (2100, 2400, outcome.best_steps)}
    assert stay <= set(names(tmp_path / "run"))
    assert len(names(tmp_path / "run")) <= 4


@pytest.mark.slow
def test_an_interruption_keeps_every_step_and_is_noted(tmp_path: Path) -> None:
    run = Trainer(settings(stopped_at=400), tmp_path / "run", with_references=False)
    with pytest.raises(KeyboardInterrupt):
        run.run()
    assert names(tmp_path / "run") == ["000000000300", "000000000400"]
    outcome = trained(tmp_path / "run", resume=True, stopped_at=400)
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    assert outcome.steps == 900
    assert about["interruptions"] == [400]
    # A policy from before the interruption is the command's own; those after it are not.
    for steps, noted in ((300, False), (900, True)):
        limits = _card(tmp_path / "run" / "checkpoints" / f"{steps:012d}" / "policy")["limits"]
        assert any("interrupted after 400" in line for line in limits) is noted


@pytest.mark.slow
def test_a_finished_run_has_nothing_left_to_do(tmp_path: Path) -> None:
    first = trained(tmp_path / "run")
    before = policy_bytes(tmp_path / "run")
    again = trained(tmp_path / "run", resume=True)
    assert again.was_done
    assert (again.best, again.seconds) == (first.best, first.seconds)
    assert policy_bytes(tmp_path / "run") == before


@pytest.mark.slow
def test_a_run_killed_while_it_put_its_policy_in_place_does_so_again(tmp_path: Path) -> None:
    trained(tmp_path / "run")
    before = policy_bytes(tmp_path / "run")
    about = json.loads((tmp_path / "run" / "run.json").read_text())
    (tmp_path / "run" / "run.json").write_text(json.dumps({**about, "done": False}))
    (tmp_path / "run" / "card.json").unlink()
    (tmp_path / "run" / "policy.safetensors").write_bytes(b"half")
    assert not trained(tmp_path / "run", resume=True).was_done
    assert policy_bytes(tmp_path / "run") == before


def test_a_folder_that_is_not_empty_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    with pytest.raises(ArgumentError, match=r"--resume.*--out"):
        trained(tmp_path)
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


@pytest.mark.slow
def test_resuming_with_other_settings_names_what_differs(tmp_path: Path) -> None:
    killed(tmp_path / "run", 400)
    with pytest.raises(
        ArgumentError, match=r"\(method\.step: 0\.001 there, 0\.5 here; seed: 3 there, 4 here\)"
    ):
        trained(tmp_path / "run", resume=True, seed=4, step=0.5)


@pytest.mark.slow
def test_numbers_that_are_not_finite_end_a_run_and_name_the_best_policy(tmp_path: Path) -> None:
    with pytest.raises(RailenvError, match=r"after 500 lane-steps.*000000000300.policy"):
        trained(tmp_path / "run", diverged_at=500)


@pytest.mark.slow
def test_a_card_holds_the_settings_that_give_the_policy_again(tmp_path: Path) -> None:
    trained(tmp_path / "run")
    training = _card(tmp_path / "run")["training"]
    again = settings_from(training["config"], "card")
    assert again == settings()
    Trainer(again, tmp_path / "again", with_references=False).run()
    assert policy_bytes(tmp_path / "again") == policy_bytes(tmp_path / "run")


@pytest.mark.slow
def test_tensorboard_reads_every_update(tmp_path: Path) -> None:
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    trained(tmp_path / "run")
    events = EventAccumulator(str(tmp_path / "run" / "tensorboard"))
    events.Reload()
    assert [e.step for e in events.Scalars("training/size")] == list(range(100, 1000, 100))
    assert [e.step for e in events.Scalars("judge/cost")] == [300, 600, 900]


def _card(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "card.json").read_text())


def _judgement(growth: float, cost: float) -> Judgement:
    return Judgement((0.0,), (0.0,), ((growth,),), (1.0,), (False,), cost)


def test_growth_counts_before_cost() -> None:
    stable, growing = _judgement(-0.1, 5.0), _judgement(0.1, -9.0)
    assert better(stable, growing)
    assert not better(growing, stable)
    assert better(_judgement(-0.1, 4.0), stable)
    assert not better(_judgement(-5.0, 5.0), stable)
    assert better(_judgement(0.05, 0.0), growing)
