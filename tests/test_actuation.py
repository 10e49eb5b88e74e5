"""Delay values, the delay line, limits, and the exact holds."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from railenv.actuation import ActuatorSpec, DelayLine, DelaySpec, held_input, ramped_input
from railenv.errors import ArgumentError
from railenv.simulation.stepping import arriving

A = np.array([[0.0, 1.0], [-40.0, -0.6]])
B = np.array([[0.0], [2.0]])


@pytest.mark.parametrize("delay", [-0.1, np.nan, np.inf, (0.1, -0.1), ()])
def test_a_delay_that_is_negative_or_not_finite_is_refused(delay: object) -> None:
    with pytest.raises(ArgumentError, match="delay"):
        DelaySpec(delay)  # type: ignore[arg-type]


def test_one_delay_serves_every_channel() -> None:
    assert DelaySpec(0.1).per_channel(4).tolist() == [0.1] * 4


def test_a_wrong_number_of_delays_is_refused_with_both_numbers() -> None:
    with pytest.raises(ArgumentError, match="2 entries for 4 channels"):
        DelaySpec((0.1, 0.2)).per_channel(4)


@given(
    delay=st.floats(0.0, 1.0),
    time_step=st.sampled_from([0.001, 0.002, 0.0025, 0.005, 0.01]),
)
def test_whole_steps_and_remainder_add_up_to_the_delay(delay: float, time_step: float) -> None:
    line = DelayLine(1, 1, time_step, 2)
    line.reset(np.array([[delay]]))
    whole, rest = int(line.whole_steps[0, 0]), float(line.remainder[0, 0])
    assert 0.0 <= rest <= time_step
    # one rounding each in product and difference
    assert whole * time_step + rest == pytest.approx(delay, abs=1e-15)


@given(
    whole_steps=st.integers(0, 40),
    steps_per_command=st.integers(1, 5),
    periods=st.integers(1, 20),
)
def test_a_command_takes_force_its_whole_steps_after_its_issue(
    whole_steps: int, steps_per_command: int, periods: int
) -> None:
    line = DelayLine(1, 1, 0.005, steps_per_command)
    line.reset(np.array([[whole_steps * 0.005]]))
    whole = int(line.whole_steps[0, 0])
    for number in range(periods):
        line.issue(np.array([[float(number + 1)]]))
        for step in range(number * steps_per_command, (number + 1) * steps_per_command):
            before, after, switches = arriving(line.commands[0], whole, 0, step, steps_per_command)
            newest = (step - whole) // steps_per_command
            assert after == (newest + 1 if newest >= 0 else 0)
            assert switches == ((step - whole) % steps_per_command == 0)
            assert before == (max(newest, 0) if switches else after)


def test_the_force_limit_cuts_and_the_rate_limit_slows() -> None:
    actuator = ActuatorSpec(force_limit=30e3, rate_limit=1e5)
    wanted, previous = np.array([[50e3, -500.0]]), np.array([[29.5e3, 0.0]])
    np.testing.assert_array_equal(actuator.limited(wanted, previous, 0.01), [[30e3, -500.0]])
    np.testing.assert_array_equal(actuator.limited(wanted, 0 * previous, 0.01), [[1e3, -500.0]])


@pytest.mark.parametrize(
    "settings", [{"force_limit": 0.0}, {"rate_limit": -1.0}, {"lag": -0.01}, {"lag": np.nan}]
)
def test_an_impossible_actuator_is_refused_by_name(settings: dict[str, float]) -> None:
    with pytest.raises(ArgumentError, match=next(iter(settings))):
        ActuatorSpec(**settings)


def test_a_lagged_force_approaches_its_command_exponentially() -> None:
    plant, drive = ActuatorSpec(lag=0.05).with_lag(A, B)
    _, response = held_input(plant, drive, 0.02)
    # unit step after 20 ms: 1 - exp(-0.02 / 0.05)
    assert response[-1, 0] == pytest.approx(1.0 - np.exp(-0.4), rel=1e-13)


def test_a_held_input_moves_an_oscillator_as_quadrature_says() -> None:
    transition, effect = held_input(A, B, 0.3)
    solution = integrate.solve_ivp(
        lambda t, x: A @ x + B[:, 0], (0, 0.3), [0.7, -0.2], rtol=1e-12, atol=1e-14
    )
    # the quadrature's own tolerance
    np.testing.assert_allclose(
        transition @ [0.7, -0.2] + effect[:, 0], solution.y[:, -1], rtol=1e-9
    )


def test_a_held_input_needs_no_inverse_of_the_plant() -> None:
    _, effect = held_input(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), 2.0)
    np.testing.assert_allclose(effect[:, 0], [2.0, 2.0], rtol=1e-15)


def test_a_ramp_and_its_rate_move_an_oscillator_as_quadrature_says() -> None:
    E, rate = np.array([[0.3], [5.0]]), np.array([[0.0], [0.8]])
    start, end = ramped_input(A, E, rate, 0.2)
    w0, w1 = 1.5, -0.4

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        w = w0 + (w1 - w0) * t / 0.2
        return A @ x + E[:, 0] * w + rate[:, 0] * (w1 - w0) / 0.2

    solution = integrate.solve_ivp(slope, (0, 0.2), [0.0, 0.0], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(start[:, 0] * w0 + end[:, 0] * w1, solution.y[:, -1], rtol=1e-9)
