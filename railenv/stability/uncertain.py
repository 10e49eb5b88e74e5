"""Families of delay systems: entries known up to an interval, parameters known up to an interval.

    A = A_0 + sum_k p_k A_k + E_A,   |p_k| <= 1,   |E_A| <= A_radius entry by entry,

B and K alike with the same p_k. Parameters say that many entries move together (1/v stands in
every creep term); radii let every entry move by itself, which is far more pessimistic where entries
are in fact tied. A member is any choice of parameters and entries; it does not change with time.

This module holds the value; proofs about every member are in `railenv.stability.proof.uncertain`.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from railenv.errors import ArgumentError, check_finite, check_not_negative
from railenv.stability.delay_system import DelaySystem
from railenv.stability.loops import real_matrix
from railenv.stability.uncertain_corners import (
    built_at_corners,
    checked_range,
    covering_model,
    middle_and_radius,
)
from railenv.units import FloatArray

Triple = tuple[FloatArray, FloatArray, FloatArray]
"""What belongs to A, to B and to K."""

NAMES = ("A", "B", "K")

MOST_PARAMETERS = 8
"""Most parameters of `between`: it builds a loop for each of their 2^8 corners."""

_ABSENT: FloatArray = np.zeros((0, 0))


def _absent() -> FloatArray:
    return _ABSENT


@dataclass(frozen=True, eq=False)
class UncertainDelaySystem:
    """Every loop whose matrices lie within intervals around those of a nominal one.

    Attributes:
        nominal: The loop in the middle, a member itself.
        A_radius: Largest change of each entry of A by itself, shape (n, n); none unless given.
        B_radius: The same for B, shape (n, m).
        K_radius: The same for K, shape (m, n).
        directions: For each parameter p_k in [-1, 1] what it adds to A, B and K at p_k = 1.

    Raises:
        ArgumentError: A shape does not fit, a number is not finite, or a radius is negative.
        NeutralLoopError: The nominal loop is neutral.
    """

    nominal: DelaySystem
    A_radius: FloatArray = field(default_factory=_absent)
    B_radius: FloatArray = field(default_factory=_absent)
    K_radius: FloatArray = field(default_factory=_absent)
    directions: tuple[Triple, ...] = ()

    def __post_init__(self) -> None:
        self.nominal.require_retarded("an uncertain delay system")
        for name in NAMES:
            given = getattr(self, f"{name}_radius")
            radius = _like(getattr(self.nominal, name), f"{name}_radius", given, may_lack=True)
            if np.any(radius < 0.0):
                raise ArgumentError(
                    f"{name}_radius holds {radius.min():g}; a radius must not be negative: give "
                    "the largest change of each entry in either direction"
                )
            object.__setattr__(self, f"{name}_radius", radius)
        checked: list[Triple] = []
        for k, direction in enumerate(self.directions):
            if len(direction) != len(NAMES):
                raise ArgumentError(
                    f"directions[{k}] has {len(direction)} matrices; give three: for A, B and K"
                )
            A, B, K = (
                _like(getattr(self.nominal, name), f"directions[{k}] for {name}", matrix)
                for name, matrix in zip(NAMES, direction, strict=True)
            )
            checked.append((A, B, K))
        object.__setattr__(self, "directions", tuple(checked))

    @classmethod
    def from_balls(cls, A: Any, B: Any, K: Any) -> "UncertainDelaySystem":
        """Take ball matrices of python-flint (`arb_mat`), each entry by itself.

        Radii are rounded outwards: every matrix in the balls is a member.

        Raises:
            ArgumentError: A matrix holds a ball that is not finite, or a shape does not fit.
        """
        middles: list[FloatArray] = []
        radii: list[FloatArray] = []
        for name, matrix in zip(NAMES, (A, B, K), strict=True):
            try:
                shape, entries = (matrix.nrows(), matrix.ncols()), list(matrix.entries())
                pairs = [middle_and_radius(entry) for entry in entries]
            except (AttributeError, TypeError, ValueError, OverflowError):
                raise ArgumentError(
                    f"{name} is no matrix of finite real balls; give an arb_mat of python-flint"
                ) from None
            middles.append(np.array([a for a, _ in pairs]).reshape(shape))
            radii.append(np.array([r for _, r in pairs]).reshape(shape))
        return _independent(middles, radii)

    @classmethod
    def hull(cls, systems: Sequence[DelaySystem]) -> "UncertainDelaySystem":
        """Return the smallest family of independent entries that holds all given loops.

        The loops of all speeds between two corners are in the hull of the corners only if every
        entry of A, B and K is monotone in every parameter (with the others held), as entries affine
        in one parameter or in its inverse are. What the doubles of the corners have lost by
        rounding when they were assembled is not covered either; `inflate` adds room for it. The
        entries of a hull move independently: `between` proves far wider ranges.

        Raises:
            ArgumentError: No system is given, or their sizes differ.
        """
        _same_size(systems)
        middles: list[FloatArray] = []
        radii: list[FloatArray] = []
        for name in NAMES:
            stack: FloatArray = np.array([getattr(system, name) for system in systems])
            low: FloatArray = np.min(stack, axis=0, initial=np.inf)
            high: FloatArray = np.max(stack, axis=0, initial=-np.inf)
            middle: FloatArray = np.where(low == high, low, low / 2 + high / 2)
            radius: FloatArray = np.maximum(high - middle, middle - low)
            middles.append(middle)
            # A difference of doubles is off by half a unit in the last place at most.
            radii.append(np.where(radius > 0.0, np.nextafter(radius, np.inf), 0.0))
        return _independent(middles, radii)

    @classmethod
    def between(
        cls,
        build: Callable[..., DelaySystem],
        ranges: Sequence[tuple[float, float]],
        curved: int | None = None,
    ) -> "UncertainDelaySystem":
        """Return a family that holds `build(*values)` for all values within ranges.

        It is built at the ranges' corners. That covers what lies between if each parameter enters
        all entries through one monotone function of itself, affinely with the others held: 1/v for
        the speed, the conicity itself. Products of parameters become radii. One parameter may enter
        otherwise (a mass stands in some entries as m, in others as 1/m): name it as `curved`, then
        every entry must be convex or concave in it, the loop is also built at the middle of its
        range, and the bend becomes a radius.

        These conditions cannot be checked from samples. Rounding in `build` is not covered; follow
        with `inflate(1e-12)` or what its arithmetic needs.

        Args:
            build: Returns the loop for one value per range.
            ranges: Lowest and highest value of each parameter.
            curved: Position of the parameter that enters convexly or concavely.

        Raises:
            ArgumentError: A range is reversed, there are too many, or the loops differ in size.
        """
        ends = [checked_range(k, pair) for k, pair in enumerate(ranges)]
        if len(ends) > MOST_PARAMETERS:
            raise ArgumentError(
                f"ranges has {len(ends)} entries; give at most {MOST_PARAMETERS} parameters"
            )
        if curved is not None and not 0 <= curved < len(ends):
            raise ArgumentError(
                f"curved = {curved} is no position in ranges; give 0 to {len(ends) - 1}"
            )
        built, bends = built_at_corners(build, ends, curved)
        _same_size([*built.values(), *bends.values()])
        models = [
            covering_model(
                {c: getattr(system, name) for c, system in built.items()},
                {c: getattr(system, name) for c, system in bends.items()},
                curved,
            )
            for name in NAMES
        ]
        (A, A_slopes, A_radius), (B, B_slopes, B_radius), (K, K_slopes, K_radius) = models
        directions = tuple(zip(A_slopes, B_slopes, K_slopes, strict=True))
        return cls(DelaySystem(A, B, K), A_radius, B_radius, K_radius, directions)

    @property
    def num_parameters(self) -> int:
        """Number of parameters."""
        return len(self.directions)

    def inflate(self, relative: float) -> "UncertainDelaySystem":
        """Return the family with every entry's radius grown by a share of the entry's size.

        Args:
            relative: Share of the largest modulus that the entry reaches [1].

        Raises:
            ArgumentError: The share is negative or not finite.
        """
        share = check_not_negative("relative", relative)
        radii: list[FloatArray] = []
        for index, name in enumerate(NAMES):
            radius: FloatArray = getattr(self, f"{name}_radius")
            size: FloatArray = np.abs(getattr(self.nominal, name)) + radius
            for direction in self.directions:
                size = size + np.abs(direction[index])
            radii.append(radius + share * size)
        A, B, K = radii
        return UncertainDelaySystem(self.nominal, A, B, K, self.directions)

    def with_entries_as_parameters(self) -> "UncertainDelaySystem":
        """Return the same family with a parameter for every entry that has a radius.

        A radius is held against every phase of the entry's effect, a parameter against its own
        only, and it can be cut; worth it for a few entries.

        Raises:
            ArgumentError: There would be more than `MOST_PARAMETERS` parameters.
        """
        directions = list(self.directions)
        for index, name in enumerate(NAMES):
            radius: FloatArray = getattr(self, f"{name}_radius")
            places = np.argwhere(radius > 0.0).tolist()
            if len(directions) + len(places) > MOST_PARAMETERS:
                raise ArgumentError(
                    f"{name}_radius has {len(places)} entries above zero; "
                    f"{MOST_PARAMETERS} parameters are the most: leave them as radii"
                )
            for i, j in places:
                step = [np.zeros_like(getattr(self.nominal, other)) for other in NAMES]
                step[index][i, j] = radius[i, j]
                directions.append((step[0], step[1], step[2]))
        return UncertainDelaySystem(self.nominal, directions=tuple(directions))

    def member(self, parameters: Sequence[float]) -> DelaySystem:
        """Return the loop at given parameters in [-1, 1], entries rounded to doubles.

        Raises:
            ArgumentError: There are more or fewer than the family has, or one is out of range.
        """
        if len(parameters) != self.num_parameters:
            raise ArgumentError(
                f"parameters has {len(parameters)} entries; give {self.num_parameters}"
            )
        found: list[FloatArray] = [getattr(self.nominal, name) for name in NAMES]
        for k, direction in enumerate(self.directions):
            p = check_finite(f"parameters[{k}]", parameters[k])
            if abs(p) > 1.0:
                raise ArgumentError(f"parameters[{k}] = {p:g} is outside the family; give -1 to 1")
            found = [value + p * change for value, change in zip(found, direction, strict=True)]
        return DelaySystem(found[0], found[1], found[2])

    def to_plain(self) -> dict[str, Any]:
        """Return all numbers as lists."""
        plain: dict[str, Any] = {"kind": "uncertain delay system"}
        for name in NAMES:
            plain[name] = getattr(self.nominal, name).tolist()
            plain[f"{name}_radius"] = getattr(self, f"{name}_radius").tolist()
        plain["directions"] = [
            {name: matrix.tolist() for name, matrix in zip(NAMES, direction, strict=True)}
            for direction in self.directions
        ]
        return plain


def _like(model: FloatArray, name: str, given: Any, *, may_lack: bool = False) -> FloatArray:
    if may_lack and given is _ABSENT:
        matrix: FloatArray = np.zeros(model.shape)
    else:
        matrix = real_matrix(name, given)
    if matrix.shape != model.shape:
        raise ArgumentError(f"{name} has shape {matrix.shape}; it must be {model.shape}")
    matrix.setflags(write=False)
    return matrix


def _independent(middles: list[FloatArray], radii: list[FloatArray]) -> UncertainDelaySystem:
    A, B, K = middles
    A_radius, B_radius, K_radius = radii
    return UncertainDelaySystem(DelaySystem(A, B, K), A_radius, B_radius, K_radius)


def _same_size(systems: Sequence[DelaySystem]) -> None:
    if not systems:
        raise ArgumentError("systems is empty; give at least one DelaySystem")
    first = systems[0]
    for system in systems:
        system.require_retarded("a family of delay systems")
        if system.A.shape != first.A.shape or system.B.shape != first.B.shape:
            raise ArgumentError(
                f"a loop has {system.num_states} states and {system.num_channels} channels, "
                f"another {first.num_states} and {first.num_channels}; a family has one size"
            )
