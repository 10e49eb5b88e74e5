"""What a controller's card shows: histories of the cells' own runs, roots that the oracle finds."""

from typing import Any

import numpy as np
import pytest
from benchmark_examples import BROKEN, SUITE, block, rows_of, suite_of

from eval.benchmark import run_work
from eval.benchmark_motion import (
    ACCELERATION_STEP,
    BIN,
    DELAYS,
    FORCE_STEP,
    MotionWork,
    envelope,
    motion_answer,
)
from eval.benchmark_roots import DEEPEST, LOCUS_DELAYS, root_motion
from eval.cells import controller_for
from eval.stability_answers import critical_delay_answer, delay_system
from railenv.errors import ArgumentError, ControllerError
from railenv.vehicle import lateral17, state_space

pytestmark = pytest.mark.slow

PLACE = ("lateral17", "nominal", "4", 300.0)
HOOK, LQG, DESIGNS = "skyhook:gain=35e3", "lqg", "lqg-delay:delay={delay}"


def roots_of(spec: str, layout: str = "4") -> dict[str, Any]:
    """The roots of a law on the nominal vehicle at 300 km/h."""
    controller = controller_for(spec, (*PLACE[:2], layout, PLACE[3]))
    return root_motion(controller, lateral17(layout="passive" if spec == "passive" else layout))


def rightmost(roots: dict[str, Any]) -> dict[float, float]:
    """The largest real part by delay."""
    found: dict[float, float] = {}
    for branch in roots["branches"]:
        for k, (real, _) in enumerate(branch["roots"], branch["first"]):
            delay = roots["delays_s"][k]
            found[delay] = max(found.get(delay, -np.inf), real)
    return found


@pytest.mark.parametrize("spec", [HOOK, "apg-linear", "passive"])
def test_histories_are_those_of_the_cells_with_the_same_delay_and_track(spec: str) -> None:
    # Runs of 5 s, so that the whole of a cell is shown.
    cells = rows_of(SUITE, spec)
    runs = motion_answer(MotionWork(SUITE, spec, "4"))["runs"]
    assert [run["delay_s"] for run in runs] == (list(DELAYS) if spec != "passive" else [0.0])
    for run in runs[:2]:
        key = f"v0/lateral17/nominal/4/300/german_low/constant:{1000 * run['delay_s']:g}/0"
        # Only the order of a sum over a thousand samples may differ.
        for end in ("front", "rear"):
            assert run[end]["rms"] == pytest.approx(cells[key][f"floor_rms_{end}"], rel=1e-13)
        if spec != "passive":
            assert run["force_rms"] == pytest.approx(cells[key]["force_rms"], rel=1e-13)


def test_the_largest_force_of_a_cell_is_in_its_history() -> None:
    suite = suite_of(block(layouts=("2",)))
    (cell,) = rows_of(suite, HOOK).values()
    answer = motion_answer(MotionWork(suite, HOOK, "2"))
    run = answer["runs"][1]
    peak = max(abs(v) for v in (*run["force"]["low"], *run["force"]["high"])) * FORCE_STEP
    # The first of two actuators; the larger one may be the second.
    assert peak <= cell["force_peak"] + FORCE_STEP
    assert peak > 0.5 * cell["force_peak"]
    assert answer["window_s"] == [1.0, 6.0]
    assert len(run["force"]["low"]) == round(5.0 / BIN)


def test_no_value_of_a_signal_lies_outside_its_envelope_and_the_ends_are_met() -> None:
    signal = np.random.Generator(np.random.PCG64(3)).standard_normal(1003)
    thin = envelope(signal, 8, 1e-3)
    low, high = np.array(thin["low"]) * 1e-3, np.array(thin["high"]) * 1e-3
    assert len(low) == -(-1003 // 8)
    bins = np.arange(1003) // 8
    # A thousandth of a step for rounding in the product.
    assert np.all(signal >= low[bins] - 1e-6)
    assert np.all(signal <= high[bins] + 1e-6)
    assert high.max() - signal.max() < 1.001e-3
    assert signal.min() - low.min() < 1.001e-3
    # Bins share a sample, so that a line has no gap between them.
    assert np.all(np.minimum(high[:-1], high[1:]) >= np.maximum(low[:-1], low[1:]) - 1e-6)


def test_fast_motion_is_not_folded_into_slow_motion() -> None:
    rate, per_bin = 200.0, 8
    fast = np.sin(2.0 * np.pi * 24.0 * np.arange(2000) / rate)
    # Picking every eighth sample, 25 a second, shows a wave of 1 Hz that is not there.
    picked = fast[::per_bin]
    assert np.argmax(np.abs(np.fft.rfft(picked))) / 10.0 == 1.0
    thin = envelope(fast, per_bin, 1e-4)
    # A bin of 40 ms holds a whole period of 42 ms but for 4 %: both ends come close to the peak.
    assert min(thin["high"]) > 0.9 / 1e-4
    assert max(thin["low"]) < -0.9 / 1e-4


def test_a_bin_without_a_number_throughout_has_none() -> None:
    signal = np.array([1.0, 2.0, 3.0, 4.0, np.nan, np.nan, np.nan])
    # The second bin begins with numbers, and the first reaches to the second's first sample.
    assert envelope(signal, 2, 1.0) == {"low": [1, None, None, None], "high": [3, None, None, None]}


def test_a_locus_crosses_the_axis_at_the_critical_delay() -> None:
    controller, vehicle = controller_for(HOOK, PLACE), lateral17()
    answer = critical_delay_answer(delay_system(controller, vehicle), vehicle, None, 0.3)
    critical = answer["critical_delay_s"]
    roots = roots_of(HOOK)
    assert roots["kind"] == "exact"
    assert roots["delays_s"] == list(LOCUS_DELAYS)
    crossing = []
    for branch in roots["branches"]:
        real = np.array([root[0] for root in branch["roots"]])
        for k in np.flatnonzero((real[:-1] < 0.0) & (real[1:] >= 0.0)):
            share = -real[k] / (real[k + 1] - real[k])
            crossing.append(0.01 * (branch["first"] + k + share))
    # Straight lines between delays 10 ms apart; the curve between is bent by less than that.
    assert min(crossing) == pytest.approx(critical, abs=2e-4)
    assert len(crossing) == sum(c["direction"] == "unstable" for c in answer["crossings"])


@pytest.mark.parametrize("layout", ["2", "4"])
def test_the_passive_vehicles_roots_are_its_own_at_one_delay(layout: str) -> None:
    roots = roots_of("passive", layout)
    assert (roots["kind"], roots["delays_s"]) == ("passive", [0.0])
    own = np.linalg.eigvals(state_space(lateral17(layout="passive")).A)
    own = own[(own.imag >= 0.0) & (own.real > DEEPEST) & (own.imag < 2 * np.pi * 6.0)]
    shown = np.array([complex(*root) for b in roots["branches"] for root in b["roots"]])
    # Six digits after the point are kept.
    np.testing.assert_allclose(np.sort_complex(shown), np.sort_complex(own), atol=1e-6)


@pytest.mark.parametrize("spec", [LQG, "apg-linear"])
def test_a_sampled_laws_rightmost_root_is_the_loops_growth_rate(spec: str) -> None:
    controller, vehicle = controller_for(spec, PLACE), lateral17()
    loop = controller.to_sampled_loop(vehicle, 0.01)
    roots = roots_of(spec)
    assert roots["kind"] == "sampled"
    found = rightmost(roots)
    for delay in (0.0, 0.1, 0.2, 0.3):
        assert found[delay] == pytest.approx(loop.growth_rate(delay), abs=1e-6)


def test_designs_stand_each_at_its_own_delay_and_are_not_joined() -> None:
    roots = roots_of(DESIGNS)
    assert (roots["kind"], roots["delays_s"]) == ("designs", [0.0, 0.1, 0.2, 0.3])
    assert {len(branch["roots"]) for branch in roots["branches"]} == {1}
    for delay, real in rightmost(roots).items():
        law = controller_for(DESIGNS.replace("{delay}", repr(delay)), PLACE)
        loop = law.to_sampled_loop(lateral17(), 0.01)
        assert real == pytest.approx(loop.growth_rate(delay), abs=1e-6)


def test_a_delay_that_changes_nothing_moves_no_root() -> None:
    found = rightmost(roots_of("zero"))
    assert len(found) == len(LOCUS_DELAYS)
    # The rightmost root of the vehicle without dampers and forces; six digits are kept.
    own = np.linalg.eigvals(state_space(lateral17()).A).real.max()
    np.testing.assert_allclose(list(found.values()), own, atol=1.01e-6)


@pytest.mark.parametrize("spec", ["apg-network", "semiactive-skyhook"])
def test_a_law_that_is_not_linear_has_no_roots_and_that_is_said(spec: str) -> None:
    assert "not linear" in roots_of(spec)["none"]


def test_a_wrong_oracle_of_the_users_own_costs_the_roots_alone(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def refuse(*_: object) -> None:
        raise ArgumentError("no such loop")

    monkeypatch.setattr("eval.benchmark_roots.delay_system", refuse)
    answer = motion_answer(MotionWork(SUITE, HOOK, "4"))
    assert answer["roots"] == {"none": "no such loop"}
    assert len(answer["runs"]) == 3


def test_a_controller_that_fails_says_so() -> None:
    with pytest.raises(ControllerError, match="gave up"):
        motion_answer(MotionWork(SUITE, f"{BROKEN}Raises", "4"))


def test_a_motion_is_a_kind_of_work_and_the_same_in_every_bit() -> None:
    work = MotionWork(SUITE, HOOK, "4")
    assert work.place == (HOOK, "4", "nominal", 300.0)
    assert run_work(work) == motion_answer(work)


def test_a_run_that_diverges_keeps_its_numbers_and_leaves_the_scale() -> None:
    # Two seconds are enough for a root of +1.5 1/s to show; the lqg without a delay is stable.
    runs = motion_answer(MotionWork(SUITE, LQG, "4"))["runs"]
    peaks = [max(map(abs, run["rear"]["high"])) * ACCELERATION_STEP for run in runs]
    assert peaks[0] < 0.5
    assert peaks[1] > 2.0 * peaks[0]
