"""Coordinate names, the rows of points, and layouts."""

import numpy as np
import pytest

from railenv.errors import ArgumentError
from railenv.vehicle import coordinates as c


def test_coordinates_stand_in_the_order_of_the_model() -> None:
    names = "w1_y w1_psi w2_y w2_psi w3_y w3_psi w4_y w4_psi f1_y f1_psi f1_phi f2_y f2_psi f2_phi"
    words = {"w": "wheelset", "f": "bogie", "y": "lateral", "psi": "yaw", "phi": "roll"}
    expected = []
    for name in names.split():
        body, motion = name.split("_")
        expected.append(f"{words[body[0]]}{body[1]}_{words[motion]}")
    expected += ["carbody_lateral", "carbody_yaw", "carbody_roll"]
    assert list(c.COORDINATES) == expected


def test_index_is_the_place_in_the_order() -> None:
    assert [c.coordinate_index(name) for name in c.COORDINATES] == list(range(17))


def test_unit_row_picks_one_coordinate() -> None:
    q = np.arange(17.0)
    assert c.unit_row("bogie1_yaw") @ q == 9.0


def test_point_ahead_moves_to_the_right_with_positive_yaw() -> None:
    assert c.lateral_of_point("carbody", 3.0, 0.0)[c.coordinate_index("carbody_yaw")] == 3.0


def test_point_below_moves_to_the_left_with_positive_roll() -> None:
    assert c.lateral_of_point("bogie2", 0.0, 0.5)[c.coordinate_index("bogie2_roll")] == -0.5


@pytest.mark.parametrize("body", ["carbody", "bogie1", "bogie2"])
def test_point_follows_its_body_sideways(body: str) -> None:
    row = c.lateral_of_point(body, 2.0, 0.3)
    assert row[c.coordinate_index(f"{body}_lateral")] == 1.0
    assert np.count_nonzero(row) == 3


def test_bogies_carry_two_wheelsets_each() -> None:
    assert [c.bogie_of_wheelset(w) for w in c.WHEELSETS] == [1, 1, 2, 2]


def test_damper_places_lie_two_at_each_bogie() -> None:
    assert [c.bogie_of_position(k) for k in c.DAMPER_POSITIONS] == [1, 1, 2, 2]


def test_odd_numbers_lead() -> None:
    assert [c.end_sign(k) for k in (1, 2, 3, 4)] == [1, -1, 1, -1]


def test_front_bogie_lies_ahead() -> None:
    assert [c.bogie_sign(j) for j in c.BOGIES] == [1, -1]


@pytest.mark.parametrize(
    ("given", "name"), [("passive", "passive"), (2, "2"), ("2", "2"), (4, "4"), ("4", "4")]
)
def test_layout_has_one_name_however_it_is_given(given: object, name: str) -> None:
    assert c.parse_layout(given) == name


@pytest.mark.parametrize("bad", [0, 1, 3, "active", None, 2.0])
def test_layout_that_does_not_exist_is_refused_with_the_choices(bad: object) -> None:
    with pytest.raises(ArgumentError, match="choose passive, 2 or 4"):
        c.parse_layout(bad)


@pytest.mark.parametrize(
    ("layout", "actuators", "dampers"),
    [("passive", (), (1, 2, 3, 4)), ("2", (1, 4), (2, 3)), ("4", (1, 2, 3, 4), ())],
)
def test_every_place_holds_an_actuator_or_a_damper(
    layout: c.Layout, actuators: tuple[int, ...], dampers: tuple[int, ...]
) -> None:
    assert (c.actuator_positions(layout), c.damper_positions(layout)) == (actuators, dampers)
