"""The vehicle against the numbers of `reference/lateral17.toml`: published, agreed and frozen."""

import tomllib
from functools import cache
from pathlib import Path

import numpy as np
import pytest

from baselines.skyhook import SkyHook
from railenv.stability import (
    Crossing,
    DelaySystem,
    Mode,
    critical_delays,
    rightmost_roots,
)
from railenv.stability.modes import modes_of_matrix
from railenv.vehicle import LateralVehicle, get_vehicle, lateral17, mode_name, state_space
from railenv.vehicle.coordinates import COORDINATES, lateral_of_point
from railenv.vehicle.modes import energy_shares, phase_degrees

REFERENCE = tomllib.loads(
    (Path(__file__).parent / "reference" / "lateral17.toml").read_text(encoding="utf-8")
)
NUMBERS = {entry["name"]: entry for entry in REFERENCE["number"]}
PAPER = get_vehicle("paper_fit").parameters
GAIN = 35e3


def modes_of(vehicle: LateralVehicle) -> list[Mode]:
    A = state_space(vehicle).A
    return modes_of_matrix(A, A.shape[0])


@cache
def named(layout: str, name: str) -> Mode:
    """The vehicle's mode of that name, without feedback."""
    vehicle = lateral17(layout=layout)
    found = [m for m in modes_of(vehicle) if mode_name(vehicle, m.root, m.shape) == name]
    assert len(found) == 1
    return found[0]


@cache
def critical_speed(conicity: float, creep_longitudinal: float = 1.05e7) -> float:
    """Speed at which the passive vehicle starts to hunt, by bisection to 0.05 km/h [km/h]."""
    parameters = PAPER.replace(conicity=conicity, creep_longitudinal=creep_longitudinal)
    stable, unstable = 200.0, 700.0
    while unstable - stable > 0.05:
        middle = (stable + unstable) / 2
        roots = np.linalg.eigvals(state_space(lateral17(parameters, "passive", middle)).A)
        stable, unstable = (stable, middle) if roots.real.max() > 0.0 else (middle, unstable)
    return stable


@cache
def crossings(sensor: str) -> tuple[Crossing, ...]:
    vehicle = lateral17()
    if sensor == "damper":
        loop = SkyHook(GAIN, 4).to_delay_system(vehicle)
    else:
        system = state_space(vehicle)
        K = np.zeros((4, len(system.states)))
        for channel, sign in enumerate((1, 1, -1, -1)):
            place = sign * PAPER.half_bogie_spacing
            row = lateral_of_point("carbody", place, PAPER.carbody_to_damper_height)
            K[channel, 17:34] = GAIN * row
        loop = DelaySystem(system.A, system.actuator_input, K)
    return critical_delays(loop, 0.25).crossings


@cache
def rightmost(delay_ms: float) -> list[Mode]:
    loop = SkyHook(GAIN, 4).to_delay_system(lateral17())
    return rightmost_roots(loop, delay_ms / 1e3, 10)


def energy(delay_ms: float, name: str) -> float:
    shares = energy_shares(lateral17(), rightmost(delay_ms)[0].shape)
    return 100 * float(shares[COORDINATES.index(name)])


def floor_ratio(delay_ms: float) -> complex:
    """Front over rear floor motion in the rightmost mode."""
    shape = rightmost(delay_ms)[0].shape[:17]
    front, rear = (
        lateral_of_point("carbody", place, PAPER.carbody_to_floor_height) @ shape
        for place in (8.69, -8.69)
    )
    return complex(front / rear)


ROLL, YAW, SWAY = "upper centre roll", "carbody yaw", "lower centre roll"
TOGETHER, AGAINST = "bogie hunting in phase", "bogie hunting in anti phase"
COMPUTED = {
    "passive_lower_centre_roll_frequency": lambda: named("passive", SWAY).frequency_hz,
    "passive_lower_centre_roll_damping": lambda: 100 * named("passive", SWAY).damping_ratio,
    "passive_carbody_yaw_frequency": lambda: named("passive", YAW).frequency_hz,
    "passive_carbody_yaw_damped_frequency": lambda: named("passive", YAW).damped_frequency_hz,
    "passive_carbody_yaw_damping": lambda: 100 * named("passive", YAW).damping_ratio,
    "passive_upper_centre_roll_frequency": lambda: named("passive", ROLL).frequency_hz,
    "passive_upper_centre_roll_damping": lambda: 100 * named("passive", ROLL).damping_ratio,
    "passive_hunting_in_phase_frequency": lambda: named("passive", TOGETHER).frequency_hz,
    "passive_hunting_in_phase_damping": lambda: 100 * named("passive", TOGETHER).damping_ratio,
    "passive_hunting_in_anti_phase_frequency": lambda: named("passive", AGAINST).frequency_hz,
    "passive_hunting_in_anti_phase_damping": lambda: 100 * named("passive", AGAINST).damping_ratio,
    "four_idle_actuators_lower_centre_roll_damping": lambda: 100 * named("4", SWAY).damping_ratio,
    "two_idle_actuators_lower_centre_roll_damping": lambda: 100 * named("2", SWAY).damping_ratio,
    "two_idle_actuators_lower_centre_roll_damped_frequency": lambda: (
        named("2", SWAY).damped_frequency_hz
    ),
    "critical_speed_at_conicity_0.17": lambda: critical_speed(0.17),
    "critical_speed_at_conicity_0.17_longitudinal_creep_1.0e7": lambda: critical_speed(0.17, 1.0e7),
    "critical_speed_at_conicity_0.3": lambda: critical_speed(0.3),
    "critical_speed_at_conicity_0.1": lambda: critical_speed(0.1),
    "published_critical_delay": lambda: 1e3 * crossings("damper")[0].delay,
    "published_crossing_frequency": lambda: crossings("damper")[0].frequency_hz,
    "critical_delay": lambda: 1e3 * crossings("damper")[0].delay,
    "critical_delay_sensor_at_bogie_centre": lambda: 1e3 * crossings("centre")[0].delay,
    "crossing_frequency_sensor_at_bogie_centre": lambda: crossings("centre")[0].frequency_hz,
    "yaw_crossing_delay_sensor_at_bogie_centre": lambda: 1e3 * crossings("centre")[1].delay,
    "yaw_crossing_frequency_sensor_at_bogie_centre": lambda: crossings("centre")[1].frequency_hz,
    "growth_rate_at_200_ms": lambda: rightmost(200.0)[0].root.real,
    "growth_rate_at_204_ms": lambda: rightmost(204.0)[0].root.real,
    "roll_against_lateral_phase_at_204_ms": lambda: phase_degrees(
        rightmost(204.0)[0].shape, "carbody_roll", "carbody_lateral"
    ),
    "carbody_roll_energy_at_204_ms": lambda: energy(204.0, "carbody_roll"),
    "carbody_lateral_energy_at_204_ms": lambda: energy(204.0, "carbody_lateral"),
    "carbody_yaw_energy_at_204_ms": lambda: energy(204.0, "carbody_yaw"),
    "front_against_rear_floor_phase_at_204_ms": lambda: float(
        np.degrees(np.angle(floor_ratio(204.0)))
    ),
    "front_over_rear_floor_at_204_ms": lambda: abs(floor_ratio(204.0)),
}


def test_every_reference_number_is_computed_and_the_reverse() -> None:
    assert set(COMPUTED) == set(NUMBERS)


@pytest.mark.parametrize("name", NUMBERS)
def test_vehicle_reproduces_the_reference_number(name: str) -> None:
    # the tolerance stands beside the number in the file, with its reason
    assert COMPUTED[name]() == pytest.approx(NUMBERS[name]["value"], abs=NUMBERS[name]["tolerance"])


@pytest.mark.parametrize("entry", REFERENCE["root"], ids=lambda e: f"{e['delay_ms']:g}ms")
def test_sky_hook_loop_keeps_its_roots(entry: dict[str, object]) -> None:
    roots = np.array([m.root for m in rightmost(entry["delay_ms"])])
    for real, imaginary in entry["roots"]:
        # half a unit of the last printed digit in each part, and rounding
        assert np.abs(roots - complex(real, imaginary)).min() < entry["tolerance"]


def test_passive_vehicle_is_stable_at_every_speed_below_the_critical_one() -> None:
    # so that bisection has found the first loss of stability; 20 km/h apart
    for speed_kmh in np.arange(60.0, critical_speed(0.17), 20.0):
        A = state_space(lateral17(PAPER, "passive", speed_kmh)).A
        assert np.linalg.eigvals(A).real.max() < 0.0


def test_first_crossing_is_upper_centre_roll_and_the_second_carbody_yaw() -> None:
    names = [mode_name(lateral17(), c.mode.root, c.mode.shape) for c in crossings("centre")]
    assert names == [ROLL, YAW]


@pytest.mark.parametrize("delay_ms", [204.0, 205.0])
def test_unstable_mode_beyond_the_critical_delay_is_upper_centre_roll(delay_ms: float) -> None:
    worst, *others = rightmost(delay_ms)
    assert mode_name(lateral17(), worst.root, worst.shape) == ROLL
    assert worst.root.real > 0.0 > max(m.root.real for m in others)


def test_typical_vehicle_first_loses_stability_in_yaw() -> None:
    # Yaw crosses near 212 ms, 1.32 Hz whatever the roll support, which is then softer.
    vehicle = lateral17("published_typical")
    first = critical_delays(SkyHook(GAIN, 4).to_delay_system(vehicle), 0.25).first
    assert first is not None
    assert mode_name(vehicle, first.mode.root, first.mode.shape) == YAW
    assert first.delay == pytest.approx(0.212, abs=0.0015)  # printed to whole milliseconds
