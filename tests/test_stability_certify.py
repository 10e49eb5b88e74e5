"""`certify` and `enclosed_roots`: closed forms on both sides of every edge, degenerate inputs."""

import signal
from importlib import import_module
from math import acos, pi, sqrt

import numpy as np
import pytest
from flint import acb, acb_poly, arb
from scipy.linalg import block_diag
from scipy.special import lambertw

from railenv.errors import ArgumentError, NeutralLoopError
from railenv.stability import DelaySystem, count_unstable, critical_delays, enclosed_roots
from railenv.stability.certify import certify
from railenv.stability.proof.contour import Line, Piece, Quasipolynomial
from railenv.stability.proof.precision import precision
from railenv.stability.spectrum import collocation_matrix, rightmost_roots

STABLE, UNSTABLE, UNDECIDED = "STABLE", "UNSTABLE", "UNDECIDED"


def scalar(a: float, k: float) -> DelaySystem:
    """x' = a x - k x(t - tau)."""
    return DelaySystem([[a]], [[1.0]], [[k]])


def oscillator(k: float, c: float, g: float, p: float = 0.0) -> DelaySystem:
    """x'' + c x' + k x = -g x'(t - tau) - p x(t - tau)."""
    return DelaySystem([[0.0, 1.0], [-k, -c]], [[0.0], [1.0]], [[p, g]])


def side_by_side(*loops: DelaySystem) -> DelaySystem:
    """Loops that do not know of each other."""
    return DelaySystem(*(block_diag(*(getattr(x, n) for x in loops)) for n in ("A", "B", "K")))


def two_delays(a: float, b: float, c: float) -> DelaySystem:
    """x' = -a x - b x(t - tau_1) - c x(t - tau_2)."""
    return DelaySystem([[-a]], [[1.0, 1.0]], [[b], [c]])


# --- points


@pytest.mark.parametrize(
    ("delay", "verdict", "roots"),
    [
        (0.0, STABLE, 0),
        (1.0, STABLE, 0),
        (pi / 2 - 1e-9, STABLE, 0),
        (pi / 2 + 1e-9, UNSTABLE, 2),
        (pi / 2 + 2 * pi + 1e-6, UNSTABLE, 4),
        (100.0, UNSTABLE, 32),  # pi/2 + 2 pi k <= 100 for k = 0..15
    ],
)
def test_the_delayed_integrator_is_decided_at_a_point(
    delay: float, verdict: str, roots: int
) -> None:
    answer = certify(scalar(0.0, 1.0), delay)
    assert (answer.verdict, answer.unstable_roots) == (verdict, roots)


def test_the_last_double_before_the_crossing_is_proved_stable() -> None:
    # the double nearest pi / 2 lies 6e-17 below it, closer than floating point sees
    assert certify(scalar(0.0, 1.0), pi / 2).verdict == STABLE


def test_the_first_double_after_the_crossing_is_proved_unstable() -> None:
    assert certify(scalar(0.0, 1.0), np.nextafter(pi / 2, 2.0)).verdict == UNSTABLE


def test_the_paper_loop_is_decided_on_both_sides_of_its_critical_delay(loop: DelaySystem) -> None:
    assert certify(loop, 0.1).verdict == STABLE
    answer = certify(loop, 0.203)
    assert (answer.verdict, answer.unstable_roots) == (UNSTABLE, 2)


# --- intervals


@pytest.mark.parametrize(
    ("interval", "verdict"),
    [
        ((0.0, 1.57), STABLE),
        ((1.0, 1.57), STABLE),
        ((0.0, 1.5709), UNSTABLE),
        ((1.5, 1.6), UNSTABLE),
        ((2.0, 7.0), UNSTABLE),
        ((1.3, 1.3), STABLE),
    ],
)
def test_the_delayed_integrator_is_decided_on_an_interval(
    interval: tuple[float, float], verdict: str
) -> None:
    answer = certify(scalar(0.0, 1.0), interval)
    assert answer.verdict == verdict
    if verdict == UNSTABLE:
        (witness,) = answer.evidence["delays"]
        assert interval[0] <= witness <= interval[1]
        assert witness > pi / 2


def test_an_interval_with_more_crossings_than_anybody_lists_is_decided_at_once() -> None:
    def stop(*_: object) -> None:
        raise AssertionError("not decided within 10 s")

    before = signal.signal(signal.SIGALRM, stop)
    signal.alarm(10)
    try:
        assert certify(scalar(0.0, 1.0), (0.0, 3e5)).verdict == UNSTABLE
    finally:
        signal.alarm(0)
        signal.signal(signal.SIGALRM, before)


def test_an_interval_past_an_unstable_window_is_stable() -> None:
    # stable again from the delay at which the lower frequency goes back
    loop = oscillator((2 * pi * 1.2) ** 2, 0.6, 1.5)
    (_, lost), (back, again) = critical_delays(loop).stable_windows[:2]
    assert certify(loop, (back * 1.001, again * 0.999)).verdict == STABLE
    assert certify(loop, (0.0, again * 0.999)).verdict == UNSTABLE
    assert certify(loop, (0.0, lost * 0.999)).verdict == STABLE


def test_a_narrow_unstable_window_inside_an_interval_is_found() -> None:
    # unstable over some 6e-5 s only, between two nearly tangent crossings
    answer = certify(oscillator(4.0, 0.5, 0.5 * (1 + 1e-9)), (0.0, 3.0))
    assert (answer.verdict, answer.unstable_roots) == (UNSTABLE, 2)
    assert answer.evidence["delays"][0] == pytest.approx(pi / 2, abs=1e-4)


@pytest.mark.slow
def test_a_gain_just_below_tangency_is_proved_stable_over_an_interval() -> None:
    assert certify(oscillator(4.0, 0.5, 0.5 * (1 - 1e-9)), (0.0, 3.0)).verdict == STABLE


@pytest.mark.slow
def test_the_paper_loop_is_decided_on_both_sides_as_an_interval(loop: DelaySystem) -> None:
    assert certify(loop, (0.0, 0.2019)).verdict == STABLE
    assert certify(loop, (0.0, 0.203)).verdict == UNSTABLE


# --- decay rate and damping


@pytest.mark.parametrize("delay", [0.1, 0.3, 0.7, 1.5, 2.0])
def test_the_decay_rate_is_lamberts_to_six_digits(delay: float) -> None:
    # s = W_0(-tau) / tau is the rightmost root of s + exp(-s tau)
    rate = -lambertw(-delay).real / delay
    assert certify(scalar(0.0, 1.0), delay, decay_rate=rate - 1e-6).verdict == STABLE
    assert certify(scalar(0.0, 1.0), delay, decay_rate=rate + 1e-6).verdict == UNSTABLE


def test_a_decay_rate_is_kept_over_an_interval_up_to_the_worst_delay() -> None:
    # the decay rate of s + exp(-s tau) rises up to tau = 1/e and falls beyond
    def rate(tau: float) -> float:
        return float(-lambertw(-tau).real / tau)

    worst = min(rate(0.2), rate(1.0))
    assert certify(scalar(0.0, 1.0), (0.2, 1.0), decay_rate=worst - 1e-3).verdict == STABLE
    assert certify(scalar(0.0, 1.0), (0.2, 1.0), decay_rate=worst + 1e-3).verdict == UNSTABLE


def test_a_decay_rate_without_delay_is_that_of_the_matrix() -> None:
    loop = DelaySystem(np.diag([-1.0, -2.0, -3.0]), np.zeros((3, 1)), np.zeros((1, 3)))
    found = [certify(loop, 0.5, decay_rate=r).unstable_roots for r in (0.5, 1.5, 2.5, 3.5)]
    assert found == [0, 1, 2, 3]


def test_a_negative_decay_rate_lets_slow_growth_pass() -> None:
    delay = 2.0
    growth = lambertw(-delay).real / delay
    assert growth > 0.0
    for extra, verdict in ((1e-6, STABLE), (-1e-6, UNSTABLE)):
        answer = certify(scalar(0.0, 1.0), delay, decay_rate=-(growth + extra))
        assert answer.verdict == verdict


@pytest.mark.parametrize("delay", [0.0, 0.4, 0.9])
@pytest.mark.parametrize("loop", [oscillator(4.0, 0.4, 0.3), scalar(0.0, 1.0)], ids=["2", "1"])
def test_the_damping_ratio_is_that_of_the_known_roots(loop: DelaySystem, delay: float) -> None:
    # the least damped of the roots below 0.8 Hz, by the float spectrum
    cap = 0.8
    modes = [m for m in rightmost_roots(loop, delay, 1 if delay == 0.0 else 6) if m.root.imag > 0]
    ratios = [m.damping_ratio for m in modes if m.damped_frequency_hz < cap]
    if not ratios:
        assert certify(loop, delay, damping_ratio=0.9, max_frequency_hz=cap).verdict == STABLE
        return
    least = min(ratios)
    for ratio, verdict in ((least - 1e-6, STABLE), (least + 1e-6, UNSTABLE)):
        answer = certify(loop, delay, damping_ratio=ratio, max_frequency_hz=cap)
        assert answer.verdict == verdict


def test_roots_beyond_the_capped_frequency_do_not_count() -> None:
    # omega = 2 rad/s is 0.318 Hz
    loop = oscillator(4.0, 0.01, 0.0)
    for cap, verdict in ((0.31, STABLE), (0.33, UNSTABLE)):
        answer = certify(loop, 0.2, damping_ratio=0.05, max_frequency_hz=cap)
        assert answer.verdict == verdict


def test_a_real_unstable_root_lies_in_every_wedge() -> None:
    answer = certify(scalar(2.0, 0.5), 0.2, damping_ratio=0.0, max_frequency_hz=1e-3)
    assert (answer.verdict, answer.unstable_roots) == (UNSTABLE, 1)


def test_a_damping_ratio_is_kept_over_an_interval() -> None:
    loop = oscillator(4.0, 0.4, 0.3)
    worst = min(
        mode.damping_ratio
        for delay in np.linspace(0.0, 0.5, 51)
        for mode in rightmost_roots(loop, delay, 1)
    )
    wedge = {"max_frequency_hz": 0.8}
    assert certify(loop, (0.0, 0.5), damping_ratio=worst - 1e-3, **wedge).verdict == STABLE
    assert certify(loop, (0.0, 0.5), damping_ratio=worst + 1e-3, **wedge).verdict == UNSTABLE


@pytest.mark.parametrize(
    ("region", "message"),
    [
        ({"damping_ratio": 0.05}, "needs max_frequency_hz"),
        ({"max_frequency_hz": 5.0}, "max_frequency_hz = 5.0 caps a damping ratio"),
        ({"damping_ratio": 1.0, "max_frequency_hz": 5.0}, "damping_ratio = 1.0 must be"),
        ({"damping_ratio": -0.1, "max_frequency_hz": 5.0}, "damping_ratio = -0.1 must be"),
        ({"damping_ratio": 0.1, "max_frequency_hz": 0.0}, "max_frequency_hz = 0 must be"),
        ({"damping_ratio": 0.1, "max_frequency_hz": np.inf}, "max_frequency_hz = inf must"),
        ({"damping_ratio": 0.1, "max_frequency_hz": 1.0, "decay_rate": 1.0}, "not both"),
        ({"decay_rate": np.nan}, "decay_rate = nan must be finite"),
        ({"decay_rate": "fast"}, "decay_rate = 'fast' is not a number"),
        ({"damping_ratio": "low", "max_frequency_hz": 1.0}, "damping_ratio = 'low' is not"),
        ({"most_tests": 0}, "most_tests = 0 is too small"),
    ],
)
def test_a_bad_region_is_refused_by_name_value_and_rule(
    region: dict[str, object], message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        certify(scalar(0.0, 1.0), 0.1, **region)  # type: ignore[arg-type]


# --- boxes of independent delays


def test_two_delays_on_the_diagonal_are_one_delay() -> None:
    # x' = -x - 2 x(t - tau), both channels alike: crossing at 1.2092 (closed form)
    edge = (pi - acos(0.5)) / sqrt(3.0)
    loop = two_delays(1.0, 1.25, 0.75)
    assert certify(loop, [edge - 1e-6] * 2).verdict == STABLE
    assert certify(loop, [edge + 1e-6] * 2).verdict == UNSTABLE


def test_a_box_of_two_delays_is_stable_up_to_near_the_diagonals_crossing() -> None:
    # here equal delays are worst: no point of the box is worse than its upper corner
    edge = (pi - acos(0.5)) / sqrt(3.0)
    loop = two_delays(1.0, 1.25, 0.75)
    assert certify(loop, [(0.0, edge - 0.02)] * 2).verdict == STABLE
    answer = certify(loop, [(0.0, edge + 0.02)] * 2)
    assert answer.verdict == UNSTABLE
    assert count_unstable(loop, answer.evidence["delays"]) > 0


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.slow
def test_verdicts_on_boxes_agree_with_the_spectrum_inside(seed: int) -> None:
    rng = np.random.default_rng(seed)
    a, b, c = rng.uniform(0.2, 1.5, 3)
    loop = two_delays(a, b, c)
    low = rng.uniform(0.0, 1.5, 2)
    high = low + rng.uniform(0.1, 0.8, 2)
    box = [(float(x), float(y)) for x, y in zip(low, high, strict=True)]
    answer = certify(loop, box)
    assert answer.proved, answer.reason
    if answer.verdict == UNSTABLE:
        assert count_unstable(loop, answer.evidence["delays"]) == answer.unstable_roots
        return
    for point in rng.uniform(low, high, (20, 2)):
        assert count_unstable(loop, point.tolist()) == 0


def test_an_unstable_spot_between_stable_corners_is_found() -> None:
    # the second loop is stable whatever its delay; the first only in a narrow band off the middle
    loop = oscillator(4.0, 0.5, 0.5 * (1 + 2e-3))
    both = side_by_side(loop, scalar(-1.0, 0.1))
    (one, other) = (c.delay for c in critical_delays(loop, 3.0).crossings)
    middle = (one + other) / 2
    # unstable on (one, other) only: the box's middle and ends lie outside
    box = [(middle - 0.5, middle + 1.0), (0.0, 1.0)]
    for end in (*box[0], sum(box[0]) / 2):
        assert count_unstable(both, [end, 0.5]) == 0
    answer = certify(both, box)
    assert answer.verdict == UNSTABLE
    assert one < answer.evidence["delays"][0] < other


def test_equal_intervals_are_independent_delays() -> None:
    # x' = -x / 2 - 2 x(t - tau_1) + 2 x(t - tau_2): equal delays cancel, tau = (3, 0) is unstable
    loop = two_delays(0.5, 2.0, -2.0)
    assert certify(loop, (0.0, 3.0)).verdict == STABLE
    assert certify(loop, [(0.0, 3.0), (0.0, 3.0)]).verdict == UNSTABLE


def test_equal_numbers_are_one_delay_and_say_so() -> None:
    answer = certify(two_delays(1.0, 0.3, 0.3), [0.2, 0.2])
    assert answer.claim["groups"] == [[0, 1]]
    assert answer.claim["common"] is True


def test_a_number_and_an_interval_may_stand_side_by_side() -> None:
    answer = certify(two_delays(1.0, 0.3, 0.3), [0.2, (0.0, 0.5)])
    assert answer.verdict == STABLE
    assert answer.claim["low"] == [0.2, 0.0]
    assert answer.claim["high"] == [0.2, 0.5]


@pytest.mark.parametrize(
    ("delay", "message"),
    [
        (-0.1, "delay = -0.1 must not be negative"),
        (np.nan, "delay = nan must be finite"),
        (np.inf, "delay = inf must be finite"),
        ("0.1", "delay = '0.1' is not a number"),
        (None, "delay = None is not a number"),
        (True, "delay = True is not a number"),
        (1j, "delay = 1j is not a number"),
        (1e-200, "out of reach"),
        ((0.2, 0.1), "is reversed"),
        ((0.1, 0.2, 0.3), "no .low, high. interval"),
        ((), "no .low, high. interval"),
        ((None, 0.1), "delay = None is not a number"),
        ((0.1, "b"), "delay = 'b' is not a number"),
        ([], "delay has 0 entries; give one or 2"),
        ([0.1, 0.2, 0.3], "delay has 3 entries; give one or 2"),
        ([0.1, None], "delay = None is not a number"),
        ([0.1, (0.2, 0.1)], "is reversed"),
        ([(0.1, 0.2), (0.1,)], "no .low, high. interval"),
        ([(0.1, 0.2), -1.0], "must not be negative"),
        (([0.1, 0.2], [0.3, 0.4]), "delay"),
        ([np.array([0.1, 0.2]), 0.3], "delay"),
        (np.array([[[0.1, 0.2]]]), "delay"),
        ({"front": 0.1}, "is not a number"),
    ],
    ids=str,
)
def test_a_delay_in_a_wrong_form_is_refused_by_name(delay: object, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        certify(two_delays(1.0, 0.3, 0.3), delay)  # type: ignore[arg-type]


# --- degenerate loops


@pytest.mark.slow
def test_an_interval_with_a_touch_is_undecided_with_a_reason() -> None:
    answer = certify(oscillator(4.0, 0.5, 0.5), (0.0, 3.0))
    assert answer.verdict == UNDECIDED
    assert answer.reason
    assert answer.evidence == {}


@pytest.mark.slow
def test_intervals_on_either_side_of_a_touch_are_stable() -> None:
    loop = oscillator(4.0, 0.5, 0.5)
    assert certify(loop, (0.0, pi / 2 - 1e-6)).verdict == STABLE
    assert certify(loop, (pi / 2 + 1e-6, 3.0)).verdict == STABLE


@pytest.mark.parametrize("delay", [0.1, 0.3, 0.5])
def test_identical_loops_have_twice_the_roots(delay: float) -> None:
    one = oscillator(40.0, 0.6, 4.0)
    alone, both = certify(one, delay), certify(side_by_side(one, one), delay)
    assert both.verdict == alone.verdict
    assert both.unstable_roots == 2 * (alone.unstable_roots or 0)


def test_identical_loops_are_proved_over_an_interval() -> None:
    one = oscillator(40.0, 0.6, 4.0)
    first = critical_delays(one).critical_delay
    assert first is not None
    both = side_by_side(one, one)
    assert certify(both, (0.0, first * (1 - 1e-6))).verdict == STABLE
    assert certify(both, (0.0, first * 1.01)).verdict == UNSTABLE


def test_two_pairs_of_loops_with_long_numbers_are_decided_over_an_interval() -> None:
    one, other = oscillator(4.123456789, 0.31234, 1.1234), oscillator(2.98765432, 0.2123, 0.9123)
    pairs = side_by_side(one, one, other, other)
    # the first of all crossings is at 0.7015 s
    assert certify(pairs, (0.0, 0.70)).verdict == STABLE
    assert certify(pairs, (0.0, 0.71)).verdict == UNSTABLE


@pytest.mark.parametrize("delay", [0.1, (0.0, 0.5)])
def test_a_free_rigid_body_is_undecided_and_the_reason_says_why(delay: object) -> None:
    answer = certify(oscillator(0.0, 0.0, 1.0), delay)  # type: ignore[arg-type]
    assert answer.verdict == UNDECIDED
    assert "whatever the delay" in answer.reason


def test_a_free_rigid_body_with_unstable_roots_is_unstable() -> None:
    assert certify(oscillator(0.0, 0.0, 1.0), 2.0).verdict == UNSTABLE


def test_a_free_rigid_body_has_its_decay_rate_on_the_right_side() -> None:
    answer = certify(oscillator(0.0, 0.0, 1.0), 0.5, decay_rate=0.1)
    assert (answer.verdict, answer.unstable_roots) == (UNSTABLE, 1)


def test_an_oscillator_that_nothing_reaches_is_undecided() -> None:
    answer = certify(oscillator(4.0, 0.0, 0.0), 0.1)
    assert answer.verdict == UNDECIDED
    assert "edge of the region" in answer.reason


def test_a_root_on_the_axis_without_delay_spoils_only_the_intervals_end() -> None:
    loop = oscillator(4.0, 0.0, 0.0, -1.0)  # the delayed push backs the oscillation
    assert certify(loop, (0.0, 0.5)).verdict == UNDECIDED
    assert certify(loop, (1e-6, 0.5)).verdict == STABLE


@pytest.mark.parametrize("high", [1.7, 3.0, 6.0])
def test_an_interval_after_a_root_has_left_to_the_left_is_decided(high: float) -> None:
    # stable from zero to pi / sqrt 3 = 1.81, unstable beyond
    loop = oscillator(4.0, 0.0, 0.0, -1.0)
    edge = critical_delays(loop, 6.0).stable_windows[0][1]
    verdict = STABLE if high < edge else UNSTABLE
    assert certify(loop, (0.01, high)).verdict == verdict


@pytest.mark.parametrize(("delay", "verdict"), [(1.5, STABLE), (1.6, UNSTABLE)])
def test_no_plant_at_all_is_decided(delay: float, verdict: str) -> None:
    both = DelaySystem(np.zeros((2, 2)), np.eye(2), np.eye(2))
    assert certify(both, delay).verdict == verdict


def test_repeated_and_defective_roots_are_counted() -> None:
    A = -np.eye(4) + np.eye(4, k=1)
    still = DelaySystem(A, np.zeros((4, 1)), np.zeros((1, 4)))
    assert certify(still, 0.3).verdict == STABLE
    assert certify(still, 0.3, decay_rate=1.1).unstable_roots == 4


def test_units_of_the_states_and_of_time_do_not_matter() -> None:
    one = oscillator(9.0, 0.3, 1.0)
    edge = critical_delays(one, 5.0).crossings[0].delay
    units, unit = np.array([1e-8, 1e8]), 1e6
    other = DelaySystem(
        one.A * units / units[:, None] * unit, one.B / units[:, None] * unit, one.K * units
    )
    assert certify(other, edge / unit * (1 - 1e-9)).verdict == STABLE
    assert certify(other, edge / unit * (1 + 1e-9)).verdict == UNSTABLE


@pytest.mark.slow
def test_sixty_states_are_certified_over_an_interval() -> None:
    # one oscillator that is lost at a known delay drives 58 stable states
    one = oscillator(56.8, 0.6, 4.0)
    rng = np.random.default_rng(1)
    rest = rng.normal(size=(58, 58)) - 1.2 * np.sqrt(58) * np.eye(58)
    loop = DelaySystem(
        block_diag(one.A, rest),
        np.vstack([one.B, rng.normal(size=(58, 1))]),
        np.hstack([one.K, np.zeros((1, 58))]),
    )
    first = critical_delays(one).critical_delay
    assert first is not None
    assert certify(loop, (0.0, first * 0.99)).verdict == STABLE
    assert certify(loop, (0.0, first * 1.01)).verdict == UNSTABLE


def test_many_independent_channels_are_undecided_with_a_reason() -> None:
    loop = DelaySystem(-np.eye(12), np.eye(12), np.eye(12))
    answer = certify(loop, [0.1 * k for k in range(12)])
    assert answer.verdict == UNDECIDED
    assert "give fewer different delays" in answer.reason


@pytest.mark.parametrize("delay", [0.5, (0.0, 1.0), []])
def test_no_channel_at_all_is_the_plant_alone(delay: object) -> None:
    for a, verdict in ((-1.0, STABLE), (1.0, UNSTABLE)):
        loop = DelaySystem([[a]], np.zeros((1, 0)), np.zeros((0, 1)))
        assert certify(loop, delay).verdict == verdict  # type: ignore[arg-type]


def test_too_few_tests_are_undecided_and_never_stable() -> None:
    answer = certify(two_delays(1.0, 1.25, 0.75), [(0.0, 1.18)] * 2, most_tests=3)
    assert answer.verdict == UNDECIDED
    assert "more than 3 tests" in answer.reason


# --- neutral loops


def neutral(a: float, k: float, f: float) -> DelaySystem:
    """x' = a x + y, y(t) = -k x(t - tau) - f y(t - tau)."""
    return DelaySystem([[a]], [[1.0]], [[k]], [[f]])


def neutral_roots(a: float, k: float, f: float, tau: float) -> np.ndarray:
    """Roots of (s - a)(1 + f z) + k z, z = exp(-s tau), near the axis, by Newton from a grid."""
    s = (np.linspace(-2.0, 6.0, 60)[:, None] + 1j * np.linspace(0.0, 40.0, 400)).ravel()
    for _ in range(60):
        z = np.exp(-s * tau)
        value = (s - a) * (1 + f * z) + k * z
        slope = 1 + f * z - tau * f * z * (s - a) - tau * k * z
        s = s - value / slope
        s = np.where(np.abs(s.real) < 20.0, s, 1.0)
    z = np.exp(-s * tau)
    good = np.abs((s - a) * (1 + f * z) + k * z) < 1e-9
    found = s[good & (s.imag > -1e-9)]
    return np.unique(np.round(found, 6))


@pytest.mark.parametrize("f", [0.3, -0.3, 0.6])
@pytest.mark.parametrize("delay", [0.2, 0.8, 2.0])
def test_a_weakly_neutral_loop_is_decided_as_its_roots_say(f: float, delay: float) -> None:
    roots = neutral_roots(-0.1, 3.0, f, delay)
    unstable = sum(2 if s.imag > 1e-6 else 1 for s in roots if s.real > 1e-9)
    answer = certify(neutral(-0.1, 3.0, f), delay)
    assert answer.verdict == (UNSTABLE if unstable else STABLE)
    assert answer.unstable_roots == unstable


def test_a_weakly_neutral_loop_is_decided_over_an_interval() -> None:
    assert certify(neutral(-0.1, 3.0, 0.6), (0.0, 0.1)).verdict == STABLE
    assert certify(neutral(-0.1, 3.0, 0.6), (0.0, 2.0)).verdict == UNSTABLE


@pytest.mark.parametrize("delay", [0.01, (0.0, 0.01)])
def test_an_unstable_difference_part_is_unstable_by_name(delay: object) -> None:
    answer = certify(neutral(-1.0, 0.5, 2.0), delay)  # type: ignore[arg-type]
    assert answer.verdict == UNSTABLE
    assert "difference part" in answer.reason


@pytest.mark.parametrize(
    "region",
    [{"decay_rate": -200.0}, {"damping_ratio": 0.05, "max_frequency_hz": 5.0}],
    ids=["right of a line", "wedge"],
)
def test_roots_of_the_difference_part_count_only_inside_the_region(
    region: dict[str, float],
) -> None:
    # they stand at (ln 2 + j pi (2 k + 1)) / 10 ms: real part 69 1/s, 50 Hz and more
    assert certify(neutral(-1.0, 0.5, 2.0), 0.01, **region).verdict != UNSTABLE


@pytest.mark.parametrize("f", [-1.0, 1.0])
@pytest.mark.parametrize("delay", [0.0, 0.1, (0.0, 0.1)])
def test_a_difference_part_on_the_edge_is_undecided_with_a_reason(f: float, delay: object) -> None:
    answer = certify(neutral(-1.0, 3.0, f), delay)  # type: ignore[arg-type]
    assert answer.verdict in (UNDECIDED, STABLE if f > 0 and delay == 0.0 else UNDECIDED)
    assert answer.proved or "neutral" in answer.reason


@pytest.mark.parametrize("delay", [0.5, (0.0, 2.0), [0.1, 0.2], [(0.0, 0.1), (0.1, 0.2)]])
def test_several_neutral_channels_that_are_not_decided_say_so(delay: object) -> None:
    loop = DelaySystem(-0.1 * np.eye(2), np.eye(2), 3.0 * np.eye(2), 0.6 * np.eye(2))
    answer = certify(loop, delay)  # type: ignore[arg-type]
    assert answer.verdict == UNDECIDED
    assert "neutral" in answer.reason
    assert "rightmost_roots" not in answer.reason


# --- one piece of a contour: all terms pull one way, so that every bound is met with equality


def excluded(polynomials: list[object], low: float, high: float, tau: tuple[float, float]) -> bool:
    """Test p_0(s) + p_1(s) exp(-s tau) for s from -low down to -high and tau in an interval."""
    h = Quasipolynomial(tuple(polynomials), ((0,), (1,))[: len(polynomials)])
    with precision(128):
        piece = Piece(h, Line(acb(0), acb(-1)), low, high)
        middle, width = arb(sum(tau)) / 2, arb(tau[1] - tau[0]) / 2
        return piece.excludes([middle], [width])[0]


@pytest.mark.parametrize(("inside", "expected"), [(1e-10, False), (-1e-2, True)])
def test_what_the_series_of_the_exponential_leaves_out_is_bounded(
    inside: float, expected: bool
) -> None:
    # a - exp(-s), zero just inside s = -2; the eleventh term is 1e-8 of the whole
    a = float(np.exp(2.0)) * (1.0 - inside)
    assert excluded([acb_poly([a]), acb_poly([-1])], 0.0, 2.0, (1.0, 1.0)) is expected


@pytest.mark.parametrize(("inside", "expected"), [(1e-10, False), (-1e-10, True)])
def test_high_powers_of_a_polynomial_are_bounded(inside: float, expected: bool) -> None:
    # a - (1 - (s + 1))^20 = a - (-s)^20, zero just inside s = -2; half its size is beyond t^10
    p = acb_poly([0.0] * 20 + [-1.0]) + acb_poly([2.0**20 * (1.0 - inside)])
    assert excluded([p], 0.0, 2.0, (0.0, 0.0)) is expected


@pytest.mark.parametrize(("inside", "expected"), [(1e-10, False), (-1.0, True)])
def test_the_curvature_over_an_interval_of_delays_is_bounded(inside: float, expected: bool) -> None:
    # a - exp(tau) at s = -1, zero just inside tau = 2
    a = float(np.exp(2.0)) * (1.0 - inside)
    assert excluded([acb_poly([a]), acb_poly([-1])], 1.0, 1.0, (0.0, 2.0)) is expected


@pytest.mark.parametrize("high", [1.0, 1.5, 2.0])
def test_delay_and_place_together_are_bounded(high: float) -> None:
    # a - exp(-s tau), zero just inside the far corner of s in [-high, 0], tau in [1, 2]
    a = float(np.exp(2.0 * high)) * (1.0 - 1e-10)
    assert not excluded([acb_poly([a]), acb_poly([-1])], 0.0, high, (1.0, 2.0))


def test_high_powers_times_a_spread_of_delays_are_bounded() -> None:
    # a - (-s)^20 exp(-s tau), zero just inside s = -2, tau = 0.1; half of it is beyond t^10
    a = 2.0**20 * float(np.exp(0.2)) * (1.0 - 1e-10)
    assert not excluded([acb_poly([a]), acb_poly([0.0] * 20 + [-1.0])], 0.0, 2.0, (-0.1, 0.1))


@pytest.mark.parametrize("power", [1, 2, 3])
def test_a_delay_that_acts_several_times_over_is_bounded(power: int) -> None:
    # a - exp(-k s tau), zero just inside s = -1, tau = 1.01 (of 0.99 to 1.01)
    a = float(np.exp(1.01 * power)) * (1.0 - 1e-10)
    h = Quasipolynomial((acb_poly([a]), acb_poly([-1])), ((0,), (power,)))
    with precision(128):
        piece = Piece(h, Line(acb(0), acb(-1)), 1.0, 1.0)
        assert not piece.excludes([arb(1)], [arb("0.01")])[0]


def test_left_of_the_axis_the_longest_delay_decides_what_outweighs() -> None:
    # |p_0| = 5 at s = -1 beside exp(tau): more up to 1.6, less at 2
    h = Quasipolynomial((acb_poly([5]), acb_poly([-1])), ((0,), (1,)))
    with precision(128):
        piece = Piece(h, Line(acb(0), acb(-1)), 1.0, 1.0)
        assert piece.dominated([arb("1.6")], [arb(0)])
        assert not piece.dominated([arb(2)], [arb(0)])


def test_right_of_the_axis_the_shortest_delay_decides_what_outweighs() -> None:
    # |p_0| = 0.5 at s = 1 beside exp(-tau): less at 0.5, more from 0.7
    h = Quasipolynomial((acb_poly([0.5]), acb_poly([-1])), ((0,), (1,)))
    with precision(128):
        piece = Piece(h, Line(acb(0), acb(1)), 1.0, 1.0)
        assert piece.dominated([arb(2)], [arb("0.7")])
        assert not piece.dominated([arb(2)], [arb("0.5")])


# --- enclosures


def exact_lambert(k: int, tau: float) -> acb:
    """s = W_k(-tau) / tau to 50 digits."""
    with precision(200):
        return acb(-tau).lambertw(k) / acb(tau)


@pytest.mark.parametrize("tau", [0.7, 1.3, 5.0])
def test_lamberts_roots_are_enclosed(tau: float) -> None:
    answer = enclosed_roots(scalar(0.0, 1.0), tau, 6)
    assert len(answer.roots) == 6
    for k, root in enumerate(answer.roots):
        exact = exact_lambert(k, tau)
        centre = acb(root.mode.root.real, root.mode.root.imag)
        with precision(200):
            distance = min(abs(exact - centre), abs(exact.conjugate() - centre), key=float)
            assert distance < root.radius
        assert root.radius < 1e-12 * abs(root.mode.root)
        assert root.multiplicity == 1


def test_real_roots_are_enclosed_as_real() -> None:
    # tau < 1/e: W_0 and W_-1 are real
    answer = enclosed_roots(scalar(0.0, 1.0), 0.3, 2)
    exact = [lambertw(-0.3, k).real / 0.3 for k in (0, -1)]
    assert [r.mode.root for r in answer.roots] == pytest.approx(exact, rel=1e-12)
    assert answer.number == 2


def test_a_root_twice_is_enclosed_with_its_multiplicity() -> None:
    one = oscillator(4.0, 0.3, 1.1)
    alone, both = enclosed_roots(one, 0.5, 3), enclosed_roots(side_by_side(one, one), 0.5, 6)
    assert [r.multiplicity for r in both.roots] == [2, 2, 2]
    assert both.number == 2 * alone.number
    for root, single in zip(both.roots, alone.roots, strict=True):
        assert abs(root.mode.root - single.mode.root) < root.radius


@pytest.mark.parametrize("gain", [np.exp(-1.0) * (1 + k * 1e-15) for k in (-3, -1, 0, 1, 3)])
def test_two_roots_about_to_meet_are_both_inside_the_enclosures(gain: float) -> None:
    # s = W(-k) at tau = 1: k = 1/e is a double root at -1
    answer = enclosed_roots(scalar(0.0, gain), 1.0, 1)
    assert answer.number == 2
    with precision(200):
        for branch in (0, -1):
            exact = acb(-float(gain)).lambertw(branch)
            assert any(
                min(abs(exact - c), abs(exact.conjugate() - c), key=float) <= r.radius
                for r in answer.roots
                for c in [acb(r.mode.root.real, r.mode.root.imag)]
            )


def test_roots_without_delay_are_those_of_the_matrix() -> None:
    loop = DelaySystem(np.diag([-1.0, -2.0, -3.0]), np.zeros((3, 1)), np.zeros((1, 3)))
    answer = enclosed_roots(loop, 0.0, 5)
    assert [r.mode.root for r in answer.roots] == pytest.approx([-1.0, -2.0, -3.0], abs=1e-12)
    assert answer.number == 3


def test_delays_of_their_own_are_enclosed() -> None:
    rng = np.random.default_rng(3)
    loop = DelaySystem(rng.normal(size=(3, 3)), rng.normal(size=(3, 2)), rng.normal(size=(2, 3)))
    answer = enclosed_roots(loop, [0.2, 0.5], 4)
    estimates = [m.root for m in rightmost_roots(loop, [0.2, 0.5], 4)]
    assert [r.mode.root for r in answer.roots[:4]] == pytest.approx(estimates, rel=1e-12)


def test_right_of_lists_everything_beyond_the_line() -> None:
    exact = [complex(lambertw(-1.3, k) / 1.3) for k in range(12)]
    edge = -2.0
    answer = enclosed_roots(scalar(0.0, 1.0), 1.3, right_of=edge)
    beyond = [s for s in exact if s.real > edge]
    assert answer.right_of == edge
    assert [r.mode.root for r in answer.roots] == pytest.approx(beyond, rel=1e-12)
    assert answer.number == 2 * len(beyond)


def test_a_root_that_the_estimates_miss_is_missed_by_no_list(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    module = import_module("railenv.stability.enclosed_roots")
    propose = module._line

    def forgetful(*arguments: object) -> object:
        edge, modes = propose(*arguments)
        return edge, modes[:1] + modes[2:]

    monkeypatch.setattr(module, "_line", forgetful)
    with pytest.raises(ArgumentError, match="6 roots are there, the estimates lead to 4"):
        enclosed_roots(scalar(0.0, 1.0), 1.3, 3)


def test_nothing_beyond_a_line_is_proved_too() -> None:
    answer = enclosed_roots(scalar(0.0, 1.0), 1.3, right_of=0.5)
    assert (answer.roots, answer.number) == ((), 0)


@pytest.mark.parametrize("seed", range(4))
def test_the_number_of_enclosed_roots_is_that_of_a_fine_grid(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = 4, 2
    loop = DelaySystem(rng.normal(size=(n, n)), rng.normal(size=(n, m)), rng.normal(size=(m, n)))
    delays = rng.uniform(0.1, 0.6, m)
    answer = enclosed_roots(loop, delays.tolist(), 6)
    grid = np.linalg.eigvals(collocation_matrix(loop, delays, 40))
    assert int(np.sum(grid.real > answer.right_of)) == answer.number


def test_the_papers_loop_has_its_rightmost_roots_enclosed(loop: DelaySystem) -> None:
    answer = enclosed_roots(loop, 0.2, 4)
    estimates = [m.root for m in rightmost_roots(loop, 0.2, 4)]
    assert [r.mode.root for r in answer.roots[:4]] == pytest.approx(estimates, rel=1e-9)
    assert max(r.radius / abs(r.mode.root) for r in answer.roots) < 1e-6


def test_enclosures_of_a_neutral_loop_are_refused() -> None:
    with pytest.raises(NeutralLoopError):
        enclosed_roots(neutral(-1.0, 1.0, 0.1), 0.1)


def test_a_line_through_a_root_is_refused_with_the_way_out() -> None:
    with pytest.raises(ArgumentError, match="another count or line"):
        enclosed_roots(scalar(-1.0, 0.0), 0.0, right_of=-1.0)
