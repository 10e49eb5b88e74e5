"""`railenv score`: the command, the score in a policy's card, learning curves."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines.policies import History, LinearPolicy, load_trained, save_trained
from baselines.policies.folder import load_card
from eval.cli import main
from eval.command_score import short_names
from eval.policy_evidence import evidence_text
from eval.policy_evidence import main as write_evidence
from eval.policy_score import Depth, score
from eval.policy_score_card import MEASURED, TOLERANCE, recipe_of, reproduced, scored_card
from eval.policy_score_curve import JUDGED, SCORED, learning_curve
from eval.policy_score_references import LQG, PASSIVE, SKYHOOK, YARDSTICK
from eval.policy_score_runs import Trial, comfort_of
from railenv.errors import ArgumentError, InputFileError

TRIAL = Trial(tracks=2, seconds=5.0, skip=2.0, delays=(0.0, 0.1))
DEPTH = Depth(TRIAL, growth_delays=(0.0, 0.05), windows=False, simulated=())
SENSORS = tuple(f"carbody_lateral_velocity_{k}" for k in (1, 2, 3, 4))


def hook(gain: float) -> LinearPolicy:
    """Return the sky-hook as a policy that is told the delay."""
    history = History("4", SENSORS, (1.0,) * 4, action="each", told_knots=(0.0, 0.3))
    return LinearPolicy(history, np.stack([-gain / 3e3 * np.eye(4)] * 2))


@pytest.fixture(autouse=True)
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """Two gains and one designed law: what is tested does not depend on how many there are."""
    monkeypatch.setattr("eval.policy_score_references.SKYHOOK_GAINS", (7.5e3, 15e3))
    monkeypatch.setattr("eval.policy_score_references.DESIGNED", {LQG: "lqg-delay:delay={delay}"})
    for name in ("eval.command_score.QUICK", "eval.policy_score.QUICK"):
        monkeypatch.setattr(name, TRIAL)


def saved(folder: Path, gain: float, seed: int = 0) -> Path:
    training = {"config": {"method": "apg", "seed": seed}, "seed": seed}
    save_trained(hook(gain), folder, {"training": training, "score": {"judge": {"cost": 1.0}}})
    return folder


@pytest.fixture(scope="module")
def answer() -> dict[str, Any]:
    """The score of one policy; what stands beside it does not matter here."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("eval.policy_score_references.SKYHOOK_GAINS", (7.5e3,))
        patch.setattr("eval.policy_score_references.DESIGNED", {})
        return score([("own", hook(8e3), None)], DEPTH)


@pytest.fixture
def kept(answer: dict[str, Any], tmp_path: Path) -> dict[str, Any]:
    """What a card holds of that score, read from the folder `p`."""
    folder = saved(tmp_path / "p", 8e3)
    save_trained(hook(8e3), folder, scored_card(load_card(folder), answer, "own"))
    found: dict[str, Any] = load_card(folder)["score"][MEASURED]
    return found


@pytest.mark.slow
def test_a_score_is_reproduced_from_the_card(tmp_path: Path, kept: dict[str, Any]) -> None:
    again = reproduced("p", load_trained(tmp_path / "p"), kept)
    assert again["reproduced"] is True
    assert again["largest_difference"] <= TOLERANCE


@pytest.mark.slow
def test_what_the_judge_said_stays_in_the_card(tmp_path: Path, kept: dict[str, Any]) -> None:
    assert "trial" in kept
    assert load_card(tmp_path / "p")["score"]["judge"] == {"cost": 1.0}


@pytest.mark.slow
def test_another_policy_does_not_reproduce_a_score(kept: dict[str, Any]) -> None:
    # A ten-thousandth of the gain is far more than the tolerance, and invisible in a table.
    assert reproduced("p", hook(8e3 * 1.0001), kept)["reproduced"] is False


def test_a_growth_rate_that_differs_is_found(kept: dict[str, Any]) -> None:
    kept["stability"]["worst_growth"]["told the delay"] += 1e-3
    again = reproduced("p", hook(8e3), kept)
    assert (again["reproduced"], again["where"]) == (False, "told the delay, growth rate")


@pytest.mark.slow
def test_a_run_that_diverged_then_and_not_now_is_found(kept: dict[str, Any]) -> None:
    kept["rows"]["told the delay"]["diverged"][1] = True
    again = reproduced("p", hook(8e3), kept)
    assert (again["reproduced"], again["largest_difference"]) == (False, None)


@pytest.mark.parametrize(
    ("path", "value", "words"),
    [
        ((), None, "holds no score"),
        (("trial", "tracks"), "two", "tracks"),
        (("trial", "first_track_seed"), 5, "first_track_seed is 5"),
        (("rows", "told the delay", "front"), [1.0], "one number per delay"),
        (("rows", "told the delay", "rear"), ["a", "b"], "could not convert"),
        (("stability",), [], "cannot be read"),
    ],
)
def test_a_score_that_cannot_be_read_is_refused(
    kept: dict[str, Any], path: tuple[str, ...], value: object, words: str
) -> None:
    place: Any = kept
    for key in path[:-1]:
        place = place[key]
    if path:
        place[path[-1]] = value
    with pytest.raises(InputFileError, match=words):
        reproduced("p", hook(8e3), kept if path else {})


def test_recipes_differ_in_more_than_the_seed() -> None:
    config = {"method": "apg", "seed": 1, "steps": 5}
    first = recipe_of({"class": "linear", "training": {"config": config}})
    assert first is not None
    assert first == recipe_of({"class": "linear", "training": {"config": {**config, "seed": 2}}})
    assert first != recipe_of({"class": "linear", "training": {"config": {**config, "steps": 6}}})
    assert recipe_of({"class": "linear"}) is None


@pytest.mark.slow
def test_several_seeds_are_one_table_with_a_row_for_all(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    specs = [str(saved(tmp_path / f"s{k}", 8e3 + 500.0 * k, k)) for k in range(2)]
    assert main(["score", *specs, "--quick", "--json", "--out", str(tmp_path / "out")]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert list(answer["policies"]) == ["s0", "s1", "s0 and 1 more seeds"]
    each = [answer["policies"][name]["told the delay"]["worse"][0] for name in ("s0", "s1")]
    pooled = answer["policies"]["s0 and 1 more seeds"]["told the delay"]["worse"][0]
    assert pooled == pytest.approx(np.mean(each))
    assert answer == json.loads((tmp_path / "out" / "score.json").read_text())


@pytest.mark.slow
def test_a_saved_score_is_checked_by_the_command(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = str(saved(tmp_path / "p", 8e3))
    assert main(["score", spec, "--quick", "--save"]) == 0
    assert "next: railenv score" in capsys.readouterr().out
    assert main(["score", spec, "--check"]) == 0
    assert "score reproduced" in capsys.readouterr().out


def test_a_score_that_is_not_reproduced_ends_with_1(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], kept: dict[str, Any]
) -> None:
    kept["rows"]["told the delay"]["front"][0] += 0.01
    save_trained(hook(8e3), tmp_path / "p", {"score": {MEASURED: kept}})
    assert main(["score", str(tmp_path / "p"), "--check"]) == 1
    assert "NOT reproduced" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("extra", "words"),
    [
        (["skyhook", "--check"], "holds no score"),
        (["skyhook", "--quick", "--save"], "'skyhook' is none"),
        (["skyhook", "--tracks", "0"], "tracks = 0"),
        (["skyhook", "--tracks", "x"], "tracks = 'x'"),
        (["nothing-like-it"], "unknown controller"),
        (["nowhere", "--learning-curve", "c.png"], "learning.csv"),
        (["skyhook", "--learning-curve", "c.txt"], "must end in"),
    ],
)
def test_bad_input_ends_with_2_and_a_way_out(
    extra: list[str],
    words: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["score", *extra]) == 2
    assert words in capsys.readouterr().err


def run_folder(folder: Path, columns: str = "") -> Path:
    """Write the files of a training run of which only the best checkpoint is left."""
    folder.mkdir()
    head = columns or "steps,seconds,stable,ride_index_0ms,ride_index_100ms"
    rows = "10,30.0,0.0,2.5,2.7\n20,60.0,1.0,1.5,1.9\n"
    (folder / "learning.csv").write_text(f"{head}\n{rows}")
    found = {"best sky-hook": {"ride_index": [2.2, 2.4]}, "lqg-delay": {"ride_index": [1.0, 1.2]}}
    (folder / "references.json").write_text(json.dumps(found))
    return folder


def test_a_run_without_its_checkpoints_shows_what_the_judge_said(tmp_path: Path) -> None:
    curve = learning_curve([run_folder(tmp_path / "r")], TRIAL)
    assert curve["kind"] == JUDGED
    assert curve["runs"][0]["index"] == pytest.approx([2.6, 1.7])
    assert curve["runs"][0]["stable"] == [False, True]
    assert curve["lines"] == pytest.approx({SKYHOOK: 2.3, LQG: 1.1})


@pytest.mark.slow
def test_a_run_with_all_checkpoints_is_scored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("eval.policy_score_curve._DRAWN", (PASSIVE, SKYHOOK, LQG))
    folder = run_folder(tmp_path / "r")
    for steps, gain in ((10, 3e3), (20, 8e3)):
        saved(folder / "checkpoints" / f"{steps:012d}" / "policy", gain)
    curve = learning_curve([folder], TRIAL)
    assert curve["kind"] == SCORED
    assert curve["runs"][0]["index"][1] == pytest.approx(comfort_of(hook(8e3), TRIAL).worse.mean())
    assert set(curve["lines"]) == {PASSIVE, SKYHOOK, LQG}


@pytest.mark.slow
@pytest.mark.parametrize("ending", [".png", ".svg"])
def test_a_learning_curve_is_drawn(
    tmp_path: Path, ending: str, capsys: pytest.CaptureFixture[str]
) -> None:
    picture = tmp_path / f"curve{ending}"
    runs = [str(run_folder(tmp_path / name)) for name in ("a", "b")]
    assert main(["score", *runs, "--learning-curve", str(picture)]) == 0
    assert str(picture) in capsys.readouterr().out
    assert picture.stat().st_size > 10_000  # axes, lines and words; an empty picture has 3 kB


@pytest.mark.parametrize(
    ("columns", "words"),
    [
        ("steps,seconds,stable,a,b", "no columns ride_index_"),
        ("steps,seconds,stable,ride_index_xms,b", "no columns ride_index_"),
        ("steps,a,stable,ride_index_0ms,b", "lacks the column seconds"),
    ],
)
def test_a_table_without_its_columns_is_refused(tmp_path: Path, columns: str, words: str) -> None:
    with pytest.raises(InputFileError, match=words):
        learning_curve([run_folder(tmp_path / "r", columns)], TRIAL)


def test_runs_judged_at_other_delays_are_not_drawn_together(tmp_path: Path) -> None:
    other = run_folder(tmp_path / "b", "steps,seconds,stable,ride_index_0ms,ride_index_200ms")
    with pytest.raises(ArgumentError, match="judged at other delays"):
        learning_curve([run_folder(tmp_path / "a"), other], TRIAL)


def test_the_page_names_command_and_revision(answer: dict[str, Any]) -> None:
    about = {"command": "python -m x", "revision": "abc", "seconds": 60.0}
    case = {"title": "here", "hunts": False, "tracks": 1, "delays_s": [0.1], "gains": [7.5e3]}
    case["rows"] = {"own": {"worse": [1.5], "force_rms": [100.0], "diverged": [False]}}
    text = evidence_text(answer, [case], about)
    for words in ("`python -m x` at revision abc in 1 min", "| **own**, told the delay |", "here"):
        assert words in text
    assert "{" not in text


@pytest.mark.slow
def test_the_evidence_is_written_in_a_small_size(tmp_path: Path) -> None:
    spec = str(saved(tmp_path / "p", 8e3))
    page = tmp_path / "table.md"
    write_evidence(["--smoke", "--policy", spec, "--out", str(page)])
    text = page.read_text()
    for words in ("350 km/h", "laden", "worn wheels", "TB/T 3352", "full50", "**p**"):
        assert words in text
    assert YARDSTICK not in text  # the fixture left it out


@pytest.mark.parametrize("spec", [".", "../p", "../p/.", "inner/..", "./"])
def test_a_path_without_a_name_is_called_as_the_folder_that_is_meant(
    spec: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (saved(tmp_path / "p", 8e3) / "inner").mkdir()
    monkeypatch.chdir(tmp_path / "p")
    assert short_names([spec]) == {spec: "p"}


def test_a_run_that_is_the_working_folder_has_its_name_in_the_curve(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(run_folder(tmp_path / "r"))
    assert learning_curve([Path()], TRIAL)["runs"][0]["name"] == "r"
