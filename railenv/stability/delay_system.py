"""Linear systems under delayed feedback: x' = A x - sum_i b_i K_i x(t - tau_i).

b_i is column i of B, K_i row i of K: one channel per actuator, each with its own delay, and the
feedback law u = -K x(t - tau). Delay means the time between measurement and force; a sampled
controller's hold comes on top of it (see `railenv.stability.sampled`).

Where a fed-back output answers the force at once (an accelerometer), the force is in its own law:

    x' = A x + B f,   f_i(t) = u_i(t - tau_i),   u = -K x - F f

With F = 0 that is the system above, which is retarded: finitely many roots to the right of any
line. With any other F it is treated as neutral: its roots may stand in chains up to infinite
frequency, and an arbitrarily small change of the delays may move a whole chain.

This module knows nothing of vehicles; anything linear can be asked, see `railenv.stability.loops`.
"""

import inspect
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import numpy as np
from scipy import linalg

from railenv.errors import ArgumentError, NeutralLoopError, check_not_negative
from railenv.stability.loops import (
    closed_loop,
    linear_system,
    real_matrix,
    sensor_loop,
    static_gain,
)
from railenv.units import ComplexArray, FloatArray

# Singular values below this share of the largest count as zero when B K is factored: it only
# decides the size of the reduced problem, every root is corrected on the full matrices afterwards.
_RANK_TOLERANCE = 1e-12
# Delays beyond these under- or overflow in powers of the collocation.
_SHORTEST, _LONGEST = 1e-100, 1e100
# Most letters of a list of names in a message.
_LONGEST_LIST = 120
_NO_FEEDTHROUGH: FloatArray = np.zeros((0, 0))


def _no_feedthrough() -> FloatArray:
    return _NO_FEEDTHROUGH


@dataclass(frozen=True, eq=False)
class DelaySystem:
    """x' = A x + B f, f_i(t) = u_i(t - tau_i), u = -K x - F f, with constant delays.

    Attributes:
        A: Plant, shape (n, n).
        B: Inputs, shape (n, m).
        K: Feedback gain, shape (m, n), with u = -K x(t - tau).
        feedthrough: F, shape (m, m); zero unless given. Any other F makes the loop neutral.
        direct_outputs: Names of the fed-back outputs that F comes from, for messages.

    Raises:
        ArgumentError: A matrix has the wrong shape or is not finite.
    """

    A: FloatArray
    B: FloatArray
    K: FloatArray
    feedthrough: FloatArray = field(default_factory=_no_feedthrough)
    direct_outputs: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        A = real_matrix("A", self.A)
        B, K = real_matrix("B", self.B), real_matrix("K", self.K)
        n = A.shape[0]
        if A.shape != (n, n) or n == 0:
            raise ArgumentError(f"A has shape {A.shape}; it must be square and not empty")
        if B.shape[0] != n:
            raise ArgumentError(f"B has shape {B.shape}; it must have {n} rows as A has")
        m = B.shape[1]
        if K.shape != (m, n):
            raise ArgumentError(
                f"K has shape {K.shape}; it must be ({m}, {n}): one row per column of B"
            )
        absent = self.feedthrough is _NO_FEEDTHROUGH
        F = np.zeros((m, m)) if absent else real_matrix("feedthrough", self.feedthrough)
        if F.shape != (m, m):
            raise ArgumentError(
                f"feedthrough has shape {F.shape}; it must be ({m}, {m}): one row and one column "
                "per column of B"
            )
        for name, matrix in (("A", A), ("B", B), ("K", K), ("feedthrough", F)):
            matrix.setflags(write=False)
            object.__setattr__(self, name, matrix)

    @classmethod
    def from_statespace(cls, system: Any, K: Any) -> "DelaySystem":
        """Close the loop around a plant by a static output gain.

        Args:
            system: The plant; see `railenv.stability.loops.linear_system` for what it may be.
            K: Output gain, shape (inputs, outputs), with u = -K y(t - tau).

        Returns:
            The delay system with state gain K C and feedthrough K D.

        Raises:
            ArgumentError: The plant is in discrete time or a shape does not fit.
        """
        return cls(*closed_loop(linear_system(system, "system"), static_gain(K)))

    @classmethod
    def from_loop(cls, plant: Any, controller: Any) -> "DelaySystem":
        """Close u = -controller(y) around a plant; the delays lie between command and force.

        Args:
            plant: A linear system in continuous time: a tuple (A, B, C, D), a system of
                scipy.signal or python-control, or a vehicle's state space (its actuators are the
                inputs). Inputs are the channels.
            controller: A gain matrix, or a system in any of the same forms, one row per input of
                the plant and one column per output.

        Returns:
            The loop over the states of the plant followed by those of the controller.

        Raises:
            ArgumentError: One of the two is no such system, in discrete time or improper, or the
                sizes do not fit.
        """
        return cls(
            *closed_loop(linear_system(plant, "plant"), linear_system(controller, "controller"))
        )

    @classmethod
    def from_sensors(
        cls, plant: Any, gain: Any, sensors: Sequence[str] | None = None
    ) -> "DelaySystem":
        """Close the loop by a static gain on named sensors, u = -gain @ y(t - tau).

        Args:
            plant: A vehicle's state space (`railenv.vehicle.state_space`; a state's name is a
                sensor too), or a system whose outputs have names.
            gain: Shape (channels, sensors), or a mapping from each sensor's name to its column.
            sensors: Names of the columns of a gain that is no mapping.

        Returns:
            The delay system.

        Raises:
            ArgumentError: A sensor does not exist, or the gain's shape does not fit.
        """
        return cls(*closed_loop(*sensor_loop(plant, gain, sensors)))

    @property
    def num_states(self) -> int:
        """Number of states n."""
        return self.A.shape[0]

    @property
    def num_channels(self) -> int:
        """Number of feedback channels m."""
        return self.B.shape[1]

    @cached_property
    def neutral(self) -> bool:
        """Whether the force is in its own law; any feedthrough that is not zero counts."""
        return bool(np.any(self.feedthrough))

    def require_retarded(self, what: str) -> None:
        """Raise `NeutralLoopError` if the loop is neutral.

        Args:
            what: The question that has no answer then, for the message.
        """
        if not self.neutral:
            return
        F = self.feedthrough
        numbers = [str(k + 1) for k in np.flatnonzero(np.any(F, axis=1))]
        channels = f"channel{'s' if len(numbers) > 1 else ''} {', '.join(numbers)}"
        source = ", ".join(self.direct_outputs) or "a fed-back output"
        if len(source) > _LONGEST_LIST:
            source = f"{source[:_LONGEST_LIST]} ..."
        raise NeutralLoopError(
            f"{what}: the loop is neutral, its force comes back at once through {source} into "
            f"{channels} (feedthrough up to {np.abs(F).max():.3g}), so that its roots may "
            "stand in chains up to infinite frequency and a minute change of delay may move them; "
            "low-pass what is fed back, or give the actuator a lag"
        )

    @property
    def undelayed(self) -> FloatArray:
        """Closed loop without delay, A - B (I + F)^-1 K, shape (n, n)."""
        if not self.neutral:
            return self.A - self.B @ self.K
        try:
            gain = np.linalg.solve(np.eye(self.num_channels) + self.feedthrough, self.K)
        except np.linalg.LinAlgError:
            raise ArgumentError(
                "the loop without delay has no solution: I + feedthrough is singular; change the "
                "gain, or low-pass what is fed back"
            ) from None
        return self.A - self.B @ gain

    def delays(self, delay: float | Sequence[float]) -> FloatArray:
        """Return one delay per channel.

        Args:
            delay: One delay for all channels or one per channel [s].

        Raises:
            ArgumentError: A delay is negative or not finite, or their number is wrong.
        """
        values = np.atleast_1d(np.asarray(delay, dtype=object))
        if values.ndim != 1 or len(values) not in (1, self.num_channels):
            raise ArgumentError(
                f"delay has {values.size} entries; give one or {self.num_channels}, one per channel"
            )
        checked = [check_not_negative("delay", value, "seconds") for value in values]
        for value in checked:
            if 0.0 < value < _SHORTEST or value > _LONGEST:
                raise ArgumentError(
                    f"delay = {value:g} s is out of reach; "
                    f"give 0, or {_SHORTEST:g} to {_LONGEST:g} s"
                )
        return np.broadcast_to(np.array(checked), (self.num_channels,)).copy()

    @cached_property
    def scaled(self) -> "DelaySystem":
        """The same system with states scaled by powers of two so that A and B K are balanced.

        Roots are unchanged. Newtons, metres and radians differ by many powers of ten, which costs
        digits in anything that is not scale-free.
        """
        d = self.state_scale
        return DelaySystem(
            self.A * d / d[:, None],
            self.B / d[:, None],
            self.K * d,
            self.feedthrough,
            self.direct_outputs,
        )

    @cached_property
    def state_scale(self) -> FloatArray:
        """Factors d with x = d * x_scaled, shape (n,)."""
        size = np.abs(self.A) + np.abs(self.B) @ np.abs(self.K)
        _, (scale, _) = linalg.matrix_balance(size, permute=False, separate=True)
        return np.asarray(scale, dtype=np.float64)

    def characteristic_matrix(self, s: complex, delays: FloatArray) -> ComplexArray:
        """Return M(s) = s I - A + sum_i b_i K_i exp(-s tau_i), shape (n, n).

        Raises:
            NeutralLoopError: The loop is neutral.
        """
        self.require_retarded("characteristic_matrix")
        return (
            s * np.eye(self.num_states) - self.A + (self.B * np.exp(-s * delays)) @ self.K
        ).astype(np.complex128)

    def characteristic_derivative(self, s: complex, delays: FloatArray) -> ComplexArray:
        """Return dM/ds = I - sum_i tau_i b_i K_i exp(-s tau_i), shape (n, n).

        Raises:
            NeutralLoopError: The loop is neutral.
        """
        self.require_retarded("characteristic_derivative")
        return (
            np.eye(self.num_states) - (self.B * (delays * np.exp(-s * delays))) @ self.K
        ).astype(np.complex128)

    def factor(self, channels: list[int]) -> tuple[FloatArray, FloatArray]:
        """Factor the part of B K that belongs to some channels by its rank.

        Args:
            channels: Channel numbers.

        Returns:
            L, shape (n, r), and R, shape (r, n), with B[:, channels] K[channels] = L R.
        """
        product = self.B[:, channels] @ self.K[channels]
        U, sizes, V = linalg.svd(product)
        rank = int(np.sum(sizes > _RANK_TOLERANCE * max(sizes[0], np.finfo(float).tiny)))
        root = np.sqrt(sizes[:rank])
        return U[:, :rank] * root, root[:, None] * V[:rank]


def as_delay_system(loop: Any, vehicle: Any = None) -> DelaySystem:
    """Return the delay system of whatever offers one.

    Args:
        loop: A `DelaySystem`, or an object with `to_delay_system()` or `to_delay_system(vehicle)`,
            as linear controllers have.
        vehicle: The vehicle for a controller that asks for one.

    Raises:
        ArgumentError: It offers none, or needs a vehicle and was given none.
    """
    if isinstance(loop, DelaySystem):
        return loop
    convert = getattr(loop, "to_delay_system", None)
    if not callable(convert):
        raise ArgumentError(
            f"a {type(loop).__name__} is no linear loop; give a DelaySystem (from_loop closes one "
            "around any plant) or an object with to_delay_system"
        )
    takes = [
        parameter
        for parameter in inspect.signature(convert).parameters.values()
        if parameter.kind in (parameter.POSITIONAL_ONLY, parameter.POSITIONAL_OR_KEYWORD)
    ]
    if vehicle is None and any(parameter.default is parameter.empty for parameter in takes):
        raise ArgumentError(
            f"the {type(loop).__name__} closes its loop around a vehicle; give one, vehicle=..."
        )
    system = convert(vehicle) if takes and vehicle is not None else convert()
    if not isinstance(system, DelaySystem):
        raise ArgumentError(
            f"to_delay_system of the {type(loop).__name__} returned a {type(system).__name__}; "
            "it must return a DelaySystem"
        )
    return system
