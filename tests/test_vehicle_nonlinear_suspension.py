"""The 50-coordinate vehicle's suspension against the lateral model and against exact rotations."""

import numpy as np
import pytest

from railenv.units import STANDARD_GRAVITY, FloatArray
from railenv.vehicle import get_vehicle, lateral17
from railenv.vehicle.coordinates import (
    BOGIES,
    WHEELSETS,
    Layout,
    bogie_of_wheelset,
)
from railenv.vehicle.coordinates import (
    COORDINATES as LATERAL_COORDINATES,
)
from railenv.vehicle.nonlinear import full50
from railenv.vehicle.nonlinear.coordinates import AXLE_BOXES, BODIES, coordinate_index
from railenv.vehicle.nonlinear.elements import (
    actuator_rows,
    dampers,
    geometric_stiffness,
    linear_elements,
)
from railenv.vehicle.nonlinear.parameters import FullParameters

N = 50
SHARED = [coordinate_index(name) for name in LATERAL_COORDINATES]
BOXES = [coordinate_index(f"{box}_pitch") for box in AXLE_BOXES]


@pytest.fixture(scope="module")
def parameters() -> FullParameters:
    return FullParameters(lateral=get_vehicle("paper_fit").parameters)


def height_of(parameters: FullParameters, body: str) -> float:
    """Centre of gravity above rail."""
    if body == "carbody":
        return parameters.carbody_height
    is_bogie = body.startswith("bogie")
    return parameters.bogie_height if is_bogie else parameters.lateral.wheel_radius


def condensed(parameters: FullParameters, omega: float) -> np.ndarray:
    """K + i omega C of springs and plain dashpots without the boxes' pitch, (50, 50)."""
    total = np.zeros((N, N), dtype=complex)
    for element in linear_elements(parameters):
        coefficient = element.stiffness + 1j * omega * element.damping
        total += coefficient * np.outer(element.row, element.row)
    for damper in dampers(parameters, "passive"):
        if damper.stiffness == 0.0:
            total += 1j * omega * damper.damping * np.outer(damper.row, damper.row)
    inner = total[np.ix_(BOXES, BOXES)]
    return total - total[:, BOXES] @ np.linalg.solve(inner, total[BOXES, :])


def test_stiffness_and_damping_are_the_lateral_models_in_its_coordinates(
    parameters: FullParameters,
) -> None:
    lateral = lateral17("paper_fit", "passive", 300.0)
    omega = 10.0
    found = condensed(parameters, omega)[np.ix_(SHARED, SHARED)]
    wanted = lateral.suspension_stiffness + 1j * omega * lateral.suspension_damping
    # Rounding of sums of a dozen terms.
    assert np.abs(found - wanted).max() < 1e-13 * np.abs(wanted).max()


@pytest.mark.parametrize("layout", ["passive", "2", "4"])
def test_dampers_with_a_node_and_actuators_pull_where_the_lateral_models_do(
    parameters: FullParameters, layout: Layout
) -> None:
    lateral = lateral17("paper_fit", layout, 300.0)
    found = [d for d in dampers(parameters, layout) if d.stiffness > 0.0]
    assert [(d.stiffness, d.damping) for d in found] == [
        (d.stiffness, d.damping) for d in lateral.dampers
    ]
    rows = np.array([d.row[SHARED] for d in found])
    np.testing.assert_allclose(rows, [d.row for d in lateral.dampers], rtol=0, atol=1e-15)
    pull = actuator_rows(parameters, layout)[:, SHARED]
    np.testing.assert_allclose(pull, lateral.actuator_rows, rtol=0, atol=1e-15)


@pytest.mark.parametrize("motion", ["longitudinal", "lateral", "vertical", "yaw"])
def test_moving_the_whole_vehicle_in_one_piece_stretches_nothing_but_the_coupler(
    parameters: FullParameters, motion: str
) -> None:
    # Not so for roll: bushings act along the track's axes, so that 69 mm between the two ends of a
    # secondary spring count as sideways stretch, as they do in the lateral model.
    p, q = parameters.lateral, np.zeros(N)
    for body in BODIES:
        q[coordinate_index(f"{body}_{motion}")] = 1.0
        if motion == "yaw" and body != "carbody":
            front = body in ("bogie1", "wheelset1", "wheelset2")
            x = p.half_bogie_spacing * (1.0 if front else -1.0)
            if body.startswith("wheelset"):
                x += p.half_wheelbase * (1.0 if int(body[-1]) % 2 else -1.0)
            q[coordinate_index(f"{body}_lateral")] = x
    for element in linear_elements(parameters):
        if element.name != "coupler":
            assert abs(element.row @ q) < 1e-14, element.name


def rolled_about_the_rail(parameters: FullParameters) -> FloatArray:
    """One radian of small roll of everything about the rails' level."""
    q = np.zeros(N)
    for body in BODIES:
        q[coordinate_index(f"{body}_roll")] = 1.0
        q[coordinate_index(f"{body}_lateral")] = height_of(parameters, body)
    return q


def test_preloads_hold_each_tilted_body_up_along_its_tilt(parameters: FullParameters) -> None:
    force = -geometric_stiffness(parameters) @ rolled_about_the_rail(parameters)
    for body in ("carbody", "bogie1", "bogie2"):
        at = coordinate_index(f"{body}_lateral")
        weight = parameters.masses[at] * STANDARD_GRAVITY
        # The tilted springs push sideways by the weight times the angle; nothing turns the body.
        assert force[at] == pytest.approx(weight, rel=1e-12)
        assert abs(force[coordinate_index(f"{body}_roll")]) < 1e-9 * weight


def test_preloads_push_no_common_way(parameters: FullParameters) -> None:
    force = -geometric_stiffness(parameters) @ rolled_about_the_rail(parameters)
    sideways = [force[coordinate_index(f"{body}_lateral")] for body in BODIES]
    assert abs(sum(sideways)) < 1e-9 * max(map(abs, sideways))


def preload_energy(parameters: FullParameters, q: FloatArray, plane: str) -> float:
    """Work stored against the preloads with exact rotations in one plane.

    Every preload P between A above and B below stores P (r_A - r_B) . e_z with the bogie's axis.
    """
    turn, along = ("roll", "lateral") if plane == "across" else ("pitch", "longitudinal")
    # Roll turns y towards z, pitch turns z towards x: e_z leans to -y or to +x.
    lean = -1.0 if plane == "across" else 1.0

    def value(body: str, motion: str) -> float:
        return float(q[coordinate_index(f"{body}_{motion}")])

    def point(body: str, side: float, down: float) -> FloatArray:
        a = value(body, turn)
        s, c = lean * np.sin(a), np.cos(a)
        centre = np.array([value(body, along), value(body, "vertical")])
        centre[1] -= height_of(parameters, body)
        return centre + np.array([side * c + down * s, -side * s + down * c])

    p, total = parameters.lateral, 0.0
    for i in WHEELSETS:
        frame = f"bogie{bogie_of_wheelset(i)}"
        ahead = p.half_wheelbase * (1.0 if i % 2 else -1.0)
        for sign in (-1.0, 1.0):
            upper = lower = sign * p.half_primary_spacing
            if plane == "along":
                upper, lower = ahead, 0.0
            gap = point(frame, upper, p.bogie_to_primary_height) - point(f"wheelset{i}", lower, 0.0)
            if plane == "along":
                gap[0] -= ahead
            a = value(frame, turn)
            total += parameters.primary_preload * (gap @ [lean * np.sin(a), np.cos(a)])
    for j in BOGIES:
        frame, place = f"bogie{j}", p.half_bogie_spacing * (1.0 if j == 1 else -1.0)
        for sign in (-1.0, 1.0):
            upper = lower = sign * p.half_secondary_spacing
            if plane == "along":
                upper, lower = place, 0.0
            gap = point("carbody", upper, p.carbody_to_secondary_height) - point(
                frame, lower, p.bogie_to_secondary_height
            )
            if plane == "along":
                gap[0] -= place
            a = value(frame, turn)
            total += parameters.secondary_preload * (gap @ [lean * np.sin(a), np.cos(a)])
    return total


@pytest.mark.parametrize("plane", ["across", "along"])
def test_geometric_stiffness_is_the_second_derivative_of_the_preloads_work(
    parameters: FullParameters, plane: str
) -> None:
    motions = ("lateral", "roll") if plane == "across" else ("longitudinal", "pitch")
    moved = [coordinate_index(f"{b}_{m}") for b in BODIES for m in (*motions, "vertical")]
    step, k = 1e-3, len(moved)
    found = np.zeros((k, k))
    unit = step * np.eye(N)
    for i in range(k):
        for j in range(k):
            a, b = unit[moved[i]], unit[moved[j]]
            signs = ((1, 1, 1), (1, -1, -1), (-1, 1, -1), (-1, -1, 1))
            found[i, j] = sum(
                w * preload_energy(parameters, s * a + t * b, plane) for s, t, w in signs
            )
    found /= 4.0 * step**2
    wanted = geometric_stiffness(parameters)[np.ix_(moved, moved)]
    # The differences leave step^2 and rounding, 1e-16 of 1e5 J over 1e-6.
    np.testing.assert_allclose(found, wanted, rtol=0, atol=3e-6 * np.abs(wanted).max())


def test_an_actuators_residue_damps_as_a_dashpot_in_its_place() -> None:
    bare = full50("paper_fit", "4", 300.0)
    left = bare.replace(parameters=bare.parameters.replace(actuator_residue=2e3))
    rows = actuator_rows(bare.parameters, "4")
    np.testing.assert_allclose(
        left.damping - bare.damping, 2e3 * rows.T @ rows, rtol=1e-12, atol=1e-9
    )
    passive = left.replace(layout="passive")
    np.testing.assert_array_equal(passive.damping, bare.replace(layout="passive").damping)
