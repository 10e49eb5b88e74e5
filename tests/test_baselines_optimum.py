"""What knowledge is worth: full information, sensors, preview, and what the yardstick costs."""

import numpy as np
import pytest

from baselines.design.cost import LoopCost, loop_cost
from baselines.design.model import DESIGN_NOISE, DesignModel, design_model
from baselines.design.optimum import (
    Estimator,
    Optimum,
    estimator,
    perfect_knowledge,
    regulator,
)
from baselines.lqg import SHARP_EFFORT, DelayLqg
from baselines.optimum import OPTIMUM, FullInformation, everything, exact_optimum
from railenv.envs.observation import DEFAULT_ACTION_SCALE, sensor_names
from railenv.errors import ArgumentError, RailenvError
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, lateral17

NOISE, EFFORT = DESIGN_NOISE, SHARP_EFFORT
SENSORS = sensor_names("4")


@pytest.fixture(scope="module")
def models(vehicle: LateralVehicle) -> dict[float, DesignModel]:
    return {delay: design_model(vehicle, delay) for delay in (0.0, 0.0237, 0.1)}


def price(cost: LoopCost | Optimum) -> float:
    """What the design minimises: E z'z + effort E|u|^2 / (m F0^2)."""
    force = cost.force_rms / DEFAULT_ACTION_SCALE
    return cost.weighted_acceleration**2 + EFFORT * force**2


EFFORTS = np.geomspace(1e-4, 1.0, 9)


def curve(model: DesignModel, known: Estimator) -> tuple[FloatArray, FloatArray]:
    """Forces and accelerations over rising effort."""
    designs = [Optimum(model, regulator(model, effort), known) for effort in EFFORTS]
    return (
        np.array([design.force_rms for design in designs]),
        np.array([design.weighted_acceleration for design in designs]),
    )


@pytest.fixture(scope="module")
def told(models: dict[float, DesignModel]) -> tuple[FloatArray, FloatArray]:
    return curve(models[0.1], perfect_knowledge(models[0.1]))


@pytest.fixture(scope="module")
def sensed(models: dict[float, DesignModel]) -> tuple[FloatArray, FloatArray]:
    return curve(models[0.1], estimator(models[0.1], SENSORS, NOISE))


class TestWhatKnowledgeIsWorth:
    def test_effort_buys_less_force_for_more_acceleration(
        self, told: tuple[FloatArray, FloatArray], sensed: tuple[FloatArray, FloatArray]
    ) -> None:
        for force, acceleration in (told, sensed):
            assert np.all(np.diff(force) < 0.0)
            assert np.all(np.diff(acceleration) > 0.0)

    def test_full_information_is_better_at_equal_force(
        self, told: tuple[FloatArray, FloatArray], sensed: tuple[FloatArray, FloatArray]
    ) -> None:
        forces = np.geomspace(
            max(told[0].min(), sensed[0].min()), min(told[0].max(), sensed[0].max()), 20
        )
        at = [np.interp(forces, force[::-1], a[::-1]) for force, a in (told, sensed)]
        assert np.all(at[0] < at[1])

    def test_more_noise_costs(self, models: dict[float, DesignModel]) -> None:
        gain = regulator(models[0.1], EFFORT)
        costs = [
            price(Optimum(models[0.1], gain, estimator(models[0.1], SENSORS, noise)))
            for noise in (0.03, 0.1, 0.3, 1.0)
        ]
        assert np.all(np.diff(costs) > 0.0)

    def test_a_longer_delay_costs(self, models: dict[float, DesignModel]) -> None:
        costs = [price(exact_optimum(models[delay], EFFORT)) for delay in (0.0, 0.0237, 0.1)]
        assert np.all(np.diff(costs) > 0.0)

    def test_on_a_track_in_a_row_to_know_that_it_is_one_helps(
        self, vehicle: LateralVehicle
    ) -> None:
        real = DelayLqg(vehicle, 0.1, preview=True)
        ignorant = loop_cost(real.optimum.model, DelayLqg(vehicle, 0.1), NOISE)
        # at 100 ms the rear end sees most of its track 210 ms before it comes
        assert price(real.optimum) < 0.9 * price(ignorant)


class TestYardstick:
    """What the law that is told states and track costs above its bound."""

    @pytest.mark.parametrize(
        ("preview", "delay", "percent", "bound"),
        [
            (False, 0.0, 4.5, 0.0016),
            (False, 0.1, 0.76, 0.0269),
            (True, 0.0, 0.71, 0.0021),
            (True, 0.1, 1.04, 0.0273),
        ],
    )
    def test_readings_at_the_samples_tell_almost_everything(
        self, vehicle: LateralVehicle, preview: bool, delay: float, percent: float, bound: float
    ) -> None:
        law = FullInformation(vehicle, delay, preview=preview)
        best, cost = law.optimum, loop_cost(law.optimum.model, law, 1e-3)
        above = 100.0 * (cost.weighted_acceleration / best.weighted_acceleration - 1.0)
        # what the readings leave open: rates of the track, and the ride filters between samples
        assert above == pytest.approx(percent, abs=0.02)  # the digits of the module's text
        assert best.weighted_acceleration == pytest.approx(bound, abs=6e-5)
        assert cost.force_rms == pytest.approx(best.force_rms, rel=4e-3)

    def test_designed_for_wheelsets_apart_it_loses_almost_a_quarter_on_one(
        self, vehicle: LateralVehicle
    ) -> None:
        law, one_track = FullInformation(vehicle, 0.1), design_model(vehicle, 0.1, preview=True)
        apart, in_a_row = (loop_cost(model, law) for model in (law.optimum.model, one_track))
        ratio = in_a_row.weighted_acceleration / apart.weighted_acceleration
        assert ratio == pytest.approx(1.23, abs=0.005)  # the digits of the module's text

    @pytest.mark.parametrize("delay", [0.0, 0.1])
    def test_the_noise_put_in_for_the_sake_of_the_equation_does_not_matter(
        self, vehicle: LateralVehicle, delay: float
    ) -> None:
        # in preview the equation can be solved down to a millionth
        model, names = design_model(vehicle, delay, preview=True), everything(vehicle)
        gain = regulator(model, EFFORT)
        costs = [
            Optimum(model, gain, estimator(model, names, noise)).weighted_acceleration
            for noise in (1e-6, 1e-3)
        ]
        assert costs[0] < costs[1] < costs[0] * (1.0 + 3e-4)

    def test_readings_without_any_noise_are_refused(self, models: dict[float, DesignModel]) -> None:
        names = everything(models[0.1].vehicle)
        with pytest.raises(RailenvError, match="change the effort, the noise or the sensors"):
            estimator(models[0.1], names, 1e-5)

    def test_full_information_bounds_the_sensors(self, vehicle: LateralVehicle) -> None:
        bound = FullInformation(vehicle, 0.1).optimum
        assert price(bound) < price(DelayLqg(vehicle, 0.1).optimum)

    def test_the_entry_builds_the_law_for_its_speed(self, vehicle: LateralVehicle) -> None:
        settings = {name: value for name, (value, _) in OPTIMUM.settings.items()}
        built = OPTIMUM.build(vehicle, **{**settings, "design_kmh": 200.0})
        assert isinstance(built, FullInformation)
        assert built.optimum.model.vehicle.speed == pytest.approx(200.0 / 3.6, rel=1e-15)

    def test_refused(self, vehicle: LateralVehicle) -> None:
        with pytest.raises(ArgumentError, match="effort"):
            FullInformation(vehicle, effort=0.0)
        with pytest.raises(ArgumentError, match="passive"):
            FullInformation(lateral17("paper_fit", "passive", 300.0))
