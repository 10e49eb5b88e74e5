"""Force elements: their displacement rows, and a spring in series with a dashpot."""

import numpy as np
import pytest
from numpy.typing import NDArray

from railenv.vehicle import LateralVehicle, get_vehicle, lateral17, state_space
from railenv.vehicle.coordinates import COORDINATES
from railenv.vehicle.suspension import damper_row, maxwell_elements, parallel_elements

PAPER = get_vehicle("paper_fit").parameters
ROWS = {e.name: e.row for e in (*parallel_elements(PAPER), *maxwell_elements(PAPER, "passive"))}


def motion(**values: float) -> NDArray[np.float64]:
    return np.array([values.get(name, 0.0) for name in COORDINATES])


def test_suspension_has_three_elements_per_wheelset_and_four_per_bogie() -> None:
    assert len(parallel_elements(PAPER)) == 4 * 3 + 2 * 4


@pytest.mark.parametrize("name", ROWS)
def test_element_does_not_stretch_when_all_bodies_shift_together(name: str) -> None:
    shift = np.array([float(c.endswith("lateral")) for c in COORDINATES])
    # coefficients of both ends are plus and minus one exactly
    assert ROWS[name] @ shift == 0.0


@pytest.mark.parametrize("wheelset", [1, 2, 3, 4])
def test_primary_lateral_spring_does_not_stretch_when_the_frame_rolls_about_it(
    wheelset: int,
) -> None:
    bogie = "bogie1" if wheelset < 3 else "bogie2"
    turn = motion(**{f"{bogie}_roll": 1.0, f"{bogie}_lateral": PAPER.bogie_to_primary_height})
    assert ROWS[f"primary_lateral_{wheelset}"] @ turn == 0.0


@pytest.mark.parametrize("bogie", [1, 2])
def test_secondary_lateral_spring_does_not_stretch_when_both_bodies_roll_about_it(
    bogie: int,
) -> None:
    turn = motion(
        **{
            "carbody_roll": 1.0,
            "carbody_lateral": PAPER.carbody_to_secondary_height,
            f"bogie{bogie}_roll": 1.0,
            f"bogie{bogie}_lateral": PAPER.bogie_to_secondary_height,
        }
    )
    # rounding of two differences of a metre
    assert ROWS[f"secondary_lateral_{bogie}"] @ turn == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("position", [1, 2, 3, 4])
def test_lateral_damper_does_not_stretch_when_both_bodies_roll_about_it(position: int) -> None:
    bogie = "bogie1" if position < 3 else "bogie2"
    turn = motion(
        **{
            "carbody_roll": 1.0,
            "carbody_lateral": PAPER.carbody_to_damper_height,
            f"{bogie}_roll": 1.0,
            f"{bogie}_lateral": PAPER.bogie_to_damper_height,
        }
    )
    # rounding of two differences of a metre
    assert ROWS[f"lateral_damper_{position}_node"] @ turn == pytest.approx(0.0, abs=1e-15)


@pytest.mark.parametrize("kind", ["secondary_vertical", "antiroll_bar"])
@pytest.mark.parametrize("bogie", [1, 2])
def test_roll_support_does_not_stretch_when_body_and_frame_roll_alike(
    kind: str, bogie: int
) -> None:
    turn = motion(**{"carbody_roll": 1.0, f"bogie{bogie}_roll": 1.0})
    assert ROWS[f"{kind}_{bogie}"] @ turn == 0.0


def test_rolling_the_whole_vehicle_stretches_the_lateral_dampers() -> None:
    # h_5 - h_6 = 0.922 + 0.147 of the catalogued vehicle: roll is free in single elements only.
    roll = motion(carbody_roll=1.0, bogie1_roll=1.0, bogie2_roll=1.0)
    assert ROWS["lateral_damper_1_node"] @ roll == pytest.approx(-1.069, abs=1e-15)


@pytest.mark.parametrize("bogie", [1, 2])
def test_yaw_damper_on_the_right_shortens_when_the_carbody_turns_right(bogie: int) -> None:
    # A point at y = w moves along x by -w yaw.
    stretch = ROWS[f"bogie{bogie}_yaw_damper_right_node"] @ motion(carbody_yaw=1.0)
    assert stretch == -PAPER.half_yaw_damper_spacing


def test_track_roll_reaches_the_primary_vertical_springs_only() -> None:
    moved = [e.name for e in parallel_elements(PAPER) if e.track_row.any()]
    assert moved == [f"primary_vertical_{w}" for w in (1, 2, 3, 4)]


@pytest.mark.parametrize("wheelset", [1, 2, 3, 4])
def test_primary_vertical_spring_reads_the_track_roll_at_its_own_wheelset(wheelset: int) -> None:
    element = next(e for e in parallel_elements(PAPER) if e.name == f"primary_vertical_{wheelset}")
    # alignment at four wheelsets, then roll at four
    assert np.flatnonzero(element.track_row).tolist() == [4 + wheelset - 1]


@pytest.mark.parametrize(("layout", "kept"), [("passive", 8), ("2", 6), ("4", 4)])
def test_layout_keeps_the_dampers_that_no_actuator_replaces(layout: str, kept: int) -> None:
    assert len(lateral17(layout=layout).dampers) == kept


def test_two_actuators_leave_the_dampers_at_the_inner_places() -> None:
    names = [d.name for d in lateral17(layout=2).dampers if "lateral" in d.name]
    assert names == ["lateral_damper_2_node", "lateral_damper_3_node"]


def test_damper_without_series_stiffness_is_left_out() -> None:
    bare = PAPER.replace(yaw_damper_stiffness=0.0, lateral_damper_stiffness=0.0)
    assert LateralVehicle(bare, "passive", 80.0).dampers == ()


def dynamic_stiffness(name: str, s: complex, series_stiffness: float = 4.5e6) -> complex:
    """Force of a damper over its stretch at complex frequency s, from A and C of the vehicle."""
    parameters = PAPER.replace(lateral_damper_stiffness=series_stiffness)
    vehicle = LateralVehicle(parameters, "passive", 80.0)
    system = state_space(vehicle)
    node = system.states.index(f"{name}_node")
    row = damper_row(parameters, int(name[-1]))
    body = int(np.argmax(np.abs(row)))
    response = system.A[node, body] / (s - system.A[node, node])
    force = system.C[system.outputs.index(f"{name}_force")]
    return complex((force[body] + force[node] * response) / row[body])


@pytest.mark.parametrize("omega", [0.1, 8.0, 300.0, 1e4])
def test_maxwell_damper_has_the_stiffness_of_spring_and_dashpot_in_series(omega: float) -> None:
    s = 1j * omega
    series = 1.0 / (1.0 / 4.5e6 + 1.0 / (15e3 * s))
    # far below its corner frequency the force is a small difference: 300 / 0.1 units of rounding
    assert dynamic_stiffness("lateral_damper_2", s) == pytest.approx(series, rel=1e-12)


def test_maxwell_damper_is_its_dashpot_at_low_frequency() -> None:
    s = 1j * 1e-3
    # s c / k = 3e-6 is what the spring still gives way
    assert dynamic_stiffness("lateral_damper_1", s) / s == pytest.approx(15e3, rel=1e-5)


def test_maxwell_damper_is_its_spring_at_high_frequency() -> None:
    # k / (s c) = 3e-6 is what the dashpot still gives way
    assert dynamic_stiffness("lateral_damper_3", 1j * 1e8) == pytest.approx(4.5e6, rel=1e-5)


def test_maxwell_damper_with_a_rigid_spring_is_a_dashpot() -> None:
    s = 8j
    # s c / k = 1e-7 is what the spring still gives way
    stiff = dynamic_stiffness("lateral_damper_4", s, series_stiffness=1.2e12)
    assert stiff / s == pytest.approx(15e3, rel=1e-6)


@pytest.mark.parametrize(
    ("damper", "stiffness", "damping"), [("yaw", 8.8e6, 330e3), ("lateral", 4.5e6, 15e3)]
)
def test_damper_node_relaxes_at_stiffness_over_damping(
    damper: str, stiffness: float, damping: float
) -> None:
    system = state_space(lateral17(layout="passive"))
    rates = [
        system.A[k, k]
        for k, name in enumerate(system.states)
        if name.endswith("_node") and f"{damper}_damper" in name
    ]
    # rounding of one division
    assert rates == pytest.approx([-stiffness / damping] * 4, rel=1e-15)


def test_actuators_that_act_as_dashpots_replace_dampers_with_rigid_springs() -> None:
    rigid = PAPER.replace(lateral_damper_stiffness=1e12)
    passive = state_space(LateralVehicle(rigid, "passive", 80.0))
    active = state_space(LateralVehicle(PAPER, "4", 80.0))
    rates, _ = active.output_rows(tuple(f"suspension_stroke_rate_{k}" for k in (1, 2, 3, 4)))
    looped = np.linalg.eigvals(active.A - 15e3 * active.actuator_input @ rates)
    roots = np.linalg.eigvals(passive.A)
    slow = looped[(np.abs(looped) < 25.0) & (looped.imag > 0.0)]
    distance = np.abs(slow[:, None] - roots[None, :]).min(axis=1)
    # the spring gives way by s c / k = 4e-7; the nodes' roots at 7e7 1/s cost the solver digits
    assert np.all(distance < 1e-5 * np.abs(slow))
