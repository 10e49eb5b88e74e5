"""Predictors: the spectrum that the theory promises, the poles that stay, and a wrong delay."""

import numpy as np
import pytest
from scipy import linalg

from baselines import SkyHook
from baselines.design.model import DesignModel, design_model
from baselines.design.optimum import estimator
from baselines.predictor import LIVELY_NOISE, PredictorSkyHook
from baselines.smith import SmithSkyHook
from railenv.actuation import held_input
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, lateral17, state_space
from railenv.vehicle.coordinates import actuator_positions

PERIOD, GAIN = 0.01, 35e3
DELAYS = [0.0, 0.03, 0.1, 0.123]
# Away from the zeros, whose multiplicity would blow rounding up to 0.03, and from the stable poles.
PLACES = [1.3 * np.exp(0.3j), 1.1 * np.exp(1.7j), -1.2, 1.05 * np.exp(0.02j)]


def characteristic(matrix: FloatArray, z: complex) -> complex:
    """Log of det(z I - matrix), up to whole turns."""
    sign, size = np.linalg.slogdet(z * np.eye(len(matrix)) - matrix)
    return complex(size, np.angle(sign))


def assert_same(lifted: FloatArray, factors: list[tuple[int, FloatArray]]) -> None:
    """The eigenvalues of a lifted loop are those of the factors, each so many times, and zeros."""
    # How many zeros there are says how many signals are remembered, nothing of the loop.
    left = len(lifted) - sum(power * len(matrix) for power, matrix in factors)
    for z in PLACES:
        expected = sum(power * characteristic(matrix, z) for power, matrix in factors)
        off = characteristic(lifted, z) - expected - left * np.log(complex(z))
        # a determinant of 400 rows: rounding of 1e-16 times their number and condition
        assert abs(np.exp(off) - 1.0) < 1e-6


def undelayed(vehicle: LateralVehicle, gain: float) -> FloatArray:
    """One period of the vehicle under sampled sky-hook without delay."""
    system = state_space(vehicle)
    names = tuple(f"carbody_lateral_velocity_{k}" for k in actuator_positions(vehicle.layout))
    transition, full = held_input(system.A, system.actuator_input, PERIOD)
    return transition - gain * full @ system.output_rows(names)[0]


def uncontrolled(vehicle: LateralVehicle) -> FloatArray:
    return np.asarray(linalg.expm(PERIOD * state_space(vehicle).A))


def estimation(model: DesignModel, noise: float) -> FloatArray:
    """One period of the estimation error."""
    known = estimator(model, sensor_names(model.vehicle.layout), noise)
    return model.A @ (np.eye(len(model.A)) - known.gain @ known.M)


def parts(model: DesignModel) -> list[FloatArray]:
    """What the design model holds besides the vehicle: ride filters and track process."""
    n, q = len(model.A), model.num_track
    track = slice(n - model.num_channels - q, n - model.num_channels)
    first = track.start - model.filters
    return [model.A[first : track.start, first : track.start], model.A[track, track]]


class TestPredictor:
    @pytest.mark.parametrize("delay", DELAYS)
    @pytest.mark.parametrize("layout", [2, 4])
    def test_the_spectrum_is_that_without_delay_and_that_of_the_estimator(
        self, delay: float, layout: int
    ) -> None:
        car = lateral17("paper_fit", layout, 300.0)
        law = PredictorSkyHook(car, delay, GAIN)
        model = design_model(car, delay)
        names = tuple(f"carbody_lateral_velocity_{k}" for k in actuator_positions(car.layout))
        K = GAIN * model.measurement(names)
        # The real vehicle has no ride filter and meets a flat track: their poles are not there.
        assert_same(
            law.to_sampled_loop(car, PERIOD).lifted_matrix(delay),
            [
                (1, model.A - model.B @ K),
                (1, estimation(model, LIVELY_NOISE)),
                *((-1, part) for part in parts(model)),
            ],
        )

    @pytest.mark.parametrize("delay", [0.0, 0.03, 0.1])
    def test_at_whole_periods_the_first_part_is_sampled_sky_hook_itself(
        self, vehicle: LateralVehicle, delay: float
    ) -> None:
        model = design_model(vehicle, delay)
        assert_same(
            PredictorSkyHook(vehicle, delay, GAIN)
            .to_sampled_loop(vehicle, PERIOD)
            .lifted_matrix(delay),
            [(1, undelayed(vehicle, GAIN)), (1, estimation(model, LIVELY_NOISE))],
        )

    def test_a_broken_period_is_left_as_the_delay(self, vehicle: LateralVehicle) -> None:
        # the law predicts to the start of the period in which the force arrives
        law = PredictorSkyHook(vehicle, 0.123, GAIN).to_sampled_loop(vehicle, PERIOD)
        rest = SkyHook(GAIN, 4).to_sampled_loop(vehicle, PERIOD)
        model = design_model(vehicle, 0.123)
        assert_same(
            law.lifted_matrix(0.123),
            [(1, rest.lifted_matrix(0.003)), (1, estimation(model, LIVELY_NOISE))],
        )

    def test_it_is_stable_beyond_the_critical_delay_of_sky_hook(
        self, vehicle: LateralVehicle
    ) -> None:
        plain = SkyHook(GAIN, 4).to_sampled_loop(vehicle, PERIOD)
        for delay in (0.2, 0.3):
            law = PredictorSkyHook(vehicle, delay, GAIN).to_sampled_loop(vehicle, PERIOD)
            assert plain.growth_rate(delay) > 0.0 > law.growth_rate(delay)


class TestSmith:
    @pytest.mark.parametrize("delay", DELAYS)
    @pytest.mark.parametrize("layout", [2, 4])
    def test_the_spectrum_is_that_without_delay_and_that_without_control(
        self, delay: float, layout: int
    ) -> None:
        car = lateral17("paper_fit", layout, 300.0)
        loop = SmithSkyHook(car, delay, GAIN).to_sampled_loop(car, PERIOD)
        assert_same(loop.lifted_matrix(delay), [(1, undelayed(car, GAIN)), (1, uncontrolled(car))])

    @pytest.mark.parametrize(("layout", "percent"), [(4, 0.18), (2, 8.02)])
    def test_the_uncontrolled_sway_of_half_a_hertz_stays(self, layout: int, percent: float) -> None:
        # without two or all four of its lateral dampers; the paper's layout 4 leaves 0.2 %
        car = lateral17("paper_fit", layout, 300.0)
        lifted = SmithSkyHook(car, 0.1, GAIN).to_sampled_loop(car, PERIOD).lifted_matrix(0.1)
        z = linalg.eigvals(lifted)
        rates = np.log(z[np.abs(z) > 0.5].astype(complex)) / PERIOD
        own = linalg.eigvals(state_space(car).A)
        kept = own[np.argmin(np.abs(own - 3.41j))]
        # eigenvalues of a hundred rows against those of the vehicle; other modes are 1 1/s away
        assert np.abs(rates - kept).min() < 1e-6 * abs(kept)
        assert -100.0 * kept.real / abs(kept) == pytest.approx(percent, abs=0.01)

    def test_the_predictor_does_not_leave_it_there(self, vehicle: LateralVehicle) -> None:
        # with four actuators the sway leaves at 0.006 1/s behind Smith's predictor
        smith = SmithSkyHook(vehicle, 0.1, GAIN).to_sampled_loop(vehicle, PERIOD)
        predictor = PredictorSkyHook(vehicle, 0.1, GAIN).to_sampled_loop(vehicle, PERIOD)
        assert smith.growth_rate(0.1) == pytest.approx(-0.0061, abs=1e-4)
        assert predictor.growth_rate(0.1) < -0.3

    @pytest.mark.parametrize("error", [-0.05, -0.02, 0.02, 0.05])
    def test_it_does_not_grow_when_the_delay_is_wrong_by_fifty_milliseconds(
        self, vehicle: LateralVehicle, error: float
    ) -> None:
        loop = SmithSkyHook(vehicle, 0.1, GAIN).to_sampled_loop(vehicle, PERIOD)
        assert loop.growth_rate(0.1 + error) < 0.0

    def test_without_gain_it_is_silent(self, vehicle: LateralVehicle) -> None:
        law = SmithSkyHook(vehicle, 0.1, 0.0)
        law.reset(1, 0)
        assert not np.any(law.act(np.ones((1, len(law.measures)))))

    def test_without_delay_it_is_sky_hook(self, vehicle: LateralVehicle) -> None:
        law, plain = SmithSkyHook(vehicle, 0.0, GAIN), SkyHook(GAIN, 4)
        law.reset(2, 0)
        rng = np.random.Generator(np.random.PCG64(5))
        for _ in range(5):
            seen = rng.standard_normal((2, len(law.measures)))
            # the model with the delay is the model without: their difference stays at zero
            np.testing.assert_allclose(law.act(seen), plain.act(seen), rtol=1e-9)


class TestRefused:
    @pytest.mark.parametrize("law", [PredictorSkyHook, SmithSkyHook])
    @pytest.mark.parametrize(
        ("name", "settings"),
        [
            ("delay", {"delay": -0.01}),
            ("delay", {"delay": 1e3}),
            ("gain", {"gain": -1.0}),
            ("period", {"control_period": 0.0}),
        ],
    )
    def test_a_value_out_of_range_is_named(
        self, vehicle: LateralVehicle, law: type, name: str, settings: dict[str, float]
    ) -> None:
        with pytest.raises(ArgumentError, match=name):
            law(vehicle, **settings)

    @pytest.mark.parametrize("law", [PredictorSkyHook, SmithSkyHook])
    def test_a_vehicle_without_actuators(self, law: type) -> None:
        with pytest.raises(ArgumentError, match="passive"):
            law(lateral17("paper_fit", "passive", 300.0))

    def test_an_estimator_without_noise(self, vehicle: LateralVehicle) -> None:
        with pytest.raises(ArgumentError, match="noise"):
            PredictorSkyHook(vehicle, noise=0.0)
