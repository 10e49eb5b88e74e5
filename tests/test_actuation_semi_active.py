"""The semi-active damper as a value: its range, and the coefficient nearest to a wanted force."""

from typing import Any

import numpy as np
import pytest

from railenv.actuation import SemiActiveDamper, coefficient_names
from railenv.errors import ArgumentError

DAMPER = SemiActiveDamper(5e3, 30e3, 0.01)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"lowest": -1.0}, "lowest = -1 must not be negative"),
        ({"highest": 0.0, "lowest": 0.0}, "highest = 0 must be above zero"),
        ({"highest": np.inf}, "highest = inf must be finite"),
        ({"response_time": -0.01}, "response_time = -0.01 must not be negative"),
        ({"lowest": 40e3, "highest": 30e3}, "lowest = 40000 N s/m must not be above highest"),
        ({"highest": "stiff"}, "highest = 'stiff' is not a number"),
    ],
)
def test_a_damper_that_cannot_be_is_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        SemiActiveDamper(**settings)


def test_a_command_is_limited_to_the_range() -> None:
    limited = DAMPER.limited(np.array([-1e9, 4e3, 5e3, 7e3, 1e9]))
    assert limited.tolist() == [5e3, 5e3, 5e3, 7e3, 30e3]


def test_a_force_that_resists_the_stroke_is_met_exactly_within_the_range() -> None:
    rate = np.array([0.1, -0.2])
    coefficient = DAMPER.towards(np.array([-1000.0, 3000.0]), rate)
    # one rounding of the quotient, one of the product
    np.testing.assert_allclose(-coefficient * rate, [-1000.0, 3000.0], rtol=4e-16)


def test_no_coefficient_of_the_range_comes_nearer_to_a_wanted_force() -> None:
    generator = np.random.default_rng(1)
    force = generator.normal(0.0, 2e3, (200, 4))
    rate = generator.normal(0.0, 0.1, (200, 4))
    chosen = np.abs(force + DAMPER.towards(force, rate) * rate)
    assert np.all((DAMPER.towards(force, rate) >= 5e3) & (DAMPER.towards(force, rate) <= 30e3))
    for coefficient in np.linspace(5e3, 30e3, 101):
        # rounding of forces of some kN
        assert np.all(chosen <= np.abs(force + coefficient * rate) + 1e-9)


def test_a_damper_at_rest_is_soft_and_one_that_hardly_moves_overflows_nothing() -> None:
    rate = np.array([0.0, -0.0, 5e-324, 1e-300])
    assert DAMPER.towards(np.full(4, -1e300), rate).tolist() == [5e3, 5e3, 30e3, 30e3]


def test_coefficients_are_named_by_their_places() -> None:
    assert coefficient_names("2") == ("damping_coefficient_1", "damping_coefficient_4")
    assert coefficient_names("passive") == ()
