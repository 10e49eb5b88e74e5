"""The benchmark's page of made-up records, and its elements."""

from html.parser import HTMLParser
from pathlib import Path
from typing import Any

from report_examples import exact, scenarios, simple

from eval.report import write_report
from eval.scoring.board import Board, boards_of
from eval.scoring.statistics import RESAMPLING, Resampling
from eval.store.reader import Reader

RUN = scenarios()
HOOK, LAW = "skyhook:gain=15e3", "py:mine:law"
_VOID = {"meta", "link", "br", "wbr"}


class Parsed(HTMLParser):
    """A page's elements: (name, attributes, text within) in order; tags must match."""

    def __init__(self, page: str) -> None:
        super().__init__()
        self.elements: list[tuple[str, dict[str, str], list[str]]] = []
        self._open: list[int] = []
        self.feed(page)
        self.close()
        assert not self._open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}, []))
        if tag not in _VOID:
            self._open.append(len(self.elements) - 1)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, {name: value or "" for name, value in attrs}, []))

    def handle_endtag(self, tag: str) -> None:
        assert self.elements[self._open.pop()][0] == tag

    def handle_data(self, data: str) -> None:
        for number in self._open:
            self.elements[number][2].append(data)

    def all(self, tag: str, **wanted: str) -> list[tuple[dict[str, str], str]]:
        """Return attributes and text of elements with this name and these attributes."""
        return [
            (attributes, " ".join("".join(text).split()))
            for name, attributes, text in self.elements
            if name == tag and all(attributes.get(k) == v for k, v in wanted.items())
        ]

    @property
    def text(self) -> str:
        """All that is read."""
        return " ".join(self.all(name)[0][1] for name in ("header", "main"))


def page_of(folder: Path, by: Resampling | None = RESAMPLING) -> tuple[str, list[Board]]:
    with Reader.open(folder) as reader:
        boards = boards_of(reader, by)
        return write_report(reader, boards).read_text(encoding="utf-8"), boards


def usual() -> dict[str, Any]:
    return {
        HOOK: ("untold", simple(RUN, 0.5, 250.0), exact(250.0)),
        LAW: ("told", simple(RUN, 0.8, 900.0), exact(None)),
    }
