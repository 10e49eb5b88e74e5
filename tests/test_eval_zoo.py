"""The zoo's cells and claims: distances, windows, comfort beside sky-hook, returns."""

from pathlib import Path

import numpy as np
import pytest

from baselines import make_controller
from baselines.design.cost import loop_cost
from baselines.design.model import design_model
from baselines.design.optimum import perfect_knowledge
from baselines.design.yardstick import optimum_at_force
from eval.zoo import (
    SKYHOOK_GAINS,
    Entry,
    Scale,
    best_skyhook,
    evaluate,
    mismatched,
    weighted_acceleration,
)
from eval.zoo_judge import window_around, yardstick
from eval.zoo_return import compared
from eval.zoo_table import LAWS
from eval.zoo_table import main as write_table
from railenv.errors import ArgumentError
from railenv.simulation import Trajectory
from railenv.stability.lifted_roots import unstable_at
from railenv.vehicle import lateral17

pytestmark = pytest.mark.slow

SHORT = Scale(tracks=1, duration=20.0, delays=(0.0, 0.1))
FAIR = Scale(tracks=4, duration=45.0, delays=(0.05, 0.1, 0.15, 0.2, 0.25, 0.3))
LINEAR = (
    "skyhook:gain=10e3",
    "skyhook-acc",
    "pid",
    "smith",
    "predictor",
    "lqg-delay",
    "lqg-delay:preview=1,noise=1,effort=1e-2",
)


@pytest.mark.parametrize("layout", ["2", "4"])
@pytest.mark.parametrize("preview", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_no_linear_law_beats_the_optimum_at_its_own_force(layout: str, preview: bool) -> None:
    vehicle = lateral17("paper_fit", layout, 300.0)
    model = design_model(vehicle, 0.1, preview=preview)
    for spec in LINEAR:
        law = make_controller(spec, layout)
        cost = loop_cost(model, law, 0.1)  # type: ignore[arg-type]
        best = optimum_at_force(model, perfect_knowledge(model), cost.force_rms)
        assert best is not None
        assert best.force_rms == pytest.approx(cost.force_rms, rel=1e-3)
        assert cost.weighted_acceleration > best.weighted_acceleration, spec


def test_the_optimum_comes_closer_with_more_force_and_less_delay() -> None:
    rows = np.array(yardstick("4", 300.0, (0.05, 0.1), (200.0, 400.0, 800.0), False))
    assert np.all(np.diff(rows, axis=0) < 0.0)
    assert np.all(np.diff(rows, axis=1) > 0.0)


def test_no_effort_reaches_a_force_beyond_all_weights() -> None:
    model = design_model(lateral17("paper_fit", "4", 300.0), 0.1)
    assert optimum_at_force(model, perfect_knowledge(model), 1e9) is None
    with pytest.raises(ArgumentError, match="force"):
        optimum_at_force(model, perfect_knowledge(model), 0.0)


def test_cells_of_a_static_law_carry_its_proved_critical_delay_and_damping() -> None:
    cells = evaluate(Entry("sky-hook", "skyhook:gain=35e3", "4", 300.0), SHORT)
    assert [cell["delay_s"] for cell in cells] == [0.0, 0.1]
    assert cells[0]["critical_delay_s"] == pytest.approx(0.2020265, abs=1e-7)
    assert cells[0]["critical_delay_proved"] is True
    assert cells[1]["unstable_roots"] == 0
    # The least damped mode below 5 Hz at 100 ms is the bogies' hunting.
    assert 0.05 < cells[1]["damping"] < 0.08
    assert cells[1]["in_a_row_distance"] > 1.0
    assert cells[1]["apart_distance"] > 1.0


def test_a_law_that_is_told_the_delay_is_stable_in_a_window_around_it() -> None:
    entry = Entry("lqg", "lqg-delay:delay={delay},noise=1,effort=1e-2", "4", 300.0)
    assert entry.knows_delay
    cells = evaluate(entry, Scale(tracks=1, duration=20.0, delays=(0.1,)))
    low, high = cells[0]["window_s"]
    # The detuned design stands 20 ms of error either way.
    assert low < 0.08
    assert high > 0.12
    assert "critical_delay_s" not in cells[0]


def test_the_window_ends_where_the_loop_turns_unstable() -> None:
    vehicle = lateral17("paper_fit", "4", 300.0)
    loop = make_controller("skyhook:gain=35e3").to_sampled_loop(vehicle, 0.01)  # type: ignore[attr-defined]
    low, high = window_around(loop, 0.1)
    assert low == 0.0
    # The sampled critical delay is 197.05 ms; the search ends within a millisecond.
    assert 0.19605 <= high <= 0.19706
    assert unstable_at(loop, high) == 0
    assert unstable_at(loop, high + 1e-3) > 0


def test_the_passive_vehicle_has_one_cell_for_all_delays_and_its_dampers_force() -> None:
    cells = evaluate(Entry("passive", "passive", "4", 300.0), SHORT)
    assert cells[0]["front"] == cells[1]["front"]
    assert cells[0]["force_rms"] > 100.0
    assert cells[0]["in_a_row_distance"] > 1.0
    assert "in_a_row_distance" not in cells[1]


def test_a_semi_active_law_is_judged_by_its_runs() -> None:
    cell = evaluate(Entry("on-off", "semiactive-onoff", "4", 300.0), SHORT)[1]
    assert not cell["diverged"]
    assert "unstable_roots" not in cell
    assert cell["in_a_row_weighted"] == cell["weighted"]


def test_a_wrong_delay_breaks_the_sharp_law_and_is_seen_in_its_cells() -> None:
    entry = Entry("lqg", "lqg-delay:delay={delay}", "4", 300.0)
    cells = mismatched(entry, 0.1, Scale(tracks=1, duration=20.0))
    by_delay = {round(cell["delay_s"], 3): cell for cell in cells}
    assert by_delay[0.1]["unstable_roots"] == 0
    assert by_delay[0.09]["unstable_roots"] > 0
    assert by_delay[0.11]["unstable_roots"] > 0
    assert [cell for cell in cells if "window_s" in cell] == [by_delay[0.1]]


def test_the_weighted_acceleration_of_a_sine_is_the_filters_gain() -> None:
    rate, frequency = 200.0, 2.0
    time = np.arange(1, 8001) / rate
    sine = np.sqrt(2.0) * np.sin(2.0 * np.pi * frequency * time)[None, :, None]
    names = ("floor_front_lateral_acceleration", "floor_rear_lateral_acceleration")
    run = Trajectory(time, names, np.repeat(sine, 2, axis=2))
    q = 1j * frequency
    above = 0.737 * q * (np.sqrt(1.911) + 0.25 * q)
    gain = abs(above / (1.0 + 1.563 * q + 0.277 * q**2 + 0.0368 * q**3))
    # The digital filter is within 0.005 % at 200 Hz; whole periods leave no rest.
    assert weighted_acceleration(run, 10.0)[0] == pytest.approx(gain, rel=2e-4)


@pytest.fixture(scope="module")
def beside() -> dict[str, list[dict[str, float]]]:
    """Passive, every sky-hook gain and four delay-aware laws on German low with sensor noise."""
    specs = {
        "passive": "passive",
        **{f"{gain:g}": f"skyhook:gain={gain}" for gain in SKYHOOK_GAINS},
        "plain": "lqg-delay:delay={delay}",
        "preview": "lqg-delay:delay={delay},preview=1",
    }
    return {name: evaluate(Entry(name, spec, "4", 300.0), FAIR) for name, spec in specs.items()}


@pytest.mark.parametrize(("law", "longest"), [("plain", 0.25), ("preview", 0.3)])
def test_lqg_with_delay_beats_passive_and_the_best_skyhook_at_both_ends(
    beside: dict[str, list[dict[str, float]]], law: str, longest: float
) -> None:
    hooks = {gain: beside[f"{gain:g}"] for gain in SKYHOOK_GAINS}
    for k, delay in enumerate(FAIR.delays):
        if delay > longest:
            continue
        _, best = best_skyhook(hooks, k)
        for end in ("front", "rear"):
            # Above the standard error (0.01) many times, up to 200 ms at least.
            assert beside[law][k][end] < min(beside["passive"][k][end], best[end]), (delay, end)


@pytest.mark.parametrize("track", ["tb3352", "german_low"])
@pytest.mark.parametrize("delay", [0.0, 0.1, 0.2, 0.3])
def test_the_optimums_return_is_above_passive_and_every_skyhook(track: str, delay: float) -> None:
    returns = compared(delay, track)
    for law in ("lqg-delay, sharp", "lqg-delay, detuned"):
        for word in ("", ", preview"):
            own = returns[law + word]
            others = [v for name, v in returns.items() if not name.startswith("lqg")]
            # Three of its own standard errors above the best mean of the others.
            assert own.mean() > max(v.mean() for v in others) + 3.0 * own.std() / 4.0


def test_the_table_is_written_by_one_command(tmp_path: Path) -> None:
    file = tmp_path / "table.md"
    write_table(["--smoke", "--jobs", "2", "--out", str(file)])
    text = file.read_text()
    for label, _ in LAWS:
        assert f"| {label} |" in text
    for heading in ("4 actuators, 300 km/h", "Told the wrong delay", "The environment's return"):
        assert f"## {heading}" in text
    # Every row has as many cells as its header.
    widths = [
        {line.count("|") for line in block.splitlines() if line.startswith("|")}
        for block in text.split("\n\n")
    ]
    assert all(len(width) <= 1 for width in widths)
