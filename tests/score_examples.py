"""Rows and records of benchmarks with ride indices typed by hand, for the tests of scores."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from store_examples import SETTINGS

from eval.cells import described
from eval.packages import PASSIVE, REFERENCE
from eval.scenarios import Scenario
from eval.store.cell import Cell
from eval.store.schema import LOST, MEASURES
from eval.store.store import Store

PLACE = "v0/lateral17/nominal/4/300/german_low"


def key(channel: str = "constant:0", seed: int = 0, place: str = PLACE) -> str:
    """The key of a scenario."""
    return f"{place}/{channel}/{seed}"


def row(name: str, index: float | str, **measures: float) -> dict[str, Any]:
    """A row of one cell.

    Args:
        name: Its key.
        index: Ride index of the worse end, the rear one; or the status of a run without one.
        measures: Other numbers.
    """
    status = index if isinstance(index, str) else "ok"
    numbers: dict[str, Any] = dict.fromkeys(MEASURES)
    if status not in LOST:
        numbers |= {"force_rms": 0.0, "stroke_peak": 0.0}
    if not isinstance(index, str):
        numbers |= {"ride_index_front": 0.5 * index, "ride_index_rear": index}
    return {
        **described(Scenario.of(name)),
        "status": status,
        "message": "it raised" if status == "failed" else "",
        **numbers,
        **measures,
    }


def record(
    folder: Path,
    rows: Mapping[str, Sequence[dict[str, Any]]],
    told: Sequence[str] = (),
    stability: Mapping[str, dict[str, Any]] | None = None,
) -> Path:
    """Write records of rows by controller; return their folder."""
    with Store.create(folder, SETTINGS) as store:
        store.begin_session("railenv benchmark")
        for spec, own in rows.items():
            store.add_controller(spec, "told" if spec in told else "untold")
            cells = [
                Cell(
                    **{name: value for name, value in one.items() if name not in MEASURES},
                    measures={name: one[name] for name in MEASURES},
                )
                for one in own
            ]
            store.add_package(spec, "all", cells, 1.0)
        for spec, answer in (stability or {}).items():
            store.add_stability(spec, "4", "nominal", 300.0, answer)
    return folder


def yardsticks(
    passive: float | str = 2.2, reference: float | str = 1.2, seeds: int = 2, place: str = PLACE
) -> dict[str, list[dict[str, Any]]]:
    """Rows of the passive vehicle and of the reference on some tracks of one place."""
    return {
        PASSIVE: [row(key(seed=k, place=place), passive) for k in range(seeds)],
        REFERENCE: [row(key(seed=k, place=place), reference) for k in range(seeds)],
    }
