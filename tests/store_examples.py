"""Cells, settings and whole runs for the tests of the records; every number is a known function."""

import sys
from pathlib import Path

import numpy as np

from eval.store.cell import Cell
from eval.store.schema import MEASURES
from eval.store.settings import RunSettings
from eval.store.store import Store

SETTINGS = RunSettings(
    suite="quick",
    version="v0",
    content={"speeds_kmh": (200.0, 300.0), "tracks": ["german_low"], "duration": 20.0},
    limits={"seconds": 120.0, "memory_bytes": 2**31},
    salt_commitment="ab" * 32,
)
SPEC = "skyhook:gain=35e3"
PACKAGES, CELLS = 40, 50


def cell(seed: int = 0, **changes) -> Cell:
    """One cell; its key follows from the seed."""
    values = {
        "key": f"v0/lateral17/nominal/4/300/german_low/constant:100/{seed}",
        "model": "lateral17",
        "vehicle": "nominal",
        "layout": "4",
        "speed_kmh": 300.0,
        "track": "german_low",
        "channel": "constant:100",
        "delay_s": 0.1,
        "seed": seed,
        "status": "ok",
        "measures": {"ride_index_front": 2.0 + seed / 7},
        "unstable": False,
    }
    return Cell(**{**values, **changes})


def package(number: int, cells: int = CELLS) -> list[Cell]:
    """The cells of package p<number>, each with every measure."""
    numbers = np.random.Generator(np.random.PCG64(number)).standard_normal((cells, len(MEASURES)))
    return [
        cell(number * cells + i, measures=dict(zip(MEASURES, row, strict=True)))
        for i, row in enumerate(numbers)
    ]


def write(folder: Path, numbers: range, settings: RunSettings = SETTINGS) -> None:
    """Write a new run's records with these packages."""
    with Store.create(folder, settings) as store:
        go_on(store, numbers)


def go_on(store: Store, numbers: range, cells: int = CELLS) -> None:
    """Write what is missing of these packages."""
    store.begin_session("railenv benchmark --suite quick")
    store.add_controller(SPEC, "untold")
    done = store.done()
    for number in numbers:
        if (SPEC, f"p{number}") not in done:
            store.add_package(SPEC, f"p{number}", package(number, cells), 1.0)
            print(number, flush=True)


if __name__ == "__main__":  # a child process that may be killed
    place = Path(sys.argv[1])
    begun = (place / "records.sqlite").exists()
    with (Store.resume if begun else Store.create)(place, SETTINGS) as records:
        print("open", flush=True)
        go_on(records, range(PACKAGES))
