"""The numbers on the benchmark's page are those of boards and records."""

import math
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_examples import cell_of, exact, scenarios, simple, write
from report_pages import HOOK, RUN, Parsed, page_of, usual

from eval.report.charts import _front
from eval.report.svg import ticks
from eval.report.tables import gain_style
from eval.report.words import NONE, critical_ms, critical_words, number
from eval.scoring.board import Board
from eval.scoring.gain import track_scores
from eval.scoring.statistics import performance_profile

# Beside test_eval_benchmark.py and test_eval_store.py, which the default run has.
pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def usual_page(tmp_path_factory: pytest.TempPathFactory) -> tuple[str, list[Board]]:
    return page_of(write(tmp_path_factory.mktemp("usual"), usual(), RUN))


def test_leaderboard_is_the_boards(usual_page: tuple[str, list[Board]]) -> None:
    page, (board,) = usual_page
    table = page[page.index('<table class="sortable leaderboard">') :]
    rows = re.findall(r"<tr data-c.*?</tr>", table[: table.index("</table>")], flags=re.DOTALL)
    assert len(rows) == len(board.standings) == 2
    for row, standing in zip(rows, board.standings, strict=True):
        score = standing.score
        assert score is not None
        found = re.findall(r'<td class="number" data-v="([^"]*)"', row)
        better = standing.improvement
        assert found == [
            repr(score.score.estimate),
            repr(score.aggregates.interquartile_mean.estimate),
            "" if better is None else repr(better.estimate),
            repr(250.0) if standing.controller == HOOK else "1e9",
            repr(score.worst.gain),
            str(standing.diverged),
            repr(standing.force_rms / 1000.0) if standing.force_rms else "",
            repr(1000.0 * (standing.stroke_peak or 0.0)),
        ]
        ends = f"{score.score.low:.2f} to {score.score.high:.2f}".replace("-", "\N{MINUS SIGN}")
        assert f">{ends}</span>" in row


def test_marks_stand_where_the_ride_indices_are(usual_page: tuple[str, list[Board]]) -> None:
    page, (board,) = usual_page
    chart = page[page.index('labelledby="wz-4-title"') :]
    chart = chart[: chart.index("</svg>")]
    # Both axes are linear: the pixel follows from two ticks of each.
    across = re.findall(r'"tick middle" x="([\d.]+)" y="[\d.]+">(\d+)<', chart)
    up = re.findall(r'"tick end" x="[\d.]+" y="([\d.]+)">([\d.]+)<', chart)
    x_of, y_of = (
        np.polyfit(*np.array([[float(v), float(p)] for p, v in t]).T, 1) for t in (across, up)
    )
    drawn = re.findall(
        r'class="mark k\d" data-c="(\d)" transform="translate\(([\d.]+) ([\d.]+)\)', chart
    )
    names = sorted(s.controller for s in board.standings)
    expected = [
        (str(names.index(s.controller)), np.polyval(x_of, 1000.0 * delay),
         np.polyval(y_of, index) - 4.0)  # a tick's word stands 4 px below its line
        for s in board.standings for delay, index in s.ride_index.items() if index is not None
    ]  # fmt: skip
    assert len(drawn) == len(expected) == 7
    found = sorted((place, float(x), float(y)) for place, x, y in drawn)
    for mark, place in zip(found, sorted(expected), strict=True):
        assert mark[0] == place[0]
        assert mark[1:] == pytest.approx(place[1:], abs=0.15)  # tenths of pixels are written
    # At 300 ms the sky-hook has diverged: an open triangle over the axes says of how many runs.
    assert "2 of 2 runs diverged or were lost at 300 ms" in chart


def test_gains_by_speed_and_delay_follow_the_closed_form(
    usual_page: tuple[str, list[Board]],
) -> None:
    # Wz = 2 - 0.8 (1 - (d/900)^2) + 0.02 seed at 300 km/h; passive 2, reference 1, seeds 0 and 1.
    expected = [0.8 * (1.0 - (d / 900.0) ** 2) - 0.01 for d in (0.0, 100.0, 200.0, 300.0)]
    page = usual_page[0]
    table = page[page.index("Gain by speed and delay") :]
    row = table[table.index("300 km/h</th>") :]
    found = [float(v) for v in re.findall(r'data-v="([^"]*)"', row[: row.index("</tr>")])]
    assert found == pytest.approx(expected, abs=1e-12)  # rounding of a handful of operations


def test_what_is_not_scored_is_listed_with_its_reason(tmp_path: Path) -> None:
    worn = scenarios(more=[{"vehicle": "worn"}])
    cells = simple(worn, 0.5, 250.0)
    folder = write(tmp_path, {HOOK: ("untold", cells, exact(250.0))}, RUN)
    page, _ = page_of(folder)
    count = sum(s.vehicle == "worn" for s in worn)
    assert f"{count} of {len(worn)} runs" in Parsed(page).text
    hopeless = [cell_of(s, None) for s in worn if s.vehicle == "worn" and not s.channel.delay]
    both = {"passive": ("untold", hopeless, None), HOOK: ("untold", cells, exact(250.0))}
    page, _ = page_of(write(tmp_path / "worn", both, worn))
    words = "linear, worn, 300 km/h, german_low: the passive vehicle diverges"
    assert words in Parsed(page).text


def test_safety_is_shown_where_the_nonlinear_vehicle_was_run(tmp_path: Path) -> None:
    run = scenarios(more=[{"model": "full50"}])
    page, _ = page_of(
        write(tmp_path, {HOOK: ("untold", simple(run, 0.5, 250.0), exact(250.0))}, run)
    )
    text = Parsed(page).text
    assert "Y/Q [1]" in text
    assert "nonlinear, nominal, 300 km/h, german_low, constant" in text


@pytest.mark.parametrize("gain", np.linspace(-1.0, 1.0, 41))
def test_colour_of_a_gain_can_be_read_and_says_its_sign(gain: float) -> None:
    paper, ink = re.fullmatch(
        r"background:#(\w{6});color:#(\w{3})", gain_style(float(gain))
    ).groups()

    def luminance(rgb: str) -> float:
        parts = [int(rgb[k : k + 2], 16) / 255.0 for k in (0, 2, 4)]
        linear = [p / 12.92 if p <= 0.04045 else ((p + 0.055) / 1.055) ** 2.4 for p in parts]
        return float(np.dot([0.2126, 0.7152, 0.0722], linear))

    light, dark = sorted((luminance(paper), luminance(2 * ink)), reverse=True)
    assert (light + 0.05) / (dark + 0.05) >= 4.5  # WCAG 2, level AA
    red, blue = int(paper[:2], 16), int(paper[4:], 16)
    assert np.sign(blue - red) == np.sign(round(float(gain), 9))


@pytest.mark.parametrize(
    ("answer", "words", "delay"),
    [
        (exact(290.4), ("290 ms", "proved"), 290.4),
        (exact(290.4, proved=False), ("290 ms", "by eigenvalues"), 290.4),
        (exact(None), ("> 2000 ms", "exact"), math.inf),
        (exact(None, longest_s=None), (NONE, "no actuator"), None),
        (exact(0.0, unstable_roots_without_delay=2), ("0 ms", "unstable without delay"), 0.0),
        (
            {"method": "simulation", "critical_delay_s": 0.1504, "longest_s": 0.6},
            ("150 ms", "by simulation"),
            150.4,
        ),
        (
            {"method": "sampled", "critical_delay_s": None, "longest_s": 0.6},
            ("> 600 ms", "by eigenvalues"),
            math.inf,
        ),
        ({"error": "it hung"}, (NONE, "it hung"), None),
        ({}, (NONE, "not known"), None),
    ],
)
def test_critical_delay_is_said_with_its_evidence(
    answer: dict[str, Any], words: tuple[str, str], delay: float | None
) -> None:
    assert critical_words(answer) == words
    assert critical_ms(answer) == (None if delay is None else pytest.approx(delay))


def test_ticks_are_round_numbers_inside_the_range() -> None:
    assert ticks(0.0, 300.0) == [0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0]
    assert ticks(-1.0, 1.0, 6) == [-1.0, -0.5, 0.0, 0.5, 1.0]
    for low, high in np.random.Generator(np.random.PCG64(3)).normal(size=(200, 2)):
        ends = min(low, high), max(low, high)
        found = ticks(*ends)
        assert 2 <= len(found) <= 8
        assert ends[0] - 1e-9 <= found[0] < found[-1] <= ends[1] + 1e-9


def test_front_is_what_nobody_beats_in_both() -> None:
    points = [(1.0, 1.0), (2.0, 0.5), (1.5, 0.4), (3.0, 0.1), (0.5, 1.0)]
    corners = _front(points)[::2]
    assert corners == [(3.0, 0.1), (2.0, 0.5), (1.0, 1.0)]


def test_number_has_a_minus_sign_and_no_minus_zero() -> None:
    assert number(-0.25) == "\N{MINUS SIGN}0.25"
    assert number(-0.001) == "0.00"
    assert number(math.nan) == number(None) == NONE


def test_profiles_draw_a_track_in_all_its_conditions_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    # A second condition, which has one track of its own.
    run = [*scenarios(seeds=3), *scenarios(more=[{"track": "tb3352"}], seeds=1)]
    run = list(dict.fromkeys(run))
    asked: list[Any] = []

    def profile(scores: Any, thresholds: Any, resampling: Any, **more: Any) -> Any:
        asked.append((scores, resampling, more["tracks"]))
        return performance_profile(scores, thresholds, resampling, **more)

    monkeypatch.setattr("eval.report.charts.performance_profile", profile)
    page, (board,) = page_of(
        write(tmp_path, {HOOK: ("untold", simple(run, 0.5, 250.0), None)}, run)
    )
    (((scores, resampling, tracks)),) = asked
    score = board.standings[0].score
    assert score is not None
    conditions = track_scores(score.gains).values()
    assert tracks == [list(each) for each in conditions]
    assert scores == [list(each.values()) for each in conditions]
    # One condition without a spread of its own takes the band from nobody.
    assert 1 in map(len, tracks)
    assert resampling is not None
    assert '<path class="band' in page[page.index("Performance profiles") :]
