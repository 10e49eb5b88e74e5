"""Rigid wheel-rail geometry against closed forms, brute force and the Manchester benchmark."""

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

from railenv.contact.geometry import (
    FLANGE,
    TREAD,
    WheelRail,
    rolling_radius_difference,
    wheelset_contact,
)
from railenv.contact.profiles import get_profile
from railenv.errors import ArgumentError

SLOPE, RAIL_RADIUS, HALF_SPACING = 0.17, 0.1, 0.75


@pytest.fixture(scope="module")
def s1002() -> WheelRail:
    """The Manchester benchmark's pair."""
    return WheelRail(
        get_profile("s1002"), get_profile("60e1"), back_to_back=1.36, gauge_depth=0.014
    )


@pytest.fixture(scope="module")
def cone() -> WheelRail:
    """A cone on a circular rail head, whose geometry is a line on a circle."""
    return WheelRail(
        get_profile(f"cone:angle={SLOPE}"),
        get_profile(f"arc:radius={RAIL_RADIUS}"),
        cant=0.0,
        rail_lateral=HALF_SPACING,
    )


def random_poses(count: int, seed: int = 5) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(-0.015, 0.02, count),
        rng.uniform(-0.02, 0.02, count),
        rng.uniform(-0.03, 0.03, count),
    )


def line_on_circle(pair: WheelRail, u, phi):
    """Height of touch of a straight generator on a circle without yaw, by the line's distance."""
    theta = phi - np.arctan(SLOPE)
    y, r = pair.tape_circle, pair.wheel_radius
    offset = HALF_SPACING - u - y * np.cos(phi) + r * np.sin(phi)
    return (
        RAIL_RADIUS
        - RAIL_RADIUS / np.cos(theta)
        - offset * np.tan(theta)
        - y * np.sin(phi)
        - r * np.cos(phi)
        + pair.axle_height
    )


def test_cone_on_arc_touches_at_the_height_of_a_line_on_a_circle(cone):
    rng = np.random.default_rng(1)
    u, phi = rng.uniform(-5e-3, 3e-3, 200), rng.uniform(-0.008, 0.008, 200)  # off the flange
    # 1e-11 m: the rail is a spline through points 0.05 mm apart.
    np.testing.assert_allclose(cone.height(u, phi), line_on_circle(cone, u, phi), atol=1e-11)


def test_cone_on_arc_touches_where_the_tangents_are_parallel(cone):
    touch = cone.touch(1e-3, 0.002)
    theta = 0.002 - np.arctan(SLOPE)
    # Below 1e-8 m: the stationary point is found from a slope known to 1e-14 over 10/m.
    assert touch.on_rail == pytest.approx(HALF_SPACING + RAIL_RADIUS * np.sin(theta), abs=1e-8)
    assert touch.angle == pytest.approx(-theta, abs=1e-8)


def test_curvatures_of_cone_and_arc_are_those_of_line_circle_and_revolution(cone):
    touch = cone.touch(0.0)
    assert touch.wheel_curvature == pytest.approx(0.0, abs=1e-9)
    assert touch.rail_curvature == pytest.approx(1.0 / RAIL_RADIUS, rel=1e-6)
    radius = cone.wheel_radius - SLOPE * touch.on_wheel
    assert touch.radius == pytest.approx(radius, abs=1e-12)
    assert touch.rolling_curvature == pytest.approx(np.cos(np.arctan(SLOPE)) / radius, rel=1e-9)


def lateral_curvature(cone: WheelRail) -> tuple[float, float]:
    """Second derivative of the wheelset's rigid height by shift, and roll per shift, at rest.

    Derivatives of `line_on_circle` at u = phi = 0, where theta = -gamma: with tan = -lambda,
    sec^2 = 1 + lambda^2 and D = spacing - y: h_u = tan, h_uphi = sec^2,
    h_phi = -R tan sec - D sec^2 - r tan - y and h_phiphi = -R sec (tan^2 + sec^2) - y tan
    - 2 r sec^2 - 2 D sec^2 tan + r. Equal heights left and right need
    h_u u + h_phi phi = 0, and what is left is half (h_uu + 2 h_uphi c + h_phiphi c^2) u^2.
    """
    tan, y, r = -SLOPE, cone.tape_circle, cone.wheel_radius
    sec = np.hypot(1.0, tan)
    away = HALF_SPACING - y
    by_roll = -RAIL_RADIUS * tan * sec - away * sec**2 - r * tan - y
    twice = (
        -RAIL_RADIUS * sec * (tan**2 + sec**2)
        - y * tan
        - 2.0 * r * sec**2
        - 2.0 * away * sec**2 * tan
        + r
    )
    roll = -tan / by_roll
    return 2.0 * sec**2 * roll + twice * roll**2, roll


def test_gravitational_stiffness_of_a_coned_wheelset_in_shift_is_the_closed_form(cone):
    expected, roll = lateral_curvature(cone)
    step = 1e-4
    heights = wheelset_contact(cone, [-step, 0.0, step]).height
    # 1e-5: rounding of heights (1e-16 m over 1e-8 m^2) and the fourth derivative.
    assert (heights[0] - 2.0 * heights[1] + heights[2]) / step**2 == pytest.approx(
        expected, rel=1e-5
    )
    assert wheelset_contact(cone, step).roll / step == pytest.approx(roll, rel=1e-5)
    # The wheelset rises, by 2 lambda/b to first order: one share is the roll, which turns both
    # contact normals, the other the load, which moves to the wheel that the centre nears.
    assert -expected == pytest.approx(2.0 * SLOPE / HALF_SPACING, rel=0.3)


def test_gravitational_stiffness_of_a_coned_wheelset_in_yaw_is_minus_slope_times_lever(cone):
    centred = cone.touch(0.0)
    expected = SLOPE * (centred.lateral - centred.radius * SLOPE)
    step = 1e-3
    heights = wheelset_contact(cone, [0.0, 0.0, 0.0], [-step, 0.0, step]).height
    # 1e-4: the term in psi^4, and the rail spline's rounding over 1e-6.
    assert (heights[0] - 2.0 * heights[1] + heights[2]) / step**2 == pytest.approx(
        expected, rel=1e-4
    )
    assert expected > 0.0  # the wheelset sinks as it yaws: weight drives it on


def test_contact_point_of_a_yawed_cone_moves_forward_by_slope_times_radius_times_yaw(cone):
    touch = cone.touch(0.0, 0.0, 1e-4)
    assert touch.forward == pytest.approx(SLOPE * touch.radius * 1e-4, rel=1e-6)


def brute_force(pair: WheelRail, u: float, phi: float, psi: float) -> float:
    """Least vertical distance of wheel surface and rail, sampled ever finer around the best."""
    wheel = CubicSpline(pair.wheel.y, pair.wheel.z)
    rail = CubicSpline(pair.rail.y, pair.rail.z)
    c = np.arctan(pair.cant)
    fine = np.linspace(pair.rail.y[0], pair.rail.y[-1], 400_001)
    rail_y = fine * np.cos(c) + rail(fine) * np.sin(c)
    rail_z = rail(fine) * np.cos(c) - fine * np.sin(c)
    rail_z -= rail_z.min()
    face = np.interp(-pair.gauge_depth, -rail_z[fine < 0.0], rail_y[fine < 0.0])
    rail_y = rail_y - face + 0.5 * pair.gauge
    low, high = np.array([pair.wheel.y[0], -0.15]), np.array([pair.wheel.y[-1], 0.15])
    for _ in range(9):
        s, t = np.meshgrid(
            np.linspace(low[0], high[0], 301), np.linspace(low[1], high[1], 301), indexing="ij"
        )
        r, y = pair.wheel_radius + wheel(s), pair.tape_circle + s
        x1 = r * np.sin(t)
        y1 = y * np.cos(phi) - r * np.cos(t) * np.sin(phi)
        z1 = y * np.sin(phi) + r * np.cos(t) * np.cos(phi)
        across = u + x1 * np.sin(psi) + y1 * np.cos(psi)
        below = np.interp(across, rail_y, rail_z, left=1.0, right=1.0)
        gap = below - z1
        best = np.unravel_index(np.argmin(gap), gap.shape)
        middle, span = np.array([s[best], t[best]]), (high - low) / 12.0
        low, high = np.maximum(middle - span, [pair.wheel.y[0], -1.0]), middle + span
        high[0] = min(high[0], pair.wheel.y[-1])
    return float(gap.min()) + pair.axle_height


@pytest.mark.parametrize(
    ("u", "phi", "psi"),
    [
        (0.001, 0.0, 0.02),
        (-0.008, 0.01, -0.03),
        (0.0055, -0.001, 0.01),
        (0.008, -0.004, 0.03),
        (0.016, -0.012, -0.02),
        (0.025, -0.019, 0.0),
    ],
)
def test_search_finds_the_least_gap_of_the_whole_wheel_surface(s1002, u, phi, psi):
    # 2e-10 m: the brute force reads the rail linearly between points 0.2 micrometres apart, and
    # both take the profile's points with splines over different variables.
    assert s1002.height(u, phi, psi) == pytest.approx(brute_force(s1002, u, phi, psi), abs=2e-10)


def test_derivatives_of_the_height_are_those_of_the_envelope_theorem(s1002):
    poses = random_poses(300)
    touch = s1002.touch(*poses)
    step = 1e-7
    for n, slope in enumerate((touch.shift_slope, touch.roll_slope, touch.yaw_slope)):
        ahead = [pose + step * (m == n) for m, pose in enumerate(poses)]
        behind = [pose - step * (m == n) for m, pose in enumerate(poses)]
        difference = (s1002.height(*ahead) - s1002.height(*behind)) / (2.0 * step)
        # 1e-6: rounding of heights over the step; a kink within the step would show as more, and
        # less than one in 300 poses is that near to one.
        assert np.quantile(np.abs(difference - slope), 0.99) < 1e-6


def test_shift_slope_is_minus_the_tangent_of_the_contact_angle(s1002):
    touch = s1002.touch(0.007)
    assert touch.shift_slope == pytest.approx(-np.tan(touch.angle), rel=1e-12)
    assert touch.angle == pytest.approx(np.arctan(2.747477419), abs=1e-4)  # the flange's face


def test_height_is_the_same_for_yaw_to_either_side(s1002):
    u, phi, psi = random_poses(200)
    left, right = s1002.touch(u, phi, psi), s1002.touch(u, phi, -psi)
    np.testing.assert_allclose(left.height, right.height, atol=1e-15)
    np.testing.assert_allclose(left.forward, -right.forward, atol=1e-9)


def test_both_wheels_touch_and_shifts_to_either_side_mirror(s1002):
    shift = np.linspace(-6e-3, 6e-3, 25)
    contact = wheelset_contact(s1002, shift, 0.5 * shift)
    np.testing.assert_allclose(contact.right.height, contact.left.height, atol=1e-14)
    np.testing.assert_allclose(contact.roll, -contact.roll[::-1], atol=1e-13)
    # The points, unlike heights, hang on slopes and are known to 1e-9 m only.
    difference = rolling_radius_difference(s1002, shift, 0.5 * shift)
    np.testing.assert_allclose(difference, -difference[::-1], atol=1e-9)


# Manchester contact benchmark, case A-2.2 (Shackleton and Iwnicki 2008), as solved by CONTACT
# (examples of github.com/eve70a/CONTACT, mbench_a22_left/right): yaw 2.4 mrad per mm of shift.
BENCHMARK_SHIFTS = np.array([1.0, 1.5, 2.0, 2.5, 3.0, 3.5, 4.0, 4.5, 5.0, 5.5, 6.0])
BENCHMARK_DIFFERENCES = [
    0.609, 0.710, 0.801, 0.893, 0.992, 1.103, 1.232, 1.392, 3.523, 4.012, 4.625,
]  # fmt: skip


def test_rolling_radius_differences_are_those_of_contacts_elastic_points(s1002):
    shift = 1e-3 * BENCHMARK_SHIFTS
    rigid = 1e3 * rolling_radius_difference(s1002, shift, 2.4 * shift)
    # 0.03 mm: the loaded patch's middle is not the point of first touch. At 5 mm, just beyond the
    # jump to the flange root, 0.5 mm of that lie on a slope of 0.3.
    tolerance = np.where(np.abs(BENCHMARK_SHIFTS - 5.0) < 0.1, 0.16, 0.03)
    assert np.all(np.abs(rigid - BENCHMARK_DIFFERENCES) < tolerance)


def test_rolling_radius_differences_for_shifts_at_rail_level_are_those_of_the_plane_search(s1002):
    # Our own earlier plane integration, without yaw, whose shift is the contact points'.
    rows = [0.551, 0.632, 0.713, 0.796, 0.884, 0.979, 1.082, 1.203, 1.346]
    level = np.arange(0.5e-3, 4.6e-3, 0.5e-3)
    shift = level
    for _ in range(6):
        shift = level + s1002.wheel_radius * wheelset_contact(s1002, shift).roll
    # 0.003 mm: the earlier search stepped by 0.1 mm.
    np.testing.assert_allclose(1e3 * rolling_radius_difference(s1002, shift), rows, atol=3e-3)


@pytest.mark.parametrize(
    ("shift_mm", "left_mm", "right_mm"),
    # 0 mm is left out: the point of touch is about to jump by 11 mm, and the patch has two parts.
    [(1.0, 6.269, -9.030), (3.0, 10.338, -13.096), (5.0, 13.114, -28.047)],
)
def test_contact_points_are_those_of_the_benchmark(s1002, shift_mm, left_mm, right_mm):
    contact = wheelset_contact(s1002, 1e-3 * shift_mm, 2.4e-3 * shift_mm)
    # 0.3 and 0.55 mm: CONTACT gives the middle of patches of 1 to 4 mm half width under 10 kN.
    assert 1e3 * contact.left.on_wheel == pytest.approx(left_mm, abs=0.3)
    assert 1e3 * contact.right.on_wheel == pytest.approx(right_mm, abs=0.55)


def test_roll_and_height_are_those_of_the_benchmark_less_its_elastic_approach(s1002):
    shift = np.array([1.0, 3.0, 5.0]) * 1e-3
    contact = wheelset_contact(s1002, shift, 2.4 * shift)
    # 6e-6 rad: the approaches left and right differ by 3 to 8 micrometres over 1.5 m.
    np.testing.assert_allclose(contact.roll, [-5.049e-5, -1.803e-4, -3.554e-4], atol=6e-6)
    # CONTACT's wheels are 0.1981 mm down under 10 kN, which approaches wheel and rail by 0.016 mm.
    down = s1002.wheel_radius - s1002.axle_height
    assert 1e3 * down == pytest.approx(0.1981 - 0.016, abs=2e-3)


def test_whole_wheel_touches_with_the_nearer_of_its_zones(s1002):
    poses = random_poses(300)
    nearer = np.minimum(s1002.height(*poses, TREAD), s1002.height(*poses, FLANGE))
    np.testing.assert_allclose(s1002.height(*poses), nearer, atol=1e-13)


@pytest.mark.parametrize("names", [("s1002cn", "cn60"), ("lma", "cn60"), ("lmb10", "cn60")])
def test_a_contact_that_both_zones_find_is_shared_by_their_weights(names):
    pair = WheelRail(get_profile(names[0]), get_profile(names[1]))
    u = np.linspace(0.006, 0.012, 400)
    tread, flange = pair.touch(u, zone=TREAD), pair.touch(u, zone=FLANGE)
    same = np.abs(tread.on_wheel - flange.on_wheel) < 1e-9
    np.testing.assert_allclose((tread.weight + flange.weight)[same], 1.0, atol=1e-6)
    # Whoever is nearer to the rail has the whole patch, or shares it with the other.
    whole = pair.touch(u)
    weights = np.where(np.abs(tread.height - whole.height) < 1e-12, tread.weight, 0.0)
    weights += np.where(np.abs(flange.height - whole.height) < 1e-12, flange.weight, 0.0)
    np.testing.assert_allclose(weights, 1.0, atol=1e-6)


def test_a_conformal_contact_travels_through_the_overlap_of_the_zones():
    pair = WheelRail(get_profile("lma"), get_profile("cn60"))
    weights = pair.touch(np.linspace(0.008, 0.01, 200), zone=TREAD).weight
    assert np.count_nonzero((weights > 0.05) & (weights < 0.95)) >= 3


def test_wheels_and_rails_cannot_be_confused():
    wheel, rail = get_profile("s1002"), get_profile("60e1")
    with pytest.raises(ArgumentError, match="wheel = '60e1' is a rail profile"):
        WheelRail(rail, wheel)


def test_settings_that_do_not_fit_the_profiles_are_refused():
    wheel, rail = get_profile("s1002"), get_profile("60e1")
    with pytest.raises(ArgumentError, match=r"gauge_depth = 0\.05 m is not on rail '60e1'"):
        WheelRail(wheel, rail, gauge_depth=0.05)
    with pytest.raises(ArgumentError, match="no place to part tread and flange"):
        WheelRail(wheel, rail, zone_split=0.2)
    with pytest.raises(ArgumentError, match="back_to_back = -1 must be above zero"):
        WheelRail(wheel, rail, back_to_back=-1.0)


@pytest.mark.parametrize("change", [{"gauge": 1.6}, {"gauge": 1e6}, {"back_to_back": 1.5}])
def test_wheels_that_cannot_stand_between_the_rails_are_refused(change):
    with pytest.raises(ArgumentError, match="for two flanges and their play"):
        WheelRail(get_profile("s1002"), get_profile("60e1"), **change)


def test_a_rail_whose_side_is_upright_keeps_its_gauge():
    wheel, rail = get_profile("s1002"), get_profile("60e1")
    steep = WheelRail(wheel, rail, back_to_back=1.36, gauge_depth=0.014, cant=1 / 20)
    # S1002 on 60E1 canted by 1:20 is known for its low conicity, some 0.01 at 3 mm.
    difference = rolling_radius_difference(steep, np.array([3e-3]))[0]
    assert 0.0 < difference < 2 * 0.02 * 3e-3


def test_poses_out_of_range_are_refused(s1002):
    with pytest.raises(ArgumentError, match=r"roll = 0\.5 rad must be at most 0\.2"):
        s1002.touch(0.0, 0.5)
    with pytest.raises(ArgumentError, match="shift = nan m must be finite"):
        s1002.touch(np.nan)
    with pytest.raises(ArgumentError, match="zone = 2 does not exist"):
        s1002.touch(0.0, zone=2)
