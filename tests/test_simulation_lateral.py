"""The batch simulation: exact steps, fractional delays, holds of the right order, lanes apart."""

import numpy as np
import pytest
from scipy import linalg

from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError
from railenv.simulation import LateralSimulation, wheelset_inputs
from railenv.track import Track, make_track
from railenv.vehicle import LateralVehicle, state_space

OUTPUTS = ("carbody_lateral", "carbody_yaw", "bogie1_lateral", "actuator_force_1")
FREE = ActuatorSpec(force_limit=None)


def driven(
    vehicle: LateralVehicle,
    delays: np.ndarray,
    time_step: float,
    control_period: float = 0.02,
    duration: float = 0.6,
    actuator: ActuatorSpec = FREE,
    track: np.ndarray | None = None,
) -> np.ndarray:
    """States after seeded commands, shape (lanes, states)."""
    simulation = LateralSimulation(
        vehicle, OUTPUTS, actuator=actuator, control_period=control_period, time_step=time_step
    )
    simulation.reset(delays, track)
    commands = 1000 * np.random.default_rng(3).normal(size=(100, 1, 4))
    for k in range(round(duration / control_period)):
        simulation.advance(np.repeat(commands[k], len(delays), axis=0))
    return simulation.state[:, : simulation.system.A.shape[0]].copy()


def test_fractional_delays_per_channel_agree_with_switching_times_solved_one_by_one(
    vehicle: LateralVehicle,
) -> None:
    delays = np.array([0.0, 0.0137, 0.05, 0.1003])
    system = state_space(vehicle)
    commands = 1000 * np.random.default_rng(3).normal(size=(100, 1, 4))[:, 0]
    # Independent way: list every instant at which some force changes, and go from one to the next.
    changes = sorted({(k * 0.02 + tau, k, i) for k in range(30) for i, tau in enumerate(delays)})
    x, force, now = np.zeros(system.A.shape[0]), np.zeros(4), 0.0
    n, m = system.actuator_input.shape
    for instant, k, channel in [*changes, (0.6, -1, -1)]:
        if instant > 0.6:
            continue
        block = np.zeros((n + m, n + m))
        block[:n, :n], block[:n, n:] = system.A, system.actuator_input
        transition = linalg.expm(block * (instant - now))
        x, now = transition[:n, :n] @ x + transition[:n, n:] @ force, instant
        if channel >= 0:
            force[channel] = commands[k, channel]
    # 120 exponentials against 60: rounding grows to some 1e-12 of the largest state
    np.testing.assert_allclose(
        driven(vehicle, delays[None], 0.01)[0], x, rtol=1e-9, atol=1e-11 * np.abs(x).max()
    )


@pytest.mark.parametrize("lag", [0.0, 0.013])
def test_halving_the_step_changes_nothing_for_held_inputs(
    vehicle: LateralVehicle, lag: float
) -> None:
    delays = np.array([[0.0, 0.0137, 0.05, 0.1003], [0.2, 0.2, 0.2, 0.2]])
    actuator = ActuatorSpec(force_limit=None, lag=lag)
    coarse = driven(vehicle, delays, 0.01, actuator=actuator)
    fine = driven(vehicle, delays, 0.005, actuator=actuator)
    # both are exact; products of matrices with entries up to 1e5 leave a few hundred roundings
    np.testing.assert_allclose(fine, coarse, rtol=1e-9, atol=1e-12 * np.abs(coarse).max())


def test_a_delay_on_a_step_boundary_is_the_limit_of_delays_beside_it(
    vehicle: LateralVehicle,
) -> None:
    at, below, above = (
        driven(vehicle, np.full((1, 4), tau), 0.005) for tau in (0.03, 0.03 - 1e-9, 0.03 + 1e-9)
    )
    # 1e-9 s of 1 kN on 2 t moves velocities by 1e-9 m/s
    np.testing.assert_allclose(below, at, atol=1e-7 * np.abs(at).max())
    np.testing.assert_allclose(above, at, atol=1e-7 * np.abs(at).max())


def test_the_track_hold_converges_with_the_square_of_the_step(vehicle: LateralVehicle) -> None:
    distance = np.arange(0.0, 120.0, 0.125)
    wave = 2e-3 * np.sin(2 * np.pi * distance / 12.0) * (1 - np.exp(-((distance / 30) ** 4)))
    track = Track("wave", 0.125, {"alignment": wave, "cross_level": 0.5 * wave})

    def end(time_step: float) -> np.ndarray:
        steps = round(0.6 / time_step)
        inputs = wheelset_inputs(vehicle, track, time_step, steps)[None]
        return driven(vehicle, np.zeros((1, 4)), time_step, 0.02, 0.6, FREE, inputs)[0]

    reference = end(0.02 / 64)
    errors = [np.linalg.norm(end(0.02 / parts) - reference) for parts in (4, 8, 16)]
    orders = np.log2(np.array(errors[:-1]) / errors[1:])
    # first-order hold: order two, to a tenth at these steps
    np.testing.assert_allclose(orders, 2.0, atol=0.1)


def test_a_lane_does_not_depend_on_its_neighbours(vehicle: LateralVehicle) -> None:
    delays = np.random.default_rng(0).uniform(0.0, 0.3, size=(5, 4))
    together = driven(vehicle, delays, 0.005)
    for lane in range(5):
        np.testing.assert_array_equal(
            driven(vehicle, delays[lane : lane + 1], 0.005)[0], together[lane]
        )


def test_the_rear_wheelsets_see_the_track_later_by_their_distance(vehicle: LateralVehicle) -> None:
    track = make_track("german_low", 400.0, 5)
    inputs = wheelset_inputs(vehicle, track, 0.003, 1000)
    # 2.5, 17.38 and 19.88 m behind the leading wheelset at 250/3 m/s: 0.03 s is ten steps
    np.testing.assert_allclose(inputs[10:, 1], inputs[:-10, 0], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(inputs[10:, 7], inputs[:-10, 6], rtol=1e-9, atol=1e-12)
    assert vehicle.wheelset_setback == pytest.approx([0.0, 2.5, 17.38, 19.88])


def test_cross_level_becomes_roll_over_the_contact_spacing(vehicle: LateralVehicle) -> None:
    track = Track("tilt", 0.125, {"cross_level": np.full(4000, 0.0149)})
    inputs = wheelset_inputs(vehicle, track, 0.01, 300)
    assert inputs[-1, 4:] == pytest.approx(0.0149 / (2 * 0.7465))


def test_a_constant_force_ends_in_the_static_deflection(vehicle: LateralVehicle) -> None:
    simulation = LateralSimulation(vehicle, OUTPUTS, control_period=0.05, time_step=0.05)
    simulation.reset(np.full((1, 4), 0.1))
    force = np.array([[100.0, 100.0, 100.0, 100.0]])
    for _ in range(60_000):
        simulation.advance(force)
    system = simulation.system
    static = -np.linalg.solve(system.A, system.actuator_input @ force[0])
    # slowest root -0.006 1/s for 3000 s leaves exp(-18)
    np.testing.assert_allclose(simulation.state[0], static, atol=1e-6 * np.abs(static).max())


def test_saturation_is_the_actuators_and_not_the_controllers(vehicle: LateralVehicle) -> None:
    simulation = LateralSimulation(vehicle, OUTPUTS)
    simulation.reset(np.zeros((1, 4)))
    recorded = simulation.advance(np.array([[50e3, 0.0, 0.0, 0.0]]))
    assert recorded[0, -1, 3] == 30e3


def test_time_is_counted_and_not_summed(vehicle: LateralVehicle) -> None:
    simulation = LateralSimulation(vehicle, OUTPUTS, control_period=0.01, time_step=0.005)
    simulation.reset(np.zeros((1, 4)))
    for _ in range(1000):
        simulation.advance(np.zeros((1, 4)))
    assert simulation.time == 10.0


@pytest.mark.parametrize(
    ("commands", "message"),
    [(np.zeros((1, 3)), "shape"), (np.full((1, 4), np.nan), "not finite")],
)
def test_bad_commands_are_refused(
    vehicle: LateralVehicle, commands: np.ndarray, message: str
) -> None:
    simulation = LateralSimulation(vehicle, OUTPUTS)
    simulation.reset(np.zeros((1, 4)))
    with pytest.raises(ArgumentError, match=message):
        simulation.advance(commands)


def test_a_track_that_ends_is_an_error_and_not_a_straight(vehicle: LateralVehicle) -> None:
    simulation = LateralSimulation(vehicle, OUTPUTS)
    simulation.reset(np.zeros((1, 4)), np.zeros((1, 4, 8)))
    simulation.advance(np.zeros((1, 4)))
    with pytest.raises(ArgumentError, match=r"ends after 0\.015 s"):
        simulation.advance(np.zeros((1, 4)))


def test_a_control_period_that_is_no_multiple_of_the_step_is_refused(
    vehicle: LateralVehicle,
) -> None:
    with pytest.raises(ArgumentError, match="whole multiple"):
        LateralSimulation(vehicle, OUTPUTS, control_period=0.01, time_step=0.003)
