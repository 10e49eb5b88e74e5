"""Controllers: SPECs, shapes, what they command, and what the oracle is given."""

from pathlib import Path

import numpy as np
import pytest

from baselines import LinearFeedback, Passive, SkyHook, Zero, make_controller
from railenv.actuation import ActuatorSpec
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError, ControllerError, NeutralLoopError
from railenv.stability import critical_delays
from railenv.vehicle import lateral17, state_space


def test_sky_hook_resists_the_velocity_at_each_actuator() -> None:
    controller = SkyHook(10e3, 4)
    observation = np.zeros((1, len(sensor_names("4")) + 120))
    observation[0, :4] = [0.1, 0.2, -0.3, 0.0]
    forces = controller.action_scale * controller.act(observation)
    assert forces == pytest.approx(np.array([[-1000.0, -2000.0, 3000.0, 0.0]]))


def test_actions_do_not_depend_on_the_number_of_lanes() -> None:
    controller = LinearFeedback(np.random.default_rng(0).normal(size=(4, 16)), sensor_names("4"), 4)
    observations = np.random.default_rng(1).normal(size=(33, 136))
    together = controller.act(observations)
    alone = np.vstack([controller.act(observations[k : k + 1]) for k in range(33)])
    np.testing.assert_array_equal(together, alone)


def test_passive_implies_its_layout() -> None:
    controller = make_controller("passive", 4)
    assert isinstance(controller, Passive)
    assert controller.layout == "passive"


def test_zero_leaves_the_four_actuator_vehicle_all_but_undamped() -> None:
    vehicle = lateral17(layout=4)
    system = Zero(4).to_delay_system(vehicle)
    assert critical_delays(system).crossings == ()
    np.testing.assert_array_equal(system.undelayed, state_space(vehicle).A)


def test_actuator_lag_becomes_part_of_the_loop_and_costs_delay(vehicle) -> None:
    lagged = SkyHook(35e3, 4).to_delay_system(vehicle, ActuatorSpec(lag=0.02))
    assert lagged.num_states == 38 + 4
    plain = critical_delays(SkyHook(35e3, 4).to_delay_system(vehicle)).critical_delay
    delayed = critical_delays(lagged).critical_delay
    assert plain is not None
    assert delayed is not None
    # a first-order lag delays slow motion by its time constant
    assert plain - delayed == pytest.approx(0.02, abs=0.003)


def test_accelerometer_feedback_without_a_filter_is_neutral_and_named(vehicle) -> None:
    controller = LinearFeedback(np.eye(4) * 1e3, sensor_names("4")[4:8], 4)
    system = controller.to_delay_system(vehicle)
    assert system.neutral
    with pytest.raises(NeutralLoopError, match=r"carbody_lateral_acceleration_1.*lag"):
        critical_delays(system)


def test_accelerometer_feedback_through_a_lag_is_answered(vehicle) -> None:
    controller = LinearFeedback(np.eye(4) * 1e3, sensor_names("4")[4:8], 4)
    system = controller.to_delay_system(vehicle, ActuatorSpec(lag=0.05))
    assert critical_delays(system).unstable_without_delay == 0


def test_a_controller_of_another_layout_is_refused() -> None:
    with pytest.raises(ArgumentError, match="layout"):
        SkyHook(35e3, 2).to_delay_system(lateral17(layout=4))


@pytest.mark.parametrize(
    ("spec", "message"),
    [
        ("skyhok", "skyhook"),
        ("skyhook:gian=1e3", "gain"),
        ("skyhook:gain", "no value"),
        ("skyhook:gain=abc", "not a finite number"),
        ("skyhook:gain=nan", "finite"),
        ("skyhook:gain=-1", "negative"),
        ("passive:gain=1", "no settings"),
        ("py:nothing_here:make", "not found"),
        ("py:json", "module:function"),
        ("py:json:nothing", "no function"),
        ("", "unknown controller"),
    ],
)
def test_a_bad_spec_is_refused_with_the_way_out(spec: str, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        make_controller(spec)


def test_a_spec_without_settings_takes_the_defaults() -> None:
    controller = make_controller("skyhook")
    assert isinstance(controller, SkyHook)
    np.testing.assert_array_equal(controller.gain, 35e3 * np.eye(4))


def test_a_controller_of_the_users_own_is_found_where_the_command_runs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "my_law.py").write_text(
        "from baselines import SkyHook\n\ndef make(layout):\n    return SkyHook(1e3, layout)\n"
    )
    monkeypatch.chdir(tmp_path)
    monkeypatch.syspath_prepend(str(tmp_path))
    controller = make_controller("py:my_law:make", 2)
    assert isinstance(controller, SkyHook)
    assert controller.gain.shape == (2, 2)


@pytest.mark.parametrize(
    ("name", "body", "message"),
    [
        ("raises", "def make():\n    raise ValueError('no luck')\n", "no luck"),
        ("returns", "def make():\n    return 3\n", "returned int"),
        ("broken", "1 / 0\n", "ZeroDivisionError"),
    ],
)
def test_a_failing_function_of_the_users_own_is_a_controller_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, name: str, body: str, message: str
) -> None:
    (tmp_path / f"law_{name}.py").write_text(body)
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ControllerError, match=message):
        make_controller(f"py:law_{name}:make")


@pytest.mark.parametrize("layout", [3, "6", None])
def test_a_layout_that_does_not_exist_is_refused(layout: object) -> None:
    with pytest.raises(ArgumentError, match="choose passive, 2 or 4"):
        SkyHook(1e3, layout)


def test_a_sensor_that_does_not_exist_is_refused_with_the_nearest() -> None:
    with pytest.raises(ArgumentError, match="carbody_roll_rate"):
        LinearFeedback(np.zeros((4, 1)), ("carbody_rol_rate",), 4)


def test_the_layout_is_given_only_to_a_parameter_of_that_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "level_law.py").write_text(
        "class Law:\n"
        "    def __init__(self, level=1.0): self.level = level\n"
        "    def reset(self, num_lanes, seed): pass\n"
        "    def act(self, observations): return observations[:, :4]\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    assert make_controller("py:level_law:Law", 4).level == 1.0  # type: ignore[attr-defined]


def test_a_module_that_exits_is_a_controller_error(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "exit_law.py").write_text("import sys\nsys.exit(3)\n")
    monkeypatch.syspath_prepend(str(tmp_path))
    with pytest.raises(ControllerError, match="SystemExit"):
        make_controller("py:exit_law:make")
