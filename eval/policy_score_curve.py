"""Learning over wall-clock time: the ride index of a run's checkpoints, classical laws as lines.

If every checkpoint of a run still has its policy ([checkpoints] keep = 1000 in the settings), each
is scored on the scoring tracks as `railenv score` does, and the lines are the references there.
Otherwise the judge's estimates of the run are drawn, with the lines that the judge knows; the two
kinds differ in tracks and in how the ride index is computed, and are never drawn together.
"""

import csv
import json
import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from baselines.policies.folder import load_trained
from eval.arguments import folder_name
from eval.policy_score_references import (
    LQG,
    PASSIVE,
    PREVIEW,
    SKYHOOK,
    YARDSTICK,
    layout_beside,
    passive_and_skyhook,
    with_designs,
)
from eval.policy_score_runs import Trial, comfort_of
from railenv.errors import ArgumentError, InputFileError

SCORED, JUDGED = "scored on the scoring tracks", "estimated by the judge on its own tracks"

_DRAWN = (PASSIVE, SKYHOOK, LQG, PREVIEW, YARDSTICK)
_JUDGES = {"best sky-hook": SKYHOOK, "lqg-delay": LQG}
_INDEX, _END = "ride_index_", "ms"
_FEWEST = 2


def learning_curve(
    folders: Sequence[Path], trial: Trial, progress: Callable[[str], None] | None = None
) -> dict[str, Any]:
    """Return how runs learnt.

    Args:
        folders: Folders of `railenv train`, of one recipe usually.
        trial: What is run where checkpoints are scored; its delays are those of the runs.
        progress: Called with a word on every run that starts.

    Returns:
        `kind`, `delays_s`, `runs` (each `name`, `seconds`, `index`: mean over the delays of the
        ride index of the worse end, None where it left every bound, and `stable`), and `lines`, the
        same number of the references by name. Plain values.

    Raises:
        ArgumentError: The runs were not judged at the same delays.
        InputFileError: A file of a run cannot be used.
    """
    tell = progress or (lambda _: None)
    tables = [_table(folder) for folder in folders]
    delays = _delays(folders[0], tables[0])
    for folder, table in zip(folders, tables, strict=True):
        if _delays(folder, table) != delays:
            raise ArgumentError(f"{folder} was judged at other delays than {folders[0]}")
    pairs = list(zip(folders, tables, strict=True))
    whole = all(_policy(folder, row).is_dir() for folder, table in pairs for row in table)
    place = replace(trial, delays=delays)
    runs = [_run(folder, table, place if whole else None, tell) for folder, table in pairs]
    if whole:
        first = [(str(f), load_trained(_policy(f, table[0]))) for f, table in pairs]
        found = passive_and_skyhook(place, tell, layout=layout_beside(first))
        found = with_designs(found, place, tell)
        lines = {name: float(found.rows[name].worse.mean()) for name in _DRAWN}
    else:
        lines = _judges_lines(folders[0])
    return {
        "kind": SCORED if whole else JUDGED,
        "delays_s": list(delays),
        "runs": runs,
        "lines": {name: value for name, value in lines.items() if math.isfinite(value)},
    }


def _run(
    folder: Path,
    table: list[dict[str, float]],
    trial: Trial | None,
    tell: Callable[[str], None],
) -> dict[str, Any]:
    index: list[float | None] = []
    for row in table:
        if trial is None:
            values = [value for name, value in row.items() if name.startswith(_INDEX)]
            mean = float(np.mean(values))
        else:
            tell(f"{folder_name(folder)}, {int(row['steps'])} steps")
            mean = float(comfort_of(load_trained(_policy(folder, row)), trial).worse.mean())
        index.append(mean if math.isfinite(mean) else None)
    return {
        "name": folder_name(folder),
        "seconds": [row["seconds"] for row in table],
        "index": index,
        "stable": [bool(row["stable"]) for row in table],
    }


def _policy(folder: Path, row: dict[str, float]) -> Path:
    return folder / "checkpoints" / f"{int(row['steps']):012d}" / "policy"


def _table(folder: Path) -> list[dict[str, float]]:
    """Return the rows of learning.csv."""
    path = folder / "learning.csv"
    try:
        with path.open(encoding="ascii", newline="") as stream:
            rows = [{k: float(v) for k, v in row.items()} for row in csv.DictReader(stream)]
    except OSError as error:
        raise InputFileError(
            f"cannot read {path}: {error.strerror}; give the folder of a railenv train run"
        ) from None
    except (ValueError, TypeError, AttributeError, csv.Error) as error:
        raise InputFileError(f"{path} is no table of numbers: {error}") from None
    if len(rows) < _FEWEST:
        raise InputFileError(f"{path} has {len(rows)} rows; a curve needs {_FEWEST} checkpoints")
    missing = {"steps", "seconds", "stable"} - set(rows[0])
    if missing:
        raise InputFileError(f"{path} lacks the column {', '.join(sorted(missing))}")
    if not all(math.isfinite(row[key]) for row in rows for key in ("steps", "seconds")):
        raise InputFileError(f"{path} has steps or seconds that are not finite")
    return rows


def _delays(folder: Path, table: list[dict[str, float]]) -> tuple[float, ...]:
    """Return the judged delays from the names of the columns [s]."""
    names = [name for name in table[0] if name.startswith(_INDEX) and name.endswith(_END)]
    try:
        delays = tuple(float(name[len(_INDEX) : -len(_END)]) / 1000.0 for name in names)
    except ValueError:
        delays = ()
    if not delays:
        raise InputFileError(f"{folder / 'learning.csv'} has no columns {_INDEX}...{_END}")
    return delays


def _judges_lines(folder: Path) -> dict[str, float]:
    """Return what the judge found of the classical laws, by this module's names."""
    path = folder / "references.json"
    try:
        found: Any = json.loads(path.read_text(encoding="ascii"))
        return {
            name: float(np.mean([float(v) for v in found[key]["ride_index"]]))
            for key, name in _JUDGES.items()
        }
    except OSError as error:
        raise InputFileError(f"cannot read {path}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError) as error:
        raise InputFileError(f"{path} is no file of references: {error}") from None
