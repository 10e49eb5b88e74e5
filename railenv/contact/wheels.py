"""Nominal wheel profiles, in millimetres: y from the tape circle to the field side, z down.

S1002 follows EN 13715 zone by zone (the coefficients as printed; public copies agree to 2e-6 mm).
Its polynomials are rounded, so that zone C misses its neighbours by 0.04 and 0.12 micrometres; a
cubic of that size closes both joints in height and slope.

LMA and LMB10 are fits to published point tables (to 4 and 5 micrometres). Radii and joints of the
tread and root are the fit's; centres follow from tangency. The fit leaves these parts open, and
they are completed here by tangent arcs, as good as a nominal flange without claim to the standard:

* LMA beyond the root arc R14: a face of 79 degrees (the tables have 78 to 80), then R15, a tip R12
  that reaches z = 28 at y = -53.6, and the back R25.
* LMB10 beyond the end of the root arc R15: the face of 70 degrees goes on until R20 leads into the
  tip R12 that reaches z = 28 at y = -54; the back has S1002's R20.5. The chamfer beyond y = 60 is
  left out.

Both treads bend at y = 30 by 1 to 2.4 degrees; there a radius of 50 mm rounds the edge (it cuts off
11 micrometres or less), so that every profile has a tangent everywhere.

Backs of flanges end where they are steeper than 78.5 degrees: rails touch only the other side.
"""

import math

import numpy as np
from numpy.polynomial import Polynomial
from scipy.interpolate import CubicHermiteSpline

from railenv.contact.profile_pieces import (
    Arc,
    Line,
    Piece,
    arc_from,
    fillet,
    inner_tangent_y,
    sampled,
)
from railenv.units import FloatArray

_SPACING = 0.05
_FIELD_SIDE = 60.0
_BACK = -70.0
_STEEPEST_BACK = math.tan(math.radians(78.5))
_EDGE_RADIUS = 50.0

S1002_SHIFT = 3.0
"""How far S1002 is moved to the field side to make S1002CN [mm]."""

_S1002_A = Line(1.364323640, -0.066666667)
_S1002_B = Polynomial(
    [
        0.0,
        -3.358537058e-2,
        1.565681624e-3,
        -2.810427944e-5,
        5.844240864e-8,
        -1.562379023e-8,
        5.309217349e-15,
        -5.957839843e-12,
        2.646656573e-13,
    ]
)
_S1002_C = -Polynomial(
    [
        4.320221063e3,
        1.038384026e3,
        1.065501873e2,
        6.051367875,
        2.054332446e-1,
        4.169739389e-3,
        4.687195829e-5,
        2.252755540e-7,
    ]
)
_S1002_D = Arc(-26.210665, 16.446, 13.0, -1)
_S1002_E = Line(-93.576667419, -2.747477419)
_S1002_F = Arc(-58.558326413, 8.834924130, 20.0, 1)
_S1002_G = Arc(-55.0, 16.0, 12.0, 1)
_S1002_H = Arc(-49.5, 9.519259302, 20.5, 1)


def s1002() -> tuple[FloatArray, FloatArray]:
    """Return S1002 with a flange of 28 mm height (EN 13715), y and z [mm]."""
    low, high = -35.0, -26.0
    gaps = [_S1002_D.at(low) - _S1002_C(low), _S1002_B(high) - _S1002_C(high)]
    slopes = [
        _S1002_D.slope_at(low) - _S1002_C.deriv()(low),
        _S1002_B.deriv()(high) - _S1002_C.deriv()(high),
    ]
    closing = CubicHermiteSpline([low, high], gaps, slopes)

    def zone_c(y: FloatArray) -> FloatArray:
        return _S1002_C(y) + closing(y)

    pieces = [
        *_s1002_flange(-38.426669071),
        _S1002_D.between(-38.426669071, low),
        Piece(low, high, zone_c),
        Piece(high, 32.15796, _S1002_B),
        _S1002_A.between(32.15796, _FIELD_SIDE),
    ]
    return sampled(pieces, _SPACING)


def s1002cn() -> tuple[FloatArray, FloatArray]:
    """Return S1002 moved to the field side by `S1002_SHIFT`, and down so that z(0) = 0 [mm].

    The thinner flange suits the Chinese back-to-back distance of 1353 mm.
    """
    y, z = s1002()
    inside = y <= _FIELD_SIDE - S1002_SHIFT
    return y[inside] + S1002_SHIFT, z[inside] - float(_S1002_B(-S1002_SHIFT))


def lma() -> tuple[FloatArray, FloatArray]:
    """Return LMA, y and z [mm]; see the module for what is completed."""
    inner = Line(-0.0201, -1.0 / 40.0)
    outer = Line(1.23, -1.0 / 15.0)
    tread = arc_from(4.25, inner.at(4.25), inner.slope, 450.0, -1)
    middle = arc_from(-10.754, tread.at(-10.754), tread.slope_at(-10.754), 90.0, -1)
    root = arc_from(-28.44, middle.at(-28.44), middle.slope_at(-28.44), 14.0, -1)
    face = -math.tan(math.radians(79.0))
    start = root.where(face)
    return sampled(
        [
            *_flange(start, root.at(start), face, front=15.0, tip=-53.6, back=25.0),
            root.between(start, -28.44),
            middle.between(-28.44, -10.754),
            tread.between(-10.754, 4.25),
            *_tread_lines(inner, outer, 4.25),
        ],
        _SPACING,
    )


def lmb10() -> tuple[FloatArray, FloatArray]:
    """Return LMB10, y and z [mm]; see the module for what is completed."""
    inner = Line(-0.222957 + 4.0 / 20.0, -1.0 / 20.0)
    outer = Line(inner.at(30.0) + 30.0 / 15.0, -1.0 / 15.0)
    tread = arc_from(4.0, inner.at(4.0), inner.slope, 350.0, -1)
    middle = arc_from(-18.06, tread.at(-18.06), tread.slope_at(-18.06), 300.0, -1)
    root = arc_from(-27.23, middle.at(-27.23), middle.slope_at(-27.23), 15.0, -1)
    face = -math.tan(math.radians(70.0))
    start = root.where(face)
    return sampled(
        [
            *_flange(start, root.at(start), face, front=20.0, tip=-54.0, back=20.5),
            root.between(start, -27.23),
            middle.between(-27.23, -18.06),
            tread.between(-18.06, 4.0),
            *_tread_lines(inner, outer, 4.0),
        ],
        _SPACING,
    )


def cone(slope: float) -> tuple[FloatArray, FloatArray]:
    """Return a straight tread with S1002's flange, joined by a root of 13 mm radius [mm].

    Args:
        slope: Tangent of the cone's half angle, from 0 to 0.2: the tread is z = -slope y.
    """
    tread = Line(0.0, -slope)
    root = fillet(_S1002_E, tread, 13.0, -1)
    low, high = root.where(_S1002_E.slope), root.where(tread.slope)
    return sampled(
        [*_s1002_flange(low), root.between(low, high), tread.between(high, _FIELD_SIDE)], _SPACING
    )


def _s1002_flange(face_end: float) -> list[Piece]:
    """Return zones H to E of S1002, from the back to where the face is to end [mm]."""
    return [
        _S1002_H.between(_S1002_H.where(_STEEPEST_BACK), -62.764705882),
        _S1002_G.between(-62.764705882, -49.662510381),
        _S1002_F.between(-49.662510381, -39.764473993),
        _S1002_E.between(-39.764473993, face_end),
    ]


def _flange(
    y: float, z: float, face: float, *, front: float, tip: float, back: float
) -> list[Piece]:
    """Return a flange of 28 mm height from its back to the end of the root [mm].

    Args:
        y: Where the root arc ends and the straight face begins.
        z: Height there.
        face: Slope of the face, negative.
        front: Radius between face and tip.
        tip: y of the tip, which has a radius of 12 mm.
        back: Radius between the tip and the wheel's back, where it is upright.
    """
    point = Arc(tip, 28.0 - 12.0, 12.0, 1)
    # The face goes on by `length`, until the front arc's circle holds the tip's: the distance of
    # the two centres, seen from the one that belongs to length 0, gives a quadratic equation.
    start = arc_from(y, z, face, front, 1)
    along = np.array([-1.0, -face]) / math.hypot(1.0, face)
    gap = np.array([point.centre_y - start.centre_y, point.centre_z - start.centre_z])
    towards = float(along @ gap)
    length = towards - math.sqrt(towards**2 - float(gap @ gap) + (front - point.radius) ** 2)
    end_y, end_z = y + length * float(along[0]), z + length * float(along[1])
    front_arc = arc_from(end_y, end_z, face, front, 1)
    behind = _BACK + back
    drop = math.sqrt((back - point.radius) ** 2 - (behind - tip) ** 2)
    back_arc = Arc(behind, point.centre_z - drop, back, 1)
    first, second = inner_tangent_y(back_arc, point), inner_tangent_y(front_arc, point)
    return [
        back_arc.between(back_arc.where(_STEEPEST_BACK), first),
        point.between(first, second),
        front_arc.between(second, end_y),
        Line(z - face * y, face).between(end_y, y),
    ]


def _tread_lines(inner: Line, outer: Line, start: float) -> list[Piece]:
    """Return the two straight parts of a tread from `start`, the edge between them rounded [mm]."""
    edge = fillet(inner, outer, _EDGE_RADIUS, 1)
    low, high = edge.where(inner.slope), edge.where(outer.slope)
    return [
        inner.between(start, low),
        edge.between(low, high),
        outer.between(high, _FIELD_SIDE),
    ]
