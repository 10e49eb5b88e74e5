"""Energy of the simulated 50-coordinate vehicle without friction, input and dampers."""

from itertools import pairwise

import numpy as np
import pytest

from railenv.contact.table import touch
from railenv.simulation.full_run import FullSimulation
from railenv.units import FloatArray
from railenv.vehicle.nonlinear import ContactSettings, FullVehicle, equilibrium, full50
from railenv.vehicle.nonlinear.coordinates import BODIES, FIRST_WHEELSET, coordinate_index
from railenv.vehicle.nonlinear.elements import stops

N = 50
NONE = np.zeros((1, 0))
PERIOD = 0.01


def stop_energy(vehicle: FullVehicle, q: FloatArray) -> float:
    """Work stored in the bump stops: the table's integral, its last slope going on."""
    gaps, forces = np.array(vehicle.parameters.bump_stop).T
    total = 0.0
    for stop in stops(vehicle.parameters):
        size = abs(float(stop.row @ q))
        inside = gaps < size
        places = np.append(gaps[inside], size)
        slope = (forces[-1] - forces[-2]) / (gaps[-1] - gaps[-2])
        beyond = forces[-1] + slope * max(0.0, size - gaps[-1])
        values = np.interp(places, gaps, forces)
        values[-1] = beyond if size > gaps[-1] else values[-1]
        total += float(np.trapezoid(values, places))
    return total


def contact_energy(vehicle: FullVehicle, q: FloatArray) -> float:
    """2/5 k p^(5/2) of every wheel and zone."""
    total = 0.0
    for i in range(4):
        _, y, z, roll, _, yaw = q[FIRST_WHEELSET + 6 * i : FIRST_WHEELSET + 6 * i + 6]
        for sign in (-1.0, 1.0):
            for zone in (0, 1):
                h, _, _, _, k, _, _, _ = touch(
                    vehicle.contact_arrays, zone, sign * y, sign * roll, sign * yaw
                )
                total += 0.4 * k * max(0.0, z - h) ** 2.5
    return total


def energy(vehicle: FullVehicle, state: FloatArray) -> float:
    """Kinetic energy and everything stored [J]; springs in K hold the preloads' part."""
    q, v = state[:N], state[N : 2 * N]
    total = 0.5 * float(vehicle.arrays.mass @ v**2 + q @ vehicle.stiffness @ q)
    total -= float(vehicle.arrays.load @ q)
    for k, damper in enumerate(vehicle.nodes):
        total += 0.5 * damper.stiffness * float(damper.row @ q - state[2 * N + k]) ** 2
    return total + stop_energy(vehicle, q) + contact_energy(vehicle, q)


def undamped(vehicle: FullVehicle) -> FullVehicle:
    """The vehicle without any damper: one whose spring in series is zero is left out."""
    p = vehicle.parameters
    lateral = p.lateral.replace(
        primary_lateral_damping=0.0,
        primary_vertical_damping=0.0,
        secondary_lateral_damping=0.0,
        secondary_vertical_damping=0.0,
        yaw_damper_stiffness=0.0,
        lateral_damper_stiffness=0.0,
    )
    parameters = p.replace(lateral=lateral, arm_damping=0.0, coupler_damping=0.0)
    return vehicle.replace(parameters=parameters)


@pytest.fixture(scope="module")
def smooth() -> FullVehicle:
    """No friction; dampers and the contact's damping are there."""
    return full50("paper_fit", "passive", 300.0, ContactSettings(friction=0.0))


@pytest.fixture(scope="module")
def conservative() -> FullVehicle:
    return undamped(
        full50("paper_fit", "passive", 300.0, ContactSettings(friction=0.0, damping=0.0))
    )


def disturbed(vehicle: FullVehicle, *, rise: float = 0.0, roll: float = 0.0) -> FloatArray:
    """Steady rolling, moved by millimetres and milliradians, and raised or rolled on top."""
    rng = np.random.default_rng(1)
    state = equilibrium(vehicle).state.copy()
    for body in BODIES:
        at = coordinate_index(f"{body}_lateral")
        state[at] += 2e-3 * rng.standard_normal()
        state[at + 1] += 1e-4 * rng.standard_normal() - rise
        state[at + 2] += 1e-4 * rng.standard_normal() + roll
        state[at + 4] += 1e-3 * rng.standard_normal()
    for k, damper in enumerate(vehicle.nodes):
        state[2 * N + k] = damper.row @ state[:N]
    return state


def history(
    vehicle: FullVehicle, start: FloatArray, seconds: float, time_step: float
) -> tuple[FloatArray, FloatArray]:
    """Energy at the start and after every hundredth of a second, and the wheels' loads."""
    simulation = FullSimulation(
        vehicle, ["carbody_lateral"], record_step=PERIOD, time_step=time_step
    )
    simulation.reset(NONE, initial_state=start)
    found, loads = [energy(vehicle, start)], []
    for _ in range(round(seconds / PERIOD)):
        simulation.advance(NONE)
        found.append(energy(vehicle, simulation.state[0]))
        loads.append(simulation.wheels[0, :, 0])
    assert not simulation.ended.any()
    return np.array(found), np.array(loads)


def stored(vehicle: FullVehicle, start: FloatArray) -> float:
    """Energy of a start over that of steady rolling [J]."""
    return energy(vehicle, start) - energy(vehicle, equilibrium(vehicle).state)


@pytest.mark.parametrize("rise", [0.0, 3e-3])
def test_energy_never_grows_without_friction_and_input(smooth: FullVehicle, rise: float) -> None:
    start = disturbed(smooth, rise=rise)
    found, _ = history(smooth, start, 3.0, 5e-4)
    # The steps' own error may add this much between two looks: 1e-9 of what is stored.
    assert np.diff(found).max() < 1e-9 * stored(smooth, start)
    assert found[-1] - found[0] < -0.5 * stored(smooth, start)


def test_energy_drifts_with_the_fifth_power_of_the_step_while_forces_are_smooth(
    conservative: FullVehicle,
) -> None:
    # Micrometres: no wheel lifts and no cell of the contact table is left. A Runge-Kutta step of
    # order 4 multiplies the energy of an oscillation by 1 - (omega h)^6 / 72.
    rest = equilibrium(conservative).state
    start = rest + 0.003 * (disturbed(conservative) - rest)
    drifts = [
        float(np.abs(np.diff(history(conservative, start, 0.2, h)[0])).sum())
        for h in (2.5e-4, 1.25e-4, 6.25e-5)
    ]
    for coarse, fine in pairwise(drifts):
        assert coarse / fine == pytest.approx(32.0, rel=0.1)


@pytest.mark.parametrize(
    ("rise", "roll", "lifted"),
    [(0.0, 0.0, "none"), (3e-3, 0.0, "both"), (3.2e-3, 4e-3, "one")],
)
def test_energy_is_conserved_to_the_integrators_order_without_dampers(
    conservative: FullVehicle, rise: float, roll: float, lifted: str
) -> None:
    start = disturbed(conservative, rise=rise, roll=roll)
    drifts: list[float] = []
    for time_step in (5e-4, 2.5e-4, 1.25e-4):
        found, loads = history(conservative, start, 0.3, time_step)
        drifts.append(float(np.abs(found - found[0]).max()) / stored(conservative, start))
        gone = loads.reshape(-1, 4, 2) == 0.0
        assert bool(gone.any()) == (lifted != "none")
        # Loads are means over a hundredth of a second: in the first, one wheel of an axle or none.
        if lifted == "both":
            assert gone.all(axis=2).any()
        if lifted == "one":
            assert gone[0].any()
            assert not gone[0].all(axis=1).any()
    # Fourth order would be a factor of 256 over two halvings. A wheel that touches (force p^1.5)
    # and the cells of the contact table (two continuous derivatives) are less smooth than that.
    assert drifts[0] < 0.2
    assert drifts[0] / drifts[2] > 100.0
    assert drifts[2] < 5e-4


def test_bump_stops_store_what_they_take(conservative: FullVehicle) -> None:
    start = disturbed(conservative)
    carbody = coordinate_index("carbody_lateral")
    start[carbody] += 0.045  # into the stops of both bogies
    found, _ = history(conservative, start, 0.5, 1.25e-4)
    assert stop_energy(conservative, start[:N]) > 500.0
    # Kinks of the table cost a step of fourth order some accuracy.
    assert np.abs(found - found[0]).max() < 2e-3 * stored(conservative, start)


def test_an_axles_spin_turns_energy_around_and_makes_none(conservative: FullVehicle) -> None:
    quick = conservative.replace(
        parameters=conservative.parameters.replace(wheelset_pitch_inertia=760.0)
    )
    start = disturbed(quick, rise=3e-3)
    found, _ = history(quick, start, 0.3, 6.25e-5)
    plain, _ = history(conservative, disturbed(conservative, rise=3e-3), 0.3, 6.25e-5)
    drift, other = (float(np.abs(e - e[0]).max()) for e in (found, plain))
    assert drift < 3.0 * other + 1e-6
