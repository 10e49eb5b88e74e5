"""The H2 optimum: its equations by scipy, its cost twice, and that nothing near it is better."""

from dataclasses import replace

import numpy as np
import pytest
from scipy import linalg

from baselines import SkyHook
from baselines.design.cost import LoopCost, loop_cost
from baselines.design.model import DESIGN_NOISE, DesignModel, design_model, sensor_noise
from baselines.design.optimum import (
    Estimator,
    Optimum,
    estimator,
    regulator,
)
from baselines.design.predictor_law import PredictorLaw
from baselines.design.riccati import riccati_residual
from baselines.lqg import SHARP_EFFORT, DelayLqg
from baselines.optimum import exact_optimum
from railenv.envs.observation import DEFAULT_ACTION_SCALE, sensor_names
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle

NOISE, EFFORT = DESIGN_NOISE, SHARP_EFFORT
SENSORS = sensor_names("4")


@pytest.fixture(scope="module")
def models(vehicle: LateralVehicle) -> dict[float, DesignModel]:
    return {delay: design_model(vehicle, delay) for delay in (0.0, 0.0237, 0.1)}


def in_kilonewtons(model: DesignModel) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """A, B, C and D with forces in units of an action, for solvers that mind sizes."""
    scale = np.ones(len(model.A))
    scale[-model.num_channels :] = DEFAULT_ACTION_SCALE
    F0 = DEFAULT_ACTION_SCALE
    return (
        model.A * scale / scale[:, None],
        model.B * F0 / scale[:, None],
        model.C * scale,
        model.D * F0,
    )


class TestEquations:
    def test_the_gain_is_that_of_one_riccati_equation_of_everything(
        self, models: dict[float, DesignModel]
    ) -> None:
        # with the track's states in the plant, by scipy; the model solves for the vehicle alone
        A, B, C, D = in_kilonewtons(models[0.0])
        m = B.shape[1]
        R, S = D.T @ D + EFFORT / m * np.eye(m), C.T @ D
        X = linalg.solve_discrete_are(A, B, C.T @ C, R, s=S)
        expected = np.linalg.solve(R + B.T @ X @ B, B.T @ X @ A + S.T)
        found = regulator(models[0.0], EFFORT).gain / DEFAULT_ACTION_SCALE
        found[:, -m:] *= DEFAULT_ACTION_SCALE
        # scipy takes a pencil of 140 rows apart and keeps eight digits of the largest entry
        np.testing.assert_allclose(found, expected, atol=1e-7 * np.abs(expected).max())

    @pytest.mark.parametrize("effort", [1e-6, 1e-3, 10.0])
    def test_the_regulators_equation_is_solved(
        self, models: dict[float, DesignModel], effort: float
    ) -> None:
        found = regulator(models[0.0], effort)
        # doubling reaches 4e-12 at the smallest effort
        assert riccati_residual(*found.riccati, found.value) < 1e-10
        closed = models[0.0].A - models[0.0].B @ found.gain
        assert np.abs(np.linalg.eigvals(closed)).max() < 1.0

    def test_the_estimator_is_kalmans_by_scipy(self, models: dict[float, DesignModel]) -> None:
        model = models[0.0]
        found = estimator(model, SENSORS, NOISE)
        R = np.diag(sensor_noise(SENSORS, NOISE) ** 2)
        P = linalg.solve_discrete_are(model.A.T, found.M.T, model.G @ model.G.T, R)
        gain = np.linalg.solve(found.M @ P @ found.M.T + R, found.M @ P).T
        scale = np.abs(found.gain).max(axis=1, keepdims=True)
        # each row of the gain has its own unit; that of the force, which is known, is zero
        np.testing.assert_array_equal(found.gain[-4:], 0.0)
        scale[-4:] = 1.0
        # scipy keeps six digits of the smallest rows
        np.testing.assert_allclose(found.gain / scale, gain / scale, atol=1e-5)
        # Joseph's form of the error: right for any gain, here the optimal one
        left = np.eye(len(P)) - gain @ found.M
        error = left @ P @ left.T + gain @ R @ gain.T
        # scipy's gain carries errors of some 1e-8
        np.testing.assert_allclose(found.error, error, atol=1e-7 * np.abs(error).max())

    @pytest.mark.parametrize("preview", [False, True])
    def test_the_estimators_equation_is_solved(
        self, vehicle: LateralVehicle, preview: bool
    ) -> None:
        model = design_model(vehicle, 0.0, preview=preview)
        found = estimator(model, SENSORS, NOISE)
        whitened = found.M / sensor_noise(SENSORS, NOISE)[:, None]
        before = found.error + found.innovation
        residual = riccati_residual(model.A.T, whitened.T @ whitened, model.G @ model.G.T, before)
        assert residual < 1e-10  # doubling reaches 2e-11 with the 163 states of preview
        poles = np.linalg.eigvals(model.A @ (np.eye(len(model.A)) - found.gain @ found.M))
        assert np.abs(poles).max() < 1.0


class TestDelay:
    """Prediction against the plant augmented by the commands on their way; d = 2 and a rest."""

    def augmented(self, model: DesignModel) -> tuple[FloatArray, FloatArray, FloatArray]:
        """A, B and C of [X, u_(k-1), u_(k-2)], forces in units of an action."""
        A, B, C, D = in_kilonewtons(model)
        n, m = B.shape
        whole, drive = np.zeros((n + 2 * m, n + 2 * m)), np.zeros((n + 2 * m, m))
        whole[:n, :n], whole[:n, n + m :] = A, B
        whole[n + m :, n : n + m] = np.eye(m)
        drive[n : n + m] = np.eye(m)
        return whole, drive, np.hstack([C, np.zeros((len(C), m)), D])

    def test_the_gain_is_that_of_the_augmented_plant(
        self, models: dict[float, DesignModel]
    ) -> None:
        model = models[0.0237]
        A, B, _, _ = in_kilonewtons(model)
        m = model.num_channels
        whole, drive, cost = self.augmented(model)
        R = EFFORT / m * np.eye(m)
        X = linalg.solve_discrete_are(whole, drive, cost.T @ cost, R)
        expected = np.linalg.solve(R + drive.T @ X @ drive, drive.T @ X @ whole)
        K = regulator(model, EFFORT).gain / DEFAULT_ACTION_SCALE
        K[:, -m:] *= DEFAULT_ACTION_SCALE
        found = np.hstack([K @ A @ A, K @ B, K @ A @ B])
        # as above: scipy's pencil of 160 rows keeps seven digits of the largest entry
        np.testing.assert_allclose(found, expected, atol=1e-6 * np.abs(expected).max())

    def test_the_law_answers_a_reading_as_lqg_of_the_augmented_plant_does(
        self, models: dict[float, DesignModel]
    ) -> None:
        model = models[0.0237]
        m, n = model.num_channels, len(model.A)
        whole, drive, cost = self.augmented(model)
        F0 = DEFAULT_ACTION_SCALE
        scale = np.r_[np.ones(n - m), np.full(m, F0)]
        M = np.hstack([model.measurement(SENSORS) * scale, np.zeros((len(SENSORS), 2 * m))])
        deviation = sensor_noise(SENSORS, NOISE)
        M /= deviation[:, None]
        W = np.zeros_like(whole)
        W[:n, :n] = (model.G @ model.G.T) / np.outer(scale, scale)
        R = EFFORT / m * np.eye(m)
        X = linalg.solve_discrete_are(whole, drive, cost.T @ cost, R)
        K = np.linalg.solve(R + drive.T @ X @ drive, drive.T @ X @ whole)
        # Commands on their way are known: their own error is zero, and so is its equation.
        P = np.zeros_like(whole)
        P[:n, :n] = linalg.solve_discrete_are(
            whole[:n, :n].T, M[:, :n].T, W[:n, :n], np.eye(len(M))
        )
        L = np.linalg.solve(M @ P @ M.T + np.eye(len(M)), M @ P).T
        np.testing.assert_allclose(
            whole @ (P - L @ M @ P) @ whole.T + W, P, atol=1e-9 * np.abs(P).max()
        )
        law = PredictorLaw(model, regulator(model, EFFORT).gain, estimator(model, SENSORS, NOISE))
        A, B, C, D = (getattr(law.law, name) for name in "ABCD")
        estimate, own = np.zeros((len(whole), len(M))), np.zeros((len(A), len(M)))
        expected, found = [], []
        for k in range(40):
            y = np.eye(len(M)) if k == 0 else np.zeros((len(M), len(M)))
            filtered = estimate + L @ (y - M @ estimate)
            expected.append(-K @ filtered * F0)
            estimate = whole @ filtered + drive @ (-K @ filtered)
            reading = deviation[:, None] * y
            found.append(-(C @ own + D @ reading))
            own = A @ own + B @ reading
        scale_of_answer = np.abs(np.array(expected)).max()
        # eight digits of scipy's two gains, over 40 periods of an unstable law
        np.testing.assert_allclose(found, expected, atol=1e-5 * scale_of_answer)


class TestCost:
    @pytest.mark.parametrize("delay", [0.0, 0.0237, 0.1])
    @pytest.mark.parametrize("noise", [NOISE, 1.0])
    def test_the_design_predicts_what_its_loop_costs(
        self, models: dict[float, DesignModel], delay: float, noise: float
    ) -> None:
        model = models[delay]
        known = estimator(model, SENSORS, noise)
        design = Optimum(model, regulator(model, EFFORT), known)
        law = PredictorLaw(model, design.regulator.gain, known)
        cost = loop_cost(model, law, noise)
        # two routes through covariances: prediction errors, and the whole loop's Lyapunov equation
        assert cost.weighted_acceleration == pytest.approx(design.weighted_acceleration, rel=1e-6)
        assert cost.force_rms == pytest.approx(design.force_rms, rel=1e-6)

    def test_the_design_in_a_row_predicts_what_its_loop_costs(
        self, vehicle: LateralVehicle
    ) -> None:
        law = DelayLqg(vehicle, 0.0537, preview=True)
        cost = loop_cost(law.optimum.model, law, NOISE)
        design = law.optimum
        assert cost.weighted_acceleration == pytest.approx(design.weighted_acceleration, rel=1e-6)
        assert cost.force_rms == pytest.approx(design.force_rms, rel=1e-6)

    def test_exact_knowledge_costs_what_a_state_feedback_costs(
        self, models: dict[float, DesignModel]
    ) -> None:
        model = models[0.0]
        design = exact_optimum(model, EFFORT)
        K = design.regulator.gain
        X = linalg.solve_discrete_lyapunov(model.A - model.B @ K, model.G @ model.G.T)
        rows = model.C - model.D @ K
        total = np.trace(rows @ X @ rows.T) + np.sum(model.H**2)
        # the same covariance from scipy
        assert design.weighted_acceleration == pytest.approx(np.sqrt(total), rel=1e-6)

    def test_the_noise_of_the_sensors_is_part_of_the_cost(
        self, models: dict[float, DesignModel], vehicle: LateralVehicle
    ) -> None:
        law = SkyHook(35e3, 4)
        still = loop_cost(models[0.1], law)
        noisy = loop_cost(models[0.1], law, 1.0)
        assert noisy.force_rms > still.force_rms
        assert noisy.weighted_acceleration > still.weighted_acceleration


def price(cost: LoopCost | Optimum) -> float:
    """What the design minimises: E z'z + effort E|u|^2 / (m F0^2)."""
    force = cost.force_rms / DEFAULT_ACTION_SCALE
    return cost.weighted_acceleration**2 + EFFORT * force**2


@pytest.fixture(scope="module")
def design(models: dict[float, DesignModel]) -> Optimum:
    model = models[0.0237]
    return Optimum(model, regulator(model, EFFORT), estimator(model, SENSORS, NOISE))


class TestOptimality:
    """A minimum of a smooth function: whatever moves away from it, in either sense, costs more."""

    def moved(self, design: Optimum, gain: FloatArray, known: Estimator) -> float:
        return price(loop_cost(design.model, PredictorLaw(design.model, gain, known), NOISE))

    @pytest.mark.parametrize("seed", range(3))
    @pytest.mark.parametrize("sign", [-1.0, 1.0])
    def test_no_other_gain_is_better(self, design: Optimum, seed: int, sign: float) -> None:
        noise = np.random.Generator(np.random.PCG64(seed)).standard_normal
        K = design.regulator.gain
        other = self.moved(design, K * (1.0 + sign * 0.01 * noise(K.shape)), design.estimator)
        assert other > price(design) * (1.0 + 1e-9)  # a millionth of what is found, above rounding

    @pytest.mark.parametrize("seed", range(3))
    @pytest.mark.parametrize("sign", [-1.0, 1.0])
    def test_no_other_estimator_is_better(self, design: Optimum, seed: int, sign: float) -> None:
        noise = np.random.Generator(np.random.PCG64(seed)).standard_normal
        L = design.estimator.gain
        known = replace(design.estimator, gain=L * (1.0 + sign * 0.01 * noise(L.shape)))
        other = self.moved(design, design.regulator.gain, known)
        assert other > price(design) * (1.0 + 1e-9)

    @pytest.mark.parametrize("gain", [3e3, 1e4, 35e3])
    def test_sky_hook_costs_more(self, design: Optimum, gain: float) -> None:
        assert price(loop_cost(design.model, SkyHook(gain, 4), NOISE)) > price(design)
