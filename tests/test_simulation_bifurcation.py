"""Critical speeds and bifurcation diagrams of oscillators whose branches are known exactly.

The oscillator is the normal form r' = r (s + a r^2 + b r^4 + c r^6), angle' = omega, with
s = 0.25 (V - 50): Hopf point at 50 m/s whatever a, b and c are, every limit cycle a circle.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numba import njit

from railenv.errors import ArgumentError, RailenvError
from railenv.simulation.bifurcation import (
    BifurcationDiagram,
    Kind,
    SpeedRamp,
    _judge,
    bifurcation_diagram,
)
from railenv.simulation.linear_speed import linear_critical_speed
from railenv.simulation.periodic_orbits import OrbitBranch, follow_orbits
from railenv.simulation.settling import Settling, settle

HOPF, SLOPE, OMEGA = 50.0, 0.25, 4 * np.pi
FOLD = 49.0  # of a = 1, b = -1: s = -r^2 + r^4 has its least value -1/4 at r^2 = 1/2
SETTLING = Settling(rest=0.01, block=2.0, samples=200, drift=1e-4, most_blocks=200)


@njit(cache=True)
def steps(
    states: np.ndarray, sigmas: np.ndarray, h: float, law: tuple, outputs: np.ndarray
) -> None:
    turn = np.cos(OMEGA * h), np.sin(OMEGA * h)  # the angle is stepped exactly
    for lane in range(len(states)):
        x, y = states[lane]
        for k in range(outputs.shape[1]):
            r = start = np.hypot(x, y)
            slope = 0.0
            total = 0.0
            for weight, share in ((1.0, 0.0), (2.0, 0.5), (2.0, 0.5), (1.0, 1.0)):
                r = start + share * h * slope
                q = r * r
                slope = r * (sigmas[lane] + q * (law[0] + q * (law[1] + q * law[2])))
                total += weight * slope
            scale = (start + h / 6.0 * total) / start if start > 0.0 else 0.0
            x, y = scale * (turn[0] * x - turn[1] * y), scale * (turn[1] * x + turn[0] * y)
            outputs[lane, k] = x
        states[lane] = x, y


@dataclasses.dataclass
class Oscillator:
    """The normal form as a hunting system; its output is x = r cos(angle)."""

    law: tuple[float, float, float]
    state_size: int = 2

    def advance(self, states, speeds, durations, samples):
        end, outputs = states.copy(), np.empty((len(states), samples))
        for lane in range(len(states)):
            part = slice(lane, lane + 1)
            sigma, h = SLOPE * (speeds[part] - HOPF), durations[lane] / samples
            steps(end[part], sigma, h, self.law, outputs[part])
        return end, outputs


SUBCRITICAL = Oscillator((1.0, -1.0, 0.0))
SUPERCRITICAL = Oscillator((-1.0, 0.0, 0.0))
TWO_CYCLES = Oscillator((-1.0, 2.0, -1.1))  # a small and a large one at 50.33 to 50.60 m/s
SMALL_AND_LARGE = Oscillator((-1.0, 2.2, -1.0))  # a small cycle above the Hopf point, a large below


def linearisation(speed: float) -> np.ndarray:
    s = SLOPE * (speed - HOPF)
    return np.array([[s, -OMEGA], [OMEGA, s]])


def subcritical_radius(speed: np.ndarray | float, branch: int) -> np.ndarray:
    return np.sqrt((1.0 + branch * np.sqrt(1.0 + 4 * SLOPE * (np.asarray(speed) - HOPF))) / 2)


def diagram(
    system: Oscillator, speeds: np.ndarray, settling: Settling = SETTLING, **options: Any
) -> BifurcationDiagram:
    options = {"linear": linear_critical_speed(linearisation, 40.0, 60.0), **options}
    return bifurcation_diagram(
        system, speeds, np.array([1e-3, 0.0]), np.array([1.5, 0.0]), settling, **options
    )


HALVES = np.arange(47.25, 53.0, 0.5)


@pytest.fixture(scope="module")
def subcritical() -> BifurcationDiagram:
    return diagram(SUBCRITICAL, HALVES)


@pytest.fixture(scope="module")
def branch() -> OrbitBranch:
    start = np.array([float(subcritical_radius(51.0, 1)), 0.0])
    return follow_orbits(
        SUBCRITICAL, start, 0.5, 51.0, lowest=45.0, highest=52.0, least_amplitude=0.05
    )


def test_the_linear_critical_speed_is_where_the_eigenvalues_cross() -> None:
    found = linear_critical_speed(linearisation, 40.0, 60.0, 7)
    assert found is not None
    assert found.speed == pytest.approx(HOPF, abs=1e-10)  # root finding at rounding
    assert found.frequency == pytest.approx(2.0, rel=1e-12)


def test_a_divergence_has_no_frequency() -> None:
    found = linear_critical_speed(lambda v: np.array([[v - 20.0]]), 10.0, 30.0)
    assert found is not None
    assert found.frequency == 0.0


def test_a_system_that_stays_stable_has_no_linear_critical_speed() -> None:
    assert linear_critical_speed(linearisation, 30.0, 49.0) is None


def test_a_scan_that_begins_unstable_is_refused() -> None:
    with pytest.raises(ArgumentError, match="begin at a lower speed"):
        linear_critical_speed(linearisation, 51.0, 60.0)


def test_the_verdict_on_a_subcritical_oscillator(subcritical: BifurcationDiagram) -> None:
    assert subcritical.kind is Kind.SUBCRITICAL
    assert subcritical.hysteresis == (49.25, 49.75)
    assert "49.25 to 49.75" in subcritical.reason


def test_the_way_up_rests_until_the_hopf_point_and_then_jumps(
    subcritical: BifurcationDiagram,
) -> None:
    up = subcritical.up
    assert np.array_equal(up.hunting, up.speeds > HOPF)
    large = subcritical_radius(up.speeds[up.hunting], 1)
    # 100 samples in a period miss the peak by up to (pi / 100)^2 / 2; drift adds 1e-4.
    np.testing.assert_allclose(up.amplitudes[up.hunting], large, rtol=7e-4)


def test_the_way_down_stays_on_the_large_cycle_until_the_fold(
    subcritical: BifurcationDiagram,
) -> None:
    down = subcritical.down
    assert np.array_equal(down.hunting, down.speeds > FOLD)
    large = subcritical_radius(down.speeds[down.hunting], 1)
    np.testing.assert_allclose(down.amplitudes[down.hunting], large, rtol=7e-4)
    np.testing.assert_allclose(down.frequencies[down.hunting], 2.0, rtol=1e-3)
    assert np.all(down.settled)


def test_the_way_up_begins_where_it_is_told_and_carries_its_state_on() -> None:
    # Begun on the large cycle above the fold, the way up never comes to rest.
    found = diagram(SUBCRITICAL, np.array([49.5, 49.75, 50.5]), straight=np.array([1.0, 0.0]))
    assert np.all(found.up.hunting)


def test_the_nonlinear_critical_speed_is_the_folds(subcritical: BifurcationDiagram) -> None:
    assert subcritical.hunting_speed - subcritical.rest_speed <= 0.05
    # Its upper end may lie lower than the fold by what drift lets pass: below 0.01 here.
    assert FOLD - 0.01 < subcritical.hunting_speed < FOLD + 0.06


def test_a_stricter_drift_brings_a_ramp_nearer_to_the_fold() -> None:
    speeds = np.array([48.5, 49.5, 50.5])
    found = [
        diagram(
            SUBCRITICAL,
            speeds,
            dataclasses.replace(SETTLING, drift=drift, most_blocks=2000),
            tolerance=1e-4,
        ).hunting_speed
        for drift in (1e-2, 1e-3, 1e-4)
    ]
    short = FOLD - np.array(found)
    assert short[0] > short[1] > short[2] > 0.0
    # Drift in a block at the ghost of the cycle is about 2 s times the missing s: 2 x 0.25 x short.
    np.testing.assert_allclose(short, [2e-2, 2e-3, 2e-4], rtol=0.8)


def test_any_number_of_lanes_brackets_the_same_speed() -> None:
    speeds = np.array([48.5, 49.5, 50.5])
    one = diagram(SUBCRITICAL, speeds, section_lanes=1, tolerance=0.02)
    five = diagram(SUBCRITICAL, speeds, section_lanes=5, tolerance=0.02)
    assert one.rest_speed < five.hunting_speed
    assert five.rest_speed < one.hunting_speed


def test_the_verdict_on_a_supercritical_oscillator() -> None:
    found = diagram(SUPERCRITICAL, HALVES)
    assert found.kind is Kind.SUPERCRITICAL
    assert found.hysteresis == ()
    assert found.linear is not None
    # Its amplitude 0.5 sqrt(V - 50) passes the bound for rest, 0.01, at 50.0004 m/s.
    assert found.hunting_speed == pytest.approx(found.linear.speed, abs=0.05)


def test_a_soft_onset_beside_a_large_cycle_is_not_called_subcritical() -> None:
    # Locally supercritical, yet rest and a large cycle exist side by side below the Hopf point.
    found = diagram(SMALL_AND_LARGE, HALVES)
    assert len(found.hysteresis) > 0
    assert found.kind is Kind.UNDECIDED
    assert "its amplitude is not that of the way down" in found.reason


def test_a_soft_onset_with_a_jump_to_a_large_cycle_above_is_supercritical() -> None:
    # s = q - 2 q^2 + 1.1 q^3 of the squared radius q turns back at 0.152 and 0.081.
    speeds = np.array([49.5, 49.9, 50.05, 50.2, 50.4, 50.5, 50.7, 51.0])
    found = diagram(TWO_CYCLES, speeds, dataclasses.replace(SETTLING, most_blocks=400))
    assert found.kind is Kind.SUPERCRITICAL
    assert found.hysteresis == ()
    assert "two cycles side by side at 50.4 to 50.5 m/s" in found.reason
    assert found.linear is not None
    assert found.hunting_speed == pytest.approx(found.linear.speed, abs=0.05)


def test_rest_above_the_linear_critical_speed_is_growth_too_slow_to_see() -> None:
    # At 50.05 m/s from 1e-3 to the bound for rest takes 184 s; waiting ends after 120 s.
    hurried = dataclasses.replace(SETTLING, most_blocks=60)
    found = diagram(SUPERCRITICAL, np.array([49.0, 50.05, 51.0, 52.0]), hurried)
    assert not found.up.hunting[1]
    assert found.down.hunting[2]
    assert found.hysteresis == ()
    assert found.kind is Kind.SUPERCRITICAL


def test_settled_rest_above_the_linear_critical_speed_is_no_hysteresis() -> None:
    # As where other motions die out over the growth, so that it looks settled.
    def ramp(speeds: list[float], amplitudes: list[float]) -> SpeedRamp:
        seen = np.array(amplitudes)
        settled = np.ones(len(seen), dtype=np.bool_)
        return SpeedRamp(
            np.array(speeds), seen, np.zeros_like(seen), settled, seen > 0.01, np.zeros((3, 2))
        )

    linear = linear_critical_speed(linearisation, 40.0, 60.0)
    up, down = ramp([49.0, 50.1, 52.0], [0.0, 0.0, 1.0]), ramp([52.0, 50.1, 49.0], [1.0, 0.1, 0.0])
    kind, _, hysteresis = _judge(up, down, linear, (50.01, 50.0, 0.02))
    assert kind is Kind.SUPERCRITICAL
    assert hysteresis == ()


def test_a_way_up_that_hunts_from_its_lowest_speed_leaves_the_kind_open() -> None:
    found = diagram(SUPERCRITICAL, np.array([51.0, 52.0]), linear=None)
    assert found.kind is Kind.UNDECIDED
    assert "begin lower" in found.reason


def test_a_lane_that_left_all_bounds_begins_anew_at_the_next_speed() -> None:
    # r' = r (s + r^2) leaves all bounds from a radius of 1.5 above s = -2.25, 41 m/s, dies below.
    found = diagram(Oscillator((1.0, 0.0, 0.0)), np.array([38.0, 40.0, 42.0]))
    assert not np.isfinite(found.down.amplitudes[0])
    assert not np.any(found.down.hunting[1:])
    assert np.all(found.down.settled[1:])


def test_speeds_too_far_apart_to_see_both_leave_the_kind_open() -> None:
    found = diagram(SUBCRITICAL, np.array([46.0, 48.0, 50.5, 52.0]))
    assert found.kind is Kind.UNDECIDED
    assert "nearer together" in found.reason


def test_without_hunting_there_is_no_nonlinear_critical_speed() -> None:
    found = diagram(SUBCRITICAL, np.array([40.0, 44.0, 48.0]))
    assert found.kind is Kind.UNDECIDED
    assert found.hunting_speed == np.inf
    assert found.rest_speed == 48.0


def test_hunting_at_every_speed_leaves_the_lower_end_open() -> None:
    found = diagram(SUBCRITICAL, np.array([49.5, 50.5, 51.5]))
    assert found.hunting_speed == 49.5
    assert found.rest_speed == 0.0


def test_a_motion_without_bound_is_reported_and_not_judged() -> None:
    found = diagram(Oscillator((1.0, 0.0, 0.0)), np.array([48.0, 49.0, 51.0]))
    assert found.kind is Kind.UNDECIDED
    assert "left all bounds" in found.reason
    assert not found.down.settled[0]


def test_the_same_ramps_give_the_same_numbers(subcritical: BifurcationDiagram) -> None:
    again = diagram(SUBCRITICAL, HALVES)
    assert np.array_equal(again.up.states, subcritical.up.states)
    assert np.array_equal(again.down.amplitudes, subcritical.down.amplitudes)
    assert again.hunting_speed == subcritical.hunting_speed


def test_what_a_lane_settles_to_does_not_depend_on_the_others() -> None:
    states = np.array([[1.2, 0.0], [0.0, 0.3], [0.9, 0.1]])
    speeds = np.array([51.0, 47.0, 49.2])
    together = settle(SUBCRITICAL.advance, states, speeds, SETTLING)
    for lane in range(3):
        part = slice(lane, lane + 1)
        alone = settle(SUBCRITICAL.advance, states[part], speeds[part], SETTLING)
        assert np.array_equal(alone.states[0], together.states[lane])
        assert alone.amplitudes[0] == together.amplitudes[lane]


def test_growth_from_below_the_bound_for_rest_is_not_rest() -> None:
    # At 50.4 m/s the radius grows by 22 % in a block, from 1e-4: 21 blocks to the bound of 0.01.
    result = settle(SUBCRITICAL.advance, np.array([[1e-4, 0.0]]), np.array([50.4]), SETTLING)
    assert result.hunting[0]
    assert result.amplitudes[0] == pytest.approx(float(subcritical_radius(50.4, 1)), rel=7e-4)


def test_a_block_shorter_than_two_periods_settles_nothing() -> None:
    short = dataclasses.replace(SETTLING, block=0.5, most_blocks=20)
    result = settle(SUBCRITICAL.advance, np.array([[1.1, 0.0]]), np.array([51.0]), short)
    assert result.hunting[0]
    assert not result.settled[0]


def test_the_fold_is_located_by_following_the_cycle(branch: OrbitBranch) -> None:
    (fold,) = branch.folds
    # The step of a 600th period is exact to 1e-10; at the fold speed varies with the square of
    # the position on the branch, the amplitude directly.
    assert fold.speed == pytest.approx(FOLD, abs=1e-8)
    assert fold.amplitude == pytest.approx(np.sqrt(0.5), abs=1e-4)
    assert fold.period == pytest.approx(0.5, rel=1e-9)


def test_every_cycle_of_the_branch_is_one_of_the_two_known(branch: OrbitBranch) -> None:
    for orbit in branch.orbits:
        radius = subcritical_radius(orbit.speed, 1 if orbit.stable else -1)
        # A peak between two of 600 samples is missed by up to (pi / 600)^2 / 2 = 1.4e-5; at the
        # fold the root in the formula turns rounding into its root.
        assert orbit.amplitude == pytest.approx(float(radius), rel=2e-5, abs=1e-5)
    assert {orbit.stable for orbit in branch.orbits} == {True, False}
    assert branch.residual < 1e-8


def test_floquet_multipliers_are_those_of_the_radial_equation(branch: OrbitBranch) -> None:
    for orbit in branch.orbits:
        q = float(np.sum(orbit.state**2))
        radial = np.exp(0.5 * (2 * q - 4 * q**2))
        # One-sided differences of 1e-6.
        np.testing.assert_allclose(np.sort(orbit.multipliers.real), sorted([1, radial]), atol=1e-5)


def test_the_branch_ends_near_the_hopf_point(branch: OrbitBranch) -> None:
    last = branch.orbits[-1]
    assert last.amplitude < 0.05
    assert HOPF - 0.01 < last.speed < HOPF  # s = -r^2: 0.01 m/s at 0.05


def test_a_supercritical_branch_has_no_fold() -> None:
    start = np.array([0.5, 0.0])
    found = follow_orbits(
        SUPERCRITICAL, start, 0.5, 51.0, lowest=45.0, highest=52.0, least_amplitude=0.05
    )
    assert found.folds == ()
    assert all(orbit.stable for orbit in found.orbits)


@pytest.mark.parametrize("state", [[0.9, 0.0], [1e-6, 0.0]])
def test_a_state_without_a_cycle_near_it_is_refused(state: list) -> None:
    with pytest.raises(RailenvError, match="no limit cycle near"):
        follow_orbits(SUBCRITICAL, np.array(state), 0.5, 45.0, lowest=40.0, highest=50.0)


def test_a_wrong_period_does_not_pass_the_straight_run_for_a_cycle() -> None:
    with pytest.raises(RailenvError, match="no limit cycle near"):
        follow_orbits(SUBCRITICAL, np.array([0.9, 0.0]), 0.13, 45.0, lowest=40.0, highest=50.0)


@pytest.mark.parametrize("speeds", [[50.0], [50.0, 49.0], [0.0, 1.0], [[1.0, 2.0]]])
def test_speeds_that_do_not_increase_are_refused(speeds: list) -> None:
    with pytest.raises(ArgumentError, match="speeds"):
        diagram(SUBCRITICAL, np.array(speeds))


def test_states_of_the_wrong_length_are_named() -> None:
    good, bad = np.zeros(2), np.zeros(3)
    for small, large, name in ((bad, good, "small"), (good, bad, "large")):
        with pytest.raises(ArgumentError, match=name):
            bifurcation_diagram(SUBCRITICAL, HALVES, small, large, SETTLING)
    with pytest.raises(ArgumentError, match="straight"):
        bifurcation_diagram(SUBCRITICAL, HALVES, good, good, SETTLING, straight=bad)
    with pytest.raises(ArgumentError, match="state"):
        follow_orbits(SUBCRITICAL, bad, 0.5, 51.0, lowest=45.0, highest=52.0)
    with pytest.raises(ArgumentError, match="between lowest"):
        follow_orbits(SUBCRITICAL, np.ones(2), 0.5, 51.0, lowest=52.0, highest=53.0)


@pytest.mark.parametrize(
    "change", [{"rest": 0.0}, {"drift": -1.0}, {"samples": 5}, {"most_blocks": 2}]
)
def test_settling_refuses_what_cannot_settle(change: dict) -> None:
    with pytest.raises(ArgumentError, match=next(iter(change))):
        dataclasses.replace(SETTLING, **change)


@pytest.mark.parametrize("with_branch", [True, False])
def test_the_picture_is_written(
    subcritical: BifurcationDiagram, branch: OrbitBranch, with_branch: bool, tmp_path: Path
) -> None:
    pytest.importorskip("matplotlib")
    from eval.bifurcation_plot import plot_bifurcation

    path = tmp_path / "bifurcation.png"
    plot_bifurcation(subcritical, path, branch=branch if with_branch else None, title="normal form")
    assert path.read_bytes()[:4] == b"\x89PNG"
