"""The page of the leaderboard: of finished records alone, with every number that the board has."""

import re
import shlex
from pathlib import Path

import pytest
from benchmark_examples import block, run, suite_of
from leaderboard_examples import SALTS, SUITE, keep

from eval.benchmark import Benchmark
from eval.entries import entries_of
from eval.leaderboard import code, leaderboard_text, main, prose
from eval.scoring.board import boards_of
from eval.scoring.finished import check_finished
from eval.scoring.statistics import Resampling
from eval.store.digest import digest
from eval.store.reader import Reader
from eval.workers import Limits
from railenv.errors import ArgumentError

FEW = Resampling(draws=200)
COMMAND = "python -m eval.leaderboard runs/standard"


def flat(index: float):
    return lambda s: index + 0.01 * s.seed


def table_rows(text: str) -> list[list[str]]:
    """Cells of all rows of all tables without the heads; a bar that is escaped is none."""
    rows = [line for line in text.splitlines() if line.startswith("| ")]
    cells = [[c.strip() for c in re.split(r"(?<!\\)\|", line)[1:-1]] for line in rows]
    return [own for own in cells if own[0] not in ("rank", "---")]


def test_the_page_shows_the_boards_own_numbers_best_first_by_division(tmp_path: Path) -> None:
    laws = {"zero": flat(2.0), "lqg": flat(1.4), "skyhook": flat(1.8), "lqg-delay": flat(1.3)}
    folder = keep(tmp_path, laws, told=("lqg-delay",))
    text = leaderboard_text(folder, COMMAND, FEW)
    rows = table_rows(text)
    assert [own[:2] for own in rows] == [
        ["1", "`lqg-delay`"],
        ["1", "`lqg`"],
        ["2", "`skyhook`"],
        ["3", "`zero`"],
    ]
    with Reader.open(folder) as reader:
        (board,) = boards_of(reader, FEW)
    for own, standing in zip(rows, board.standings, strict=True):
        assert standing.score is not None
        score = standing.score.score
        assert own[2] == f"{score.estimate:.3f}"
        assert own[3] == f"{score.low:.2f} to {score.high:.2f}"
        assert own[4] == f"{standing.score.aggregates.interquartile_mean.estimate:.2f}"
        assert own[6] == "200 p"
        assert own[-1].endswith(f"at `{standing.score.worst.key}`")
    assert text.index("### Told the delay") < text.index("### Not told the delay")


def test_the_page_says_where_it_comes_from_and_how_to_make_it_again(tmp_path: Path) -> None:
    folder = keep(tmp_path, {"zero": flat(2.0)})
    text = leaderboard_text(folder, COMMAND, FEW)
    assert f"Written by `{COMMAND}`" in text
    assert f"`{digest(folder)}`" in text
    assert f"`standard` v0, {len(SUITE.scenarios)} cells" in text
    assert "Test tracks: the public ones" in text
    assert "numpy" in text
    assert "cores, revision" in text
    # The suite's own controllers need no names.
    assert "    railenv benchmark --suite standard --out runs/standard\n" in text
    with Reader.open(folder) as reader:
        assert reader.sessions()[0]["started"] in text


def test_other_controllers_and_a_private_salt_are_in_the_command(tmp_path: Path) -> None:
    folder = keep(tmp_path, {"py:mine:it's": flat(2.0)}, salt=SALTS[1])
    text = leaderboard_text(folder, COMMAND, FEW)
    (line,) = [own for own in text.splitlines() if own.startswith("    railenv")]
    words = shlex.split(line)
    assert words[words.index("--controller") + 1] == "py:mine:it's"
    assert words[words.index("--private-salt") + 1] == "SALT"
    with Reader.open(folder) as reader:
        assert f"`{reader.settings.salt_commitment}`" in text
    assert SALTS[1] not in text


def test_the_same_records_give_the_same_page(tmp_path: Path) -> None:
    folder = keep(tmp_path, {"zero": flat(2.0), "lqg": flat(1.4)})
    assert leaderboard_text(folder, COMMAND, FEW) == leaderboard_text(folder, COMMAND, FEW)


def test_another_suite_than_standard_is_said_to_be_no_leaderboard(tmp_path: Path) -> None:
    whole = leaderboard_text(keep(tmp_path / "a", {"zero": flat(2.0)}), COMMAND, FEW)
    other = suite_of(block(seeds=2))
    tiny = leaderboard_text(keep(tmp_path / "b", {"zero": flat(2.0)}, other), COMMAND, FEW)
    assert "the suite is `" not in whole
    assert "**Not for publication**: the suite is `tiny`" in tiny


def test_who_lacks_runs_has_no_rank_and_reasons_stand_below_the_table(tmp_path: Path) -> None:
    suite = suite_of(block(seeds=2), block(models=("full50",), seeds=2))
    laws = {
        "semi": flat(1.2),
        "lame": lambda s: "failed" if s.seed else 1.9,
    }
    folder = keep(tmp_path, laws, suite, only=lambda spec, s: (spec, s.model) != ("semi", "full50"))
    text = leaderboard_text(folder, COMMAND, FEW)
    assert [own[:2] for own in table_rows(text)] == [["1", "`lame`"], ["-", "`semi`"]]
    assert "- `semi`: no result in 2 runs that others are scored by" in text
    assert "- `lame`: it raised" in text


def test_conditions_of_one_track_are_counted_beside_the_intervals(tmp_path: Path) -> None:
    suite = suite_of(block(seeds=2), block(speeds_kmh=(200.0,)))
    text = leaderboard_text(keep(tmp_path, {"zero": flat(2.0)}, suite), COMMAND, FEW)
    assert "A condition has one scored track, of which intervals hold nothing." in text


@pytest.mark.parametrize(
    ("only", "words"),
    [
        (lambda spec, s: not (spec == "lqg" and s.channel.delay_ms == 300.0), "lqg lacks 14 runs"),
        (lambda spec, _: spec != "lqg", "lqg lacks 40 runs"),
        (lambda spec, s: spec != "passive" or s.seed, "passive lacks 2 runs"),
        (lambda spec, _: spec != "reference", "reference lacks 8 runs"),
    ],
)
def test_records_that_are_not_finished_are_refused(tmp_path: Path, only, words: str) -> None:
    folder = keep(tmp_path, {"zero": flat(2.0), "lqg": flat(1.4)}, only=only)
    with pytest.raises(ArgumentError, match="not finished") as error:
        leaderboard_text(folder, COMMAND, FEW)
    assert words in str(error.value)
    assert "--resume" in str(error.value)


def test_records_without_answers_on_stability_are_refused(tmp_path: Path) -> None:
    folder = keep(tmp_path, {"zero": flat(2.0)}, answered=False)
    with pytest.raises(ArgumentError, match="zero lacks an answer on its stability"):
        leaderboard_text(folder, COMMAND, FEW)


def test_a_layout_that_was_not_reached_is_missed_through_its_answer(tmp_path: Path) -> None:
    suite = suite_of(block(layouts=("4", "2"), seeds=2))
    folder = keep(
        tmp_path, {"zero": flat(2.0)}, suite, only=lambda spec, s: spec != "zero" or s.layout == "4"
    )
    with pytest.raises(ArgumentError, match="zero lacks 2 runs"):
        leaderboard_text(folder, COMMAND, FEW)


@pytest.mark.slow
def test_a_run_that_has_ended_is_finished_whatever_a_law_can_act_on(tmp_path: Path) -> None:
    suite = suite_of(block(layouts=("4", "2"), seeds=2))
    specs = ("semiactive-onoff", "apg-linear", "zero")
    whole = Benchmark(suite, tuple(entries_of(specs)), Limits(60.0, 2**31))
    folder = run(tmp_path, whole)
    with Reader.open(folder) as reader:
        check_finished(reader)


def test_a_folder_without_records_is_an_argument_error(tmp_path: Path) -> None:
    for folder in (tmp_path, tmp_path / "nowhere"):
        with pytest.raises(ArgumentError, match="give the folder of a benchmark"):
            leaderboard_text(folder, COMMAND)


def test_records_of_nobody_are_refused(tmp_path: Path) -> None:
    with pytest.raises(ArgumentError, match="holds no controller"):
        leaderboard_text(keep(tmp_path, {}), COMMAND)


def test_the_program_writes_the_page_or_leaves_what_was_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = keep(tmp_path / "run", {"zero": flat(2.0)})
    page = tmp_path / "docs" / "leaderboard.md"
    main([str(folder), "--out", str(page)])
    first = page.read_text()
    assert first.startswith("# Leaderboard\n")
    with pytest.raises(SystemExit) as done:
        main([str(tmp_path), "--out", str(page)])
    assert done.value.code == 2
    assert "give the folder of a benchmark" in capsys.readouterr().err
    assert page.read_text() == first


@pytest.mark.parametrize(
    ("text", "shown"),
    [
        ("lqg", "`lqg`"),
        ("a|b", "`a\\|b`"),
        ("a`b", "`` a`b ``"),
        ("``", "``` `` ```"),
        ("a\nb\x1b", "`a b?`"),
    ],
)
def test_a_name_stays_in_its_cell(text: str, shown: str) -> None:
    assert code(text) == shown


def test_a_message_is_no_markup() -> None:
    assert prose("<script>*a*|`b`") == r"&lt;script&gt;\*a\*\|\`b\`"
