"""The assembled matrices against a second implementation, force by force and body by body.

The library sums k r r^T over displacement rows. Here every spring, damper, wheel and actuator sits
at a point in space, displacements come from the cross product of a small rotation with the point,
every force acts on one body and its reaction on the other, and Newton's second law does the rest.
"""

import dataclasses

import numpy as np
import pytest
from numpy.typing import NDArray

from railenv.units import STANDARD_GRAVITY
from railenv.vehicle import (
    LateralVehicle,
    StateSpace,
    VehicleParameters,
    get_vehicle,
    lateral17,
    state_space,
)

Vector = NDArray[np.float64]

BOTH_SIDES = (-1.0, 1.0)
LAYOUTS = {"passive": (), "2": (1, 4), "4": (1, 2, 3, 4)}
# Sums of some ten products each: a few units of the last of 16 digits per summand.
ROUNDING = 1e-13


class Body:
    """A rigid body with small lateral motion, yaw and roll about its centre of gravity."""

    def __init__(self, name: str, motion: dict[str, float]) -> None:
        def pick(kind: str, suffix: str) -> float:
            return motion.get(f"{name}_{kind}{suffix}", 0.0)

        self.shift, self.speed = (np.array([0, pick("lateral", s), 0]) for s in ("", "_velocity"))
        self.turn, self.spin = (
            np.array([pick("roll", s), 0, pick("yaw", s)]) for s in ("", "_velocity")
        )
        self.force, self.moment = np.zeros(3), np.zeros(3)

    def displacement(self, point: Vector) -> Vector:
        return self.shift + np.cross(self.turn, point)

    def velocity(self, point: Vector) -> Vector:
        return self.speed + np.cross(self.spin, point)

    def push(self, point: Vector, force: Vector) -> None:
        self.force = self.force + force
        self.moment = self.moment + np.cross(point, force)


def push_apart(upper: Body, lower: Body, here: Vector, there: Vector, force: Vector) -> None:
    """Act with a force on the upper body and with its reaction on the lower body."""
    upper.push(here, force)
    lower.push(there, -force)


def spring(
    upper: Body, lower: Body, here: Vector, there: Vector, stiffness: Vector, damping: Vector
) -> None:
    stretch = upper.displacement(here) - lower.displacement(there)
    rate = upper.velocity(here) - lower.velocity(there)
    push_apart(upper, lower, here, there, -stiffness * stretch - damping * rate)


def wheel_on_rail(
    wheelset: Body, p: VehicleParameters, speed: float, alignment: float, roll: float
) -> None:
    """Kalker's linear creep at each of the two wheels, gravity for the whole wheelset."""
    weight = STANDARD_GRAVITY * (p.carbody_mass / 4 + p.bogie_mass / 2 + p.wheelset_mass)
    offset, yaw = wheelset.shift[1] - alignment, wheelset.turn[2]
    lateral_creepage = wheelset.speed[1] / speed - yaw
    spin_creepage = wheelset.spin[2] / speed
    for side in BOTH_SIDES:
        wheel = np.array([0.0, side * p.half_contact_spacing, 0.0])
        # The wheel towards which the wheelset has shifted rolls on a larger radius and runs ahead.
        radius = p.wheel_radius + side * p.conicity * offset
        slip = wheelset.velocity(wheel)[0] + speed * (1.0 - radius / p.wheel_radius)
        creep_force = np.array(
            [
                -p.creep_longitudinal * slip / speed,
                -p.creep_lateral * lateral_creepage - p.creep_lateral_spin * spin_creepage,
                0.0,
            ]
        )
        wheelset.push(wheel, creep_force)
        wheelset.moment[2] += p.creep_lateral_spin * lateral_creepage - p.creep_spin * spin_creepage
    wheelset.force[1] -= weight * p.conicity / p.half_contact_spacing * offset
    wheelset.force[1] += weight * roll
    wheelset.moment[2] += weight * p.half_contact_spacing * p.conicity * yaw


def newton(
    p: VehicleParameters,
    actuators: tuple[int, ...],
    speed: float,
    x: dict[str, float],
    u: dict[str, float],
) -> dict[str, float]:
    """Return the rate of every state from Newton's second law."""
    at = np.array
    carbody = Body("carbody", x)
    bogies = {j: Body(f"bogie{j}", x) for j in (1, 2)}
    wheelsets = {i: Body(f"wheelset{i}", x) for i in (1, 2, 3, 4)}
    rates: dict[str, float] = {}

    for i, wheelset in wheelsets.items():
        # A wheelset rolls with the track below it.
        wheelset.turn[0], wheelset.spin[0] = u[f"track_roll_{i}"], u[f"track_roll_{i}_rate"]
        wheel_on_rail(wheelset, p, speed, u[f"alignment_{i}"], u[f"track_roll_{i}"])
        ahead = p.half_wheelbase if i in (1, 3) else -p.half_wheelbase
        for side in BOTH_SIDES:
            box = side * p.half_primary_spacing
            spring(
                bogies[1 if i < 3 else 2],
                wheelset,
                at([ahead, box, p.bogie_to_primary_height]),
                at([0.0, box, 0.0]),
                at(
                    [
                        p.primary_longitudinal_stiffness,
                        p.primary_lateral_stiffness,
                        p.primary_vertical_stiffness,
                    ]
                ),
                at([0.0, p.primary_lateral_damping, p.primary_vertical_damping]),
            )

    for j, bogie in bogies.items():
        pivot = p.half_bogie_spacing if j == 1 else -p.half_bogie_spacing
        for side in BOTH_SIDES:
            seat = side * p.half_secondary_spacing
            spring(
                carbody,
                bogie,
                at([pivot, seat, p.carbody_to_secondary_height]),
                at([0.0, seat, p.bogie_to_secondary_height]),
                at(
                    [
                        p.secondary_longitudinal_stiffness,
                        p.secondary_lateral_stiffness,
                        p.secondary_vertical_stiffness,
                    ]
                ),
                at([0.0, p.secondary_lateral_damping, p.secondary_vertical_damping]),
            )
        couple = p.antiroll_stiffness * (carbody.turn[0] - bogie.turn[0])
        carbody.moment[0] -= couple
        bogie.moment[0] += couple
        for side, word in zip(BOTH_SIDES, ("left", "right"), strict=True):
            here = at([pivot, side * p.half_yaw_damper_spacing, 0.0])
            there = at([0.0, side * p.half_yaw_damper_spacing, 0.0])
            node = f"bogie{j}_yaw_damper_{word}_node"
            stretch = (carbody.displacement(here) - bogie.displacement(there))[0]
            pull = p.yaw_damper_stiffness * (stretch - x[node])
            rates[node] = pull / p.yaw_damper_damping
            push_apart(carbody, bogie, here, there, at([-pull, 0.0, 0.0]))

    ends = {1: (1, 1.0, 1.0), 2: (1, 1.0, -1.0), 3: (2, -1.0, 1.0), 4: (2, -1.0, -1.0)}
    for k, (j, front, leading) in ends.items():
        ahead = leading * p.damper_offset
        here = at([front * p.half_bogie_spacing + ahead, 0.0, p.carbody_to_damper_height])
        there = at([ahead, 0.0, p.bogie_to_damper_height])
        if k in actuators:
            push = u[f"actuator_force_{k}"]
        else:
            stretch = (carbody.displacement(here) - bogies[j].displacement(there))[1]
            push = -p.lateral_damper_stiffness * (stretch - x[f"lateral_damper_{k}_node"])
            rates[f"lateral_damper_{k}_node"] = -push / p.lateral_damper_damping
        push_apart(carbody, bogies[j], here, there, at([0.0, push, 0.0]))

    inertias = [("carbody", carbody, p.carbody_mass, p.carbody_yaw_inertia, p.carbody_roll_inertia)]
    for j, bogie in bogies.items():
        row = (f"bogie{j}", bogie, p.bogie_mass, p.bogie_yaw_inertia, p.bogie_roll_inertia)
        inertias.append(row)
    for i, wheelset in wheelsets.items():
        row = (f"wheelset{i}", wheelset, p.wheelset_mass, p.wheelset_yaw_inertia, np.inf)
        inertias.append(row)
    for name, body, mass, yaw_inertia, roll_inertia in inertias:
        rates[f"{name}_lateral_velocity"] = body.force[1] / mass
        rates[f"{name}_yaw_velocity"] = body.moment[2] / yaw_inertia
        rates[f"{name}_roll_velocity"] = body.moment[0] / roll_inertia
    for name in list(rates):
        if name.endswith("_velocity"):
            rates[name.removesuffix("_velocity")] = x.get(name, 0.0)
    return rates


def random_parameters(rng: np.random.Generator) -> VehicleParameters:
    """Every number of the catalogued vehicle times 0.5 to 2; the zeros replaced by 5 kN s/m."""
    values = dataclasses.asdict(get_vehicle("paper_fit").parameters)
    return VehicleParameters(
        **{name: (value or 5e3) * 2.0 ** rng.uniform(-1, 1) for name, value in values.items()}
    )


def worst_disagreement(
    vehicle: LateralVehicle, system: StateSpace, rng: np.random.Generator
) -> tuple[float, str]:
    """Largest error over the states of one random motion, in shares of the summands' sizes."""
    x, u = rng.normal(size=len(system.states)), rng.normal(size=len(system.inputs))
    expected = newton(
        vehicle.parameters,
        LAYOUTS[vehicle.layout],
        vehicle.speed,
        dict(zip(system.states, x, strict=True)),
        dict(zip(system.inputs, u, strict=True)),
    )
    found = system.A @ x + system.B @ u
    size = np.abs(system.A) @ np.abs(x) + np.abs(system.B) @ np.abs(u)
    errors = [
        (abs(found[k] - expected[name]) / size[k], name) for k, name in enumerate(system.states)
    ]
    return max(errors)


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("name", ["paper_fit", "published_typical"])
@pytest.mark.parametrize("speed_kmh", [20.0, 160.0, 300.0, 450.0])
def test_catalogued_vehicle_obeys_newtons_second_law(
    name: str, layout: str, speed_kmh: float
) -> None:
    vehicle = lateral17(name, layout, speed_kmh)
    rng = np.random.default_rng(1)
    error, where = worst_disagreement(vehicle, state_space(vehicle), rng)
    assert error < ROUNDING, where


@pytest.mark.parametrize("layout", LAYOUTS)
@pytest.mark.parametrize("seed", range(20))
def test_vehicle_with_random_parameters_obeys_newtons_second_law(seed: int, layout: str) -> None:
    rng = np.random.default_rng(seed)
    vehicle = lateral17(random_parameters(rng), layout, rng.uniform(10.0, 500.0))
    error, where = worst_disagreement(vehicle, state_space(vehicle), rng)
    assert error < ROUNDING, where


@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_entry_of_both_matrices_follows_from_newtons_second_law(layout: str) -> None:
    vehicle = lateral17(random_parameters(np.random.default_rng(99)), layout, 250.0)
    system = state_space(vehicle)
    names = (*system.states, *system.inputs)
    columns = []
    for active in names:
        x = {name: float(name == active) for name in system.states}
        u = {name: float(name == active) for name in system.inputs}
        rates = newton(vehicle.parameters, LAYOUTS[layout], vehicle.speed, x, u)
        columns.append([rates[name] for name in system.states])
    # Opposite summands of one entry leave their rounding: gravity against spin on wheelset yaw.
    np.testing.assert_allclose(
        np.hstack([system.A, system.B]), np.transpose(columns), rtol=1e-11, atol=1e-9
    )
