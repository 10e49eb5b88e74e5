"""Proofs about every member of a family of delay systems, at every delay of a box.

The roots of the nominal loop are counted exactly at one delay. Then M(s) is proved regular for
every s on the line Re s = -decay_rate, every delay of the box and every member: beyond a radius
because s outweighs everything, below it part by part (`uncertain_boxes`), with pieces of the line,
delays and parameters cut where that helps most. Family and box are connected, so no root ever
passes the line and the count is the same for all. Where a member seems to have roots to the right
of the line, it is counted exactly.

STABLE holds for constant delays and members that do not change with time.
"""

from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np

from railenv.errors import check_finite
from railenv.stability.proof.counting import Effort
from railenv.stability.proof.polynomials import UndecidedError
from railenv.stability.proof.precision import precision
from railenv.stability.proof.uncertain_boxes import (
    far_radius,
    guess,
    modal_bases,
    proves,
)
from railenv.stability.proof.uncertain_frames import BASIS_BITS, Balls, Floats, Frame, Part, Scaled
from railenv.stability.proof.uncertain_members import (
    Member,
    checked_delays,
    corner_members,
    count_evidence,
    counted,
    farthest_member,
    proved_unstable,
    said,
    seems_unstable,
)
from railenv.stability.uncertain import UncertainDelaySystem
from railenv.units import ComplexArray

MOST_TESTS = 20_000
"""Parts after which a proof is given up; some minutes for 38 states."""

BITS = 96
"""Precision of the balls: V, of order one and whole in 24 bits, may be ill-conditioned by 2^20."""

# The first piece of the line as a share of its length; later ones grow and shrink by themselves.
_FIRST_PIECE = 2.0**-14
_NARROWEST = 2.0**-44
# Looking at a member in floats costs as much as some tests.
_SUSPICIOUS = 6
_LEAST_ROOM = 1e-9

Answer = tuple[str, int | None, str, dict[str, Any]]
"""Verdict, unstable roots, reason, evidence."""


class _WitnessError(Exception):
    """A member that looks unstable."""

    def __init__(self, member: Member) -> None:
        super().__init__(member)
        self.member = member


def prove_uncertain(
    family: UncertainDelaySystem,
    low: Sequence[float],
    high: Sequence[float],
    groups: Sequence[Sequence[int]],
    decay_rate: float = 0.0,
    effort: Effort | None = None,
) -> Answer:
    """Decide whether all members have all roots left of Re s = -decay_rate, at all delays of a box.

    Args:
        family: The loops.
        low: Shortest delay of each group [s].
        high: Longest delay of each group [s].
        groups: Channels that share a delay; together they hold every channel once.
        decay_rate: The line [1/s].
        effort: What it may cost, in parts tested.

    Returns:
        Verdict ("STABLE": every member at every delay; "UNSTABLE": some member at some delay;
        "UNDECIDED"), number of unstable roots (0 if STABLE; of that member if UNSTABLE), reason,
        and the evidence in plain values.

    Raises:
        ArgumentError: Groups or delays do not fit.
    """
    rate = check_finite("decay_rate", decay_rate, "1/s")
    shared, ends = checked_delays(family, low, high, groups)
    question = _Search(family, shared, ends, rate, effort or Effort(MOST_TESTS))
    try:
        return question.answer()
    except _WitnessError as found:
        return question.unstable(found.member)
    except UndecidedError as error:
        return "UNDECIDED", None, str(error), {}


class _Search:
    """One question, with the bases found so far."""

    def __init__(
        self,
        family: UncertainDelaySystem,
        groups: list[list[int]],
        delays: Part,
        rate: float,
        effort: Effort,
    ) -> None:
        self.family, self.groups, self.delays, self.rate = family, groups, delays, rate
        self.effort = effort
        self.floats = Scaled(Floats(), family, groups, rate)
        self.plain = Frame(self.floats, np.eye(family.nominal.num_states, dtype=np.complex128))
        self.kept: list[tuple[Frame, Frame]] = []
        self.bases: list[ComplexArray] = []

    def answer(self) -> Answer:
        """Count the nominal loop, look at corners, then prove that no root passes the line."""
        delays = self.delays.centre
        proof = counted(self.family.nominal, self.groups, delays, self.rate)
        nominal = Member(self.family.nominal, (0.0,) * self.family.num_parameters, delays)
        if proof.verdict == "UNSTABLE":
            return self.unstable(nominal)
        if proof.verdict != "STABLE":
            raise UndecidedError(f"the nominal loop: {proof.reason}")
        for member in corner_members(self.family, self.delays.low, self.delays.high):
            self.look_at(member)
        with precision(BITS):
            self.balls = Scaled(Balls(), self.family, self.groups, self.rate)
            radius = far_radius(self.floats, self.balls, self.delays)
            pieces = self.pieces(radius)
        used: list[int] = sorted(
            {(-c - 1) // 2 for piece in pieces for c in piece["cuts"] if c < 0}
        )
        for piece in pieces:
            # Bases of pieces that were cut shorter after all are left out.
            piece["cuts"] = [
                c if c >= 0 else -1 - 2 * used.index((-c - 1) // 2) - (-c - 1) % 2
                for c in piece["cuts"]
            ]
        exponents = np.frexp(self.family.nominal.state_scale)[1] - 1
        evidence: dict[str, Any] = {
            "method": "parts",
            "count": count_evidence(proof, delays),
            "bits": BITS,
            "scale": [int(e) for e in exponents],
            "basis_bits": BASIS_BITS,
            "bases": [_plain_basis(self.bases[k]) for k in used],
            "radius": radius,
            "pieces": pieces,
        }
        return "STABLE", 0, "", evidence

    def unstable(self, member: Member) -> Answer:
        """Prove one member unstable."""
        proof, evidence = proved_unstable(self.family, self.groups, member, self.rate)
        if proof.verdict != "UNSTABLE":
            return "UNDECIDED", None, proof.reason, {}
        named = f" of the member at parameters {said(member.parameters)}"
        where = named if member.parameters else ""
        return "UNSTABLE", proof.roots, f"{proof.reason}{where}", evidence

    def look_at(self, member: Member) -> None:
        """Raise if a member looks unstable."""
        if seems_unstable(member, self.groups, self.rate):
            raise _WitnessError(member)

    def pieces(self, radius: float) -> list[dict[str, Any]]:
        """Cover the line from the real axis to the radius."""
        found: list[dict[str, Any]] = []
        parameters = self.family.num_parameters
        start, size = 0.0, radius * _FIRST_PIECE
        while start < radius:
            end = min(start + size, radius)
            whole = Part(
                (start, *self.delays.low, *[-1.0] * parameters),
                (end, *self.delays.high, *[1.0] * parameters),
            )
            cuts = self.tree(whole, shortest=size <= radius * _NARROWEST)
            if cuts is None:
                size /= 2.0
                continue
            found.append({"end": end, "cuts": cuts})
            start, size = end, size * 2.0
            if self.effort.progress is not None:
                self.effort.progress(min(start / radius, 1.0))
        return found

    def tree(self, whole: Part, *, shortest: bool) -> list[int] | None:
        """Return the cuts of a piece in preorder; None if a shorter piece should be tried.

        An axis (0 the line, then the groups, then the parameters) is cut in the middle; a leaf is
        -1 - 2 b - f for basis number b and f = 1 if exponentials are free.
        """
        cuts: list[int] = []
        work: list[tuple[Part, int]] = [(whole, 0)]
        while work:
            part, depth = work.pop()
            self.effort.spend()
            leaf, frame, free = self.attempt(part)
            if leaf is not None:
                cuts.append(leaf)
                continue
            axis = self.axis(part, frame, free)
            if axis == 0 and depth == 0 and not shortest:
                return None
            middle = part.centre
            if not part.low[axis] < middle[axis] < part.high[axis]:
                raise UndecidedError(f"a root may be on the line {self.place(middle)}")
            if depth % _SUSPICIOUS == _SUSPICIOUS - 1:
                delays, parameters = self.split(middle)
                self.look_at(Member(self.family.member(parameters), parameters, delays))
            cuts.append(axis)
            below, above = part.halves(axis)
            work += [(above, depth + 1), (below, depth + 1)]
        return cuts

    def attempt(self, part: Part) -> tuple[int | None, Frame, bool]:
        """Try a part in the basis used last, then in its own.

        Returns:
            The leaf, or None; then the frame, and whether exponentials are free, that come nearest.
        """
        nearest: list[tuple[float, Frame, bool]] = []
        for free in (True, False):
            if self.kept:
                frame, balls = self.kept[-1]
                told = guess(frame.terms(part, free=free))
                if told.holds and proves(balls, part, told, free=free):
                    return -1 - 2 * (len(self.kept) - 1) - int(free), frame, free
            for basis in modal_bases(self.plain, part, free=free):
                try:
                    frame = Frame(self.floats, basis)
                    told = guess(frame.terms(part, free=free))
                    if told.holds:
                        balls = Frame(self.balls, basis)
                        if proves(balls, part, told, free=free):
                            self.kept.append((frame, balls))
                            self.bases.append(basis)
                            return -1 - 2 * (len(self.kept) - 1) - int(free), frame, free
                except (np.linalg.LinAlgError, ZeroDivisionError):
                    continue
                # Where the test fails at the centre by itself, no cut will help this basis.
                point = Part(part.centre, part.centre)
                least = guess(frame.terms(point, free=free))
                if least.holds:
                    # How many times too wide the part is for the room there is at its centre.
                    room = max(1.0 - least.share, _LEAST_ROOM)
                    nearest.append(((told.share - least.share) / room, frame, free))
                    break
        if not nearest:
            self.give_up(part)
        _, frame, free = min(nearest, key=lambda entry: entry[0])
        return None, frame, free

    def give_up(self, part: Part) -> NoReturn:
        """No cut will help: the radii reach a root on the line, or seem to."""
        delays, parameters = self.split(part.centre)
        s = complex(-self.rate, part.centre[0])
        self.look_at(farthest_member(self.family, self.groups, s, parameters, delays))
        raise UndecidedError(
            f"the radii may let a root onto the line {self.place(part.centre)}; narrow them, or "
            "say by parameters which entries move together"
        )

    def axis(self, part: Part, frame: Frame, free: bool) -> int:
        """Return the axis whose halving helps most."""
        shares = [
            (guess(frame.terms(part.shrunk(k), free=free)).share, k)
            for k, (a, b) in enumerate(zip(part.low, part.high, strict=True))
            if a < b
        ]
        return min(shares)[1]

    def split(self, point: tuple[float, ...]) -> tuple[tuple[float, ...], tuple[float, ...]]:
        """Return delays and parameters of a point."""
        return point[1 : 1 + len(self.groups)], point[1 + len(self.groups) :]

    def place(self, point: tuple[float, ...]) -> str:
        """Name a point in a message."""
        delays, parameters = self.split(point)
        named = f", parameters {said(parameters)}" if parameters else ""
        return f"near frequency {point[0]:.6g} rad/s at delays {said(delays)} s{named}"


def _plain_basis(basis: ComplexArray) -> list[list[int]]:
    """Return V as whole numbers, rows of real and imaginary parts in turn."""
    whole = np.round(basis * 2.0**BASIS_BITS)
    return [[int(v) for z in row.tolist() for v in (z.real, z.imag)] for row in whole]
