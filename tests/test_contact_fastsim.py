"""FASTSIM against CONTACT's printed results, closed forms and a plain version of itself."""

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from railenv.contact.fastsim import (
    CreepForce,
    fastsim,
    flexibilities,
    normalised_creepages,
    normalised_forces,
)
from railenv.contact.kalker import kalker_coefficients
from railenv.errors import ArgumentError

# CONTACT (Vollebregt), examples/fastsim.inp and its output: patch, load, creepages in metres.
PATCH = (8e-3, 4e-3, 82e3, 0.3)
CREEPAGES = (0.0, -6.25e-4, 0.625)
LIMIT = 0.3 * 82e3
PRINTED_FLEXIBILITIES = (0.4937e-13, 0.5152e-13, 0.4090e-13)

share = st.floats(-1.0, 1.0)


def case(bound: str, cells: int, flexibility: tuple[float, float, float] | None) -> CreepForce:
    return fastsim(
        *PATCH, *CREEPAGES, flexibility=flexibility, bound=bound, strips=cells, steps=cells
    )


@pytest.mark.parametrize(
    ("bound", "coarse", "fine"), [("parabolic", -0.6118, -0.6359), ("elliptic", -0.6016, -0.5956)]
)
def test_case_of_contact_is_met(bound: str, coarse: float, fine: float) -> None:
    # CONTACT's grids of 44 and 220 cells err in proportion to the cell: the line leads to none.
    without_cells = fine + (fine - coarse) / 4.0
    found = case(bound, 500, PRINTED_FLEXIBILITIES).fy / LIMIT
    # Both printed to four digits, so 1.3e-4 from rounding; the rest for what is not proportional.
    assert found == pytest.approx(without_cells, abs=5e-4)
    # And as asked without any extrapolation, on CONTACT's own finer grid.
    assert case(bound, 220, None).fy / LIMIT == pytest.approx(fine, rel=0.02)


def test_moment_of_the_case_has_contacts_sign_and_size() -> None:
    # The exact theory's -48.21 N m; the simplified theory is known to be some tenths off.
    assert case("elliptic", 100, None).mz == pytest.approx(-48.21, rel=0.15)


def test_printed_flexibilities_are_kalkers_on_their_way_to_one() -> None:
    given = flexibilities(8e-3, 4e-3)
    _, y, spin = CREEPAGES
    turn = 3.0 * math.pi / 32.0 * 8e-3 * spin
    common = (y**2 + turn**2) / (y**2 / given[1] + turn**2 / given[2])
    ways = [(p - g) / (common - g) for p, g in zip(PRINTED_FLEXIBILITIES, given, strict=True)]
    # One and the same share for all three; the last digit printed is worth 0.001, 0.001 and 0.007.
    assert ways[0] == pytest.approx(ways[1], abs=2e-3)
    assert ways[2] == pytest.approx(ways[1], abs=8e-3)
    assert ways[1] == pytest.approx(0.080, abs=1e-3)


def test_our_way_to_one_flexibility_is_near_contacts() -> None:
    ours = case("parabolic", 200, None).fy
    printed = case("parabolic", 200, PRINTED_FLEXIBILITIES).fy
    assert ours == pytest.approx(printed, rel=2e-3)  # shares of 0.084 and 0.080


@pytest.mark.parametrize("scale", [0.1, 1.0, 30.0])
def test_flexibilities_pass_over_to_one_as_stated(scale: float) -> None:
    a, b, normal, friction = PATCH
    creepages = scale * np.array([3e-4, -6e-4, 0.2])
    c11, c22, c23, _ = (float(c) for c in kalker_coefficients(a / b))
    found = normalised_creepages(a, b, c11, c22, c23, 82e9, normal * friction, *creepages)
    # The module's text, step by step: work, r and share from L, then u, v, w with the new L.
    length = np.array([1.0, 1.0, (a + b) / 2])
    slips = creepages * [1.0, 1.0, 3 * math.pi / 32 * a]
    given = np.array(flexibilities(a, b))
    common = np.sum(slips**2) / np.sum(slips**2 / given)
    factor = a / (friction * 2 * normal / (math.pi * a * b)) * length * creepages
    square = np.sum((factor / given) ** 2)
    blended = given + (common - given) * square / (square + 25.0)
    np.testing.assert_allclose(found, factor / blended, rtol=1e-12)  # rounding


def plain(u: float, v: float, w: float, e: float, cells: int) -> tuple[float, float, float]:
    """The textbook's FASTSIM on a rectangular grid, first order in the cell."""
    d = 2.0 / cells
    x = 1.0 - d * (np.arange(cells) + 0.5)
    y = d * (np.arange(cells) + 0.5) - 1.0
    p, fx, fy, mz = np.zeros((2, cells)), 0.0, 0.0, 0.0
    for k in x:
        bound = 1.0 - k * k - y * y
        inside = bound > 0.0
        p = np.where(
            inside, p - d * np.stack([u - (1 - e) * w * y, v + (1 + e) * w * k + 0 * y]), 0
        )
        size = np.maximum(np.hypot(*p), 1e-30)
        p *= np.minimum(1.0, np.maximum(bound, 0.0) / size)
        fx, fy = fx + p[0].sum(), fy + p[1].sum()
        mz += float(((1 + e) * k * p[1] - (1 - e) * y * p[0]).sum())
    return tuple(2.0 / math.pi * d * d * value for value in (fx, fy, mz))


@pytest.mark.parametrize("e", [-0.6, 0.0, 0.5])
@pytest.mark.parametrize("creepages", [(0.5, 0.3, 0.4), (1.0, -2.0, 1.5), (0.2, 0.1, 3.0)])
def test_plain_version_leads_to_the_same(e: float, creepages: tuple[float, ...]) -> None:
    coarse = np.array(plain(*creepages, e, 200))
    fine = np.array(plain(*creepages, e, 400))
    # First order: the extrapolation leaves the grid's raggedness at the patch's edge, below 0.2 %.
    np.testing.assert_allclose(
        normalised_forces(*creepages, e, 150, 300, False), 2 * fine - coarse, atol=2e-3
    )


def test_creepage_without_spin_saturates_as_the_closed_form() -> None:
    # A strip of half-length l sticks up to x = u - l; with s = x + l its force is
    # 2 l^2 u - l u^2 + u^3/6 while u < 2 l, and 4/3 l^3 where all of it slides.
    def strip(y: float, u: float) -> float:
        half = math.sqrt(1.0 - y * y)
        stick = 2 * half**2 * u - half * u**2 + u**3 / 6
        return stick if u < 2 * half else 4 / 3 * half**3

    for u in (0.1, 0.7, 1.3, 1.9, 2.1):
        edge = math.sqrt(max(0.0, 1.0 - u * u / 4.0))
        expected = 2 / math.pi * quad(strip, -1, 1, args=(u,), points=[-edge, edge])[0]
        fx, fy, _ = normalised_forces(u, 0.0, 0.0, 0.3, 200, 400, False)
        assert fx == pytest.approx(-expected, abs=1e-5)  # second order in the cell: (1/400)^2
        assert fy == 0.0


def test_all_slides_from_two_on_without_spin() -> None:
    fx, fy, mz = normalised_forces(1.4143, 1.4143, 0.0, -0.4, 40, 80, False)
    # The last cell of the shortest strip is the only one left to stick.
    assert math.hypot(fx, fy) == pytest.approx(1.0, abs=1e-4)
    assert fx == pytest.approx(fy, rel=1e-12)
    assert abs(mz) < 1e-3  # the parabola's own moment is zero


def test_small_creepages_give_kalkers_forces() -> None:
    a, b, normal, friction = 5e-3, 7e-3, 8e4, 0.4
    c11, c22, c23, _ = (float(c) for c in kalker_coefficients(a / b))
    for xi_x, xi_y, spin in [(1e-7, 0, 0), (0, 1e-7, 0), (0, 0, 1e-5), (1e-7, -3e-7, 2e-5)]:
        force = fastsim(a, b, normal, friction, xi_x, xi_y, spin)
        linear_x = -82e9 * a * b * c11 * xi_x
        linear_y = -82e9 * a * b * (c22 * xi_y + math.sqrt(a * b) * c23 * spin)
        # Sliding at the trailing edge is of the order of the creepage over that of sliding, 1e-4.
        assert force.fx == pytest.approx(linear_x, rel=2e-3, abs=1e-9)
        assert force.fy == pytest.approx(linear_y, rel=2e-3, abs=1e-9)


def test_small_creepages_give_the_simplified_theorys_moment() -> None:
    # p_y = -v (l - x) - (1 + e) w (l^2 - x^2)/2, p_x = (1 - e) w y (l - x), integrated by hand.
    e, v, w = 0.2, 1e-5, 2e-5
    mz = normalised_forces(0.0, v, w, e, 100, 200, False)[2]
    expected = 2 / math.pi * ((1 + e) * v * math.pi / 4 - (1 - e) ** 2 * w * 8 / 15)
    assert mz == pytest.approx(expected, rel=1e-3)  # a spot of sliding at the trailing edge


def test_spin_alone_pushes_sideways_up_to_a_limit_and_then_less() -> None:
    spins = np.geomspace(0.1, 1e4, 60)
    forces = np.array([normalised_forces(0.0, 0.0, w, 0.0, 48, 96, False) for w in spins])
    lateral = -forces[:, 1]
    # Forces along cancel between the two halves of the patch, to the order of summing them.
    np.testing.assert_allclose(forces[:, 0], 0.0, atol=1e-12)
    top = int(np.argmax(lateral))
    # Kalker's exact theory has 0.6 to 0.8 for round patches; the parabola's theory a sharper top.
    assert 0.6 < lateral[top] < 0.9
    assert 1.5 < spins[top] < 2.5
    assert np.all(np.diff(lateral[: top + 1]) > 0.0)
    assert np.all(np.diff(lateral[top:]) < 1e-3)
    # A patch that turns as a whole is symmetric: no force is left but for the cell's width.
    assert abs(lateral[-1]) < 5e-3
    assert forces[-1, 2] < -0.3


def test_sliding_is_against_the_slip_although_the_flexibilities_differ() -> None:
    # a/b = 5 has C11/C22 = 0.96, 0.2 has 1.28; the rest is the way to one flexibility, 25/r^2.
    for ratio in (0.2, 5.0):
        force = fastsim(4e-3 * ratio, 4e-3, 5e4, 0.3, 3.0, 4.0, 0.0)
        assert force.fx == pytest.approx(-0.6 * 0.3 * 5e4, rel=2e-3)
        assert force.fy == pytest.approx(-0.8 * 0.3 * 5e4, rel=2e-3)


@given(share, share, share, share, st.floats(-2.0, 3.0), st.booleans())
def test_force_is_never_beyond_friction(
    u: float, v: float, w: float, e: float, power: float, elliptic: bool
) -> None:
    r = 10.0**power
    fx, fy, _ = normalised_forces(r * u, r * v, r * w, e, 12, 16, elliptic)
    assert math.hypot(fx, fy) <= 1.0 + 1e-12


@given(share, share, share, share)
def test_reversed_creepages_reverse_the_force(u: float, v: float, w: float, e: float) -> None:
    one = normalised_forces(3 * u, 3 * v, 3 * w, e, 12, 16, False)
    other = normalised_forces(-3 * u, -3 * v, -3 * w, e, 12, 16, False)
    np.testing.assert_allclose(one, np.negative(other), atol=1e-13)


@given(share, share, share, share)
def test_mirrored_creepages_mirror_the_force(u: float, v: float, w: float, e: float) -> None:
    fx, fy, mz = normalised_forces(3 * u, 3 * v, 3 * w, e, 12, 16, False)
    mirrored = normalised_forces(3 * u, -3 * v, -3 * w, e, 12, 16, False)
    np.testing.assert_allclose(mirrored, (fx, -fy, -mz), atol=1e-13)


@given(share, share, share, share, st.floats(-2.0, 2.0))
def test_one_flexibility_never_feeds_energy_in(
    u: float, v: float, w: float, e: float, power: float
) -> None:
    # p.(slip - L dp/dx) <= 0 where it slides and the elastic part sums up to -p^2/2 at the rear.
    r = 10.0**power
    fx, fy, mz = normalised_forces(r * u, r * v, r * w, e, 24, 48, False)
    assert (fx * u + fy * v + mz * w) * r <= 1e-9


@pytest.mark.parametrize("scale", [1e-30, 1e30, 1e100])
def test_neither_tiny_nor_huge_creepages_break_it(scale: float) -> None:
    result = normalised_forces(scale, -2 * scale, 0.5 * scale, 0.2, 12, 16, False)
    assert np.all(np.isfinite(result))
    creepages = normalised_creepages(
        5e-3, 4e-3, 4.3, 3.9, 1.7, 82e9, 1e4, scale, -scale, 3.0 * scale
    )
    assert np.all(np.isfinite(creepages))


def test_no_load_gives_no_force() -> None:
    assert fastsim(5e-3, 4e-3, 0.0, 0.3, 0.1, 0.1, 1.0) == (0.0, 0.0, 0.0)


@pytest.mark.parametrize(
    ("change", "match"),
    [
        ({"a": 0.0}, "a = 0"),
        ({"normal": -1.0}, "normal"),
        ({"spin": math.nan}, "spin"),
        ({"bound": "round"}, "bound"),
        ({"strips": 1}, "strips"),
        ({"flexibility": (1e-13, 0.0, 1e-13)}, "flexibility"),
    ],
)
def test_bad_arguments_are_named(change: dict[str, object], match: str) -> None:
    arguments: dict[str, object] = {"a": 5e-3, "b": 5e-3, "normal": 1e4, "friction": 0.3}
    arguments |= {"xi_x": 0.0, "xi_y": 0.0, "spin": 0.0}
    with pytest.raises(ArgumentError, match=match):
        fastsim(**(arguments | change))  # pyright: ignore[reportArgumentType]
