"""LQR and LQG: their equations, their margins, and what a wrong delay does to them."""

import control
import numpy as np
import pytest
from scipy import linalg

from baselines.design.cost import loop_cost
from baselines.design.model import DESIGN_NOISE
from baselines.lqg import DELAY_LQG, DETUNED, LQG, SHARP_EFFORT, DelayLqg, Lqg
from baselines.lqr import LQR, LinearQuadraticRegulator
from railenv.errors import ArgumentError
from railenv.stability import critical_delays
from railenv.vehicle import LateralVehicle, lateral17

PERIOD, STEP = 0.01, 0.005


class TestLqr:
    @pytest.mark.parametrize("layout", [2, 4])
    @pytest.mark.parametrize("effort", [1e-3, 0.1, 10.0])
    def test_its_riccati_equation_is_solved(self, layout: int, effort: float) -> None:
        law = LinearQuadraticRegulator(lateral17("paper_fit", layout, 300.0), effort)
        A, B, Q, R, S = law.riccati
        X, K = law.value, law.gain
        terms = (A.T @ X, X @ A, Q, K.T @ R @ K)
        residual = terms[0] + terms[1] + Q - K.T @ R @ K
        # of the largest term; X spans ten powers of ten
        assert np.abs(residual).max() < 1e-9 * max(np.abs(term).max() for term in terms)
        np.testing.assert_allclose(R @ K, B.T @ X + S.T, atol=1e-12 * np.abs(R @ K).max())
        assert linalg.eigvals(A - B @ K).real.max() < 0.0

    def test_its_gain_is_python_controls(self, vehicle: LateralVehicle) -> None:
        law = LinearQuadraticRegulator(vehicle)
        A, B, Q, R, S = law.riccati
        # Forces in units of an action, so that R is of order one for the other solver.
        F0 = 3e3
        gain, _, _ = control.lqr(A, B * F0, Q, R * F0**2, S * F0)
        # eight digits of the largest entry: positions ask for 1e6 N/m, angles for 1e3 N/rad
        np.testing.assert_allclose(
            law.gain, np.asarray(gain) * F0, atol=1e-6 * np.abs(law.gain).max()
        )

    @pytest.mark.parametrize("effort", [1e-3, 0.1])
    def test_its_return_difference_is_the_spectral_factor_of_its_cost(
        self, vehicle: LateralVehicle, effort: float
    ) -> None:
        # (1 + L)* R (1 + L) = cost of a force of that frequency: Kalman's identity with what the
        # force does to the floor at once, C Phi B + D
        law = LinearQuadraticRegulator(vehicle, effort)
        A, B, Q, R, S = law.riccati
        for omega in 2 * np.pi * np.geomspace(0.05, 50.0, 12):
            Phi = np.linalg.solve(1j * omega * np.eye(len(A)) - A, B)
            factor = np.eye(len(R)) + law.gain @ Phi
            cross = Phi.conj().T @ S
            power = Phi.conj().T @ Q @ Phi + cross + cross.conj().T + R
            left = factor.conj().T @ R @ factor
            np.testing.assert_allclose(left, power, atol=1e-7 * np.abs(power).max())

    def test_its_return_difference_is_not_above_one_everywhere(
        self, vehicle: LateralVehicle
    ) -> None:
        # The textbook's margin needs a cost without a product of state and force: a force moves the
        # floor at once, and where the floor's answer is smaller than that the margin is, too. What
        # is left is the share of the effort in the cost of a force, sqrt(effort / R).
        law = LinearQuadraticRegulator(vehicle)
        A, B, _, R, _ = law.riccati
        root = np.real(linalg.sqrtm(R))
        effort = 0.1 / (4 * 3e3**2)
        bound = np.sqrt(effort / np.abs(np.linalg.eigvalsh(R)).max())
        smallest = []
        for omega in 2 * np.pi * np.geomspace(0.05, 50.0, 60):
            Phi = np.linalg.solve(1j * omega * np.eye(len(A)) - A, B)
            factor = root @ (np.eye(len(R)) + law.gain @ Phi) @ np.linalg.inv(root)
            smallest.append(np.linalg.svd(factor, compute_uv=False)[-1])
        assert bound * (1.0 - 1e-6) <= min(smallest) < 0.9

    @pytest.mark.slow
    def test_the_cheaper_its_force_the_less_delay_it_stands(self, vehicle: LateralVehicle) -> None:
        found = [
            critical_delays(
                LinearQuadraticRegulator(vehicle, effort).to_delay_system(vehicle)
            ).critical_delay
            for effort in (0.01, 0.1, 1.0)
        ]
        # 0.224, 0.245 and 0.350 s: a law that knows of no delay still has a margin
        assert found == pytest.approx([0.2237, 0.2448, 0.3503], abs=1e-4)

    def test_more_effort_is_less_gain(self, vehicle: LateralVehicle) -> None:
        gains = [LinearQuadraticRegulator(vehicle, effort).gain for effort in (0.01, 0.1, 1.0)]
        sizes = [np.linalg.norm(gain[:, 17:34]) for gain in gains]
        assert np.all(np.diff(sizes) < 0.0)

    def test_refused(self, vehicle: LateralVehicle) -> None:
        with pytest.raises(ArgumentError, match="effort"):
            LinearQuadraticRegulator(vehicle, 0.0)
        with pytest.raises(ArgumentError, match="passive"):
            LinearQuadraticRegulator(lateral17("paper_fit", "passive", 300.0))

    def test_design_kmh_designs_for_another_speed(self, vehicle: LateralVehicle) -> None:
        law = LQR.build(vehicle, effort=0.1, design_kmh=200.0)
        assert isinstance(law, LinearQuadraticRegulator)
        expected = LinearQuadraticRegulator(lateral17("paper_fit", 4, 200.0), 0.1)
        np.testing.assert_array_equal(law.gain, expected.gain)


def growth(law: DelayLqg, vehicle: LateralVehicle, delay: float) -> float:
    return law.to_sampled_loop(vehicle, PERIOD).growth_rate(delay)


@pytest.mark.parametrize("preview", [False, True])
@pytest.mark.parametrize("delay", [0.1, 0.2])
class TestWrongDelay:
    def test_the_sharp_design_breaks_at_ten_milliseconds(
        self, vehicle: LateralVehicle, delay: float, preview: bool
    ) -> None:
        law = DelayLqg(vehicle, delay, preview=preview)
        assert growth(law, vehicle, delay) < 0.0
        assert growth(law, vehicle, delay - 0.01) > 0.0
        assert growth(law, vehicle, delay + 0.01) > 0.0

    @pytest.mark.slow
    def test_the_detuned_design_stands_fifty(
        self, vehicle: LateralVehicle, delay: float, preview: bool
    ) -> None:
        law = DelayLqg(vehicle, delay, DETUNED * SHARP_EFFORT, DETUNED * DESIGN_NOISE, preview)
        for error in (-0.05, -0.02, -0.01, 0.0, 0.01, 0.02, 0.05):
            assert growth(law, vehicle, delay + error) < 0.0

    @pytest.mark.slow
    def test_the_sharp_design_is_the_better_one_at_its_own_delay(
        self, vehicle: LateralVehicle, delay: float, preview: bool
    ) -> None:
        sharp = DelayLqg(vehicle, delay, preview=preview)
        detuned = DelayLqg(vehicle, delay, DETUNED * SHARP_EFFORT, DETUNED * DESIGN_NOISE, preview)
        costs = [loop_cost(sharp.optimum.model, law, DESIGN_NOISE) for law in (sharp, detuned)]
        assert costs[0].weighted_acceleration < costs[1].weighted_acceleration
        assert costs[0].force_rms > costs[1].force_rms


def test_a_detuned_design_is_no_guarantee() -> None:
    fast = lateral17("paper_fit", 4, 350.0)
    law = DelayLqg(fast, 0.3, DETUNED * SHARP_EFFORT, DETUNED * DESIGN_NOISE, True)
    assert growth(law, fast, 0.3) < 0.0 < growth(law, fast, 0.32)


class TestEntries:
    def test_without_delay_is_the_detuned_design(self, vehicle: LateralVehicle) -> None:
        built = LQG.build(vehicle, **{name: value for name, (value, _) in LQG.settings.items()})
        assert isinstance(built, Lqg)
        expected = DelayLqg(vehicle, 0.0, DETUNED * SHARP_EFFORT, DETUNED * DESIGN_NOISE)
        for name in "ABCD":
            np.testing.assert_array_equal(getattr(built.law, name), getattr(expected.law, name))

    def test_with_delay_is_the_sharp_design(self, vehicle: LateralVehicle) -> None:
        settings = {name: value for name, (value, _) in DELAY_LQG.settings.items()}
        built = DELAY_LQG.build(vehicle, **settings)
        assert isinstance(built, DelayLqg)
        expected = DelayLqg(vehicle, 0.1, 1e-3, 0.1)
        np.testing.assert_array_equal(built.law.D, expected.law.D)
        assert built.delay == 0.1

    @pytest.mark.parametrize(
        ("name", "settings"),
        [("effort", {"effort": 0.0}), ("noise", {"noise": -1.0}), ("delay", {"delay": -1.0})],
    )
    def test_a_value_out_of_range_is_named(
        self, vehicle: LateralVehicle, name: str, settings: dict[str, float]
    ) -> None:
        with pytest.raises(ArgumentError, match=name):
            DelayLqg(vehicle, **settings)  # type: ignore[arg-type]

    def test_preview_is_a_switch(self, vehicle: LateralVehicle) -> None:
        settings = {name: value for name, (value, _) in DELAY_LQG.settings.items()}
        with pytest.raises(ArgumentError, match=r"preview = 0\.5"):
            DELAY_LQG.build(vehicle, **{**settings, "preview": 0.5})

    def test_a_track_without_a_rational_density_is_refused(self, vehicle: LateralVehicle) -> None:
        with pytest.raises(ArgumentError, match="tb3352"):
            DelayLqg(vehicle, track="tb3352")
