"""Proofs about loops with a finite history, against eigenvalues and against the other proof."""

from fractions import Fraction
from types import SimpleNamespace

import numpy as np
import pytest

from railenv.errors import ArgumentError
from railenv.stability import FiniteHistoryLoop, SampledLoop, certify
from railenv.stability.proof.ball_matrices import rational
from railenv.stability.proof.history_boxes import Boxes, Cover
from railenv.stability.proof.history_count import count_outside
from railenv.stability.proof.history_function import HistoryFunction, Polynomials
from railenv.stability.proof.history_models import ORDER
from railenv.stability.proof.history_modes import DEGREE, held_modes
from railenv.stability.proof.history_range import HistoryRange

T = 0.125  # a double, so that whole periods are exact


def loop(A, B, C, D=None, measured=None, commanded=None, told=(0.0,), spread=None, period=T):
    """Build a loop; gains have the shape (knots, ages, signals, ...)."""
    A, B, C = (np.array(M, dtype=float) for M in (A, B, C))
    D = np.zeros((len(C), B.shape[1])) if D is None else np.array(D, dtype=float)
    spread = np.eye(B.shape[1]) if spread is None else np.array(spread, dtype=float)
    measured = np.array(measured, dtype=float)
    q, r = len(measured), spread.shape[1]
    commanded = np.zeros((q, 0, r, r)) if commanded is None else np.array(commanded, dtype=float)
    return FiniteHistoryLoop(A, B, C, D, period, measured, commanded, spread, np.array(told))


def lag(gains, told=(0.0,), commanded=None, D=None, pole=-1.0):
    """A first-order plant under u_k = -g y_k, one gain per knot."""
    measured = np.array(gains, dtype=float).reshape(-1, 1, 1, 1)
    return loop([[pole]], [[1.0]], [[1.0]], D, measured, commanded, told)


def random_loop(seed):
    """A random loop with a stable plant, a schedule and three forces from one or two signals."""
    rng = np.random.default_rng(seed)
    r = 1 + seed % 2
    A = rng.normal(size=(3, 3)) * 2
    A -= (np.linalg.eigvals(A).real.max() + rng.uniform(0.1, 3.0)) * np.eye(3)
    size = rng.uniform(0.02, 0.25)
    return loop(
        A,
        rng.normal(size=(3, 3)),
        rng.normal(size=(2, 3)),
        0.3 * rng.normal(size=(2, 3)),
        size * rng.normal(size=(3, 3, r, 2)),
        2 * size * rng.normal(size=(3, 2, r, r)),
        (0.0, 0.13, 0.3),
        rng.normal(size=(3, r)),
    )


def worst_growth(system, low, high, error):
    """Largest growth rate on a grid, both sides of whole periods included."""
    edges = [d * T + s for d in range(5) for s in (-1e-9, 0.0)]
    delays = [x for x in (*np.linspace(low, high, 13), *edges) if low <= x <= high]
    return max(
        system.growth_rate(delay, max(delay + e, 0.0))
        for delay in delays
        for e in np.linspace(-error, error, 5)
    )


def test_growth_rate_is_that_of_the_general_sampled_loop():
    system = random_loop(1)
    S = system.spread
    general = SampledLoop.from_feedback(
        system.A,
        system.B,
        system.C,
        system.D,
        T,
        S @ system.measured,
        S @ system.commanded @ np.linalg.pinv(S),
        system.told,
    )
    for delay, told in ((0.0, 0.0), (0.2, 0.2), (0.31, 0.05), (0.1, 0.5)):
        # Eigenvalues of maps of 7 to 40 rows, of order one.
        assert system.growth_rate(delay, told) == pytest.approx(
            general.growth_rate(delay, told), rel=1e-7
        )


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(10))
def test_no_verdict_is_contradicted_by_eigenvalues_on_a_grid(seed):
    system, low, high, error = random_loop(seed), 0.02, 0.33, 0.03
    certificate = certify(system, (low, high), told_error=error)
    worst = worst_growth(system, low, high, error)
    if certificate.verdict == "STABLE":
        assert worst < 0.0
    elif certificate.verdict == "UNSTABLE":
        claim = certificate.claim
        assert system.growth_rate(claim["witness"], claim["witness_told"]) > 0.0
        assert abs(claim["witness"] - claim["witness_told"]) <= error
        assert low <= claim["witness"] <= high
    # Clear cases are decided.
    if abs(worst) > 0.05:
        assert certificate.verdict == ("STABLE" if worst < 0.0 else "UNSTABLE")


@pytest.mark.slow
def test_the_random_loops_are_of_both_kinds():
    worst = [worst_growth(random_loop(seed), 0.02, 0.33, 0.03) for seed in range(10)]
    assert sum(w < 0.0 for w in worst) >= 3
    assert sum(w > 0.0 for w in worst) >= 3


@pytest.mark.slow
@pytest.mark.parametrize("gain", [3.0, 8.0])
def test_it_ends_where_the_other_proof_of_sampled_loops_ends(gain):
    system = lag([gain])
    # The critical delay of x' = -x - g x held: by bisection of the growth rate.
    low, high = 0.0, 3.0
    for _ in range(40):
        middle = (low + high) / 2
        low, high = (middle, high) if system.growth_rate(middle) < 0 else (low, middle)
    for share, verdict in ((0.98, "STABLE"), (1.02, "UNSTABLE")):
        for form in (system, system.to_sampled_loop()):
            assert certify(form, (0.0, share * low)).verdict == verdict


@pytest.mark.slow
def test_a_narrow_island_of_told_delays_is_not_missed():
    def island(height):
        told = (0.0, 0.1870, 0.1875, 0.1880, 0.5)
        return lag([1.0, 1.0, height, 1.0, 1.0], told)

    # At 0.25 s this gain grows; on either side of 0.187 to 0.188 s the gain is 1.
    assert island(12.0).growth_rate(0.25, 0.1875) > 0.0
    assert certify(island(1.0), (0.2, 0.3), told_error=0.1).verdict == "STABLE"
    assert certify(island(12.0), (0.2, 0.3), told_error=0.1).verdict != "STABLE"
    assert certify(island(12.0), (0.2, 0.3), told_error=0.005).verdict == "STABLE"


@pytest.mark.slow
def test_a_narrow_window_of_unstable_delays_is_not_missed():
    # A weakly damped oscillator: the feedback pumps it at some delays and damps it at others.
    A = [[0.0, 1.0], [-100.0, -0.2]]
    system = loop(A, [[0.0], [1.0]], [[0.0, 1.0]], None, [[[[0.19]]]], period=0.0625)
    assert system.growth_rate(0.0) < 0.0
    delays = np.linspace(0.0, 0.6, 601)
    growth = np.array([system.growth_rate(delay) for delay in delays])
    assert growth.max() < 0.0  # 0.19 < 0.2: never unstable
    assert certify(system, (0.0, 0.6)).verdict == "STABLE"
    pumped = loop(A, [[0.0], [1.0]], [[0.0, 1.0]], None, [[[[0.21]]]], period=0.0625)
    growth = np.array([pumped.growth_rate(delay) for delay in delays])
    assert 0.0 < (growth > 0.0).mean() < 0.3
    assert certify(pumped, (0.0, 0.6)).verdict != "STABLE"


def jumping():
    """A loop whose feedthrough makes it unstable below one period of delay and stable from there.

    y_k = D v_(k-1-d) but for a small decoupled state, v_k = -g y_k - F v_(k-1): with g D = F = 0.6
    z = -1.2 for d = 0, and z^2 + 0.6 z + 0.6 = 0, |z|^2 = 0.6, for d = 1.
    """
    return lag([0.6], commanded=[[[[0.6]]]], D=[[1.0]], pole=-50.0)


def test_both_sides_of_a_jump_at_a_whole_period_are_judged():
    assert certify(jumping(), (T, 1.9 * T)).verdict == "STABLE"
    certificate = certify(jumping(), (T - 1e-6, 1.9 * T))
    assert certificate.verdict == "UNSTABLE"
    assert certificate.claim["witness"] < T
    # The delay just below 2 T is stable, the one at 2 T is not (three periods of memory).
    at_two = jumping().growth_rate(2 * T)
    assert (certify(jumping(), (T, 2 * T)).verdict == "STABLE") == (at_two < 0.0)


def test_a_largest_delay_rounded_just_below_a_whole_period_counts_as_that_period():
    wanted = HistoryRange(0.0, 0.3, 0.0, 0.01, np.array([0.0]))
    assert Fraction(0.3) < 30 * Fraction(0.01)
    assert wanted.last == 30
    assert HistoryRange(0.0, 0.2999, 0.0, 0.01, np.array([0.0])).last == 29


@pytest.mark.slow
def test_a_plant_that_is_unstable_by_itself_is_counted_right():
    assert certify(lag([3.0], pole=1.0), (0.0, 0.1)).verdict == "STABLE"
    weak = certify(lag([0.5], pole=1.0), (0.0, 0.1))
    assert (weak.verdict, weak.unstable_roots) == ("UNSTABLE", 1)
    certificate = certify(lag([0.0], pole=1.0), 0.05)
    assert (certificate.verdict, certificate.unstable_roots) == ("UNSTABLE", 1)


@pytest.mark.parametrize("seed", [2, 5, 8])
def test_the_number_of_unstable_eigenvalues_is_the_true_one(seed):
    system = random_loop(seed)
    strong = loop(
        system.A,
        system.B,
        system.C,
        system.D,
        20 * system.measured,
        system.commanded,
        system.told,
        system.spread,
    )
    certificate = certify(strong, 0.2, told_error=0.0)
    values = np.linalg.eigvals(strong.to_sampled_loop(0.2).lifted_matrix(0.2))
    outside = int(np.sum(np.abs(values) > 1.0))
    assert outside > 0
    assert (certificate.verdict, certificate.unstable_roots) == ("UNSTABLE", outside)


def left_over(entries, rest=0.0):
    """Boxes over which a polynomial in sigma, rho and x is not shown to have no zero."""
    coefs = np.zeros((1, 3, DEGREE + 1, ORDER + 1), complex)
    for place, value in entries.items():
        coefs[(0, *place)] = value
    whole = Boxes(np.zeros(1, dtype=int), np.zeros((1, 2)), np.ones((1, 2)))
    cover = Cover(Polynomials(coefs, np.array([rest])), 100_000)
    return cover.run(whole, lambda boxes: np.ones(len(boxes), dtype=bool))


def test_a_polynomial_is_free_of_zeros_only_above_its_bound():
    constant = (0, 0, 0)
    assert len(left_over({constant: 1.0}, 0.99)) == 0
    assert len(left_over({constant: 1.0}, 1.01)) == 1


@pytest.mark.slow
def test_no_zero_of_a_polynomial_is_lost():
    # 1 + 0.75 sigma + 0.75 rho is zero on a line across one corner.
    plane = left_over({(0, 0, 0): 1.0, (1, 0, 0): 0.75, (0, 1, 0): 0.75})
    for rho in np.linspace(-1.0, -1 / 3, 7):
        point = np.array([-(1 + 0.75 * rho) / 0.75, rho])
        held = np.abs(plane.middle - point) <= plane.half + 1e-12
        assert np.any(np.all(held, axis=1))
    # 1 + 0.9 sigma + 0.9 i rho is zero nowhere, and no box is left over.
    assert len(left_over({(0, 0, 0): 1.0, (1, 0, 0): 0.9, (0, 1, 0): 0.9j})) == 0


@pytest.mark.slow
@pytest.mark.parametrize("arcs", [1, 4])
def test_turns_are_counted_whatever_the_first_arcs(arcs):
    # v_k = -1.5 v_(k-7) beside a plant that is not fed back: 1 + 1.5 w^7 has seven zeros inside.
    modes = held_modes(
        np.array([[-1.0]]),
        rational(np.ones((1, 2))),
        np.ones((1, 1)),
        rational(np.zeros((1, 2))),
        T,
    )
    commanded = np.zeros((1, 7, 2, 2))
    commanded[0, 6, 0, 0] = 1.5
    function = HistoryFunction(modes, np.zeros((1, 1, 2, 1)), commanded, 1)
    points = HistoryRange(0.0, T, 0.0, T, np.array([0.0])).points([(0, 0.01, 0.0), (1, 0.02, 0.0)])
    assert count_outside(function, *points, arcs, 2.0**-20) == [7, 7]


class Constant:
    """A characteristic function that is one, known to within a bound."""

    modes = SimpleNamespace(outside=0)

    def __init__(self, rest):
        self.rest = rest

    def on(self, arc, wholes, intervals):
        coefs = np.zeros((len(wholes), 3, DEGREE + 1, ORDER + 1), complex)
        coefs[:, 0, 0, 0] = 1.0
        return Polynomials(coefs, np.full(len(wholes), self.rest))


def test_nothing_is_counted_where_the_function_may_vanish():
    points = HistoryRange(0.0, T, 0.0, T, np.array([0.0])).points([(0, 0.01, 0.0)])
    assert count_outside(Constant(0.99), *points, 2, 0.1) == [0]
    assert count_outside(Constant(1.01), *points, 2, 0.1) == [None]


def test_everything_that_may_be_told_is_in_a_box():
    knots = np.array([0.05, 0.1, 0.2])
    wanted = HistoryRange(0.03, 0.27, 0.04, 0.0625, knots)
    wholes, intervals, boxes = wanted.cases()
    rng = np.random.default_rng(4)
    for delay in rng.uniform(0.03, 0.27, 200):
        told = min(max(delay + rng.uniform(-0.04, 0.04), 0.0, 0.05), 0.2)
        d = int(delay // 0.0625)
        rho = 2 * (delay - d * 0.0625) / 0.0625 - 1
        held = False
        for case in range(len(boxes)):
            low, high = knots[intervals[case]], knots[intervals[case] + 1]
            point = np.array([2 * (told - low) / (high - low) - 1, rho])
            inside = np.all(np.abs(point - boxes.middle[case]) <= boxes.half[case])
            if wholes[case] == d and inside:
                tiny = Boxes(np.array([case]), point[None], np.full((1, 2), 1e-9))
                held = bool(wanted.wanted(wholes[[case]], intervals[[case]], tiny)[0])
        assert held


def test_boxes_far_from_what_may_be_told_are_dropped():
    knots = np.array([0.0, 0.3])
    wanted = HistoryRange(0.0, 0.3, 0.02, 0.1, knots)
    # Delay 0.2 s, told 0.1 s.
    far = Boxes(np.zeros(1, dtype=int), np.array([[-1 / 3, -1.0]]), np.full((1, 2), 0.01))
    assert not wanted.wanted(np.array([2]), np.array([0]), far)[0]


def test_a_law_that_is_not_scheduled_needs_no_told_delay():
    certificate = certify(lag([2.0]), (0.0, 0.1), told_error=5.0)
    assert certificate.verdict == "STABLE"
    assert certificate.claim["witness_told"] is None


def test_a_proof_that_is_given_up_says_where():
    certificate = certify(lag([3.0]), (0.0, 0.2), most_tests=5)
    assert certificate.verdict == "UNDECIDED"
    assert "work allowed" in certificate.reason
    assert "Hz" in certificate.reason


def test_a_loop_on_its_stability_limit_is_undecided_not_stable():
    # x' = 0 x would be on the circle without control: no proof rests on such a plant.
    certificate = certify(lag([1.0], pole=0.0), (0.0, 0.1))
    assert certificate.verdict == "UNDECIDED"
    assert "unit circle" in certificate.reason


def test_arguments_that_cannot_be_meant_are_refused():
    system = lag([1.0])
    for delay, said in (([0.1], "list"), ((0.2, 0.1), "reversed"), (-0.1, "negative")):
        with pytest.raises(ArgumentError, match=said):
            certify(system, delay)
    with pytest.raises(ArgumentError, match="constant delays"):
        certify(system, 0.1, jitter=0.01)
    with pytest.raises(ArgumentError, match="told_error"):
        certify(system, 0.1, told_error=-0.01)
    with pytest.raises(ArgumentError, match="periods"):
        certify(system, 1e4)
    many = loop(-np.eye(3), np.eye(3), np.eye(3), None, np.zeros((1, 1, 3, 3)))
    with pytest.raises(ArgumentError, match="bogies"):
        certify(many, 0.1)
    with pytest.raises(ArgumentError, match="measured has shape"):
        loop([[-1.0]], [[1.0]], [[1.0]], None, np.zeros((1, 1, 2, 1)))
    with pytest.raises(ArgumentError, match="rising"):
        lag([1.0, 1.0], (0.1, 0.1))
    with pytest.raises(ArgumentError, match="told is missing"):
        lag([1.0, 1.0], (0.0, 0.1)).gains()
