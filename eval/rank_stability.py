"""Writes docs/rank-stability.md: do controllers stand in one order on disjoint sets of tracks?

`python -m eval.rank_stability FOLDER FOLDER FOLDER` compares finished runs of one suite on tracks
of different salts; `python -m eval.rank_stability FOLDER --split 3` deals the tracks of one run
into disjoint sets: a track goes by its number, so that no track is in two sets.
"""

import argparse
import shlex
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from eval.leaderboard import code, open_records
from eval.policy_score_text import markdown
from eval.records import provenance, write_text
from eval.scoring.order import FEWEST_TRACKS, Comparison, Pair, compared
from eval.scoring.statistics import RESAMPLING, Interval, Resampling
from eval.seed_sets import Group, seed_sets
from eval.store.digest import digest
from eval.store.schema import DIVISIONS
from railenv.errors import RailenvError
from railenv.files import make_folder

_LAYOUTS = {"2": "two actuators", "4": "four actuators"}
_TITLES = {"told": "told the delay", "untold": "not told the delay"}


def main(arguments: Sequence[str] | None = None) -> None:
    """Read, compare and write."""
    parser = argparse.ArgumentParser(prog="python -m eval.rank_stability", description=__doc__)
    parser.add_argument("folders", nargs="+", metavar="FOLDER", help="folder of a finished run")
    parser.add_argument("--split", type=int, help="deal one run's tracks into so many sets")
    parser.add_argument("--out", default="docs/rank-stability.md", help="where to write")
    given = sys.argv[1:] if arguments is None else list(arguments)
    options = parser.parse_args(given)
    command = shlex.join(["python", "-m", "eval.rank_stability", *given])
    try:
        path = Path(options.out)
        text = stability_text([Path(folder) for folder in options.folders], options.split, command)
        make_folder(path.parent)
        write_text(path, text)
    except RailenvError as error:
        parser.error(str(error))


def stability_text(
    folders: Sequence[Path],
    split: int | None,
    command: str,
    resampling: Resampling | None = RESAMPLING,
) -> str:
    """Return the page.

    Args:
        folders: Of finished runs; one if it is to be split.
        split: Number of sets; None for one set per folder.
        command: How the program was called.
        resampling: Of the intervals.

    Raises:
        ArgumentError: See `seed_sets`.
        InputFileError: Records are damaged or of a newer version.
    """
    groups = seed_sets(folders, split)
    found = {
        group: compared(sets, resampling)
        for group, sets in sorted(groups.items(), key=_group_order)
    }
    parts = [
        _HEAD.format(
            command=command,
            revision=provenance(command, 0.0)["revision"],
            fewest=FEWEST_TRACKS,
        ),
        "\n".join(_sources(folders, split)),
        _answer(found.values()),
        *(part for group, each in found.items() for part in _group_parts(group, each)),
    ]
    return "\n\n".join(parts) + "\n"


def _group_order(item: tuple[Group, object]) -> tuple[int, int]:
    layout, division = item[0]
    return -int(layout), DIVISIONS.index(division)


_HEAD = """# Is the order of the controllers the same on other tracks?

Written by `{command}`
at revision {revision}; do not edit. Scores are those of [benchmark.md](benchmark.md).

Each set has tracks that no other set has. Two controllers are compared in a set by the difference
of their scores on its tracks, both on the same ones, with a 95 % bootstrap interval over the
tracks, each drawn in all its conditions at once; they are *separated* if zero is outside. No
interval is drawn of fewer than {fewest} tracks, nor where a condition has one track alone. With few
tracks intervals are too narrow: pairs are rather called separated that are not, and reversals
rather found than missed.

Where controllers are alike their order must change from set to set. What would count against the
benchmark is a pair that is separated in one set and in the other order in another."""


def _sources(folders: Sequence[Path], split: int | None) -> Iterator[str]:
    for folder in folders:
        with open_records(folder) as reader:
            settings, sessions = reader.settings, reader.sessions()
        salt = settings.salt_commitment
        tracks = f"private salt with the SHA-256 `{salt}`" if salt else "public tracks"
        revision = sessions[-1]["revision"] if sessions else None
        yield (
            f"- {code(folder.name)}: suite `{settings.suite}` {settings.version}, {tracks}, "
            f"revision {revision or 'none'}, digest `{digest(folder)}`"
        )
    if split is not None:
        sets = ", ".join(f"set {k + 1}" for k in range(split))
        yield f"- Tracks dealt by their numbers, one after the other, to {sets}"


def _answer(found: Iterable[Comparison]) -> str:
    pairs = [pair for each in found for pair in each.pairs]
    separated = sum(any(pair.separated) for pair in pairs)
    swaps = [pair for pair in pairs if pair.swaps]
    against = sum(pair.contradicts for pair in swaps)
    text = (
        f"**Of {len(pairs)} pairs of controllers {len(pairs) - len(swaps)} stand in one order in "
        f"all sets and {len(swaps)} swap. {separated} are separated in a set; of these {against} "
        "stand the other way round in another.**"
    )
    if any(not all(pair.drawn) for pair in pairs):
        text += " Some sets have too few tracks for an interval; of them nothing is separated."
    return text


def _group_parts(group: Group, each: Comparison) -> Iterator[str]:
    layout, division = group
    yield f"## {_LAYOUTS.get(layout, layout).capitalize()}, {_TITLES[division]}"
    tracks = ", ".join(f"{s.name} {len(s.tracks)}" for s in each.sets)
    left = f"; conditions left out for want of a scored track in a set: {len(each.left_out)}"
    yield f"Tracks: {tracks}{left if each.left_out else ''}."
    numbers = range(len(each.sets))
    ranks = [each.ranks(k) for k in numbers]
    order = sorted(each.whole, key=lambda spec: (ranks[0][spec], spec))
    rows = [
        [code(spec), *(f"{ranks[k][spec]:g} ({each.score(k, spec):.3f})" for k in numbers)]
        for spec in order
    ]
    rows += [
        [code(spec), *(f"- ({each.score(k, spec):.3f})" for k in numbers)] for spec in each.lacking
    ]
    yield markdown(["controller: rank (score)", *(s.name for s in each.sets)], rows)
    if each.lacking:
        yield "Without a rank: not run in all conditions, and compared with others on common ones."
    lines = [_agreement_line(each, i, j) for i in numbers for j in numbers if i < j]
    yield "\n".join(lines)
    swapped = [pair for pair in each.pairs if pair.swaps]
    if not swapped:
        yield f"None of {len(each.pairs)} pairs swaps."
        return
    yield f"{len(swapped)} of {len(each.pairs)} pairs swap: difference of the scores by set."
    yield markdown(
        ["pair", *(s.name for s in each.sets), "all tracks together", "separated and reversed"],
        [_pair_row(pair) for pair in swapped],
    )


def _agreement_line(each: Comparison, one: int, other: int) -> str:
    found = each.agreement(one, other)
    words = "too few controllers, or all alike"
    if found is not None:
        words = f"Kendall's tau {found[0]:.3f}, Spearman's rho {found[1]:.3f}"
    return f"- {each.sets[one].name} and {each.sets[other].name}: {words}"


def _pair_row(pair: Pair) -> list[str]:
    cells = [_difference(d) for d in (*pair.differences, pair.together)]
    against = "yes" if pair.contradicts else "no"
    return [f"{code(pair.first)}, {code(pair.second)}", *cells, against]


def _difference(found: Interval) -> str:
    if found.low != found.low:  # NaN: no interval
        return f"{found.estimate:+.4f}"
    return f"{found.estimate:+.4f} [{found.low:+.4f}, {found.high:+.4f}]"


if __name__ == "__main__":
    main()
