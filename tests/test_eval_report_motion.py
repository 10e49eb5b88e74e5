"""Time histories and root loci on the page: drawn as they are on record, or why they are not."""

import copy
import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from report_examples import add_motion, many, motion, passive_motion, write
from report_pages import HOOK, LAW, RUN, Parsed, page_of, usual

from eval.benchmark_motion import ACCELERATION_STEP
from eval.report.locus import locus_chart, locus_sentence, rightmost
from eval.report.motion import history_chart, passive_signals, scale_of
from eval.report.svg import Chart


def page_with(folder: Path, found: dict[str, dict[str, Any]]) -> Parsed:
    return Parsed(page_of(add_motion(write(folder, usual(), RUN), found))[0])


def extent(path: str) -> tuple[float, float]:
    """The smallest and the largest y of a path of an M and steps."""
    numbers = [[float(v) for v in part.split()] for part in re.split("[Mlz]", path) if part]
    y = np.cumsum([pair[1] for pair in numbers])
    return float(y.min()), float(y.max())


def test_every_card_with_motion_has_both_charts_with_words(tmp_path: Path) -> None:
    parsed = page_with(tmp_path, {HOOK: motion(), LAW: motion(0.5), "passive": passive_motion()})
    titles = [text for attributes, text in parsed.all("title") if "id" in attributes]
    histories = [text for text in titles if text.startswith("Time histories")]
    loci = [text for text in titles if text.startswith("Roots of the continuous loop")]
    assert len(histories) == len(loci) == 2
    # Rear, the worse end: peaks of 2000, 4000 and 8000 steps, root mean square by the example.
    assert "0.100 at 0 ms (rear), 0.200 at 100 ms (rear), 0.400 at 300 ms (rear)" in histories[0]
    assert "the passive vehicle 0.150 (rear)" in histories[0]
    axes = [text for _, text in parsed.all("text")]
    for words in ("acceleration [m/s\N{SUPERSCRIPT TWO}]", "force [kN]", "time [s]"):
        assert axes.count(words) == 2
    assert axes.count("real part [1/s]") == axes.count("frequency [Hz]") == 2


def test_a_page_of_records_without_motion_says_so_once(tmp_path: Path) -> None:
    parsed = Parsed(page_of(write(tmp_path, usual(), RUN))[0])
    assert parsed.text.count("The records have no time histories and no roots") == 1
    assert "--resume adds them" in parsed.text
    assert parsed.all("svg", **{"class": "unseen"}) == []


def test_controllers_without_motion_are_counted(tmp_path: Path) -> None:
    parsed = page_with(tmp_path, {HOOK: motion(), "passive": passive_motion()})
    assert "1 of 2 controllers have no time histories" in parsed.text


def test_why_a_picture_is_missing_is_said_as_text(tmp_path: Path) -> None:
    nonlinear = motion() | {"roots": {"none": "the law is not linear"}}
    parsed = page_with(tmp_path, {HOOK: {"error": "<script>it hung</script>"}, LAW: nonlinear})
    assert "No time histories and no roots: <script>it hung</script>." in parsed.text
    assert "No root locus: the law is not linear." in parsed.text
    assert len(parsed.all("script")) == 1


def test_histories_meet_the_scales_edge_where_the_signal_does() -> None:
    passive = passive_motion(peak=4000)
    scale = scale_of("4", passive, [])
    # 0.4 m/s^2 with room of a quarter.
    assert scale.reach == 0.5
    strip = 50.0
    (_, rear) = re.findall(r' d="([^"]*)"', passive_signals(scale, passive))
    low, high = extent(rear)
    # A tenth of a pixel is kept; the signal goes from -50 to 4000 steps.
    assert low == pytest.approx(-0.5 * strip * 4000 * ACCELERATION_STEP / scale.reach, abs=0.11)
    assert high == pytest.approx(0.5 * strip * 50 * ACCELERATION_STEP / scale.reach, abs=0.11)


def test_what_leaves_the_scale_is_said_and_cut_off() -> None:
    answer = motion(peak=2000)
    drawn = history_chart("x", answer, scale_of("4", passive_motion(peak=3000), []))
    # Rear peaks of 0.2, 0.4 and 0.8 at a scale of 0.4; forces of 0.5, 1 and 2 kN at one of 2 kN.
    assert drawn.count("(leaves the scale)") == 1
    assert drawn.count("clip-path=") == 6


def test_a_run_that_blew_up_is_drawn_as_far_as_it_went() -> None:
    answer = motion()
    rear = answer["runs"][2]["rear"]
    rear["rms"] = None
    rear["low"][30:] = rear["high"][30:] = [None] * 20
    drawn = history_chart("x", answer, scale_of("4", None, [answer]))
    assert "rear end: blown up" in drawn
    assert "nan" not in drawn.lower()
    assert drawn.count("None") == 0


@pytest.mark.parametrize(
    ("slope", "words"),
    [
        (1.05, "one crosses to growth between 190 and 200 ms (1.0 Hz)."),
        (0.5, "all are left of the axis at every delay shown"),
        (-0.5, "all are left of the axis"),
    ],
)
def test_the_locus_says_where_it_crosses(slope: float, words: str) -> None:
    assert words in locus_sentence(motion(slope)["roots"])


def test_the_locus_says_what_grows_without_delay_and_when_it_is_back() -> None:
    roots = copy.deepcopy(motion(-1.05)["roots"])
    for root in roots["branches"][0]["roots"]:
        root[0] += 3.0
    words = locus_sentence(roots)
    assert "one grows at 0 ms with 1.00 1/s at 1.0 Hz; the last one is back between 90 and" in words
    for root in roots["branches"][0]["roots"]:
        root[0] += 10.0
    assert "at every delay shown one grows" in locus_sentence(roots)
    assert "beyond 8 1/s are not drawn" in locus_sentence(roots)


def test_the_rightmost_root_is_found_at_every_delay() -> None:
    steps = rightmost(motion()["roots"])
    assert [step.delay for step in steps] == [k / 100.0 for k in range(31)]
    assert [steps[0].real, steps[-1].real] == pytest.approx([-2.0, 1.0])
    assert {round(step.hertz, 5) for step in steps} == {1.0}


def test_a_locus_has_a_mark_for_every_hundred_milliseconds() -> None:
    drawn = locus_chart("x", motion()["roots"], passive_motion()["roots"])
    for k, times in enumerate((1, 1, 2, 1)):
        # One in the legend; at 200 ms there is another root.
        assert drawn.count(f'class="at{k}"') == times + 1
    assert drawn.count("was-root") == 1 + 1


@pytest.mark.slow
def test_a_page_of_many_controllers_with_motion_stays_light(tmp_path: Path) -> None:
    many(tmp_path, 30)
    page, _ = page_of(tmp_path, None)
    before = len(page)
    specs = set(
        re.findall(r'class="rank-number">\d+\.</span> <a [^>]*>([^<]*(?:<wbr>[^<]*)*)', page)
    )
    names = [spec.replace("<wbr>", "") for spec in specs]
    assert len(names) == 30
    wave = np.random.Generator(np.random.PCG64(2))
    for layout in ("4", "2"):
        found = {name: motion() for name in names}
        for answer in found.values():
            for run in answer["runs"]:
                for signal in (run["front"], run["rear"], run["force"]):
                    # As rough as can be, and of full length.
                    signal["low"] = [int(v) for v in wave.integers(-4000, 0, 250)]
                    signal["high"] = [int(v) for v in wave.integers(0, 4000, 250)]
        add_motion(tmp_path, {**found, "passive": passive_motion()}, layout)
    page, _ = page_of(tmp_path, None)
    # Thirty controllers on two layouts: sixty cards.
    assert before < 1_500_000
    assert len(page) < 4_000_000
    ids = [a["id"] for _, a, _ in Parsed(page).elements if "id" in a]
    assert len(ids) == len(set(ids))
    assert set(re.findall(r'(?:href="#|url\(#)([^")]+)', page)) <= set(ids)


def test_long_numbers_beside_an_axis_have_room() -> None:
    short, long = (Chart("x", "", "", "", (0.0, 1.0), ends) for ends in ((0.0, 1.0), (-0.3, 1.08)))
    # Seven and a half pixels for each of the characters of minus 0.25, and the axis' own words.
    assert short.left == 56.0
    assert long.left - 6.0 - 5 * 7.5 >= 13.0 + 4.0
