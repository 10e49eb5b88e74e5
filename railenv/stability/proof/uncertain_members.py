"""Single members of a family: which of them looks unstable, and the proof for one of them.

A count of roots is exact for the doubles it is given. For it to say something of the family those
doubles must be a member, which is checked in rational numbers: rounding p_k A_k may have moved them
out, unless the radii leave room for it.
"""

import itertools
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np

from railenv.errors import ArgumentError, check_not_negative
from railenv.stability.delay_system import DelaySystem
from railenv.stability.proof.contour import Box
from railenv.stability.proof.delay_box import Proof, prove_box
from railenv.stability.proof.region import Region
from railenv.stability.proof.uncertain_frames import Part
from railenv.stability.spectrum import rightmost_roots
from railenv.stability.uncertain import NAMES, UncertainDelaySystem
from railenv.units import ComplexArray, FloatArray

_MOST_CORNERS = 32
# Entries at the end of their radius are pulled in by this share so that rounding keeps them inside.
_PULLED_IN = 1.0 - 1e-12


@dataclass(frozen=True, eq=False)
class Member:
    """One loop of a family at one delay per group.

    Attributes:
        system: Its matrices.
        parameters: p_k.
        delays: One per group [s].
    """

    system: DelaySystem
    parameters: tuple[float, ...]
    delays: tuple[float, ...]


def checked_delays(
    family: UncertainDelaySystem, low: Sequence[float], high: Sequence[float], groups: Any
) -> tuple[list[list[int]], Part]:
    """Return groups and the box of their delays, or raise `ArgumentError`."""
    shared = [[int(k) for k in group] for group in groups]
    channels = sorted(k for group in shared for k in group)
    m = family.nominal.num_channels
    if channels != list(range(m)) or not (shared and (all(shared) or m == 0)):
        raise ArgumentError(
            f"groups = {shared} must hold every channel 0 to {m - 1} once, in groups that are not "
            "empty"
        )
    if not len(low) == len(high) == len(shared):
        raise ArgumentError(
            f"low has {len(low)} and high {len(high)} entries; give one delay per group, "
            f"{len(shared)}"
        )
    first = tuple(check_not_negative("low", tau, "seconds") for tau in low)
    last = tuple(check_not_negative("high", tau, "seconds") for tau in high)
    for a, b in zip(first, last, strict=True):
        if a > b:
            raise ArgumentError(f"low = {a:g} is above high = {b:g}; give low <= high")
    return shared, Part(first, last)


def counted(
    system: DelaySystem,
    groups: Sequence[Sequence[int]],
    delays: Sequence[float],
    decay_rate: float,
) -> Proof:
    """Count the roots of one loop to the right of Re s = -decay_rate, exactly."""
    point = tuple(float(tau) for tau in delays)
    region = Region(decay_rate=decay_rate)
    try:
        return prove_box(system, groups, Box(point, point), region, 1)
    except ArgumentError as error:
        return Proof("UNDECIDED", None, str(error), {})


def count_evidence(proof: Proof, delays: Sequence[float]) -> dict[str, Any]:
    """Return what re-checking a count needs."""
    return {
        "delays": [float(tau) for tau in delays],
        "verdict": proof.verdict,
        "unstable_roots": proof.roots,
        "evidence": proof.evidence,
    }


def seems_unstable(member: Member, groups: Sequence[Sequence[int]], decay_rate: float) -> bool:
    """Whether floating point sees a root to the right; False also if it cannot tell."""
    try:
        found = rightmost_roots(member.system, channel_delays(member, groups).tolist(), 1)
    except (ArgumentError, ArithmeticError, ValueError):
        return False
    return any(mode.root.real > -decay_rate for mode in found)


def channel_delays(member: Member, groups: Sequence[Sequence[int]]) -> FloatArray:
    """Spread one delay per group over the channels."""
    values = np.zeros(member.system.num_channels)
    for group, tau in zip(groups, member.delays, strict=True):
        values[list(group)] = tau
    return values


def corner_members(
    family: UncertainDelaySystem, low: Sequence[float], high: Sequence[float]
) -> list[Member]:
    """Return members at the ends of parameters and delays; the first few if there are many."""
    ranges = [(-1.0, 1.0)] * family.num_parameters
    ends = [*ranges, *({a, b} for a, b in zip(low, high, strict=True))]
    found: list[Member] = []
    for chosen in itertools.islice(itertools.product(*(sorted(e) for e in ends)), _MOST_CORNERS):
        parameters, delays = chosen[: len(ranges)], chosen[len(ranges) :]
        found.append(Member(family.member(parameters), parameters, delays))
    return found


def farthest_member(
    family: UncertainDelaySystem,
    groups: Sequence[Sequence[int]],
    s: complex,
    parameters: tuple[float, ...],
    delays: tuple[float, ...],
) -> Member:
    """Propose the entries within the radii that move the root near s farthest to the right.

    With left and right eigenvectors w, v of M(s) for its eigenvalue next to zero, a change E of A
    moves the root by w E v / (w M' v); every entry takes the sign that moves it to the right.
    """
    member = Member(family.member(parameters), parameters, delays)
    loop = member.system.scaled
    taus = channel_delays(member, groups)
    values, vectors = np.linalg.eig(loop.characteristic_matrix(s, taus))
    near = int(np.argmin(np.abs(values)))
    try:
        w = np.linalg.inv(vectors)[near]
    except np.linalg.LinAlgError:
        return member
    v = vectors[:, near]
    w = w / (w @ loop.characteristic_derivative(s, taus) @ v)
    z = np.exp(-s * taus)
    slopes: list[ComplexArray] = [
        np.outer(w, v),
        -np.outer(w, z * (loop.K @ v)),
        -np.outer(z * (w @ loop.B), v),
    ]
    moved: list[FloatArray] = []
    for name, slope in zip(NAMES, slopes, strict=True):
        way: FloatArray = np.sign(np.real(slope)) * _PULLED_IN
        moved.append(getattr(member.system, name) + way * getattr(family, f"{name}_radius"))
    return Member(DelaySystem(moved[0], moved[1], moved[2]), parameters, delays)


def belongs(family: UncertainDelaySystem, member: Member) -> bool:
    """Whether a loop's doubles are exactly within the family."""
    p = [Fraction(value) for value in member.parameters]
    for index, name in enumerate(NAMES):
        given, middle = getattr(member.system, name), getattr(family.nominal, name)
        radius = getattr(family, f"{name}_radius")
        for place in np.ndindex(given.shape):
            away = Fraction(float(given[place])) - Fraction(float(middle[place]))
            for value, direction in zip(p, family.directions, strict=True):
                step = float(direction[index][place])
                if step != 0.0:
                    away -= value * Fraction(step)
            if abs(away) > Fraction(float(radius[place])):
                return False
    return True


def proved_unstable(
    family: UncertainDelaySystem,
    groups: Sequence[Sequence[int]],
    member: Member,
    decay_rate: float,
) -> tuple[Proof, dict[str, Any]]:
    """Prove that a member has roots to the right of the line; the proof says if it could not."""
    if not belongs(family, member):
        reason = (
            f"the member at parameters {said(member.parameters)}, rounded to doubles, is outside "
            "the family by its rounding; inflate the family by 1e-14 to let it be proved unstable"
        )
        return Proof("UNDECIDED", None, reason, {}), {}
    proof = counted(member.system, groups, member.delays, decay_rate)
    if proof.verdict != "UNSTABLE":
        reason = proof.reason or "floating point sees an unstable member, the count does not"
        return Proof("UNDECIDED", None, reason, {}), {}
    evidence = {
        "method": "member",
        "member": {
            **{name: getattr(member.system, name).tolist() for name in NAMES},
            "parameters": list(member.parameters),
        },
        "count": count_evidence(proof, member.delays),
    }
    return proof, evidence


def said(values: Sequence[float]) -> str:
    """Return numbers for a message."""
    return "(" + ", ".join(f"{v:.6g}" for v in values) + ")"
