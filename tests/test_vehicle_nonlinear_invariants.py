"""What holds for the 50-coordinate vehicle whatever its numbers: weight, mirror image, power."""

import numpy as np
import pytest

from railenv.units import STANDARD_GRAVITY, FloatArray
from railenv.vehicle.nonlinear import (
    ContactSettings,
    Equilibrium,
    FullVehicle,
    equilibrium,
    full50,
    rate_of_change,
)
from railenv.vehicle.nonlinear.coordinates import FIRST_WHEELSET, coordinate_index

N = 50
SWAPPED = [1, 0, 3, 2, 5, 4, 7, 6]  # wheels: left and right
LAWS = ("linear", "fastsim-table", "fastsim", "polach", "shen-hedrick-elkins")


@pytest.fixture(scope="module")
def vehicle() -> FullVehicle:
    return full50("paper_fit", 2, 300.0, actuator_lag=0.005)


@pytest.fixture(scope="module")
def rolling(vehicle: FullVehicle) -> Equilibrium:
    return equilibrium(vehicle)


def test_rails_carry_the_weight_of_every_axle(vehicle: FullVehicle, rolling: Equilibrium) -> None:
    loads = rolling.wheels[:, 0].reshape(4, 2).sum(axis=1)
    p = vehicle.parameters.lateral
    mass = p.carbody_mass + 2 * p.bogie_mass + 4 * p.wheelset_mass
    # The project asks for 1e-6; the solver stops at 1e-10 of an axle load.
    assert loads.sum() == pytest.approx(mass * STANDARD_GRAVITY, rel=1e-9)
    # Spin holds the wheels back by some newtons; the train's pull at the carbody's height against
    # it moves 2e-6 of the load from the leading axles to the trailing ones or back.
    np.testing.assert_allclose(loads, p.axle_load, rtol=1e-5)
    rate, _ = rate_of_change(vehicle, rolling.state)
    assert np.abs(rate[N:]).max() < 1e-6 * STANDARD_GRAVITY


def test_steady_rolling_is_the_same_on_both_sides(rolling: Equilibrium) -> None:
    np.testing.assert_allclose(rolling.wheels, rolling.wheels[SWAPPED], rtol=1e-9, atol=1e-12)
    for body in ("carbody", "bogie1", "bogie2", "wheelset1", "wheelset4"):
        for motion in ("lateral", "roll", "yaw"):
            assert abs(rolling.state[coordinate_index(f"{body}_{motion}")]) < 1e-12


def mirrored(vehicle: FullVehicle) -> tuple[list[int], FloatArray]:
    """Where each state of the mirror image comes from, and its sign."""
    names = vehicle.states
    other = [n.replace("left", "#").replace("right", "left").replace("#", "right") for n in names]
    odd = ("lateral", "roll", "yaw", "actuator_force")
    # A yaw damper stretches along the track, so its node has no sign; a lateral one's changes.
    signs = [-1.0 if any(w in n for w in odd) and "yaw_damper" not in n else 1.0 for n in names]
    return [names.index(name) for name in other], np.array(signs)


def test_the_mirror_image_of_a_motion_has_the_mirror_image_of_its_rates(
    vehicle: FullVehicle, rolling: Equilibrium
) -> None:
    source, sign = mirrored(vehicle)
    rng = np.random.default_rng(5)
    rail_sign = np.array([-1.0, 1.0, -1.0, 1.0])
    for size in (1e-5, 1e-4, 1e-3, 1e-2):  # from the tread to lift-off and flanges
        for _ in range(20):
            n = len(rolling.state)
            scale = np.concatenate([np.full(N, size), np.full(N, 100.0 * size)])
            scale = np.concatenate([scale, np.full(n - 2 * N, size)])
            scale[-vehicle.num_actuators :] = 1e6 * size
            state = rolling.state + scale * rng.standard_normal(n)
            rails = rng.standard_normal((8, 4)) * [size, size, 10 * size, 10 * size]
            command = 1e4 * rng.standard_normal(vehicle.num_actuators)
            rate, wheels = rate_of_change(vehicle, state, rails, command)
            image, image_wheels = rate_of_change(
                vehicle, sign * state[source], (rails * rail_sign)[SWAPPED], -command
            )
            # The same sums in another order.
            tolerance = 1e-13 * np.abs(rate).max()
            np.testing.assert_allclose(sign * rate[source], image, rtol=0, atol=tolerance)
            np.testing.assert_allclose(wheels[SWAPPED], image_wheels, rtol=1e-12)


def sliding_power(vehicle: FullVehicle, smooth: FullVehicle, state: FloatArray) -> float:
    """Power of the creep forces on what slides [W], drive included.

    The generalised forces are what friction changes. They also work on the vehicle's way along the
    track and on the wheels' nominal rotation, which the coordinates do not hold.
    """
    change = rate_of_change(vehicle, state)[0] - rate_of_change(smooth, state)[0]
    force = change[N : 2 * N] * vehicle.arrays.mass
    first = FIRST_WHEELSET + 6 * np.arange(4)
    radius = vehicle.parameters.lateral.wheel_radius
    drive = force[first].sum() - force[first + 4].sum() / radius
    return float(force @ state[N : 2 * N] + vehicle.speed * drive)


@pytest.mark.parametrize("law", LAWS)
def test_creep_forces_only_take_power_away(
    vehicle: FullVehicle, rolling: Equilibrium, law: str
) -> None:
    with_friction = vehicle.replace(contact=ContactSettings(law=law))
    smooth = vehicle.replace(contact=ContactSettings(friction=0.0))
    rng = np.random.default_rng(7)
    for creepage in (1e-5, 1e-4, 1e-3, 1e-2):
        for _ in range(15):
            state = rolling.state.copy()
            for i in range(4):
                b = FIRST_WHEELSET + 6 * i
                state[b + 1] += rng.uniform(-6e-3, 6e-3)  # up to the flange
                state[b + 5] += creepage * rng.standard_normal()
                rates = rng.standard_normal(6) * np.array([0.3, 1.0, 0.01, 0.1, 0.3, 1.0])
                state[N + b : N + b + 6] += creepage * vehicle.speed * rates
            assert sliding_power(with_friction, smooth, state) < 0.0


def test_the_contacts_damping_only_takes_power_away(
    vehicle: FullVehicle, rolling: Equilibrium
) -> None:
    # Its force is -k p^1.5 alpha p' along the same path that p' is measured on.
    damped, free = (
        vehicle.replace(contact=ContactSettings(friction=0.0, damping=d)) for d in (1.5, 0.0)
    )
    rng = np.random.default_rng(11)
    for _ in range(50):
        state = rolling.state.copy()
        for i in range(4):
            b = FIRST_WHEELSET + 6 * i
            state[b + 1] += rng.uniform(-8e-3, 8e-3)
            state[N + b : N + b + 6] += 0.05 * rng.standard_normal(6)
        change = rate_of_change(damped, state)[0] - rate_of_change(free, state)[0]
        power = (change[N : 2 * N] * vehicle.arrays.mass) @ state[N : 2 * N]
        assert power < 0.0
        # A vehicle and rails that move sideways together do not squeeze the contact.
        moved = state.copy()
        moved[N + FIRST_WHEELSET + 1 : N + FIRST_WHEELSET + 24 : 6] += 0.1
        rails = np.zeros((8, 4))
        rails[:, 2] = 0.1
        along = rate_of_change(damped, moved, rails)[0] - rate_of_change(free, moved, rails)[0]
        np.testing.assert_allclose(along[N:], change[N:], rtol=0, atol=1e-9)


def test_without_friction_rails_do_not_hold_a_wheel_along_the_track(
    vehicle: FullVehicle, rolling: Equilibrium
) -> None:
    smooth = vehicle.replace(contact=ContactSettings(friction=0.0))
    state = rolling.state.copy()
    free = rate_of_change(smooth, state)[0][N:]
    state[N + FIRST_WHEELSET] += 1.0  # a wheel that slides forward at 1 m/s
    state[N + FIRST_WHEELSET + 4] += 1.0
    change = rate_of_change(smooth, state)[0][N:] - free
    assert abs(change[FIRST_WHEELSET]) < 1e-9
    assert abs(change[FIRST_WHEELSET + 4]) < 1e-9


def test_a_lifted_wheelset_is_not_touched_by_the_rails(
    vehicle: FullVehicle, rolling: Equilibrium
) -> None:
    state = rolling.state.copy()
    state[FIRST_WHEELSET + 2] -= 5e-3
    _, wheels = rate_of_change(vehicle, state)
    assert not np.any(wheels[:2, :4])
    assert np.all(wheels[2:, 0] > 0.0)
