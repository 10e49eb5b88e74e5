"""Characteristic roots and crossings: closed forms, published values, two ways that agree."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.linalg import block_diag
from scipy.special import lambertw

from railenv.errors import ArgumentError
from railenv.stability import (
    DelaySystem,
    count_unstable,
    critical_delays,
    estimated_critical_delays,
    rightmost_roots,
)
from railenv.stability.spectrum import collocation_matrix
from railenv.vehicle import LateralVehicle, mode_name


def scalar(a: float, k: float) -> DelaySystem:
    """x' = a x - k x(t - tau)."""
    return DelaySystem([[a]], [[1.0]], [[k]])


def oscillator(k: float, c: float, g: float) -> DelaySystem:
    """x'' + c x' + k x = -g x'(t - tau)."""
    return DelaySystem([[0.0, 1.0], [-k, -c]], [[0.0], [1.0]], [[0.0, g]])


def test_the_scalar_equation_has_lamberts_roots() -> None:
    # s = W_k(-tau) / tau solves s + exp(-s tau) = 0
    exact = sorted((lambertw(-0.7, k) / 0.7 for k in range(5)), key=lambda s: -s.real)
    roots = [mode.root for mode in rightmost_roots(scalar(0.0, 1.0), 0.7, 5)]
    np.testing.assert_allclose(roots, exact, rtol=1e-12)


@pytest.mark.parametrize(
    ("system", "omega", "delay"),
    [
        (scalar(0.0, 1.0), 1.0, np.pi / 2),
        (scalar(0.5, 1.0), np.sqrt(3) / 2, 1.20919957615615),
        (scalar(-1.0, 2.0), np.sqrt(3), 1.20919957615615),
        (
            DelaySystem([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 1.0]]),
            1.27201964951407,
            0.711118648715793,
        ),
    ],
)
def test_known_first_crossings_are_found_to_all_digits(
    system: DelaySystem, omega: float, delay: float
) -> None:
    first = critical_delays(system).first
    assert first is not None
    assert first.mode.root.imag == pytest.approx(omega, rel=1e-12)
    assert first.delay == pytest.approx(delay, rel=1e-12)


@given(k=st.floats(1.0, 200.0), c=st.floats(0.01, 2.0), ratio=st.floats(1.05, 20.0))
def test_velocity_feedback_of_one_mass_crosses_where_the_closed_form_says(
    k: float, c: float, ratio: float
) -> None:
    g = ratio * c
    # cos(omega tau) = -c / g; omega = (+-sqrt(g^2 - c^2) + sqrt(g^2 - c^2 + 4 k)) / 2
    root = np.sqrt(g**2 - c**2)
    expected = []
    for sign in (1, -1):
        omega = (sign * root + np.sqrt(root**2 + 4 * k)) / 2
        phase = np.arccos(-c / g) if sign > 0 else 2 * np.pi - np.arccos(-c / g)
        expected += [
            ((phase + 2 * np.pi * n) / omega, sign)
            for n in range(40)
            if (phase + 2 * np.pi * n) / omega <= 2.0
        ]
    found = critical_delays(oscillator(k, c, g), 2.0).crossings
    assert [x.delay for x in found] == pytest.approx(sorted(d for d, _ in expected), rel=1e-9)
    assert [x.direction for x in found] == [s for _, s in sorted(expected)]


def test_a_gain_below_the_damping_never_crosses() -> None:
    assert critical_delays(oscillator(50.0, 0.6, 0.5)).crossings == ()


def test_stability_returns_in_a_second_window() -> None:
    answer = critical_delays(oscillator((2 * np.pi * 1.2) ** 2, 0.6, 1.5))
    windows = answer.stable_windows
    assert len(windows) > 1
    middle = (windows[1][0] + windows[1][1]) / 2
    assert rightmost_roots(oscillator((2 * np.pi * 1.2) ** 2, 0.6, 1.5), middle, 1)[0].root.real < 0


def test_the_papers_loop_has_its_crossings_with_modes(
    vehicle: LateralVehicle, loop: DelaySystem
) -> None:
    found = [
        (c.delay, c.frequency_hz, c.direction, mode_name(vehicle, c.mode.root, c.mode.shape))
        for c in critical_delays(loop, 0.6).crossings
    ]
    assert [x[0] for x in found] == pytest.approx([0.2020, 0.2132, 0.3712], abs=5e-5)
    assert [x[1] for x in found] == pytest.approx([1.3230, 1.3111, 0.7154], abs=5e-5)
    assert [x[2] for x in found] == [1, 1, 1]
    assert [x[3] for x in found] == ["upper centre roll", "carbody yaw", "lower centre roll"]


@pytest.mark.parametrize("seed", range(12))
def test_the_staircase_of_crossings_is_the_count_of_roots(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(2, 7)), int(rng.integers(1, 3))
    A = rng.normal(size=(n, n)) - 1.2 * np.eye(n)
    system = DelaySystem(A, rng.normal(size=(n, m)), rng.normal(size=(m, n)))
    answer = critical_delays(system, 3.0)
    edges = [0.0, *(c.delay for c in answer.crossings), 3.0]
    for low, high in pairwise(edges):
        middle = (low + high) / 2
        assert answer.unstable_roots(middle) == count_unstable(system, middle)


@pytest.mark.parametrize("copies", [2, 3])
def test_identical_loops_side_by_side_are_counted_once_each(copies: int) -> None:
    one = oscillator(40.0, 0.6, 4.0)
    many = DelaySystem(*(block_diag(*[matrix] * copies) for matrix in (one.A, one.B, one.K)))
    answer, alone = critical_delays(many, 1.5), critical_delays(one, 1.5)
    assert len(answer.crossings) == copies * len(alone.crossings)
    for delay in (0.1, 0.3, 0.95, 1.2):
        assert answer.unstable_roots(delay) == copies * alone.unstable_roots(delay)


def test_root_speed_at_a_crossing_is_the_slope_of_the_root(loop: DelaySystem) -> None:
    first = critical_delays(loop, 0.25).first
    assert first is not None
    step = 1e-5
    before, after = (rightmost_roots(loop, first.delay + d, 1)[0].root for d in (-step, step))
    # central difference: error of the order of step squared
    assert (after - before) / (2 * step) == pytest.approx(first.speed, rel=1e-6)


def test_every_root_solves_the_characteristic_equation(loop: DelaySystem) -> None:
    for delay in (0.0, 0.003, 0.1, 0.2, 0.5):
        delays = loop.delays(delay)
        for mode in rightmost_roots(loop, delay, 12):
            M = loop.characteristic_matrix(mode.root, delays)
            residual = (
                np.linalg.norm(M @ mode.shape) / np.linalg.norm(M) / np.linalg.norm(mode.shape)
            )
            assert residual < 1e-10


def test_delays_of_their_own_per_channel_agree_with_a_finer_grid(loop: DelaySystem) -> None:
    delays = np.array([0.05, 0.1, 0.1, 0.2])
    fine = np.linalg.eigvals(collocation_matrix(loop.scaled, delays, 40))
    rightmost = fine[np.argsort(-fine.real)]
    rightmost = rightmost[rightmost.imag >= 0.0][:6]
    roots = [mode.root for mode in rightmost_roots(loop, delays.tolist(), 6)]
    np.testing.assert_allclose(roots, rightmost, rtol=1e-8)


def test_equal_delays_per_channel_are_one_common_delay(loop: DelaySystem) -> None:
    common = [m.root for m in rightmost_roots(loop, 0.2, 5)]
    assert [m.root for m in rightmost_roots(loop, [0.2] * 4, 5)] == pytest.approx(common, rel=1e-12)


def test_two_rare_roots_of_one_place_are_both_listed(loop: DelaySystem) -> None:
    # the antisymmetric yaw-damper nodes decay alone at K / C = 8.8e6 / 330e3, once per bogie
    roots = np.array([m.root for m in rightmost_roots(loop, 0.0, 12)])
    assert np.sum(np.abs(roots + 8.8e6 / 330e3) < 1e-6) == 2


def test_a_free_motion_is_named_and_never_stable() -> None:
    free = DelaySystem([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[0.0, 1.0]])
    answer = critical_delays(free)
    assert answer.proved
    assert answer.marginal == 1  # s = 0; the other root is that of x' = -x(t - tau)
    assert answer.critical_delay == 0.0
    assert answer.stable_windows == ()
    assert answer.crossings[0].delay == pytest.approx(np.pi / 2, rel=1e-14)


def test_the_estimate_refuses_a_free_motion() -> None:
    free = DelaySystem([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[0.0, 1.0]])
    with pytest.raises(ArgumentError, match="imaginary axis"):
        estimated_critical_delays(free)


def test_an_unstable_loop_without_delay_has_critical_delay_zero() -> None:
    assert critical_delays(scalar(1.0, 0.5)).critical_delay == 0.0


def test_a_delay_beyond_the_search_has_no_count() -> None:
    with pytest.raises(ArgumentError, match="beyond the searched"):
        critical_delays(scalar(0.0, 1.0), 1.0).unstable_roots(1.5)


def test_only_the_exact_answer_claims_to_be_proved(loop: DelaySystem) -> None:
    assert critical_delays(loop).proved is True
    assert estimated_critical_delays(loop).proved is False


@pytest.mark.parametrize("delay", [0.05, 0.1, 0.5, 1.0, 3.0, 10.0])
def test_delayed_position_feedback_is_counted_at_any_delay(delay: float) -> None:
    # its later roots lie far to the left, where no grid resolves them
    loop = DelaySystem([[0.0, 1.0], [-1.0, -0.1]], [[0.0], [1.0]], [[0.5, 0.0]])
    assert count_unstable(loop, delay) == critical_delays(loop, 11.0).unstable_roots(delay)
    assert len(rightmost_roots(loop, delay, 2)) == 2


@pytest.mark.parametrize("delays", [[0.3, 0.0], [0.2, 0.1], [0.3, 0.1], [0.0, 0.3], [0.01, 0.2]])
def test_a_pendulum_with_two_delays_has_its_roots(delays: list[float]) -> None:
    loop = DelaySystem(
        [[0.0, 1.0], [9.81, 0.0]], [[0.0, 0.0], [1.0, 1.0]], [[20.0, 0.0], [0.0, 6.0]]
    )
    for mode in rightmost_roots(loop, delays, 3):
        s = mode.root
        left = s**2 - 9.81 + 20.0 * np.exp(-s * delays[0]) + 6.0 * s * np.exp(-s * delays[1])
        assert abs(left) < 1e-9 * (abs(s) ** 2 + 30.0)


@pytest.mark.parametrize("unit", [1e-9, 1e-3, 1e6, 1e12])
def test_the_unit_of_time_does_not_matter(unit: float) -> None:
    one = oscillator(9.0, 0.3, 1.0)
    other = DelaySystem(one.A * unit, one.B * unit, one.K)
    expected = [c.delay for c in critical_delays(one, 5.0).crossings]
    found = [c.delay * unit for c in critical_delays(other, 5.0 / unit).crossings]
    assert found == pytest.approx(expected, rel=1e-9)
    assert count_unstable(other, 1.127 / unit) == count_unstable(one, 1.127)


def test_an_undamped_oscillator_is_counted_by_where_the_first_delay_moves_it() -> None:
    for gain in (1.0, -1.0):
        loop = DelaySystem([[0.0, 1.0], [-4.0, 0.0]], [[0.0], [1.0]], [[gain, 0.0]])
        answer = critical_delays(loop, 6.0)
        for delay in (0.1, 1.2, 2.3, 3.5, 5.0):
            assert answer.unstable_roots(delay) == count_unstable(loop, delay)


def test_so_many_crossings_that_nobody_reads_them_are_refused(loop: DelaySystem) -> None:
    with pytest.raises(ArgumentError, match="give a shorter one"):
        critical_delays(loop, 1e6)


def test_complex_matrices_are_refused() -> None:
    with pytest.raises(ArgumentError, match="real numbers"):
        DelaySystem([[1j]], [[1.0]], [[1.0]])


@pytest.mark.parametrize("seed", range(30))
@pytest.mark.slow
def test_long_delays_of_fast_loops_are_counted_or_refused(seed: int) -> None:
    # omega tau up to some hundreds: dozens of unstable roots around the resonance, which a coarse
    # grid does not show and which no two coarse grids may agree away
    rng = np.random.default_rng(seed)
    omega = 10 ** rng.uniform(0.0, 2.3)
    c = omega * 10 ** rng.uniform(-3.0, -0.5)
    g = c * rng.uniform(0.5, 8.0)
    loop = DelaySystem([[0.0, 1.0], [-(omega**2), -c]], [[0.0], [1.0]], [[g * omega * 0.3, g]])
    answer = critical_delays(loop, 3.0)
    for delay in rng.uniform(0.01, 3.0, 3):
        try:
            number = count_unstable(loop, delay)
        except ArgumentError:
            assert omega * delay > 100.0
            continue
        assert number == answer.unstable_roots(delay)


def test_as_many_roots_come_back_as_were_asked_for() -> None:
    modes = rightmost_roots(oscillator(1.0, 0.1, 0.5), 1.0, 50)
    assert len(modes) == 50
    for mode in modes:
        s = mode.root
        left = s**2 + 0.1 * s + 1.0 + 0.5 * s * np.exp(-s)
        assert abs(left) < 1e-8 * abs(s) ** 2
