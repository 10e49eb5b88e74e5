"""When commands reach the 50-coordinate vehicle, and that its lanes do not know of each other."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from railenv.simulation.full import FullBatch
from railenv.simulation.full_run import FullSimulation
from railenv.track import Track, make_track
from railenv.track.table import FULL_CHANNELS, single_track
from railenv.units import FloatArray
from railenv.vehicle.nonlinear import FullVehicle, equilibrium, full50, rate_of_change

OUTPUTS = ("carbody_lateral_acceleration_1", "actuator_force_1", "carbody_lateral")
FORCE = 5e3
PERIOD = 0.01


@pytest.fixture(scope="module")
def vehicle() -> FullVehicle:
    return full50("paper_fit", 4, 300.0)


@pytest.fixture(scope="module")
def track(vehicle: FullVehicle) -> Track:
    return make_track("tb3352", 6.0 * vehicle.speed, 3)


def pushed(
    vehicle: FullVehicle, delay: float, time_step: float, periods: int
) -> tuple[FloatArray, FloatArray]:
    """State after some periods with a constant command from the first one on, and all outputs."""
    simulation = FullSimulation(
        vehicle,
        OUTPUTS,
        time_step=time_step,
        record_step=0.001,
    )
    simulation.reset(np.full((1, 4), delay))
    commands = np.full((1, 4), FORCE)
    found = [simulation.advance(commands)[0] for _ in range(periods)]
    return simulation.state[0], np.concatenate(found)


@pytest.mark.parametrize("delay", [0.0, 0.02, 0.02345, 0.0100001])
def test_a_force_arrives_after_its_delay_and_not_before(vehicle: FullVehicle, delay: float) -> None:
    _, outputs = pushed(vehicle, delay, 5e-4, 5)
    time = 0.001 * np.arange(1, len(outputs) + 1)
    there = outputs[:, 1] != 0.0
    # A record at the very instant still has the force from before.
    assert not there[time < delay - 1e-9].any()
    assert there[time > delay + 1e-9].all()
    still = np.abs(outputs[~there, 0])
    assert still.size == 0 or still.max() < 1e-8
    felt = outputs[there, 0]
    assert felt[0] > 0.5 * 4.0 * FORCE / vehicle.parameters.lateral.carbody_mass


def exact(vehicle: FullVehicle, delay: float, end: float) -> FloatArray:
    """The same by an adaptive method of order 8 that starts anew where the force arrives."""
    state = equilibrium(vehicle).state
    for begin, stop, force in ((0.0, delay, 0.0), (delay, end, FORCE)):
        command = np.full(4, force)
        found = solve_ivp(
            lambda _, x, command=command: rate_of_change(vehicle, x, command=command)[0],
            (begin, stop),
            state,
            method="DOP853",
            rtol=1e-9,
            atol=1e-12,
        )
        state = found.y[:, -1]
    return state


def test_a_force_that_arrives_inside_a_step_acts_from_its_instant_on(vehicle: FullVehicle) -> None:
    delay, end = 0.01234567, 0.03
    wanted = exact(vehicle, delay, end)
    turning = [i for i, name in enumerate(vehicle.states[:50]) if name.endswith("pitch")]
    kept = np.setdiff1d(np.arange(100), turning)
    errors: list[float] = []
    for time_step in (5e-4, 2.5e-4, 1.25e-4):
        state, _ = pushed(vehicle, delay, time_step, round(end / PERIOD))
        errors.append(float(np.abs(state - wanted)[kept].max()))
    # A command rounded to a whole step of 0.5 ms would be wrong by 5e3 N 4 / 40 t 0.15 ms = 7e-5
    # m/s; this falls with the fourth power of the step.
    assert errors[0] < 2e-6
    assert errors[0] / errors[1] > 10.0
    assert errors[1] / errors[2] > 10.0


def driven(
    vehicle: FullVehicle, track: Track, delays: FloatArray, level: FloatArray, periods: int = 60
) -> tuple[FloatArray, FloatArray]:
    """States and outputs of lanes under sky-hook control."""
    names = [f"carbody_lateral_velocity_{k}" for k in (1, 2, 3, 4)]
    simulation = FullSimulation(vehicle, names)
    simulation.reset(delays, [track], level=level)
    measured, kept = simulation.measure(), []
    for _ in range(periods):
        found = simulation.advance(-35e3 * measured)
        kept.append(found)
        measured = found[:, -1]
    return simulation.state, np.concatenate(kept, axis=1)


def test_a_lane_of_a_batch_is_bit_for_bit_the_batch_of_one(
    vehicle: FullVehicle, track: Track
) -> None:
    delays = np.array([[0.0] * 4, [0.0123] * 4, [0.05, 0.04, 0.0301, 0.02]])
    level = np.array([1.0, 0.5, 2.0])
    states, outputs = driven(vehicle, track, delays, level)
    assert len(np.unique(states[:, 0])) == 3
    for lane in range(3):
        one = slice(lane, lane + 1)
        state, alone = driven(vehicle, track, delays[one], level[one])
        np.testing.assert_array_equal(state[0], states[lane])
        np.testing.assert_array_equal(alone[0], outputs[lane])


def test_threads_that_share_the_lanes_change_no_bit(vehicle: FullVehicle, track: Track) -> None:
    lanes = 4

    def started() -> FullBatch:
        pool = (single_track(track, FULL_CHANNELS),)
        batch = FullBatch((vehicle,), lanes, pool, recorded=OUTPUTS, longest_delay=0.05)
        batch.places.amplitude[:] = [0.5, 1.0, 1.5, 2.0]
        numbers = np.arange(lanes, dtype=np.int64)
        batch.start(numbers, np.zeros_like(numbers), np.full((lanes, 4), 0.015))
        batch.commands[:] = FORCE * np.arange(1, lanes + 1)[:, None]
        return batch

    together, apart = started(), started()
    for _ in range(40):
        together.advance(0, lanes)

    def drive(first: int) -> None:
        for _ in range(40):
            apart.advance(first, first + 2)

    with ThreadPoolExecutor(2) as workers:
        list(workers.map(drive, (0, 2)))
    np.testing.assert_array_equal(together.lanes.state, apart.lanes.state)
    np.testing.assert_array_equal(together.recorded, apart.recorded)
    np.testing.assert_array_equal(together.lanes.wheels, apart.lanes.wheels)


def test_a_derailed_lane_says_so_stands_still_and_leaves_the_others_alone(
    vehicle: FullVehicle,
) -> None:
    simulation = FullSimulation(vehicle, OUTPUTS)
    rest = equilibrium(vehicle).state
    thrown = rest.copy()
    index = vehicle.states.index("wheelset1_lateral_velocity")
    thrown[index] = 8.0  # over the flange
    simulation.reset(np.zeros((2, 4)), initial_state=np.array([rest, thrown]))
    none = np.zeros((2, 4))
    for _ in range(20):
        outputs = simulation.advance(none)
    np.testing.assert_array_equal(simulation.derailed, [False, True])
    np.testing.assert_array_equal(simulation.ended, [False, True])
    before = simulation.state
    outputs = simulation.advance(none)
    np.testing.assert_array_equal(simulation.state[1], before[1])
    assert np.isfinite(simulation.state).all()
    assert np.isfinite(outputs).all()
    lateral = [i for i, name in enumerate(vehicle.states[:50]) if name.endswith("lateral")]
    assert np.abs(simulation.state[0, lateral]).max() < 1e-12


def test_a_lane_that_has_ended_takes_no_more_commands(vehicle: FullVehicle) -> None:
    # Its time stands still, so that nothing arrives. Commands of a longer and longer way would pile
    # up beyond the queue, in that of the next lane.
    simulation = FullSimulation(vehicle, OUTPUTS)
    simulation.reset(np.full((2, 4), 0.02), longest_jitter=0.02)
    simulation.stop(np.array([True, False]))
    alone = FullSimulation(vehicle, OUTPUTS)
    alone.reset(np.full((1, 4), 0.02), longest_jitter=0.02)
    commands = FORCE * np.sin(np.arange(30.0))
    for k, command in enumerate(commands):
        later = 0.02 * k / len(commands)
        # Three are lost, so that both lanes are not in the same slot by chance.
        lost = np.array([[k < 3] * 4, [False] * 4])
        both = simulation.advance(np.full((2, 4), command), np.full((2, 4), later), lost)
        one = alone.advance(np.full((1, 4), command), np.full((1, 4), later))
        np.testing.assert_array_equal(both[1], one[0])
    np.testing.assert_array_equal(simulation.state[1], alone.state[0])
