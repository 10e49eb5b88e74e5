"""`railenv train` and `railenv search` as a user types them; SIGKILL at random moments."""

import csv
import json
import os
import re
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from baselines.policies import load_trained
from baselines.training.checkpoint import read_checkpoint
from eval.cli import main
from railenv.config import config_path

pytest.importorskip("torch")

SMOKE = str(config_path("train", "smoke"))


@pytest.fixture(scope="module")
def smoke(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, str]:
    """A run of the smallest configuration, and what the command printed."""
    import contextlib
    import io

    folder = tmp_path_factory.mktemp("train") / "run"
    text = io.StringIO()
    with contextlib.redirect_stdout(text):
        assert main(["train", SMOKE, "--out", str(folder)]) == 0
    return folder, text.getvalue()


@pytest.mark.slow
def test_the_command_says_where_the_policy_is_and_what_comes_next(smoke: tuple[Path, str]) -> None:
    folder, text = smoke
    assert f"policy     {folder}\n" in text
    assert re.search(r"judge      stable: worst growth -\d", text)
    assert text.endswith(f"next       railenv score {folder}\n")
    assert load_trained(folder).history.control_period == 0.02


@pytest.mark.slow
def test_the_learning_curve_has_a_row_per_checkpoint(smoke: tuple[Path, str]) -> None:
    with (smoke[0] / "learning.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [float(row["steps"]) for row in rows] == [1600, 3200, 4800]
    assert {"seconds", "loss", "cost", "worst_growth", "ride_index_100ms", "growth_0ms"} <= set(
        rows[0]
    )


def test_the_run_records_settings_command_and_versions(smoke: tuple[Path, str]) -> None:
    about = json.loads((smoke[0] / "run.json").read_text())
    assert about["command"] == f"railenv train {SMOKE}"
    assert about["done"] is True
    assert {"numpy", "torch", "railenv"} <= set(about["versions"])
    assert about["config"]["method"]["learning_rate"] == 0.001


def test_resuming_what_is_done_says_so(
    smoke: tuple[Path, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", SMOKE, "--out", str(smoke[0]), "--resume"]) == 0
    assert "was done before; nothing was left to do" in capsys.readouterr().out


def test_a_policy_that_was_deleted_is_written_again_and_that_is_said(
    smoke: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = Path(shutil.copytree(smoke[0], tmp_path / "run"))
    for name in ("policy.safetensors", "card.json"):
        (run / name).unlink()
    assert main(["train", SMOKE, "--out", str(run), "--resume"]) == 0
    text = capsys.readouterr().out
    assert "its policy was missing and is written again from the best checkpoint" in text
    assert "nothing was left to do" not in text
    for name in ("policy.safetensors", "card.json"):
        assert (run / name).read_bytes() == (smoke[0] / name).read_bytes()


def test_a_warning_of_the_search_is_the_searchs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    class Warns:
        trials = 1

        def __init__(self, *_: object, warn: Callable[[str], None], **__: object) -> None:
            self.warn = warn

        def run(self, *_: object) -> dict[str, object]:
            self.warn("trial 0: it diverged")
            return {"trials": 1, "stable": 1, "number": 0, "cost": 1.0, "values": {}}

    monkeypatch.setattr("baselines.training.search.Search", Warns)
    assert main(["search", SMOKE, "--out", str(tmp_path / "a search")]) == 0
    found = capsys.readouterr()
    assert "railenv search: warning: trial 0: it diverged\n" in found.err
    assert "railenv train" not in found.err
    # What comes next can be pasted, a space in the path or not.
    assert shlex.split(found.out.splitlines()[-1])[-1] == str(tmp_path / "a search" / "best.toml")


@pytest.mark.slow
def test_a_second_run_gives_the_same_files_by_another_name_and_as_json(
    smoke: tuple[Path, str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ["train", SMOKE, "--out", str(tmp_path / "run"), "--json"]
    assert main(command) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["stable"] is True
    assert answer["policy"] == str(tmp_path / "run")
    for name in ("policy.safetensors", "card.json"):
        assert (tmp_path / "run" / name).read_bytes() == (smoke[0] / name).read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["train", "smoek"], "did you mean 'smoke'"),
        (["train", "nowhere.toml"], "cannot read nowhere.toml"),
        (["train", "smoke", "--seed", "x"], "seed = 'x' is not a whole number"),
        (["train", "smoke", "--steps", "0"], "steps = 0 is too small"),
        (["train", "smoke", "--out", ""], "out = '' is no folder"),
        (["search", "smoke"], r"has no table \[search\]"),
    ],
)
def test_bad_arguments_are_one_line_and_status_two(
    arguments: list[str], message: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert re.search(message, error)
    assert error.count("\n") == 1


def test_a_folder_in_use_is_refused(
    smoke: tuple[Path, str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["train", SMOKE, "--out", str(smoke[0])]) == 2
    assert re.search("--resume.*--out", capsys.readouterr().err)


def _many_checkpoints(folder: Path) -> str:
    """The smallest configuration with a checkpoint after every update."""
    text = Path(SMOKE).read_text()
    text = text.replace("every = 1_600", "every = 400").replace("steps = 4_800", "steps = 12_000")
    path = folder / "many.toml"
    path.write_text(text)
    return str(path)


def _start(config: str, folder: Path, *more: str) -> "subprocess.Popen[bytes]":
    command = [sys.executable, "-m", "eval.cli", "train", config, "--out", str(folder), *more]
    return subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)


def _wait_for(process: "subprocess.Popen[bytes]", folder: Path, steps: int) -> None:
    """Wait until a checkpoint of so many steps is there."""
    deadline = time.monotonic() + 120.0
    while not any(int(p.name) >= steps for p in folder.glob("checkpoints/[0-9]*")):
        assert process.poll() is None, "the run ended before it was killed"
        assert time.monotonic() < deadline
        time.sleep(0.002)


@pytest.mark.slow
def test_a_run_killed_at_three_random_moments_ends_as_an_undisturbed_one(tmp_path: Path) -> None:
    config = _many_checkpoints(tmp_path)
    whole, run = tmp_path / "whole", tmp_path / "run"
    assert _start(config, whole).wait(300) == 0
    # A checkpoint takes most of the time between two: many of these moments fall into writing.
    draws = np.random.default_rng(7)
    for place, after in enumerate((400, 4000, 8000)):
        process = _start(config, run, *(["--resume"] if place else []))
        _wait_for(process, run, after + 400 * int(draws.integers(0, 6)))
        time.sleep(float(draws.uniform(0.0, 0.1)))
        os.kill(process.pid, signal.SIGKILL)
        assert process.wait(60) == -signal.SIGKILL
        assert not (run / "policy.safetensors").exists()
    assert _start(config, run, "--resume").wait(300) == 0
    for name in ("policy.safetensors", "card.json"):
        assert (run / name).read_bytes() == (whole / name).read_bytes()
    _check_every_file(run)


def _check_every_file(run: Path) -> None:
    """Every file of a run loads, and nothing temporary is left."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    about = json.loads((run / "run.json").read_text())
    assert about["done"] is True
    json.loads((run / "references.json").read_text())
    with (run / "learning.csv").open() as stream:
        steps = [float(row["steps"]) for row in csv.DictReader(stream)]
    assert steps == list(range(400, 12_001, 400))
    for folder in (run / "checkpoints").iterdir():
        assert folder.name.isdecimal()
        assert read_checkpoint(folder).steps == int(folder.name)
        load_trained(folder / "policy")
    load_trained(run)
    events = EventAccumulator(str(run / "tensorboard"))
    events.Reload()
    assert events.Scalars("judge/cost")[-1].step == 12_000
    known = {
        *("run.json", "references.json", "learning.csv", "checkpoints", "tensorboard"),
        *("policy.safetensors", "card.json", ".lock"),
    }
    assert {path.name for path in run.iterdir()} == known


@pytest.mark.slow
def test_ctrl_c_leaves_a_checkpoint_and_status_130(tmp_path: Path) -> None:
    text = Path(SMOKE).read_text().replace("steps = 4_800", "steps = 4_000_000")
    config = tmp_path / "long.toml"
    config.write_text(text.replace("every = 1_600", "every = 4_000"))
    run = tmp_path / "run"
    process = _start(str(config), run)
    _wait_for(process, run, 4000)
    process.send_signal(signal.SIGINT)
    assert process.wait(60) == 130
    newest = max((run / "checkpoints").iterdir())
    # The one that the interruption wrote: between two regular ones, or at one.
    assert read_checkpoint(newest).plain["progress"]["interruptions"] in ([], [int(newest.name)])


@pytest.mark.slow
def test_the_search_command_writes_a_configuration_that_trains(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    config = tmp_path / "search.toml"
    shutil.copy(SMOKE, config)
    with config.open("a") as stream:
        stream.write("\n[search]\ntrials = 2\nsteps = 800\n[search.ranges]\n")
        stream.write('"method.learning_rate" = {low = 1e-4, high = 2e-3, log = true}\n')
    assert main(["search", str(config), "--out", str(tmp_path / "s")]) == 0
    assert f"next       railenv train {tmp_path / 's' / 'best.toml'}" in capsys.readouterr().out
    best = str(tmp_path / "s" / "best.toml")
    assert main(["train", best, "--steps", "800", "--out", str(tmp_path / "run")]) == 0
