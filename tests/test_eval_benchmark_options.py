"""Options of `railenv benchmark`: refused, handed on, a salt's file, a check's answer."""

import json
import os
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest
from benchmark_commands import Inline, refusal
from benchmark_examples import BROKEN, TEXT

from eval import command_benchmark
from eval.benchmark import Benchmark
from eval.cli import main
from eval.workers import Limits

SALT = "sixteen characters or more"
KEY = "v0/lateral17/nominal/4/300/german_low/jitter:100/1"


@pytest.fixture
def made(monkeypatch: pytest.MonkeyPatch) -> list[tuple[int, Limits]]:
    """Work is done in this process; what was asked of the pools."""
    Inline.made = []
    monkeypatch.setattr(command_benchmark, "LocalPool", Inline)
    return Inline.made


@pytest.fixture
def tiny(tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("suite") / "tiny.toml"
    path.write_text(TEXT)
    return str(path)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--suite", "quik"), "quick"),
        (("--suite", "missing.toml"), "missing.toml"),
        (("--jobs", "0"), "jobs"),
        (("--jobs", "two"), "jobs"),
        (("--seconds", "0"), "seconds"),
        (("--seconds", "nan"), "seconds"),
        (("--memory", "-1"), "memory"),
        (("--memory", "inf"), "memory"),
        (("--memory", "1e300"), "more than any machine has"),
        (("--memory", "1e-300"), "memory"),
        (("--controller", "skyhok"), "skyhook"),
        (("--controller", "reference"), "leave it out"),
        (("--controller", "lqg-delay:delai={delay}"), "delai"),
        (("--controller", "py:no_such_module:Law"), "no_such_module"),
        (("--controller", "py:../mine:law"), "must be py:module:function, the module by its name"),
        (("--private-salt", "short"), "salt"),
        (("--export", "cells.txt"), "cells.txt"),
        (("--resume",), "does not exist"),
    ],
    ids=" ".join,
)
def test_a_bad_argument_is_refused_in_one_line_before_the_work(
    tiny: str,
    made: list[Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: tuple[str, ...],
    words: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    given = arguments if "--suite" in arguments else ("--suite", tiny, *arguments)
    assert words in refusal(capsys, *given, "--out", "run")
    assert list(tmp_path.iterdir()) == []


def handed_on(monkeypatch: pytest.MonkeyPatch, *arguments: str) -> Benchmark:
    """What `railenv benchmark` asks for; the run itself is left out."""
    asked: list[Benchmark] = []
    monkeypatch.setattr(command_benchmark, "run_benchmark", lambda b, *_: asked.append(b))
    monkeypatch.setattr(command_benchmark, "_show", lambda *_: [])
    assert main(["benchmark", *arguments]) == 0
    return asked[0]


def test_arguments_are_handed_on(
    tiny: str, made: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    given = ("--jobs", "3", "--seconds", "12", "--memory", "1.5", "--private-salt", SALT)
    own = ("--controller", "zero", "--controller", "skyhook", "--controller", "zero")
    out = ("--suite", tiny, "--out", str(tmp_path / "run"))
    benchmark = handed_on(monkeypatch, *out, *given, *own)
    assert [e.spec for e in benchmark.entries] == ["zero", "skyhook"]
    assert benchmark.salt == SALT
    assert benchmark.limits == Limits(12.0, 3 * 2**29)
    assert made[-1] == (3, benchmark.limits)


def test_without_arguments_the_suites_controllers_run_on_every_core_into_a_folder_of_its_name(
    tiny: str, made: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    benchmark = handed_on(monkeypatch, "--suite", tiny)
    assert [e.spec for e in benchmark.entries] == ["skyhook:gain=15e3"]
    assert made[-1][0] == os.cpu_count()
    assert (tmp_path / "runs" / "tiny" / "records.sqlite").exists()


@pytest.mark.parametrize(
    ("mode", "other"),
    [
        *((("--cell", KEY), other) for other in (("--out", "run"), ("--resume",))),
        (("--cell", KEY), ("--export", "cells.csv")),
        *(
            (("--check", "zero"), other)
            for other in (
                ("--controller", "zero"),
                ("--jobs", "2"),
                ("--ray", "auto"),
                ("--out", ""),
                ("--resume",),
                ("--private-salt", SALT),
                ("--export", "cells.csv"),
                ("--cell", KEY),
            )
        ),
        *(
            (("--template", "mine.py"), other)
            for other in (("--suite", "quick"), ("--seconds", "300"), ("--check", "zero"))
        ),
    ],
    ids=lambda words: " ".join(words[:1]),
)
def test_what_would_be_ignored_is_refused_with_both_names(
    made: list[Any],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    mode: tuple[str, ...],
    other: tuple[str, ...],
) -> None:
    monkeypatch.chdir(tmp_path)
    err = refusal(capsys, *mode, *other)
    assert f"{other[0]} says nothing beside {mode[0]}, " in err
    assert (made, list(tmp_path.iterdir())) == ([], [])


@pytest.mark.parametrize("ending", ["", "\n", "\r\n"])
def test_a_salt_may_come_from_the_line_of_a_file(
    tiny: str, made: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, ending: str
) -> None:
    path = tmp_path / "salt"
    path.write_bytes((SALT + " \u00e4" + ending).encode())
    given = ("--suite", tiny, "--out", str(tmp_path / "run"), "--private-salt", f"@{path}")
    assert handed_on(monkeypatch, *given).salt == SALT + " \u00e4"


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "No such file"),
        (b"", "must hold one line"),
        (b"\n", "must hold one line"),
        (b"sixteen characters\nor more", "must hold one line"),
        (b"\xff\xfe sixteen characters", "no text in UTF-8"),
        (b"short\n", "salt"),
    ],
    ids=str,
)
def test_a_file_that_holds_no_salt_is_refused_rather_than_the_public_tracks_run(
    tiny: str,
    made: list[Any],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    content: bytes | None,
    words: str,
) -> None:
    path = tmp_path / "salt"
    if content is not None:
        path.write_bytes(content)
    run = ("--suite", tiny, "--out", str(tmp_path / "run"))
    assert words in refusal(capsys, *run, "--private-salt", f"@{path}")
    assert not (tmp_path / "run").exists()


def test_an_empty_salt_is_refused(
    tiny: str, made: list[Any], capsys: pytest.CaptureFixture[str]
) -> None:
    # As of "$SALT" where the variable is not set.
    assert "one line" in refusal(capsys, "--suite", tiny, "--private-salt", "")


def test_the_template_is_written_and_how_to_go_on_is_said(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    module = ModuleType("eval.controller_template")

    def write_template(path: Path) -> Path:
        path.write_text("controller = None")
        return path

    module.write_template = write_template  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "eval.controller_template", module)
    monkeypatch.chdir(tmp_path)
    assert main(["benchmark", "--template", "mine.py"]) == 0
    assert capsys.readouterr().out.splitlines() == [
        "template: mine.py",
        "next:",
        "  railenv benchmark --check py:mine:controller",
        "  railenv benchmark --controller py:mine:controller",
    ]
    (tmp_path / "a b").mkdir()
    assert main(["benchmark", "--template", "a b/mine.py"]) == 0
    assert f"  cd '{tmp_path / 'a b'}'" in capsys.readouterr().out.splitlines()
    assert main(["benchmark", "--template", "mine.py", "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found == {"template": "mine.py", "controller": "py:mine:controller"}


def test_ray_takes_the_place_of_local_workers(
    tiny: str, made: list[Any], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[tuple[Any, ...]] = []

    class Far(Inline):
        def __init__(self, address: str, limits: Limits, jobs: int | None, owner: object) -> None:
            asked.append((address, limits, jobs))

    monkeypatch.setattr(command_benchmark, "RayPool", Far)
    limits = [
        handed_on(
            monkeypatch,
            *("--suite", tiny, "--out", str(tmp_path / str(number)), "--ray", "head:6379", *jobs),
        ).limits
        for number, jobs in enumerate(((), ("--jobs", "7")))
    ]
    assert asked == [("head:6379", limits[0], None), ("head:6379", limits[1], 7)]
    # The controllers themselves are looked at here.
    assert [jobs for jobs, _ in made] == [1, 1]


def test_workers_are_shared_by_all_but_controllers_of_a_users_own() -> None:
    assert command_benchmark._owner_of_spec("skyhook:gain=1") is None
    assert command_benchmark._owner_of_spec("py:mine:law") == "py:mine:law"


def test_the_check_exits_with_status_one_if_something_is_wrong(
    made: list[Any], tiny: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["benchmark", "--suite", tiny, "--check", f"{BROKEN}Newtons"]) == 1
    out, err = capsys.readouterr()
    assert "PROBLEM  layout 4: force: " in out
    assert "not fit for the benchmark" in err
    assert made[0][0] == 1


def test_the_check_exits_with_status_zero_if_nothing_is(
    made: list[Any], tiny: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["benchmark", "--suite", tiny, "--check", f"{BROKEN}Law"]) == 0
    out, err = capsys.readouterr()
    assert "ok       layout 4: repeatable: " in out
    assert err == ""


def test_the_check_prints_one_object(
    made: list[Any], tiny: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["benchmark", "--suite", tiny, "--check", f"{BROKEN}Nan", "--json"]) == 1
    found = json.loads(capsys.readouterr().out)
    assert found["controller"] == f"{BROKEN}Nan"
    assert {"name": "layout 4: runs", "good": False}.items() <= found["findings"][-1].items()
