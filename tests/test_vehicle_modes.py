"""Modes get their names from their shapes, whatever their frequency or order."""

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.skyhook import SkyHook
from railenv.stability import Mode, rightmost_roots
from railenv.stability.modes import modes_of_matrix
from railenv.vehicle import LateralVehicle, get_vehicle, lateral17, mode_name, state_space
from railenv.vehicle.coordinates import COORDINATES, coordinate_index
from railenv.vehicle.modes import energy_shares, phase_degrees

PAPER = get_vehicle("paper_fit").parameters
PASSIVE = lateral17(layout="passive")
BODY_NAMES = {"lower centre roll", "upper centre roll", "carbody yaw"}


def modes_of(vehicle: LateralVehicle) -> list[Mode]:
    A = state_space(vehicle).A
    return modes_of_matrix(A, A.shape[0])


def names_below(vehicle: LateralVehicle, frequency_hz: float) -> dict[float, str]:
    """Oscillating modes up to a frequency: damped frequency [Hz] to name, by rising frequency."""
    found = [m for m in modes_of(vehicle) if m.root.imag > 0.0 and m.frequency_hz < frequency_hz]
    found.sort(key=lambda m: m.frequency_hz)
    return {m.frequency_hz: mode_name(vehicle, m.root, m.shape) for m in found}


def shape(**values: complex) -> NDArray[np.complex128]:
    motion = np.zeros(42, dtype=complex)
    for name, value in values.items():
        motion[coordinate_index(name)] = value
    return motion


def test_slow_modes_of_the_passive_vehicle_have_the_names_of_the_field() -> None:
    assert list(names_below(PASSIVE, 5.0).values()) == [
        "lower centre roll",
        "carbody yaw",
        "upper centre roll",
        "bogie hunting in phase",
        "bogie hunting in anti phase",
    ]


@pytest.mark.parametrize("delay", [0.0, 0.15, 0.204])
def test_closed_loop_keeps_one_mode_of_each_body_name(delay: float) -> None:
    vehicle = lateral17()
    modes = rightmost_roots(SkyHook().to_delay_system(vehicle), delay, 5)
    names = [mode_name(vehicle, m.root, m.shape) for m in modes]
    body = [name for name in names if name in BODY_NAMES]
    assert sorted(body) == sorted(set(body))
    assert {"lower centre roll", "upper centre roll"} <= set(body)


def test_kinematic_mode_at_small_conicity_is_hunting_and_no_carbody_mode() -> None:
    # At conicity 0.05 the wheelsets' wave comes down to 1.8 Hz, next to the body modes.
    names = names_below(lateral17(PAPER.replace(conicity=0.05), "passive", 300.0), 2.0)
    near = [name for f, name in names.items() if 1.7 < f < 1.9]
    assert len(near) == 2
    assert all(name.startswith("bogie hunting") for name in near)


def test_body_names_stay_when_yaw_becomes_the_slowest_mode() -> None:
    heavy_ends = PAPER.replace(carbody_yaw_inertia=4 * PAPER.carbody_yaw_inertia)
    names = list(names_below(LateralVehicle(heavy_ends, "passive", PASSIVE.speed), 2.0).values())
    assert names == ["carbody yaw", "lower centre roll", "upper centre roll"]


def test_body_names_stay_when_upper_roll_becomes_faster_than_hunting() -> None:
    # A light body rolls at 2.1 Hz, above the slow wave of a small conicity at 1.8 Hz.
    light = PAPER.replace(carbody_roll_inertia=30e3, conicity=0.05)
    names = list(names_below(LateralVehicle(light, "passive", PASSIVE.speed), 3.0).values())
    assert names[-1] == "upper centre roll"
    assert sorted(n for n in names if n in BODY_NAMES) == sorted(BODY_NAMES)


@pytest.mark.parametrize("factor", [0.01, 100.0])
def test_name_does_not_depend_on_the_frequency(factor: float) -> None:
    for m in modes_of(PASSIVE):
        assert mode_name(PASSIVE, factor * m.root, m.shape) == mode_name(PASSIVE, m.root, m.shape)


@pytest.mark.parametrize("factor", [1e-6, -3.0, np.exp(2j)])
def test_name_does_not_depend_on_size_and_phase_of_the_shape(factor: complex) -> None:
    for m in modes_of(PASSIVE):
        assert mode_name(PASSIVE, m.root, factor * m.shape) == mode_name(PASSIVE, m.root, m.shape)


@pytest.mark.parametrize(
    ("roll", "name"),
    [
        (1.0, "lower centre roll"),
        (-1.0, "upper centre roll"),
        (np.exp(1.5j), "lower centre roll"),
        (np.exp(1.7j), "upper centre roll"),
    ],
)
def test_centre_of_roll_follows_from_the_sign_of_lateral_against_roll(
    roll: complex, name: str
) -> None:
    # The point that stands still lies h = y / phi below the centre of gravity; 90 degrees divide.
    still = shape(carbody_lateral=1.0, carbody_roll=roll)
    assert mode_name(PASSIVE, -0.1 + 5j, still) == name


def test_yaw_needs_more_than_half_of_the_carbody_energy() -> None:
    # m y^2 against I_cz psi^2: at equal lateral amplitude 1 m, yaw holds half at sqrt(m / I_cz).
    even = np.sqrt(PAPER.carbody_mass / PAPER.carbody_yaw_inertia)
    below = shape(carbody_lateral=1.0, carbody_yaw=0.99 * even)
    above = shape(carbody_lateral=1.0, carbody_yaw=1.01 * even)
    names = [mode_name(PASSIVE, -0.1 + 5j, s) for s in (below, above)]
    assert names == ["lower centre roll", "carbody yaw"]


@pytest.mark.parametrize("factor", [0.99, 1.01])
def test_carbody_owns_a_mode_from_half_of_the_energy(factor: float) -> None:
    even = np.sqrt(PAPER.carbody_mass / PAPER.bogie_mass)
    mixed = shape(carbody_lateral=1.0, bogie1_lateral=factor * even)
    name = mode_name(PASSIVE, -0.1 + 5j, mixed)
    assert (name in BODY_NAMES) == (factor < 1.0)


@pytest.mark.parametrize(
    ("rear", "name"),
    [
        (1.0, "bogie hunting in phase"),
        (-1.0, "bogie hunting in anti phase"),
        (0.1, "front bogie hunting"),
        (10.0, "rear bogie hunting"),
    ],
)
def test_hunting_is_named_by_front_against_rear(rear: float, name: str) -> None:
    front_part = dict.fromkeys(("bogie1_lateral", "wheelset1_lateral", "wheelset2_lateral"), 1.0)
    rear_part = dict.fromkeys(("bogie2_lateral", "wheelset3_lateral", "wheelset4_lateral"), rear)
    assert mode_name(PASSIVE, -0.1 + 20j, shape(**front_part, **rear_part)) == name


def test_motion_across_the_primary_suspension_is_not_hunting() -> None:
    against = shape(bogie1_lateral=1.0, wheelset1_lateral=-0.3, wheelset2_lateral=-0.3)
    assert mode_name(PASSIVE, -1.0 + 190j, against) == "bogie1 lateral"


def test_strongly_damped_motion_of_the_running_gear_is_not_hunting() -> None:
    following = shape(bogie1_lateral=1.0, wheelset1_lateral=1.0, wheelset2_lateral=1.0)
    assert mode_name(PASSIVE, -10.0 + 10j, following) == "bogie1 lateral"


def test_root_that_does_not_oscillate_is_called_overdamped() -> None:
    name = mode_name(PASSIVE, complex(-3.0), shape(carbody_yaw=1.0))
    assert name == "carbody yaw (overdamped)"


@pytest.mark.parametrize(
    ("kind", "rate"), [("yaw damper relaxation", 8.8e6 / 330e3), ("lateral damper", None)]
)
def test_nodes_that_move_alone_are_damper_relaxation(kind: str, rate: float | None) -> None:
    # Left and right yaw dampers working against each other hold the bodies: two roots at k / c. No
    # such pair exists among the lateral dampers.
    found = [m for m in modes_of(PASSIVE) if mode_name(PASSIVE, m.root, m.shape).startswith(kind)]
    pure = [m for m in found if rate and abs(m.root + rate) < 1e-6 * rate]
    assert len(pure) == (2 if rate else 0)


def test_energy_shares_add_up_to_one() -> None:
    for m in modes_of(PASSIVE):
        assert energy_shares(PASSIVE, m.shape).sum() == pytest.approx(1.0, rel=1e-14)  # rounding


def test_energy_share_weighs_motion_with_mass() -> None:
    shares = energy_shares(PASSIVE, shape(bogie1_lateral=2.0, carbody_roll=1j))
    expected = 2200.0 * 4.0 / (2200.0 * 4.0 + 127681.0)
    # rounding of one division
    assert shares[COORDINATES.index("bogie1_lateral")] == pytest.approx(expected, rel=1e-15)


@pytest.mark.parametrize("degrees", [-170.0, -90.0, 0.0, 35.0, 180.0])
def test_phase_is_that_of_the_first_minus_that_of_the_second(degrees: float) -> None:
    turned = shape(carbody_roll=2.0 * np.exp(1j * np.radians(degrees + 20.0)))
    turned += shape(carbody_lateral=np.exp(1j * np.radians(20.0)))
    # rounding of degrees
    assert abs(phase_degrees(turned, "carbody_roll", "carbody_lateral") - degrees) < 1e-12
