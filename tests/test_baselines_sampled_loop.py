"""`to_sampled_loop`: the loop that is proved is the one that `act` closes, step by step."""

from collections.abc import Callable

import numpy as np
import pytest

from baselines import LinearDynamic, LinearFeedback, SkyHook
from baselines.passive import Passive, Zero
from railenv.actuation import ActuatorSpec
from railenv.actuation.hold import held_input
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError
from railenv.stability import SampledLoop, certify
from railenv.vehicle import LateralVehicle, lateral17, state_space

SENSORS = sensor_names("4")
VELOCITIES = SENSORS[:4]
# These have direct feedthrough: the forces push the carbody that they are mounted on.
ACCELERATIONS = tuple(name for name in SENSORS if "acceleration" in name)[:4]
PERIOD = 0.01

Linear = LinearFeedback | LinearDynamic


def feedback(strength: float = 1.0) -> LinearFeedback:
    gain = strength * np.hstack([35e3 * np.eye(4), 900.0 * np.eye(4)])
    return LinearFeedback(gain, (*VELOCITIES, *ACCELERATIONS), 4)


def dynamic(strength: float = 1.0, sensors: tuple[str, ...] = VELOCITIES) -> LinearDynamic:
    """Low-passes and a part that is passed straight through."""
    eye = np.eye(4)
    law = (-50.0 * eye, 50.0 * eye, strength * 30e3 * eye, strength * 5e3 * eye)
    return LinearDynamic(law, sensors, 4, control_period=PERIOD)


def accelerating(strength: float = 1.0) -> LinearDynamic:
    return dynamic(0.1 * strength, ACCELERATIONS)


LAWS: dict[str, Callable[[float], Linear]] = {
    "feedback": feedback,
    "dynamic": dynamic,
    "dynamic with feedthrough": accelerating,
}


def simulated(
    controller: Linear, vehicle: LateralVehicle, delay: float, start: np.ndarray, steps: int
) -> np.ndarray:
    """Plant states at the samples, shape (steps, n): `act` beside an exactly discretised plant."""
    system = state_space(vehicle)
    A, B = system.A, system.actuator_input
    C, D = system.output_rows(SENSORS)
    whole, rest = int(delay // PERIOD), delay % PERIOD
    before, old_force = held_input(A, B, rest)
    after, new_force = held_input(A, B, PERIOD - rest)
    controller.reset(1, 0)
    controller.act(np.zeros((1, len(SENSORS))))  # what came before was nothing
    x, past = start, [np.zeros(B.shape[1]) for _ in range(whole + 1)]
    states = []
    for _ in range(steps):
        states.append(x)
        # The reading is taken before the force switches.
        reading = C @ x + D[:, : B.shape[1]] @ past[whole]
        command = controller.action_scale * controller.act(reading[None])[0]
        x = before @ x + old_force @ past[whole]
        past = [command, *past[:whole]]
        x = after @ x + new_force @ past[whole]
    return np.array(states)


@pytest.mark.parametrize("delay", [0.0, 0.0037, 0.01, 0.0237])
@pytest.mark.parametrize("name", LAWS)
def test_every_step_of_the_map_is_a_step_of_the_controller(
    vehicle: LateralVehicle, name: str, delay: float
) -> None:
    controller = LAWS[name](1.0)
    start = 1e-2 * np.random.default_rng(3).normal(size=state_space(vehicle).A.shape[0])
    expected = simulated(controller, vehicle, delay, start, 60)
    loop = controller.to_sampled_loop(vehicle, PERIOD)
    matrix, n = loop.lifted_matrix(delay), len(start)
    state = np.zeros(len(matrix))
    state[:n] = start / loop.state_scale
    found = []
    for _ in expected:
        found.append(loop.state_scale * state[:n])
        state = matrix @ state
    # 60 steps of products of a few dozen numbers each
    scale = np.abs(expected).max(axis=0)
    np.testing.assert_allclose(found / scale, expected / scale, rtol=0.0, atol=1e-10)


@pytest.mark.parametrize("name", LAWS)
def test_the_spectral_radius_is_the_growth_of_the_simulation(
    vehicle: LateralVehicle, name: str
) -> None:
    delay, controller = 0.0237, LAWS[name](12.0)
    start = 1e-3 * np.random.default_rng(3).normal(size=state_space(vehicle).A.shape[0])
    sizes = np.abs(
        np.linalg.eigvals(controller.to_sampled_loop(vehicle, PERIOD).lifted_matrix(delay))
    )
    states = simulated(controller, vehicle, delay, start, 1500)[-60:]
    states /= np.abs(states).max()
    # In the end one pair of eigenvalues is left: x_(k+2) = 2 Re(z) x_(k+1) - |z|^2 x_k.
    columns = np.column_stack([states[1:-1].ravel(), states[:-2].ravel()])
    fit, *_ = np.linalg.lstsq(columns, states[2:].ravel(), rcond=None)
    assert sizes.max() > 1.0
    assert np.sqrt(-fit[1]) == pytest.approx(sizes.max(), rel=1e-8)


@pytest.mark.parametrize("lag", [0.0, 0.02])
def test_static_feedback_without_feedthrough_is_that_of_the_delay_system(
    vehicle: LateralVehicle, lag: float
) -> None:
    controller, actuator = SkyHook(35e3, 4), ActuatorSpec(lag=lag)
    loop = controller.to_sampled_loop(vehicle, PERIOD, actuator)
    other = SampledLoop.from_delay_system(controller.to_delay_system(vehicle, actuator), PERIOD)
    assert loop.num_states == state_space(vehicle).A.shape[0] + (4 if lag else 0)
    for delay in (0.0, 0.0137, [0.1, 0.1, 0.15, 0.0]):
        assert loop.growth_rate(delay) == pytest.approx(other.growth_rate(delay), abs=1e-9)


def test_a_lag_takes_the_feedthrough_into_the_plant(vehicle: LateralVehicle) -> None:
    direct = dynamic(1.0, ACCELERATIONS).to_sampled_loop(vehicle, PERIOD)
    lagged = dynamic(1.0, ACCELERATIONS).to_sampled_loop(vehicle, PERIOD, ActuatorSpec(lag=0.01))
    assert np.any(direct.D)
    assert not np.any(lagged.D)


@pytest.mark.parametrize("controller", [Passive(), Zero(4)])
def test_what_does_nothing_leaves_the_vehicle_as_it_is(controller: LinearFeedback) -> None:
    vehicle = lateral17("paper_fit", controller.layout, 200.0)
    loop = controller.to_sampled_loop(vehicle, PERIOD)
    rightmost = np.linalg.eigvals(state_space(vehicle).A).real.max()
    # a nearly defective eigenvalue loses digits in either form
    assert loop.growth_rate(0.0) == pytest.approx(rightmost, abs=1e-6)


@pytest.mark.slow
def test_a_filter_is_proved_on_both_sides_of_its_critical_delay(vehicle: LateralVehicle) -> None:
    loop = dynamic(1.0).to_sampled_loop(vehicle, PERIOD)
    assert certify(loop, 0.0).verdict == "STABLE"
    assert certify(loop, 0.4).verdict == "UNSTABLE"


def test_another_period_or_layout_is_refused_by_name(vehicle: LateralVehicle) -> None:
    with pytest.raises(ArgumentError, match=r"period = 0\.02 s.*control_period = 0\.01 s"):
        dynamic().to_sampled_loop(vehicle, 0.02)
    for period in (0.0, -1.0, np.nan):
        for controller in (feedback(), dynamic()):
            with pytest.raises(ArgumentError, match="period"):
                controller.to_sampled_loop(vehicle, period)
    other = lateral17("paper_fit", 2, 300.0)
    for controller in (feedback(), dynamic()):
        with pytest.raises(ArgumentError, match="layout"):
            controller.to_sampled_loop(other, PERIOD)
