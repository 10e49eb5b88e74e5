"""The simulated 50-coordinate vehicle against closed forms, the lateral model and finer steps."""

from itertools import pairwise

import numpy as np
import pytest

from eval.full50_table import comparable, cone_contact
from railenv.errors import ArgumentError
from railenv.simulation import LateralSimulation, wheelset_inputs
from railenv.simulation.full_run import FullSimulation
from railenv.track import Track, make_track
from railenv.units import FloatArray
from railenv.vehicle import VehicleParameters, get_vehicle, lateral17
from railenv.vehicle.nonlinear import (
    ContactSettings,
    FullParameters,
    FullVehicle,
    equilibrium,
    full50,
    linearised,
)
from railenv.vehicle.nonlinear.coordinates import coordinate_index

pytestmark = pytest.mark.slow

NONE = np.zeros((1, 0))
FLOOR = tuple(
    f"floor_{end}_{way}_acceleration"
    for way in ("lateral", "vertical")
    for end in ("front", "rear")
)


@pytest.fixture(scope="module")
def parameters() -> VehicleParameters:
    return get_vehicle("paper_fit").parameters


def recorded(
    vehicle: FullVehicle,
    outputs: tuple[str, ...],
    seconds: float,
    track: Track | None = None,
    **settings: float,
) -> FloatArray:
    """Outputs of an uncontrolled run, shape (records, outputs)."""
    simulation = FullSimulation(vehicle, outputs, **settings)
    simulation.reset(np.zeros((1, vehicle.num_actuators)), [] if track is None else [track])
    command = np.zeros((1, vehicle.num_actuators))
    found = [simulation.advance(command)[0] for _ in range(round(seconds / 0.01))]
    assert not simulation.ended.any()
    return np.concatenate(found)


def free_wheelset(parameters: VehicleParameters, *, roll_coupling: bool) -> FullVehicle:
    """Wheelsets with next to no suspension under the whole axle load, at 36 km/h."""
    soft = {f"primary_{way}_stiffness": 100.0 for way in ("longitudinal", "lateral", "vertical")}
    lateral = parameters.replace(primary_lateral_damping=0.0, primary_vertical_damping=0.0, **soft)
    full = FullParameters(lateral=lateral, arm_stiffness=100.0, arm_damping=0.0)
    return full50(
        full,
        "passive",
        36.0,
        cone_contact(parameters, 0.01, "given"),
        gravity_coupling=False,
        roll_coupling=roll_coupling,
    )


@pytest.mark.parametrize(("conicity", "roll"), [(0.17, True), (0.17, False), (0.1, True)])
def test_a_free_wheelset_follows_klingels_wavelength(
    parameters: VehicleParameters, conicity: float, *, roll: bool
) -> None:
    p = parameters.replace(conicity=conicity)
    vehicle = free_wheelset(p, roll_coupling=roll)
    start = equilibrium(vehicle).state.copy()
    for i in range(1, 5):
        start[coordinate_index(f"wheelset{i}_lateral")] = 1e-3
        # Both wheels go on touching: the right one runs on a larger circle and stands higher.
        start[coordinate_index(f"wheelset{i}_roll")] = -1e-3 * conicity / p.half_contact_spacing
    simulation = FullSimulation(
        vehicle, ["wheelset1_lateral"], control_period=0.01, record_step=0.01, time_step=1.25e-4
    )
    simulation.reset(NONE, initial_state=start)
    y = np.array([simulation.advance(NONE)[0, 0, 0] for _ in range(300)])
    last = np.flatnonzero(y[:-1] * y[1:] < 0.0)
    crossings = last + y[last] / (y[last] - y[last + 1])
    wavelength = 2.0 * np.diff(crossings).mean() * 0.01 * vehicle.speed
    klingel = 2.0 * np.pi * np.sqrt(p.wheel_radius * p.half_contact_spacing / conicity)
    # Inertia, growing with speed, is left out by the formula; 10 m/s leave 0.3 %.
    assert wavelength == pytest.approx(klingel, rel=0.01)
    assert 0.9e-3 < np.abs(y[-100:]).max() < 1.3e-3


def test_a_run_on_a_track_agrees_with_the_lateral_models(parameters: VehicleParameters) -> None:
    # A flat cone: what is left grows with the slope of the contact plane, see the table of modes.
    # Alignment only: cross level enters the wheelsets' roll, which the comparable vehicle lacks.
    p, seconds, step = parameters.replace(conicity=0.05), 8.0, 0.00125
    full, lateral = comparable(p), lateral17(p, "passive", 300.0)
    whole = make_track("tb3352", full.speed * (seconds + 1.0), 3)
    track = Track("alignment", whole.spacing, {"alignment": 0.2 * whole.channels["alignment"]})
    outputs = (*FLOOR[:2], "wheelset1_lateral")
    found = recorded(full, outputs, seconds, track)
    linear = LateralSimulation(lateral, outputs, time_step=step)
    inputs = wheelset_inputs(lateral, track, step, round(seconds / step))
    linear.reset(NONE, inputs[None])
    each = [linear.advance(NONE)[0, 3::4] for _ in range(round(seconds / 0.01))]
    wanted = np.concatenate(each)
    rms = np.sqrt(np.mean(wanted**2, axis=0))
    assert np.sqrt(np.mean(found**2, axis=0)) == pytest.approx(rms, rel=0.04)
    # Not only as much, but at the same time.
    assert np.all(np.sqrt(np.mean((found - wanted) ** 2, axis=0)) < 0.06 * rms)


@pytest.fixture(scope="module")
def on_steps() -> dict[float, FloatArray]:
    """Floor, bogie and wheelset accelerations at 300 km/h by physics step."""
    # A profile on which the vehicle runs straight: a hunting one would carry every difference on.
    vehicle = full50("paper_fit", 4, 300.0, ContactSettings(wheel="lma"))
    seconds = 3.0
    track = make_track("tb3352", vehicle.speed * (seconds + 1.0), 1)
    moving = [f"{body}_{way}_velocity" for body in ("bogie1", "wheelset1") for way in WAYS]
    found: dict[float, FloatArray] = {}
    for step in (1e-3, 5e-4, 2.5e-4, 1.25e-4):
        run = recorded(vehicle, (*FLOOR, *moving), seconds, track, time_step=step, record_step=1e-3)
        # Means over a millisecond.
        change = np.diff(run[:, len(FLOOR) :], axis=0) / 1e-3
        found[step] = np.concatenate([run[1:, : len(FLOOR)], change], axis=1)[500:]
    return found


WAYS = ("lateral", "vertical")


def test_halving_the_default_step_moves_no_rms_by_a_hundredth(
    on_steps: dict[float, FloatArray],
) -> None:
    rms = {step: np.sqrt(np.mean(a**2, axis=0)) for step, a in on_steps.items()}
    # What the project asks for; measured are 0.01 %, at twice the default step 0.5 %.
    np.testing.assert_allclose(rms[5e-4], rms[2.5e-4], rtol=1e-3)
    np.testing.assert_allclose(rms[1e-3], rms[1.25e-4], rtol=1e-2)


def test_accelerations_converge_with_the_step(on_steps: dict[float, FloatArray]) -> None:
    best = on_steps[1.25e-4]
    scale = np.sqrt(np.mean(best**2, axis=0))
    errors = [
        np.sqrt(np.mean((on_steps[step] - best) ** 2, axis=0)) / scale for step in (1e-3, 5e-4)
    ]
    assert errors[1].max() < 5e-3
    # Fourth order would be a factor of 16; the contact table's cells and the track's splines, both
    # with two continuous derivatives, cost some of it.
    assert np.median(errors[0] / errors[1]) > 6.0


@pytest.mark.parametrize("everything", [False, True])
def test_runge_kutta_is_of_fourth_order_on_a_smooth_problem(
    parameters: VehicleParameters, *, everything: bool
) -> None:
    contact = ContactSettings() if everything else cone_contact(parameters, 0.3, "given")
    vehicle = full50(parameters, "passive", 300.0, contact)
    rng = np.random.default_rng(2)
    start = equilibrium(vehicle).state.copy()
    start[50:100] += 1e-4 * rng.standard_normal(50)  # stays inside the cells of the contact table
    ends: list[FloatArray] = []
    for step in (5e-4, 2.5e-4, 1.25e-4, 6.25e-5):
        simulation = FullSimulation(vehicle, ["carbody_lateral"], time_step=step)
        simulation.reset(NONE, initial_state=start)
        for _ in range(4):
            simulation.advance(NONE)
        ends.append(simulation.state[0, :50])
    kept = [i for i, name in enumerate(vehicle.states[:50]) if not name.endswith("pitch")]
    changes = [np.abs(b - a)[kept].max() for a, b in pairwise(ends)]
    # Measured 3.7 to 4.8: the steps are not yet small against the contact's 1400 rad/s.
    for coarse, fine in pairwise(changes):
        assert np.log2(coarse / fine) > 3.5


def test_a_step_beyond_stability_is_refused() -> None:
    slow = full50("paper_fit", "passive", 20.0)
    with pytest.raises(ArgumentError, match="is too long at"):
        FullSimulation(slow, ["carbody_lateral"], time_step=1e-3)


def test_the_longest_allowed_step_is_stable_by_the_linearised_vehicle() -> None:
    vehicle = full50("paper_fit", "passive", 300.0, ContactSettings())
    size = np.abs(np.linalg.eigvals(linearised(vehicle)))
    # Runge-Kutta's region of stability reaches 2.78 along either axis.
    assert size.max() * 1e-3 < 2.5
