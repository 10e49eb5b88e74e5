"""Proved crossings: closed forms, degenerate loops, and the exact arithmetic underneath.

Closed forms are compared to 12 digits: the proof rounds the last digit only, the closed forms are
evaluated in doubles.
"""

import signal
from collections.abc import Generator
from contextlib import contextmanager
from itertools import pairwise
from math import acos, pi, sqrt

import numpy as np
import pytest
from flint import acb, arb, fmpq, fmpq_poly, fmpz_poly
from scipy.linalg import block_diag

from railenv.errors import ArgumentError, NeutralLoopError
from railenv.stability import (
    CriticalDelays,
    DelaySystem,
    count_unstable,
    critical_delays,
    estimated_critical_delays,
)
from railenv.stability.certify import certify
from railenv.stability.proof.axis_crossings import proved_crossings
from railenv.stability.proof.characteristic import Characteristic, characteristic
from railenv.stability.proof.polynomials import (
    positive_zeros,
    refined,
    squarefree_factors,
    unstable_zeros,
)
from railenv.stability.proof.precision import precision
from railenv.stability.proof.resultant import irreducible_factors, resultant

DIGITS = 1e-12


def scalar(a: float, k: float) -> DelaySystem:
    """x' = a x - k x(t - tau)."""
    return DelaySystem([[a]], [[1.0]], [[k]])


def oscillator(k: float, c: float, g: float, p: float = 0.0) -> DelaySystem:
    """x'' + c x' + k x = -g x'(t - tau) - p x(t - tau)."""
    return DelaySystem([[0.0, 1.0], [-k, -c]], [[0.0], [1.0]], [[p, g]])


def side_by_side(*loops: DelaySystem) -> DelaySystem:
    """Loops that do not know of each other."""
    return DelaySystem(*(block_diag(*(getattr(x, n) for x in loops)) for n in ("A", "B", "K")))


def quarter_car() -> DelaySystem:
    """Body 250 kg on 16 kN/m, 1 kN s/m; wheel 40 kg on 160 kN/m; sky-hook 1.5 kN s/m."""
    body, wheel, spring, damper, tyre = 250.0, 40.0, 16e3, 1e3, 160e3
    A = [
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [-spring / body, spring / body, -damper / body, damper / body],
        [spring / wheel, -(spring + tyre) / wheel, damper / wheel, -damper / wheel],
    ]
    return DelaySystem(A, [[0.0], [0.0], [1 / body], [-1 / wheel]], [[0.0, 0.0, 1.5e3, 0.0]])


def velocity_crossings(k: float, c: float, g: float, longest: float) -> list[tuple[float, int]]:
    """cos(omega tau) = -c / g, omega = (+-sqrt(g^2 - c^2) + sqrt(g^2 - c^2 + 4 k)) / 2."""
    root = sqrt((g - c) * (g + c))
    found: list[tuple[float, int]] = []
    for sign in (1, -1):
        omega = (sign * root + sqrt(root**2 + 4 * k)) / 2
        phase = acos(-c / g) if sign > 0 else 2 * pi - acos(-c / g)
        while phase <= longest * omega:
            found.append((phase / omega, sign))
            phase += 2 * pi
    return sorted(found)


def delays_of(answer: CriticalDelays) -> list[float]:
    return [c.delay for c in answer.crossings]


def directions_of(answer: CriticalDelays) -> list[int]:
    return [c.direction for c in answer.crossings]


def assert_staircase_is_the_count(system: DelaySystem, longest: float) -> None:
    """Between any two crossings the argument principle counts what the crossings say."""
    answer = critical_delays(system, longest)
    assert answer.proved
    for low, high in pairwise([0.0, *delays_of(answer), longest]):
        if high - low > 1e-6 * longest:
            middle = (low + high) / 2
            counted = certify(system, middle)
            assert counted.proved, counted.reason
            assert counted.unstable_roots == answer.unstable_roots(middle)


@contextmanager
def ended_after(seconds: int) -> Generator[None, None, None]:
    """Let a search that never ends fail instead of holding up everything."""

    def stop(*_: object) -> None:
        raise AssertionError(f"not answered within {seconds} s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(seconds)
    try:
        yield
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


# --- closed forms


def test_the_delayed_integrator_crosses_at_every_full_turn_past_a_quarter() -> None:
    answer = critical_delays(scalar(0.0, 1.0), 30.0)
    expected = [pi / 2 + 2 * pi * k for k in range(5)]
    assert delays_of(answer) == pytest.approx(expected, rel=DIGITS)
    assert [c.mode.root for c in answer.crossings] == pytest.approx([1j] * 5, rel=DIGITS)
    assert directions_of(answer) == [1] * 5


@pytest.mark.parametrize(("a", "k"), [(0.5, 1.0), (-1.0, 2.0), (-0.3, 0.7), (2.0, 2.5)])
def test_the_scalar_loop_crosses_where_its_closed_form_says(a: float, k: float) -> None:
    # a = k cos(omega tau), omega = k sin(omega tau)
    omega = sqrt((k - a) * (k + a))
    phase = acos(a / k)
    answer = critical_delays(scalar(a, k), 4.0)
    assert answer.proved
    assert delays_of(answer) == pytest.approx(
        [(phase + 2 * pi * n) / omega for n in range(20) if phase + 2 * pi * n <= 4.0 * omega],
        rel=DIGITS,
    )
    assert answer.crossings[0].mode.root.imag == pytest.approx(omega, rel=DIGITS)


@pytest.mark.parametrize("g", [0.7, 1.5, 4.0, 50.0])
def test_delayed_velocity_feedback_crosses_at_both_frequencies(g: float) -> None:
    answer = critical_delays(oscillator(56.8, 0.6, g), 2.0)
    expected = velocity_crossings(56.8, 0.6, g, 2.0)
    assert answer.proved
    assert delays_of(answer) == pytest.approx([d for d, _ in expected], rel=DIGITS)
    assert directions_of(answer) == [s for _, s in expected]


def test_the_sky_hook_oscillator_has_the_published_staircase() -> None:
    omega = 2 * pi * 1.2
    answer = critical_delays(oscillator(omega**2, 0.1 * omega, 0.6 * omega), 0.9)
    assert delays_of(answer)[0] == pytest.approx(0.172221357583832, rel=1e-14)
    assert answer.crossings[0].mode.root.imag == pytest.approx(10.0930827070531, rel=1e-14)
    assert delays_of(answer)[2] == pytest.approx(0.806918817887213, rel=1e-14)
    assert [answer.unstable_roots(d) for d in (0.17, 0.2, 0.8, 0.82)] == [0, 2, 4, 2]


def test_the_double_integrator_under_delayed_pd_has_the_published_crossing() -> None:
    first = critical_delays(oscillator(0.0, 0.0, 1.0, 1.0)).first
    assert first is not None
    assert first.delay == pytest.approx(0.711118648715793, rel=1e-14)
    assert first.mode.root.imag == pytest.approx(1.27201964951407, rel=1e-14)


def test_every_stable_window_of_the_quarter_car_is_reported() -> None:
    answer = critical_delays(quarter_car(), 1.0)
    assert answer.proved
    (start, lost), (found, end) = answer.stable_windows
    assert start == 0.0
    assert lost == pytest.approx(0.211488914316151, rel=1e-13)  # printed with 15 digits
    assert found == pytest.approx(0.694811607637179, rel=1e-13)
    assert end == pytest.approx(0.8269, abs=5e-5)  # printed with 4
    assert_staircase_is_the_count(quarter_car(), 1.0)


def test_the_papers_loop_has_eleven_crossings_in_two_seconds(loop: DelaySystem) -> None:
    answer = critical_delays(loop, 2.0)
    assert answer.proved
    assert len(answer.crossings) == 11
    assert answer.first is not None
    assert answer.first.delay == pytest.approx(0.202026, abs=5e-7)  # as printed
    assert answer.first.frequency_hz == pytest.approx(1.32299, abs=5e-6)


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_static_loop_gain_of_exactly_one_is_no_crossing(sign: float) -> None:
    # x'' + x' / 2 + 4 x = -+4 x(t - tau): |G| = 1 at omega = 0 and at omega^2 = 8 - 1/4, where
    # (4 - omega^2) + j omega / 2 = -+4 exp(-j omega tau)
    omega = sqrt(7.75)
    phase = np.angle(-sign * 4.0 / complex(4.0 - omega**2, omega / 2)) % (2 * pi)
    with ended_after(5):
        answer = critical_delays(oscillator(4.0, 0.5, 0.0, sign * 4.0), 3.0)
    assert delays_of(answer) == pytest.approx(
        [d for d in (phase / omega, (phase + 2 * pi) / omega) if d <= 3.0], rel=DIGITS
    )


# --- near and on the edge of crossing at all


def test_a_gain_below_the_damping_is_proved_stable_for_every_delay() -> None:
    answer = critical_delays(oscillator(50.0, 0.6, np.nextafter(0.6, 0.0)))
    assert answer.proved
    assert answer.delay_independent
    assert answer.critical_delay is None


@pytest.mark.parametrize("excess", [1e-3, 1e-6, 1e-9, 1e-12])
def test_both_of_two_nearly_tangent_crossings_are_found(excess: float) -> None:
    g = 0.5 * (1.0 + excess)
    answer = critical_delays(oscillator(4.0, 0.5, g), 3.0)
    expected = velocity_crossings(4.0, 0.5, g, 3.0)
    assert answer.proved
    assert directions_of(answer) == [1, -1]
    # the acos of the closed form loses half its digits at the tangent
    assert delays_of(answer) == pytest.approx([d for d, _ in expected], rel=1e-9)


def test_the_last_double_above_the_tangent_still_has_two_crossings() -> None:
    answer = critical_delays(oscillator(4.0, 0.5, np.nextafter(0.5, 1.0)), 3.0)
    assert directions_of(answer) == [1, -1]


@pytest.mark.parametrize(("k", "c"), [(4.0, 0.5), (2.3, 0.3), (56.8, 1e-3)])
def test_a_tangent_loop_touches_the_axis_and_goes_back(k: float, c: float) -> None:
    # |G| peaks at exactly one at omega^2 = k, where omega tau = pi
    answer = critical_delays(oscillator(k, c, c), 3.0)
    assert answer.proved
    expected = [(2 * n + 1) * pi / sqrt(k) for n in range(20)]
    assert delays_of(answer) == pytest.approx([d for d in expected if d <= 3.0], rel=DIGITS)
    assert set(directions_of(answer)) == {0}


def test_a_touch_splits_the_stable_window() -> None:
    answer = critical_delays(oscillator(4.0, 0.5, 0.5), 3.0)
    touch = pytest.approx(pi / 2, rel=DIGITS)
    assert answer.stable_windows == ((0.0, touch), (touch, 3.0))
    assert answer.critical_delay == touch


def test_a_touch_is_not_delay_independent() -> None:
    assert not critical_delays(oscillator(4.0, 0.5, 0.5), 0.1).delay_independent


# --- loops side by side


@pytest.mark.parametrize("copies", [2, 3])
def test_identical_loops_cross_together(copies: int) -> None:
    one = oscillator(40.0, 0.6, 4.0)
    answer = critical_delays(side_by_side(*[one] * copies), 1.5)
    alone = critical_delays(one, 1.5)
    assert answer.proved
    assert delays_of(answer) == pytest.approx(sorted(delays_of(alone) * copies), rel=DIGITS)
    low, high = alone.crossings[0].delay - 1e-6, alone.crossings[0].delay + 1e-6
    assert answer.unstable_roots(high) - answer.unstable_roots(low) == 2 * copies


def test_two_different_loops_have_the_crossings_of_both() -> None:
    one, other = oscillator(4.0, 0.3, 1.1), scalar(-0.25, 1.75)
    answer = critical_delays(side_by_side(one, other), 6.0)
    assert answer.proved
    assert delays_of(answer) == pytest.approx(
        sorted(delays_of(critical_delays(one, 6.0)) + delays_of(critical_delays(other, 6.0))),
        rel=DIGITS,
    )


@pytest.mark.parametrize("copies", [1, 2])
def test_two_pairs_of_loops_with_long_numbers_are_told_apart(copies: int) -> None:
    one, other = oscillator(4.123456789, 0.31234, 1.1234), oscillator(2.98765432, 0.2123, 0.9123)
    answer = critical_delays(side_by_side(*[one, other] * copies), 3.0)
    alone = delays_of(critical_delays(one, 3.0)) + delays_of(critical_delays(other, 3.0))
    assert answer.proved
    assert delays_of(answer) == pytest.approx(sorted(alone * copies), rel=DIGITS)


def test_two_different_loops_that_cross_at_one_frequency_are_told_apart() -> None:
    # 0 x and x side by side: omega = 1 twice, at different delays
    answer = critical_delays(side_by_side(scalar(0.0, 1.0), scalar(0.75, 1.25)), 3.0)
    assert answer.proved
    assert [c.mode.root.imag for c in answer.crossings] == pytest.approx([1.0, 1.0], rel=DIGITS)
    assert delays_of(answer) == pytest.approx(sorted([pi / 2, acos(0.6)]), rel=DIGITS)


def test_a_crossing_just_after_zero_is_no_crossing_at_zero() -> None:
    # Two loops at omega = sqrt 2: one on the axis without delay, the other (unstable without)
    # crosses to the left at a delay of about 2^-400, where z is within any first ball around one.
    t = fmpq(1, 2**400)
    sitting = [fmpq_poly([4, 0, 1]), fmpq_poly([-2])]
    crossing = [
        fmpq_poly([3 + 2 * t * t, 1 + 2 * t * t, 1]),
        fmpq_poly([-(1 - 2 * t * t - 4 * t), -(1 - 2 * t * t + 2 * t)]),
    ]
    p, q = sitting, crossing
    terms = {(0,): p[0] * q[0], (1,): p[0] * q[1] + p[1] * q[0], (2,): p[1] * q[1]}
    h = Characteristic(terms, ((0,),), fmpq(1), 4)
    alone = proved_crossings(Characteristic({(0,): q[0], (1,): q[1]}, ((0,),), fmpq(1), 2))
    assert alone.unstable_without_delay == 2
    early = [c for c in alone.crossings if float(c.phase.mid()) < 1e-100]
    assert [(c.phase.is_zero(), c.direction) for c in early] == [(False, -1)]
    both = proved_crossings(h)
    leaving = [c for c in both.crossings if c.direction < 0 and float(c.phase.mid()) < 1e-100]
    assert sorted(c.phase.is_zero() for c in leaving) == [False, True]


# --- roots that sit on the axis, or that no delay reaches


def test_a_free_rigid_body_is_marginal_for_every_delay() -> None:
    answer = critical_delays(oscillator(0.0, 0.0, 1.0), 2.0)
    assert answer.proved
    assert answer.marginal == 1  # s = 0
    assert answer.stable_windows == ()
    assert delays_of(answer) == pytest.approx([pi / 2], rel=DIGITS)


def test_what_stays_on_the_axis_is_not_called_delay_independent() -> None:
    still = critical_delays(DelaySystem([[0.0]], [[1.0]], [[0.0]]))
    assert still.marginal == 1
    assert not still.delay_independent


def test_a_double_root_at_zero_that_only_half_leaves_has_no_stable_window() -> None:
    # s^2 + 1 - exp(-s tau): s = 0 for every delay, and twice without
    try:
        answer = critical_delays(oscillator(1.0, 0.0, 0.0, -1.0), 3.0)
    except ArgumentError:
        return
    assert answer.stable_windows == ()


def test_a_real_root_that_passes_the_origin_is_never_proved_away() -> None:
    # s - 1 + exp(-s tau): s = 0 for every delay, twice at tau = 1, a real unstable root beyond
    try:
        answer = critical_delays(scalar(1.0, 1.0), 3.0)
    except ArgumentError:
        return
    assert not answer.proved
    assert answer.stable_windows == ()


def test_an_unstable_part_that_the_input_does_not_reach_stays_unstable() -> None:
    lost = DelaySystem(np.diag([1.0, -1.0]), [[0.0], [1.0]], [[1.0, 2.0]])
    answer = critical_delays(lost, 3.0)
    assert answer.proved
    assert answer.unstable_without_delay == 1
    assert answer.stable_windows == ()
    # the other state is x' = -x - 2 x(t - tau)
    assert delays_of(answer) == pytest.approx([1.20919957615615], rel=DIGITS)


def test_an_oscillator_that_the_input_does_not_reach_is_marginal() -> None:
    lost = side_by_side(oscillator(1.0, 0.0, 0.0), scalar(-1.0, 2.0))
    answer = critical_delays(lost, 3.0)
    assert answer.proved
    assert answer.marginal == 2
    assert answer.critical_delay == 0.0
    assert answer.stable_windows == ()


@pytest.mark.parametrize(
    ("g", "p", "leaves"),
    [(0.0, 1.0, 2), (0.0, -1.0, 0)],
)
def test_roots_on_the_axis_without_delay_leave_it_as_the_sign_says(
    g: float, p: float, leaves: int
) -> None:
    # x'' + 4 x = -p x(t - tau): the delayed force lags, so that p > 0 feeds energy in
    answer = critical_delays(oscillator(4.0, 0.0, g, p), 6.0)
    assert answer.proved
    assert answer.unstable_without_delay == leaves
    assert_staircase_is_the_count(oscillator(4.0, 0.0, g, p), 6.0)


def test_no_plant_at_all_is_two_delayed_integrators() -> None:
    answer = critical_delays(DelaySystem(np.zeros((2, 2)), np.eye(2), np.eye(2)), 3.0)
    assert answer.proved
    assert delays_of(answer) == pytest.approx([pi / 2] * 2, rel=DIGITS)


@pytest.mark.parametrize("shift", [0.0, 1.0])
def test_a_defective_plant_is_counted(shift: float) -> None:
    A = np.eye(3, k=1) - shift * np.eye(3)
    assert_staircase_is_the_count(DelaySystem(A, [[0.0], [0.0], [1.0]], [[1.0, 3.0, 3.0]]), 3.0)


# --- scales and sizes


@pytest.mark.parametrize("unit", [2.0**-20, 2.0**20, 1e-6, 1e6])
def test_delays_scale_with_the_unit_of_time(unit: float) -> None:
    one = oscillator(9.0, 0.3, 1.0)
    other = DelaySystem(one.A * unit, one.B * unit, one.K)
    expected = delays_of(critical_delays(one, 5.0))
    found = [d * unit for d in delays_of(critical_delays(other, 5.0 / unit))]
    # a power of two is exact; any other rounds the matrices
    tolerance = 0.0 if np.log2(unit) % 1.0 == 0.0 else 1e-13
    assert found == pytest.approx(expected, rel=tolerance, abs=0.0)


def test_units_of_the_states_do_not_matter() -> None:
    one = quarter_car()
    units = 2.0 ** np.array([-26, 27, 13, -20])  # 1e-8 to 1e8, exactly
    other = DelaySystem(one.A * units / units[:, None], one.B / units[:, None], one.K * units)
    assert delays_of(critical_delays(other)) == delays_of(critical_delays(one))


def random_loop(seed: int, n: int, m: int, shift: float) -> DelaySystem:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n)) - shift * np.sqrt(n) * np.eye(n)
    return DelaySystem(A, rng.normal(size=(n, m)), rng.normal(size=(m, n)))


@pytest.mark.slow
def test_sixty_states_are_proved() -> None:
    system = random_loop(1, 60, 2, 1.2)
    answer = critical_delays(system, 1.0)
    assert answer.proved
    assert delays_of(answer) == pytest.approx(
        delays_of(estimated_critical_delays(system, 1.0)), rel=1e-9
    )
    counted = certify(system, 0.3)
    assert counted.unstable_roots == answer.unstable_roots(0.3)


@pytest.mark.parametrize("rank", [3, 4])
def test_feedback_of_higher_rank_is_proved(rank: int) -> None:
    system = random_loop(2, 6, rank, 0.4)
    answer = critical_delays(system, 2.0)
    assert answer.proved
    assert len({c.mode.root for c in answer.crossings}) > 1
    assert delays_of(answer) == pytest.approx(
        delays_of(estimated_critical_delays(system, 2.0)), rel=1e-9
    )
    assert_staircase_is_the_count(system, 2.0)


def test_no_channel_and_no_gain_are_delay_independent() -> None:
    none = DelaySystem([[-1.0]], np.zeros((1, 0)), np.zeros((0, 1)))
    idle = DelaySystem([[-1.0]], [[1.0]], [[0.0]])
    for system in (none, idle):
        answer = critical_delays(system)
        assert answer.proved
        assert answer.delay_independent
        assert answer.unstable_without_delay == 0


def test_an_open_loop_unstable_plant_without_gain_stays_so() -> None:
    answer = critical_delays(DelaySystem(np.diag([2.0, 3.0, -1.0]), np.ones((3, 1)), [[0.0] * 3]))
    assert answer.unstable_without_delay == 2


def test_a_neutral_loop_is_refused() -> None:
    with pytest.raises(NeutralLoopError):
        critical_delays(DelaySystem([[-1.0]], [[1.0]], [[0.5]], [[0.1]]))


# --- polynomials


def from_zeros(*zeros: object) -> fmpz_poly:
    product = fmpq_poly([1])
    for zero in zeros:
        product *= fmpq_poly([-fmpq(zero) if not isinstance(zero, fmpq) else -zero, 1])
    return product.numer()


def test_positive_zeros_are_isolated_one_each_and_none_outside() -> None:
    zeros = [fmpq(-3), fmpq(1, 3), fmpq(1), fmpq(2), fmpq(7, 2), fmpq(10**6)]
    found = positive_zeros(from_zeros(*zeros))
    assert len(found) == 5
    for (low, high), zero in zip(found, zeros[1:], strict=True):
        assert low < zero < high
    assert all(a[1] <= b[0] for a, b in pairwise(found))


def test_zeros_that_are_a_billionth_of_a_billionth_apart_are_told_apart() -> None:
    zeros = [1 + k * fmpq(1, 10**12) for k in range(4)] + [1 + fmpq(1, 10**18)]
    found = positive_zeros(from_zeros(*zeros))
    assert len(found) == 5
    for (low, high), zero in zip(found, sorted(zeros), strict=True):
        assert low < zero < high


def test_nearly_real_pairs_are_no_zeros() -> None:
    # (x - 1)^2 + 10^-30
    assert positive_zeros(fmpq_poly([1 + fmpq(1, 10**30), -2, 1])) == []


def test_zeros_at_the_cuts_of_the_bisection_are_found() -> None:
    zeros = [fmpq(2) ** k for k in range(-4, 5)]
    assert len(positive_zeros(from_zeros(*zeros))) == 9


def test_zero_itself_and_constants_have_no_positive_zeros() -> None:
    assert positive_zeros(fmpq_poly([0, 0, 1, 1])) == []
    assert positive_zeros(fmpq_poly([5])) == []


@pytest.mark.parametrize("bits", [64, 320, 2000])
def test_refined_zeros_hold_the_exact_one_and_are_narrow(bits: int) -> None:
    poly = fmpz_poly([-2, 0, 1])
    ((low, high),) = positive_zeros(poly)
    ball = refined(poly, low, high, bits)
    with precision(4 * bits):
        assert ball.contains(arb(2).sqrt())
        assert ball.rad() < arb(2) ** (40 - bits)


@pytest.mark.parametrize("zero", [fmpq(3, 8), fmpq(1), fmpq(1, 3), fmpq(12345, 2**40)])
def test_a_rational_zero_is_held_by_its_ball(zero: fmpq) -> None:
    poly = from_zeros(zero, fmpq(5))
    low, high = positive_zeros(poly)[0]
    ball = refined(poly, low, high, 200)
    with precision(400):
        assert ball.contains(zero)


def test_refining_does_not_stray_to_a_neighbour() -> None:
    near = [fmpq(1), 1 + fmpq(1, 10**12), 1 + fmpq(2, 10**12)]
    poly = from_zeros(*near)
    for (low, high), zero in zip(positive_zeros(poly), near, strict=True):
        with precision(600):
            ball = refined(poly, low, high, 300)
            assert ball.contains(zero)
            assert ball.rad() < arb(10) ** -40


def test_squarefree_factors_carry_their_powers() -> None:
    a, b = fmpz_poly([1, 1]), fmpz_poly([-2, 0, 1])
    powers = {int(f.degree()): p for f, p in squarefree_factors(a * b**3)}
    assert powers == {1: 1, 2: 3}


@pytest.mark.parametrize(
    ("poly", "unstable", "on_axis"),
    [
        ([1, 1], 0, 0),
        ([-1, 1], 1, 0),
        ([0, 1], 0, 1),
        ([0, 0, 1], 0, 2),
        ([1, 0, 1], 0, 2),
        ([-1, 0, 1], 1, 0),  # mirrored +-1
        ([1, 0, 0, 0, 1], 2, 0),  # mirrored four
        ([1, 0, 2, 0, 1], 0, 4),  # (s^2 + 1)^2
        ([2, 1, 2, 1], 0, 2),  # (s^2 + 1)(s + 2)
        ([-2, 1, -2, 1], 1, 2),
        ([0, 2, 1, 2, 1], 0, 3),
        ([1, 1, 1, 1, 2], 2, 0),  # the third row of its array starts with a negative
        ([1, 1, 2, 2, 1], 2, 0),  # a vanishing first entry, no mirrored zeros
        ([6, -5, -2, 1], 2, 0),  # 1, 3, -2
        ([-4, 0, -3, 0, 1], 1, 2),  # +-2, +-j
    ],
)
def test_half_plane_counts_are_exact(poly: list[int], unstable: int, on_axis: int) -> None:
    assert unstable_zeros(fmpq_poly(poly))[:2] == (unstable, on_axis)


@pytest.mark.parametrize("seed", range(10))
def test_half_plane_counts_agree_with_planted_zeros(seed: int) -> None:
    rng = np.random.default_rng(seed)
    poly, unstable, on_axis = fmpq_poly([1]), 0, 0
    for _ in range(int(rng.integers(1, 7))):
        a, b = (int(v) for v in rng.integers(-3, 4, 2))
        if rng.random() < 0.5:  # (s - a)^2 + b^2
            poly *= fmpq_poly([a * a + b * b, -2 * a, 1])
            unstable += 2 * (a > 0)
            on_axis += 2 * (a == 0)
        else:
            poly *= fmpq_poly([-a, 1])
            unstable += a > 0
            on_axis += a == 0
    assert unstable_zeros(poly)[:2] == (unstable, on_axis)


def test_a_zero_just_right_of_the_axis_counts() -> None:
    tiny = fmpq(1, 10**60)
    for sign, expected in ((1, 2), (-1, 0)):
        poly = fmpq_poly([1 + tiny * tiny, -2 * sign * tiny, 1])
        assert unstable_zeros(poly * fmpq_poly([1, 1]))[:2] == (expected, 0)


# --- elimination


def test_the_resultant_vanishes_where_the_loop_gain_is_one() -> None:
    # s + 1 + 2 z: |1 + j omega| = 2 at omega^2 = 3
    eliminated = resultant([fmpq_poly([1, 1]), fmpq_poly([2])])
    assert eliminated(3) == 0
    assert eliminated.degree() == 1


def test_the_resultant_is_the_product_over_pairs_of_zeros() -> None:
    terms = [fmpq_poly([3, 2, 1]), fmpq_poly([1, 4]), fmpq_poly([2])]
    eliminated = resultant(terms)

    def product(w: float) -> float:
        s = 1j * np.sqrt(w)
        values = [complex(sum(float(c) * s**k for k, c in enumerate(p.coeffs()))) for p in terms]
        z = np.roots(values[::-1])
        pairs = 1.0 - z[:, None] * np.conj(z)[None, :]
        return float((abs(values[-1]) ** 4 * np.prod(pairs)).real)

    def whole(w: int) -> float:
        return float(eliminated(w))

    ratio = [whole(w) / product(w) for w in (1, 2, 5, 9)]
    assert ratio == pytest.approx([ratio[0]] * 4, rel=1e-9)  # np.roots keeps some 12 digits


@pytest.mark.parametrize("size", [3, 2**70 + 1])
def test_products_are_factored_whatever_the_size_of_their_numbers(size: int) -> None:
    p = [fmpq_poly([7, 0, 1]), fmpq_poly([0, size])]
    q = [fmpq_poly([5, 0, 1]), fmpq_poly([0, size + 2])]
    terms = [p[0] * q[0], p[0] * q[1] + p[1] * q[0], p[1] * q[1]]
    found = irreducible_factors(terms)
    assert sorted(times for _, times in found) == [1, 1]
    product = [fmpq_poly([0])] * 3
    (a, _), (b, _) = found
    for i, x in enumerate(a):
        for k, y in enumerate(b):
            product[i + k] = product[i + k] + x * y
    scale = product[0].coeffs()[-1]
    assert [x / scale for x in product] == terms


# --- the characteristic function against determinants


def determinant(system: DelaySystem, s: complex, delays: np.ndarray) -> complex:
    """det [[s I - A, -B], [Z K, I + Z F]] in floating point."""
    n, m = system.num_states, system.num_channels
    Z = np.diag(np.exp(-s * delays))
    top = np.hstack([s * np.eye(n) - system.A, -system.B])
    low = np.hstack([Z @ system.K, np.eye(m) + Z @ system.feedthrough])
    return complex(np.linalg.det(np.vstack([top, low])))


def value(h: Characteristic, s: complex, delays: list[float]) -> complex:
    """h at a true s and true delays, divided by the unit of time to the degree."""
    with precision(256):
        unit = arb(h.unit)
        scaled = acb(s.real, s.imag) * unit
        total = acb(0)
        for exponents, p in h.terms.items():
            lag = sum(k * tau for k, tau in zip(exponents, delays, strict=True))
            powers = acb(0)
            for c in reversed(p.coeffs()):
                powers = powers * scaled + acb(c)
            total += powers * (-acb(s.real, s.imag) * arb(lag)).exp()
        return complex(total / unit**h.degree)


@pytest.mark.parametrize("feedthrough", [0.0, 0.4])
@pytest.mark.parametrize(
    "groups", [[[0, 1, 2]], [[0], [1], [2]], [[0, 2], [1]], [[1, 2], [0]]], ids=str
)
def test_the_characteristic_function_is_the_determinant(
    groups: list[list[int]], feedthrough: float
) -> None:
    rng = np.random.default_rng(3)
    n, m = 4, 3
    F = feedthrough * rng.normal(size=(m, m))
    system = DelaySystem(
        30.0 * rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(m, n)), F
    )
    h = characteristic(system, groups)
    for _ in range(5):
        delays = rng.uniform(0.0, 0.05, len(groups))
        per_channel = np.zeros(m)
        for group, tau in zip(groups, delays, strict=True):
            per_channel[group] = tau
        s = complex(*rng.normal(size=2) * 30.0)
        expected = determinant(system, s, per_channel)
        # the determinant in doubles loses some digits at size 7
        assert value(h, s, delays.tolist()) == pytest.approx(expected, rel=1e-10)


def test_channels_left_out_of_the_groups_have_no_delay() -> None:
    rng = np.random.default_rng(4)
    system = DelaySystem(*(rng.normal(size=s) for s in ((3, 3), (3, 2), (2, 3))))
    h = characteristic(system, [[1]])
    s = 0.3 + 1.1j
    expected = determinant(system, s, np.array([0.0, 0.7]))
    assert value(h, s, [0.7]) == pytest.approx(expected, rel=1e-12)


def test_the_degree_in_z_is_the_rank_of_the_feedback() -> None:
    system = DelaySystem(np.eye(4, k=1), np.ones((4, 3)), np.ones((3, 4)))
    assert max(k for (k,) in characteristic(system, [range(3)]).terms) == 1


def test_many_different_delays_are_refused_by_name() -> None:
    system = DelaySystem(-np.eye(12), np.eye(12), np.eye(12))
    with pytest.raises(ArgumentError, match="give fewer different delays"):
        characteristic(system, [[k] for k in range(12)])


def test_the_float_search_agrees_with_the_proof_on_the_papers_loop(loop: DelaySystem) -> None:
    exact, estimate = critical_delays(loop, 2.0), estimated_critical_delays(loop, 2.0)
    assert delays_of(estimate) == pytest.approx(delays_of(exact), rel=1e-9)
    assert directions_of(estimate) == directions_of(exact)
    assert count_unstable(loop, 0.3) == exact.unstable_roots(0.3)
