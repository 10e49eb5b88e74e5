"""The benchmark's report: what page and terminal table show, from small made-up records."""

import html
import re
import subprocess
import sys
import tempfile
from importlib import metadata
from pathlib import Path
from typing import Any

import pytest

from eval.records import provenance, write_records
from eval.report import REPORT_FILE, write_report
from eval.scenarios import load_suite
from eval.summary import WIDTH, summary_table
from railenv.config import to_dict
from railenv.errors import OutputError, RailenvError

SECTIONS = ("answer", "wz", "bogie", "locus", "gain", "table", "reproduce")
HOSTILE = "py:evil<script>alert('x')</script>:make$\\frac{\x1b[31m\ud800"


def where(controller: str, layout: str) -> dict[str, Any]:
    return {"controller": controller, "layout": layout, "speed_kmh": 300.0}


def cell(controller: str, layout: str, delay: float, track: str = "tb3352") -> dict[str, Any]:
    wz = 1.0 + len(controller) / 100 + delay
    return {
        **where(controller, layout),
        "track": track,
        "seed": 1,
        "delay_s": delay,
        "ride_index_front": wz,
        "ride_index_rear": wz + 0.125,
        "bogie_rms": 0.5 + delay,
        "diverged": delay > 0.2,
    }


def exact(controller: str, layout: str, critical: float | None = 0.2021) -> dict[str, Any]:
    first = {"frequency_hz": 1.323, "mode": "upper centre roll"}
    if critical is None:
        first = dict.fromkeys(first)
    crossing = {"delay_s": critical, **first, "direction": "unstable", "unstable_roots_after": 2}
    modes = [
        {"name": "upper centre roll", "re": [-1.0, -2.0, 0.0, 0.6], "im": [6.0, 8.0, 8.0, 7.0]},
        {"name": "bogie1 lateral", "re": [-19.0] * 4, "im": [190.0] * 4},
    ]
    return {
        **where(controller, layout),
        "vehicle": "paper_fit",
        "critical_delay_s": critical,
        "critical_delay_sampled_s": None if critical is None else critical - 0.005,
        "control_period_s": 0.01,
        "max_delay_s": 2.0,
        "method": "exact",
        "proved": False,
        **first,
        "crossings": [] if critical is None else [crossing],
        "stable_windows_s": [[0.0, critical or 2.0]],
        "unstable_roots_without_delay": 0,
        "root_locus": {"delay_s": [0.0, 0.1, 0.2, 0.3], "modes": modes},
    }


def simulated(controller: str, layout: str, critical: float | None) -> dict[str, Any]:
    answer = exact(controller, layout, critical)
    del answer["stable_windows_s"], answer["unstable_roots_without_delay"]
    for crossing in answer["crossings"]:
        del crossing["unstable_roots_after"]
    answer.update(critical_delay_s=None, root_locus=None, method="simulation", bracket_s=None)
    if critical is not None:
        answer["critical_delay_sampled_s"] = critical
        answer["bracket_s"] = [critical - 0.0002, critical + 0.0002]
    return answer


def make_records(
    stability: list[dict[str, Any]], tracks: tuple[str, ...] = ("tb3352",)
) -> dict[str, Any]:
    groups = [(answer["controller"], answer["layout"]) for answer in stability]
    suite = load_suite("smoke")
    return {
        "suite": to_dict(suite),
        "provenance": provenance("railenv benchmark smoke", 1.5),
        "cells": [cell(*g, d, t) for g in groups for t in tracks for d in suite.delays],
        "stability": stability,
        "failures": [],
    }


def smoke() -> dict[str, Any]:
    return make_records([exact("passive", "passive", None), exact("skyhook:gain=35e3", "4")])


def page_of(folder: Path, records: dict[str, Any]) -> str:
    write_records(folder, records)
    return write_report(folder).read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def smoke_page(tmp_path_factory: pytest.TempPathFactory) -> str:
    return page_of(tmp_path_factory.mktemp("smoke"), smoke())


def test_page_holds_all_sections_in_order(smoke_page: str) -> None:
    places = [smoke_page.index(f'id="{name}"') for name in SECTIONS]
    assert places == sorted(places)


def test_page_needs_nothing_from_elsewhere(smoke_page: str) -> None:
    assert re.findall(r"http|<script|@import|\bsrc=", smoke_page) == []
    references = re.findall(r'\bhref="([^"]*)"|url\(([^)]*)\)', smoke_page)
    assert all((a or b).startswith(("#", "data:")) for a, b in references)


def test_ids_are_unique_and_references_meet_one(smoke_page: str) -> None:
    ids = re.findall(r'\bid="([^"]*)"', smoke_page)
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]*)', smoke_page)) <= set(ids)


def test_every_chart_says_what_it_shows_and_keeps_text_as_text(smoke_page: str) -> None:
    charts = re.findall(r'role="img" aria-label="([^"]+)">\s*<svg', smoke_page)
    assert len(charts) == smoke_page.count("<figure>") == 7
    assert ">delay [ms]</text>" in smoke_page


def test_answer_names_the_critical_delay(smoke_page: str) -> None:
    text = re.sub(r"\s+", " ", smoke_page)
    assert "four actuators stand 202 ms of delay (197 ms when commanded every 10 ms)" in text
    assert "exact to rounding, not proved" in text
    assert "Chen, Shi, Yu (published)" in text


def test_published_point_is_absent_for_another_vehicle(tmp_path: Path) -> None:
    records = smoke()
    for answer in records["stability"]:
        answer["vehicle"] = "other"
    assert "Chen, Shi" not in page_of(tmp_path, records)


def test_table_numbers_are_the_records_numbers(smoke_page: str) -> None:
    body = smoke_page[smoke_page.index('id="table"') :]
    rows = [
        [html.unescape(c) for c in re.findall(r"<td[^>]*>(.*?)</td>", row)]
        for row in re.findall(r"<tr[^>]*>(.*?)</tr>", body, flags=re.DOTALL)
    ]
    group = ["skyhook:gain=35e3", "4", "300"]
    assert [*group, "202.1", "197.1", "1.323", "upper centre roll"] in rows
    # Worse end: 1 + 17/100 + delay + 0.125; beyond 200 ms diverged.
    found = next(row for row in rows if row[:3] == group and len(row) == 9)
    shown = [float(text.rstrip("*")) for text in found[3:6]]
    assert shown == pytest.approx([1.295, 1.395, 1.545], abs=0.00501)
    assert found[5].endswith("*")
    assert found[6:] == ["250", "0.50", "0.75"]
    assert ["202.10", "1.3230", "unstable", "upper centre roll", "2"] in rows


def test_page_says_how_to_reproduce_it(smoke_page: str) -> None:
    versions = f"numpy {metadata.version('numpy')}"
    for text in ("railenv benchmark smoke", versions, "cores", "records.json", "1.5 s"):
        assert text in smoke_page
    assert "more than 1 % of the time" in smoke_page


def test_hostile_names_are_escaped(tmp_path: Path) -> None:
    answers = [simulated(HOSTILE, "4", 0.15), exact("skyhook", "2")]
    answers[0]["mode"] = "<b>mode</b>"
    answers[1]["root_locus"]["modes"][0]["name"] = "<script>$\\bad{$</script>"
    records = make_records(answers, tracks=("<img src=x onerror=y>$_$",))
    records["failures"] = [
        {
            "controller": HOSTILE,
            "layout": "2</td>",
            "speed_kmh": 300.0,
            "error": "<script>$</script>",
        }
    ]
    page = page_of(tmp_path, records)
    assert re.findall("<script|<img|<b>mode", page) == []
    assert "&lt;script&gt;alert(" in page
    assert "&lt;img src=x" in page


def test_every_failure_stands_in_page_and_table(tmp_path: Path) -> None:
    records = smoke()
    records["failures"] = [{**where(f"py:mine:{n}", "4"), "error": f"reason {n}"} for n in range(3)]
    page, table = page_of(tmp_path, records), summary_table(records)
    for n in range(3):
        assert f"<code>py:mine:{n}</code>, four actuators, 300 km/h: reason {n}" in page
        assert f"FAILED py:mine:{n}, layout 4, 300 km/h: reason {n}" in table


def test_controller_known_by_simulation_alone_is_marked_as_estimate(tmp_path: Path) -> None:
    records = make_records([simulated("py:mine:make", "4", 0.1504)])
    page = page_of(tmp_path, records)
    assert "four actuators stand about 150 ms of delay (estimated by simulation)" in page
    assert "~150.4" in page
    assert "there is no root locus" in page
    assert "nothing to draw over gain" in page


@pytest.mark.parametrize(
    ("answer", "words"),
    [
        (simulated("py:mine:make", "2", None), "two actuators stay stable up to 2 s"),
        (exact("passive", "passive", None), "no delay can act"),
        (exact("skyhook", "4", None), ">none up to 2 s</text>"),
        ({**exact("skyhook", "4"), "unstable_roots_without_delay": 2}, "without any delay"),
    ],
)
def test_odd_answers_are_put_in_words(tmp_path: Path, answer: dict[str, Any], words: str) -> None:
    assert words in page_of(tmp_path, make_records([answer]))


def test_runs_that_blew_up_are_shown_without_a_number(tmp_path: Path) -> None:
    records = smoke()
    blown = records["cells"][-1]
    blown.update(ride_index_front=None, ride_index_rear=None, bogie_rms=None, diverged=True)
    page = page_of(tmp_path, records)
    assert "because the run blew up: 1." in page
    assert "beyond any number at 250 ms" in page
    assert "nan" not in re.sub(r"<svg.*?</svg>", "", page, flags=re.DOTALL).lower()


def test_records_without_any_run_still_make_a_page(tmp_path: Path) -> None:
    records = {**smoke(), "cells": [], "stability": []}
    page = page_of(tmp_path, records)
    assert all(f'id="{name}"' in page for name in SECTIONS)
    assert summary_table(records)


def test_seeds_are_averaged_and_one_diverged_seed_counts() -> None:
    records = make_records([exact("skyhook", "4")])
    second = [{**c, "seed": 2} for c in records["cells"]]
    second[0].update(ride_index_front=3.0, ride_index_rear=3.0, diverged=True)
    records["cells"] += second
    # Rear of seed 1: 1 + 7/100 + 0.125 = 1.195; mean with 3 is 2.0975.
    assert "2.10*" in summary_table(records)


def test_terminal_table_is_narrow_and_has_no_control_characters() -> None:
    records = make_records(
        [exact("skyhook", "4"), simulated(HOSTILE + 80 * "long", "4", None)],
        tracks=("a", "b\x1b[2J"),
    )
    table = summary_table(records)
    assert max(len(line) for line in table.splitlines()) <= WIDTH
    assert all(line.isprintable() for line in table.splitlines())
    assert table.count("skyhook ") == 3


def test_page_is_replaced_as_a_whole_or_not_at_all(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    write_records(tmp_path, {**smoke(), "cells": [], "stability": []})
    old = tmp_path / REPORT_FILE
    old.write_text("old", encoding="utf-8")

    def refuse(*_: object, **__: object) -> None:
        raise PermissionError(13, "Permission denied")

    # Permissions do not stop the superuser, so the folder's refusal is played.
    monkeypatch.setattr(tempfile, "mkstemp", refuse)
    with pytest.raises(OutputError, match="Permission denied"):
        write_report(tmp_path)
    assert old.read_text(encoding="utf-8") == "old"
    assert sorted(p.name for p in tmp_path.iterdir()) == ["records.json", REPORT_FILE]


@pytest.mark.parametrize("package", ["matplotlib", "jinja2"])
def test_missing_package_is_answered_by_the_extra_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, package: str
) -> None:
    write_records(tmp_path, smoke())
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(RailenvError, match=r'pip install "railenv\[report\]"') as caught:
        write_report(tmp_path)
    assert "\n" not in str(caught.value)
    assert package in str(caught.value)


def test_drawing_changes_no_global_setting(tmp_path: Path) -> None:
    import matplotlib as mpl

    with mpl.rc_context({"font.size": 3.0}):
        before = dict(mpl.rcParams)
        page_of(tmp_path, make_records([exact("skyhook", "4")]))
        assert dict(mpl.rcParams) == before


def test_importing_the_report_loads_no_drawing_package() -> None:
    code = "import sys, eval.report; print({'matplotlib', 'jinja2', 'numba'} & set(sys.modules))"
    command = [sys.executable, "-c", code]
    found = subprocess.run(command, capture_output=True, text=True, check=True).stdout
    assert found.strip() == "set()"
