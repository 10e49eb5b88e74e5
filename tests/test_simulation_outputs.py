"""Recorded outputs against an independent integration of the vehicle, its forces and its track."""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from railenv.actuation import ActuatorSpec
from railenv.simulation import LateralSimulation
from railenv.units import STANDARD_GRAVITY
from railenv.vehicle import LateralVehicle, lateral17, state_space

PERIOD, STEP, PERIODS = 0.01, 0.005, 15
STEPS = round(PERIODS * PERIOD / STEP)
# Fractions of a step, whole steps and more than two periods, another order in each lane.
DELAYS = np.array([[0.0, 0.0137, 0.0052, 0.0225], [0.0178, 0.0031, 0.01, 0.0]])
# Lane 0 runs on the second track and lane 1 on the first.
TRACK_OF_LANE = np.array([1, 0])
WHEELSETS = DAMPERS = (1, 2, 3, 4)

ACCELERATIONS = (
    *(f"carbody_lateral_acceleration_{k}" for k in DAMPERS),
    "bogie1_lateral_acceleration",
    "bogie2_lateral_acceleration",
    "floor_front_lateral_acceleration",
    "floor_rear_lateral_acceleration",
    "carbody_lateral_acceleration",
    "carbody_yaw_acceleration",
    "carbody_roll_acceleration",
)
RAIL_OFFSETS = tuple(f"wheelset{k}_rail_offset" for k in WHEELSETS)
FORCES = tuple(f"actuator_force_{k}" for k in DAMPERS)
STROKES = tuple(f"suspension_stroke_{k}" for k in DAMPERS)
OUTPUTS = (*ACCELERATIONS, *RAIL_OFFSETS, *FORCES, *STROKES)

# The integrator keeps each of some hundred pieces to a relative 1e-10; errors mostly cancel.
INTEGRATED = 1e-9


@dataclass(frozen=True)
class Drive:
    """Seeded commands [N], track inputs of two tracks, and the starting states."""

    commands: np.ndarray
    tracks: np.ndarray
    start: np.ndarray


@pytest.fixture(scope="module")
def drive() -> Drive:
    rng = np.random.default_rng(8)
    start = np.zeros((2, 38))
    # the first 34 are coordinates and velocities: millimetres, millimetres per second
    start[:, :34] = 1e-3 * rng.normal(size=(2, 34))
    return Drive(
        1000.0 * rng.normal(size=(PERIODS, 2, 4)),
        1e-3 * rng.normal(size=(2, STEPS + 1, 8)),
        start,
    )


@pytest.fixture(scope="module", params=[0.0, 0.02], ids=["without lag", "with lag"])
def lag(request: pytest.FixtureRequest) -> float:
    """Time constant of the actuators [s]."""
    return request.param


@pytest.fixture(scope="module")
def simulated(vehicle: LateralVehicle, drive: Drive, lag: float) -> dict[str, np.ndarray]:
    """Every output by its name, shape (lanes, steps)."""
    actuator = ActuatorSpec(force_limit=None, lag=lag)
    simulation = LateralSimulation(
        vehicle, OUTPUTS, actuator=actuator, control_period=PERIOD, time_step=STEP
    )
    simulation.reset(DELAYS, drive.tracks, TRACK_OF_LANE, drive.start)
    values = np.concatenate([simulation.advance(c) for c in drive.commands], axis=1)
    return {name: values[:, :, k] for k, name in enumerate(OUTPUTS)}


@pytest.fixture(scope="module")
def integrated(vehicle: LateralVehicle, drive: Drive, lag: float) -> dict[str, np.ndarray]:
    """The same outputs by SciPy's integrator, piece by piece between kinks and switches."""
    lanes = [
        integrated_lane(vehicle, drive, lag, lane, drive.tracks[track])
        for lane, track in ((0, 1), (1, 0))
    ]
    return {name: np.array([y[:, k] for y in lanes]) for k, name in enumerate(OUTPUTS)}


def integrated_lane(
    vehicle: LateralVehicle, drive: Drive, lag: float, lane: int, track: np.ndarray
) -> np.ndarray:
    """Outputs of one lane at the end of each physics step, shape (steps, outputs)."""
    system = state_space(vehicle)
    C, D = system.output_rows(OUTPUTS)
    switches = [k * PERIOD + tau for k in range(PERIODS) for tau in DELAYS[lane]]
    kinks = STEP * np.arange(STEPS + 1)
    # instants closer than a picosecond are the same one
    knots = np.unique(np.round([*switches, *kinks], 12))
    knots = knots[knots <= round(kinks[-1], 12)]
    x, force, rows = drive.start[lane], np.zeros(4), []
    for begin, end in pairwise(knots):
        middle = (begin + end) / 2
        step = int(middle // STEP)
        rate = (track[step + 1] - track[step]) / STEP
        newest = np.floor((middle - DELAYS[lane]) / PERIOD).astype(int)
        command = np.where(newest >= 0, drive.commands[newest, lane, range(4)], 0.0)

        def inputs(
            t: float,
            force: np.ndarray,
            step: int = step,
            rate: np.ndarray = rate,
        ) -> np.ndarray:
            return np.concatenate([force, track[step] + (t - step * STEP) * rate, rate])

        def slope(
            t: float,
            state: np.ndarray,
            command: np.ndarray = command,
            inputs=inputs,
        ) -> np.ndarray:
            x, force = state[:38], state[38:] if lag else command
            moved = system.A @ x + system.B @ inputs(t, force)
            return np.concatenate([moved, (command - force) / lag]) if lag else moved

        state = np.concatenate([x, force]) if lag else x
        solved = solve_ivp(slope, (begin, end), state, "DOP853", rtol=1e-10, atol=1e-12)
        x, force = solved.y[:38, -1], solved.y[38:, -1] if lag else command
        if abs(end - (step + 1) * STEP) < 1e-11:
            rows.append(C @ x + D @ inputs(end, force))
    return np.array(rows)


@pytest.mark.parametrize("names", [ACCELERATIONS, RAIL_OFFSETS, FORCES, STROKES])
def test_an_output_is_that_of_an_independent_integration(
    simulated: dict[str, np.ndarray], integrated: dict[str, np.ndarray], names: tuple[str, ...]
) -> None:
    for name in names:
        size = np.abs(integrated[name]).max()
        np.testing.assert_allclose(
            simulated[name], integrated[name], rtol=0.0, atol=INTEGRATED * size, err_msg=name
        )


def test_the_two_lanes_of_this_comparison_differ_in_every_output(
    integrated: dict[str, np.ndarray],
) -> None:
    # far more than the comparison lets pass
    for name, values in integrated.items():
        assert np.abs(values[0] - values[1]).max() > 1e-4 * np.abs(values).max(), name


def test_the_first_reading_of_a_rail_offset_is_wheelset_minus_rail(
    vehicle: LateralVehicle, drive: Drive
) -> None:
    simulation = LateralSimulation(vehicle, RAIL_OFFSETS)
    simulation.reset(DELAYS, drive.tracks, TRACK_OF_LANE, drive.start)
    states = state_space(vehicle).states
    wheelsets = drive.start[:, [states.index(f"wheelset{k}_lateral") for k in WHEELSETS]]
    expected = wheelsets - drive.tracks[TRACK_OF_LANE, 0, :4]
    # one subtraction of millimetres
    np.testing.assert_allclose(simulation.measure(), expected, rtol=0.0, atol=1e-16)


@pytest.mark.parametrize(
    ("sensor", "body"),
    [
        *((f"carbody_lateral_acceleration_{k}", "carbody") for k in DAMPERS),
        ("bogie1_lateral_acceleration", "bogie1"),
        ("bogie2_lateral_acceleration", "bogie2"),
        ("floor_front_lateral_acceleration", "carbody"),
    ],
)
def test_a_real_accelerometer_reads_gravity_by_its_bodys_roll_too(
    vehicle: LateralVehicle, drive: Drive, sensor: str, body: str
) -> None:
    names = (sensor, f"{body}_roll")

    def read(specific_force: bool) -> np.ndarray:
        simulation = LateralSimulation(vehicle, names, specific_force=specific_force)
        simulation.reset(DELAYS, drive.tracks, TRACK_OF_LANE, drive.start)
        return np.concatenate([simulation.advance(c) for c in drive.commands], axis=1)

    kinematic, specific = read(False), read(True)
    expected = kinematic[:, :, 0] - STANDARD_GRAVITY * kinematic[:, :, 1]
    # sums of 38 terms, of which single ones are a hundred times the reading
    np.testing.assert_allclose(
        specific[:, :, 0], expected, rtol=0.0, atol=1e-11 * np.abs(kinematic).max()
    )


def test_a_rate_limit_goes_on_from_the_last_limited_force(vehicle: LateralVehicle) -> None:
    actuator = ActuatorSpec(rate_limit=10e3)
    simulation = LateralSimulation(vehicle, ("actuator_force_1",), actuator=actuator)
    simulation.reset(np.zeros((1, 4)))
    wanted = np.array([[3000.0, 0.0, 0.0, 0.0]])
    forces = [simulation.advance(wanted)[0, -1, 0] for _ in range(3)]
    # 10 kN/s over 10 ms; sums of whole numbers are exact
    assert forces == [100.0, 200.0, 300.0]


@pytest.mark.parametrize("specific_force", [False, True])
@pytest.mark.parametrize("layout", ["passive", 2, 4])
def test_no_output_reads_a_rate_of_the_track_which_the_simulation_would_leave_out(
    layout: object, specific_force: bool
) -> None:
    system = state_space(lateral17("paper_fit", layout, 300.0), specific_force=specific_force)
    rates = [k for k, name in enumerate(system.inputs) if name.endswith("_rate")]
    assert len(rates) == 8
    assert not np.any(system.D[:, rates])
