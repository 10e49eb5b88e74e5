"""Names, inputs and outputs of the state space; each output against its definition."""

import re

import numpy as np
import pytest
from numpy.typing import NDArray

from railenv.actuation.hold import held_input
from railenv.errors import ArgumentError
from railenv.vehicle import StateSpace, get_vehicle, lateral17, state_space

Vector = NDArray[np.float64]

PAPER = get_vehicle("paper_fit").parameters
LAYOUTS = {"passive": (), "2": (1, 4), "4": (1, 2, 3, 4)}
GRAVITY = 9.80665
# Damper places ahead of the carbody's centre: +-L_c +- L_d [m]; floor above the bogie centres.
PLACES = {1: 8.69 + 0.27, 2: 8.69 - 0.27, 3: -8.69 + 0.27, 4: -8.69 - 0.27}
FLOORS = {"front": 8.69, "rear": -8.69}
DAMPER_HEIGHT, FRAME_HEIGHT, FLOOR_HEIGHT = 0.922, -0.147, 0.379


def expected_outputs(
    layout: str, x: dict[str, float], rate: dict[str, float], u: dict[str, float], g: float
) -> dict[str, float]:
    """Return every output from its definition; `g` is zero for kinematic accelerometers."""

    def carbody(at: float, height: float, kind: str = "", of: dict[str, float] = x) -> float:
        lateral, yaw, roll = (of[f"carbody_{m}{kind}"] for m in ("lateral", "yaw", "roll"))
        return lateral + at * yaw - height * roll

    def stroke(k: int, kind: str = "") -> float:
        bogie, end = (1 if k < 3 else 2), (0.27 if k in (1, 3) else -0.27)
        lateral, yaw, roll = (x[f"bogie{bogie}_{m}{kind}"] for m in ("lateral", "yaw", "roll"))
        frame = lateral + end * yaw - FRAME_HEIGHT * roll
        return carbody(PLACES[k], DAMPER_HEIGHT, kind) - frame

    tilt = g * x["carbody_roll"]
    y: dict[str, float] = {}
    for k, at in PLACES.items():
        y[f"carbody_lateral_velocity_{k}"] = carbody(at, DAMPER_HEIGHT, "_velocity")
        there = carbody(at, DAMPER_HEIGHT, "_velocity", rate)
        y[f"carbody_lateral_acceleration_{k}"] = there - tilt
        y[f"suspension_stroke_{k}"] = stroke(k)
        y[f"suspension_stroke_rate_{k}"] = stroke(k, "_velocity")
        if k in LAYOUTS[layout]:
            y[f"actuator_force_{k}"] = u[f"actuator_force_{k}"]
        else:
            y[f"lateral_damper_{k}_force"] = 4.5e6 * (stroke(k) - x[f"lateral_damper_{k}_node"])
    for j in (1, 2):
        y[f"bogie{j}_lateral_acceleration"] = (
            rate[f"bogie{j}_lateral_velocity"] - g * x[f"bogie{j}_roll"]
        )
        yaw = x["carbody_yaw"] - x[f"bogie{j}_yaw"]
        for side, w in (("left", -1.32), ("right", 1.32)):
            node = x[f"bogie{j}_yaw_damper_{side}_node"]
            y[f"bogie{j}_yaw_damper_{side}_force"] = 8.8e6 * (-w * yaw - node)
    for body in ("carbody", "bogie1", "bogie2"):
        for motion in ("roll", "yaw"):
            y[f"{body}_{motion}_rate"] = x[f"{body}_{motion}_velocity"]
    for end, at in FLOORS.items():
        y[f"floor_{end}_lateral_displacement"] = carbody(at, FLOOR_HEIGHT)
        there = carbody(at, FLOOR_HEIGHT, "_velocity", rate)
        y[f"floor_{end}_lateral_acceleration"] = there - tilt
    for motion in ("lateral", "yaw", "roll"):
        y[f"carbody_{motion}_acceleration"] = rate[f"carbody_{motion}_velocity"]
    for w in (1, 2, 3, 4):
        y[f"wheelset{w}_rail_offset"] = x[f"wheelset{w}_lateral"] - u[f"alignment_{w}"]
        for met in (f"alignment_{w}", f"track_roll_{w}"):
            y[met] = u[met]
    return y


def random_point(system: StateSpace) -> tuple[Vector, Vector]:
    rng = np.random.default_rng(5)
    return rng.normal(size=len(system.states)), rng.normal(size=len(system.inputs))


@pytest.mark.parametrize("specific_force", [False, True])
@pytest.mark.parametrize("layout", LAYOUTS)
def test_every_output_equals_its_definition(layout: str, specific_force: bool) -> None:
    system = state_space(lateral17(layout=layout), specific_force=specific_force)
    x, u = random_point(system)
    expected = expected_outputs(
        layout,
        dict(zip(system.states, x, strict=True)),
        dict(zip(system.states, system.A @ x + system.B @ u, strict=True)),
        dict(zip(system.inputs, u, strict=True)),
        GRAVITY if specific_force else 0.0,
    )
    found = dict(zip(system.outputs, system.C @ x + system.D @ u, strict=True))
    size = dict(
        zip(
            system.outputs, np.abs(system.C) @ np.abs(x) + np.abs(system.D) @ np.abs(u), strict=True
        )
    )
    assert found.keys() == expected.keys()
    # sums in another order: rounding in shares of the summands
    wrong = {k: v for k, v in found.items() if abs(v - expected[k]) > 1e-12 * size[k]}
    assert not wrong


def test_specific_force_changes_accelerometers_by_gravity_times_roll_and_nothing_else() -> None:
    vehicle = lateral17()
    kinematic, specific = state_space(vehicle), state_space(vehicle, specific_force=True)
    changed = {
        (kinematic.outputs[row], kinematic.states[column])
        for row, column in np.argwhere(kinematic.C != specific.C)
    }
    places = [f"carbody_lateral_acceleration_{k}" for k in (1, 2, 3, 4)]
    floors = [f"floor_{end}_lateral_acceleration" for end in FLOORS]
    frames = {(f"bogie{j}_lateral_acceleration", f"bogie{j}_roll") for j in (1, 2)}
    assert changed == {(name, "carbody_roll") for name in places + floors} | frames


@pytest.mark.parametrize("end", FLOORS)
def test_floor_acceleration_is_the_second_derivative_of_floor_displacement(end: str) -> None:
    system = state_space(lateral17(layout="passive"))
    x, u = random_point(system)
    u[len(system.inputs) // 2 :] = 0.0  # a constant track has no rates
    step = 1e-5
    ahead = held_input(system.A, system.B, step)
    back = held_input(system.A, system.B, -step)
    row = system.outputs.index(f"floor_{end}_lateral_displacement")

    def displacement(transition: tuple[Vector, Vector]) -> float:
        return float(system.C[row] @ (transition[0] @ x + transition[1] @ u))

    now = float(system.C[row] @ x)
    difference = (displacement(ahead) - 2 * now + displacement(back)) / step**2
    rows, through = system.output_rows((f"floor_{end}_lateral_acceleration",))
    # the difference drops step^2 times the fourth derivative and keeps rounding / step^2 = 1e-5
    assert difference == pytest.approx(float((rows @ x + through @ u)[0]), rel=1e-4)


@pytest.mark.parametrize(("layout", "states"), [("passive", 42), ("2", 40), ("4", 38)])
def test_state_has_17_coordinates_their_velocities_and_one_node_per_damper(
    layout: str, states: int
) -> None:
    assert len(state_space(lateral17(layout=layout)).states) == states


def test_velocity_states_are_the_rates_of_the_coordinates() -> None:
    system = state_space(lateral17())
    for name in system.states:
        if not name.endswith("_velocity"):
            continue
        row = system.A[system.states.index(name.removesuffix("_velocity"))]
        assert np.flatnonzero(row).tolist() == [system.states.index(name)]


@pytest.mark.parametrize("layout", LAYOUTS)
def test_inputs_are_forces_then_track_then_track_rates(layout: str) -> None:
    track = [f"{kind}_{w}" for kind in ("alignment", "track_roll") for w in (1, 2, 3, 4)]
    forces = [f"actuator_force_{k}" for k in LAYOUTS[layout]]
    rates = [f"{name}_rate" for name in track]
    assert state_space(lateral17(layout=layout)).inputs == (*forces, *track, *rates)


@pytest.mark.parametrize("layout", ["2", "4"])
def test_actuator_pushes_the_carbody_and_pulls_the_bogie(layout: str) -> None:
    system = state_space(lateral17(layout=layout))
    for channel, position in enumerate(LAYOUTS[layout]):
        force = dict(zip(system.states, system.actuator_input[:, channel], strict=True))
        assert force["carbody_lateral_velocity"] == pytest.approx(1 / 40390.0, rel=1e-15)
        bogie = 1 if position < 3 else 2
        assert force[f"bogie{bogie}_lateral_velocity"] == pytest.approx(-1 / 2200.0, rel=1e-15)


def test_actuator_above_and_below_the_centres_of_gravity_rolls_both_bodies() -> None:
    system = state_space(lateral17())
    force = dict(zip(system.states, system.actuator_input[:, 0], strict=True))
    # It acts 0.922 m below the carbody's centre of gravity and 0.147 m above the bogie's.
    expected = (-0.922 / 127681.0, -0.147 / 1236.0)
    rolls = force["carbody_roll_velocity"], force["bogie1_roll_velocity"]
    # rounding of one division
    assert rolls == pytest.approx(expected, rel=1e-15)


def test_damper_acts_where_the_actuator_does() -> None:
    passive, active = state_space(lateral17(layout="passive")), state_space(lateral17())
    node = passive.A[:34, passive.states.index("lateral_damper_3_node")]
    # the node's pull is the spring's stiffness times the actuator's column: rounding
    np.testing.assert_allclose(node, 4.5e6 * active.actuator_input[:34, 2], rtol=1e-14)


@pytest.mark.parametrize("wheelset", [1, 2, 3, 4])
def test_alignment_acts_on_its_own_wheelset_only(wheelset: int) -> None:
    system = state_space(lateral17())
    column = system.B[:, system.inputs.index(f"alignment_{wheelset}")]
    names = {system.states[k] for k in np.flatnonzero(column)}
    assert names == {f"wheelset{wheelset}_{m}_velocity" for m in ("lateral", "yaw")}


@pytest.mark.parametrize("wheelset", [1, 2, 3, 4])
def test_track_roll_acts_on_its_own_wheelset_and_the_frame_above(wheelset: int) -> None:
    system = state_space(lateral17())
    column = system.B[:, system.inputs.index(f"track_roll_{wheelset}")]
    bogie = 1 if wheelset < 3 else 2
    names = {system.states[k] for k in np.flatnonzero(column)}
    assert names == {f"wheelset{wheelset}_lateral_velocity", f"bogie{bogie}_roll_velocity"}


def test_rate_of_alignment_has_no_effect_since_the_rail_does_not_move_sideways() -> None:
    system = state_space(lateral17())
    rates = [k for k, name in enumerate(system.inputs) if re.match(r"alignment_\d_rate", name)]
    assert len(rates) == 4
    assert not system.B[:, rates].any()


def test_track_that_drops_on_the_right_pushes_the_wheelset_to_the_right() -> None:
    system = state_space(lateral17())
    row = system.states.index("wheelset1_lateral_velocity")
    push = system.B[row, system.inputs.index("track_roll_1")] * 1900.0
    # axle load W: a quarter of 40390, half of 2200, and 1900 kg; rounding
    assert push == pytest.approx(GRAVITY * (10097.5 + 1100.0 + 1900.0), rel=1e-14)


def test_output_rows_pick_states_as_well() -> None:
    system = state_space(lateral17())
    rows, through = system.output_rows(("carbody_roll", "suspension_stroke_2"))
    assert np.flatnonzero(rows[0]).tolist() == [system.states.index("carbody_roll")]
    assert np.array_equal(rows[1], system.C[system.outputs.index("suspension_stroke_2")])
    assert not through.any()


def test_unknown_output_names_the_nearest_ones() -> None:
    with pytest.raises(ArgumentError, match="suspension_stroke_1"):
        state_space(lateral17()).output_rows(("suspension_strok_1",))
