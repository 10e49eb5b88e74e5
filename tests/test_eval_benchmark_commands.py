"""`railenv benchmark` as it is typed: its answers, its refusals, and its check of a controller."""

import csv
import os
import signal
import subprocess
import sys
import time
from hashlib import sha256
from pathlib import Path
from typing import Any

import psutil
import pytest
from benchmark_commands import Inline, answer, refusal
from benchmark_examples import BROKEN, SUITE, TEXT, cells
from worker_tasks import gone

from eval import command_benchmark
from eval.cli import main
from eval.scenarios import load_suite
from eval.store.digest import digest
from eval.store.reader import Reader
from eval.store.schema import MEASURES
from eval.workers import Limits, LocalPool

# Beside test_eval_benchmark.py and test_eval_store.py, which the default run has.
pytestmark = pytest.mark.slow

TESTS = Path(__file__).parent
KEY = "v0/lateral17/nominal/4/300/german_low/jitter:100/1"
SALT = "sixteen characters or more"


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, Limits]]:
    """Work is done in this process; what was asked of the pools."""
    Inline.made = []
    monkeypatch.setattr(command_benchmark, "LocalPool", Inline)
    return Inline.made


@pytest.fixture(scope="module")
def tiny(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("suite") / "tiny.toml"
    path.write_text(TEXT)
    return str(path)


@pytest.fixture(scope="module")
def done(tiny: str, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The records of a run of the suite."""
    folder = tmp_path_factory.mktemp("done")
    with pytest.MonkeyPatch.context() as patch:
        Inline.made = []
        patch.setattr(command_benchmark, "LocalPool", Inline)
        assert main(["benchmark", "--suite", tiny, "--out", str(folder), "--json"]) == 0
    return folder


def test_the_suite_in_words_is_the_suite_in_fields(tiny: str) -> None:
    assert load_suite(tiny).scenarios == SUITE.scenarios
    assert load_suite(tiny).duration("lateral17") == SUITE.duration("lateral17")


def test_json_is_one_object_with_the_boards(
    tiny: str, done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    found = answer(capsys, "--suite", tiny, "--out", str(done), "--resume")
    assert found["records"] == str(done / "records.sqlite")
    (board,) = found["boards"]
    assert board["layout"] == "4"
    assert [s["controller"] for s in board["standings"]] == ["skyhook:gain=15e3", "passive"]


def test_the_table_names_every_controller_and_the_records(
    tiny: str, done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["benchmark", "--suite", tiny, "--out", str(done), "--resume"]) == 0
    out = capsys.readouterr().out
    assert "skyhook:gain=15e3" in out
    assert f"records: {done / 'records.sqlite'}" in out


def test_a_report_says_what_the_benchmark_said(
    tiny: str, done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["benchmark", "--suite", tiny, "--out", str(done), "--resume"]) == 0
    first = capsys.readouterr().out
    assert main(["report", str(done)]) == 0
    assert capsys.readouterr().out == first


def test_a_cell_alone_is_the_row_of_the_run_bit_for_bit(
    tiny: str, done: Path, made: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    found = answer(capsys, "--suite", tiny, "--cell", KEY)["cells"]
    assert [row["controller"] for row in found] == ["skyhook:gain=15e3"]
    (row,) = cells(done, key=KEY)
    for name in (*MEASURES, "status", "unstable", "seed", "channel"):
        assert found[0][name] == row[name], name
    assert row["ride_index_rear"] > 1.0


def test_a_cell_without_delay_is_shown_of_passive_and_reference_too(
    tiny: str, made: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    key = "v0/lateral17/nominal/4/300/german_low/constant:0/0"
    found = answer(capsys, "--suite", tiny, "--cell", key, "--controller", "zero")["cells"]
    assert [row["controller"] for row in found] == ["passive", "reference", "zero"]


def test_a_cell_of_a_controller_that_fails_says_why(
    tiny: str, made: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    given = ("--controller", f"{BROKEN}Raises", "--controller", "zero")
    found = answer(capsys, "--suite", tiny, "--cell", KEY, *given)["cells"]
    assert [row["status"] for row in found] == ["failed", "ok"]
    assert "gave up" in found[0]["message"]
    assert found[0]["key"] == KEY


def test_a_cell_is_printed_line_by_line(
    tiny: str, made: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["benchmark", "--suite", tiny, "--cell", KEY, "--controller", "zero"]) == 0
    lines = dict(line.split(maxsplit=1) for line in capsys.readouterr().out.split("\n") if line)
    assert lines["key"] == KEY
    assert lines["force_rms"] == "0.0"


def test_a_cell_with_a_private_salt_is_that_of_the_private_track(
    tiny: str,
    made: list[Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    own = ("--suite", tiny, "--controller", "zero", "--private-salt", SALT)
    monkeypatch.setattr("sys.argv", ["railenv", *own])
    answer(capsys, *own, "--out", str(tmp_path))
    (row,) = cells(tmp_path, key=KEY)
    (private,) = answer(capsys, *own, "--cell", KEY)["cells"]
    (public,) = answer(capsys, *own[:4], "--cell", KEY)["cells"]
    assert private["ride_index_rear"] == row["ride_index_rear"] != public["ride_index_rear"]
    with Reader.open(tmp_path) as reader:
        assert reader.settings.salt_commitment == sha256(SALT.encode()).hexdigest()
        (session,) = reader.sessions()
    assert session["command"].endswith("--controller zero --private-salt SALT")
    # How it was called is recorded, and must not give the salt away.
    assert not any(SALT.encode() in p.read_bytes() for p in tmp_path.iterdir() if p.is_file())


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("v0/lateral17/nominal/4/300/german_low/jitter:100/7", "not in suite 'tiny'"),
        ("v1/lateral17/nominal/4/300/german_low/jitter:100/1", "not in suite 'tiny'"),
        ("nominal/4", "eight parts"),
        ("v0/lateral17/nominal/4/300/german_low/wobble:100/1", "wobble"),
    ],
)
def test_a_cell_that_does_not_exist_is_refused(
    tiny: str, capsys: pytest.CaptureFixture[str], key: str, words: str
) -> None:
    assert words in refusal(capsys, "--suite", tiny, "--cell", key)


def test_cells_are_exported_with_every_digit(
    tiny: str, done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "cells.csv"
    answer(capsys, "--suite", tiny, "--out", str(done), "--resume", "--export", str(path))
    with path.open(newline="") as stream:
        rows = list(csv.DictReader(stream))
    recorded = cells(done)
    assert len(rows) == len(recorded) == 9 + 3 + 3
    for row, own in zip(rows, recorded, strict=True):
        assert row["key"] == own["key"]
        assert float(row["ride_index_rear"]) == own["ride_index_rear"]


def test_cells_are_exported_as_parquet(
    tiny: str, done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    parquet = pytest.importorskip("pyarrow.parquet")
    path = tmp_path / "cells.parquet"
    answer(capsys, "--suite", tiny, "--out", str(done), "--resume", "--export", str(path))
    found = parquet.read_table(path).to_pydict()["ride_index_rear"]
    assert found == [row["ride_index_rear"] for row in cells(done)]


def test_records_that_are_there_are_not_overwritten(
    tiny: str, done: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    before = digest(done)
    err = refusal(capsys, "--suite", tiny, "--out", str(done))
    assert "--resume" in err
    assert "--out" in err
    assert digest(done) == before


@pytest.mark.parametrize(
    ("arguments", "name"),
    [
        (("--seconds", "10"), "limits.seconds"),
        (("--memory", "1"), "limits.memory_bytes"),
        (("--private-salt", SALT), "salt_commitment"),
    ],
    ids=" ".join,
)
def test_other_settings_are_not_resumed_with(
    tiny: str,
    done: Path,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    name: str,
) -> None:
    given = ("--suite", tiny, "--out", str(done), "--resume", *arguments)
    assert name in refusal(capsys, *given)


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("Hangs", "timeout: stopped after the time limit of 10 s"),
        ("EatsMemory", "memory: stopped above the memory limit of 1024 MiB"),
        ("Exits", "crashed: the worker process ended itself with exit code 3"),
        ("exits_when_made", "crashed: the worker process ended itself with exit code 4"),
    ],
)
def test_the_check_outlives_what_it_checks(
    tiny: str, capsys: pytest.CaptureFixture[str], name: str, words: str
) -> None:
    limits = ("--seconds", "10", "--memory", "1")
    assert main(["benchmark", "--suite", tiny, "--check", f"{BROKEN}{name}", *limits]) == 1
    assert f"PROBLEM  {words}" in capsys.readouterr().out


def started(*arguments: str) -> "subprocess.Popen[str]":
    """Start the program in a session of its own, in which Ctrl-C is heard."""
    code = (
        "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); "
        "from eval.cli import main; sys.exit(main(sys.argv[1:]))"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code, "benchmark", *arguments],
        env={**os.environ, "PYTHONPATH": f"{TESTS}{os.pathsep}{TESTS.parent}"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def test_ctrl_c_leaves_no_worker_and_a_folder_to_be_resumed(tiny: str, tmp_path: Path) -> None:
    given = ("--suite", tiny, "--out", str(tmp_path), "--jobs", "2")
    own = ("--controller", "skyhook:gain=15e3", "--controller", f"{BROKEN}Hangs")
    process = started(*given, *own, "--seconds", "600")
    deadline = time.monotonic() + 120.0
    # Both workers hang in the end; the other controllers are done by then.
    while time.monotonic() < deadline:
        time.sleep(0.2)
        if (tmp_path / "records.sqlite").exists() and len(cells(tmp_path)) >= 9 + 3 + 3:
            break
    workers = psutil.Process(process.pid).children(recursive=True)
    os.killpg(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=20.0)
    assert process.returncode == 130
    assert err.rstrip().endswith("railenv benchmark: interrupted")
    assert len(workers) >= 2
    assert all(gone(worker.pid) for worker in workers)
    with Reader.open(tmp_path) as reader:
        assert len(reader.done()) == 6
    # That it hangs does not hold for the others: with fewer seconds it would be other settings.
    resumed = main(["benchmark", *given, *own[:2], "--seconds", "600", "--resume", "--json"])
    assert resumed == 0


def test_real_workers_give_the_rows_of_this_process(
    tiny: str, done: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert isinstance(LocalPool(1), LocalPool)
    answer(capsys, "--suite", tiny, "--out", str(tmp_path / "run"), "--jobs", "2")
    assert digest(tmp_path / "run") == digest(done)
    (found,) = answer(capsys, "--suite", tiny, "--cell", KEY)["cells"]
    (row,) = cells(done, key=KEY)
    assert {name: found[name] for name in MEASURES} == {name: row[name] for name in MEASURES}
