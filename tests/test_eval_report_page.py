"""The benchmark's page: it needs nothing, says what the boards say, and bears hostile records."""

import argparse
import json
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest
from report_examples import cell_of, exact, many, scenarios, simple, write
from report_pages import HOOK, LAW, RUN, Parsed, page_of, usual

from eval import command_benchmark
from eval.cli import main
from eval.report import REPORT_FILE
from eval.scenarios import Channel, Scenario
from eval.scoring.board import Board
from eval.store.settings import RunSettings
from railenv.errors import OutputError, RailenvError

HOSTILE = "py:evil<script>alert('x')</script>\"onload=x:{{ 7*7 }}\x1b[31m\u202e"


def made(
    folder: Path, controllers: dict[str, Any] | None = None, **more: Any
) -> tuple[str, Parsed]:
    page, _ = page_of(write(folder, controllers or usual(), RUN, **more))
    return page, Parsed(page)


@pytest.fixture(scope="module")
def usual_page(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, list[Board]]:
    return page_of(write(tmp_path_factory.mktemp("usual"), usual(), RUN))


@pytest.fixture(scope="module")
def many_page(tmp_path_factory: pytest.TempPathFactory) -> str:
    return page_of(many(tmp_path_factory.mktemp("many")), None)[0]


def test_page_needs_nothing_from_elsewhere(many_page: str) -> None:
    assert re.findall(r"https?:|//[a-z]|@import|\bsrc=", many_page.replace(" // ", "")) == []
    references = re.findall(r'\bhref="([^"]*)"|url\(([^)]*)\)', many_page)
    assert all((a or b).startswith(("#", "data:")) for a, b in references)
    assert "default-src 'none'" in many_page


def test_ids_are_unique_and_references_meet_one(many_page: str) -> None:
    ids = [a["id"] for _, a, _ in Parsed(many_page).elements if "id" in a]
    assert len(ids) == len(set(ids))
    wanted = re.findall(r'(?:href="#|url\(#|aria-labelledby=")([^")]+)', many_page)
    assert wanted
    assert set(wanted) <= set(ids)


def test_every_drawing_says_what_it_is_or_is_hidden(many_page: str) -> None:
    parsed = Parsed(many_page)
    drawings = parsed.all("svg")
    titled = [a for a, _ in drawings if a.get("role") == "img"]
    assert len(titled) == 6
    assert all(a.get("aria-hidden") == "true" for a, _ in drawings if a.get("role") != "img")
    for attributes in titled:
        assert parsed.all("title", id=attributes["aria-labelledby"])[0][1]
    regions = parsed.all("div", role="region")
    assert all(a["aria-label"] and a["tabindex"] == "0" for a, _ in regions)


def test_many_controllers_stay_readable(many_page: str) -> None:
    parsed = Parsed(many_page)
    assert len(many_page) < 1_500_000
    assert len(parsed.all("details", **{"class": "card"})) == 60
    coloured = re.findall(r'class="line k(\d)" data-c="(\d+)"', many_page)
    assert {colour for colour, _ in coloured} == set("012345")
    # One controller has one colour, wherever it stands.
    assert len({place for _, place in coloured}) == len(set(coloured))


def test_hostile_names_and_messages_stay_text(tmp_path: Path) -> None:
    lost = [
        cell_of(s, None, status="failed", message="</pre><script>x()</script>\ud800", measures={})
        for s in RUN
    ]
    hostile = exact(180.0, mode="<img src=x onerror=y>")
    controllers = {
        HOSTILE: ("untold", lost, {"error": "<b>no</b>"}),
        HOSTILE + "2": ("told", simple(RUN, 0.5, 250.0), hostile),
        **usual(),
    }
    settings = RunSettings("<i>suite</i>", "v0", {"name": "</pre><i>"}, {"<i>": "<i>"}, "ab" * 32)
    page, parsed = made(tmp_path, controllers, settings=settings)
    assert len(parsed.all("script")) == 1
    assert {name for name, _, _ in parsed.elements} & {"img", "b", "i"} <= {"b"}
    assert all(text[:1].isdigit() or text[:1] == "\N{MINUS SIGN}" for _, text in parsed.all("b"))
    assert not any(key.startswith("on") for _, a, _ in parsed.elements for key in a)
    assert "&lt;script&gt;alert(" in page
    assert "{{ 7*7 }}" in page
    assert not re.search("[\x00-\x08\x0b-\x1f\u202e]", page)


def test_records_of_failures_alone_make_a_page(tmp_path: Path) -> None:
    lost = [cell_of(s, None, status="timeout", message="it hung", measures={}) for s in RUN]
    _, parsed = made(tmp_path, {LAW: ("untold", lost, {"error": "it hung"})})
    assert f"{len(RUN)} timeout: it hung" in parsed.text
    assert "Best" in parsed.text
    assert "\N{MINUS SIGN}1.00" in parsed.text


def test_missing_stability_is_said(tmp_path: Path) -> None:
    controllers = {HOOK: ("untold", simple(RUN, 0.5, 250.0), None)}
    _, parsed = made(tmp_path, controllers)
    assert f"1. {HOOK} (no critical delay is known)" in parsed.text


@pytest.mark.parametrize("layout", ["2", "4"])
def test_one_layout_alone_makes_one_board(tmp_path: Path, layout: str) -> None:
    run = scenarios((layout,), seeds=1)
    page, boards = page_of(
        write(tmp_path, {HOOK: ("untold", simple(run, 0.5, 250.0), exact(250.0))}, run)
    )
    assert len(boards) == 1
    assert re.findall(r'<section id="board-(\d)"', page) == [layout]
    assert "nan" not in Parsed(page).text.lower()


@pytest.mark.parametrize("controllers", [{}, {HOOK: ("untold", [], None)}])
def test_a_run_that_has_hardly_begun_makes_a_page(
    tmp_path: Path, controllers: dict[str, Any]
) -> None:
    page, _ = page_of(write(tmp_path / "begun", controllers, RUN, ended=False))
    text = Parsed(page).text
    assert "it was stopped, or is still running" in text
    page, _ = page_of(write(tmp_path / "nothing", controllers, []))
    assert "There is no run on record." in Parsed(page).text


def test_page_tells_how_to_reproduce_it_and_keeps_the_salt(tmp_path: Path) -> None:
    settings = RunSettings("made-up", "v0", {"name": "made-up"}, {"seconds": 1.0}, "cd" * 32)
    page, parsed = made(tmp_path, settings=settings)
    assert "very secret" not in page
    assert "cd" * 32 in parsed.text
    assert "railenv benchmark --suite made-up.toml --private-salt SALT --jobs 1" in parsed.text
    for words in ("numpy ", "revision ", "cores", "version v0"):
        assert words in parsed.text
    commands = [text for _, text in parsed.all("code") if "--cell v0" in text]
    assert len(commands) == 2
    words = shlex.split(commands[0])
    assert words[words.index("--controller") + 1] in (HOOK, LAW)
    key = words[words.index("--cell") + 1]
    assert Scenario.of(key) in RUN
    assert Scenario.of(key).channel == Channel("constant", 300.0)


def test_page_is_replaced_as_a_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, usual(), RUN)
    old = tmp_path / REPORT_FILE
    old.write_text("old", encoding="utf-8")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    # Permissions do not stop the superuser, so the folder's refusal is played.
    monkeypatch.setattr(tempfile, "mkstemp", refuse)
    with pytest.raises(OutputError, match="Permission denied"):
        page_of(tmp_path)
    assert old.read_text(encoding="utf-8") == "old"


def test_same_records_give_the_same_page(tmp_path: Path) -> None:
    folder = write(tmp_path, usual(), RUN)
    assert page_of(folder)[0] == page_of(folder)[0]


def test_missing_package_is_answered_by_the_extra_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, usual(), RUN)
    monkeypatch.setattr("importlib.util.find_spec", lambda _: None)
    with pytest.raises(RailenvError, match=r'jinja2.*pip install "railenv\[report\]"'):
        page_of(tmp_path)


def test_importing_the_report_loads_no_template_package() -> None:
    code = "import sys, eval.report; print({'matplotlib', 'jinja2'} & set(sys.modules))"
    command = [sys.executable, "-c", code]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert found.strip() == "set()"


def test_the_command_writes_the_page_and_names_it(tmp_path: Path, capsys) -> None:
    write(tmp_path, usual(), RUN)
    assert main(["report", str(tmp_path), "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    page = Path(answer["page"])
    assert page == tmp_path / REPORT_FILE
    first = page.read_text(encoding="utf-8")
    assert main(["report", str(tmp_path)]) == 0
    assert str(page) in capsys.readouterr().out
    assert page.read_text(encoding="utf-8") == first


def test_want_of_a_package_does_not_spoil_a_run(
    tmp_path: Path, capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    write(tmp_path, usual(), RUN)
    monkeypatch.setattr(command_benchmark, "missing_for_report", lambda: "jinja2")
    options = argparse.Namespace(json=False, export=None)
    command_benchmark._show(options, tmp_path)
    assert 'jinja2 is not installed; pip install "railenv[report]"' in capsys.readouterr().out
    assert not (tmp_path / REPORT_FILE).exists()
