"""Export to scipy.signal and python-control: the same law, sign and names included."""

import builtins
from typing import Any

import control
import numpy as np
import pytest
from scipy import signal

from baselines import LinearDynamic, LinearFeedback, SkyHook
from baselines.controller import plant_seen
from baselines.passive import Passive, Zero
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError
from railenv.stability import DelaySystem, rightmost_roots
from railenv.vehicle import lateral17

VELOCITIES = sensor_names("4")[:4]
FORCES = ["actuator_force_1", "actuator_force_4"]
PERIOD = 0.02
RANDOM = np.random.default_rng(3)
# A stable law of five states, two actuators and four sensors, in either time.
MATRICES = (
    0.1 * RANDOM.normal(size=(5, 5)) - 0.5 * np.eye(5),
    RANDOM.normal(size=(5, 4)),
    1e3 * RANDOM.normal(size=(2, 5)),
    1e3 * RANDOM.normal(size=(2, 4)),
)
SENSORS = sensor_names("2")[:4]


def law(sampled: bool) -> LinearDynamic:
    return LinearDynamic(MATRICES, SENSORS, 2, control_period=PERIOD, sampled=sampled)


def response(place: complex) -> np.ndarray:
    """The law's own transfer matrix at a point s or z."""
    A, B, C, D = MATRICES
    return C @ np.linalg.solve(place * np.eye(5) - A, B) + D


def scipys(system, place: complex) -> np.ndarray:
    A, B, C, D = system.A, system.B, system.C, system.D
    return C @ np.linalg.solve(place * np.eye(len(A)) - A, B) + D


@pytest.mark.parametrize("omega", [0.3, 7.0, 90.0])
@pytest.mark.parametrize("sampled", [False, True])
def test_the_exported_system_maps_readings_to_forces_sign_included(
    sampled: bool, omega: float
) -> None:
    place = np.exp(1j * omega * PERIOD) if sampled else 1j * omega
    wanted = -response(place)
    for found in (scipys(law(sampled).to_scipy(), place), law(sampled).to_control()(place)):
        np.testing.assert_allclose(found, wanted, rtol=1e-10)  # a solve of five equations


def test_what_a_sampled_export_answers_is_what_act_does() -> None:
    readings = np.random.default_rng(5).normal(size=(40, 4))
    controller = law(sampled=True)
    controller.reset(1, 0)
    columns = len(sensor_names("2"))
    forces = np.array(
        [
            controller.act(np.pad(reading, (0, columns - 4))[None])[0] * controller.action_scale
            for reading in readings
        ]
    )
    _, found, _ = signal.dlsim(controller.to_scipy(), readings)
    # Sums of a dozen products in another order.
    np.testing.assert_allclose(found, forces, rtol=1e-9, atol=1e-9 * np.abs(forces).max())
    respond: Any = control.forced_response
    answer = respond(controller.to_control(), inputs=readings.T)
    np.testing.assert_allclose(
        answer.outputs.T, forces, rtol=1e-9, atol=1e-9 * np.abs(forces).max()
    )


def test_a_continuous_law_stays_continuous_and_a_sampled_one_has_its_period() -> None:
    assert isinstance(law(False).to_scipy(), signal.lti)
    assert isinstance(law(True).to_scipy(), signal.dlti)
    assert law(True).to_scipy().dt == PERIOD
    assert (law(False).to_control().dt, law(True).to_control().dt) == (0, PERIOD)


def test_python_control_is_told_the_names_of_sensors_and_forces() -> None:
    for controller in (law(False), law(True), LinearFeedback(np.ones((2, 4)), SENSORS, 2)):
        system = controller.to_control()
        assert system.input_labels == list(SENSORS)
        assert system.output_labels == FORCES


def test_a_gain_is_a_static_system_without_a_time_of_its_own() -> None:
    controller = SkyHook(35e3, 4)
    for system in (controller.to_scipy(), controller.to_control()):
        np.testing.assert_array_equal(system.D, -controller.gain)
        assert system.A.size == 0
        assert system.dt is None


@pytest.mark.parametrize("sampled", [False, True])
def test_the_export_is_no_view_of_the_laws_own_matrices(sampled: bool) -> None:
    controller = law(sampled)
    for system in (controller.to_scipy(), controller.to_control()):
        for name in "ABCD":
            assert not np.shares_memory(getattr(system, name), getattr(controller.law, name))


def test_the_loop_of_the_export_is_the_controllers_own() -> None:
    vehicle = lateral17("paper_fit", 2, 300.0)
    controller = law(sampled=False)
    own = controller.to_delay_system(vehicle)
    plant = plant_seen(vehicle, SENSORS, None)
    again = DelaySystem.from_loop(plant, -controller.to_control())
    for name in ("A", "B", "K", "feedthrough"):
        np.testing.assert_array_equal(getattr(again, name), getattr(own, name))


def test_python_controls_own_feedback_closes_the_loop_with_plus() -> None:
    vehicle = lateral17("paper_fit", 4, 300.0)
    controller = SkyHook(35e3, 4)
    seen = plant_seen(vehicle, controller.sensors, None)
    plant = control.ss(seen.A, seen.B, seen.C, seen.D)
    closed: Any = control.feedback(plant, controller.to_control(), sign=+1)
    wanted = rightmost_roots(controller.to_delay_system(vehicle), 0.0, 3)
    found = sorted(closed.poles(), key=lambda pole: -pole.real)
    # Eigenvalues of a matrix in SI units: some 1e-10 of its largest, 1e4 1/s.
    assert found[0].real == pytest.approx(wanted[0].root.real, abs=1e-5)


def test_a_law_for_another_period_is_refused_by_the_continuous_oracle() -> None:
    vehicle = lateral17("paper_fit", 2, 300.0)
    with pytest.raises(ArgumentError, match=r"dt = 0\.02"):
        DelaySystem.from_loop(plant_seen(vehicle, SENSORS, None), law(True).to_control())


@pytest.mark.parametrize("controller", [Passive(), Zero(4)])
def test_what_has_no_ends_is_not_exported(controller: LinearFeedback) -> None:
    for convert in (controller.to_scipy, controller.to_control):
        with pytest.raises(ArgumentError, match="no system to export"):
            convert()


def test_without_python_control_the_error_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    real = builtins.__import__

    def missing(name: str, *rest: object, **named: object):
        if name == "control":
            raise ModuleNotFoundError("No module named 'control'")
        return real(name, *rest, **named)  # type: ignore[arg-type]

    monkeypatch.setattr(builtins, "__import__", missing)
    with pytest.raises(ArgumentError, match="pip install control"):
        SkyHook(35e3, 4).to_control()
    assert SkyHook(35e3, 4).to_scipy().D.shape == (4, 4)
