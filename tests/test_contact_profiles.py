"""Wheel and rail profiles of the catalogue: their geometry and their names."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from railenv.contact import Profile, get_profile, profile_names
from railenv.errors import ArgumentError

CATALOGUE = (*profile_names("wheel"), *profile_names("rail"))
MM = 1e3


def height(profile: Profile, y_mm: float) -> float:
    return MM * float(profile.spline()(y_mm / MM))


def flank(profile: Profile, z_mm: float) -> float:
    """y of the flange's face at a depth below the tape circle [mm]."""
    part = slice(int(np.argmax(profile.z)), int(np.searchsorted(profile.y, 0.0)))
    return MM * float(np.interp(-z_mm, -MM * profile.z[part], profile.y[part]))


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_nominal_outline_turns_no_faster_than_its_smallest_radius(name: str) -> None:
    # A step in height or a bend at any joint of two arcs would turn the chord at once. Chords of
    # 0.05 mm on 12 mm radius, the smallest of all, turn by 0.05 / 12 rad; S1002's own joints are
    # open by 1e-8 rad and 6e-8 mm.
    profile = get_profile(name)
    across, down = MM * np.diff(profile.y), MM * np.diff(profile.z)
    assert np.hypot(across, down).max() <= 0.0501
    turn = np.abs(np.diff(np.arctan2(down, across)))
    assert turn.max() <= 0.05 / 12.0 * 1.001


@pytest.mark.parametrize("name", CATALOGUE)
def test_a_nominal_profile_is_zero_at_its_origin(name: str) -> None:
    profile = get_profile(name)
    if profile.kind == "wheel":
        assert abs(float(profile.spline()(0.0))) < 2e-8  # LMA's fitted arc passes 7e-9 m above
    else:
        assert abs(float(profile.z.min())) < 2e-9  # its points straddle the crown by 0.025 mm


def test_s1002_has_the_flange_that_en_13715_names() -> None:
    s1002 = get_profile("s1002")
    # Height 28, thickness 32.5 at 10 mm below the tape circle (70 mm from the back), and the
    # gradient dimension qR = 10.8 from there to 2 mm above the tip; printed to 0.1 mm.
    assert MM * s1002.z.max() == pytest.approx(28.0, abs=1e-4)
    assert flank(s1002, 10.0) + 70.0 == pytest.approx(32.5, abs=0.05)
    assert flank(s1002, 10.0) - flank(s1002, 26.0) == pytest.approx(10.8, abs=0.05)


def test_s1002_is_the_standards_polynomial_in_its_running_zone() -> None:
    y = np.array([-20.0, -10.0, 10.0, 30.0])
    # Zone B by Horner's rule, another way than the catalogue's; to rounding of the spline.
    b = (-3.358537058e-2, 1.565681624e-3, -2.810427944e-5, 5.844240864e-8, -1.562379023e-8)
    b += (5.309217349e-15, -5.957839843e-12, 2.646656573e-13)
    expected = np.zeros(4)
    for coefficient in reversed(b):
        expected = (expected + coefficient) * y
    found = [height(get_profile("s1002"), value) for value in y]
    assert found == pytest.approx(expected.tolist(), abs=1e-9)


def test_closing_s1002s_joints_moves_zone_c_by_its_rounding_only() -> None:
    c = (4.320221063e3, 1.038384026e3, 1.065501873e2, 6.051367875)
    c += (2.054332446e-1, 4.169739389e-3, 4.687195829e-5, 2.252755540e-7)
    y = np.linspace(-34.9, -26.1, 50)
    printed = -sum(coefficient * y**k for k, coefficient in enumerate(c))
    found = np.array([height(get_profile("s1002"), value) for value in y])
    assert np.abs(found - printed).max() < 1.3e-4


def test_s1002cn_is_s1002_moved_by_three_millimetres() -> None:
    moved, s1002 = get_profile("s1002cn"), get_profile("s1002")
    down = height(s1002, -3.0)
    for y in (-40.0, -20.0, 0.0, 25.0):
        assert height(moved, y) == pytest.approx(height(s1002, y - 3.0) - down, abs=1e-6)


def test_lma_and_lmb10_meet_the_points_that_were_published() -> None:
    lma, lmb10 = get_profile("lma"), get_profile("lmb10")
    # The fit's own centre of the root arc, printed to 0.01 mm.
    root = 16.86 - np.sqrt(14.0**2 - (-35.0 + 24.87) ** 2)
    assert height(lma, -35.0) == pytest.approx(root, abs=0.02)
    assert height(lma, 30.0) == pytest.approx(-0.77, abs=0.012)  # rounded edge
    # Points of a table that is rounded and differs from the fit by 4 um on the tread.
    for y, z in ((-20.0, 1.5218), (-11.0, 0.5147), (-5.0, 0.2002), (4.0, -0.12), (50.0, -2.1035)):
        assert height(lma, y) == pytest.approx(z, abs=0.005)
    # The flange is completed here, 0.2 mm beside the table's.
    for y, z in ((-39.0, 16.4254), (-42.0, 22.5165), (-50.0, 27.5827)):
        assert height(lma, y) == pytest.approx(z, abs=0.3)
    assert flank(lma, 12.0) + 70.0 == pytest.approx(32.0, abs=0.05)  # flange thickness
    assert height(lmb10, 4.0) == pytest.approx(-0.222957, abs=1e-7)
    assert height(lmb10, -39.17) == pytest.approx(12.48, abs=0.01)
    assert flank(lmb10, 16.68) == pytest.approx(-40.7, abs=0.05)  # where the tables end the face
    for profile, tip in ((lma, -53.6), (lmb10, -54.0)):
        assert MM * profile.z.max() == pytest.approx(28.0, abs=1e-4)
        assert MM * profile.y[np.argmax(profile.z)] == pytest.approx(tip, abs=0.05)


def test_rail_heads_have_the_published_widths() -> None:
    for name, half, depth in (("60e1", 36.0, 14.26), ("cn60", 35.39, 14.19)):
        rail = get_profile(name)
        assert height(rail, half) == pytest.approx(depth, abs=0.06)  # slope 20, half to 0.003 mm
        assert rail.z == pytest.approx(rail.z[::-1], abs=1e-15)
        # R300 on the crown, R80 beside it.
        assert height(rail, 8.0) == pytest.approx(300.0 - np.sqrt(300.0**2 - 64.0), abs=1e-7)
    centre_y, centre_z = 7.6998, 80.1348
    found = height(get_profile("60e1"), 20.0)
    assert found == pytest.approx(centre_z - np.sqrt(80.0**2 - (20.0 - centre_y) ** 2), abs=1e-4)


@given(slope=st.floats(0.0, 0.2))
@settings(max_examples=10, deadline=None)
def test_a_cones_tread_is_straight_up_to_its_root(slope: float) -> None:
    profile = get_profile(f"cone:angle={slope}")
    tread = profile.y > -0.0245
    assert profile.z[tread] == pytest.approx(-slope * profile.y[tread], abs=1e-15)
    assert MM * profile.z.max() == pytest.approx(28.0, abs=1e-4)  # S1002's flange


@given(radius=st.floats(0.01, 10.0))
@settings(max_examples=10, deadline=None)
def test_an_arcs_head_is_a_circle_no_wider_than_a_60e1(radius: float) -> None:
    profile = get_profile(f"arc:radius={radius}")
    inside = np.abs(profile.y) < min(0.022, 0.9 * radius)
    off = np.hypot(profile.y[inside], profile.z[inside] - radius) - radius
    assert np.abs(off).max() < 1e-12
    side = float(np.interp(0.015, profile.z[profile.y > 0.0], profile.y[profile.y > 0.0]))
    assert side <= 0.0362  # on the side of 1:20, a little below the corner


def test_profiles_cannot_be_changed_and_share_nothing() -> None:
    first, second = get_profile("lma"), get_profile("lma")
    assert not np.shares_memory(first.z, second.z)
    with pytest.raises(ValueError, match="read-only"):
        first.z[0] = 1.0


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("s1003", "did you mean 's1002'"),
        ("cone", "must have the form cone:angle=0.17"),
        ("cone:angel=0.1", "must have the form"),
        ("cone:angle=0.3", "out of range; give 0 to 0.2"),
        ("cone:angle=nan", "not a finite number"),
        ("arc:radius=0", "out of range"),
        ("arc:radius=", "not a finite number"),
    ],
)
def test_an_unusable_name_is_named(name: str, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        get_profile(name)


@pytest.mark.parametrize(
    ("y", "z", "words"),
    [
        (np.arange(12.0)[::-1], np.zeros(12), "must rise"),
        (np.arange(12.0), np.zeros(11), "one z for each y"),
        (np.arange(12.0), np.full(12, np.nan), "finite"),
        (np.arange(5.0), np.zeros(5), "10 numbers or more"),
    ],
)
def test_a_profile_of_unusable_points_is_refused(y, z, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        Profile("mine", "wheel", y, z)
