"""Whether a benchmark's records are whole, so that a page that is kept can be made from them."""

from collections import Counter
from collections.abc import Mapping, Sequence
from typing import Any

from eval.cells import described
from eval.packages import PASSIVE, REFERENCE, references_of
from eval.scenarios import Suite
from eval.store.reader import Reader
from eval.store.schema import LOST
from railenv.config import from_mapping
from railenv.errors import ArgumentError

_SHOWN = 3


def suite_of_records(reader: Reader) -> Suite:
    """Return the suite that records were begun with.

    Raises:
        ArgumentError: What they hold is no suite of this version of railenv.
    """
    content: Mapping[str, Any] = reader.settings.content
    return from_mapping(Suite, dict(content), f"the suite in {reader.path}")


def planned_rows(reader: Reader) -> list[dict[str, Any]]:
    """Return what describes every scenario of the records' suite; nothing if it is not known."""
    try:
        suite = suite_of_records(reader)
    except ArgumentError:
        return []
    return [described(scenario) for scenario in suite.scenarios]


def progress_of(
    reader: Reader, rows: Sequence[Mapping[str, Any]]
) -> dict[str, dict[str, tuple[int, int]]]:
    """Return the runs that are there and that there are to be, by layout and controller.

    Args:
        reader: The records.
        rows: Their cells.
    """
    there = Counter((row["controller"], row["layout"]) for row in rows)
    found: dict[str, dict[str, tuple[int, int]]] = {}
    for spec, layouts in reader.planned.items():
        for layout, planned in layouts.items():
            found.setdefault(layout, {})[spec] = (there[spec, layout], planned)
    return found


def check_finished(reader: Reader) -> None:
    """Raise unless every controller has all its runs and an answer on its stability.

    Runs of passive and reference must have come to an end too: what is lost of a controller is its
    result, but what is lost of these two changes everybody's score.

    A controller may have no runs on a layout or on the nonlinear vehicle, where it cannot act; but
    where it has one run it has all, and on the linear vehicle it has some. Questions on stability
    are asked last: a controller without an answer has not been through.

    Args:
        reader: The records.

    Raises:
        ArgumentError: Something is missing, or the records hold no controller.
        InputFileError: They hold what no score can be made from.
    """
    reader.check_shown()
    lacking = _lacking(reader)
    if lacking is None:
        raise ArgumentError(f"{reader.path} holds no controller; run the benchmark first")
    if lacking:
        more = f"; {len(lacking) - _SHOWN} more" if len(lacking) > _SHOWN else ""
        raise ArgumentError(
            f"the benchmark in {reader.folder} is not finished: "
            f"{'; '.join(lacking[:_SHOWN])}{more}; go on with railenv benchmark --resume"
        )


def _lacking(reader: Reader) -> list[str] | None:
    """Return by controller what it lacks, in words; None if there is no controller."""
    suite = suite_of_records(reader)
    there: dict[str, dict[str, tuple[str, str]]] = {}
    gone_yardsticks: Counter[str] = Counter()
    for row in reader.rows():
        if row["controller"] in (PASSIVE, REFERENCE) and row["status"] in LOST:
            gone_yardsticks[f"{row['controller']}: {row['status']}, {row['message']}"] += 1
        place = (str(row["layout"]), str(row["model"]))
        there.setdefault(str(row["controller"]), {})[str(row["key"])] = place
    answered: dict[str, set[str]] = {}
    for answer in reader.stability():
        answered.setdefault(answer["controller"], set()).add(answer["layout"])
    known = [controller["spec"] for controller in reader.controllers()]
    if not {*known} - {PASSIVE, REFERENCE}:
        return None
    found = [f"{number} lost runs of {why}" for why, number in gone_yardsticks.items()]
    for spec in dict.fromkeys((PASSIVE, REFERENCE, *known)):
        own = there.get(spec, {})
        layouts = {layout for layout, _ in own.values()} | answered.get(spec, set())
        models = {model for _, model in own.values()} | {"lateral17"}
        wanted = {s.key for s in suite.scenarios if s.layout in layouts and s.model in models}
        if spec in (PASSIVE, REFERENCE):
            wanted = {s.key for s in references_of(suite)}
        gone = len(wanted - own.keys())
        if gone or not own:
            found.append(f"{spec} lacks {gone or 'all'} runs")
        elif spec != REFERENCE and {layout for layout, _ in own.values()} - answered.get(
            spec, set()
        ):
            found.append(f"{spec} lacks an answer on its stability")
    return found
