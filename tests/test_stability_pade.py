"""The Pade model: the ladder's invariants, its transfer function, and the exact roots beside it."""

import numpy as np
import pytest

from railenv.errors import ArgumentError
from railenv.stability import (
    DelaySystem,
    critical_delays,
    pade_critical_delays,
    pade_matrix,
    pade_roots,
    required_order,
    rightmost_roots,
)
from railenv.stability.pade import pade_block

# m = 1, f = 1.2 Hz, c = 0.05 and g = 0.3 of critical... as x'' + c x' + k x = -g x'(t - tau)
OSCILLATOR = DelaySystem(
    [[0.0, 1.0], [-((2 * np.pi * 1.2) ** 2), -0.6]], [[0.0], [1.0]], [[0.0, 4.0]]
)


@pytest.mark.parametrize("order", [1, 2, 3, 8, 16, 32])
@pytest.mark.parametrize("delay", [0.002, 0.2])
def test_the_ladder_is_lossless(order: int, delay: float) -> None:
    A, B, _, D = pade_block(order, delay)
    # A + A' + B B' = 0, to rounding of its largest entry
    np.testing.assert_allclose(A + A.T + np.outer(B, B), 0.0, atol=1e-13 * np.abs(A).max())
    assert abs(D) == 1.0


@pytest.mark.parametrize(
    ("order", "x", "error"),
    [
        (4, 0.5, 7.6e-11),
        (4, 1.5, 1.4e-6),
        (4, np.pi, 8.7e-4),
        (8, np.pi, 5e-11),
        (8, 2 * np.pi, 4e-6),
    ],
)
def test_the_approximation_error_is_the_known_one(order: int, x: float, error: float) -> None:
    delay = 0.2
    A, B, C, D = pade_block(order, delay)
    s = 1j * x / delay
    value = C @ np.linalg.solve(s * np.eye(order) - A, B) + D
    # figures known to one or two digits
    assert abs(value - np.exp(-1j * x)) == pytest.approx(error, rel=0.12)


def test_order_one_is_the_textbook_all_pass() -> None:
    A, B, C, D = pade_block(1, 0.2)
    s = 0.3 + 2.0j
    assert C @ B / (s - A[0, 0]) + D == pytest.approx((1 - 0.1 * s) / (1 + 0.1 * s), rel=1e-14)


def test_each_channel_has_a_block_of_its_own(loop: DelaySystem) -> None:
    assert pade_matrix(loop, 0.2, 8).shape == (38 + 4 * 8, 38 + 4 * 8)


def test_no_delay_is_the_undelayed_loop(loop: DelaySystem) -> None:
    np.testing.assert_array_equal(pade_matrix(loop, 0.0, 8), loop.undelayed)


def test_order_eight_has_the_exact_body_roots(loop: DelaySystem) -> None:
    exact = [m.root for m in rightmost_roots(loop, 0.2, 3)]
    assert [m.root for m in pade_roots(loop, 0.2, 8, 3)] == pytest.approx(exact, rel=1e-9)


def test_order_eight_agrees_on_the_critical_delay(loop: DelaySystem) -> None:
    exact = critical_delays(loop, 0.25).critical_delay
    # published bound 1e-6; at omega tau = 1.7 order eight is at rounding
    assert pade_critical_delays(loop, 8, 0.25).critical_delay == pytest.approx(exact, rel=1e-10)


def test_low_orders_err_on_the_unsafe_side_and_less_with_each_order(loop: DelaySystem) -> None:
    exact = critical_delays(loop, 0.25).critical_delay
    assert exact is not None
    errors = []
    for order in (1, 2, 3, 4, 5):
        found = pade_critical_delays(loop, order, 0.4).critical_delay
        assert found is not None
        errors.append(found / exact - 1.0)
    assert all(e > 0.0 for e in errors)
    assert errors == sorted(errors, reverse=True)
    # 1-DOF and vehicle figures known: 1e-2 for order two, some 1e-6 for order four
    assert errors[1] == pytest.approx(1e-2, rel=0.5)
    assert 1e-7 < errors[3] < 2e-5


def test_frequency_of_one_mass_is_within_one_per_cent_from_order_four() -> None:
    for delay in (0.05, 0.15, 0.25):
        exact = rightmost_roots(OSCILLATOR, delay, 1)[0]
        pade = pade_roots(OSCILLATOR, delay, 4, 1)[0]
        assert pade.frequency_hz == pytest.approx(exact.frequency_hz, rel=1e-2)


def test_the_papers_order_rule_gives_eight_for_ten_hertz_and_200_ms() -> None:
    assert required_order(0.2, 10.0) == 8


@pytest.mark.parametrize("order", [0, -1, 65, 2.5, "8"])
def test_an_impossible_order_is_refused(order: object) -> None:
    with pytest.raises(ArgumentError, match="order"):
        pade_block(order, 0.1)  # type: ignore[arg-type]
