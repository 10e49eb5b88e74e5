"""The design model's period against the simulation, the ride filter and scipy's equations."""

import numpy as np
import pytest
from scipy import linalg
from scipy.signal import sosfilt

from baselines.design.model import (
    FLOOR_ACCELERATIONS,
    DesignModel,
    design_model,
    sensor_noise,
)
from baselines.design.riccati import (
    riccati_residual,
    solve_lyapunov,
    solve_riccati,
    solve_stein,
)
from baselines.design.track_filter import wheel_process
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError, RailenvError
from railenv.metrics.ride_filter import ride_filter
from railenv.simulation import LateralSimulation
from railenv.vehicle import lateral17, state_space

PERIOD, STEP = 0.01, 0.005
PERIODS = 16


class Run:
    """A random run of the simulation and of the model beside it."""

    def __init__(
        self, layout: int, delay: float, preview: bool = False, period: float = PERIOD
    ) -> None:
        car = lateral17("paper_fit", layout, 237.0)
        model: DesignModel = design_model(car, delay, preview=preview, period=period)
        process = wheel_process(car, "german_low", STEP, preview=preview)
        rng = np.random.Generator(np.random.PCG64(7))
        system = state_space(car)
        n, m, q = len(system.A), model.num_channels, model.num_track
        steps = round(period / STEP)
        noises = process.N.shape[1]
        e = rng.standard_normal((PERIODS, steps * noises))
        u = 3e3 * rng.standard_normal((PERIODS, m))
        s = 1e-3 * rng.standard_normal(q)
        X = np.zeros(len(model.A))
        X[:n] = 1e-2 * rng.standard_normal(n)
        X[n + model.filters : n + model.filters + q] = s
        met = [process.H @ s]
        for part in e.reshape(-1, noises):
            s = process.F @ s + process.N @ part
            met.append(process.H @ s)
        sensors = sensor_names(car.layout)
        forces = tuple(name for name in system.outputs if name.startswith("actuator_force"))
        seen = (*sensors, *forces, "alignment_3", "track_roll_4", "bogie1_yaw")
        simulation = LateralSimulation(
            car, (*FLOOR_ACCELERATIONS, *seen), control_period=period, time_step=STEP
        )
        simulation.reset(np.full((1, m), delay), np.array(met)[None], initial_state=X[:n])
        self.states, self.readings, floor = [], [], []
        self.expected_states, self.expected_readings, predicted = [], [], []
        rows = model.measurement(seen)
        for k in range(PERIODS):
            v = u[k - model.late] if k >= model.late else np.zeros(m)
            predicted.append(model.C @ X + model.D @ v + model.H @ e[k])
            X = model.A @ X + model.B @ v + model.G @ e[k]
            outputs = simulation.advance(u[k : k + 1])[0]
            floor.append(outputs[:, :2])
            self.states.append(simulation.state[0])
            self.readings.append(outputs[-1, 2:])
            self.expected_states.append(X[:n])
            self.expected_readings.append(rows @ X)
        weighted = sosfilt(ride_filter(1.0 / STEP), np.concatenate(floor), axis=0)
        self.z = np.array(predicted).ravel()
        self.weighted = weighted.ravel() / np.sqrt(2.0 * steps)
        self.scale = np.abs(self.weighted).max()


RUNS = [
    (4, 0.0, False, PERIOD),
    (4, 0.1, False, PERIOD),
    (4, 0.1037, False, PERIOD),
    (4, 0.1037, True, PERIOD),
    # The force switches at the very instant of a record.
    (4, 0.105, False, PERIOD),
    (2, 0.0, True, PERIOD),
    (2, 0.1, False, PERIOD),
    (2, 0.1037, False, PERIOD),
    (2, 0.0237, False, 0.02),
]


@pytest.fixture(scope="module", params=RUNS, ids=str)
def run(request: pytest.FixtureRequest) -> Run:
    return Run(*request.param)


# The simulation steps in modal coordinates, the model by matrix exponentials: both are exact and
# differ by rounding, 1e-16 times a condition number of some 1e3 over 16 periods.
EXACT = 1e-10


def test_a_period_of_the_model_is_one_of_the_simulation(run: Run) -> None:
    states = np.array(run.states)
    scale = np.abs(states).max(axis=0)
    assert np.abs((states - run.expected_states) / scale).max() < EXACT


def test_the_weighted_output_is_the_ride_filter_of_the_recorded_floor(run: Run) -> None:
    # the recorded runs start with the filter at rest, as the model's filter states do
    assert np.abs(run.z - run.weighted).max() < EXACT * run.scale


def test_sensors_see_the_force_that_acted_before_the_switch(run: Run) -> None:
    readings = np.array(run.readings)
    scale = np.abs(readings).max(axis=0)
    assert np.abs((readings - run.expected_readings) / scale).max() < EXACT


def test_the_mean_square_of_the_output_is_over_both_ends_and_all_steps() -> None:
    model = design_model(lateral17("paper_fit", 4, 300.0), 0.0, period=0.02)
    assert model.C.shape[0] == model.D.shape[0] == 2 * 4
    # the last block of the force is the command that has just arrived
    np.testing.assert_array_equal(model.B[-4:], np.eye(4))


def test_a_delay_is_whole_periods_and_a_rest() -> None:
    model = design_model(lateral17("paper_fit", 4, 300.0), 0.1037)
    assert model.late == 10
    assert model.rest == pytest.approx(0.0037, abs=1e-15)  # subtraction of decimal fractions


@pytest.mark.parametrize("delay", [0.03, 0.07, 0.29])
def test_a_whole_number_of_periods_is_not_lost_to_rounding(delay: float) -> None:
    model = design_model(lateral17("paper_fit", 4, 300.0), delay)
    assert model.late == round(delay / PERIOD)
    assert model.rest < 1e-15


def test_noise_is_in_units_of_the_controlled_response_and_of_a_millimetre_of_track() -> None:
    names = ("carbody_lateral_velocity_1", "bogie1_lateral_acceleration", "alignment_2")
    np.testing.assert_allclose(sensor_noise(names, 0.1), [0.002, 0.17, 1e-4], rtol=1e-12)


class TestRefused:
    def test_a_vehicle_without_actuators(self) -> None:
        with pytest.raises(ArgumentError, match="layout = 'passive'"):
            design_model(lateral17("paper_fit", "passive", 300.0), 0.1)

    @pytest.mark.parametrize(
        ("name", "settings"),
        [
            ("delay", {"delay": -0.01}),
            ("delay", {"delay": float("nan")}),
            ("delay", {"delay": 1e3}),
            ("period", {"delay": 0.0, "period": 0.0}),
            ("period", {"delay": 0.0, "period": 0.012}),
            ("period", {"delay": 0.0, "period": float("nan")}),
            ("time_step", {"delay": 0.0, "time_step": 0.0}),
        ],
    )
    def test_a_time_that_is_none_is_named(self, name: str, settings: dict[str, float]) -> None:
        with pytest.raises(ArgumentError, match=name):
            design_model(lateral17("paper_fit", 4, 300.0), **settings)  # type: ignore[arg-type]


def stable(rng: np.random.Generator, n: int, radius: float) -> np.ndarray:
    A = rng.standard_normal((n, n))
    return A * (radius / np.abs(np.linalg.eigvals(A)).max())


class TestEquations:
    def test_doubling_is_scipys_riccati(self) -> None:
        rng = np.random.Generator(np.random.PCG64(1))
        A, B = stable(rng, 12, 1.3), rng.standard_normal((12, 3))
        Q = np.diag([1.0] * 4 + [0.0] * 8)
        X = solve_riccati(A, B @ B.T, Q)
        expected = linalg.solve_discrete_are(A, B, Q, np.eye(3))
        # two algorithms on a well scaled problem
        np.testing.assert_allclose(X, expected, rtol=1e-9, atol=1e-9 * np.abs(X).max())
        assert riccati_residual(A, B @ B.T, Q, X) < 1e-12
        gain = np.linalg.solve(np.eye(3) + B.T @ X @ B, B.T @ X @ A)
        assert np.abs(np.linalg.eigvals(A - B @ gain)).max() < 1.0

    def test_doubling_is_scipys_lyapunov(self) -> None:
        rng = np.random.Generator(np.random.PCG64(2))
        A, W = stable(rng, 12, 0.999), np.diag(rng.random(12))
        expected = linalg.solve_discrete_lyapunov(A, W)
        # the sum is a thousand times W: three digits of sixteen, twice
        np.testing.assert_allclose(solve_lyapunov(A, W), expected, rtol=1e-9)

    def test_stein_has_two_different_sides(self) -> None:
        rng = np.random.Generator(np.random.PCG64(3))
        A, B, C = stable(rng, 5, 0.9), stable(rng, 8, 0.99), rng.standard_normal((5, 8))
        X = solve_stein(A, B, C)
        np.testing.assert_allclose(A @ X @ B + C, X, atol=1e-12 * np.abs(X).max())

    @pytest.mark.parametrize("radius", [1.0 + 1e-9, 1.5, 1e30])
    def test_what_grows_has_no_covariance(self, radius: float) -> None:
        with pytest.raises(RailenvError, match="not stable"):
            solve_lyapunov(np.diag([0.5, radius]), np.eye(2))

    def test_what_neither_grows_nor_decays_has_no_covariance(self) -> None:
        with pytest.raises(RailenvError, match="not stable"):
            solve_lyapunov(np.diag([0.5, -1.0]), np.eye(2))

    @pytest.mark.parametrize("radius", [1.001, 1.5, 1e30])
    def test_an_unstable_motion_out_of_reach_has_no_riccati_solution(self, radius: float) -> None:
        A, G = np.diag([0.5, radius]), np.diag([1.0, 0.0])
        with pytest.raises(RailenvError, match="neither stable nor within reach"):
            solve_riccati(A, G, np.eye(2))
