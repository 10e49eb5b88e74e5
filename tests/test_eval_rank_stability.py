"""Orders on disjoint tracks: planted orders are found, planted reversals are told from noise."""

import math
from pathlib import Path

import numpy as np
import pytest
from benchmark_examples import block, suite_of
from leaderboard_examples import SALTS, SUITE, Law, keep

from eval.rank_stability import main, stability_text
from eval.scoring.order import FEWEST_TRACKS, SeedSet, compared
from eval.scoring.statistics import Resampling
from eval.seed_sets import seed_sets
from railenv.errors import ArgumentError

pytestmark = pytest.mark.slow

FEW = Resampling(draws=500)
WIDE = suite_of(block(channels=("constant", "jitter"), delays_ms=(0.0, 300.0), seeds=6))
COMMAND = "python -m eval.rank_stability"


def steps(*order: str, noise: float = 0.0, salt: str = "") -> dict[str, Law]:
    """Laws a tenth of a gain apart, the first the best, with noise of their own per track."""

    def law(rank: int, spec: str) -> Law:
        def index(s):
            seed = [s.seed, *spec.encode(), *salt.encode()]
            return 1.3 + 0.1 * rank + noise * float(np.random.default_rng(seed).normal())

        return index

    return {spec: law(rank, spec) for rank, spec in enumerate(order)}


def three(tmp_path: Path, *orders: tuple[str, ...], noise: float = 0.0, **more) -> list[Path]:
    """Records of three salts with an order each."""
    return [
        keep(tmp_path / f"run{k}", steps(*order, noise=noise, salt=salt), salt=salt, **more)
        for k, (order, salt) in enumerate(zip(orders, SALTS, strict=True), 1)
    ]


def only(folders: list[Path], split: int | None = None):
    """The comparison of the one layout and division."""
    (sets,) = seed_sets(folders, split).values()
    return compared(sets, FEW)


ORDER = ("a", "b", "c", "d")


def test_one_order_in_all_sets_agrees_wholly_and_swaps_nothing(tmp_path: Path) -> None:
    found = only(three(tmp_path, ORDER, ORDER, ORDER, noise=0.01))
    for k in range(3):
        assert found.ranks(k) == {"a": 1.0, "b": 2.0, "c": 3.0, "d": 4.0}
    assert found.agreement(0, 2) == (1.0, 1.0)
    assert len(found.pairs) == 6
    assert not any(pair.swaps for pair in found.pairs)
    assert all(all(pair.separated) for pair in found.pairs)


def test_scores_are_those_of_the_benchmark(tmp_path: Path) -> None:
    found = only(three(tmp_path, ORDER, ORDER, ORDER))
    # Passive at 2.2 and the reference at 1.2: gains 0.9, 0.8, 0.7 and 0.6 at every delay.
    for k in range(3):
        assert [found.score(k, s) for s in ORDER] == pytest.approx([0.9, 0.8, 0.7, 0.6], abs=1e-13)


def test_agreement_is_kendalls_and_spearmans_of_the_ranks(tmp_path: Path) -> None:
    found = only(three(tmp_path, ORDER, ("b", "a", "c", "d"), ORDER[::-1]))
    # One of six pairs turned: tau = (5 - 1) / 6; rho = 1 - 6 * 2 / (4 * 15).
    assert found.agreement(0, 1) == pytest.approx((4 / 6, 0.8), abs=1e-12)
    assert found.agreement(0, 2) == pytest.approx((-1.0, -1.0), abs=1e-12)


def test_a_pair_that_is_reversed_for_certain_contradicts(tmp_path: Path) -> None:
    folders = three(tmp_path, ORDER, ("b", "a", "c", "d"), ORDER, noise=0.005, suite=WIDE)
    found = only(folders)
    (pair,) = [pair for pair in found.pairs if pair.swaps]
    assert {pair.first, pair.second} == {"a", "b"}
    assert pair.signs == [1, -1, 1]
    assert pair.separated == [True, True, True]
    assert pair.contradicts
    # Two of three sets have it one way: a third of the step is left.
    assert pair.together.estimate == pytest.approx(0.1 / 3, abs=0.01)


def test_a_pair_that_is_alike_may_swap_and_contradicts_nothing(tmp_path: Path) -> None:
    folders = []
    for k, salt in enumerate(SALTS):
        # Equal but for what tracks do, which is ten times the difference by set.
        laws = {
            "a": lambda s: 1.7 + 0.1 * (-1) ** s.seed,
            "b": lambda s, k=k: 1.7 + 0.01 * (-1) ** k,
        }
        folders.append(keep(tmp_path / str(k), laws, WIDE, salt))
    found = only(folders)
    (pair,) = found.pairs
    assert pair.swaps
    assert pair.drawn == [True] * 3
    assert pair.separated == [False] * 3
    assert not pair.contradicts
    text = stability_text(folders, None, COMMAND, FEW)
    assert "Of 1 pairs of controllers 0 stand in one order in all sets and 1 swap." in text
    assert "0 are separated in a set; of these 0 stand the other way round" in text


def test_pairs_are_compared_on_the_same_tracks(tmp_path: Path) -> None:
    # Tracks differ by far more than the controllers, which differ alike on every one.
    laws = {
        "a": lambda s: 1.5 + 0.1 * s.seed,
        "b": lambda s: 1.52 + 0.1 * s.seed,
    }
    folders = [keep(tmp_path / f"{k}", laws, WIDE, salt) for k, salt in enumerate(SALTS)]
    (pair,) = only(folders).pairs
    for difference in (*pair.differences, pair.together):
        ends = (difference.low, difference.estimate, difference.high)
        assert ends == pytest.approx((0.02, 0.02, 0.02), abs=1e-12)
    assert pair.separated == [True] * 3


def test_of_few_tracks_no_interval_is_drawn(tmp_path: Path) -> None:
    assert 2.0 ** (1 - FEWEST_TRACKS) < 0.05 < 2.0 ** (2 - FEWEST_TRACKS)
    small = suite_of(block(seeds=FEWEST_TRACKS - 1))
    folders = [
        keep(tmp_path / f"{k}", steps("a", "b"), small, salt) for k, salt in enumerate(SALTS)
    ]
    (pair,) = only(folders).pairs
    assert pair.drawn == [False] * 3
    assert pair.separated == [False] * 3
    assert pair.differences[0].estimate == pytest.approx(0.1, abs=1e-12)
    # There are fifteen tracks together.
    assert not math.isnan(pair.together.low)
    assert "Some sets have too few tracks" in stability_text(folders, None, COMMAND, FEW)


def test_one_run_is_dealt_by_track_number_so_that_no_track_is_in_two_sets(tmp_path: Path) -> None:
    folder = keep(tmp_path, steps(*ORDER))
    (sets,) = seed_sets([folder], 3).values()
    assert [sorted(n for _, n in each.tracks) for each in sets] == [[0, 3], [1, 4], [2, 5]]
    for each in sets:
        numbers = {n for own in each.scores.values() for t in own.values() for n in t}
        assert numbers == {n for _, n in each.tracks}
    found = compared(sets, FEW)
    # The condition with two tracks has none in the third set.
    assert [condition[3] for condition in found.left_out] == ["200"]
    assert found.ranks(2) == {"a": 1.0, "b": 2.0, "c": 3.0, "d": 4.0}
    text = stability_text([folder], 3, COMMAND, FEW)
    assert "conditions left out for want of a scored track in a set: 1" in text


def test_sets_that_share_a_track_are_refused(tmp_path: Path) -> None:
    for salt in SALTS[:2]:
        folders = [keep(tmp_path / f"{len(salt)}{k}", steps("a", "b"), salt=salt) for k in (1, 2)]
        with pytest.raises(ArgumentError, match="share track 0") as error:
            seed_sets(folders)
        assert ("the public salt" in str(error.value)) is (salt == "")
        assert salt == "" or salt not in str(error.value)


def test_the_public_tracks_and_those_of_two_salts_are_disjoint(tmp_path: Path) -> None:
    folders = three(tmp_path, ORDER, ORDER, ORDER)
    (sets,) = seed_sets(folders).values()
    assert len(frozenset.union(*(each.tracks for each in sets))) == 3 * 6


@pytest.mark.parametrize(
    ("number", "split", "words"),
    [
        (1, None, "one folder holds one set of tracks"),
        (2, 3, "give one folder alone"),
        (1, 1, "split = 1 is too small"),
        (1, 7, "leaves a set without tracks"),
    ],
)
def test_sets_that_are_none_are_refused(
    tmp_path: Path, number: int, split: int | None, words: str
) -> None:
    folders = three(tmp_path, ORDER, ORDER, ORDER)[:number]
    with pytest.raises(ArgumentError, match=words):
        seed_sets(folders, split)


def test_runs_of_other_suites_and_unfinished_ones_are_refused(tmp_path: Path) -> None:
    one = keep(tmp_path / "one", steps("a", "b"))
    other = keep(tmp_path / "other", steps("a", "b"), WIDE, SALTS[1])
    with pytest.raises(ArgumentError, match="another suite than"):
        seed_sets([one, other])
    cut = keep(
        tmp_path / "cut", steps("a", "b"), salt=SALTS[1], only=lambda c, s: c != "b" or s.seed < 4
    )
    with pytest.raises(ArgumentError, match="not finished"):
        seed_sets([one, cut])
    with pytest.raises(ArgumentError, match="give the folder of a benchmark"):
        seed_sets([one, tmp_path])


def test_divisions_and_layouts_are_compared_by_themselves(tmp_path: Path) -> None:
    suite = suite_of(block(layouts=("2", "4"), seeds=6))
    folders = [
        keep(tmp_path / f"{k}", steps(*ORDER), suite, salt, told=("a", "b"))
        for k, salt in enumerate(SALTS)
    ]
    groups = seed_sets(folders)
    assert {group: [*sets[0].scores] for group, sets in groups.items()} == {
        ("2", "told"): ["a", "b"],
        ("2", "untold"): ["c", "d"],
        ("4", "told"): ["a", "b"],
        ("4", "untold"): ["c", "d"],
    }
    text = stability_text(folders, None, COMMAND, FEW)
    titles = [line for line in text.splitlines() if line.startswith("## ")]
    assert titles == [
        "## Four actuators, told the delay",
        "## Four actuators, not told the delay",
        "## Two actuators, told the delay",
        "## Two actuators, not told the delay",
    ]


def test_who_lacks_conditions_has_no_rank_and_is_compared_on_common_ones(tmp_path: Path) -> None:
    suite = suite_of(block(seeds=6), block(models=("full50",), seeds=6))
    folders = [
        keep(
            tmp_path / f"{k}",
            # Worse than b where both run, and the better score for want of the other condition.
            {
                "b": lambda s: 1.5 if s.model == "lateral17" else 2.1,
                "semi": lambda _: 1.6,
            },
            suite,
            salt,
            only=lambda spec, s: (spec, s.model) != ("semi", "full50"),
        )
        for k, salt in enumerate(SALTS)
    ]
    found = only(folders)
    assert (found.whole, found.lacking) == (("b",), ("semi",))
    (pair,) = found.pairs
    assert (pair.first, pair.second) == ("b", "semi")
    assert pair.differences[0].estimate == pytest.approx(0.1, abs=1e-12)
    text = stability_text(folders, None, COMMAND, FEW)
    assert "| `semi` | - (0.600) | - (0.600) | - (0.600) |" in text
    assert "too few controllers, or all alike" in text


def test_who_is_not_in_every_set_is_not_compared() -> None:
    place = ("lateral17",)
    scores = {"a": {place: {0: 0.1}}, "b": {place: {0: 0.2}}}
    one = SeedSet("one", scores, frozenset({("", 0)}))
    other = SeedSet("other", {"a": {place: {1: 0.3}}}, frozenset({("", 1)}))
    assert compared([one, other], FEW).whole == ("a",)


def test_the_program_writes_the_page_or_leaves_what_was_there(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folders = [str(folder) for folder in three(tmp_path, ORDER, ORDER, ORDER)]
    page = tmp_path / "page.md"
    main([*folders, "--out", str(page)])
    first = page.read_text()
    assert "Of 6 pairs of controllers 6 stand in one order in all sets and 0 swap." in first
    assert f"suite `{SUITE.name}`" in first
    with pytest.raises(SystemExit):
        main([folders[0], folders[0], "--out", str(page)])
    assert "share track 0" in capsys.readouterr().err
    assert page.read_text() == first
