"""The picture as shapes: signs, proportions, what moves where, that nothing leaves the frame."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from railenv.errors import ArgumentError
from railenv.rendering import View, build_scene, draw_text
from railenv.rendering.pipe import axis_length
from railenv.rendering.plan import FACTOR as PLAN_FACTOR
from railenv.rendering.scales import (
    exaggerated,
    kilonewtons,
    plain,
    round_limit,
    round_steps,
    signed,
)
from railenv.rendering.scene import full_scale_force
from railenv.rendering.section import FACTOR as SECTION_FACTOR
from railenv.rendering.shapes import Arrow, Circle, Line, Polygon, Text
from railenv.vehicle.coordinates import COORDINATES

ROUNDING = 1e-9
"""Pixels: rounding of coordinates below a few thousand, with a margin of a thousand."""


def coordinates(**values):
    q = np.zeros(len(COORDINATES))
    for name, value in values.items():
        q[COORDINATES.index(name)] = value
    return q


def view(layout="4", **changes):
    channels = 2 if layout == "2" else 4
    distance = np.linspace(-25.0, 25.0, 101)
    past = np.linspace(-4.0, 0.0, 401)
    age = 0.01 * np.arange(31)
    phase = 8.0 * (past[:, None] + np.array([0.0, 0.1]))
    fields = {
        "time": 12.3,
        "speed": 83.3,
        "layout": layout,
        "coordinates": coordinates(),
        "force": np.zeros(channels),
        "command": np.zeros(channels),
        "force_limit": 30e3,
        "delay": np.full(channels, 0.1),
        "max_delay": 0.3,
        "pipe_age": age,
        "pipe_command": 500.0 * np.cos(8.0 * age)[:, None] * np.ones(channels),
        "track_distance": distance,
        "track_alignment": 0.002 * np.sin(0.2 * distance),
        "track_cross_level": 0.001 * np.cos(0.3 * distance),
        "history_time": past,
        "history_acceleration": 0.2 * np.sin(phase),
        "ride_index": np.array([2.13, 1.98]),
        "reward": -0.8,
        "ended_by": "",
    }
    return View(**{**fields, **changes})


def named(scene, name):
    found = [shape for shape in scene.shapes if shape.name == name]
    assert found, f"no shape is named {name}"
    return found[0]


def middle(shape):
    return np.mean(shape.points, axis=0)


def moved(name, **values):
    """Return how far a shape's points move when some coordinates leave zero [pixels]."""
    rest = np.array(named(build_scene(view()), name).points)
    return np.array(named(build_scene(view(coordinates=coordinates(**values))), name).points) - rest


def test_sway_to_the_right_moves_the_carbody_right_by_the_stated_factor():
    level = build_scene(view(track_cross_level=np.zeros(101)))
    scale = named(level, "wheel_right").points[0][0] - named(level, "wheel_left").points[0][0]
    # The left corners of both wheels' flanges stand the contact spacing less two offsets apart.
    metre = scale / (2.0 * (0.7465 - 0.10))
    sway = 1e-8
    aside = moved("carbody", carbody_lateral=sway)
    # x / (1 + x) is less than x by a relative x = 60 * 1e-8; the difference of pixels is 3e-5
    # and rounds to 1e-13.
    assert aside[:, 0] == pytest.approx(metre * SECTION_FACTOR * sway, rel=1e-6)
    assert aside[:, 1] == pytest.approx(0.0, abs=ROUNDING)


def test_positive_roll_lowers_the_right_side_of_the_carbody():
    rest = np.array(named(build_scene(view()), "carbody").points)
    lowered = moved("carbody", carbody_roll=1e-4)[:, 1]
    centre = rest[:, 0].mean()
    # Pixels grow downwards, so lower is more.
    assert np.all(lowered[rest[:, 0] > centre + 5.0] > 0.0)
    assert np.all(lowered[rest[:, 0] < centre - 5.0] < 0.0)


def test_positive_roll_moves_the_roof_right_and_the_underside_left():
    rest = np.array(named(build_scene(view()), "carbody").points)
    aside = moved("carbody", carbody_roll=1e-4)[:, 0]
    assert aside[np.argmin(rest[:, 1])] > 0.0
    assert aside[np.argmax(rest[:, 1])] < 0.0


def test_yaw_moves_the_carbody_above_the_front_bogie_to_the_right():
    yaw, spacing = 1e-5, 8.69
    by_yaw = moved("carbody", carbody_yaw=yaw)
    by_sway = moved("carbody", carbody_lateral=spacing * yaw)
    assert by_yaw == pytest.approx(by_sway, abs=ROUNDING)


@pytest.mark.parametrize(
    ("shape", "coordinate"),
    [("bogie", "bogie1_lateral"), ("wheel_right", "wheelset1_lateral")],
)
def test_each_body_of_the_section_follows_its_own_coordinate_to_the_right(shape, coordinate):
    assert np.all(moved(shape, **{coordinate: 0.003})[:, 0] > 1.0)
    assert np.all(moved(shape, carbody_lateral=0.003, carbody_roll=0.002) == 0.0)


def test_a_common_shift_of_vehicle_and_track_leaves_the_section_s_distances_as_they_were():
    shift = 0.012
    q = coordinates(
        **{f"wheelset{i}_lateral": shift for i in (1, 2, 3, 4)},
        bogie1_lateral=shift,
        bogie2_lateral=shift,
        carbody_lateral=shift,
    )
    flat = {"track_cross_level": np.zeros(101)}
    still = build_scene(view(track_alignment=np.zeros(101), **flat))
    shifted = build_scene(view(coordinates=q, track_alignment=np.full(101, shift), **flat))
    aside = [
        middle(named(shifted, name))[0] - middle(named(still, name))[0]
        for name in ("rail_right", "wheel_right", "bogie", "air_spring_left", "carbody")
    ]
    assert aside == pytest.approx([aside[0]] * len(aside), abs=ROUNDING)
    assert aside[0] > 5.0


def test_cross_level_lowers_the_right_rail():
    scene = build_scene(view(track_cross_level=np.full(101, 0.002)))
    assert middle(named(scene, "rail_right"))[1] > middle(named(scene, "rail_left"))[1]


def test_air_springs_end_at_the_bogie_and_at_the_carbody():
    q = coordinates(carbody_lateral=0.01, carbody_roll=0.002, bogie1_lateral=-0.003)
    scene = build_scene(view(coordinates=q))
    carbody, bogie = named(scene, "carbody").points, named(scene, "bogie").points
    spring = np.array(named(scene, "air_spring_right").points)
    foot, head = spring[[0, -1]].mean(axis=0), spring[[12, 13]].mean(axis=0)
    assert distance_to_chain(foot, bogie) == pytest.approx(0.0, abs=ROUNDING)
    assert distance_to_chain(head, carbody) == pytest.approx(0.0, abs=ROUNDING)


def distance_to_chain(point, corners):
    distances = []
    for a, b in zip(np.array(corners), np.roll(corners, -1, axis=0), strict=True):
        share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        distances.append(np.linalg.norm(a + share * (b - a) - point))
    return min(distances)


def test_air_springs_keep_their_length_above_zero_at_any_roll():
    q = coordinates(carbody_roll=0.5, bogie1_roll=-0.5)
    for name in ("air_spring_left", "air_spring_right"):
        spring = np.array(named(build_scene(view(coordinates=q)), name).points)
        assert spring[0, 1] - spring[12, 1] > 0.5


def test_a_force_to_the_right_is_an_arrow_to_the_right_and_its_reaction_to_the_left():
    scene = build_scene(view(force=np.array([400.0, 300.0, -900.0, 0.0])))
    force, reaction = named(scene, "force_front"), named(scene, "reaction_front")
    length = force.tip[0] - force.tail[0]
    assert length > 5.0
    assert reaction.tip[0] - reaction.tail[0] == pytest.approx(-length, abs=ROUNDING)
    assert force.tip[1] == force.tail[1]


def arrow_length(arrow):
    return float(np.hypot(*np.subtract(arrow.tip, arrow.tail)))


@pytest.mark.parametrize("force", [250.0, 1000.0, 3000.0, -17e3])
def test_arrows_are_as_long_as_their_force_against_the_labelled_one(force):
    scene = build_scene(view(force=np.array([force, 0.0, force, force / 2.0])))
    full = full_scale_force(view(force=np.full(4, force)))
    unit = arrow_length(named(scene, "force_scale"))
    assert arrow_length(named(scene, "force_1")) == pytest.approx(abs(force) / full * unit)
    assert arrow_length(named(scene, "force_4")) == pytest.approx(abs(force) / full * unit / 2.0)
    front = arrow_length(named(scene, "force_front_scale"))
    assert arrow_length(named(scene, "force_front")) == pytest.approx(abs(force) / full * front)
    label = kilonewtons(full)
    assert sum(isinstance(s, Text) and s.text == label for s in scene.shapes) == 2


def test_in_the_plan_a_force_to_the_right_points_down_at_its_own_place():
    scene = build_scene(view(force=np.array([400.0, 300.0, -200.0, 100.0])))
    arrows = [named(scene, f"force_{place}") for place in (1, 2, 3, 4)]
    assert [np.sign(a.tip[1] - a.tail[1]) for a in arrows] == [1.0, 1.0, -1.0, 1.0]
    # Running to the right: place 1 leads.
    assert np.all(np.diff([a.tail[0] for a in arrows]) < 0.0)


def test_two_actuators_stand_at_the_outer_ends_of_the_bogies():
    four, two = build_scene(view("4")), build_scene(view("2"))
    for place in (1, 4):
        assert named(two, f"force_{place}").tail == named(four, f"force_{place}").tail
    assert not [s for s in two.shapes if s.name in ("force_2", "force_3")]


def test_positive_yaw_turns_the_nose_to_the_right_in_the_plan():
    rest = np.array(named(build_scene(view()), "carbody_plan").points)
    down = moved("carbody_plan", carbody_yaw=1e-4)[:, 1]
    nose, tail = np.argmax(rest[:, 0]), np.argmin(rest[:, 0])
    assert down[nose] > 1.0
    assert down[tail] < -1.0


def test_positive_yaw_turns_bogie_and_wheelset_clockwise_in_the_plan():
    rest = np.array(named(build_scene(view()), "bogie1_plan").points)
    down = moved("bogie1_plan", bogie1_yaw=1e-3)[:, 1]
    assert np.all(np.sign(down) == np.sign(rest[:, 0] - rest[:, 0].mean()))
    left, right = np.array(
        named(
            build_scene(view(coordinates=coordinates(wheelset1_yaw=1e-3))), "wheelset1_plan"
        ).points
    )
    assert right[1] > left[1]
    assert right[0] < left[0]


def test_wheels_stand_on_the_rails_of_the_plan_when_the_wheelset_follows_the_track():
    alignment = 0.004
    q = coordinates(**{f"wheelset{i}_lateral": alignment for i in (1, 2, 3, 4)})
    scene = build_scene(view(coordinates=q, track_alignment=np.full(101, alignment)))
    rails = [middle(named(scene, f"rail_{side}_plan"))[1] for side in ("left", "right")]
    for wheelset in (1, 2, 3, 4):
        axle = middle(named(scene, f"wheelset{wheelset}_plan"))
        assert axle[1] == pytest.approx(np.mean(rails), abs=ROUNDING)


def test_the_rails_of_the_plan_show_the_alignment_by_the_stated_factor():
    still = build_scene(view(track_alignment=np.zeros(101)))
    scene = build_scene(view(track_alignment=np.full(101, 1e-8)))
    metre = (
        named(still, "rail_left_plan").points[-1][0] - named(still, "rail_left_plan").points[0][0]
    ) / 50.0
    aside = middle(named(scene, "rail_left_plan"))[1] - middle(named(still, "rail_left_plan"))[1]
    # x / (1 + x) is less than x by a relative x = 200 * 1e-8 m over about a metre.
    assert aside == pytest.approx(metre * PLAN_FACTOR * 1e-8, rel=5e-6)


def test_marks_on_the_track_run_backwards_at_the_vehicle_s_speed():
    scene, later = build_scene(view(time=10.0)), build_scene(view(time=10.02))
    rail = named(scene, "rail_left_plan").points
    metre = (rail[-1][0] - rail[0][0]) / 50.0

    def places(of):
        return {s.text: s.position[0] for s in of.shapes if s.name == "mark_text"}

    before, after = places(scene), places(later)
    shared = set(before) & set(after)
    assert shared
    for label in shared:
        assert after[label] - before[label] == pytest.approx(-metre * 83.3 * 0.02, abs=1e-6)


def test_the_first_mark_stands_under_the_leading_wheelset_at_the_start():
    scene = build_scene(view(time=0.0))
    (zero,) = (s for s in scene.shapes if s.name == "mark_text" and s.text == "0 m")
    assert zero.position[0] == pytest.approx(middle(named(scene, "wheelset1_plan"))[0])


@pytest.mark.parametrize("age", [0.05, 0.1, 0.27])
def test_a_command_stands_in_the_pipe_at_its_age_over_the_longest_delay(age):
    one = view(pipe_age=np.array([0.0, age, 0.3]), pipe_command=np.full((3, 4), 500.0))
    scene = build_scene(one)
    bars = [s for s in scene.shapes if s.name == "bar_1"]
    ticks = {s.text: s.position[0] for s in scene.shapes if s.name == "age"}
    left, right = ticks["0"], ticks["300"]
    assert middle(bars[1])[0] == pytest.approx(left + (right - left) * age / 0.3)


def test_bars_are_as_high_as_their_command_and_up_is_right():
    commands = np.array([[500.0], [-1000.0], [250.0]]) * np.ones(4)
    scene = build_scene(view(pipe_age=np.array([0.1, 0.15, 0.2]), pipe_command=commands))
    heights = [s.points[2][1] - s.points[0][1] for s in scene.shapes if s.name == "bar_2"]
    assert np.array(heights) / heights[0] == pytest.approx([1.0, -2.0, 0.5])
    assert heights[0] > 0.0


def test_the_mark_of_each_actuator_stands_at_its_own_delay():
    scene = build_scene(view(delay=np.array([0.0, 0.1, 0.2, 0.3])))
    x = [middle(named(scene, f"acts_{place}"))[0] for place in (1, 2, 3, 4)]
    ages = {s.text: s.position[0] for s in scene.shapes if s.name == "age"}
    assert x == pytest.approx([ages[label] for label in ("0", "100", "200", "300")])
    assert named(scene, "bar_1").points[0][0] == pytest.approx(x[0])


def test_commands_that_already_acted_are_drawn_pale():
    scene = build_scene(view())
    colours = [s.fill for s in scene.shapes if s.name == "bar_3"]
    # Ages 0 to 90 ms wait for a delay of 100 ms, the other 21 do not.
    assert colours[:10] == [colours[0]] * 10
    assert colours[10:] == [colours[10]] * 21
    assert colours[0] != colours[10]


def test_a_pipe_without_any_delay_still_has_an_axis():
    short = view(
        max_delay=0.0, delay=np.zeros(4), pipe_age=np.zeros(1), pipe_command=np.zeros((1, 4))
    )
    assert axis_length(short) > 0.0
    assert named(build_scene(short), "acts_4")


def test_a_long_pipe_keeps_bars_that_can_be_told_apart():
    age = 0.001 * np.arange(10_001)
    long = view(max_delay=10.0, pipe_age=age, pipe_command=np.full((10_001, 4), 800.0))
    bars = [s for s in build_scene(long).shapes if s.name == "bar_1"]
    assert 50 < len(bars) < 400
    assert middle(bars[2])[0] - middle(bars[1])[0] >= 2.0


def test_the_last_sample_of_the_history_stands_at_the_right_edge():
    scene = build_scene(view())
    now = named(scene, "present").position[0]
    for name in ("floor_front", "floor_rear"):
        assert named(scene, name).points[-1][0] == pytest.approx(now)


def test_positive_acceleration_is_drawn_upwards_and_to_scale():
    past = np.zeros((401, 2))
    past[100, 0], past[200, 0], past[300, 0] = 0.1, -0.2, 0.05
    scene = build_scene(view(history_acceleration=past))
    y = np.array(named(scene, "floor_front").points)[:, 1]
    up = y[0] - y[[100, 200, 300]]
    assert up / up[0] == pytest.approx([1.0, -2.0, 0.5])
    assert up[0] > 0.0
    assert {s.text for s in scene.shapes if s.name == "limit"} == {"+0.2", "-0.2"}


@pytest.mark.parametrize("peak", [3.0, -3.0])
def test_a_long_history_loses_no_peak(peak):
    time = np.linspace(-20.0, 0.0, 40_001)
    past = np.zeros((40_001, 2))
    past[12_345, 0] = peak
    scene = build_scene(view(history_time=time, history_acceleration=past))
    y = np.array(named(scene, "floor_front").points)[:, 1]
    # Fewer points than samples, and the one sample that is not zero is among them.
    assert len(y) < 2000
    assert set(np.sign(y[-1] - y)) == {0.0, np.sign(peak)}


def test_the_running_ride_index_is_printed_and_its_bar_is_to_scale():
    scene = build_scene(view(ride_index=np.array([1.0, 2.0])))
    assert named(scene, "index_front_text").text == "1.00"
    assert named(scene, "index_rear_text").text == "2.00"
    front, rear = (
        np.ptp(np.array(named(scene, f"index_{n}").points)[:, 0]) for n in ("front", "rear")
    )
    assert rear == pytest.approx(2.0 * front)


def test_a_ride_index_that_is_not_yet_known_is_a_dash():
    scene = build_scene(view(ride_index=np.array([np.nan, 1.5])))
    assert named(scene, "index_front_text").text == "--"


@pytest.mark.parametrize(("ended_by", "words"), [("gauge", "GAUGE"), ("divergence", "DIVERGED")])
def test_an_ending_shows_a_banner_that_says_why(ended_by, words):
    assert words in named(build_scene(view(ended_by=ended_by)), "banner").text
    assert not [s for s in build_scene(view()).shapes if s.name == "banner"]


def test_the_heading_says_time_speed_delay_and_reward():
    scene = build_scene(view(delay=np.array([0.08, 0.1, 0.1, 0.12])))
    texts = {s.name: s.text for s in scene.shapes if isinstance(s, Text)}
    assert texts["time"] == "t = 12.30 s"
    assert texts["speed"] == "300 km/h"
    assert texts["delay"] == "delay 80-120 ms"
    assert texts["reward"] == "reward -0.80"


def extent(shape):
    if isinstance(shape, Text):
        return [shape.position]
    if isinstance(shape, Circle):
        (x, y), r = shape.centre, shape.radius
        return [(x - r, y - r), (x + r, y + r)]
    return [shape.tail, shape.tip] if isinstance(shape, Arrow) else shape.points


huge = st.floats(-1e100, 1e100)


@settings(max_examples=25, deadline=None)
@given(
    q=st.lists(huge, min_size=17, max_size=17),
    force=huge,
    alignment=huge,
    acceleration=huge,
    index=st.floats(0.0, 1e100),
    reward=huge,
    size=st.sampled_from([(640, 480), (960, 720), (480, 360), (1920, 500), (500, 1600)]),
)
def test_nothing_leaves_its_frame_whatever_the_values(
    q, force, alignment, acceleration, index, reward, size
):
    wild = view(
        coordinates=np.array(q),
        force=np.array([force, -force, 0.3 * force, force]),
        command=np.full(4, -force),
        pipe_command=np.full((31, 4), 0.7 * force),
        track_alignment=np.linspace(-alignment, alignment, 101),
        track_cross_level=np.linspace(alignment, -alignment, 101),
        history_acceleration=np.full((401, 2), acceleration),
        ride_index=np.array([index, 0.0]),
        reward=reward,
    )
    scene = build_scene(wild, size)
    for shape in scene.shapes:
        for x, y in extent(shape):
            assert 0.0 <= x <= size[0], shape
            assert 0.0 <= y <= size[1], shape


SECTION_SHAPES = (
    "carbody",
    "bogie",
    "rail_left",
    "rail_right",
    "wheel_left",
    "wheel_right",
    "floor",
)


@pytest.mark.parametrize("sign", [-1.0, 1.0])
@pytest.mark.parametrize("opposed", [-1.0, 1.0])
def test_a_diverged_vehicle_stays_in_its_panels(sign, opposed):
    far = {
        name: sign * 10.0 * (opposed if "bogie" in name or "yaw" in name else 1.0)
        for name in COORDINATES
    }
    scene = build_scene(view(coordinates=coordinates(**far), force=np.full(4, sign * 3e4)))
    plan_shapes = (
        "carbody_plan",
        "bogie1_plan",
        "bogie2_plan",
        "wheelset1_plan",
        "force_1",
        "force_4",
    )
    for panel, names in (("section", SECTION_SHAPES), ("plan", plan_shapes)):
        box = scene.panels[panel]
        for name in names:
            for x, y in extent(named(scene, name)):
                assert box.left <= x <= box.right, name
                assert box.top <= y <= box.bottom, name


@settings(max_examples=50, deadline=None)
@given(value=st.floats(-1e100, 1e100), factor=st.floats(0.1, 1e3), limit=st.floats(1e-3, 1e3))
def test_exaggeration_keeps_the_sign_and_the_limit(value, factor, limit):
    drawn = exaggerated(value, factor, limit)
    assert abs(drawn) <= limit
    assert drawn == 0.0 or np.sign(drawn) == np.sign(value)


def test_a_larger_motion_is_drawn_larger_up_to_a_metre():
    drawn = [exaggerated(y, SECTION_FACTOR, 1.0) for y in (0.001, 0.005, 0.02, 0.1, 1.0)]
    # 60 y / (1 + 60 y) by hand, to the four digits written.
    assert drawn == pytest.approx([0.0566, 0.2308, 0.5455, 0.8571, 0.9836], abs=5.1e-5)


@settings(max_examples=100, deadline=None)
@given(value=st.floats(1e-6, 1e100))
def test_a_round_limit_holds_its_value_and_is_less_than_five_halves_of_it(value):
    limit = round_limit(value, 1e-9)
    # From just above 2 to 5 is the widest step of 1, 2, 5, 10.
    assert value * (1.0 - 1e-11) <= limit <= 2.5 * value * (1.0 + 1e-11)
    assert round_limit(limit, 1e-9) == pytest.approx(limit)


def test_round_steps_count_up_to_the_end_of_the_axis():
    assert round_steps(0.3, 5) == pytest.approx([0.0, 0.1, 0.2, 0.3])
    assert round_steps(5.0, 6) == pytest.approx([0.0, 1.0, 2.0, 3.0, 4.0, 5.0])


def test_numbers_stay_short_whatever_their_size():
    assert [signed(v) for v in (0.0, -1.234, 999.994, -1e5, 1e100)] == [
        "+0.00",
        "-1.23",
        "+999.99",
        "-1.0e+05",
        "+1.0e+100",
    ]
    assert plain(2.5) == "2.50"


@pytest.mark.parametrize("size", [(320, 240), (640, 100), (10_000, 480), (640.0, 480), (640,)])
def test_sizes_that_cannot_be_read_or_held_are_refused(size):
    with pytest.raises(ArgumentError, match=r"size|width"):
        build_scene(view(), size)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("coordinates", np.zeros(16)),
        ("coordinates", np.full(17, np.nan)),
        ("coordinates", np.full(17, 1e101)),
        ("force", np.zeros(2)),
        ("pipe_command", np.zeros((30, 4))),
        ("pipe_age", -0.01 * np.arange(31)),
        ("pipe_age", np.zeros(31)),
        ("track_distance", np.zeros(101)),
        ("history_time", np.linspace(-1.0, 1.0, 401)),
        ("history_acceleration", np.full((401, 2), np.inf)),
        ("ride_index", np.array([-1.0, 1.0])),
        ("ended_by", "boredom"),
        ("layout", "passive"),
        ("speed", 0.0),
        ("force_limit", -1.0),
        ("time", 1e10),
        ("max_delay", 1e10),
        ("speed", 1e5),
        ("reward", np.nan),
    ],
)
def test_a_view_refuses_what_cannot_be_drawn_and_names_it(name, value):
    with pytest.raises(ArgumentError, match=name):
        view(**{name: value})


@pytest.mark.parametrize("layout", ["2", "4"])
@pytest.mark.parametrize("ended_by", ["", "divergence"])
def test_the_text_is_a_small_ascii_panel(layout, ended_by):
    wild = coordinates(carbody_lateral=1e90, bogie1_lateral=-1e90)
    for q in (coordinates(), wild):
        text = draw_text(view(layout, ended_by=ended_by, coordinates=q))
        assert text.isascii()
        assert len(text.split("\n")) <= 30
        assert max(map(len, text.split("\n"))) <= 100


def test_the_text_shows_forces_ride_index_and_ending():
    shown = view(force=np.array([1234.0, 0.0, 0.0, -500.0]), ended_by="gauge")
    text = draw_text(shown)
    for part in ("+1.23", "-0.50", "2.13", "1.98", "GAUGE", "delay 100 ms"):
        assert part in text


def test_the_text_s_ruler_puts_right_on_the_right():
    lines = draw_text(view(coordinates=coordinates(carbody_lateral=0.005))).split("\n")
    (ruler,) = (line for line in lines if "carbody front" in line)
    assert ruler.index("O") > ruler.index("|")


def test_the_text_s_pipe_marks_the_delay_at_its_share_of_the_axis():
    lines = draw_text(view(delay=np.full(4, 0.15))).split("\n")
    (row,) = (line for line in lines if "actuator 1" in line)
    pipe = row[row.index("[") + 1 : row.index("]")]
    assert pipe.index("!") == (len(pipe) - 1) // 2


def test_the_same_view_gives_the_same_shapes():
    assert build_scene(view()).shapes == build_scene(view()).shapes


def test_every_field_of_a_view_is_described():
    described = View.__doc__
    for entry in dataclasses.fields(View):
        assert f"        {entry.name}: " in described


def test_shapes_are_plain_data():
    kinds = {type(shape) for shape in build_scene(view()).shapes}
    assert kinds == {Line, Polygon, Circle, Arrow, Text}
