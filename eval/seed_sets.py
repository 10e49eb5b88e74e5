"""Disjoint sets of tracks with the scores of every controller on them, from finished runs.

A track's seed follows from the suites' version, the salt and the track's number alone
(`eval.scenarios.seeds`). So two runs of different salts share no track, two of the same salt share
all; and within a run the same number is the same track in all conditions.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

from eval.leaderboard import open_records
from eval.packages import PASSIVE, REFERENCE
from eval.scoring.baseline import baselines_of
from eval.scoring.finished import check_finished
from eval.scoring.gain import delays_of, score_of, track_scores
from eval.scoring.order import Scores, SeedSet
from eval.store.schema import DIVISIONS
from eval.store.settings import RunSettings, differences
from railenv.errors import ArgumentError, check_count

Group = tuple[str, str]
"""Layout and division."""


def seed_sets(folders: Sequence[Path], split: int | None = None) -> dict[Group, list[SeedSet]]:
    """Return the disjoint sets of every layout and division.

    Args:
        folders: Of finished runs, each with tracks of its own; one if it is to be dealt.
        split: Number of sets that one run's tracks are dealt into, by their numbers; None for one
            set per folder.

    Raises:
        ArgumentError: A folder has no finished records, suites differ, sets share a track, or the
            number of folders or sets is wrong.
    """
    if split is not None:
        check_count("split", split, minimum=2)
        if len(folders) != 1:
            raise ArgumentError(f"--split {split} deals one run's tracks; give one folder alone")
        return _dealt(_run_sets(folders[0])[1], split)
    if len(folders) < 2:
        raise ArgumentError("one folder holds one set of tracks; give more, or --split 3")
    runs = [_run_sets(folder) for folder in folders]
    first = runs[0][0]
    for folder, (settings, _) in zip(folders[1:], runs[1:], strict=True):
        # Limits and salt may differ; what a cell is may not.
        unlike = differences(first, replace(settings, limits=first.limits,
                                            salt_commitment=first.salt_commitment))  # fmt: skip
        if unlike:
            raise ArgumentError(f"{folder} is of another suite than {folders[0]}: {unlike}")
    groups: dict[Group, list[SeedSet]] = {}
    for _, own in runs:
        for group, each in own.items():
            groups.setdefault(group, []).append(each)
    for sets in groups.values():
        _check_disjoint(sets)
    return {group: sets for group, sets in groups.items() if len(sets) == len(folders)}


def _run_sets(folder: Path) -> tuple[RunSettings, dict[Group, SeedSet]]:
    """Return a run's settings and its one set of every layout and division."""
    with open_records(folder) as reader:
        check_finished(reader)
        settings, rows = reader.settings, list(reader.rows())
        divisions = {row["spec"]: row["division"] for row in reader.controllers()}
    groups: dict[Group, SeedSet] = {}
    for layout in sorted({str(row["layout"]) for row in rows}):
        here = [row for row in rows if row["layout"] == layout]
        base = baselines_of(
            [row for row in here if row["controller"] == PASSIVE],
            [row for row in here if row["controller"] == REFERENCE],
        )
        running = [row for row in here if row["controller"] not in (PASSIVE, REFERENCE)]
        delays = delays_of(running)
        for division in DIVISIONS:
            scores = {
                spec: track_scores(score.gains)
                for spec in dict.fromkeys(str(row["controller"]) for row in running)
                if divisions[spec] == division
                for score in [
                    score_of([r for r in running if r["controller"] == spec], base, None, delays)
                ]
                if score is not None
            }
            if scores:
                groups[layout, division] = _seed_set(folder.name, scores, settings.salt_commitment)
    return settings, groups


def _seed_set(name: str, scores: Scores, salt: str) -> SeedSet:
    numbers = {n for own in scores.values() for tracks in own.values() for n in tracks}
    return SeedSet(name, scores, frozenset((salt, number) for number in numbers))


def _dealt(groups: Mapping[Group, SeedSet], split: int) -> dict[Group, list[SeedSet]]:
    """Deal every set's tracks by their numbers."""
    found: dict[Group, list[SeedSet]] = {}
    for group, whole in groups.items():
        sets: list[SeedSet] = []
        for k in range(split):
            scores = {
                spec: {
                    condition: own
                    for condition, tracks in conditions.items()
                    if (own := {n: gain for n, gain in tracks.items() if n % split == k})
                }
                for spec, conditions in whole.scores.items()
            }
            tracks = frozenset(track for track in whole.tracks if track[1] % split == k)
            sets.append(SeedSet(f"set {k + 1}", scores, tracks))
        if any(not own for each in sets for own in each.scores.values()):
            raise ArgumentError(
                f"--split {split} leaves a set without tracks; give fewer sets, or runs of a suite "
                "with more tracks"
            )
        _check_disjoint(sets)
        found[group] = sets
    return found


def _check_disjoint(sets: Sequence[SeedSet]) -> None:
    """Raise if two sets share a track: its seed follows from version, salt and number alone."""
    owner: dict[tuple[str, int], str] = {}
    for each in sets:
        for track in sorted(each.tracks):
            if track in owner:
                salt = "the public salt" if not track[0] else f"the salt {track[0][:12]}..."
                raise ArgumentError(
                    f"{owner[track]} and {each.name} share track {track[1]} of {salt}; give runs "
                    "with different --private-salt, or one folder with --split"
                )
            owner[track] = each.name
