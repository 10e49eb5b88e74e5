"""Writes docs/leaderboard.md from the records of a finished run.

`python -m eval.leaderboard FOLDER` shows what is in the folder's records.sqlite and runs nothing. A
published leaderboard is of the suite `standard`; another one is said to be none.
"""

import argparse
import re
import shlex
import sys
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

from baselines.policies.shipped import shipped_names
from eval.entries import SHIPPED
from eval.packages import PASSIVE, REFERENCE
from eval.policy_score_text import markdown
from eval.records import provenance, write_text
from eval.scoring.board import Board, Standing, boards_of
from eval.scoring.board_text import printable, single_note, standing_cells, standing_notes
from eval.scoring.finished import check_finished, suite_of_records
from eval.scoring.statistics import RESAMPLING, Resampling
from eval.store.connection import records_path
from eval.store.digest import digest
from eval.store.reader import Reader
from eval.store.schema import DIVISIONS
from railenv.errors import ArgumentError, InputFileError, RailenvError
from railenv.files import make_folder

PUBLISHED = "standard"
"""The suite that a published leaderboard is of."""

_COLUMNS = {
    "score": "score",
    "interval": "95 % interval",
    "interquartile mean": "IQM",
    "better": "better",
    "critical": "critical delay [ms]",
    "lost": "lost",
    "force": "force [kN]",
    "stroke": "stroke [mm]",
    "derailment quotient": "Y/Q",
    "unloading": "unloading",
}
_LAYOUTS = {"2": "Two actuators", "4": "Four actuators"}
_TITLES = {"told": "Told the delay", "untold": "Not told the delay"}


def main(arguments: Sequence[str] | None = None) -> None:
    """Read and write."""
    parser = argparse.ArgumentParser(prog="python -m eval.leaderboard", description=__doc__)
    parser.add_argument("folder", help="folder of a finished run")
    parser.add_argument("--out", default="docs/leaderboard.md", help="where to write")
    given = sys.argv[1:] if arguments is None else list(arguments)
    options = parser.parse_args(given)
    command = shlex.join(["python", "-m", "eval.leaderboard", *given])
    try:
        path = Path(options.out)
        text = leaderboard_text(Path(options.folder), command)
        make_folder(path.parent)
        write_text(path, text)
    except RailenvError as error:
        parser.error(str(error))


def open_records(folder: Path) -> Reader:
    """Open a folder's records.

    Raises:
        ArgumentError: It holds none.
        InputFileError: They are damaged or of a newer version.
    """
    try:
        records_path(folder)
    except InputFileError as error:
        raise ArgumentError(str(error)) from None
    return Reader.open(folder)


def leaderboard_text(folder: Path, command: str, resampling: Resampling | None = RESAMPLING) -> str:
    """Return the page.

    Args:
        folder: The run's folder.
        command: How the program was called.
        resampling: Of the intervals; None for none.

    Raises:
        ArgumentError: There are no records, the benchmark is not finished, or runs of passive or
            the reference were lost.
        InputFileError: They are damaged or of a newer version.
    """
    with open_records(folder) as reader:
        check_finished(reader)
        parts = [
            _HEAD.format(command=command, revision=provenance(command, 0.0)["revision"]),
            *_warnings(reader),
            *(part for board in boards_of(reader, resampling) for part in _board_parts(board)),
            _COLUMNS_TEXT,
            "## Where the numbers come from",
            "\n".join(_sources(reader)),
            "## How to reproduce",
            _reproduction(reader),
        ]
    return "\n\n".join(parts) + "\n"


_HEAD = """# Leaderboard

Written by `{command}`
at revision {revision}; do not edit. What the score is, what it rewards and what it cannot see, and
the rule for getting in: [benchmark.md](benchmark.md)."""

_COLUMNS_TEXT = """## What the columns are

**Score**: delay-robust score with its 95 % bootstrap interval; one is the reference without delay,
zero the passive vehicle, -1 a vehicle that diverged. **IQM**: interquartile mean over the tracks of
all conditions. **Better**: probability that a track is better than with the best sky-hook.
**Critical delay** of the nominal vehicle at 300 km/h: p proved, e by eigenvalues, s by simulation;
"none": it has no actuator. **Lost**: runs that diverged + runs that came to no end. **Force**: RMS
over all runs that came to an end. **Stroke** of the secondary suspension, and on the nonlinear
vehicle **Y/Q** and **unloading** of a wheel: the largest of all these runs. **Worst cell**: the
smallest gain, and where; of equal ones the first by name.

Ranks are within a division; those not told the delay may be compared with those told it, not the
other way round. Who lacks runs that others are scored by stands below them, without a rank."""


def _warnings(reader: Reader) -> Iterator[str]:
    settings = reader.settings
    if settings.suite != PUBLISHED:
        yield (
            f"**Not for publication**: the suite is `{settings.suite}`, a published leaderboard "
            f"is of `{PUBLISHED}`."
        )
    revisions = [str(session["revision"] or "") for session in reader.sessions()]
    if any(revision.endswith("-dirty") for revision in revisions):
        yield "**Not for publication**: run from a checkout with changes that are in no revision."


def _board_parts(board: Board) -> Iterator[str]:
    yield f"## {_LAYOUTS.get(board.layout, board.layout)}"
    force = board.reference_force
    known = "" if force is None else f"Force of the reference: {force / 1e3:.2f} kN RMS. "
    note = single_note(board)
    yield (
        f"{known}Stroke of the passive vehicle: {standing_cells(board.passive)['stroke']} mm."
        + (f" {note[0].upper()}{note[1:]}." if note else "")
    )
    for division in DIVISIONS:
        standings = [s for s in board.standings if s.division == division]
        if standings:
            yield f"### {_TITLES[division]}"
            yield _table(standings)
            notes = [(s, words) for s in standings for words in standing_notes(s)]
            if notes:
                yield "\n".join(f"- {code(s.controller)}: {prose(words)}" for s, words in notes)


def _table(standings: Sequence[Standing]) -> str:
    rows: list[list[str]] = []
    for rank, standing in enumerate(standings, 1):
        cells = standing_cells(standing)
        score = standing.score
        worst = "-" if score is None else f"{cells['worst']} at {code(score.worst.key)}"
        place = "-" if standing.missing or score is None else str(rank)
        rows.append([place, code(standing.controller), *(cells[name] for name in _COLUMNS), worst])
    return markdown(["rank", "controller", *_COLUMNS.values(), "worst cell"], rows)


def code(text: str) -> str:
    """Return a text as code in a cell of a table, whatever it holds."""
    shown = printable(text).replace("|", "\\|")
    if "`" not in shown:
        return f"`{shown}`"
    longest = max(len(run) for run in re.findall("`+", shown))
    fence = "`" * (longest + 1)
    return f"{fence} {shown} {fence}"


def prose(text: str) -> str:
    """Return a text with nothing that Markdown or HTML would take for its own."""
    return "".join(f"\\{c}" if c in "\\`*_[]|#" else _HTML.get(c, c) for c in printable(text))


_HTML = {"<": "&lt;", ">": "&gt;", "&": "&amp;"}


def _sources(reader: Reader) -> Iterator[str]:
    settings = reader.settings
    sessions = reader.sessions()
    suite = suite_of_records(reader)
    tracks = "the public ones"
    if settings.salt_commitment:
        tracks = f"of a private salt with the SHA-256 `{settings.salt_commitment}`"
    yield f"- Suite: `{settings.suite}` {settings.version}, {len(suite.scenarios):,} cells"
    yield f"- Test tracks: {tracks}"
    limits = ", ".join(f"{name} {_grouped(value)}" for name, value in settings.limits.items())
    yield f"- Limits of a package: {prose(limits)}"
    yield f"- Digest of all results (`eval.store.digest`): `{digest(reader.folder)}`"
    work = sum(package["seconds"] for package in reader.packages())
    runs = sum(1 for _ in reader.rows())
    yield f"- {runs:,} runs, {work:,.0f} s of work of one core"
    for session in sessions:
        versions = ", ".join(f"{name} {value}" for name, value in session["versions"].items())
        yield (
            f"- Session from {session['started']} to {session['ended'] or 'a kill'}, "
            f"{session['cores']} cores, revision {session['revision'] or 'none'}: {versions}"
        )
    for controller in reader.controllers():
        if controller["sha256"]:
            yield f"- SHA-256 behind {code(controller['spec'])}: `{controller['sha256']}`"


def _grouped(value: object) -> str:
    return f"{value:,}" if isinstance(value, int | float) else str(value)


def _reproduction(reader: Reader) -> str:
    settings: Any = reader.settings
    specs = [row["spec"] for row in reader.controllers()]
    running = [spec for spec in specs if spec not in (PASSIVE, REFERENCE)]
    words = ["railenv", "benchmark", "--suite", settings.suite]
    if {*running} != _usual(settings.content):
        words += [word for spec in running for word in ("--controller", spec)]
    if settings.salt_commitment:
        words += ["--private-salt", "SALT"]
    out = f"runs/{settings.suite}"
    lines = [
        printable(shlex.join([*words, "--out", out])),
        f"python -m eval.leaderboard {out}",
        'python -c "from pathlib import Path; from eval.store.digest import digest; '
        f"print(digest(Path('{out}')))\"",
    ]
    if settings.suite != PUBLISHED:
        lines[1] += f" --out {out}/leaderboard.md"
    text = "\n".join(f"    {line}" for line in lines)
    return f"{text}\n\n{_SAME}"


_SAME = """On one machine with the same versions the digest is the same; elsewhere the last digits
differ. One cell again: `railenv benchmark --suite SUITE --controller SPEC --cell KEY`."""


def _usual(content: Mapping[str, Any]) -> set[str]:
    """Return the controllers that a suite runs if none are named."""
    given = content.get("controllers", ())
    return {name for spec in given for name in (shipped_names() if spec == SHIPPED else [spec])}


if __name__ == "__main__":
    main()
