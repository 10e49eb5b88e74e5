"""Noise of the sensors in runs: its size, its streams, and what it does to a loop."""

import json
from typing import Any

import numpy as np
import pytest
from scipy.linalg import solve_discrete_lyapunov

from baselines import SkyHook
from eval.cli import main
from eval.rollout import Stepping, rollout
from eval.sensor_noise import usual_reading
from railenv.actuation import held_input
from railenv.envs.noise import AHEAD
from railenv.envs.observation import bound, sensor_names
from railenv.errors import ArgumentError
from railenv.simulation.full_outputs import output_names
from railenv.track import make_track
from railenv.vehicle import LateralVehicle, lateral17, state_space
from railenv.vehicle.nonlinear import full50

SHARE = 0.1
SIGMAS = 5.0
"""Statistics may be off by so many of their own standard deviations; all seeds are fixed."""


class Listener:
    """Commands nothing and notes what it is shown."""

    def __init__(self, measures: tuple[str, ...] | None = None) -> None:
        self.seen: list[np.ndarray] = []
        if measures is not None:
            self.measures = measures

    def reset(self, num_lanes: int, seed: int) -> None:
        pass

    def act(self, observations: np.ndarray) -> np.ndarray:
        self.seen.append(observations.copy())
        return np.zeros((len(observations), 4))


def heard(
    vehicle: LateralVehicle,
    lanes: int,
    periods: int,
    share: float = SHARE,
    measures: tuple[str, ...] | None = None,
    seed: int = 0,
) -> np.ndarray:
    """What a controller reads at rest on flat track: noise; (periods, lanes, columns)."""
    listener = Listener(measures)
    stepping = Stepping(max_delay=0.0, sensor_noise=share)
    delays = np.zeros((lanes, 4))
    rollout(listener, vehicle, delays, 0.01 * periods, stepping=stepping, seed=seed)
    return np.array(listener.seen)


@pytest.fixture(scope="module")
def noise(vehicle: LateralVehicle) -> np.ndarray:
    """Noise in units of its standard deviation."""
    usual = np.array([bound(name)[2] for name in sensor_names("4")])
    return heard(vehicle, 16, 600) / (SHARE * usual)


def test_every_sensor_has_its_share_of_the_controlled_response(noise: np.ndarray) -> None:
    count = noise[..., 0].size
    # times n it is chi-square of n degrees of freedom: its standard deviation is sqrt(2 / n)
    ratio = (noise**2).mean(axis=(0, 1))
    assert np.abs(ratio - 1.0).max() < SIGMAS * np.sqrt(2.0 / count)
    assert np.abs(noise.mean(axis=(0, 1))).max() < SIGMAS / np.sqrt(count)


@pytest.mark.parametrize("lag", [1, AHEAD, 2 * AHEAD])
def test_noise_is_white(noise: np.ndarray, lag: int) -> None:
    products = noise[lag:] * noise[:-lag]
    assert np.abs(products.mean(axis=(0, 1))).max() < SIGMAS / np.sqrt(products[..., 0].size)


@pytest.mark.parametrize("axis", [1, 2], ids=["lanes", "columns"])
def test_lanes_and_columns_are_independent(noise: np.ndarray, axis: int) -> None:
    samples = np.moveaxis(noise, axis, 0).reshape(noise.shape[axis], -1)
    products = samples @ samples.T / samples.shape[1]
    apart = products - np.diag(np.diag(products))
    assert np.abs(apart).max() < SIGMAS / np.sqrt(samples.shape[1])


def test_a_lanes_noise_does_not_depend_on_how_many_lanes_there_are(
    vehicle: LateralVehicle,
) -> None:
    one, many = heard(vehicle, 1, 150), heard(vehicle, 5, 150)
    np.testing.assert_array_equal(one[:, 0], many[:, 0])
    np.testing.assert_array_equal(heard(vehicle, 2, 150)[:, 1], many[:, 1])


def test_another_seed_is_other_noise_and_the_same_seed_the_same(vehicle: LateralVehicle) -> None:
    first, again, other = (heard(vehicle, 1, 20, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert not np.any(first == other)


def test_without_noise_the_controller_reads_the_true_values(vehicle: LateralVehicle) -> None:
    assert not np.any(heard(vehicle, 2, 80, share=0.0))


def test_what_is_recorded_is_the_true_motion(vehicle: LateralVehicle) -> None:
    record, stepping = sensor_names("4"), Stepping(sensor_noise=SHARE)
    run = rollout(Listener(), vehicle, np.zeros((1, 4)), 0.5, record=record, stepping=stepping)
    assert not np.any(run.values)


def test_states_are_noisy_and_forces_are_not(vehicle: LateralVehicle) -> None:
    states = state_space(vehicle).states
    found = heard(vehicle, 8, 300, measures=(*states, "actuator_force_1"))
    usual = np.array([bound(name)[2] for name in states])
    ratio = (found[..., :-1] ** 2).mean(axis=(0, 1)) / (SHARE * usual) ** 2
    assert np.abs(ratio - 1.0).max() < SIGMAS * np.sqrt(2.0 / (8 * 300))
    assert not np.any(found[..., -1])


@pytest.mark.parametrize("layout", ["passive", 2, 4])
def test_every_motion_of_the_linear_vehicle_can_be_noisy(layout: Any) -> None:
    system = state_space(lateral17("paper_fit", layout, 300.0))
    for name in (*system.outputs, *system.states, *system.inputs):
        quiet = name.endswith("_force") or name.startswith(("actuator", "alignment", "track_roll"))
        assert (usual_reading(name) == 0.0) == quiet, name


def test_every_state_of_the_nonlinear_vehicle_can_be_noisy() -> None:
    vehicle = full50("paper_fit", 4, 300.0)
    assert all(usual_reading(name) >= 0.0 for name in output_names(vehicle))
    moving = [name for name in vehicle.states if not name.startswith("actuator_force")]
    assert all(usual_reading(name) > 0.0 for name in moving)


def test_readings_beyond_the_observation_have_their_controlled_response(
    vehicle: LateralVehicle,
) -> None:
    rates = tuple(f"bogie{j}_{motion}_rate" for j in (1, 2) for motion in ("roll", "yaw"))
    names = (*rates, "carbody_roll_acceleration", "carbody_yaw_acceleration")
    tracks = [make_track("german_low", vehicle.speed * 32.0, seed) for seed in range(4)]
    run = rollout(
        SkyHook(10e3, 4),
        vehicle,
        np.zeros((4, 4)),
        30.0,
        tracks=tracks,
        track_of_lane=np.arange(4),
        record=names,
    )
    # the start at rest is over after 3 s; scales are rounded
    rms = np.sqrt((run.values[:, 600:] ** 2).mean(axis=(0, 1)))
    ratio = rms / [usual_reading(name) for name in names]
    assert np.all((ratio > 0.7) & (ratio < 1.4))


def test_a_loop_answers_noise_as_the_lyapunov_equation_says(vehicle: LateralVehicle) -> None:
    gain, period, lanes = 35e3, 0.01, 64
    system = state_space(vehicle)
    velocities = tuple(f"carbody_lateral_velocity_{k}" for k in (1, 2, 3, 4))
    C, _ = system.output_rows(velocities)
    # x at the measurements: x+ = F x + G u with u = -gain (C x + noise), held for a period
    F, G = held_input(system.A, system.actuator_input, period)
    deviation = SHARE * bound(velocities[0])[2]
    spread = solve_discrete_lyapunov(F - gain * G @ C, (gain * deviation) ** 2 * G @ G.T)
    run = rollout(
        SkyHook(gain, 4),
        vehicle,
        np.zeros((lanes, 4)),
        40.0,
        record=velocities,
        stepping=Stepping(sensor_noise=SHARE),
    )
    # after 10 s, at the ends of the periods (every second record)
    found = (run.values[:, 2001::2] ** 2).mean(axis=(0, 1))
    # The velocity forgets itself within some 1 s, a body period: 64 lanes of 30 s are some 2000
    # independent squares, whose mean is within sqrt(2 / 2000) of the variance.
    expected = np.diag(C @ spread @ C.T)
    np.testing.assert_allclose(found, expected, rtol=SIGMAS * np.sqrt(2.0 / 2000))


@pytest.mark.parametrize(
    ("share", "seed", "message"),
    [(-0.1, 0, "sensor_noise"), (np.nan, 0, "sensor_noise"), (0.1, -1, "seed")],
)
def test_impossible_noise_is_refused_by_name(
    vehicle: LateralVehicle, share: float, seed: int, message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        heard(vehicle, 1, 1, share=share, seed=seed)


RUN = ("simulate", "--controller", "skyhook:gain=35e3", "--track", "flat", "--seconds", "10")


def test_simulate_takes_the_noise_and_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert main([*RUN, "--sensor-noise", "0.1", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert answer["settings"]["sensor_noise"] == 0.1
    # On flat track all force answers noise. A command is -gain times the noise of a measurement,
    # 70 N, and little else: the carbody does not follow a single one.
    assert answer["measures"]["force_rms"] == pytest.approx(35e3 * 0.1 * 0.02, rel=0.1)


@pytest.mark.parametrize("text", ["-0.1", "nan", "much", "inf"])
def test_simulate_refuses_impossible_noise(capsys: pytest.CaptureFixture[str], text: str) -> None:
    assert main([*RUN, f"--sensor-noise={text}"]) == 2
    assert "sensor" in capsys.readouterr().err
