"""How `railenv benchmark` and `railenv report` end where a file, a run or a cell is wanting."""

import json
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import pytest
from benchmark_commands import Inline, refusal
from benchmark_examples import TEXT, cells

from eval import command_benchmark
from eval.cells import CellWork
from eval.cli import main
from eval.packages import PASSIVE, REFERENCE
from eval.workers import Outcome

# Beside test_eval_benchmark.py and test_eval_store.py, which the default run has.
pytestmark = pytest.mark.slow

WITHOUT_DELAY = "v0/lateral17/nominal/4/300/german_low/constant:0/0"
WITH_DELAY = "v0/lateral17/nominal/4/300/german_low/jitter:100/1"


@pytest.fixture(autouse=True)
def made(monkeypatch: pytest.MonkeyPatch) -> None:
    """Work is done in this process."""
    Inline.made = []
    monkeypatch.setattr(command_benchmark, "LocalPool", Inline)


@pytest.fixture
def tiny(tmp_path: Path) -> str:
    path = tmp_path / "tiny.toml"
    path.write_text(TEXT)
    return str(path)


@pytest.mark.parametrize("lost", [PASSIVE, REFERENCE])
def test_a_run_whose_yardstick_is_lost_prints_its_boards_and_ends_with_status_one(
    tiny: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    lost: str,
) -> None:
    class Loses(Inline):
        def run(
            self, function: Callable[[Any], Any], tasks: Iterable[Any]
        ) -> Iterator[Outcome[Any]]:
            for outcome in super().run(function, tasks):
                task = outcome.task
                if isinstance(task, CellWork) and task.package.controller == lost:
                    outcome = Outcome(task, "timeout", None, "too slow", 1.0)
                yield outcome

    given = ["benchmark", "--suite", tiny, "--out", str(tmp_path / "run")]
    with monkeypatch.context() as patch:
        patch.setattr(command_benchmark, "LocalPool", Loses)
        assert main([*given, "--json"]) == 1
        out, err = capsys.readouterr()
        (board,) = json.loads(out)["boards"]
        assert board["lost_baselines"] == {f"{lost}: timeout, too slow": 3}
        assert "passive or the reference were lost on 3 tracks" in err
        assert err.count("\n") == 1
    # The records are there, and what was lost is run again.
    assert main(["report", str(tmp_path / "run")]) == 0
    assert main([*given, "--resume"]) == 0
    assert {row["status"] for row in cells(tmp_path / "run", controller=lost)} == {"ok"}


@pytest.mark.parametrize("plain", [[], ["--json"]], ids=["text", "json"])
def test_boards_are_printed_before_a_page_that_cannot_be_written_is_told(
    tiny: str, tmp_path: Path, capsys: pytest.CaptureFixture[str], plain: list[str]
) -> None:
    run = tmp_path / "run"
    given = ["benchmark", "--suite", tiny, "--out", str(run)]
    assert main([*given, "--json"]) == 0
    page = Path(json.loads(capsys.readouterr().out)["page"])
    page.unlink()
    page.mkdir()  # no file can take its place
    table = tmp_path / "cells.csv"
    exported = [*given, "--resume", "--export", str(table)]
    for arguments in (["report", str(run)], exported):
        assert main([*arguments, *plain]) == 1
        out, err = capsys.readouterr()
        assert f"cannot write {page}: " in err
        assert err.count("\n") == 1
        if plain:
            found = json.loads(out)
            assert found["page"] is None
            assert found["boards"][0]["standings"]
        else:
            assert "skyhook:gain=15e3" in out
            assert out.splitlines()[-1].split() == ["page:", "not", "written"]
    assert table.exists()


def test_boards_are_printed_before_a_table_that_cannot_be_written_is_told(
    tiny: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    table = tmp_path / "cells.csv"
    export = command_benchmark.export

    def spoilt(folder: Path, path: Path) -> int:
        path.mkdir()  # after the check, as a disk that fills up in the meantime
        return export(folder, path)

    monkeypatch.setattr(command_benchmark, "export", spoilt)
    given = ["benchmark", "--suite", tiny, "--out", str(tmp_path / "run"), "--export", str(table)]
    assert main(given) == 1
    out, err = capsys.readouterr()
    assert "skyhook:gain=15e3" in out
    assert f"cannot write {table}: " in err


def test_a_cell_that_nobody_given_runs_is_not_said_to_be_in_no_suite(
    tiny: str, capsys: pytest.CaptureFixture[str]
) -> None:
    err = refusal(capsys, "--suite", tiny, "--cell", WITH_DELAY, "--controller", PASSIVE)
    assert "is in suite 'tiny', and no controller given here runs it" in err
    assert "passive, reference: without delay alone" in err
    assert "not in suite" not in err


def test_a_cell_that_passive_runs_is_shown_of_passive_alone_too(
    tiny: str, capsys: pytest.CaptureFixture[str]
) -> None:
    given = ["--suite", tiny, "--cell", WITHOUT_DELAY, "--controller", PASSIVE, "--json"]
    assert main(["benchmark", *given]) == 0
    found = json.loads(capsys.readouterr().out)["cells"]
    assert [row["controller"] for row in found] == [PASSIVE, REFERENCE]
