"""The curved functions of the policies: entry by entry, whatever the number of lanes."""

import math
from typing import Any

import numpy as np
import pytest
from policy_examples import MAKERS, played, small_readings

from baselines.policies.elementwise import sigmoid, softmax, tanh

VALUES = 3.0 * np.random.default_rng(0).normal(size=(37, 23))


def test_tanh_is_that_of_each_entry_by_itself() -> None:
    alone = [[math.tanh(value) for value in row] for row in VALUES]
    # Bit for bit: an array library's own tanh differs in the last digit of a third of them.
    np.testing.assert_array_equal(tanh(VALUES), alone)


def test_sigmoid_is_one_over_one_plus_exp() -> None:
    alone = [[1.0 / (1.0 + math.exp(-value)) for value in row] for row in VALUES]
    # Two ways to compute it, each rounded a few times to numbers of size one.
    np.testing.assert_allclose(sigmoid(VALUES), alone, atol=4e-16)
    np.testing.assert_array_equal(sigmoid(np.array([[-1e3, 0.0, 1e3]])), [[0.0, 0.5, 1.0]])


def test_softmax_is_shares_of_exp() -> None:
    alone = [[math.exp(value) for value in row] for row in VALUES]
    shares = [np.array(row) / math.fsum(row) for row in alone]
    # 23 terms summed in turn, each rounded.
    np.testing.assert_allclose(softmax(VALUES), shares, rtol=1e-14)


def test_softmax_of_large_logits_does_not_overflow() -> None:
    np.testing.assert_array_equal(softmax(np.array([[1e6, 1e6, -1e6]])), [[0.5, 0.5, 0.0]])


@pytest.mark.parametrize("function", [tanh, sigmoid, softmax])
def test_a_lane_is_bitwise_the_same_among_any_number(function: Any) -> None:

    together = function(VALUES)
    for number in range(1, 9):
        np.testing.assert_array_equal(function(VALUES[:number]), together[:number])


@pytest.mark.parametrize("make", MAKERS)
def test_no_policy_takes_a_curved_function_from_an_array_library(
    make: type, monkeypatch: pytest.MonkeyPatch
) -> None:
    def refused(*_: object, **__: object) -> None:
        raise AssertionError("computed for many lanes at once")

    policy = make()
    for name in ("tanh", "exp", "log", "log1p", "expm1"):
        monkeypatch.setattr(np, name, refused)
    assert np.isfinite(played(policy, small_readings(policy, 3, 2, 1.0), np.zeros(2))).all()
