"""The delay system's value: shapes, sources, scaling, and what it refuses."""

import numpy as np
import pytest
from scipy import signal

from railenv.errors import ArgumentError, NeutralLoopError
from railenv.stability import (
    DelaySystem,
    count_unstable,
    critical_delays,
    pade_critical_delays,
    pade_roots,
    rightmost_roots,
    sampled_growth_rate,
    sampled_roots,
)

A = np.array([[0.0, 1.0], [-4.0, -0.2]])
B = np.array([[0.0], [1.0]])
K = np.array([[0.0, 1.0]])


@pytest.mark.parametrize(
    ("matrices", "message"),
    [
        ((np.zeros((2, 3)), B, K), "A has shape"),
        ((A, np.zeros((3, 1)), K), "B has shape"),
        ((A, B, np.zeros((2, 2))), "K has shape"),
        ((A * np.nan, B, K), "A holds a value that is not finite"),
        ((A, B, [["x", 1.0]]), "K is not a matrix"),
        ((A, B, [0.0, 1.0]), "K has 1 dimensions"),
        ((A, B, K, np.zeros((2, 2))), "feedthrough has shape"),
        ((A, B, K, [[np.inf]]), "feedthrough holds a value that is not finite"),
        ((np.zeros((0, 0)), np.zeros((0, 1)), np.zeros((1, 0))), "A has shape"),
    ],
)
def test_a_bad_matrix_is_refused_by_name(matrices: tuple, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        DelaySystem(*matrices)


def test_the_matrices_cannot_be_changed_behind_its_back() -> None:
    system = DelaySystem(A, B, K)
    with pytest.raises(ValueError, match="read-only"):
        system.A[0, 0] = 1.0


def test_a_scipy_system_with_output_feedback_gives_the_same_loop() -> None:
    plant = signal.StateSpace(A, B, np.array([[0.0, 2.0]]), np.zeros((1, 1)))
    np.testing.assert_array_equal(DelaySystem.from_statespace(plant, [[0.5]]).K, K)


def test_feedthrough_in_the_loop_makes_it_neutral() -> None:
    plant = signal.StateSpace(A, B, A[1:], np.array([[1.0]]))
    system = DelaySystem.from_statespace(plant, [[0.5]])
    assert system.neutral
    np.testing.assert_array_equal(system.feedthrough, [[0.5]])


def test_a_loop_is_retarded_unless_something_is_fed_through() -> None:
    assert not DelaySystem(A, B, K).neutral
    assert not DelaySystem(A, B, K, np.zeros((1, 1))).neutral
    np.testing.assert_array_equal(DelaySystem(A, B, K).feedthrough, [[0.0]])


NEUTRAL = DelaySystem(A, B, K, np.array([[0.5]]), ("accelerometer",))


@pytest.mark.parametrize(
    "question",
    [
        lambda: rightmost_roots(NEUTRAL, 0.1),
        lambda: count_unstable(NEUTRAL, 0.1),
        lambda: critical_delays(NEUTRAL),
        lambda: pade_roots(NEUTRAL, 0.1, 3),
        lambda: pade_critical_delays(NEUTRAL, 3),
        lambda: sampled_growth_rate(NEUTRAL, 0.1, 0.01),
        lambda: sampled_roots(NEUTRAL, 0.1, 0.01),
        lambda: NEUTRAL.characteristic_matrix(1j, np.array([0.1])),
        lambda: NEUTRAL.characteristic_derivative(1j, np.array([0.1])),
        lambda: NEUTRAL.scaled.require_retarded("anything"),
    ],
)
def test_no_question_for_retarded_loops_answers_a_neutral_one(question) -> None:
    with pytest.raises(NeutralLoopError, match=r"neutral.*accelerometer into channel 1.*low-pass"):
        question()


def test_a_neutral_loop_without_delay_solves_for_its_force() -> None:
    # f = -(K x + f / 2), so that two thirds of the gain are left
    np.testing.assert_allclose(NEUTRAL.undelayed, A - B @ K / 1.5, rtol=1e-15)
    singular = DelaySystem(A, B, K, np.array([[-1.0]]))
    with pytest.raises(ArgumentError, match="singular"):
        _ = singular.undelayed


def test_a_discrete_time_plant_is_refused_with_its_period() -> None:
    plant = signal.StateSpace(A, B, K, np.zeros((1, 1)), dt=0.01)
    with pytest.raises(ArgumentError, match=r"dt = 0\.01"):
        DelaySystem.from_statespace(plant, [[0.5]])


@pytest.mark.parametrize("delay", [-0.1, np.nan, [0.1, 0.2]])
def test_a_bad_delay_is_refused(delay: object) -> None:
    with pytest.raises(ArgumentError, match="delay"):
        rightmost_roots(DelaySystem(A, B, K), delay)  # type: ignore[arg-type]


def test_units_of_the_states_do_not_change_the_answers() -> None:
    scale = np.array([1e-6, 1e5])
    scaled = DelaySystem(A * scale[:, None] / scale, B * scale[:, None], K / scale)
    plain = critical_delays(DelaySystem(A, B, K)).critical_delay
    assert critical_delays(scaled).critical_delay == pytest.approx(plain, rel=1e-11)


def test_unit_of_time_scales_roots_and_delays() -> None:
    system, slow = DelaySystem(A, B, K), DelaySystem(A / 7, B / 7, K)
    roots = [m.root for m in rightmost_roots(system, 0.3, 4)]
    assert [7 * m.root for m in rightmost_roots(slow, 2.1, 4)] == pytest.approx(roots, rel=1e-11)
