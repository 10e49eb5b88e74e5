"""Vehicles in modal coordinates, side by side in one batch, against an integration by hand."""

from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import expm

from railenv.actuation import ActuatorSpec, held_input
from railenv.errors import ArgumentError
from railenv.simulation import PlantTable, VehicleBatch
from railenv.vehicle import LateralVehicle, lateral17, state_space

STEP, PER_COMMAND, PERIODS = 0.005, 2, 40
OUTPUTS = ("floor_front_lateral_acceleration", "carbody_yaw", "suspension_stroke_1")
SENSORS = ("carbody_lateral_velocity_1", "carbody_lateral_acceleration_3")
FREE = ActuatorSpec(force_limit=None)

FAST, SLOW = lateral17("paper_fit", 4, 300.0), lateral17("paper_fit", 4, 160.0)
LOADED = LateralVehicle(
    FAST.parameters.replace(carbody_mass=1.2 * FAST.parameters.carbody_mass, conicity=0.1),
    "4",
    FAST.speed,
)
# Without conicity nothing holds the wheelsets in the track: two roots at zero with one mode.
DRIFTING = LateralVehicle(FAST.parameters.replace(conicity=0.0), "4", FAST.speed)


class Run:
    """Seeded commands, delays, jitter, losses and track of some lanes."""

    def __init__(self, lanes: int, jitter: float = 0.0, dropout: float = 0.0) -> None:
        rng = np.random.default_rng(5)
        self.delays = rng.uniform(0.0, 0.08, (lanes, 4))
        self.delays[0] = [0.0, 0.03, 0.0125, 0.005]
        self.commands = 1000.0 * rng.normal(size=(PERIODS, lanes, 4))
        self.later = jitter * rng.random((PERIODS, lanes, 4))
        self.lost = rng.random((PERIODS, lanes, 4)) < dropout
        self.track = 1e-3 * rng.normal(size=(lanes, PERIODS * PER_COMMAND + 1, 8))

    def batch(
        self,
        vehicles: list[LateralVehicle],
        actuator: ActuatorSpec = FREE,
        state: np.ndarray | None = None,
    ) -> tuple[VehicleBatch, np.ndarray, np.ndarray]:
        """The batch after the run, its outputs and its sampled columns."""
        lanes = len(self.delays)
        table = PlantTable(vehicles, OUTPUTS, SENSORS, actuator, STEP)
        longest = float((self.delays + self.later.max()).max())
        batch = VehicleBatch(table, lanes, PER_COMMAND, longest, actuator)
        everyone = np.arange(lanes)
        batch.track[:, -1] = self.track[:, 0]
        batch.start(everyone, everyone % len(vehicles), self.delays, state)
        outputs, sampled = [], [batch.sampled.copy()]
        for k in range(PERIODS):
            batch.track[:] = self.track[:, PER_COMMAND * k : PER_COMMAND * (k + 1) + 1]
            batch.commands[:], batch.later[:] = self.commands[k], self.later[k]
            batch.lost[:] = self.lost[k]
            batch.advance(0, lanes)
            outputs.append(batch.recorded.copy())
            sampled.append(batch.sampled.copy())
        return batch, np.concatenate(outputs, axis=1), np.stack(sampled, axis=1)

    def forces(self, lane: int, now: float) -> np.ndarray:
        """The newest command of each channel that has arrived at an instant."""
        period = STEP * PER_COMMAND
        arrives = period * np.arange(PERIODS)[:, None] + self.delays[lane] + self.later[:, lane]
        arrives[self.lost[:, lane]] = np.inf
        force = np.zeros(4)
        for channel in range(4):
            arrived = np.nonzero(arrives[:, channel] <= now)[0]
            if len(arrived):
                force[channel] = self.commands[arrived[-1], lane, channel]
        return force

    def by_hand(
        self,
        vehicle: LateralVehicle,
        lane: int,
        lag: float = 0.0,
        start: np.ndarray | None = None,
    ) -> tuple[np.ndarray, np.ndarray]:
        """States and outputs at the end of every step: one exponential from event to event.

        The track is a state of its own that moves at a constant rate, the force one that stands.
        """
        system = state_space(vehicle)
        A, B = ActuatorSpec(lag=lag).with_lag(system.A, system.actuator_input)
        n = len(A)
        by_track = np.zeros((n, 16))
        by_track[: len(system.A)] = system.B[:, 4:]
        whole = np.zeros((n + 20, n + 20))
        whole[:n, :n], whole[:n, n : n + 16] = A, by_track
        whole[n : n + 8, n + 8 : n + 16] = np.eye(8)
        whole[:n, n + 16 :] = B
        C, D = system.output_rows(OUTPUTS)
        period = STEP * PER_COMMAND
        arrivals = (
            period * np.arange(PERIODS)[:, None] + self.delays[lane] + self.later[:, lane]
        ).ravel()
        x = np.zeros(n) if start is None else start
        states, outputs = [], []
        for k in range(PERIODS * PER_COMMAND):
            left, right = k * STEP, (k + 1) * STEP
            rate = (self.track[lane, k + 1] - self.track[lane, k]) / STEP
            inside = arrivals[(arrivals > left + 1e-12) & (arrivals < right - 1e-12)]
            force = np.zeros(4)
            for begin, end in pairwise(np.unique([left, *inside, right])):
                force = self.forces(lane, 0.5 * (begin + end))
                track = self.track[lane, k] + rate * (begin - left)
                y = np.concatenate([x, track, rate, force])
                x = (expm(whole * (end - begin)) @ y)[:n]
            states.append(x)
            felt = x[-4:] if lag else force
            inputs = np.concatenate([felt, self.track[lane, k + 1], np.zeros(8)])
            outputs.append(C @ x[: len(system.A)] + D @ inputs)
        return np.array(states), np.array(outputs)


# Some hundred steps of a rounding each, of matrices whose modes are conditioned to about 1e3.
CLOSE = 1e-10


def assert_close(found: np.ndarray, expected: np.ndarray, share: float = CLOSE) -> None:
    """Compare column by column, each against its own largest value."""
    scale = np.abs(expected).max(axis=0)
    assert np.all(np.abs(found - expected) <= share * scale)


@pytest.mark.parametrize(("jitter", "dropout"), [(0.0, 0.0), (0.03, 0.2)])
def test_vehicles_of_one_table_move_as_each_does_by_hand(jitter: float, dropout: float) -> None:
    run = Run(3, jitter, dropout)
    vehicles = [FAST, SLOW, LOADED]
    batch, outputs, _ = run.batch(vehicles)
    for lane, vehicle in enumerate(vehicles):
        states, expected = run.by_hand(vehicle, lane)
        assert_close(batch.states()[lane], states[-1], CLOSE * 100)
        assert_close(outputs[lane], expected)


@pytest.mark.parametrize("lag", [0.02, 0.001])
def test_lagged_actuators_move_as_by_hand(lag: float) -> None:
    run = Run(2, 0.02)
    batch, outputs, _ = run.batch([FAST, SLOW], ActuatorSpec(force_limit=None, lag=lag))
    for lane, vehicle in enumerate([FAST, SLOW]):
        states, expected = run.by_hand(vehicle, lane, lag)
        np.testing.assert_allclose(batch.states()[lane, -4:], states[-1, -4:], rtol=1e-9)
        assert_close(outputs[lane], expected)


def test_a_start_state_goes_on_as_by_hand() -> None:
    run = Run(2)
    start = 1e-3 * np.random.default_rng(1).normal(size=(2, 38))
    _, outputs, sampled = run.batch([FAST, SLOW], state=start)
    for lane, vehicle in enumerate([FAST, SLOW]):
        _, expected = run.by_hand(vehicle, lane, start=start[lane])
        assert_close(outputs[lane], expected)
        # what is sampled at the start is the state that was given, before any force
        C, D = state_space(vehicle).output_rows(SENSORS)
        at_start = C @ start[lane] + D[:, 4:12] @ run.track[lane, 0]
        np.testing.assert_allclose(sampled[lane, 0], at_start, rtol=1e-9)


def test_a_plant_whose_modes_do_not_span_the_state_keeps_its_full_matrix() -> None:
    assert len(PlantTable([DRIFTING], OUTPUTS, SENSORS, FREE, STEP).arrays.full) == 1
    assert len(PlantTable([FAST], OUTPUTS, SENSORS, FREE, STEP).arrays.full) == 0


def test_such_a_plant_moves_as_by_hand() -> None:
    run = Run(2, 0.02, 0.1)
    batch, outputs, _ = run.batch([DRIFTING, DRIFTING])
    for lane in range(2):
        states, expected = run.by_hand(DRIFTING, lane)
        assert_close(batch.states()[lane], states[-1], CLOSE * 100)
        assert_close(outputs[lane], expected)


def test_a_vehicle_is_the_same_with_modes_and_without() -> None:
    run = Run(2, 0.02)
    with_modes = run.batch([FAST, SLOW])[1]
    without = run.batch([FAST, DRIFTING])[1]
    assert_close(without[0], with_modes[0])


def test_a_nearly_drifting_vehicle_moves_nearly_as_a_drifting_one() -> None:
    nearly = LateralVehicle(FAST.parameters.replace(conicity=1e-4), "4", FAST.speed)
    assert len(PlantTable([nearly], OUTPUTS, SENSORS, FREE, STEP).arrays.full) == 0
    run = Run(1)
    near, drifting = run.batch([nearly])[1], run.batch([DRIFTING])[1]
    # the effect of conicity on 0.4 s is proportional to it, and of the order of one at 0.1
    assert_close(near[0], drifting[0], 0.01)
    assert not np.array_equal(near, drifting)


@pytest.mark.parametrize("lag", [0.0, 0.02, 0.001, 0.0002])
def test_the_series_of_a_late_command_is_its_matrix_exponential(lag: float) -> None:
    table = PlantTable([FAST, LOADED], OUTPUTS, SENSORS, ActuatorSpec(lag=lag), STEP)
    assert table.smooth
    rng = np.random.default_rng(0)
    for vehicle in (0, 1):
        scale = np.abs(table.late_effect(vehicle, 0.0)).max()
        for rest in [0.0, STEP, *rng.uniform(0.0, STEP, 20)]:
            place = 2.0 * (STEP - rest) / STEP - 1.0
            series = np.polynomial.chebyshev.chebval(place, table.arrays.late[vehicle])
            error = np.abs(series - table.late_effect(vehicle, rest)).max()
            # terms end where they fall below 1e-15 of the largest; a hundred of them add up
            assert error <= 1e-12 * scale


def test_the_effect_of_a_late_command_is_kept_for_its_instant() -> None:
    table = PlantTable([FAST], OUTPUTS, SENSORS, FREE, STEP)
    batch = VehicleBatch(table, 1, 1, 0.1, FREE)
    only = np.array([0])
    batch.start(only, only, np.array([[0.0, 0.0012, 0.0049, 0.0025]]))
    batch.commands[:] = 1000.0
    batch.advance(0, 1)
    for channel, rest in enumerate([0.0, 0.0012, 0.0049, 0.0025]):
        expected = table.late_effect(0, rest)[channel]
        found = batch.lanes.late[0, channel]
        # as above
        np.testing.assert_allclose(found, expected, atol=1e-12 * np.abs(expected).max())


def test_what_is_kept_of_one_vehicle_does_not_serve_the_next_one_in_its_lane() -> None:
    table = PlantTable([FAST, LOADED], OUTPUTS, SENSORS, FREE, STEP)
    only, delays = np.array([0]), np.full((1, 4), 0.0012)
    used, fresh = (VehicleBatch(table, 1, 1, 0.1, FREE) for _ in "ab")
    for batch, vehicles in ((used, (0, 1)), (fresh, (1,))):
        for vehicle in vehicles:
            batch.start(only, np.array([vehicle]), delays)
            batch.commands[:] = 1000.0
            batch.advance(0, 1)
    np.testing.assert_array_equal(used.recorded, fresh.recorded)


def test_the_effect_of_a_late_command_is_that_of_a_shorter_hold() -> None:
    table = PlantTable([FAST], OUTPUTS, SENSORS, FREE, STEP)
    system = state_space(FAST)
    _, effect = held_input(system.A, system.actuator_input, 0.0031)
    no_track = np.zeros(8)
    by_modes = [table.from_modes(0, row, no_track) for row in table.late_effect(0, STEP - 0.0031)]
    # into the modes and back
    np.testing.assert_allclose(np.array(by_modes).T, effect, atol=1e-12 * np.abs(effect).max())


@pytest.mark.parametrize("vehicle", [FAST, DRIFTING])
def test_modes_and_states_are_one_to_one(vehicle: LateralVehicle) -> None:
    table = PlantTable([vehicle], OUTPUTS, SENSORS, FREE, STEP)
    state = np.random.default_rng(0).normal(size=38)
    back = table.from_modes(0, table.to_modes(0, state), np.zeros(8))
    # the modes' condition is below a million
    np.testing.assert_allclose(back, state, atol=1e-10)


def test_an_actuator_far_faster_than_the_step_moves_as_by_hand() -> None:
    actuator = ActuatorSpec(force_limit=None, lag=1e-5)
    run = Run(2)
    run.delays[1, 0] = 0.295
    assert not PlantTable([FAST], OUTPUTS, SENSORS, actuator, STEP).smooth
    _, outputs, _ = run.batch([FAST, SLOW], actuator)
    for lane, vehicle in enumerate([FAST, SLOW]):
        assert_close(outputs[lane], run.by_hand(vehicle, lane, 1e-5)[1])


def test_jitter_of_such_an_actuator_is_refused() -> None:
    actuator = ActuatorSpec(lag=1e-5)
    table = PlantTable([FAST], OUTPUTS, SENSORS, actuator, STEP)
    with pytest.raises(ArgumentError, match="jitter"):
        VehicleBatch(table, 1, 1, 0.1, actuator).refuse_jitter_if_stiff(0.01)


def test_inactive_lanes_stand_still() -> None:
    run = Run(3)
    table = PlantTable([FAST], OUTPUTS, SENSORS, FREE, STEP)
    batch = VehicleBatch(table, 3, PER_COMMAND, 0.1, FREE)
    everyone = np.arange(3)
    batch.start(everyone, everyone * 0, run.delays)
    batch.commands[:] = 1000.0
    batch.active[1] = False
    for _ in range(10):
        batch.advance(0, 3)
    assert batch.step.tolist() == [20, 0, 20]
    assert not np.any(batch.states()[1])
    assert np.all(np.any(batch.states()[[0, 2]] != 0.0, axis=1))


def test_a_table_without_vehicles_or_with_two_layouts_is_refused() -> None:
    with pytest.raises(ArgumentError, match="vehicles is empty"):
        PlantTable([], OUTPUTS, SENSORS, FREE, STEP)
    two = lateral17("paper_fit", 2, 300.0)
    with pytest.raises(ArgumentError, match="layouts"):
        PlantTable([FAST, two], OUTPUTS, SENSORS, FREE, STEP)
