"""Hertz's ellipse and Kalker's coefficients against closed forms, integrals and CONTACT."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad

from railenv.contact.hertz import hertz_contact
from railenv.contact.kalker import kalker_coefficients
from railenv.errors import ArgumentError

COMBINED = 82e9 / (1.0 - 0.28)


def test_sphere_on_a_plane_has_the_closed_form() -> None:
    radius, normal = 0.5, 1e5
    contact = hertz_contact(1.0 / radius, 1.0 / radius)
    a = np.cbrt(0.75 * normal * radius / COMBINED)
    # Rounding only: the circle is an exact root of the equation that is solved.
    assert contact.along * np.cbrt(normal) == pytest.approx(a, rel=1e-13)
    assert contact.across * np.cbrt(normal) == pytest.approx(a, rel=1e-13)
    assert contact.approach * normal ** (2 / 3) == pytest.approx(a**2 / radius, rel=1e-13)


def test_case_of_contact_is_met() -> None:
    # CONTACT, examples/fastsim.inp: curvatures A, B [1/mm] of gap = A x^2 + B y^2 for 8 x 4 mm.
    contact = hertz_contact(2 * 0.8464, 2 * 2.406)
    third = np.cbrt(82e3)
    # A and B are printed to four digits; the approach to three, the pressure to four.
    assert contact.along * third == pytest.approx(8e-3, rel=1e-4)
    assert contact.across * third == pytest.approx(4e-3, rel=1e-4)
    assert contact.approach * third**2 == pytest.approx(0.0927e-3, abs=0.5e-7)
    assert contact.pressure(82e3) == pytest.approx(1223e6, rel=5e-4)


@given(st.floats(0.02, 50.0), st.floats(0.02, 50.0))
def test_pressure_of_the_ellipse_presses_the_given_gap_flat(x: float, y: float) -> None:
    # Displacement of a half-space under the ellipsoid of pressure (Johnson 1985, equation 3.41):
    # delta - gap = 3 N/(4 pi E*) int (1 - x^2/(a^2+w) - y^2/(b^2+w)) dw/sqrt((a^2+w)(b^2+w) w).
    contact = hertz_contact(x, y)
    size = float(contact.along)
    ratio = float(contact.across / contact.along) ** 2

    def integral(power_a: float, power_b: float) -> float:
        # w = (size tan(t))^2 makes the integrand smooth and its range finite.
        def integrand(t: float) -> float:
            tangent = np.tan(t) ** 2
            slim = (1 + tangent) ** (0.5 + power_a) * (ratio + tangent) ** (0.5 + power_b)
            return float(2.0 * (1.0 + tangent) / slim)

        return quad(integrand, 0.0, np.pi / 2, epsrel=1e-11)[0]

    factor = 3.0 / (4.0 * np.pi * COMBINED * size)
    # Eight digits: what the quadrature gives for a slim ellipse.
    assert factor * integral(1, 0) / size**2 == pytest.approx(x / 2, rel=1e-8)
    assert factor * integral(0, 1) / size**2 == pytest.approx(y / 2, rel=1e-8)
    assert factor * integral(0, 0) == pytest.approx(float(contact.approach), rel=1e-8)


def test_long_patch_is_as_wide_as_a_line_contact() -> None:
    contact = hertz_contact(1e-6, 1.0)
    load = 0.75 / contact.along  # greatest force per length for N = 1
    # Line contact b^2 = 4 R p/(pi E*); the rest falls as (b/a)^2, here 1e-8.
    assert contact.across**2 == pytest.approx(4.0 * load / (np.pi * COMBINED), rel=1e-6)


def test_swapped_curvatures_swap_the_axes() -> None:
    one, other = hertz_contact(2.0, [0.3, 2.0, 90.0]), hertz_contact([0.3, 2.0, 90.0], 2.0)
    np.testing.assert_array_equal(one.along, other.across)
    np.testing.assert_array_equal(one.approach, other.approach)


def test_larger_curvature_has_the_smaller_axis() -> None:
    contact = hertz_contact(np.array([1.0, 3.0]), np.array([3.0, 1.0]))
    assert contact.axis_ratio[0] > 1.0 > contact.axis_ratio[1]


def test_ellipse_is_smooth_through_the_circle() -> None:
    # d ln(a/b) / d ln(kappa_y/kappa_x) is 2/3 there; the cubic term is 1e-3 of the step's square.
    ratio = hertz_contact(1.0, [np.exp(-1e-3), np.exp(1e-3), np.exp(1e-2)]).axis_ratio
    np.testing.assert_allclose(np.log(ratio) * 1.5, [-1e-3, 1e-3, 1e-2], rtol=1e-5)


def test_stiffness_and_approach_are_the_same_law() -> None:
    contact = hertz_contact(2.2, 5.0)
    assert contact.stiffness * contact.approach**1.5 == pytest.approx(1.0, rel=1e-14)


@pytest.mark.parametrize("curvature", [0.0, -1.0, np.nan, np.inf])
def test_hollow_as_round_as_its_body_is_refused(curvature: float) -> None:
    with pytest.raises(ArgumentError, match="curvature_across"):
        hertz_contact(1.0, curvature)


def test_poisson_ratio_of_no_solid_is_refused() -> None:
    with pytest.raises(ArgumentError, match="poisson_ratio"):
        hertz_contact(1.0, 1.0, poisson_ratio=0.6)
    with pytest.raises(ArgumentError, match="poisson_ratio"):
        kalker_coefficients(1.0, -0.1)


def test_printed_coefficients_are_met() -> None:
    # Kalker's table E3 at nu = 1/4: a/b = 0.3, 1 and b/a = 0.3; only rounding at the nodes.
    found = kalker_coefficients(np.array([0.3, 1.0, 1 / 0.3]), 0.25)
    np.testing.assert_allclose(found.c11, [3.44, 4.12, 6.34], rtol=1e-12)
    np.testing.assert_allclose(found.c22, [2.75, 3.67, 6.40], rtol=1e-12)
    np.testing.assert_allclose(found.c23, [0.715, 1.47, 4.32], rtol=1e-12)
    np.testing.assert_allclose(found.c33, [2.96, 1.19, 0.674], rtol=1e-12)


@pytest.mark.parametrize("nu", [0.0, 0.25, 0.28, 0.5])
def test_coefficients_between_nodes_stay_between_them(nu: float) -> None:
    # C11 at nu = 1/2 has a shallow minimum; the others rise or fall all along the table.
    ratio = np.geomspace(0.1, 10.0, 400)
    found = kalker_coefficients(ratio, nu)
    for values in found[1:3]:
        assert np.all(np.diff(values) > 0.0)
    assert np.all(np.diff(found.c33) < 0.0)


@pytest.mark.parametrize("nu", [0.0, 0.25, 0.28])
def test_slim_patches_follow_kalkers_limits(nu: float) -> None:
    # Six per cent is how far the printed table at a/b = 0.1 is from its own limit for a/b -> 0
    # (C23 at nu = 0 is furthest); the scaling that joins the two carries that on.
    ratio = 0.01
    found = kalker_coefficients(ratio, nu)
    limits = (
        np.pi**2 / (4 * (1 - nu)),
        np.pi**2 / 4,
        np.pi * np.sqrt(ratio) / (3 * (1 - nu)) * (1 + nu * (np.log(16 / ratio) - 5)),
        np.pi**2 / (16 * (1 - nu) * ratio),
    )
    np.testing.assert_allclose([float(c) for c in found], limits, rtol=0.06)


def test_coefficients_are_continuous_at_the_ends_of_the_table() -> None:
    for edge in (0.1, 10.0):
        near = kalker_coefficients(np.array([edge * (1 - 1e-9), edge * (1 + 1e-9)]))
        for values in near:
            assert values[0] == pytest.approx(values[1], rel=1e-8)  # slopes are of order one


def test_spin_and_side_slip_together_take_energy() -> None:
    # The linear law must not feed energy in: f22 xi^2 + f33 spin^2 > 0 needs positive coefficients.
    found = kalker_coefficients(np.geomspace(1e-3, 1e3, 50))
    assert all(np.all(values > 0.0) for values in found)


@pytest.mark.parametrize("ratio", [0.0, -2.0, np.nan])
def test_axis_ratio_must_be_above_zero(ratio: float) -> None:
    with pytest.raises(ArgumentError, match="axis_ratio"):
        kalker_coefficients(ratio)
