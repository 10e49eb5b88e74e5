"""Nominal rail heads, in millimetres: y from the symmetry line, z down from the crown, uncanted.

60E1 (EN 13674-1) and CN60 (60 kg/m, GB 2585) are tangent arcs R300, R80 and R13 and a side of 1:20;
the half-widths where arcs meet are fits to point tables (3e-5 mm and 2e-3 mm), centres follow from
tangency. Sides end 25 mm below the crown.
"""

import math

from railenv.contact.profile_pieces import Arc, Line, arc_from, sampled
from railenv.units import FloatArray

_SPACING = 0.05
_DEPTH = 25.0
_SIDE = 20.0
_HALF_WIDTH = 36.0
_CORNER = 13.0


def rail_60e1() -> tuple[FloatArray, FloatArray]:
    """Return the head of 60E1 (UIC60), y and z [mm]."""
    return _three_arcs(10.5, 25.988)


def rail_cn60() -> tuple[FloatArray, FloatArray]:
    """Return the head of the Chinese 60 kg/m rail, y and z [mm]."""
    return _three_arcs(10.0, 25.33)


def circular(radius: float) -> tuple[FloatArray, FloatArray]:
    """Return a circular head with sides of 1:20, y and z [mm].

    A head that would be wider than 60E1's gets 60E1's width by corners of 13 mm radius, so that the
    gauge is measured at the same place.

    Args:
        radius: Radius of the running surface [mm].
    """
    crown = Arc(0.0, radius, radius, -1)
    end = crown.where(_SIDE)
    if end <= _HALF_WIDTH:
        return _symmetric([(crown, end)])
    corner_y = _HALF_WIDTH - _CORNER * _SIDE / math.hypot(1.0, _SIDE)
    joint = radius * corner_y / (radius - _CORNER)
    corner = arc_from(joint, crown.at(joint), crown.slope_at(joint), _CORNER, -1)
    return _symmetric([(crown, joint), (corner, corner.where(_SIDE))])


def _three_arcs(first: float, second: float) -> tuple[FloatArray, FloatArray]:
    crown = Arc(0.0, 300.0, 300.0, -1)
    shoulder = arc_from(first, crown.at(first), crown.slope_at(first), 80.0, -1)
    corner = arc_from(second, shoulder.at(second), shoulder.slope_at(second), _CORNER, -1)
    return _symmetric([(crown, first), (shoulder, second), (corner, corner.where(_SIDE))])


def _symmetric(arcs: list[tuple[Arc, float]]) -> tuple[FloatArray, FloatArray]:
    """Return a head of arcs, the first one the crown, each up to its y, and sides [mm]."""
    crown, end = arcs[0]
    pieces = [crown.between(-end, end)]
    for arc, high in arcs[1:]:
        mirrored = arc._replace(centre_y=-arc.centre_y)
        pieces = [mirrored.between(-high, -end), *pieces, arc.between(end, high)]
        end = high
    depth = arcs[-1][0].at(end)
    reach = end + max(_DEPTH - depth, 1.0) / _SIDE
    left, right = Line(depth - _SIDE * end, -_SIDE), Line(depth - _SIDE * end, _SIDE)
    return sampled([left.between(-reach, -end), *pieces, right.between(end, reach)], _SPACING)
