"""The 50-coordinate vehicle in curves: steady curving by hand, and a run through a transition."""

import numpy as np
import pytest

from eval.full50_table import cone_contact
from railenv.errors import ArgumentError
from railenv.simulation.full_run import FullSimulation
from railenv.units import STANDARD_GRAVITY, FloatArray
from railenv.vehicle import get_vehicle
from railenv.vehicle.nonlinear import (
    Equilibrium,
    FullVehicle,
    NoEquilibriumError,
    equilibrium,
    full50,
)
from railenv.vehicle.nonlinear.coordinates import BODIES, coordinate_index
from railenv.vehicle.nonlinear.curve import circular_curve, curved_line, frame_in
from railenv.vehicle.nonlinear.elements import linear_elements
from railenv.vehicle.nonlinear.rates import FrameArrays

OUTWARD = np.array([-1.0, 1.0] * 4)  # the rail's outside as a direction of y, left and right
CURVES = [(3000.0, 0.0), (3000.0, 0.05), (2000.0, 0.1), (-2000.0, -0.1)]


@pytest.fixture(scope="module")
def vehicle() -> FullVehicle:
    return full50("paper_fit", "passive", 200.0)


@pytest.fixture(scope="module")
def on_cones() -> FullVehicle:
    """Wheels that touch at the half contact spacing wherever the wheelset is."""
    contact = cone_contact(get_vehicle("paper_fit").parameters, 0.01, "given")
    return full50("paper_fit", "passive", 200.0, contact)


def steady(vehicle: FullVehicle, radius: float, cant: float) -> tuple[Equilibrium, FrameArrays]:
    line = curved_line([(0.0, 1.0 / radius, cant), (1e4, 1.0 / radius, cant)])
    frame = frame_in(line, 5000.0, vehicle.speed, np.array(vehicle.wheelset_setback))
    return equilibrium(vehicle, frame), frame


def body_masses(vehicle: FullVehicle) -> FloatArray:
    masses = vehicle.parameters.masses
    return np.array([masses[coordinate_index(f"{body}_lateral")] for body in BODIES])


def unbalanced(vehicle: FullVehicle, radius: float, cant: float) -> float:
    """V^2/R - g cant [m/s^2]."""
    return vehicle.speed**2 / radius - STANDARD_GRAVITY * cant


@pytest.mark.parametrize(("radius", "cant"), CURVES)
def test_guiding_forces_hold_the_mass_in_the_curve(
    vehicle: FullVehicle, radius: float, cant: float
) -> None:
    found, _ = steady(vehicle, radius, cant)
    on_rails = float(OUTWARD @ found.wheels[:, 1])
    wanted = -body_masses(vehicle).sum() * unbalanced(vehicle, radius, cant)
    assert on_rails == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize(("radius", "cant"), CURVES)
def test_rails_carry_the_weight_and_the_canted_share_of_the_centrifugal_force(
    vehicle: FullVehicle, radius: float, cant: float
) -> None:
    found, _ = steady(vehicle, radius, cant)
    down = STANDARD_GRAVITY * (1.0 - cant**2 / 2.0) + vehicle.speed**2 / radius * cant
    assert found.wheels[:, 0].sum() == pytest.approx(body_masses(vehicle).sum() * down, rel=1e-6)


def test_balanced_cant_leaves_no_net_guiding_force(vehicle: FullVehicle) -> None:
    radius = 2500.0
    cant = vehicle.speed**2 / radius / STANDARD_GRAVITY
    found, _ = steady(vehicle, radius, cant)
    weight = body_masses(vehicle).sum() * STANDARD_GRAVITY
    assert abs(float(OUTWARD @ found.wheels[:, 1])) < 1e-9 * weight


@pytest.mark.parametrize(("radius", "cant"), [*CURVES, (2500.0, 0.12588)])
def test_wheel_loads_differ_by_the_overturning_moment(
    on_cones: FullVehicle, radius: float, cant: float
) -> None:
    found, frame = steady(on_cones, radius, cant)
    p, g, speed = on_cones.parameters, STANDARD_GRAVITY, on_cones.speed
    b, r = p.lateral.half_contact_spacing, p.lateral.wheel_radius
    mass = body_masses(on_cones)
    height = np.array([p.carbody_height, p.bogie_height, p.bogie_height, r, r, r, r])
    lateral = np.array([coordinate_index(f"{body}_lateral") for body in BODIES])
    # Places in one common frame; the curve's bend sets wheelsets and bodies off against each other.
    place = (found.state + np.pad(frame.offset, (0, len(found.state) - 50)))[lateral]
    rails = np.repeat(frame.offset[lateral[3:]], 2)
    loads = found.wheels[:, 0]
    forces = mass @ height * unbalanced(on_cones, radius, cant)
    weights = g * float(mass @ place) - float(loads @ rails)
    # Turning a spinning axle takes a moment that presses the outer wheel down.
    spin = 4.0 * p.wheelset_pitch_inertia * speed / r * speed / radius
    difference = float(loads[0::2].sum() - loads[1::2].sum())
    # Secondary springs push along the track's axes with 69 mm between their ends, as in the
    # lateral model, and no couple makes up for it.
    gap = p.carbody_height - p.lateral.carbody_to_secondary_height
    gap -= p.bogie_height - p.lateral.bogie_to_secondary_height
    pushed = sum(
        element.stiffness * float(element.row @ (found.state[:50] + frame.offset))
        for element in linear_elements(p)
        if element.name.startswith("secondary_lateral")
    )
    # Round heads of 10 mm let the points of contact move by some tenths of a millimetre of b.
    scale = mass.sum() * g * b
    hand = forces - weights + spin + gap * pushed
    assert difference * b == pytest.approx(hand, abs=5e-4 * scale)
    assert abs(spin) > 1e-3 * scale


def test_a_left_hand_curve_is_the_mirror_image_of_a_right_hand_one(vehicle: FullVehicle) -> None:
    right, _ = steady(vehicle, 2000.0, 0.1)
    left, _ = steady(vehicle, -2000.0, -0.1)
    swapped = [1, 0, 3, 2, 5, 4, 7, 6]
    # Newton's method ends at a residual of 1e-10 of an axle load, creepages at 1e-9.
    np.testing.assert_allclose(left.wheels[swapped], right.wheels, rtol=1e-6, atol=1e-6)


def test_a_run_through_a_transition_ends_in_steady_curving(on_cones: FullVehicle) -> None:
    line = circular_curve(3000.0, 0.05, start=50.0, transition=150.0)
    simulation = FullSimulation(
        on_cones, ["carbody_lateral"], curves=line, control_period=0.1, record_step=0.1
    )
    simulation.reset(np.zeros((1, 0)))
    pushed: list[float] = []
    for _ in range(180):
        simulation.advance(np.zeros((1, 0)))
        pushed.append(float(OUTWARD @ simulation.wheels[0, :, 1]))
    wanted, _ = steady(on_cones, 3000.0, 0.05)
    state = simulation.state[0]
    turning = [coordinate_index(f"wheelset{i}_pitch") for i in range(1, 5)]
    kept = np.setdiff1d(np.arange(50), turning)
    # 14 s after the transition the slowest motion, half a hertz with 15 % damping, is at e^-7 of
    # the 30 mm that the carbody moves.
    np.testing.assert_allclose(state[kept], wanted.state[kept], rtol=0, atol=5e-5)
    assert pushed[-1] == pytest.approx(float(OUTWARD @ wanted.wheels[:, 1]), rel=3e-3)
    # The transition begins ahead of the vehicle.
    assert abs(pushed[0]) < 1.0


def test_a_curve_that_the_rails_cannot_hold_has_no_equilibrium(vehicle: FullVehicle) -> None:
    with pytest.raises(NoEquilibriumError, match="check curve, cant"):
        steady(vehicle, 100.0, 0.0)


@pytest.mark.parametrize(
    ("points", "message"),
    [
        ([(0.0, 0.0, 0.0)], "points has 1"),
        ([(0.0, 0.0, 0.0), (0.0, 1e-3, 0.0)], "rising distances"),
        ([(0.0, 0.0, 0.0), (1.0, float("nan"), 0.0)], "curvature"),
        ([(0.0, 0.0, 0.0), (1.0, 1e-3, 0.3)], "cant"),
    ],
)
def test_lines_that_make_no_sense_are_refused(
    points: list[tuple[float, float, float]], message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        curved_line(points)
