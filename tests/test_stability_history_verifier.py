"""Saved proofs about loops with a finite history are proved anew, in balls."""

import json

import numpy as np
import pytest
from flint import acb, acb_mat, acb_poly, arb, fmpq

from railenv.stability import FiniteHistoryLoop, certify
from railenv.stability.certificate import digest
from railenv.stability.verifier import verify_certificate
from railenv.stability.verifier.history_boxes import Box, place_to_cut
from railenv.stability.verifier.history_function import (
    ORDER,
    chebyshev_product,
    folded,
    powers,
    reciprocal,
)
from railenv.stability.verifier.history_modes import DEGREE, late_series

T = 0.125


def lag(gains, told=(0.0,), pole=-1.0, commanded=None, D=0.0):
    """A first-order plant under u_k = -g y_k, one gain per knot."""
    one = np.ones((1, 1))
    q = len(gains)
    return FiniteHistoryLoop(
        pole * one,
        one,
        one,
        D * one,
        T,
        np.reshape(gains, (q, 1, 1, 1)),
        np.zeros((q, 0, 1, 1)) if commanded is None else np.array(commanded),
        one,
        np.array(told),
    )


def saved(tmp_path, system, delay, error=0.0, **changes):
    """Save a certificate, with some entries of the claim or the whole changed."""
    plain = certify(system, delay, told_error=error).to_plain()
    for name, value in changes.items():
        (plain if name in plain else plain["claim"])[name] = value
        if name == "verdict":
            plain["claim"]["verdict"] = value
    plain["digest"] = digest(plain)
    path = tmp_path / "c.json"
    path.write_text(json.dumps(plain))
    return path


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gains", "told", "delay", "error"),
    [
        ([3.0], (0.0,), (0.0, 0.2), 0.0),
        ([1.0, 2.0, 1.0], (0.0, 0.1, 0.2), (0.05, 0.2), 0.05),
        ([40.0], (0.0,), (0.0, 0.2), 0.0),
        ([1.0, 40.0], (0.0, 0.2), (0.0, 0.2), 0.05),
    ],
)
def test_what_was_proved_is_proved_anew(tmp_path, gains, told, delay, error):
    system = lag(gains, told)
    path = saved(tmp_path, system, delay, error)
    result = verify_certificate(path, system)
    assert result.accepted, result.reasons
    assert not verify_certificate(path, lag([2 * g for g in gains], told)).accepted


@pytest.mark.slow
def test_a_law_with_two_signals_is_proved_anew(tmp_path):
    rng = np.random.default_rng(5)
    system = FiniteHistoryLoop(
        np.array([[-1.0, 2.0], [-2.0, -1.5]]),
        rng.normal(size=(2, 3)),
        rng.normal(size=(2, 2)),
        0.2 * rng.normal(size=(2, 3)),
        T,
        0.1 * rng.normal(size=(2, 2, 2, 2)),
        0.2 * rng.normal(size=(2, 1, 2, 2)),
        rng.normal(size=(3, 2)),
        np.array([0.0, 0.2]),
    )
    path = saved(tmp_path, system, (0.05, 0.15), 0.05)
    result = verify_certificate(path, system)
    assert result.certificate["verdict"] == "STABLE"
    assert result.accepted, result.reasons


@pytest.mark.slow
def test_more_than_was_proved_is_rejected(tmp_path):
    # Stable to 0.2 s, unstable at 1 s.
    path = saved(tmp_path, lag([3.0]), (0.0, 0.2), high=1.0)
    assert not verify_certificate(path).accepted
    # A gain of 40 is told beyond 0.2 s only.
    system = lag([1.0, 1.0, 40.0], (0.0, 0.2, 0.21))
    path = saved(tmp_path, system, (0.0, 0.15), 0.01)
    assert verify_certificate(path).accepted
    path = saved(tmp_path, system, (0.0, 0.15), 0.01, told_error=0.1)
    assert not verify_certificate(path).accepted


@pytest.mark.slow
def test_only_the_unstable_side_of_a_jump_is_enough_to_reject(tmp_path):
    # Unstable below one period of delay, stable from there: see the proof's own test.
    system = lag([0.6], pole=-50.0, commanded=[[[[0.6]]]], D=1.0)
    path = saved(tmp_path, system, (T, 1.5 * T))
    assert verify_certificate(path).accepted
    path = saved(tmp_path, system, (T, 1.5 * T), low=T - 1e-9)
    assert not verify_certificate(path).accepted


@pytest.mark.slow
def test_a_false_count_or_a_witness_out_of_the_range_is_rejected(tmp_path):
    system = lag([0.5], pole=1.0)
    for changes in ({"unstable_roots": 2}, {"witness": 0.5}, {"verdict": "STABLE"}, {"low": 0.05}):
        path = saved(tmp_path, system, (0.0, 0.1), **changes)
        assert not verify_certificate(path).accepted, changes
    told = lag([1.0, 40.0], (0.0, 0.2))
    path = saved(tmp_path, told, (0.0, 0.2), 0.05, witness_told=0.35)
    assert not verify_certificate(path).accepted


@pytest.mark.slow
def test_a_plant_that_is_unstable_by_itself_is_counted_with_its_own_modes(tmp_path):
    assert verify_certificate(saved(tmp_path, lag([3.0], pole=1.0), (0.0, 0.1))).accepted
    assert verify_certificate(saved(tmp_path, lag([0.5], pole=1.0), (0.0, 0.1))).accepted


@pytest.mark.slow
def test_what_a_file_must_not_hold_is_rejected(tmp_path):
    system = lag([3.0])
    for changes in (
        {"period": 0.25},
        {"told_error": -0.1},
        {"low": 0.3},
        {"verdict": "UNDECIDED"},
        {"high": 1e9},
    ):
        assert not verify_certificate(saved(tmp_path, system, (0.0, 0.2), **changes)).accepted
    plain = certify(system, (0.0, 0.2)).to_plain()
    for name, value in (("told", [0.0, 0.1]), ("measured", [[[[3.0], [1.0]]]]), ("A", [[0.0]])):
        changed = {**plain, "system": {**plain["system"], name: value}}
        changed["digest"] = digest(changed)
        path = tmp_path / "d.json"
        path.write_text(json.dumps(changed))
        assert not verify_certificate(path).accepted, name


def test_a_box_is_free_of_zeros_only_if_its_constant_is_larger_than_all_else():
    def cut(entries, radius=0.0):
        rows = [[acb(0)] * (3 * (ORDER + 1)) for _ in range(8)]
        for (sigma, rho, x), value in entries.items():
            rows[rho][sigma * (ORDER + 1) + x] = acb(value)
        rows[0][0] += acb(arb(0, radius), arb(0))
        whole = Box(0, 0, fmpq(0), fmpq(1), fmpq(0), fmpq(1))
        return place_to_cut(acb_mat(rows), whole)

    assert cut({(0, 0, 0): 1.0, (1, 0, 0): 0.5, (0, 1, 0): 0.4}) == ""
    assert cut({(0, 0, 0): 1.0, (1, 0, 0): 0.7, (0, 1, 0): 0.6}) == "sigma"
    assert cut({(0, 0, 0): 1.0, (1, 0, 0): 0.6, (0, 1, 0): 0.7}) == "rho"
    assert cut({(0, 0, 0): 1.0, (0, 0, 1): 1.3}) == "x"
    assert cut({(0, 0, 0): 1.0}, 0.99) == ""
    assert cut({(0, 0, 0): 1.0}, 1.01) == "x"


def test_what_is_beyond_the_order_of_a_polynomial_goes_to_its_constant():
    poly = acb_poly([1] * (ORDER + 3))
    cut = folded(poly)
    assert len(cut.coeffs()) == ORDER + 1
    # Two coefficients of one were cut; at x = 1 the true value is ORDER + 3.
    assert cut(1).real.contains(ORDER + 3)
    assert cut(-1).real.contains(1)


def test_a_reciprocal_holds_the_true_one_at_both_ends():
    inverse = reciprocal(acb_poly([2, -1]))
    assert inverse(1).real.contains(1)
    assert inverse(-1).real.contains(arb(1) / 3)
    with pytest.raises(ZeroDivisionError):
        reciprocal(acb_poly([1.01, -1]))


def test_powers_of_a_turn_hold_the_true_ones_at_the_end_of_the_arc():
    # Forty turns of pi / 64: two radians, far from what degree 10 follows exactly.
    power = powers(fmpq(3, 10), fmpq(1, 64), 40)[40]
    true = (-40 * (arb(3) / 10 + arb(1) / 64)).cos_pi()
    assert power(1).real.overlaps(true)
    assert float(power(1).real.rad()) > 1e-6


def test_a_chebyshev_product_beyond_the_degree_goes_to_the_constant():
    series = [acb_poly([int(j == DEGREE)]) for j in range(DEGREE + 1)]
    product = chebyshev_product(series, series)
    # T_7(1)^2 = 1.
    assert sum((poly(0) for poly in product), acb(0)).real.contains(1)


def test_the_series_in_the_rest_of_the_delay_holds_a_mode_that_turns_fast():
    # g(T - r) is zero at r = T, rho = 1; 7 rad within the period.
    coefs = late_series(acb(-40, 700), arb(0.01))
    assert sum(coefs, acb(0)).contains(0)
    assert float(abs(sum(coefs, acb(0)).mid())) > 1e-9
