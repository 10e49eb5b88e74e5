"""Runs of which a file is gone or damaged: what is put right, and what is said of the rest."""

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from test_baselines_training_trainer import policy_bytes, settings

from baselines.training.method import METHODS
from baselines.training.trainer import Trainer
from railenv.errors import InputFileError

pytest.importorskip("torch")


@pytest.fixture(scope="module", autouse=True)
def walk() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.setitem(METHODS, "walk", "test_baselines_training_trainer:Walk")
        yield


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run that is done."""
    folder = tmp_path_factory.mktemp("done") / "run"
    Trainer(settings(), folder, with_references=False).run()
    return folder


@pytest.fixture
def run(whole: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(whole, tmp_path / "run"))


def resumed(run: Path) -> tuple[Any, list[str]]:
    warnings: list[str] = []
    trainer = Trainer(settings(), run, with_references=False, warn=warnings.append)
    return trainer.run(resume=True), warnings


def undone(run: Path) -> Path:
    """Make a run one that was killed after its last checkpoint; return that."""
    about = json.loads((run / "run.json").read_text())
    (run / "run.json").write_text(json.dumps({**about, "done": False}))
    return max((run / "checkpoints").iterdir())


@pytest.mark.parametrize("lost", [("card.json",), ("policy.safetensors", "card.json")])
def test_a_policy_that_was_deleted_comes_back_bit_for_bit(
    run: Path, whole: Path, lost: tuple[str, ...]
) -> None:
    for name in lost:
        (run / name).unlink()
    outcome, _ = resumed(run)
    assert (outcome.was_done, outcome.put_back) == (True, True)
    assert policy_bytes(run) == policy_bytes(whole)
    assert resumed(run)[0].put_back is False


def test_a_deleted_policy_without_its_checkpoint_is_an_error(run: Path) -> None:
    (run / "card.json").unlink()
    shutil.rmtree(run / "checkpoints")
    with pytest.raises(InputFileError, match=r"cannot be taken from its checkpoint.*--out"):
        resumed(run)
    # What is left is left as it is.
    assert (run / "policy.safetensors").is_file()
    assert not (run / "card.json").exists()


def test_a_damaged_checkpoint_is_not_put_in_place_of_a_policy(run: Path) -> None:
    best = json.loads((run / "run.json").read_text())["best_steps"]
    stored = run / "checkpoints" / f"{best:012d}" / "policy" / "policy.safetensors"
    stored.write_bytes(stored.read_bytes()[:-8])
    (run / "card.json").unlink()
    with pytest.raises(InputFileError, match=r"not as it was written: damaged"):
        resumed(run)
    assert not (run / "card.json").exists()


def without(content: dict[str, Any], *path: str) -> dict[str, Any]:
    place = content
    for key in path[:-1]:
        place = place[key]
    del place[path[-1]]
    return content


def placed(content: dict[str, Any], value: object, *path: str) -> dict[str, Any]:
    place = content
    for key in path[:-1]:
        place = place[key]
    place[path[-1]] = value
    return content


@pytest.mark.parametrize(
    "damage",
    [
        lambda _: "",
        lambda c: json.dumps(c)[:-40],
        lambda _: "[" * 100_000,
        lambda _: "[]",
        lambda c: json.dumps(without(c, "plain")),
        lambda c: json.dumps(placed(c, [1], "sha256")),
        # Valid in itself, and found by its own checksum.
        lambda c: json.dumps(placed(c, 1e9, "plain", "progress", "seconds")),
        lambda c: json.dumps(without(c, "plain", "method", "steps")),
    ],
)
def test_a_damaged_checkpoint_json_falls_back_to_the_one_before(
    run: Path, whole: Path, damage: Any
) -> None:
    path = undone(run) / "checkpoint.json"
    path.write_text(damage(json.loads(path.read_text())))
    outcome, warnings = resumed(run)
    assert len(warnings) == 1
    assert str(path.parent) in warnings[0]
    assert "the one before" in warnings[0]
    assert outcome.steps == 900
    assert policy_bytes(run) == policy_bytes(whole)


@pytest.mark.parametrize(
    ("damage", "words"),
    [
        (lambda c: without(c, "plain", "method"), "KeyError: 'method'"),
        (lambda c: without(c, "plain", "method", "steps"), "KeyError: 'steps'"),
        (lambda c: placed(c, 600, "plain", "method", "steps"), "steps are 600 and 900"),
        (lambda c: placed(c, 3, "plain", "progress"), "TypeError"),
        (lambda c: placed(c, "x", "plain", "progress", "best_steps"), "lane-steps is 'x'"),
        (lambda c: placed(c, None, "plain", "progress", "best"), "without its judgement"),
        (lambda c: placed(c, {"cost": 1}, "plain", "progress", "best"), "KeyError"),
        (lambda c: placed(c, [{"cost": "x"}], "plain", "progress", "rows"), "is no number"),
        (lambda c: placed(c, [1], "plain", "progress", "best_of"), "TypeError"),
    ],
)
def test_a_checkpoint_that_does_not_fit_is_an_error_and_stays(
    run: Path, damage: Any, words: str
) -> None:
    # Without a checksum of its own, as checkpoints were written before; another version's too.
    path = undone(run) / "checkpoint.json"
    content = without(damage(json.loads(path.read_text())), "sha256_of_this")
    path.write_text(json.dumps(content))
    with pytest.raises(InputFileError, match=rf"checkpoint\.json does not hold.*{words}.*remove"):
        resumed(run)
    assert path.read_text() == json.dumps(content)


def test_a_checkpoint_without_a_checksum_of_its_own_is_still_read(run: Path, whole: Path) -> None:
    path = undone(run) / "checkpoint.json"
    path.write_text(json.dumps(without(json.loads(path.read_text()), "sha256_of_this")))
    assert resumed(run)[1] == []
    assert policy_bytes(run) == policy_bytes(whole)


def test_a_checkpoint_under_a_name_of_other_steps_falls_back_to_the_one_before(run: Path) -> None:
    newest = undone(run)
    newest.rename(newest.with_name("000000001000"))
    assert "stands after 900 lane-steps" in resumed(run)[1][0]


@pytest.mark.parametrize("key", ["steps", "best_steps", "best"])
def test_a_run_json_that_lacks_how_the_run_ended_is_an_error(run: Path, key: str) -> None:
    path = run / "run.json"
    path.write_text(json.dumps(without(json.loads(path.read_text()), key)))
    with pytest.raises(InputFileError, match=r"run\.json says that the run is done.*--out"):
        resumed(run)
