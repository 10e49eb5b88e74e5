"""The page of a benchmark: one HTML file, made from its records alone, that needs no network.

Names in records (a controller's SPEC can be any text) are escaped by the templates, which hold all
HTML, and by `eval.report.svg`. Jinja is imported when a page is made.
"""

import importlib.util
from collections.abc import Sequence
from pathlib import Path

from eval.records import write_text
from eval.scoring.board import Board
from eval.store.reader import Reader
from railenv.errors import RailenvError

REPORT_FILE = "report.html"


def missing_for_report() -> str | None:
    """Return the name of a package that the page needs and that is not installed, if any."""
    return None if importlib.util.find_spec("jinja2") else "jinja2"


def write_report(reader: Reader, boards: Sequence[Board]) -> Path:
    """Write `report.html` beside a benchmark's records.

    Args:
        reader: The records, open.
        boards: Their leaderboards, `eval.scoring.board.boards_of(reader)`.

    Returns:
        The page's path.

    Raises:
        OutputError: The page cannot be written; an older one is untouched.
        RailenvError: Jinja is not installed.
    """
    if missing := missing_for_report():
        raise RailenvError(
            f'the page needs {missing}, which is not installed; run pip install "railenv[report]"'
        )
    from eval.report.page import page_of

    path = reader.folder / REPORT_FILE
    write_text(path, page_of(reader, boards))
    return path


__all__ = ["REPORT_FILE", "missing_for_report", "write_report"]
