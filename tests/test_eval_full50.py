"""The 50-coordinate vehicle in the commands: one face for both vehicles, critical delay, safety."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.linalg import expm

from baselines import SkyHook, Zero
from eval import full50_delay
from eval.cli import main
from eval.delay_sweep import simulated_critical_delay
from eval.full50_linear import linear_loop, linear_plant
from eval.full50_probe import FullProbe, Hunting, _hunting
from eval.full50_safety import VERTICAL, SafetyWatch
from eval.rollout import ACCELERATIONS, ControlledBatch, Stepping, rollout
from eval.simulations import FullRuns, LinearRuns, simulation_of
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError
from railenv.simulation import LateralSimulation, wheelset_inputs
from railenv.stability import CriticalDelays, DelaySystem, critical_delays
from railenv.track import make_track
from railenv.vehicle import LateralVehicle, mode_name
from railenv.vehicle.coordinates import COORDINATES
from railenv.vehicle.nonlinear import ContactSettings, FullVehicle, full50

STEP = {"actuator": ActuatorSpec(), "control_period": 0.01, "time_step": 0.005}
LIKE_LINEAR = full50_delay.VARIANTS[-2]
"""Cone on a narrow head, given creep, no roll, no gravity coupling: the linear vehicle's like."""


@pytest.fixture(scope="module")
def full() -> FullVehicle:
    return full50("paper_fit", 4, 300.0)


@pytest.fixture(scope="module")
def alike() -> FullVehicle:
    return LIKE_LINEAR.made()


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = main(list(arguments))
    captured = capsys.readouterr()
    return status, captured.out, captured.err


# One face for both vehicles.


def test_a_track_and_a_level_give_the_linear_vehicle_the_inputs_it_always_had(
    vehicle: LateralVehicle,
) -> None:
    track, delays = make_track("tb3352", vehicle.speed * 1.0, 1), np.zeros((2, 4))
    level = np.array([1.0, 0.3])
    here = simulation_of(vehicle, ACCELERATIONS, **STEP)
    here.begin(delays, (track,), level=level)
    there = LateralSimulation(vehicle, ACCELERATIONS, control_period=0.01, time_step=0.005)
    sampled = wheelset_inputs(vehicle, track, 0.005, 200)
    there.reset(delays, level[:, None, None] * sampled, np.arange(2))
    command = np.full((2, 4), 100.0)
    for _ in range(100):
        assert np.array_equal(here.advance(command), there.advance(command))


def test_a_linear_run_of_a_track_lasts_as_long_as_the_track(vehicle: LateralVehicle) -> None:
    # 0.48 s of 83.3 m/s: the length divided by the step is a hair below a whole number
    track = make_track("flat", vehicle.speed * 0.48, 1)
    here = simulation_of(vehicle, ACCELERATIONS, **STEP)
    here.begin(np.zeros((1, 4)), (track,))
    for _ in range(48):
        here.advance(np.zeros((1, 4)))
    with pytest.raises(ArgumentError, match="the track ends"):
        here.advance(np.zeros((1, 4)))


def test_each_vehicle_gets_its_own_simulation(vehicle: LateralVehicle, full: FullVehicle) -> None:
    assert isinstance(simulation_of(vehicle, ACCELERATIONS, **STEP), LinearRuns)
    assert isinstance(simulation_of(full, ACCELERATIONS, **STEP), FullRuns)


def test_the_nonlinear_vehicle_takes_over_the_actuators_lag(full: FullVehicle) -> None:
    made = simulation_of(full, ACCELERATIONS, **{**STEP, "actuator": ActuatorSpec(lag=0.02)})
    assert made.vehicle.actuator_lag == 0.02


def test_a_slow_vehicle_is_stepped_finely_enough(full: FullVehicle) -> None:
    # At 20 km/h creep damps the wheels' rotation at 10^4 1/s; steps of 0.5 ms would be refused.
    slow = full.replace(speed=20.0 / 3.6)
    made = simulation_of(slow, ACCELERATIONS, **STEP)
    made.begin(np.zeros((1, 4)))
    assert np.abs(made.advance(np.zeros((1, 4)))).max() < 1e-6


def test_the_lateral_coordinates_are_those_of_the_linear_model(full: FullVehicle) -> None:
    made = simulation_of(full, COORDINATES, **STEP)
    made.begin(np.zeros((1, 4)), (make_track("tb3352", full.speed, 1),))
    outputs = [made.advance(np.full((1, 4), 1e3)) for _ in range(20)][-1]
    assert np.array_equal(made.lateral[0], outputs[0, -1])


@pytest.mark.parametrize("lanes", [1, 2, 5])
def test_threads_change_nothing(full: FullVehicle, lanes: int) -> None:
    track = make_track("tb3352", full.speed * 1.0, 1)
    runs = []
    for threads in (1, 3):
        made = FullRuns(full, ACCELERATIONS, record_step=0.005, threads=threads)
        made.begin(np.tile(np.linspace(0.0, 0.02, lanes)[:, None], 4), (track,))
        command = 1e3 * np.ones((lanes, 4))
        runs.append(np.concatenate([made.advance(command) for _ in range(10)], axis=1))
    assert np.array_equal(*runs)


def test_a_second_run_of_the_same_lanes_forgets_the_first(full: FullVehicle) -> None:
    track = make_track("tb3352", full.speed * 1.0, 1)
    made = simulation_of(full, ACCELERATIONS, **STEP)
    runs = []
    for level in (np.array([0.2]), np.array([0.7]), np.array([0.2])):
        made.begin(np.full((1, 4), 0.013), (track,), level=level)
        runs.append([made.advance(np.full((1, 4), 500.0)) for _ in range(10)])
    assert np.array_equal(runs[0], runs[2])
    assert not np.array_equal(runs[0], runs[1])


def test_sampled_inputs_are_for_the_linear_vehicle(full: FullVehicle) -> None:
    with pytest.raises(ArgumentError, match="give tracks"):
        rollout(Zero(4), full, np.zeros((1, 4)), 0.1, track_inputs=np.zeros((1, 30, 8)))


def test_a_derailed_vehicle_ends_in_nan(full: FullVehicle) -> None:
    batch = ControlledBatch(Zero(4), full, ACCELERATIONS, Stepping())
    state = np.zeros(full.num_states)
    state[full.states.index("wheelset1_lateral")] = 0.03
    batch.reset(np.zeros((1, 4)), initial_state=state)
    outputs = batch.advance()
    assert batch.simulation.derailed[0]
    assert np.all(np.isnan(outputs))


def test_a_silent_lane_gets_no_force(full: FullVehicle) -> None:
    track = make_track("tb3352", full.speed * 1.0, 1)
    runs = []
    for controller, silent in ((SkyHook(35e3, 4), np.array([True])), (Zero(4), None)):
        batch = ControlledBatch(controller, full, ACCELERATIONS, Stepping())
        batch.silent = silent
        batch.reset(np.zeros((1, 4)), (track,))
        runs.append(np.concatenate([batch.advance() for _ in range(50)], axis=1))
    assert np.array_equal(*runs)


# The linearised vehicle before the oracle.


@pytest.fixture(scope="module")
def found(alike: FullVehicle) -> CriticalDelays:
    return critical_delays(linear_loop(SkyHook(35e3, 4), alike), 0.21)


@pytest.mark.slow
def test_without_its_nonlinearities_the_vehicle_has_the_linear_models_critical_delay(
    found: CriticalDelays, loop: DelaySystem
) -> None:
    known = critical_delays(loop, 0.21)
    # 202.05 against 202.03 ms: vertical motion and creep's spin terms make the difference
    assert found.critical_delay == pytest.approx(known.critical_delay, abs=1e-4)
    assert found.first.frequency_hz == pytest.approx(known.first.frequency_hz, rel=1e-3)


def test_the_linear_plant_has_its_states_in_the_lateral_models_order(
    found: CriticalDelays, vehicle: LateralVehicle
) -> None:
    mode = found.first.mode
    assert mode_name(vehicle, mode.root, mode.shape) == "upper centre roll"


def test_sensors_of_the_linear_plant_are_those_of_the_simulation(alike: FullVehicle) -> None:
    sensors = (
        "carbody_lateral_velocity_1",
        "carbody_lateral_acceleration_2",
        "suspension_stroke_3",
    )
    plant = linear_plant(alike, sensors)
    made = simulation_of(alike, sensors, **STEP)
    made.begin(np.zeros((1, 4)))
    command = np.array([[10.0, -5.0, 0.0, 2.0]])
    outputs = made.advance(command)[0]
    # x(t) for a constant force from rest, by the matrix exponential of the augmented system
    n, m = plant.B.shape
    whole = np.zeros((n + m, n + m))
    whole[:n, :n], whole[:n, n:] = plant.A, plant.B
    state = (expm(0.01 * whole) @ np.r_[np.zeros(n), command[0]])[:n]
    expected = plant.C @ state + plant.D @ command[0]
    # Motion is microscopic, so the difference is that of the contact table's curvature: < 1e-4
    assert outputs[-1] == pytest.approx(expected, rel=1e-3, abs=1e-3 * np.abs(expected).min())


def test_only_static_feedback_is_closed_around_the_linearised_vehicle(full: FullVehicle) -> None:
    with pytest.raises(ArgumentError, match="--method simulation"):
        linear_loop(object(), full)
    with pytest.raises(ArgumentError, match="layout"):
        linear_loop(SkyHook(35e3, 2), full)


# Hunting apart, the carbody's motion is judged.

TIME = np.arange(12000).reshape(12, 1000) * 0.005


def signals(floor: np.ndarray, bogie: np.ndarray) -> np.ndarray:
    return np.stack([floor, floor, bogie, bogie], axis=2)


def test_a_bogie_that_goes_on_at_5_hz_hunts() -> None:
    own = 0.02 * np.sin(2 * np.pi * 4.9 * TIME)
    sway = 0.2 * np.exp(-0.02 * TIME) * np.sin(2 * np.pi * 0.5 * TIME)
    found = _hunting(signals(own + sway, 50 * own), 0.005)
    # lines of a 20 s record are 0.05 Hz apart
    assert found.frequency == pytest.approx(4.9, abs=0.05)
    assert found.floor == pytest.approx(0.02 / np.sqrt(2), rel=0.05)


@pytest.mark.parametrize(
    "bogie",
    [
        np.exp(-0.3 * TIME) * np.sin(2 * np.pi * 5.0 * TIME),
        np.sin(2 * np.pi * 0.6 * TIME),
        np.full_like(TIME, np.nan),
    ],
)
def test_what_fades_or_follows_the_carbody_or_derails_is_no_hunting(bogie: np.ndarray) -> None:
    assert _hunting(signals(bogie, bogie), 0.005).frequency == 0.0


class Motion:
    """Stands for the batch: floor accelerations as given, one lane each, a window per call."""

    def __init__(self, lanes: list[tuple[float, float, float]]) -> None:
        self.lanes, self.windows = lanes, 0
        self.commands = np.zeros((len(lanes), 4))
        self.simulation = self
        self.num_lanes = len(lanes)

    def stop(self, lanes: np.ndarray) -> None:
        pass

    def advance(self) -> np.ndarray:
        time = 5.0 * self.windows + 0.005 * np.arange(1, 1001)
        self.windows += 1
        values = [
            first * np.exp(rate * time) * np.sin(8.3 * time) + own * np.sin(2 * np.pi * 4.9 * time)
            for first, rate, own in self.lanes
        ]
        return np.repeat(np.array(values)[:, :, None], 4, axis=2)


def judged(
    monkeypatch: pytest.MonkeyPatch, full: FullVehicle, own: float, lanes: list[tuple]
) -> list[bool]:
    probe = FullProbe(SkyHook(35e3, 4), full, Stepping(), "tb3352", 0)
    probe._hunting = Hunting(4.9 if own else 0.0, own, 50 * own)
    monkeypatch.setattr(probe, "_excite", lambda delays: None)
    monkeypatch.setattr(probe, "_batch", Motion(lanes))
    monkeypatch.setattr(probe, "_window", 1)
    return probe.stable(np.zeros(len(lanes))).tolist()


def test_hunting_is_not_taken_for_the_controllers_instability(monkeypatch, full) -> None:
    lanes = [(0.05, -0.05, 0.02), (0.05, -0.003, 0.02), (0.05, 0.003, 0.02), (0.05, 0.1, 0.02)]
    assert judged(monkeypatch, full, 0.02 / np.sqrt(2), lanes) == [True, True, False, False]


def test_hunting_that_the_controller_makes_much_worse_is_unstable(monkeypatch, full) -> None:
    lanes = [(0.05, -0.05, 0.02), (0.05, -0.05, 0.05)]
    assert judged(monkeypatch, full, 0.02 / np.sqrt(2), lanes) == [True, False]


def test_without_hunting_a_limit_cycle_is_unstable(monkeypatch, full) -> None:
    lanes = [(0.05, -0.05, 0.0), (0.05, -0.05, 0.02)]
    assert judged(monkeypatch, full, 0.0, lanes) == [True, False]


@pytest.mark.slow
def test_the_time_domain_finds_the_linearised_vehicles_critical_delay(alike: FullVehicle) -> None:
    probe = FullProbe(SkyHook(35e3, 4), alike, LIKE_LINEAR.stepping(), "tb3352", 0)
    # Linearised and held for 10 ms: 197.08 ms
    assert probe.stable(np.array([0.1965, 0.1976])).tolist() == [True, False]


@pytest.mark.slow
def test_the_paper_s_loop_becomes_unstable_within_some_per_cent_of_197_ms(full) -> None:
    answer = simulated_critical_delay(SkyHook(35e3, 4), full, max_delay=0.22, resolution=0.002)
    assert answer["critical_delay_sampled_s"] == pytest.approx(0.197, rel=0.04)
    assert answer["mode"] == "upper centre roll"


# Commands.

SHORT = ("simulate", "--model", "full50", "--seconds", "5", "--controller", "skyhook:gain=35e3")


def test_a_run_on_wheels_and_rails_says_how_safe_it_was(capsys, tmp_path: Path) -> None:
    out = str(tmp_path / "run.npz")
    status, text, _ = run(capsys, *SHORT, "--out", out, "--json")
    found = json.loads(text)
    safety = found["safety"]
    assert status == 0
    assert not safety["derailed"]
    assert 0.0 < safety["derailment_quotient"] < 0.8  # the limit of EN 14363
    assert 0.0 < safety["wheel_unloading"] < 1.0
    assert 0.0 < safety["wheelset_shift"] < 0.01
    assert safety["ride_index_vertical_front"] > 0.0
    assert (found["settings"]["model"], found["settings"]["wheel"]) == ("full50", "s1002cn")
    assert set(VERTICAL) <= set(np.load(out).files)


@pytest.mark.slow
@pytest.mark.parametrize(("option", "name"), [("--plot", "run.png"), ("--video", "run.mp4")])
def test_a_run_is_drawn(capsys, tmp_path: Path, option: str, name: str) -> None:
    assert run(capsys, *SHORT, option, str(tmp_path / name))[0] == 0
    assert (tmp_path / name).stat().st_size > 10_000


def test_a_derailment_is_a_result(capsys) -> None:
    # heights 30 times those of a line fit for this speed
    status, text, _ = run(capsys, *SHORT, "--track", "tb3352:level=1000")
    assert status == 0
    assert "DERAILED after" in text


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("--model", "full"), "unknown model"),
        (("--model", "full50", "--wheel", "s1003"), "s1002"),
        (("--model", "full50", "--rail", "s1002"), "wheel profile"),
        (("--model", "full50", "--friction", "-0.1"), "friction"),
        (("--model", "full50", "--creep-law", "polac"), "polach"),
        (("--wheel", "lma"), "give --model full50"),
    ],
)
@pytest.mark.parametrize("command", ["simulate", "critical-delay"])
def test_a_mistake_about_wheel_and_rail_is_one_line(
    capsys, command: str, arguments: tuple[str, ...], message: str
) -> None:
    status, out, error = run(capsys, command, "--controller", "skyhook", *arguments)
    assert (status, out) == (2, "")
    assert message in error
    assert error.count("\n") == 1


def test_models_are_listed(capsys) -> None:
    assert set(json.loads(run(capsys, "list", "models", "--json")[1])["models"]) == {
        "lateral17",
        "full50",
    }


@pytest.mark.slow
def test_the_linearised_vehicles_crossings_are_printed_with_their_modes(capsys) -> None:
    arguments = ("--controller", "skyhook:gain=35e3", "--model", "full50", "--max-delay", "0.3")
    status, text, _ = run(capsys, "critical-delay", *arguments, "--json")
    crossings = json.loads(text)["crossings"]
    assert status == 0
    assert crossings[0]["mode"] == "upper centre roll"
    # gravity, real profiles and the wheelset's roll move 202 ms by some milliseconds
    assert crossings[0]["delay_s"] == pytest.approx(0.202, abs=0.006)


def test_safety_is_the_worst_wheel_of_the_run(full: FullVehicle) -> None:
    class Told(FullRuns):
        told = np.zeros((1, 8, 5))

        @property
        def wheels(self) -> np.ndarray:
            return self.told

    batch = ControlledBatch(Zero(4), full, ACCELERATIONS, Stepping())
    batch.simulation = Told(full, ACCELERATIONS, record_step=0.005)
    load = full.parameters.lateral.axle_load / 2
    told = batch.simulation.told
    told[0, :, 0] = load
    watch = SafetyWatch(full)
    told[0, 3, :2], told[0, 2, :2] = (0.8 * load, 0.2 * load), (load, -0.1 * load)
    told[0, 5, 0], told[0, 5, 1] = 0.0, 5.0  # in the air: no quotient, all load gone
    told[0, 6, 4] = -0.004
    watch.watch(batch, np.zeros((1, 2, 4)))
    assert watch.derailment_quotient == pytest.approx(0.25)
    assert watch.wheel_unloading == pytest.approx(1.0)
    assert watch.guiding_force == pytest.approx(0.3 * load)
    assert watch.wheelset_shift == 0.004
    assert watch.derailed_at is None


def test_the_table_of_effects_names_a_line_that_does_not_exist(capsys) -> None:
    with pytest.raises(SystemExit, match="2"):
        full50_delay.main(["--only", "blow-off"])
    assert "no blow-off" in capsys.readouterr().err


def test_an_answer_becomes_a_line() -> None:
    line = full50_delay.row(
        {
            "name": "everything on",
            "continuous_s": 0.19816,
            "sampled_s": 0.19319,
            "hunts_linearly": True,
            "bracket_s": (0.19119, 0.19144),
            "frequency_hz": 1.356,
            "hunting_hz": 4.9,
        }
    )
    expected = "everything on 198.16 ~193.19 191.32 +- 0.13 1.356 4.9 Hz"
    assert " ".join(line.replace("~ ", "~").split()) == expected


def test_contact_settings_reach_the_vehicle() -> None:
    changed = full50("paper_fit", 4, 300.0, ContactSettings(friction=0.1, law="polach"))
    assert changed.arrays.scalars[4] == 0.1
