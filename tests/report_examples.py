"""Records of made-up controllers for the tests of the page; every number is a known function."""

import itertools
import sqlite3
from collections.abc import Iterable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import numpy as np

from eval.packages import PASSIVE, REFERENCE
from eval.scenarios import Channel, Scenario
from eval.store.cell import Cell
from eval.store.schema import RECORDS_FILE
from eval.store.settings import RunSettings
from eval.store.store import Store

SETTINGS = RunSettings("made-up", "v0", {"name": "made-up"}, {"seconds": 1.0, "memory_bytes": 1})
COMMAND = "railenv benchmark --suite made-up.toml --private-salt 'very secret' --jobs 1"
PASSIVE_INDEX, REFERENCE_INDEX = 2.0, 1.0
DELAYS_MS = (0.0, 100.0, 200.0, 300.0)


def scenarios(
    layouts: Sequence[str] = ("4",),
    delays_ms: Sequence[float] = DELAYS_MS,
    seeds: int = 2,
    more: Iterable[dict[str, Any]] = (),
) -> list[Scenario]:
    """The condition that is drawn, and others that differ from it."""
    changes: list[dict[str, Any]] = [{}, {"speed_kmh": 250.0}, {"vehicle": "laden"}, *more]
    found = []
    for layout, change, delay, seed in itertools.product(layouts, changes, delays_ms, range(seeds)):
        values = {"model": "lateral17", "vehicle": "nominal", "speed_kmh": 300.0,
                  "track": "german_low", "kind": "constant"} | change  # fmt: skip
        channel = Channel(values.pop("kind"), delay)
        found.append(Scenario("v0", layout=layout, channel=channel, seed=seed, **values))
    return found


def ride_index(quality: float, critical_ms: float, scenario: Scenario) -> float | None:
    """Passive 2, reference 1: quality falls with the square of the delay; None beyond critical."""
    delay = scenario.channel.delay_ms
    if delay > critical_ms:
        return None
    gain = quality * (1.0 - (delay / critical_ms) ** 2)
    steps = 0.02 * scenario.seed + 0.05 * (scenario.vehicle == "laden")
    return PASSIVE_INDEX - gain + steps + 0.0004 * (300.0 - scenario.speed_kmh)


def cell_of(scenario: Scenario, index: float | None, **changes: Any) -> Cell:
    """A cell whose rear end is the worse one; diverged if it has no index."""
    measures = {"force_rms": 1000.0, "stroke_peak": 0.02}
    if index is not None:
        measures |= {"ride_index_front": index - 0.1, "ride_index_rear": index}
    if scenario.model == "full50":
        measures |= {"derailment_quotient": 0.25, "wheel_unloading": 0.5}
    values = {
        "key": scenario.key,
        "model": scenario.model,
        "vehicle": scenario.vehicle,
        "layout": scenario.layout,
        "speed_kmh": scenario.speed_kmh,
        "track": scenario.track,
        "channel": scenario.channel.kind,
        "delay_s": scenario.channel.delay,
        "seed": scenario.seed,
        "status": "ok" if index is not None else "diverged",
        "measures": measures,
    }
    return Cell(**{**values, **changes})


def exact(critical_ms: float | None, **changes: Any) -> dict[str, Any]:
    """An answer on stability as `eval.benchmark_stability` gives it for a continuous law."""
    return {
        "method": "exact",
        "longest_s": 2.0,
        "critical_delay_s": None if critical_ms is None else critical_ms / 1000.0,
        "proved": True,
        "unstable_roots_without_delay": 0,
        "stable_windows_s": [[0.0, 2.0 if critical_ms is None else critical_ms / 1000.0]],
        "frequency_hz": None if critical_ms is None else 1.3,
        "mode": None if critical_ms is None else "upper centre roll",
        **changes,
    }


def motion(
    slope: float = 1.0, delays: Sequence[float] = (0.0, 0.1, 0.3), peak: int = 2000
) -> dict[str, Any]:
    """A controller's motion as `eval.benchmark_motion` gives it, of triangles and straight lines.

    Args:
        slope: One root moves by so much per 100 ms, from -2 1/s and 1 Hz on.
        delays: Of the histories [s].
        peak: Largest acceleration at 0 ms, in steps; it doubles with every delay.
    """

    def signal(high: int) -> dict[str, Any]:
        wave = [round(high * abs(k % 20 - 10) / 10) for k in range(50)]
        return {"rms": high / 2e4, "low": [w - 50 for w in wave], "high": wave}

    runs = [
        {
            "delay_s": delay,
            "front": signal(peak * 2**k // 2),
            "rear": signal(peak * 2**k),
            "force": signal(500 * 2**k),
            "force_rms": 250.0 * 2**k,
        }
        for k, delay in enumerate(delays)
    ]
    steps = [k / 100.0 for k in range(31)]
    moving = [[-2.0 + slope * delay / 0.1, 6.283185] for delay in steps]
    branches = [{"first": 0, "roots": moving}, {"first": 20, "roots": [[-4.0, 3.0]]}]
    roots = {"kind": "exact", "delays_s": steps, "branches": branches}
    return {"window_s": [10.0, 12.0], "bin_s": 0.04, "runs": runs, "roots": roots}


def passive_motion(peak: int = 3000) -> dict[str, Any]:
    """The passive vehicle's motion: one run, no force, one root."""
    found = motion(delays=(0.0,), peak=peak)
    found["runs"][0] |= {"force": None, "force_rms": None}
    still = [{"first": 0, "roots": [[-0.5, 3.0]]}]
    return found | {"roots": {"kind": "passive", "delays_s": [0.0], "branches": still}}


def add_motion(folder: Path, found: dict[str, dict[str, Any]], layout: str = "4") -> Path:
    """Add motions by SPEC to records."""
    with Store.resume(folder, SETTINGS) as store:
        for spec, answer in found.items():
            store.add_motion(spec, layout, "nominal", 300.0, answer)
    return folder


def write(
    folder: Path,
    controllers: dict[str, tuple[str, list[Cell], dict[str, Any] | None]],
    run: Sequence[Scenario],
    settings: RunSettings = SETTINGS,
    *,
    ended: bool = True,
) -> Path:
    """Write records: passive, reference, and by SPEC a division, cells and an answer."""
    still = [s for s in run if s.channel.delay == 0.0 and s.channel.kind == "constant"]
    passive = [cell_of(s, PASSIVE_INDEX, measures=_indices(PASSIVE_INDEX)) for s in still]
    reference = [cell_of(s, REFERENCE_INDEX) for s in still]
    everyone = {
        PASSIVE: ("untold", passive, exact(None, longest_s=None, proved=False)),
        REFERENCE: ("untold", reference, None),
        **controllers,
    }
    folder.mkdir(parents=True, exist_ok=True)
    with Store.create(folder, settings) as store:
        store.begin_session(COMMAND)
        for spec, (division, cells, answer) in everyone.items():
            store.add_controller(spec, division)
            if cells:
                store.add_package(spec, "p0", cells, 1.0)
            for layout in sorted({cell.layout for cell in cells}) if answer is not None else ():
                store.add_stability(spec, layout, "nominal", 300.0, answer)
    if not ended:
        # As a kill leaves it.
        with closing(sqlite3.connect(folder / RECORDS_FILE)) as file, file:
            file.execute("UPDATE sessions SET ended = NULL")
    return folder


def simple(run: Sequence[Scenario], quality: float, critical_ms: float) -> list[Cell]:
    """The cells of a controller of a quality and a critical delay."""
    return [cell_of(s, ride_index(quality, critical_ms, s)) for s in run]


def many(folder: Path, count: int = 30) -> Path:
    """Write records of many controllers; on two actuators others are good, and most diverge."""
    more = [{"speed_kmh": 200.0}, {"speed_kmh": 350.0}, {"kind": "jitter"}, {"track": "tb3352"}]
    run = scenarios(("4", "2"), [50.0 * k for k in range(7)], 3, more)
    numbers = np.random.Generator(np.random.PCG64(1)).uniform(size=(count, 2))
    found: dict[str, Any] = {}
    for k, (quality, place) in enumerate(numbers):
        critical = 120.0 + 600.0 * place
        spec = f"skyhook:gain={k}e3" if k % 5 == 0 else f"py:my_package.my_controllers_{k}:make_law"
        answer = exact(None if k % 7 == 3 else critical, proved=k % 2 == 0)
        division = "untold" if k % 3 else "told"
        cells = simple([s for s in run if s.layout == "4"], 0.3 + 0.7 * quality, critical)
        cells += simple([s for s in run if s.layout == "2"], 1.0 - 0.7 * quality, 0.4 * critical)
        found[spec] = (division, cells, answer)
    return write(folder, found, run)


def _indices(index: float) -> dict[str, float]:
    return {"ride_index_front": index - 0.1, "ride_index_rear": index}
