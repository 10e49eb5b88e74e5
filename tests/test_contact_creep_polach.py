"""Polach's law against the formulas of his papers, and at the bound."""

import math

import numpy as np
import pytest

from railenv.contact.creep_laws import POLACH, creep_force, make_creep_table
from railenv.contact.hertz import hertz_contact
from railenv.contact.kalker import kalker_coefficients

G = 82e9


def test_polachs_closed_form_of_the_spin_term_is_his() -> None:
    # The paper's K_M with delta = (q^2 - 1)/(q^2 + 1).
    for q in (0.1, 0.7, 1.5, 4.0):
        delta = (q * q - 1) / (q * q + 1)
        paper = q * (delta**3 / 3 - delta**2 / 2 + 1 / 6) - math.sqrt((1 - delta**2) ** 3) / 3
        assert paper == pytest.approx(-2 / 3 * q / (1 + q * q) ** 2, rel=1e-12)


def test_polachs_reductions_are_his() -> None:
    patch, normal, friction, xi = (2.2, 4.0), 8e4, 0.3, 2e-3
    table = make_creep_table("polach", adhesion_reduction=0.8, slip_reduction=0.3)
    hertz = hertz_contact(*patch)
    a = float(hertz.along) * normal ** (1 / 3)
    b = float(hertz.across) * normal ** (1 / 3)
    c = [float(x) for x in kalker_coefficients(a / b)]
    found = creep_force(POLACH, a, b, *c, G, normal, friction, xi, 0.0, 0.0, table)[0]
    # Polach 1999: C = (3/8) G c_jj / a, eps = (2/3) C pi a^2 b s / (Q f).
    eps = 2 / 3 * (3 / 8 * G / a * c[0]) * math.pi * a * a * b * xi / (normal * friction)
    curve = 0.8 * eps / (1 + (0.8 * eps) ** 2) + math.atan(0.3 * eps)
    assert found == pytest.approx(-2 * normal * friction / math.pi * curve, rel=1e-12)


def test_polachs_spin_term_does_not_carry_a_wet_contact_beyond_friction() -> None:
    # With k_A and k_S far below 1 the spin's term, which they do not touch, exceeds friction alone
    # when lateral creepage is half the spin's and against it.
    table = make_creep_table("polach", adhesion_reduction=0.1, slip_reduction=0.1)
    a, b, c = 8e-3, 1e-3, [float(x) for x in kalker_coefficients(8.0)]
    limit = 0.3 * 1e4
    forces = []
    for spin in np.geomspace(1e-2, 10.0, 200):
        found = creep_force(POLACH, a, b, *c, G, 1e4, 0.3, 0.0, -0.5 * spin * a, spin, table)
        forces.append(math.hypot(*found[:2]) / limit)
    assert max(forces) == pytest.approx(1.0, rel=1e-12)  # at the bound, not beyond
