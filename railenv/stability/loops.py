"""Closing loops: linear plants and controllers of any origin become one set of matrices.

    plant       x'  = A x + B f,        y = C x + D f,      f_i(t) = u_i(t - tau_i)
    controller  xc' = Ac xc + Bc y,     u = -(Cc xc + Dc y)

With X = [x, xc] that is the delay system X' = A_X X + B_X f, u = -K X - F f with

    A_X = [[A, 0], [Bc C, Ac]],   B_X = [B; Bc D],   K = [Dc C, Cc],   F = Dc D

Each delay sits between a command and its force, so that plant feedthrough drives the controller's
states by the delayed force. F is what makes a loop neutral. Nothing is reduced: every state of both
is a state of the loop, hidden ones too, and their roots count.

Transfer functions are realised in canonical form. Each entry of the matrices is the exact rational
function of the coefficients given, rounded once; that rounding is part of the system asked about.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, cast

import numpy as np

from railenv.errors import ArgumentError, unknown_name
from railenv.stability.realisation import of_fractions, of_zeros_and_poles
from railenv.units import FloatArray
from railenv.vehicle.statespace import StateSpace

_KINDS = (
    "a tuple (A, B, C, D), a state space, transfer function or zeros, poles and gain of "
    "scipy.signal, a state space or transfer function of python-control, or a gain as an array"
)


@dataclass(frozen=True, eq=False)
class LinearSystem:
    """x' = A x + B u, y = C x + D u in continuous time; no states for a static gain.

    Attributes:
        A: Shape (n, n).
        B: Shape (n, inputs).
        C: Shape (outputs, n).
        D: Shape (outputs, inputs).
        inputs: Names of the inputs; empty if they have none.
        outputs: Names of the outputs; empty if they have none.

    Raises:
        ArgumentError: A matrix has the wrong shape or is not finite.
    """

    A: FloatArray
    B: FloatArray
    C: FloatArray
    D: FloatArray
    inputs: tuple[str, ...] = ()
    outputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        for name in ("A", "B", "C", "D"):
            matrix = real_matrix(name, getattr(self, name))
            matrix.setflags(write=False)
            object.__setattr__(self, name, matrix)
        n, (outputs, inputs) = self.A.shape[0], self.D.shape
        for name, shape in (("A", (n, n)), ("B", (n, inputs)), ("C", (outputs, n))):
            given = getattr(self, name).shape
            if given != shape:
                raise ArgumentError(
                    f"{name} has shape {given}; with A {self.A.shape} and D {self.D.shape} "
                    f"it must be {shape}"
                )
        for name, number in (("inputs", inputs), ("outputs", outputs)):
            names = getattr(self, name)
            if names and len(names) != number:
                raise ArgumentError(f"{name} has {len(names)} names; give {number} or none")

    def measured(self, names: Sequence[str]) -> "LinearSystem":
        """Return the same system with only the named outputs, in the order given.

        Raises:
            ArgumentError: The outputs have no names, or one of these names is not theirs.
        """
        if not self.outputs:
            raise ArgumentError("the plant's outputs have no names; give the gain as a matrix")
        for name in names:
            if name not in self.outputs:
                raise unknown_name("sensor", name, self.outputs)
        rows = [self.outputs.index(name) for name in names]
        return LinearSystem(self.A, self.B, self.C[rows], self.D[rows], self.inputs, tuple(names))


def linear_system(value: Any, name: str) -> LinearSystem:
    """Read a linear system of any origin.

    Args:
        value: A tuple (A, B, C, D); an object with matrices `A, B, C, D`, with `num` and `den`, or
            with `zeros, poles, gain` (scipy.signal, python-control); a vehicle's state space, whose
            inputs are then the actuators alone; or a static gain as an array, list or number.
        name: What it is, for messages.

    Returns:
        The same system as matrices, not reduced.

    Raises:
        ArgumentError: It is none of these, in discrete time, improper, or a shape does not fit.
    """
    if isinstance(value, LinearSystem):
        return value
    try:
        return _read(value)
    except ArgumentError as error:
        raise ArgumentError(f"{name}: {error}") from None


def _read(value: Any) -> LinearSystem:
    if isinstance(value, StateSpace):
        m = value.num_actuators
        named = (value.inputs[:m], value.outputs)
        return LinearSystem(value.A, value.B[:, :m], value.C, value.D[:, :m], *named)
    period = getattr(value, "dt", None)
    if period not in (None, 0):
        raise ArgumentError(
            f"it has sampling period dt = {period}; give a continuous-time system (dt = 0)"
        )
    inputs, outputs = _labels(value, "input_labels"), _labels(value, "output_labels")
    if isinstance(value, tuple):
        parts = cast("tuple[Any, ...]", value)
        if len(parts) != 4:
            raise ArgumentError(
                f"a tuple of {len(parts)} is no system; give (A, B, C, D), "
                "or a static gain as an array"
            )
        return LinearSystem(*parts)
    if all(hasattr(value, letter) for letter in "ABCD"):
        return LinearSystem(value.A, value.B, value.C, value.D, inputs, outputs)
    if hasattr(value, "num") and hasattr(value, "den"):
        return LinearSystem(*of_fractions(_entries(value)), inputs, outputs)
    if all(hasattr(value, part) for part in ("zeros", "poles", "gain")):
        return LinearSystem(*of_zeros_and_poles(value.zeros, value.poles, value.gain))
    if isinstance(value, int | float | np.number):
        return static_gain(np.array([[value]]))
    if isinstance(value, list | np.ndarray):
        return static_gain(value)
    raise ArgumentError(f"a {type(value).__name__} is no linear system; give {_KINDS}")


def static_gain(gain: Any) -> LinearSystem:
    """Return a system without states, y = gain u."""
    D = real_matrix("the gain", gain)
    outputs, inputs = D.shape
    return LinearSystem(np.zeros((0, 0)), np.zeros((0, inputs)), np.zeros((outputs, 0)), D)


def _labels(value: Any, attribute: str) -> tuple[str, ...]:
    labels = getattr(value, attribute, None)
    return tuple(cast("list[str]", labels)) if isinstance(labels, list) else ()


def _entries(value: Any) -> list[list[tuple[Any, Any]]]:
    """Return numerator and denominator of each entry, rows being outputs."""
    num: Any = getattr(value, "num_list", value.num)
    den: Any = getattr(value, "den_list", value.den)
    if _is_table(num):
        pairs = zip(num, den, strict=True)
        return [list(zip(above, below, strict=True)) for above, below in pairs]
    # scipy's: one input and one denominator, one row of coefficients per output.
    rows: list[Any] = list(num) if np.ndim(num) == 2 else [num]
    return [[(row, den)] for row in rows]


def _is_table(num: Any) -> bool:
    return isinstance(num, list) and isinstance(cast("list[Any]", num)[0], list)


def sensor_loop(
    plant: Any, gain: Any, sensors: Sequence[str] | None
) -> tuple[LinearSystem, LinearSystem]:
    """Return a plant seen through named sensors and the static gain on them.

    Args:
        plant: A vehicle's state space, or a system whose outputs have names.
        gain: One column per sensor, shape (channels, sensors), or a mapping from each sensor's name
            to its column (a number where there is one channel).
        sensors: Names of the columns; not with a mapping.

    Raises:
        ArgumentError: A sensor does not exist, or the gain's shape does not fit.
    """
    if isinstance(gain, Mapping):
        columns = cast("Mapping[str, Any]", gain)
        if sensors is not None:
            raise ArgumentError("gain names its sensors already; drop sensors")
        names = tuple(columns)
        parts = [np.atleast_1d(np.asarray(column, dtype=object)) for column in columns.values()]
        if len({part.shape for part in parts}) > 1 or any(part.ndim != 1 for part in parts):
            raise ArgumentError(
                "gain has columns of different lengths; give each sensor one number per channel"
            )
        matrix: Any = np.column_stack(parts) if parts else None
    elif sensors is None:
        raise ArgumentError("sensors is missing; name the sensor of each column of gain")
    elif isinstance(sensors, str):
        raise ArgumentError(f"sensors = {sensors!r} is one text; give a tuple of names")
    else:
        names, matrix = tuple(sensors), gain
    if isinstance(plant, StateSpace):
        C, D = plant.output_rows(names)
        m = plant.num_actuators
        system = LinearSystem(plant.A, plant.B[:, :m], C, D[:, :m], plant.inputs[:m], names)
    else:
        system = linear_system(plant, "plant").measured(names)
    if matrix is None:
        matrix = np.zeros((system.B.shape[1], 0))
    return system, static_gain(matrix)


def closed_loop(
    plant: LinearSystem, controller: LinearSystem
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray, tuple[str, ...]]:
    """Close u = -controller(y) around a plant; see the module's text.

    Returns:
        A, B, K and F of the delay system, and the names of the fed-back outputs with direct
        feedthrough (none if F is zero).

    Raises:
        ArgumentError: The sizes differ, or both name the same signals in another order.
    """
    shape = controller.D.shape
    if shape != plant.D.shape[::-1]:
        raise ArgumentError(
            f"the controller has shape {shape}; it must be {plant.D.shape[::-1]}: one row per "
            "input of the plant, one column per output"
        )
    _check_order("outputs", plant.outputs, "inputs", controller.inputs)
    _check_order("inputs", plant.inputs, "outputs", controller.outputs)
    n, nc = plant.A.shape[0], controller.A.shape[0]
    with np.errstate(over="ignore", invalid="ignore"):  # what is not finite is refused by the loop
        A = np.zeros((n + nc, n + nc))
        A[:n, :n], A[n:, :n], A[n:, n:] = plant.A, controller.B @ plant.C, controller.A
        B = np.vstack([plant.B, controller.B @ plant.D])
        K = np.hstack([controller.D @ plant.C, controller.C])
        # A channel that is never commanded carries no force: nothing comes straight back from it.
        commanded = np.any(controller.C, axis=1) | np.any(controller.D, axis=1)
        D = np.where(commanded, plant.D, 0.0)
        F = controller.D @ D
    direct = np.any(D, axis=1) & np.any(controller.D, axis=0) & bool(np.any(F))
    names = plant.outputs or tuple(f"output {k + 1}" for k in range(shape[1]))
    return (
        A,
        B,
        K,
        F,
        tuple(name for name, is_direct in zip(names, direct, strict=True) if is_direct),
    )


def _check_order(first: str, names: Iterable[str], second: str, others: Iterable[str]) -> None:
    """Refuse signals that both sides name alike but count in another order."""
    own, other = list(names), list(others)
    if own != other and sorted(own) == sorted(other):
        raise ArgumentError(
            f"the plant's {first} are {', '.join(own)}, the controller's {second} "
            f"{', '.join(other)}: they are joined in the order given; put them in the same one"
        )


def real_matrix(name: str, values: Any) -> FloatArray:
    """Return a new matrix of finite real numbers, or raise `ArgumentError` with its name."""
    try:
        if np.iscomplexobj(values):
            raise TypeError
        matrix = np.array(values, dtype=float)
    except (TypeError, ValueError, OverflowError):
        raise ArgumentError(
            f"{name} is not a matrix of real numbers; give a two-dimensional array"
        ) from None
    if matrix.ndim != 2:
        raise ArgumentError(f"{name} has {matrix.ndim} dimensions; give a two-dimensional array")
    if not np.all(np.isfinite(matrix)):
        raise ArgumentError(
            f"{name} holds a value that is not finite; every entry must be a number"
        )
    return matrix
