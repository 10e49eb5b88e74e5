"""Dynamic linear feedback: what it commands, what the oracle is told, and its file."""

import io
import json
import os
import zipfile
from pathlib import Path

import control
import numpy as np
import pytest
from scipy import linalg, signal

from baselines import (
    LinearDynamic,
    LinearFeedback,
    SkyHook,
    load_policy,
    make_controller,
    save_policy,
)
from eval.rollout import ControlledBatch, Stepping
from railenv.actuation import ActuatorSpec
from railenv.actuation.hold import held_input
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError, InputFileError, OutputError
from railenv.stability import critical_delays, rightmost_roots
from railenv.vehicle import LateralVehicle, state_space

SENSORS = sensor_names("4")
VELOCITIES = SENSORS[:4]
PERIOD = 0.01
RESONANT = (
    np.array([[0.0, 1.0], [-400.0, -8.0]]),
    np.array([[0.0], [1.0]]),
    np.array([[300.0, 20.0]]),
    np.array([[5.0]]),
)


def low_pass(time: float, gain: float = 35e3) -> tuple[np.ndarray, ...]:
    """Sky-hook behind a first-order low-pass in every channel."""
    eye = np.eye(4)
    return -eye / time, eye / time, gain * eye, np.zeros((4, 4))


def random_law(seed: int, inputs: int = 16, states: int = 5) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    return (
        rng.normal(size=(states, states)) - 3.0 * np.eye(states),
        rng.normal(size=(states, inputs)),
        1e3 * rng.normal(size=(4, states)),
        1e3 * rng.normal(size=(4, inputs)),
    )


def run(controller, readings: np.ndarray) -> np.ndarray:
    """Forces of a controller, shape (steps, lanes, 4), for readings of shape (steps, lanes, c)."""
    controller.reset(readings.shape[1], 0)
    return np.array([controller.action_scale * controller.act(now) for now in readings])


def one_sensor(law) -> LinearDynamic:
    """The same law of the first sensor at the first actuator; the other three stand still."""
    A, B, C, D = law
    rows = np.vstack([C, np.zeros((3, len(A)))]), np.vstack([D, np.zeros((3, 1))])
    return LinearDynamic((A, B, *rows), SENSORS[:1], 4, control_period=PERIOD)


def test_a_ramp_is_answered_as_the_continuous_law_answers_it() -> None:
    A, B, C, D = RESONANT
    slope, steps = 0.7, 40
    readings = np.zeros((steps, 1, len(SENSORS)))
    readings[:, 0, 0] = slope * PERIOD * np.arange(steps)
    forces = run(one_sensor(RESONANT), readings)[:, 0, 0]
    # xc' = A xc + B slope t from rest: a constant added state, one exponential
    block = np.zeros((4, 4))
    block[:2, :2], block[:2, 2:3], block[2, 3] = A, B, 1.0
    expected = []
    for k in range(steps):
        state = linalg.expm(block * k * PERIOD) @ [0, 0, 0, slope]
        expected.append(-(C @ state[:2] + D[:, 0] * state[2])[0])
    # some 40 periods of one exponential against one long one
    np.testing.assert_allclose(forces, expected, rtol=1e-10, atol=1e-12)


def test_any_reading_is_filtered_as_scipys_first_order_hold_does() -> None:
    readings = np.random.default_rng(4).normal(size=(60, 1, len(SENSORS)))
    readings[0] = 0.0  # the two start alike only from a reading of zero
    forces = run(one_sensor(RESONANT), readings)[:, 0, 0]
    discrete = signal.cont2discrete(RESONANT, PERIOD, method="foh")
    _, expected, _ = signal.dlsim(discrete, readings[:, 0, 0])
    np.testing.assert_allclose(forces, -expected[:, 0], rtol=1e-10, atol=1e-10)


def test_a_constant_reading_settles_at_the_laws_own_gain() -> None:
    A, B, C, D = RESONANT
    forces = run(one_sensor(RESONANT), np.ones((800, 1, len(SENSORS))))[:, 0]
    # exp(-4 * 8) of the start is left
    np.testing.assert_allclose(forces[-1, 0], (C @ np.linalg.solve(A, B) - D)[0, 0], rtol=1e-12)
    np.testing.assert_array_equal(forces[:, 1:], 0.0)


def test_actions_do_not_depend_on_the_number_of_lanes() -> None:
    controller = LinearDynamic(random_law(0), SENSORS, 4)
    readings = np.random.default_rng(1).normal(size=(20, 33, 136))
    together = run(controller, readings)
    alone = np.concatenate([run(controller, readings[:, k : k + 1]) for k in range(33)], axis=1)
    np.testing.assert_array_equal(together, alone)


def test_a_reset_forgets_the_past() -> None:
    controller = LinearDynamic(random_law(0), SENSORS, 4)
    readings = np.random.default_rng(1).normal(size=(20, 3, 136))
    np.testing.assert_array_equal(run(controller, readings), run(controller, readings))


def test_observations_are_not_changed_and_not_kept() -> None:
    controller = LinearDynamic(random_law(0), SENSORS, 4)
    controller.reset(2, 0)
    observations = np.ones((2, 136))
    first = controller.act(observations).copy()
    observations[:] = 7.0
    second = controller.act(np.ones((2, 136)))
    controller.reset(2, 0)
    np.testing.assert_array_equal(controller.act(np.ones((2, 136))), first)
    np.testing.assert_array_equal(controller.act(np.ones((2, 136))), second)


def test_a_law_without_states_is_linear_feedback_to_the_bit() -> None:
    gain = np.random.default_rng(0).normal(size=(4, 16))
    readings = np.random.default_rng(1).normal(size=(5, 3, 136))
    static = run(LinearFeedback(gain, SENSORS, 4), readings)
    np.testing.assert_array_equal(run(LinearDynamic(gain, SENSORS, 4), readings), static)


def test_another_number_of_lanes_than_at_the_reset_is_refused() -> None:
    controller = LinearDynamic(random_law(0), SENSORS, 4)
    with pytest.raises(ArgumentError, match=r"3 lanes.*reset"):
        controller.act(np.zeros((3, 136)))


def test_a_fast_filter_leaves_the_critical_delay_less_its_time_constant(
    vehicle: LateralVehicle,
) -> None:
    plain = critical_delays(SkyHook(35e3, 4).to_delay_system(vehicle)).critical_delay
    loop = LinearDynamic(low_pass(0.02), VELOCITIES, 4).to_delay_system(vehicle)
    assert loop.num_states == 38 + 4
    filtered = critical_delays(loop).critical_delay
    assert plain is not None
    assert filtered is not None
    # a first-order lag delays slow motion by its time constant
    assert plain - filtered == pytest.approx(0.02, abs=0.003)


def test_a_filter_and_an_actuators_lag_are_the_same_to_the_oracle(vehicle: LateralVehicle) -> None:
    filtered = LinearDynamic(low_pass(0.03), VELOCITIES, 4).to_delay_system(vehicle)
    lagged = SkyHook(35e3, 4).to_delay_system(vehicle, ActuatorSpec(lag=0.03))
    # the same product of transfer functions in another order
    assert [m.root for m in rightmost_roots(filtered, 0.15, 5)] == pytest.approx(
        [m.root for m in rightmost_roots(lagged, 0.15, 5)], rel=1e-9
    )


def test_a_low_pass_makes_accelerometer_feedback_retarded(vehicle: LateralVehicle) -> None:
    accelerometers = SENSORS[4:8]
    law = low_pass(0.05, gain=1e3)
    assert not LinearDynamic(law, accelerometers, 4).to_delay_system(vehicle).neutral
    straight = LinearDynamic(1e3 * np.eye(4), accelerometers, 4)
    assert straight.to_delay_system(vehicle).neutral
    assert not straight.to_delay_system(vehicle, ActuatorSpec(lag=0.05)).neutral


def test_python_controls_transfer_function_is_a_law(vehicle: LateralVehicle) -> None:
    table = [[[35e3] if i == j else [0.0] for j in range(4)] for i in range(4)]
    below = [[[0.02, 1.0] if i == j else [1.0] for j in range(4)] for i in range(4)]
    controller = LinearDynamic(control.tf(table, below), VELOCITIES, 4)
    loop = controller.to_delay_system(vehicle)
    own = LinearDynamic(low_pass(0.02), VELOCITIES, 4).to_delay_system(vehicle)
    assert critical_delays(loop).critical_delay == pytest.approx(
        critical_delays(own).critical_delay, rel=1e-10
    )


def sampled_map(vehicle: LateralVehicle, law, whole: int) -> np.ndarray:
    """One period of vehicle, hold, a delay of whole periods, and scipy's first-order hold."""
    plant = state_space(vehicle)
    C, _ = plant.output_rows(VELOCITIES)
    Phi, G = held_input(plant.A, plant.actuator_input, PERIOD)
    Ad, Bd, Cd, Dd, _ = signal.cont2discrete(law, PERIOD, method="foh")
    n, nc = len(Phi), len(Ad)
    step = np.zeros((n + nc + 4 * whole, n + nc + 4 * whole))
    step[:n, :n], step[:n, -4:] = Phi, G
    step[n : n + nc, :n], step[n : n + nc, n : n + nc] = Bd @ C, Ad
    pipe = n + nc
    step[pipe : pipe + 4, :n], step[pipe : pipe + 4, n:pipe] = -Dd @ C, -Cd
    step[pipe + 4 :, pipe:-4] = np.eye(4 * (whole - 1))
    return step


def test_the_simulated_loop_moves_as_an_independent_map_says(vehicle: LateralVehicle) -> None:
    law, whole = low_pass(0.05), 3
    controller = LinearDynamic(law, VELOCITIES, 4, control_period=PERIOD)
    names = state_space(vehicle).states
    stepping = Stepping(PERIOD, 0.005, ActuatorSpec(force_limit=None))
    batch = ControlledBatch(controller, vehicle, names, stepping)
    start = np.zeros(len(names))
    start[:17] = 1e-3 * np.random.default_rng(5).normal(size=17)  # at rest: readings are zero
    batch.reset(np.full((1, 4), whole * PERIOD), initial_state=start)
    step = sampled_map(vehicle, law, whole)
    lifted = np.zeros(len(step))
    lifted[: len(start)] = start
    moved, expected = [], []
    for _ in range(60):
        moved.append(batch.advance()[0, -1])
        lifted = step @ lifted
        expected.append(lifted[: len(start)])
    size = np.abs(expected).max(axis=0)
    # both are exact; 60 products of matrices with entries up to 1e5 leave a few thousand roundings
    np.testing.assert_allclose(np.array(moved) / size, np.array(expected) / size, atol=1e-9)


@pytest.mark.parametrize("time", [0.05, 0.2])
def test_the_sampled_law_acts_as_the_oracles_at_half_a_period_more_delay(
    vehicle: LateralVehicle, time: float
) -> None:
    law, whole = low_pass(time), 10
    z = np.linalg.eigvals(sampled_map(vehicle, law, whole))
    rates = np.log(z[np.abs(z) > 1e-6].astype(complex)) / PERIOD
    loop = LinearDynamic(law, VELOCITIES, 4).to_delay_system(vehicle)
    for mode in rightmost_roots(loop, (whole + 0.5) * PERIOD, 4):
        # the hold is half a period of delay; what is left is of the order of (|s| T)^2 / 24
        s = mode.root
        nearest = rates[np.argmin(np.abs(rates - s))]
        assert abs(nearest - s) < 0.2 * abs(s) * (abs(s) * PERIOD) ** 2 + 1e-9


@pytest.mark.parametrize(
    ("law", "sensors", "settings", "message"),
    [
        (np.ones((4, 2)), SENSORS[:1], {}, r"shape \(4, 2\); it must be \(4, 1\)"),
        (np.ones((4, 1)), ("carbody_rol_rate",), {}, "carbody_roll_rate"),
        (control.tf([1, 0], [1]), SENSORS[:1], {}, "law: .*improper"),
        (control.tf([1], [1, 1], 0.01), SENSORS[:1], {}, r"law: .*dt = 0\.01"),
        (np.ones((4, 1)), SENSORS[:1], {"control_period": 0.0}, "control_period = 0"),
        (np.ones((4, 1)), SENSORS[:1], {"action_scale": -1.0}, "action_scale = -1"),
        (
            (np.array([[1e6]]), np.ones((1, 1)), np.ones((4, 1)), np.ones((4, 1))),
            SENSORS[:1],
            {},
            "too fast to be stepped",
        ),
    ],
)
def test_a_law_that_does_not_fit_is_refused(law, sensors, settings, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        LinearDynamic(law, sensors, 4, **settings)


class TestFile:
    laws = (
        LinearFeedback(np.random.default_rng(7).normal(size=(4, 16)) / 3, SENSORS, 4, 450.1),
        LinearDynamic(random_law(2), SENSORS, 4, 451.3, 0.02),
        LinearDynamic(control.tf([1], [3, 1]) * np.ones((2, 1)), ("carbody_roll_rate",), 2),
        SkyHook(35e3, 2),
    )

    @pytest.mark.parametrize("controller", laws, ids=lambda c: type(c).__name__)
    def test_what_is_read_back_acts_bit_for_bit_like_what_was_saved(
        self, controller, tmp_path: Path
    ) -> None:
        path = tmp_path / "law.npz"
        save_policy(controller, path)
        again = load_policy(path)
        readings = np.random.default_rng(1).normal(size=(9, 3, 136))
        np.testing.assert_array_equal(run(again, readings), run(controller, readings))
        assert (again.layout, again.sensors) == (controller.layout, controller.sensors)
        assert again.action_scale == controller.action_scale
        if isinstance(controller, LinearDynamic):
            assert isinstance(again, LinearDynamic)
            assert again.control_period == controller.control_period

    def test_a_path_is_a_spec_and_brings_its_layout(self, tmp_path: Path) -> None:
        path = tmp_path / "law.npz"
        save_policy(SkyHook(20e3, 2), path)
        controller = make_controller(str(path), 4)
        assert isinstance(controller, LinearFeedback)
        assert controller.layout == "2"
        np.testing.assert_array_equal(controller.gain, 20e3 * np.eye(2))

    def test_the_same_policy_is_the_same_file(self, tmp_path: Path) -> None:
        for name in ("a.npz", "b.npz"):
            save_policy(self.laws[1], tmp_path / name)
        assert (tmp_path / "a.npz").read_bytes() == (tmp_path / "b.npz").read_bytes()

    def test_a_law_with_a_method_of_its_own_is_not_saved_as_another(self, tmp_path: Path) -> None:
        class Cubed(SkyHook):
            def act(self, observations):
                return super().act(observations) ** 3

        with pytest.raises(ArgumentError, match="Cubed is no linear law"):
            save_policy(Cubed(35e3, 4), tmp_path / "law.npz")
        with pytest.raises(ArgumentError, match="object is no linear law"):
            save_policy(object(), tmp_path / "law.npz")  # type: ignore[arg-type]
        assert list(tmp_path.iterdir()) == []

    def test_a_wrong_ending_and_a_wrong_place_are_refused(self, tmp_path: Path) -> None:
        with pytest.raises(ArgumentError, match=r"must end in \.npz"):
            save_policy(self.laws[0], tmp_path / "law.bin")
        with pytest.raises(OutputError, match="cannot write"):
            save_policy(self.laws[0], tmp_path / "missing" / "law.npz")

    @pytest.mark.parametrize(
        ("change", "message"),
        [
            ({"format": "other"}, "no saved policy"),
            ({"version": 2}, "version 2; this railenv reads version 1"),
            ({"version": True}, "version True"),
            ({"kind": "neural"}, "kind 'neural'; known: linear_feedback"),
            ({"kind": ["linear_feedback"]}, "kind"),
            ({"kind": "linear_dynamic"}, "metadata of a linear_dynamic are"),
            ({"extra": 1}, "extra"),
            ({"sensors": "carbody"}, "no list of names"),
            ({"sensors": ["nothing"] * 16}, "unknown sensor 'nothing'"),
            ({"layout": 3}, "choose passive, 2 or 4"),
            ({"layout": ["4"]}, "layout"),
            ({"action_scale": "big"}, "action_scale = 'big'"),
            ({"action_scale": float("nan")}, "action_scale = nan"),
            ({"gain": np.ones((4, 3))}, r"shape \(4, 3\); it must be \(4, 16\)"),
            ({"gain": np.full((4, 16), np.nan)}, "not finite"),
            ({"gain": np.array(["a"])}, "holds text"),
            ({"gain": np.ones((4, 16), complex)}, "complex128 values"),
            ({"gain": np.full((4, 16), 2**53 + 1)}, "double precision"),
            ({"other": np.ones(3)}, "arrays of a linear_feedback are gain"),
            ({"metadata": np.array("{")}, "no JSON"),
            ({"metadata": np.array("[" * 100_000)}, "no JSON"),
            ({"metadata": np.array("[]")}, "no saved policy"),
            ({"metadata": np.ones(2)}, "no text 'metadata'"),
        ],
        ids=str,
    )
    def test_a_file_with_something_else_in_it_is_refused(
        self, tmp_path: Path, change: dict, message: str
    ) -> None:
        path = tmp_path / "law.npz"
        save_policy(self.laws[0], path)
        with np.load(path) as archive:
            contents = dict(archive)
        metadata = json.loads(str(contents["metadata"]))
        for key, value in change.items():
            (contents if isinstance(value, np.ndarray) else metadata)[key] = value
        if "metadata" not in change:
            contents["metadata"] = np.array(json.dumps(metadata))
        np.savez(path, **contents)
        with pytest.raises(InputFileError, match=message) as caught:
            load_policy(path)
        assert "law.npz" in str(caught.value)

    def test_a_pickle_is_never_opened(self, tmp_path: Path) -> None:
        class Trap:
            def __reduce__(self):
                return os.mkdir, (str(tmp_path / "sprung"),)

        path = tmp_path / "law.npz"
        np.savez(path, metadata=np.array([Trap()], dtype=object))
        with pytest.raises(InputFileError, match="object values"):
            load_policy(path)
        stream = io.BytesIO()
        np.save(stream, np.array([Trap()], dtype=object), allow_pickle=True)
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("metadata.npy", stream.getvalue())
        with pytest.raises(InputFileError, match="object values"):
            load_policy(path)
        assert not (tmp_path / "sprung").exists()

    def test_the_oracle_answers_a_saved_policy_on_the_command_line(
        self, tmp_path: Path, capsys: pytest.CaptureFixture[str]
    ) -> None:
        from eval.cli import main

        path = tmp_path / "law.npz"
        save_policy(LinearDynamic(low_pass(0.02), VELOCITIES, 4), path)
        arguments = ["critical-delay", "--controller", str(path), "--max-delay", "0.3", "--json"]
        assert main(arguments) == 0
        found = json.loads(capsys.readouterr().out)
        assert found["critical_delay_s"] == pytest.approx(0.182, abs=0.003)
        assert found["mode"] == "upper centre roll"


def test_a_law_that_is_unstable_by_itself_stays_finite_and_spares_its_neighbours() -> None:
    growing = (np.eye(1) * 2.0, np.ones((1, 1)), np.ones((4, 1)), np.zeros((4, 1)))
    law = LinearDynamic(growing, SENSORS[:1], 4, sampled=True)
    readings = np.zeros((2, len(SENSORS)))
    readings[0, 0] = 1.0
    law.reset(2, 0)
    for _ in range(2000):
        actions = law.act(readings)
    # 2^2000 is no double; the lane stopped where its command had left every limit behind.
    assert np.all(np.isfinite(actions))
    assert np.all(np.abs(actions[0]) > 1e90)
    assert np.all(actions[1] == 0.0)
