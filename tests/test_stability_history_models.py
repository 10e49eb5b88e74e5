"""The arithmetic under the proofs about loops with a finite history: bounds hold, exactly."""

from fractions import Fraction

import numpy as np
import pytest
from flint import fmpq_mat
from scipy import linalg

from railenv.actuation.hold import held_input
from railenv.stability import FiniteHistoryLoop
from railenv.stability.proof.ball_matrices import rational
from railenv.stability.proof.history_boxes import chebyshev_part
from railenv.stability.proof.history_function import Arc, HistoryFunction
from railenv.stability.proof.history_models import (
    ORDER,
    Constants,
    Models,
    chebyshev_product,
    combined,
    constant,
    matrix_product,
    powers,
    reciprocal,
)
from railenv.stability.proof.history_modes import DEGREE, ModesError, held_modes

# Neither of the products of these two numbers, nor their sum, is a double.
ODD, SMALL = 1.0 + 2.0**-30, 2.0**-60


def number(value, rest=0.0, power=0):
    """A model that is `value` times x^power."""
    coefs = np.zeros((1, ORDER + 1), complex)
    coefs[0, power] = value
    return Models(coefs, np.array([rest]))


def error(models, exact):
    """Distance of a model's constant coefficient from an exact number."""
    return abs(Fraction(models.coefs.ravel()[0].real) - exact)


def test_a_sum_that_no_double_holds_is_within_its_bound():
    total = number(1.0) + number(SMALL)
    assert error(total, 1 + Fraction(SMALL)) == Fraction(SMALL)
    assert Fraction(total.rest[0]) >= Fraction(SMALL)


@pytest.mark.parametrize("kind", ["product", "matrix", "combined", "chebyshev"])
def test_a_product_that_no_double_holds_is_within_its_bound(kind):
    a = number(ODD)
    if kind == "product":
        product = a * a
    elif kind == "matrix":
        product = matrix_product(a[:, None], a[:, None])
    elif kind == "combined":
        weights = Constants(np.array([[ODD + 0j]]), np.zeros((1, 1)))
        product = combined(weights, a)
    else:
        product = chebyshev_product(a, a)
    missed = error(product, Fraction(ODD) ** 2)
    assert missed > 0
    assert Fraction(product.rest.ravel()[0]) >= missed


def test_what_is_beyond_the_order_is_in_the_bound():
    high = number(3.0, power=ORDER) * number(2.0, power=1)
    assert np.all(high.coefs == 0.0)
    # |6 x^11| is at most 6 and reaches it.
    assert high.rest[0] >= 6.0
    product = matrix_product(number(3.0, power=ORDER)[:, None], number(2.0, power=1)[:, None])
    assert product.rest[0, 0] >= 6.0


def test_bounds_of_both_factors_carry_into_a_product():
    # (1 +- 0.5)(2 +- 0.25) reaches 1.5 * 2.25 = 3.375, which is 1.375 from 2.
    for product in (
        number(1.0, 0.5) * number(2.0, 0.25),
        matrix_product(number(1.0, 0.5)[:, None], number(2.0, 0.25)[:, None])[0],
    ):
        assert product.rest[0] == pytest.approx(1.375, rel=1e-9)
        assert product.rest[0] >= 1.375


def test_chebyshev_products_beyond_the_degree_are_in_the_bound():
    # T_7^2 = (T_14 + T_0) / 2: half stays, half is left out.
    coefs = np.zeros((DEGREE + 1, ORDER + 1), complex)
    coefs[DEGREE, 0] = 1.0
    series = Models(coefs, np.zeros(DEGREE + 1))
    product = chebyshev_product(series, series)
    assert product.coefs[0, 0] == 0.5
    assert product.rest.sum() >= 0.5
    assert product.rest.sum() == pytest.approx(0.5, rel=1e-9)


def test_a_reciprocal_encloses_the_true_one_next_to_its_pole():
    # 1 / (1.02 - x) has its pole just outside: the power series is far from it, the bound is not.
    coefs = np.zeros((1, ORDER + 1), complex)
    coefs[0, :2] = 2.0, -1.0
    inverse = reciprocal(Models(coefs, np.array([1e-3])))
    x = np.linspace(-1.0, 1.0, 101)
    values = np.polyval(inverse.coefs[0, ::-1], x)
    for shift in (-1e-3, 1e-3):
        assert np.all(np.abs(values - 1 / (2 - x + shift)) <= inverse.rest[0])
    coefs[0, 0] = 1.02
    assert reciprocal(Models(coefs, np.zeros(1))) is None


def test_powers_of_a_turn_are_enclosed_far_from_the_arc_s_middle():
    step = 1 / 64
    turn = [complex(np.exp(-0.3j * np.pi * n)) for n in range(80)]
    models = powers(turn, step)
    for x in (-1.0, 0.37, 1.0):
        true = np.exp(-1j * np.pi * (0.3 + step * x) * np.arange(80))
        values = models.coefs @ x ** np.arange(ORDER + 1)
        # 80 turns of 0.3 pi: the argument itself is rounded by 2e-14 in this test.
        assert np.all(np.abs(values - true) <= models.rest + 1e-13)
        assert np.abs(values - true).max() > 1e-6  # the bound is really needed


def test_a_chebyshev_series_on_a_part_of_its_range_is_the_same_function():
    R = chebyshev_part(DEGREE + 1, np.array(0.3), np.array(0.2))
    x = np.linspace(-1.0, 1.0, 9)
    whole = np.polynomial.chebyshev.chebvander(0.3 + 0.2 * x, DEGREE)
    part = np.polynomial.chebyshev.chebvander(x, DEGREE)
    # Coefficients of order one, eight of them.
    assert part @ R == pytest.approx(whole, abs=1e-13)


def random_loop(seed, n=4, period=0.1):
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(n, n)) * 3 - 4 * np.eye(n)
    return FiniteHistoryLoop(
        A=A,
        B=rng.normal(size=(n, 3)),
        C=rng.normal(size=(2, n)),
        D=rng.normal(size=(2, 3)),
        period=period,
        measured=rng.normal(size=(3, 4, 2, 2)),
        commanded=rng.normal(size=(3, 2, 2, 2)),
        spread=rng.normal(size=(3, 2)),
        told=np.array([0.0, 0.1, 0.3]),
    )


def modes_of(loop):
    spread = rational(loop.spread)
    B, D = rational(loop.B) * spread, rational(loop.D) * spread
    return held_modes(loop.A, B, loop.C, D, loop.period)


def characteristic(loop, w, whole, rest, interval, sigma):
    """f at one point, by a matrix exponential and a dense solve: no modes, no polynomials."""
    T, S = loop.period, loop.spread
    flow, full = held_input(loop.A, loop.B @ S, T)
    _, late = held_input(loop.A, loop.B @ S, T - rest)
    resolvent = np.linalg.solve(np.eye(len(flow)) - w * flow, late + w * (full - late))
    P = loop.D @ S + loop.C @ resolvent
    share = (1 + sigma) / 2
    G, F = (
        (1 - share) * X[interval] + share * X[interval + 1] for X in (loop.measured, loop.commanded)
    )
    X = np.eye(2) + sum(gain * w ** (h + 1) for h, gain in enumerate(F))
    Y = sum(gain * w ** (h + 1) for h, gain in enumerate(G)) @ P
    return np.linalg.det(X + w**whole * Y)


@pytest.mark.parametrize("seed", range(3))
def test_the_characteristic_function_is_enclosed_over_arc_delay_and_told_delay(seed):
    loop = random_loop(seed)
    rng = np.random.default_rng(seed + 100)
    function = HistoryFunction(modes_of(loop), loop.measured, loop.commanded, 5)
    for arc in (Arc(1 / 64, 1 / 64), Arc(0.4, 1 / 64), Arc(0.75, 1e-3)):
        wholes, intervals = np.array([0, 3, 5, 5]), np.array([0, 1, 0, 1])
        found = function.on(arc, wholes, intervals)
        for case in range(4):
            for corner in (*rng.uniform(-1, 1, (4, 3)), (1, 1, 1), (-1, -1, 1), (-1, 1, -1)):
                x, rho, sigma = corner
                w = np.exp(-1j * np.pi * (arc.t + arc.s * x))
                rest = loop.period * (1 + rho) / 2
                true = characteristic(loop, w, wholes[case], rest, intervals[case], sigma)
                chebyshev = np.polynomial.chebyshev.chebvander
                value = np.einsum(
                    "sre,s,r,e",
                    found.coefs[case],
                    chebyshev(sigma, 2).ravel(),
                    chebyshev(rho, DEGREE).ravel(),
                    x ** np.arange(ORDER + 1),
                )
                # The dense evaluation is itself good to 1e-10 of numbers up to a hundred.
                assert abs(value - true) <= found.rest[case] + 1e-8
                assert found.rest[case] < 0.05 * np.abs(found.coefs[case]).sum()


def test_a_mode_that_turns_fast_within_a_period_is_enclosed_with_its_series_remainder():
    # 3.5 rad in half a period: the series of degree 7 leaves out a thousandth and more.
    A = np.array([[-4.0, 70.0], [-70.0, -4.0]])
    # One signal alone: no product of two series, whose own bound would cover for it.
    gains = np.array([[[[1.0], [0.0]]]])
    spread = np.array([[1.0, 0.5]])
    fast = FiniteHistoryLoop(
        A,
        np.array([[0.0], [70.0]]),
        np.array([[1.0, 0.0]]),
        np.zeros((1, 1)),
        0.1,
        np.concatenate([gains, gains]),
        np.zeros((2, 0, 2, 2)),
        spread,
        np.array([0.0, 1.0]),
    )
    function = HistoryFunction(modes_of(fast), fast.measured, fast.commanded, 1)
    arc, one = Arc(0.3, 1e-4), np.ones(1, dtype=int)
    found = function.on(arc, one, 0 * one)
    missed = []
    for rho in np.linspace(-1.0, 1.0, 21):
        true = characteristic(fast, np.exp(-0.3j * np.pi), 1, 0.05 * (1 + rho), 0, 0.0)
        chebyshev = np.polynomial.chebyshev.chebvander
        sigma = chebyshev(0.0, 2).ravel()
        value = sigma @ found.coefs[0, :, :, 0] @ chebyshev(rho, DEGREE).ravel()
        missed.append(abs(value - true))
    assert max(missed) > 1e-4
    assert max(missed) <= found.rest[0]


def test_an_arc_that_is_too_long_beside_a_mode_has_no_bound():
    loop = random_loop(0)
    weak = FiniteHistoryLoop(
        **{
            **{name: getattr(loop, name) for name in ("B", "C", "D", "measured", "commanded")},
            "A": np.diag([-1e-3, -1.0, -2.0, -3.0]),
            "period": 0.1,
            "spread": loop.spread,
            "told": loop.told,
        }
    )
    function = HistoryFunction(modes_of(weak), weak.measured, weak.commanded, 1)
    case = np.zeros(1, dtype=int)
    assert np.isinf(function.on(Arc(1 / 64, 1 / 64), case, case).rest[0])
    assert np.isfinite(function.on(Arc(0.5, 1 / 64), case, case).rest[0])


def test_modes_multiply_out_to_the_held_plant_with_equal_eigenvalues():
    # Two equal eigenvalues with independent eigenvectors: twin parts of a vehicle.
    T = np.array([[1.0, 2.0, 0.5], [0.0, 1.0, 0.3], [0.4, 0.0, 1.0]])
    A = T @ np.diag([-2.0, -2.0, -5.0]) @ linalg.inv(T)
    # Rounded, the two differ by rounding; exact twins are the harder case.
    A = np.where(np.abs(A) < 1e-12, 0.0, A)
    exact = np.diag([-2.0, -2.0, -5.0])
    for plant in (A, exact):
        B, C = np.eye(3)[:, :2], np.ones((1, 3))
        modes = held_modes(plant, rational(B), C, fmpq_mat(1, 2), 0.1)
        assert modes.outside == 0
        w, rest = np.exp(-0.7j), 0.03
        flow, full = held_input(plant, B, 0.1)
        _, late = held_input(plant, B, 0.07)
        dense = C @ np.linalg.solve(np.eye(3) - w * flow, late + w * (full - late))
        rho = 2 * rest / 0.1 - 1
        series = modes.late.middle @ np.polynomial.chebyshev.chebvander(rho, DEGREE).ravel()
        held = ((1 - w) * series + w * modes.whole.middle) / (1 - w * modes.turn.middle)
        # Chebyshev series of degree 7 of exp(-0.25 rho): left out 1e-11.
        assert np.abs(modes.residues.middle @ held - dense).max() < 1e-9


def test_a_plant_without_enough_eigenvectors_or_on_the_circle_is_refused():
    jordan = np.array([[-1.0, 1.0], [0.0, -1.0]])
    for plant, said in ((jordan, "eigenvectors"), (np.diag([0.0, -1.0]), "unit circle")):
        with pytest.raises(ModesError, match=said):
            held_modes(plant, rational(np.eye(2)), np.eye(2), fmpq_mat(2, 2), 0.1)


def test_a_constant_s_radius_stays_in_the_model():
    model = constant(Constants(np.array([1.0 + 0j]), np.array([0.25])))
    assert model.rest[0] >= 0.25
    weights = Constants(np.array([[2.0 + 0j]]), np.array([[0.5]]))
    # (2 +- 0.5)(1 +- 0.25) reaches 3.125, 1.125 from 2.
    assert combined(weights, model).rest[0] == pytest.approx(1.125, rel=1e-9)
