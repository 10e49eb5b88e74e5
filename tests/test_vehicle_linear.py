"""Laws that the assembled lateral vehicle must obey whatever its numbers."""

import re
import typing

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from railenv.errors import ArgumentError
from railenv.vehicle import (
    LateralVehicle,
    VehicleParameters,
    get_vehicle,
    lateral17,
    state_space,
)
from railenv.vehicle.coordinates import COORDINATES

Matrix = NDArray[np.float64]

PAPER = get_vehicle("paper_fit").parameters
LAYOUTS = ("passive", "2", "4")
N = 17
NO_CREEP = {
    "creep_longitudinal": 0.0,
    "creep_lateral": 0.0,
    "creep_lateral_spin": 0.0,
    "creep_spin": 0.0,
}
# Without conicity the rails exert no gravitational force either: the vehicle floats.
FLOATING = PAPER.replace(
    conicity=0.0, primary_lateral_damping=3e3, secondary_lateral_damping=2e3, **NO_CREEP
)
# Places of the 17 coordinates' bodies ahead of the vehicle's centre [m].
PLACES = {
    "wheelset1": 8.69 + 1.25,
    "wheelset2": 8.69 - 1.25,
    "wheelset3": -8.69 + 1.25,
    "wheelset4": -8.69 - 1.25,
    "bogie1": 8.69,
    "bogie2": -8.69,
    "carbody": 0.0,
}


def coordinates(values: dict[str, float]) -> Matrix:
    return np.array([values.get(name, 0.0) for name in COORDINATES])


SHIFT = coordinates({f"{body}_lateral": 1.0 for body in PLACES})
TURN = coordinates(
    {f"{body}_lateral": place for body, place in PLACES.items()}
    | {f"{body}_yaw": 1.0 for body in PLACES}
)


@pytest.mark.parametrize("name", ["paper_fit", "published_typical"])
def test_mass_matrix_is_symmetric_and_positive_definite(name: str) -> None:
    M = lateral17(name).mass
    assert np.array_equal(M, M.T)
    assert np.linalg.eigvalsh(M).min() > 0.0


@pytest.mark.parametrize("matrix", ["suspension_stiffness", "suspension_damping"])
def test_suspension_matrix_is_symmetric_and_positive_semidefinite(matrix: str) -> None:
    K = getattr(LateralVehicle(FLOATING, "passive", 80.0), matrix)
    assert np.array_equal(K, K.T)
    roots = np.linalg.eigvalsh(K)
    # rounding of the eigenvalue solver, relative to the largest
    assert roots.min() > -1e-14 * roots.max()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_common_lateral_shift_of_vehicle_and_track_gives_no_force(layout: str) -> None:
    system = state_space(lateral17(layout=layout))
    x = np.concatenate([SHIFT, np.zeros(len(system.states) - N)])
    u = np.array([float(re.fullmatch(r"alignment_\d", name) is not None) for name in system.inputs])
    rates = system.A @ x + system.B @ u
    size = np.abs(system.A) @ np.abs(x) + np.abs(system.B) @ np.abs(u)
    # cancelling summands leave their rounding
    assert np.all(np.abs(rates) <= 1e-14 * size)


@pytest.mark.parametrize("motion", [SHIFT, TURN], ids=["shift", "yaw"])
def test_rigid_motion_of_the_whole_vehicle_is_free_of_stress(motion: Matrix) -> None:
    system = state_space(LateralVehicle(FLOATING, "passive", 80.0))
    x = np.concatenate([motion, np.zeros(len(system.states) - N)])
    # cancelling summands leave their rounding
    assert np.all(np.abs(system.A @ x) <= 1e-14 * (np.abs(system.A) @ np.abs(x)))


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("motion", [SHIFT, TURN], ids=["momentum", "angular momentum"])
def test_internal_forces_leave_the_momentum_of_the_vehicle_alone(
    motion: Matrix, layout: str
) -> None:
    vehicle = LateralVehicle(FLOATING, layout, 80.0)
    system = state_space(vehicle)
    forces = [k for k, name in enumerate(system.inputs) if name.startswith("actuator")]
    blocks = np.hstack([system.A, system.B[:, forces]])[N : 2 * N]
    weighted = motion @ vehicle.mass
    # a share of the summands: the forces of both ends cancel up to rounding
    assert np.all(np.abs(weighted @ blocks) <= 1e-14 * (np.abs(weighted) @ np.abs(blocks)))


@pytest.mark.parametrize("layout", LAYOUTS)
def test_left_and_right_of_the_vehicle_are_mirror_images(layout: str) -> None:
    # Seen in a mirror along the track, lateral motion, yaw, roll and the lateral nodes change sign;
    # the yaw dampers work along x, which the mirror keeps, but left becomes right.
    system = state_space(lateral17(layout=layout))
    mirror = np.zeros((len(system.states), len(system.states)))
    for row, name in enumerate(system.states):
        other = re.sub("left|right", lambda m: {"left": "right", "right": "left"}[m[0]], name)
        mirror[row, system.states.index(other)] = 1.0 if "yaw_damper" in name else -1.0
    np.testing.assert_array_equal(mirror @ system.A @ mirror.T, system.A)


SWAP = str.maketrans({"1": "4", "2": "3", "3": "2", "4": "1"})


def end_for_end(name: str) -> str:
    """Name of what stands in this place when the vehicle is looked at from its other end."""
    if name.startswith("bogie"):
        return name.translate(str.maketrans({"1": "2", "2": "1"}))
    return name.translate(SWAP)


@pytest.mark.parametrize("layout", LAYOUTS)
def test_front_and_rear_of_the_floating_vehicle_are_mirror_images(layout: str) -> None:
    # A mirror across the track swaps the ends and reverses yaw and the stretch of the yaw dampers.
    # Creep is left out: it knows the direction of travel.
    system = state_space(LateralVehicle(FLOATING, layout, 80.0))

    def mirror(names: tuple[str, ...]) -> Matrix:
        P = np.zeros((len(names), len(names)))
        for row, name in enumerate(names):
            P[row, names.index(end_for_end(name))] = -1.0 if "yaw" in name else 1.0
        return P

    P, Q = mirror(system.states), mirror(system.inputs)
    # sums in another order: rounding
    np.testing.assert_allclose(P @ system.A @ P.T, system.A, rtol=1e-13, atol=1e-9)
    np.testing.assert_allclose(P @ system.B @ Q.T, system.B, rtol=1e-13, atol=1e-12)


def energy_matrix(vehicle: LateralVehicle) -> Matrix:
    """Q with stored energy x^T Q x: motion, parallel springs and the dampers' series springs."""
    size = 2 * N + len(vehicle.dampers)
    Q = np.zeros((size, size))
    Q[:N, :N] = vehicle.suspension_stiffness / 2
    Q[N : 2 * N, N : 2 * N] = vehicle.mass / 2
    for k, damper in enumerate(vehicle.dampers):
        stretch = np.concatenate([damper.row, np.zeros(size - N)])
        stretch[2 * N + k] = -1.0
        Q += damper.stiffness / 2 * np.outer(stretch, stretch)
    return Q


@pytest.mark.parametrize("layout", LAYOUTS)
def test_energy_never_grows_without_creep_and_actuators(layout: str) -> None:
    vehicle = LateralVehicle(FLOATING, layout, 80.0)
    Q, A = energy_matrix(vehicle), state_space(vehicle).A
    power = Q @ A + A.T @ Q
    # In units in which every state stores energy of order one, so that rounding is comparable.
    scale = 1.0 / np.sqrt(np.diag(Q))
    power = power * scale * scale[:, None]
    # rounding of the solver relative to the largest power
    assert np.linalg.eigvalsh(power).max() < 1e-12 * np.abs(power).max()


@pytest.mark.parametrize("layout", LAYOUTS)
def test_speed_enters_only_as_a_constant_part_and_a_part_over_v(layout: str) -> None:
    def system_matrix(speed_kmh: float) -> Matrix:
        return state_space(lateral17(layout=layout, speed_kmh=speed_kmh)).A

    over_v = (system_matrix(100.0) - system_matrix(400.0)) / (1 / 100.0 - 1 / 400.0)
    constant = system_matrix(400.0) - over_v / 400.0
    for speed_kmh in (3.0, 50.0, 230.0, 1000.0):
        # two subtractions of comparable numbers: a few units of rounding, times 100 / 3 in v
        np.testing.assert_allclose(
            system_matrix(speed_kmh), constant + over_v / speed_kmh, rtol=1e-11, atol=1e-9
        )


def test_part_over_v_touches_wheelset_velocities_only() -> None:
    changed = state_space(lateral17(speed_kmh=100.0)).A != state_space(lateral17(speed_kmh=400.0)).A
    rows, columns = np.nonzero(changed)
    assert {*rows, *columns} == set(range(N, N + 8))


def test_inputs_do_not_depend_on_the_speed() -> None:
    slow, fast = (state_space(lateral17(speed_kmh=v)).B for v in (100.0, 400.0))
    assert np.array_equal(slow, fast)


@pytest.mark.parametrize("conicity", [0.05, 0.17, 0.4])
def test_free_wheelset_follows_klingel_wavelength(conicity: float) -> None:
    # Suspension off, inertia and weight negligible against creep (10 g on 10 MN), crawling.
    light = {f.name: 0.01 for f in FIELDS if f.name.endswith(("mass", "inertia"))}
    loose = {f.name: 0.0 for f in FIELDS if f.name.startswith("primary_")}
    no_spin = {"creep_lateral_spin": 0.0, "creep_spin": 0.0}
    free = PAPER.replace(conicity=conicity, **light, **loose, **no_spin)
    speed = 1.0
    A = state_space(LateralVehicle(free, "4", speed)).A
    wheelset = [0, 1, N, N + 1]
    roots = np.linalg.eigvals(A[np.ix_(wheelset, wheelset)])
    waves = roots[roots.imag > 0.0]
    wavelength = 2 * np.pi * speed / waves.imag
    klingel = 2 * np.pi * np.sqrt(free.half_contact_spacing * free.wheel_radius / conicity)
    # weight and inertia over creep are 1e-8; beside the stiff roots 2 f / (m v) = 2e9 1/s the
    # solver leaves about 1e-7 of the slow one
    assert wavelength == pytest.approx([klingel], rel=1e-6)


def test_wheelsets_follow_the_leading_one_by_wheelbase_and_bogie_spacing() -> None:
    # 2 L_b, 2 L_c and their sum; rounding of sums of metres
    assert lateral17().wheelset_setback == pytest.approx([0.0, 2.5, 17.38, 19.88], abs=1e-13)


DIMENSIONS = {"kg": (1, 0, 0), "m": (0, 1, 0), "s": (0, 0, 1), "N": (1, 1, -2), "rad": (0, 0, 0)}


def unit_factor(unit: str, factors: tuple[float, float, float]) -> float:
    """How much a number in this unit changes when mass, length and time are counted otherwise."""
    factor = 1.0
    over = 1
    for word in re.findall(r"[A-Za-z]+(?:\^\d)?|/", unit):
        if word == "/":
            over = -1
            continue
        base, _, power = word.partition("^")
        exponents = [over * int(power or 1) * e for e in DIMENSIONS[base]]
        factor *= np.prod([f**e for f, e in zip(factors, exponents, strict=True)])
    return factor


class Field(typing.NamedTuple):
    name: str
    unit: str


FIELDS = [
    Field(name, hint.__metadata__[0])
    for name, hint in typing.get_type_hints(VehicleParameters, include_extras=True).items()
]


@pytest.mark.parametrize("layout", LAYOUTS)
@settings(max_examples=10, deadline=None)
@given(mass=st.floats(0.1, 10.0), length=st.floats(0.1, 10.0))
def test_roots_scale_by_one_over_time_when_units_change(
    layout: str, mass: float, length: float
) -> None:
    # Gravity is a constant of the library, so time changes as the root of length and keeps it.
    time = np.sqrt(length)
    changed = VehicleParameters(
        **{
            f.name: getattr(PAPER, f.name) * unit_factor(f.unit, (mass, length, time))
            for f in FIELDS
        }
    )
    speed = 80.0
    before = np.linalg.eigvals(state_space(LateralVehicle(PAPER, layout, speed)).A)
    after = np.linalg.eigvals(state_space(LateralVehicle(changed, layout, speed * length / time)).A)
    distance = np.abs(before[:, None] - after[None, :] * time)
    # nearly equal pairs of roots (both bogies) keep about half of the solver's digits
    assert np.all(distance.min(axis=1) < 1e-7 * np.abs(before))
    assert np.all(distance.min(axis=0) < 1e-7 * np.abs(after * time))


@pytest.mark.parametrize("speed", [0.0, -10.0, float("nan"), float("inf"), "fast"])
def test_speed_that_is_not_above_zero_is_refused(speed: float) -> None:
    with pytest.raises(ArgumentError, match="speed"):
        LateralVehicle(PAPER, "4", speed)


def test_vehicle_at_300_kmh_runs_at_83_and_a_third_metres_per_second() -> None:
    # rounding of one division
    assert lateral17(speed_kmh=300.0).speed == pytest.approx(250.0 / 3.0, rel=1e-15)


@pytest.mark.parametrize(("layout", "channels"), [("passive", 0), (2, 2), ("4", 4)])
def test_layout_has_as_many_actuators_as_its_name_says(layout: object, channels: int) -> None:
    assert lateral17(layout=layout).num_actuators == channels


def test_parameters_of_ones_own_are_taken_as_they_are() -> None:
    mine = PAPER.replace(carbody_mass=30e3)
    assert lateral17(mine).parameters is mine
