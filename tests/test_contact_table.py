"""The contact table against itself (derivatives, work) and against the exact search."""

import numpy as np
import pytest

from railenv.contact.geometry import FLANGE, TREAD, WheelRail, wheelset_contact
from railenv.contact.hertz import hertz_contact
from railenv.contact.kalker import kalker_coefficients
from railenv.contact.profiles import get_profile
from railenv.contact.table import (
    ContactArrays,
    contact_arrays,
    flange_is_free,
    patch,
    touch,
)
from railenv.errors import ArgumentError

ZONES = (TREAD, FLANGE)
SHIFT_STEP, ROLL_STEP = 2e-4, 1.5e-3


@pytest.fixture(scope="module")
def pair() -> WheelRail:
    """The Manchester benchmark's pair."""
    return WheelRail(
        get_profile("s1002"), get_profile("60e1"), back_to_back=1.36, gauge_depth=0.014
    )


@pytest.fixture(scope="module")
def arrays(pair) -> ContactArrays:
    return contact_arrays(pair)


@pytest.fixture(scope="module")
def sharp(pair) -> ContactArrays:
    """Without a load to be shared: every node shows its own rigid touch."""
    return contact_arrays(pair, load=1e-4)


def touches(arrays: ContactArrays, zone: int, *poses: np.ndarray) -> np.ndarray:
    """Rows of `touch`, shape (8, n)."""
    rows = zip(*(np.asarray(pose, dtype=float).tolist() for pose in poses), strict=True)
    return np.array([touch(arrays, zone, *row) for row in rows]).T


def patches(arrays: ContactArrays, zone: int, *poses: np.ndarray) -> np.ndarray:
    """Rows of `patch`, shape (10, n)."""
    rows = zip(*(np.asarray(pose, dtype=float).tolist() for pose in poses), strict=True)
    return np.array([patch(arrays, zone, *row) for row in rows]).T


def random_poses(
    count: int, shift=(-0.006, 0.006), roll=0.01, yaw=0.005, seed: int = 3
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return (
        rng.uniform(*shift, count),
        rng.uniform(-roll, roll, count),
        rng.uniform(-yaw, yaw, count),
    )


@pytest.mark.parametrize("zone", ZONES)
def test_gradients_are_those_of_the_looked_up_values(arrays, zone):
    poses = random_poses(200, (-0.012, 0.03), 0.025, 0.03)  # within the table
    value = touches(arrays, zone, *poses)
    step = 1e-7
    for n in range(3):
        ahead = touches(arrays, zone, *(p + step * (m == n) for m, p in enumerate(poses)))
        behind = touches(arrays, zone, *(p - step * (m == n) for m, p in enumerate(poses)))
        slopes = (ahead - behind) / (2.0 * step)
        # 1e-6 of the largest: third derivatives over the step, and rounding, 1e-10 in slopes of h.
        for quantity in (0, 4):
            expected = value[quantity + 1 + n]
            scale = np.max(np.abs(expected)) + 1e-3
            np.testing.assert_allclose(slopes[quantity], expected, atol=1e-6 * scale)


@pytest.mark.parametrize(("zone", "first"), [(TREAD, -15), (FLANGE, 30)])
def test_second_derivatives_are_continuous_across_cells(arrays, zone, first):
    nodes = SHIFT_STEP * np.arange(first, first + 30)  # across the tread's jump; along the flange
    level = np.zeros_like(nodes)

    def jumps(step: float) -> np.ndarray:
        """Second derivatives just right of the nodes less those just left: of h, of k."""
        left, middle, right = (
            touches(arrays, zone, nodes + away, level, level)[[1, 5]] for away in (-step, 0.0, step)
        )
        return np.max(np.abs(right - 2.0 * middle + left), axis=1) / step

    # Third derivatives do jump, so that this falls with the step; a jump of the second would stay.
    assert np.all(jumps(1e-7) < 0.2 * jumps(1e-6))


def test_all_values_are_even_in_yaw(arrays):
    u, phi, psi = random_poses(100, (-0.02, 0.03), 0.05, 0.03)
    even = [0, 1, 2, 4, 5, 6]
    for zone in ZONES:
        left, right = touches(arrays, zone, u, phi, psi), touches(arrays, zone, u, phi, -psi)
        np.testing.assert_array_equal(left[even], right[even])
        np.testing.assert_array_equal(left[[3, 7]], -right[[3, 7]])


@pytest.mark.parametrize("seed", range(3))
def test_contact_forces_do_no_work_around_a_closed_loop(arrays, seed):
    rng = np.random.default_rng(seed)
    t = np.linspace(0.0, 2.0 * np.pi, 6000, endpoint=False)
    waves = np.stack([np.cos(t), np.sin(t), np.cos(2.0 * t), np.sin(2.0 * t)])
    rates = np.stack([-np.sin(t), np.cos(t), -2.0 * np.sin(2.0 * t), 2.0 * np.cos(2.0 * t)])
    share = rng.normal(size=(4, 4)) * np.array([[1.5e-3], [5e-5], [1.5e-3], [4e-3]])
    u, z, phi, psi = share @ waves
    path = share @ rates
    u = u + 6e-3
    z = z - 4e-4  # presses into tread and flange on parts of the loop
    force = np.zeros((4, len(t)))
    for zone in ZONES:
        h, h_u, h_phi, h_psi, k, k_u, k_phi, k_psi = touches(arrays, zone, u, phi, psi)
        p = np.maximum(z - h, 0.0)
        force[1] -= k * p**1.5
        for n, (by, stiffer) in enumerate([(h_u, k_u), (h_phi, k_phi), (h_psi, k_psi)]):
            force[(0, 2, 3)[n]] += k * p**1.5 * by - 0.4 * p**2.5 * stiffer
    power = np.sum(force * path, axis=0)
    # 1e-6: the sum over even steps of a periodic function with jumps in the second derivative.
    assert abs(np.sum(power)) < 1e-6 * np.sum(np.abs(power))


def steady(pair: WheelRail, zone: int, u, phi, psi) -> np.ndarray:
    """Where a zone touches and its point moves less than 4 mm over the nodes of a B-spline."""
    exact = pair.touch(u, phi, psi, zone)
    low = high = exact.lateral
    for a in (-2, 0, 2):
        for b in (-2, 0, 2):
            roll = phi + b * ROLL_STEP
            shift = u + a * SHIFT_STEP + pair.wheel_radius * b * ROLL_STEP
            y = pair.touch(shift, roll, psi, zone).lateral
            low, high = np.minimum(low, y), np.maximum(high, y)
    return (high - low < 4e-3) & (exact.weight > 0.999)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("wheel", "rail"),
    [
        ("s1002", "60e1"),
        ("s1002cn", "cn60"),
        ("lma", "cn60"),
        ("cone:angle=0.17", "arc:radius=0.3"),
    ],
)
def test_tread_heights_are_exact_to_0_2_micrometres_on_smooth_stretches(wheel, rail):
    pair = WheelRail(get_profile(wheel), get_profile(rail))
    arrays = contact_arrays(pair)
    poses = random_poses(2000, (-0.006, 0.004), 0.004, 0.005)
    smooth = steady(pair, TREAD, *poses)
    assert np.count_nonzero(smooth) > 800
    exact = pair.touch(*poses, TREAD)
    table = touches(arrays, TREAD, *poses)
    assert np.max(np.abs(table[0] - exact.height)[smooth]) < 2e-7  # 1e-8 at the 90th percentile
    assert np.max(np.abs(table[1] - exact.shift_slope)[smooth]) < 5e-4
    # Not smooth are places where the point of touch jumps or travels by millimetres within a step.
    assert np.max(np.abs(table[0] - exact.height)) < 1e-5


def test_flange_heights_are_exact_to_micrometres_at_common_yaw_angles(pair, arrays):
    poses = random_poses(1500, (0.006, 0.02), 0.005, 0.01)
    exact = pair.touch(*poses, FLANGE)
    error = np.abs(touches(arrays, FLANGE, *poses)[0] - exact.height)[exact.weight > 0.999]
    # Yaw is linear in psi^2 between two layers; slopes up to 2.7 bend within a millimetre.
    assert np.quantile(error, 0.5) < 2e-7
    assert np.max(error) < 1e-5


def test_a_jump_of_the_contact_point_is_rounded_with_monotonous_slopes(pair, arrays):
    u = np.arange(-1.5e-3, 2e-3, 1e-5)
    zero = np.zeros_like(u)
    exact = pair.touch(u, zone=TREAD).shift_slope
    slope = touches(arrays, TREAD, u, zero, zero)[1]
    jump = np.min(np.diff(exact))
    assert jump < -0.03  # it is there
    assert np.max(np.diff(slope)) < 1e-6
    # Rounded over at least one step of the table: the curvature, and with it the gravitational
    # stiffness, is at most the jump over the step.
    assert np.min(np.diff(slope)) / 1e-5 > jump / SHIFT_STEP
    centre = u[np.argmin(np.diff(exact))]
    # The jump moves by 0.4 mm with each step of roll, over which it is rounded as well.
    away = np.abs(u - centre) > 1e-3
    np.testing.assert_allclose(slope[away], exact[away], atol=3e-4)


def test_stiffness_is_nowhere_negative_and_nothing_is_nan_far_outside(arrays):
    u, phi, psi = random_poses(3000, (-0.5, 0.5), 0.5, 0.5)
    near = random_poses(3000, (-0.03, 0.05), 0.08, 0.05)
    for zone in ZONES:
        for poses in ((u, phi, psi), near):
            values = touches(arrays, zone, *poses)
            assert np.all(np.isfinite(values))
            assert np.all(values[4] >= 0.0)
            assert np.all(np.isfinite(patches(arrays, zone, *poses)))


def test_height_goes_on_linearly_beyond_the_edges(arrays):
    u = np.array([0.1, 0.2, 0.3])
    height, slope, _, _, k, k_u, _, _ = touches(arrays, FLANGE, u, np.zeros(3), np.zeros(3))
    # 1e-5: rounding of four coefficients on a line times the cube of 1000 steps.
    assert height[2] - height[1] == pytest.approx(height[1] - height[0], rel=1e-5)
    assert slope[0] == pytest.approx((height[1] - height[0]) / 0.1, rel=1e-5)
    np.testing.assert_allclose(k_u, 0.0, atol=1e-8 * k[0] / SHIFT_STEP)


def test_a_pose_that_is_not_a_number_gives_none_back(arrays):
    assert np.isnan(touch(arrays, TREAD, np.nan, 0.0, 0.0)[0])
    assert np.isnan(touch(arrays, TREAD, 0.0, np.nan, 0.0)[0])


def test_both_zones_carry_load_where_s1002_comes_to_its_flange(pair, arrays):
    # The point of touch jumps from 28 to 70 degrees where the flange comes to the tread's height.
    shifts = np.arange(6e-3, 7e-3, 2e-6)
    level = np.zeros_like(shifts)
    tread, flange = (touches(arrays, zone, shifts, level, level) for zone in ZONES)
    exact = pair.touch(shifts).on_wheel
    jump = shifts[np.argmin(np.diff(exact))]
    n = int(np.argmax(flange[0] < tread[0]))
    assert shifts[n] == pytest.approx(jump, abs=2e-5)
    # A loaded wheel's approach is 0.1 mm, a third of which is left across the flange's face.
    down = tread[0, n] + 1e-4
    for row in (tread[:, n], flange[:, n]):
        assert row[4] * (down - row[0]) ** 1.5 > 3e3
    lower = touch(arrays, FLANGE, 4e-3, 0.0, 0.0)[0] - float(pair.height(4e-3))
    assert lower > 1e-3  # in the middle of the track the flange is free


def test_the_flange_comes_to_touch_with_its_own_slope_and_full_stiffness(pair, arrays):
    u = np.arange(5.5e-3, 6.6e-3, 5e-5)
    zero = np.zeros_like(u)
    values = touches(arrays, FLANGE, u, zero, zero)
    # The face of S1002; 0.2 and 0.5 per cent: its end next to the root, where it jumps to.
    np.testing.assert_allclose(values[1], -2.747477419, rtol=2e-3)
    np.testing.assert_allclose(values[4], values[4, -1], rtol=5e-3)


def test_one_conformal_patch_is_not_counted_twice():
    pair = WheelRail(get_profile("lma"), get_profile("cn60"))
    arrays = contact_arrays(pair)
    u = np.linspace(8.6e-3, 9.7e-3, 56)
    values = np.stack([touches(arrays, zone, u, np.zeros(56), np.zeros(56)) for zone in ZONES])
    down = np.min(values[:, 0], axis=0) + 6e-5
    force = np.sum(values[:, 4] * np.maximum(down - values[:, 0], 0.0) ** 1.5, axis=0)
    # What the touch of the whole wheel would carry, which travels 10 mm through the flange root.
    whole = pair.touch(u)
    least = np.maximum(1.0 / 1.5, 0.1 * whole.rail_curvature)
    across = np.maximum(whole.wheel_curvature + whole.rail_curvature, least)
    hertz = hertz_contact(whole.rolling_curvature, across).stiffness
    share = force / (hertz * np.cos(whole.angle) ** 2.5 * 6e-5**1.5)
    # Twice would be 2; the stiffness is averaged over 2 mm of shift, in which it changes threefold.
    assert np.all((share > 0.55) & (share < 1.5))


@pytest.mark.parametrize(("wheel", "rail"), [("s1002cn", "cn60"), ("lma", "cn60")])
def test_a_flange_said_to_be_free_does_not_touch(wheel, rail):
    arrays = contact_arrays(WheelRail(get_profile(wheel), get_profile(rail)))
    draw = np.random.default_rng(5)
    free = 0
    for _ in range(4000):
        u, phi, psi = draw.uniform([-0.01, -0.012, -0.012], [0.012, 0.012, 0.012])
        down = draw.uniform(-0.01, 0.01)
        if flange_is_free(arrays, u, phi, psi, down):
            free += 1
            assert down < touch(arrays, FLANGE, u, phi, psi)[0]
    assert free > 1000  # of 4000: else it would be no use
    assert flange_is_free(arrays, 3e-3, 1e-3, 1e-3, 2e-4)
    assert not flange_is_free(arrays, 9e-3, 0.0, 0.0, 2e-4)


def test_patch_is_where_the_search_touches(pair, sharp):
    poses = random_poses(1500, (-0.006, 0.004), 0.004, 0.005)
    smooth = steady(pair, TREAD, *poses)
    exact = pair.touch(*poses, TREAD)
    radius, lateral, forward, angle = patches(sharp, TREAD, *poses)[:4]
    # Bilinear: the contact point moves by up to 4 mm over two steps to both sides, so about 1/30.
    assert np.max(np.abs(lateral - exact.lateral)[smooth]) < 2e-4
    assert np.max(np.abs(radius - exact.radius)[smooth]) < 1e-5
    assert np.max(np.abs(forward - exact.forward)[smooth]) < 2e-5
    assert np.max(np.abs(angle - exact.angle)[smooth]) < 1e-3


@pytest.mark.parametrize(
    ("shift", "side", "pressure_mpa"),
    # Manchester benchmark in CONTACT: yaw 2.4 mrad per mm, 10 kN per wheel.
    [(1.0, -1, 424), (1.0, 1, 741), (3.0, -1, 499), (3.0, 1, 713), (5.0, -1, 553)],
)
def test_hertz_pressures_are_those_of_contact(pair, sharp, shift, side, pressure_mpa):
    u, psi = 1e-3 * shift, 2.4e-3 * shift
    roll = float(wheelset_contact(pair, u, psi).roll)
    a, b = patch(sharp, TREAD, side * u, side * roll, side * psi)[4:6]
    force = 1e4
    pressure = 1.5 * np.cbrt(force) / (np.pi * a * b)
    # 5 %: the patch is an ellipse only where curvatures are constant over it.
    assert 1e-6 * pressure == pytest.approx(pressure_mpa, rel=0.05)


def radius_difference(pair, arrays, shift) -> float:
    """Right minus left by the table, both wheels on rigid rails [mm]."""
    psi = 2.4 * shift
    roll = float(wheelset_contact(pair, shift, psi).roll)
    radii = []
    for side in (1, -1):
        pose = side * shift, side * roll, side * psi
        zone = min(ZONES, key=lambda zone: touch(arrays, zone, *pose)[0])
        radii.append(patch(arrays, zone, *pose)[0])
    return 1e3 * (radii[0] - radii[1])


def test_patches_that_share_10_kn_roll_as_in_the_benchmark(pair):
    arrays = contact_arrays(pair, load=1e4)
    # CONTACT's points of Manchester, 1 to 4.5 mm, within what was asked.
    expected = [0.609, 0.710, 0.801, 0.893, 0.992, 1.103, 1.232, 1.392]
    shifts = np.arange(1.0, 4.6, 0.5)
    found = [radius_difference(pair, arrays, 1e-3 * shift) for shift in shifts]
    np.testing.assert_allclose(found, expected, atol=0.05)


@pytest.mark.slow
def test_at_a_jump_the_load_sets_the_width_and_not_the_steps(pair):
    # 0.5 mm is beside the jump at 0.2 mm, over which the difference rises by 0.43 mm.
    found = [
        radius_difference(pair, contact_arrays(pair, shift_step=step), 5e-4)
        for step in (4e-4, 2e-4, 1e-4)
    ]
    assert np.ptp(found) < 0.02


def test_the_stiffness_of_a_jump_does_not_push_outwards(arrays):
    # -2/5 p^(5/2) dk/du at 60 kN; the slopes to both sides differ by 0.05, 3 kN. Over one step of
    # the table it was thousands of newtons.
    u = np.arange(-1e-3, 1.5e-3, 2e-5)
    values = touches(arrays, TREAD, u, 0 * u, 0 * u)
    approach = (60e3 / values[4]) ** (2.0 / 3.0)
    assert np.max(np.abs(0.4 * approach**2.5 * values[5])) < 300.0


def test_patch_is_longer_in_the_direction_of_the_larger_radius(arrays):
    # Centred, wheel and rail have 1.3 m across and 0.46 m along; 3 mm to the flange 0.15 m across.
    along, across = patch(arrays, TREAD, 0.0, 0.0, 0.0)[4:6]
    assert across > along
    along, across = patch(arrays, TREAD, 3e-3, 0.0, 0.0)[4:6]
    assert along > across


def test_creep_coefficients_of_the_patch_are_kalkers(sharp):
    values = patch(sharp, TREAD, -5e-3, 0.0, 0.0)
    expected = kalker_coefficients(values[4] / values[5])
    # 5e-4: each is averaged and interpolated between nodes on its own.
    np.testing.assert_allclose(values[6:], np.array(expected), rtol=5e-4)


def test_centred_wheels_sink_under_10_kn_as_far_as_in_the_benchmark(pair, arrays):
    k = touch(arrays, TREAD, 0.0, 0.0, 0.0)[4]
    down = pair.wheel_radius - pair.axle_height + (1e4 / k) ** (2.0 / 3.0)
    # CONTACT says 0.1981 mm; 0.006 mm: next to the jump at 0.2 mm its patch is two in one, and
    # the table's stiffness is averaged over both.
    assert 1e3 * down == pytest.approx(0.1981, abs=6e-3)


def test_conformal_contact_has_a_bounded_stiffness(pair, arrays):
    # The largest k_n that the bounds allow: the rail's corner of 13 mm, a tenth of its curvature.
    bound = hertz_contact(0.3, 1.0 / 1.5).stiffness
    assert np.max(arrays.spline[..., 2]) < bound


def test_two_builds_of_a_table_are_equal(pair, arrays):
    again = contact_arrays(pair)
    np.testing.assert_array_equal(again.spline, arrays.spline)
    np.testing.assert_array_equal(again.patch, arrays.patch)


def test_steps_without_an_inside_are_refused(pair):
    with pytest.raises(ArgumentError, match="shift_step = -1 must be above zero"):
        contact_arrays(pair, shift_step=-1.0)
    with pytest.raises(ArgumentError, match=r"roll_step = 0\.1 rad makes 2 steps"):
        contact_arrays(pair, roll_step=0.1)
