"""Controllers in the loop: what they see, what their actions weigh, and what the oracle is told."""

import numpy as np
import pytest

from baselines import LinearFeedback, SkyHook
from eval.rollout import ControlledBatch, Stepping
from railenv.actuation import ActuatorSpec
from railenv.envs.observation import sensor_names
from railenv.stability.sampled import lifted_matrix
from railenv.vehicle import LateralVehicle, state_space

SENSORS = sensor_names("4")
FORCES = tuple(f"actuator_force_{k}" for k in (1, 2, 3, 4))
PERIOD, PIPE = 0.01, 30


class Numbered:
    """Acts with a number that names decision, lane and channel, and keeps what it saw."""

    def reset(self, num_lanes: int, seed: int) -> None:
        self.seen: list[np.ndarray] = []

    def act(self, observations: np.ndarray) -> np.ndarray:
        self.seen.append(observations.copy())
        return numbers(len(self.seen), observations.shape[0])


class Weighed(Numbered):
    """The same, with a force of 700 N for an action of one."""

    action_scale = 700.0


def numbers(decision: int, lanes: int) -> np.ndarray:
    """Actions of a decision (counted from one), shape (lanes, 4), all different and small."""
    lane, channel = np.arange(lanes)[:, None], np.arange(1, 5)
    return 0.1 * decision + 0.01 * lane + 0.001 * channel


def batch_of(
    controller: object, vehicle: LateralVehicle, record: tuple[str, ...], lag: float = 0.0
) -> ControlledBatch:
    stepping = Stepping(PERIOD, 0.005, ActuatorSpec(force_limit=None, lag=lag))
    return ControlledBatch(controller, vehicle, record, stepping)  # type: ignore[arg-type]


def feedback(rng: np.random.Generator, action_scale: float = 3000.0) -> LinearFeedback:
    """Dense feedback of every sensor, each at most some 100 N in this file's small motion."""
    size = np.array([2e3] * 4 + [1e3] * 4 + [100.0] * 2 + [2e3] * 2 + [2e4] * 4)
    return LinearFeedback(size * rng.normal(size=(4, 16)), SENSORS, 4, action_scale)


def start(vehicle: LateralVehicle) -> np.ndarray:
    """Millimetres and millimetres per second, seeded."""
    n = len(state_space(vehicle).states)
    return 1e-3 * np.random.default_rng(5).normal(size=n)


def test_a_controller_sees_an_empty_pipe_at_first(vehicle: LateralVehicle) -> None:
    controller = Numbered()
    batch = batch_of(controller, vehicle, FORCES)
    batch.reset(np.zeros((2, 4)))
    batch.advance()
    np.testing.assert_array_equal(controller.seen[0][:, len(SENSORS) :], np.zeros((2, PIPE * 4)))


def test_a_controller_sees_its_own_past_actions_newest_first(vehicle: LateralVehicle) -> None:
    controller = Numbered()
    batch = batch_of(controller, vehicle, FORCES)
    batch.reset(np.zeros((2, 4)))
    for _ in range(5):
        batch.advance()
    past = [numbers(decision, 2) for decision in (4, 3, 2, 1)]
    np.testing.assert_array_equal(
        controller.seen[4][:, len(SENSORS) : len(SENSORS) + 16], np.concatenate(past, axis=1)
    )


def test_a_controller_sees_the_sensors_at_the_end_of_the_last_period(
    vehicle: LateralVehicle,
) -> None:
    controller = Numbered()
    batch = batch_of(controller, vehicle, SENSORS)
    batch.reset(np.zeros((2, 4)))
    recorded = batch.advance()
    batch.advance()
    np.testing.assert_array_equal(controller.seen[1][:, : len(SENSORS)], recorded[:, -1])


@pytest.mark.parametrize(("kind", "newtons"), [(Weighed, 700.0), (Numbered, 3000.0)])
def test_an_action_of_one_is_the_controllers_own_scale_or_three_kilonewtons(
    vehicle: LateralVehicle, kind: type[Numbered], newtons: float
) -> None:
    batch = batch_of(kind(), vehicle, FORCES)
    batch.reset(np.zeros((2, 4)))
    # without delay and lag the command is the force; one product, rounded
    np.testing.assert_allclose(batch.advance()[:, -1], newtons * numbers(1, 2), rtol=1e-15)


def test_a_gain_in_newtons_does_not_depend_on_the_scale_of_the_action(
    vehicle: LateralVehicle,
) -> None:
    def forces(action_scale: float) -> np.ndarray:
        batch = batch_of(SkyHook(35e3, 4, action_scale), vehicle, FORCES)
        batch.reset(np.full((1, 4), 0.05), initial_state=start(vehicle))
        return np.concatenate([batch.advance() for _ in range(50)], axis=1)

    usual, small = forces(3000.0), forces(450.0)
    # a quotient and a product by another number in every period: some roundings each
    np.testing.assert_allclose(small, usual, rtol=0.0, atol=1e-12 * np.abs(usual).max())


def test_the_oracle_is_told_the_feedback_of_what_the_sensors_read_through_a_lag(
    vehicle: LateralVehicle,
) -> None:
    rng = np.random.default_rng(2)
    controller = feedback(rng)
    loop = controller.to_delay_system(vehicle, ActuatorSpec(lag=0.03))
    plant = state_space(vehicle)
    state, force = start(vehicle), 100.0 * rng.normal(size=4)
    C, D = plant.output_rows(SENSORS)
    readings = C @ state + D[:, :4] @ force
    expected = controller.gain @ readings
    # sums of 42 terms, some of them a thousand times the result
    np.testing.assert_allclose(
        loop.K @ np.concatenate([state, force]), expected, atol=1e-11 * np.abs(expected).max()
    )


def test_an_action_is_the_oracles_feedback_in_units_of_the_scale(vehicle: LateralVehicle) -> None:
    controller = SkyHook(35e3, 4, 450.0)
    loop = controller.to_delay_system(vehicle)
    state = start(vehicle)
    C, _ = state_space(vehicle).output_rows(SENSORS)
    forces = 450.0 * controller.act((C @ state)[None])[0]
    # one row of a few terms
    np.testing.assert_allclose(forces, -loop.K @ state, rtol=1e-12)


@pytest.mark.parametrize("lag", [0.02, 0.1])
def test_the_simulated_loop_moves_as_the_oracles_sampled_map_says(
    vehicle: LateralVehicle, lag: float
) -> None:
    controller = feedback(np.random.default_rng(3), action_scale=800.0)
    delays = np.array([0.0, 0.0137, 0.02, 0.0351])
    batch = batch_of(controller, vehicle, state_space(vehicle).states, lag)
    begin = start(vehicle)
    batch.reset(delays[None], initial_state=begin)

    loop = controller.to_delay_system(vehicle, batch.stepping.actuator)
    period_map = lifted_matrix(loop, tuple(delays), PERIOD)
    # the map's state begins with the loop's own; no force and nothing in the pipe at first
    lifted = np.zeros(len(period_map))
    lifted[: len(begin)] = begin
    moved, expected = [], []
    for _ in range(60):
        moved.append(batch.advance()[0, -1])
        lifted = period_map @ lifted
        expected.append(lifted[: len(begin)])
    size = np.abs(expected).max(axis=0)
    # both are exact; 60 products of matrices with entries up to 1e5 leave a few thousand roundings
    np.testing.assert_allclose(np.array(moved) / size, np.array(expected) / size, atol=1e-9)
