"""Labels of imitation, and the least squares that fit gains to them."""

import numpy as np
import pytest

from baselines.training.imitation_round import Round
from baselines.training.least_squares import ScheduledLeastSquares
from railenv.errors import ArgumentError
from railenv.units import FloatArray


def small_loop(late: int, periods: int) -> tuple[FloatArray, ...]:
    """Run x' = A x + B u_(k-d) + e under random commands; return A, B, K, states and commands."""
    generator = np.random.default_rng(3)
    A = np.array([[0.9, 0.2], [-0.1, 0.8]])
    B, gain = np.array([[0.1], [0.5]]), np.array([[0.7, -0.4]])
    x, commands = np.zeros((periods, 2)), generator.standard_normal((periods, 1))
    for k in range(periods - 1):
        acting = commands[k - late] if k >= late else np.zeros(1)
        x[k + 1] = A @ x[k] + B @ acting + 0.3 * generator.standard_normal(2)
    return A, B, gain, x, commands


@pytest.mark.slow
def test_regression_on_exact_data_finds_gain_times_conditional_expectation() -> None:
    late, periods = 3, 40_000
    A, B, gain, x, commands = small_loop(late, periods)
    # Features: the state now, then the commands of 1, 2 and 3 periods ago.
    pipe = [np.roll(commands, age, axis=0) for age in range(1, late + 1)]
    run = Round(
        np.hstack([x, *pipe])[None],
        (-x @ gain.T)[None],
        np.zeros((1, periods, 1)),
        np.array([late]),
        np.array([0.03]),
        np.array([True]),
        np.array([periods]),
        np.zeros(1),
    )
    used, label = run.samples(0, late)
    sums = ScheduledLeastSquares(1, 1, 2 + late)
    sums.add(run.features[0, used], np.ones(1), label)
    found = sums.solve(1e-12)[0]
    expected = [-gain @ np.linalg.matrix_power(A, late)]
    expected += [-gain @ np.linalg.matrix_power(A, i - 1) @ B for i in range(1, late + 1)]
    # Noise on the way scatters the estimate by about 0.5 / sqrt(40 000) = 0.0025; four times that.
    assert np.allclose(found, np.hstack(expected), atol=0.01)


def test_label_is_what_the_expert_wants_when_the_command_arrives() -> None:
    wanted = np.arange(10.0)[None, :, None]
    nothing = np.zeros((1, 10, 1))
    run = Round(
        nothing,
        wanted,
        nothing,
        np.array([3]),
        np.zeros(1),
        np.array([True]),
        np.array([8]),
        np.zeros(1),
    )
    used, label = run.samples(0, 2)
    # Periods 2 to 4 arrive at 5 to 7, the last before the lane ended.
    assert (used.start, used.stop) == (2, 5)
    assert label[:, 0].tolist() == [5.0, 6.0, 7.0]


def test_scheduled_sums_solve_the_least_squares_problem() -> None:
    generator = np.random.default_rng(0)
    knots, actions, size = 3, 2, 4
    sums = ScheduledLeastSquares(knots, actions, size)
    rows, right = [], []
    for hat in ([0.3, 0.7, 0.0], [0.0, 1.0, 0.0], [0.0, 0.6, 0.4], [0.8, 0.2, 0.0]):
        x = generator.standard_normal((20, size))
        wanted = generator.standard_normal((20, actions))
        sums.add(x, np.array(hat), wanted)
        rows.append(np.kron(np.array(hat), x))
        right.append(wanted)
    direct = np.linalg.lstsq(np.vstack(rows), np.vstack(right), rcond=None)[0]
    expected = direct.reshape(knots, size, actions).transpose(0, 2, 1)
    # The ridge of 1e-12 and the condition of 1e2 leave 1e-9.
    assert np.allclose(sums.solve(1e-12), expected, atol=1e-8)


def test_sums_without_samples_are_refused() -> None:
    with pytest.raises(ArgumentError, match="no samples"):
        ScheduledLeastSquares(1, 1, 1).solve(1e-6)
