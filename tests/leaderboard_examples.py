"""Records of a small suite with ride indices by formula, for the tests of pages made of them."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from benchmark_examples import block, suite_of
from score_examples import row

from eval.packages import PASSIVE, REFERENCE, references_of
from eval.scenarios import Scenario, Suite, commitment
from eval.store.cell import Cell
from eval.store.schema import MEASURES
from eval.store.settings import RunSettings
from eval.store.store import Store
from railenv.config import to_dict

SUITE = suite_of(
    block(channels=("constant", "jitter"), delays_ms=(0.0, 100.0, 300.0), seeds=6),
    block(name="speed", speeds_kmh=(200.0,), delays_ms=(0.0, 300.0), seeds=2),
    name="standard",
    controllers=("zero",),
)
"""Three conditions: two with six tracks and one with two."""

LIMITS = {"seconds": 300.0, "memory_bytes": 2**32}
SALTS = ("", "1234567890abcdef", "fedcba0987654321")

Law = Callable[[Scenario], float | str]
"""Ride index or status of every scenario."""


def keep(
    folder: Path,
    laws: Mapping[str, Law],
    suite: Suite = SUITE,
    salt: str = "",
    told: tuple[str, ...] = (),
    only: Callable[[str, Scenario], bool] = lambda _spec, _scenario: True,
    answered: bool = True,
) -> Path:
    """Write records of some laws beside passive at 2.2 and the reference at 1.2; return the folder.

    Args:
        folder: The run's folder.
        laws: By controller.
        suite: The suite.
        salt: Private salt that the records say they are of.
        told: Controllers of the division "told".
        only: Which runs of which controller are there.
        answered: Whether questions on stability have an answer.
    """
    content = to_dict(suite)
    settings = RunSettings(suite.name, suite.version, content, LIMITS, commitment(salt))
    with Store.create(folder, settings) as store:
        store.begin_session("railenv benchmark")
        for spec, law in {PASSIVE: lambda _: 2.2, REFERENCE: lambda _: 1.2, **laws}.items():
            store.add_controller(spec, "told" if spec in told else "untold")
            scenarios = suite.scenarios
            if spec in (PASSIVE, REFERENCE):
                scenarios = references_of(suite)
            cells = [_cell(row(s.key, law(s))) for s in scenarios if only(spec, s)]
            if cells:
                store.add_package(spec, "all", cells, 60.0)
            if spec != REFERENCE and answered:
                for layout in sorted({s.layout for s in scenarios}):
                    answer = {"method": "exact", "critical_delay_s": 0.2, "proved": True}
                    store.add_stability(spec, layout, "nominal", 300.0, answer)
    return folder


def _cell(one: dict[str, Any]) -> Cell:
    place = {name: value for name, value in one.items() if name not in MEASURES}
    return Cell(**place, measures={name: one[name] for name in MEASURES})
