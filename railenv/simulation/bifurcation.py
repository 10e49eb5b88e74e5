"""Hunting against speed: linear and nonlinear critical speed, both branches, kind of bifurcation.

Below the linear critical speed small disturbances die out; that says nothing about large ones.
Here a system runs at stepped speeds, up from rest with a small disturbance at every speed, and down
from the large limit cycle with its state carried over. The lowest speed with sustained hunting on
the way down is the nonlinear critical speed (the ramp of UIC 518 and EN 14363, practised by O.
Polach, Veh. Syst. Dyn. 44 sup. (2006) 469). Where the two ways differ, the bifurcation is
subcritical, and the speeds between are those at which a disturbance decides.

What a ramp finds is what a finite time shows. Just below a fold motion lingers near the limit cycle
that is no more; `Settling.drift` decides how slow a decay counts as none, and pulls the result
down by that much. `railenv.simulation.periodic_orbits` has no such bias, for small systems.

Any system fits that follows `HuntingSystem`: the bogie of `railenv.vehicle.cooperrider` does, and
the nonlinear vehicle by `railenv.simulation.full_hunting`.
"""

import enum
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from railenv.errors import ArgumentError, check_count, check_positive
from railenv.simulation.linear_speed import LinearCriticalSpeed
from railenv.simulation.settling import Settled, Settling, settle
from railenv.units import Dimensionless, FloatArray, MetrePerSecond

_ALIKE = 0.1  # relative difference up to which two amplitudes belong to one branch
_CLOSE = 0.02  # the same relative to the largest amplitude: near the onset little is settled well
_SMALL = 0.25  # onset over largest amplitude up to which hunting begins softly


class HuntingSystem(Protocol):
    """A vehicle on perfect straight track, stepped in lanes.

    A lane's state is one row of numbers that says everything about it. Outputs are one signal, by
    which hunting is judged: a wheelset's lateral displacement, say.
    """

    @property
    def state_size(self) -> int:
        """Length of a state."""
        ...

    def advance(
        self, states: FloatArray, speeds: FloatArray, durations: FloatArray, samples: int
    ) -> tuple[FloatArray, FloatArray]:
        """Move lanes on.

        Args:
            states: Shape (lanes, n); not changed.
            speeds: Shape (lanes,) [m/s].
            durations: Shape (lanes,) [s]; all the same, except from `periodic_orbits`.
            samples: Outputs to record in that time, equally spaced, the last one at the end.

        Returns:
            New states, shape (lanes, n), and outputs, shape (lanes, samples).
        """
        ...


class Kind(enum.StrEnum):
    """How the straight run loses its stability, as two ramps show it."""

    SUBCRITICAL = "subcritical"
    SUPERCRITICAL = "supercritical"
    UNDECIDED = "undecided"


@dataclass(frozen=True, eq=False)
class SpeedRamp:
    """What was seen at each speed of one ramp, in the order in which it was run.

    Attributes:
        speeds: Shape (k,) [m/s].
        amplitudes: Half of peak to peak of the output, shape (k,).
        frequencies: Of the oscillation, 0 at rest, shape (k,) [Hz].
        settled: Whether the amplitude had come to a stand, shape (k,).
        hunting: Whether it is above the bound for rest, shape (k,).
        states: State at the end, shape (k, n).
    """

    speeds: FloatArray
    amplitudes: FloatArray
    frequencies: FloatArray
    settled: np.ndarray[tuple[int], np.dtype[np.bool_]]
    hunting: np.ndarray[tuple[int], np.dtype[np.bool_]]
    states: FloatArray


@dataclass(frozen=True, eq=False)
class BifurcationDiagram:
    """Both branches, the critical speeds and what follows from them; seen, not proved.

    Attributes:
        up: Ramp from rest, a small disturbance at every speed.
        down: Ramp from the large limit cycle.
        linear: Linear critical speed, None where none was looked for or found.
        hunting_speed: Nonlinear critical speed: lowest at which hunting was sustained on the way
            down; infinite if there was none even at the highest.
        rest_speed: Highest speed below it at which hunting died out; zero if it never did.
        hunting_amplitude: Amplitude at `hunting_speed`.
        hysteresis: Speeds of the ramps at which the way down hunts and the way up rests [m/s].
        kind: Verdict.
        reason: The evidence for it, in a sentence.
    """

    up: SpeedRamp
    down: SpeedRamp
    linear: LinearCriticalSpeed | None
    hunting_speed: MetrePerSecond
    rest_speed: MetrePerSecond
    hunting_amplitude: Dimensionless
    hysteresis: tuple[float, ...]
    kind: Kind
    reason: str


def bifurcation_diagram(
    system: HuntingSystem,
    speeds: FloatArray,
    small: FloatArray,
    large: FloatArray,
    settling: Settling,
    *,
    straight: FloatArray | None = None,
    linear: LinearCriticalSpeed | None = None,
    tolerance: MetrePerSecond = 0.05,
    section_lanes: int = 4,
) -> BifurcationDiagram:
    """Run both ramps, refine the nonlinear critical speed and judge the bifurcation.

    Args:
        system: What hunts.
        speeds: Increasing, at least two, shape (k,) [m/s].
        small: Disturbance put on the state at every speed of the way up, shape (n,). It should lead
            to less than the bound for rest.
        large: State from which the way down begins at the highest speed, shape (n,).
        settling: When a motion counts as settled and when as rest.
        straight: State of the straight run, where the way up begins, shape (n,); None for zeros.
        linear: Linear critical speed for the verdict, from `railenv.simulation.linear_speed`.
        tolerance: Width to which the nonlinear critical speed is bracketed.
        section_lanes: Speeds tried at once in each refinement; more cost no time in a simulator
            whose lanes run side by side.

    Raises:
        ArgumentError: Speeds do not increase, or a state has the wrong length.
    """
    speeds = np.array(speeds, dtype=np.float64)
    if speeds.ndim != 1 or len(speeds) < 2 or not np.all(np.diff(speeds, prepend=0.0) > 0.0):
        raise ArgumentError(
            f"speeds = {speeds!r} must be two or more and increase from above zero; sort them"
        )
    tolerance = check_positive("tolerance", tolerance, "m/s")
    section_lanes = check_count("section_lanes", section_lanes)
    small, large = _state(system, "small", small), _state(system, "large", large)
    straight = _state(system, "straight", np.zeros_like(large) if straight is None else straight)
    up, down = _ramps(system, speeds, (straight, small, large), settling)
    onset = _refine(system, down, settling, tolerance, section_lanes)
    kind, reason, hysteresis = _judge(up, down, linear, onset)
    return BifurcationDiagram(up, down, linear, *onset, hysteresis, kind, reason)


def _state(system: HuntingSystem, name: str, state: FloatArray) -> FloatArray:
    state = np.array(state, dtype=np.float64)
    if state.shape != (system.state_size,) or not np.all(np.isfinite(state)):
        raise ArgumentError(
            f"{name} has the shape {state.shape}; give {system.state_size} finite numbers, as "
            "long as the system's state"
        )
    return state


def _ramps(
    system: HuntingSystem,
    speeds: FloatArray,
    starts: tuple[FloatArray, FloatArray, FloatArray],
    settling: Settling,
) -> tuple[SpeedRamp, SpeedRamp]:
    """Run up and down, as two lanes side by side."""
    straight, small, large = starts
    begin = np.stack([straight, large])
    states = begin.copy()
    seen: list[tuple[FloatArray, Settled]] = []
    for up_speed, down_speed in zip(speeds, speeds[::-1], strict=True):
        # What left all bounds at one speed begins anew at the next.
        bounded = np.all(np.isfinite(states), axis=1)
        states = np.where(bounded[:, None], states, begin)
        states[0] += small
        now = np.array([up_speed, down_speed])
        result = settle(system.advance, states, now, settling)
        states = result.states
        seen.append((now, result))
    up, down = (
        SpeedRamp(
            np.array([now[lane] for now, _ in seen]),
            np.array([r.amplitudes[lane] for _, r in seen]),
            np.array([r.frequencies[lane] for _, r in seen]),
            np.array([r.settled[lane] for _, r in seen]),
            np.array([r.hunting[lane] for _, r in seen]),
            np.stack([r.states[lane] for _, r in seen]),
        )
        for lane in (0, 1)
    )
    return up, down


def _refine(
    system: HuntingSystem,
    down: SpeedRamp,
    settling: Settling,
    tolerance: float,
    lanes: int,
) -> tuple[float, float, float]:
    """Narrow down where hunting dies out: lowest hunting, highest rest, amplitude at the lowest.

    Motion without bound says nothing about where it would end, so that search stops there.
    """
    if not down.hunting[0]:
        return float("inf"), float(down.speeds[0]), 0.0
    if np.all(down.hunting):
        return float(down.speeds[-1]), 0.0, float(down.amplitudes[-1])
    first = int(np.argmin(down.hunting))  # the first speed at rest
    high, low = float(down.speeds[first - 1]), float(down.speeds[first])
    state, amplitude = down.states[first - 1], float(down.amplitudes[first - 1])
    while high - low > tolerance and np.isfinite(amplitude):
        # Both ends are known; the lanes share what lies between them evenly.
        between = high - (high - low) * np.arange(1, lanes + 1) / (lanes + 1)
        result = settle(system.advance, np.tile(state, (lanes, 1)), between, settling)
        died = lanes if np.all(result.hunting) else int(np.argmin(result.hunting))
        if died < lanes:
            low = float(between[died])
        if died > 0:
            high, state = float(between[died - 1]), result.states[died - 1]
            amplitude = float(result.amplitudes[died - 1])
    return high, low, amplitude


def _judge(
    up: SpeedRamp,
    down: SpeedRamp,
    linear: LinearCriticalSpeed | None,
    onset: tuple[float, float, float],
) -> tuple[Kind, str, tuple[float, ...]]:
    """Tell the kind from both ramps; speeds of `down` run backwards.

    The kind is about how the straight run loses its stability. Further cycles at higher speeds,
    and jumps between them, are named in the reason.
    """
    bounded = np.isfinite(up.amplitudes) & np.isfinite(down.amplitudes[::-1])
    if not np.all(bounded):
        lost = float(up.speeds[np.argmin(bounded)])
        return Kind.UNDECIDED, f"the motion left all bounds, first at {_told(lost)}", ()
    hunting_speed, _, onset_amplitude = onset
    up_hunts, down_hunts = up.hunting, down.hunting[::-1]
    up_seen, down_seen = up.amplitudes, down.amplitudes[::-1]
    both_settled = up.settled & down.settled[::-1]
    # Above the linear critical speed rest cannot last: the way up was too short to grow.
    slow = ~up_hunts & (up.speeds >= (np.inf if linear is None else linear.speed))
    apart = down_hunts & ~up_hunts & both_settled & ~slow
    hysteresis = tuple(float(v) for v in up.speeds[apart])
    if not np.any(up_hunts):
        return Kind.UNDECIDED, "the way up never hunts: raise the highest speed", hysteresis
    first = int(np.argmax(up_hunts))
    if first == 0:
        return Kind.UNDECIDED, "the way up hunts at the lowest speed: begin lower", hysteresis
    jump = f"{_told(float(up.speeds[first]))}, the first speed at which the way up hunts"
    largest = float(down_seen.max())
    alike = abs(up_seen - down_seen) <= _ALIKE * down_seen + _CLOSE * largest
    together = bool(alike[first])
    if hysteresis:
        span = f"rest and hunting side by side at {_told(hysteresis[0], hysteresis[-1])}"
        if not together:
            reason = f"{span}, but at {jump}, its amplitude is not that of the way down"
            return Kind.UNDECIDED, reason, hysteresis
        return Kind.SUBCRITICAL, f"{span}; at {jump}, it is on the large cycle", hysteresis
    if linear is not None and hunting_speed < linear.speed - linear.scan_step:
        reason = f"hunting down to {_told(hunting_speed)}, but no settled speed shows both"
        return Kind.UNDECIDED, f"{reason}: give speeds nearer together", hysteresis
    soft = onset_amplitude <= _SMALL * largest and together
    if not (soft and np.array_equal(up_hunts | slow, down_hunts)):
        return Kind.UNDECIDED, "neither hysteresis nor an onset from small amplitudes", hysteresis
    reason = (
        f"both ways agree near the onset; on the way down hunting ends at {_told(hunting_speed)} "
        f"with {onset_amplitude / largest:.2g} of its largest amplitude"
    )
    two = up.speeds[up_hunts & ~alike]
    if len(two):
        reason += f"; two cycles side by side at {_told(float(two[0]), float(two[-1]))}"
    return Kind.SUPERCRITICAL, reason, hysteresis


def _told(*speeds: float) -> str:
    """Return one speed, or the ends of a range, in both units."""
    metres, kilometres = (
        " to ".join(f"{factor * speed:.6g}" for speed in speeds) for factor in (1.0, 3.6)
    )
    return f"{metres} m/s ({kilometres} km/h)"
