"""What a leaderboard's page speaks of: its controllers with their colours and their runs."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from eval.packages import PASSIVE, REFERENCE
from eval.report.svg import MARKS
from eval.scoring.board import SHOWN, Board, Standing, is_skyhook
from eval.scoring.gain import Row
from eval.store.schema import DIVISIONS

MOST_COLOURS = 6
"""More lines than that nobody tells apart; the others are thin and grey."""

_OF_DIVISION = 3
"""Colours of each division's best; the best sky-hook's is one of its own division's."""


@dataclass(frozen=True, eq=False)
class Entrant:
    """A controller on a board.

    Attributes:
        rank: From 1.
        place: Its number in the page, by which a script finds it, e.g. "7".
        colour: Number of its colour; None for thin and grey.
        standing: Its line on the leaderboard.
        rows: Its runs.
    """

    rank: int
    place: str
    colour: int | None
    standing: Standing
    rows: tuple[Row, ...]

    @property
    def classes(self) -> str:
        """Classes of the style sheet for its lines and marks."""
        return "other" if self.colour is None else f"k{self.colour}"

    @property
    def shape(self) -> str:
        """Its mark."""
        return "o" if self.colour is None else MARKS[self.colour % len(MARKS)]

    @property
    def name(self) -> str:
        """Its SPEC."""
        return self.standing.controller


@dataclass(frozen=True, eq=False)
class BoardView:
    """A board with everything that is drawn of it.

    Attributes:
        board: The leaderboard.
        entrants: Its controllers, the best first.
        passive: Runs of the passive vehicle.
        reference: Runs of the reference.
    """

    board: Board
    entrants: tuple[Entrant, ...]
    passive: tuple[Row, ...]
    reference: tuple[Row, ...]

    @property
    def coloured(self) -> list[Entrant]:
        """The entrants that stand out, the best first."""
        return [entrant for entrant in self.entrants if entrant.colour is not None]

    @property
    def best_skyhook(self) -> Entrant | None:
        """The best sky-hook that has a score."""
        return next((e for e in self.entrants if _is_scored_skyhook(e.standing)), None)


def views_of(boards: Sequence[Board], rows: Iterable[Row]) -> list[BoardView]:
    """Return the boards with their runs; a controller has one colour on all of them.

    Args:
        boards: The leaderboards.
        rows: All cells of the records.
    """
    found: dict[tuple[str, str], list[Row]] = {}
    for row in rows:
        found.setdefault((row["layout"], row["controller"]), []).append(row)
    names = sorted({s.controller for board in boards for s in board.standings})
    places = {name: str(number) for number, name in enumerate(names)}
    colours: dict[str, int] = {}
    views: list[BoardView] = []
    for board in boards:
        taken = _colours(board.standings, colours)
        colours.update({name: colour for name, colour in taken.items() if name not in colours})
        views.append(
            BoardView(
                board,
                tuple(
                    Entrant(rank, places[s.controller], taken.get(s.controller), s,
                            tuple(found.get((board.layout, s.controller), ())))
                    for rank, s in enumerate(board.standings, 1)
                ),
                tuple(found.get((board.layout, PASSIVE), ())),
                tuple(found.get((board.layout, REFERENCE), ())),
            )
        )  # fmt: skip
    return views


def shown_rows(rows: Iterable[Row]) -> list[Row]:
    """Return the runs on the condition that is drawn against delay."""
    return [row for row in rows if _as_shown(row)]


def _as_shown(row: Row) -> bool:
    wanted: dict[str, Any] = SHOWN
    return all(row[name] == value for name, value in wanted.items())


def _colours(standings: Sequence[Standing], before: dict[str, int]) -> dict[str, int]:
    """Return a colour for the best of both divisions and the best sky-hook."""
    chosen: list[Standing] = [s for s in standings if _is_scored_skyhook(s)][:1]
    for division in DIVISIONS:
        have = sum(s.division == division for s in chosen)
        best = [s for s in standings if s.division == division and s not in chosen]
        chosen += best[: _OF_DIVISION - have]
    chosen += [s for s in standings if s not in chosen]
    names = [s.controller for s in chosen[:MOST_COLOURS]]
    taken: dict[str, int] = {}
    for name in names:
        if name in before and before[name] not in taken.values():
            taken[name] = before[name]
    free = [k for k in range(MOST_COLOURS) if k not in taken.values()]
    for name in names:
        if name not in taken:
            taken[name] = free.pop(0)
    return taken


def _is_scored_skyhook(standing: Standing) -> bool:
    return standing.score is not None and is_skyhook(standing.controller)
