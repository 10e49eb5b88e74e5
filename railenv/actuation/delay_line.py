"""Commands on their way to the actuators: the queue that realises a delay.

A command computed from the measurement at time t_k takes force in channel i at t_k + delay_i, later
by its own jitter, and holds until the next one arrives. Arrivals are whole physics steps and a
remainder that the exact stepping honours (`railenv.simulation.stepping`); nothing is rounded. A
command that arrives before an older one replaces it, so that the newest that has arrived acts, as
the oracle's varying delay assumes. A lost command never reaches the actuator, which holds its last.
"""

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.actuation.actuator import ActuatorSpec
from railenv.units import FloatArray

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


class QueueArrays(NamedTuple):
    """Commands on their way, one queue per lane and channel, ordered by arrival.

    Attributes:
        whole_steps: Whole steps of each channel's delay, shape (lanes, m).
        rest: What is left of it, in [0, h), shape (lanes, m) [s].
        last: The newest command that was sent, after the limits, shape (lanes, m) [N].
        head: Slot of the next to arrive, shape (lanes, m).
        waiting: How many are on their way, shape (lanes, m).
        arrival_step: Step in which a command arrives, shape (lanes, slots, m).
        arrival_rest: Instant inside that step, shape (lanes, slots, m) [s].
        arrival_force: The command, shape (lanes, slots, m) [N].
    """

    whole_steps: IntArray
    rest: FloatArray
    last: FloatArray
    head: IntArray
    waiting: IntArray
    arrival_step: IntArray
    arrival_rest: FloatArray
    arrival_force: FloatArray


class DelayLine:
    """One queue per lane and channel.

    Args:
        num_lanes: Number of lanes.
        num_channels: Actuator channels m.
        time_step: Physics step [s].
        steps_per_command: Physics steps in one control period.
        longest: Longest delay, jitter included, that a lane may get [s].
        actuator: Force and rate limit.

    Attributes:
        arrays: The queues.
        force_limit: Largest force in either direction [N]; infinite for none.
        force_step: Largest change between two commands [N]; infinite for none.
    """

    def __init__(
        self,
        num_lanes: int,
        num_channels: int,
        time_step: float,
        steps_per_command: int,
        longest: float,
        actuator: ActuatorSpec,
    ) -> None:
        self._time_step = time_step
        period = steps_per_command * time_step
        self.force_limit = np.inf if actuator.force_limit is None else float(actuator.force_limit)
        self.force_step = np.inf if actuator.rate_limit is None else actuator.rate_limit * period
        slots = int(longest / period) + 3
        flat, deep = (num_lanes, num_channels), (num_lanes, slots, num_channels)
        self.arrays = QueueArrays(
            whole_steps=np.zeros(flat, dtype=np.int64),
            rest=np.zeros(flat),
            last=np.zeros(flat),
            head=np.zeros(flat, dtype=np.int64),
            waiting=np.zeros(flat, dtype=np.int64),
            arrival_step=np.zeros(deep, dtype=np.int64),
            arrival_rest=np.zeros(deep),
            arrival_force=np.zeros(deep),
        )

    def start(self, lanes: IntArray, delays: FloatArray) -> None:
        """Empty the queues of some lanes and set their delays.

        Args:
            lanes: Lane numbers, shape (k,).
            delays: Delay of every channel, shape (k, channels) [s], not negative.
        """
        begin_queues(self.arrays, lanes, delays, self._time_step)

    def issue(
        self,
        step: IntArray,
        active: BoolArray,
        first: int,
        end: int,
        commands: FloatArray,
        later: FloatArray,
        lost: BoolArray,
    ) -> None:
        """Send one command per channel of the lanes from `first` to before `end` on its way.

        Args:
            step: Physics step of each lane now, shape (lanes,).
            active: Lanes that take part, shape (lanes,).
            first: First lane.
            end: One past the last lane.
            commands: Wanted forces, before the limits, shape (lanes, channels) [N].
            later: What each command is late beyond its delay, shape (lanes, channels) [s].
            lost: Commands that get lost, shape (lanes, channels).
        """
        issue(
            self.arrays,
            step,
            active,
            first,
            end,
            commands,
            later,
            lost,
            self.force_limit,
            self.force_step,
            self._time_step,
        )


def split_delay(delays: FloatArray, time_step: float) -> tuple[IntArray, FloatArray]:
    """Split delays into whole physics steps and a remainder in [0, time_step) [s]."""
    parts = np.array([_split(float(delay), time_step) for delay in delays.flat]).reshape(-1, 2)
    whole = parts[:, 0].astype(np.int64)
    return whole.reshape(delays.shape), parts[:, 1].reshape(delays.shape)


@njit(cache=True, nogil=True, error_model="numpy")
def _split(delay: float, time_step: float) -> tuple[int, float]:
    """Split one delay."""
    whole = int(np.floor(delay / time_step))
    # The quotient may round up to the next whole number: then the remainder would be negative.
    if delay < whole * time_step:
        whole -= 1
    rest = min(delay - whole * time_step, time_step)
    # The difference may round up to a whole step.
    return (whole + 1, 0.0) if rest >= time_step else (whole, rest)


@njit(cache=True, nogil=True, error_model="numpy")
def begin_queues(queue: QueueArrays, lanes: IntArray, delays: FloatArray, time_step: float) -> None:
    """Empty the queues of some lanes and set their delays.

    Args:
        queue: The queues; changed.
        lanes: Lane numbers, shape (k,).
        delays: Delay of every channel, shape (k, m) [s], not negative.
        time_step: h [s].
    """
    for number in range(len(lanes)):
        lane = lanes[number]
        for c in range(delays.shape[1]):
            whole, rest = _split(delays[number, c], time_step)
            queue.whole_steps[lane, c] = whole
            queue.rest[lane, c] = rest
            queue.last[lane, c] = 0.0
            queue.waiting[lane, c] = 0
            queue.head[lane, c] = 0


@njit(cache=True, nogil=True, error_model="numpy")
def issue(
    queue: QueueArrays,
    step: IntArray,
    active: BoolArray,
    first: int,
    end: int,
    commands: FloatArray,
    later: FloatArray,
    lost: BoolArray,
    force_limit: float,
    force_step: float,
    time_step: float,
) -> None:
    """Send one command per lane and channel on its way.

    A command that arrives before an older one replaces it: the newest that has arrived holds. A
    lost one is never seen by the actuator, which holds what it has.

    Args:
        queue: Commands on their way; changed.
        step: Physics step of each lane now, shape (lanes,).
        active: Lanes that take part, shape (lanes,).
        first: First lane.
        end: One past the last lane.
        commands: Wanted forces, shape (lanes, m) [N].
        later: What each command is late on top of its channel's delay, shape (lanes, m) [s].
        lost: Commands that get lost, shape (lanes, m).
        force_limit: Largest force in either direction [N]; infinite for none.
        force_step: Largest change between two commands [N]; infinite for none.
        time_step: h [s].
    """
    arrival_step, last_of, rest_of, whole_steps, waiting, head_of, arrival_rest, arrival_force = (
        queue.arrival_step,
        queue.last,
        queue.rest,
        queue.whole_steps,
        queue.waiting,
        queue.head,
        queue.arrival_rest,
        queue.arrival_force,
    )
    m = commands.shape[1]
    slots = arrival_step.shape[1]
    for lane in range(first, end):
        if not active[lane]:
            continue
        for c in range(m):
            if lost[lane, c]:
                continue
            wanted = min(max(commands[lane, c], -force_limit), force_limit)
            last = last_of[lane, c]
            force = min(max(wanted, last - force_step), last + force_step)
            last_of[lane, c] = force
            rest = rest_of[lane, c] + later[lane, c]
            whole = int(np.floor(rest / time_step))
            # The quotient may round up to the next whole number.
            if rest < whole * time_step:
                whole -= 1
            rest -= whole * time_step
            arrives = step[lane] + whole_steps[lane, c] + whole
            count, head = waiting[lane, c], head_of[lane, c]
            while count > 0:
                slot = (head + count - 1) % slots
                other = arrival_step[lane, slot, c]
                if other < arrives:
                    break
                if other == arrives and arrival_rest[lane, slot, c] < rest:
                    break
                count -= 1
            if count == slots:
                # Beyond it lies another lane's queue.
                raise IndexError("more commands are on their way than the delay line has room for")
            slot = head + count
            if slot >= slots:
                slot -= slots
            arrival_step[lane, slot, c] = arrives
            arrival_rest[lane, slot, c] = rest
            arrival_force[lane, slot, c] = force
            waiting[lane, c] = count + 1
