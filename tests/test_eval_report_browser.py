"""The benchmark's page in headless Chromium: nothing is asked for, nothing complains, all fits."""

from pathlib import Path

import pytest
from browser import Page, program
from report_examples import add_motion, many, motion, passive_motion, write
from report_pages import HOOK, LAW, RUN, usual

from eval.report import write_report
from eval.scoring.board import boards_of
from eval.store.reader import Reader

pytestmark = [
    pytest.mark.slow,
    pytest.mark.browser,
    pytest.mark.skipif(program() is None, reason="no Chromium on this machine"),
]

ROWS = "Array.from(document.querySelectorAll('#board-4 .leaderboard tbody tr'))"
NAMES = f"{ROWS}.map((row) => row.cells[0].querySelector('a')?.textContent ?? 'passive')"


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    with Reader.open(many(tmp_path_factory.mktemp("many"))) as reader:
        return write_report(reader, boards_of(reader, None))


INSIDE = (
    "Array.from(document.querySelectorAll('.chart svg')).every((svg) => {"
    " const all = svg.getBoundingClientRect();"
    " return Array.from(svg.querySelectorAll('text')).every((text) => {"
    "  const box = text.getBoundingClientRect();"
    "  return box.left >= all.left - 1 && box.right <= all.right + 1"
    "   && box.top >= all.top - 1 && box.bottom <= all.bottom + 1; }); })"
)
"""Whether texts stay inside their chart: nothing is cut off at its edge."""


@pytest.fixture(scope="module")
def cards(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A page whose two controllers have time histories and roots."""
    folder = write(tmp_path_factory.mktemp("cards"), usual(), RUN)
    found = {HOOK: motion(), LAW: motion(0.5), "passive": passive_motion()}
    with Reader.open(add_motion(folder, found)) as reader:
        return write_report(reader, boards_of(reader, None))


@pytest.mark.parametrize("width", [390, 1400])
def test_nothing_is_asked_for_and_nothing_complains(path: Path, tmp_path: Path, width: int) -> None:
    with Page(tmp_path, width) as page:
        page.open(path)
        assert page.complaints() == []
        # The page itself and its empty icon, which is in it.
        assert {url for url in page.requests() if not url.startswith("data:")} == {path.as_uri()}
        assert page.evaluate("document.documentElement.classList.contains('ready')")
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        sizes = page.evaluate(
            "Array.from(document.querySelectorAll('.chart svg')).map((s) => s.clientHeight)"
        )
        assert len(sizes) == 6
        assert min(sizes) > 150
        assert page.evaluate(INSIDE)


@pytest.mark.parametrize("width", [390, 1400])
def test_time_histories_and_loci_are_drawn_on_open_cards(
    cards: Path, tmp_path: Path, width: int
) -> None:
    with Page(tmp_path, width) as page:
        page.open(cards)
        page.evaluate("document.querySelectorAll('details.card').forEach((d) => { d.open = true })")
        assert page.complaints() == []
        assert {url for url in page.requests() if not url.startswith("data:")} == {cards.as_uri()}
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        sizes = page.evaluate(
            "Array.from(document.querySelectorAll('.card .chart svg')).map((s) => s.clientHeight)"
        )
        assert len(sizes) == 4
        assert min(sizes) > 200
        assert page.evaluate(INSIDE)
        # Three of each controller's strips have the passive vehicle's signal behind.
        heights = page.evaluate(
            "Array.from(document.querySelectorAll('.card .was')).map((u) => u.getBBox().height)"
        )
        assert len(heights) == 6
        # From -50 to 3000 steps on 25 px that reach to 4000; a tenth of a pixel is kept.
        assert heights == pytest.approx([25.0 * 3050 / 4000] * 6, abs=0.11)


def test_table_sorts_and_passive_stays_last(path: Path, tmp_path: Path) -> None:
    with Page(tmp_path, 1400) as page:
        page.open(path)
        before = page.evaluate(NAMES)
        page.evaluate("document.querySelector('#board-4 .leaderboard thead button').click()")
        assert page.evaluate(NAMES) == before  # ranked already
        page.evaluate("document.querySelector('#board-4 .leaderboard thead button').click()")
        assert page.evaluate(NAMES) == [*before[-2::-1], "passive"]
        page.evaluate("document.querySelectorAll('#board-4 .leaderboard thead button')[4].click()")
        delays = page.evaluate(f"{ROWS}.slice(0, -1).map((row) => Number(row.cells[4].dataset.v))")
        assert delays == sorted(delays)
        assert page.evaluate("document.querySelectorAll('[aria-sort]').length") == 1


def test_division_and_controller_are_picked(path: Path, tmp_path: Path) -> None:
    with Page(tmp_path, 1400) as page:
        page.open(path)
        page.evaluate(
            "(() => { const choice = document.getElementById('division'); choice.value = 'told';"
            " choice.dispatchEvent(new Event('change')); })()"
        )
        shown = page.evaluate(f"{ROWS}.filter((row) => !row.hidden).map((r) => r.dataset.division)")
        assert set(shown[:-1]) == {"told"}
        page.evaluate(
            "(() => { const choice = document.getElementById('pick'); choice.value = '3';"
            " choice.dispatchEvent(new Event('change')); })()"
        )
        picked = page.evaluate(
            "Array.from(document.querySelectorAll('.picked')).map((e) => e.dataset.c)"
        )
        assert set(picked) == {"3"}
        # A row, a card, lines and marks on both layouts.
        assert len(picked) >= 10


def test_a_link_opens_its_card(path: Path, tmp_path: Path) -> None:
    with Page(tmp_path, 390) as page:
        page.open(path)
        page.evaluate("document.querySelector('#board-4 .leaderboard a').click()")
        page.evaluate("new Promise((done) => setTimeout(done, 100))")
        assert page.evaluate("document.getElementById('card-4-1').open")
