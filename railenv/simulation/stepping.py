"""The compiled physics step of a linear vehicle: exact, lane by lane.

One physics step of length h:

    x <- Phi x + G(h) f_before + G(h - r) (f_after - f_before) + W_0 w_0 + W_1 w_1

with the force of each channel switching from f_before to f_after at r inside the step, so that a
delay needs no rounding, and the track input w linear over the step (first-order hold).

Every lane is computed on its own with a fixed order of operations: no matrix library, no
reassociation, no reduction across lanes. A lane's numbers do not depend on how many lanes there
are. Matrices are passed transposed so that the inner loops run over contiguous memory.

Both compiled functions stand in this file, because the compiler's cache watches only the file of
the function that is called: a change elsewhere would go on running as it was.
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.units import FloatArray


@njit(cache=True, inline="always")
def arriving(
    commands: FloatArray,
    whole_steps: int,
    channel: int,
    step: int,
    steps_per_command: int,
) -> tuple[float, float, bool]:
    """Return the force in effect before and after the switch inside one physics step.

    Command j is issued at physics step j * steps_per_command and takes force `whole_steps` steps
    and the remainder later.

    Args:
        commands: One lane's ring, shape (capacity, channels).
        whole_steps: Whole steps of this channel's delay.
        channel: Channel number.
        step: Physics step, counted from the start.
        steps_per_command: Physics steps in one control period.

    Returns:
        Force before [N], force after [N], and whether a switch falls into this step.
    """
    elapsed = step - whole_steps
    newest = elapsed // steps_per_command
    capacity = commands.shape[0]
    after = commands[newest % capacity, channel] if newest >= 0 else 0.0
    if elapsed % steps_per_command != 0:
        return after, after, False
    before = commands[(newest - 1) % capacity, channel] if newest >= 1 else 0.0
    return before, after, True


@njit(cache=True, nogil=True)
def advance(
    state: FloatArray,
    commands: FloatArray,
    whole_steps: NDArray[np.int64],
    first_step: int,
    first_on_track: int,
    steps_per_command: int,
    transition: FloatArray,
    held: FloatArray,
    late: FloatArray,
    ramp_start: FloatArray,
    ramp_end: FloatArray,
    track: FloatArray,
    track_of_lane: NDArray[np.int64],
    output_state: FloatArray,
    output_force: FloatArray,
    output_track: FloatArray,
    recorded: FloatArray,
) -> None:
    """Advance every lane by one control period, in place.

    Args:
        state: x, shape (lanes, n); overwritten.
        commands: Delay line's ring, shape (lanes, capacity, m).
        whole_steps: Whole steps in each delay, shape (lanes, m).
        first_step: Physics step number at the start of the period.
        first_on_track: Where that step lies in `track`.
        steps_per_command: Physics steps in the period.
        transition: Phi transposed, shape (n, n).
        held: G(h) transposed, shape (m, n).
        late: G(h - r) transposed for each lane and channel, shape (lanes, m, n).
        ramp_start: W_0 transposed, shape (k, n).
        ramp_end: W_1 transposed, shape (k, n).
        track: Track inputs at every physics step, shape (tracks, steps + 1, k).
        track_of_lane: Which track each lane runs on, shape (lanes,).
        output_state: C transposed, shape (n, p).
        output_force: D's actuator columns transposed, shape (m, p).
        output_track: D's track columns transposed, shape (k, p).
        recorded: Outputs at the end of each physics step, just before any switch that falls on that
            instant, shape (lanes, steps_per_command, p); overwritten.
    """
    lanes, n = state.shape
    m = held.shape[0]
    k = ramp_start.shape[0]
    p = output_state.shape[1]
    new = np.empty(n)
    force = np.empty(m)
    for lane in range(lanes):
        x = state[lane]
        line = track[track_of_lane[lane]]
        for substep in range(steps_per_command):
            step = first_step + substep
            place = first_on_track + substep
            w_0, w_1 = line[place], line[place + 1]
            new[:] = 0.0
            for j in range(n):
                x_j = x[j]
                for i in range(n):
                    new[i] += transition[j, i] * x_j
            for channel in range(m):
                before, after, switches = arriving(
                    commands[lane], whole_steps[lane, channel], channel, step, steps_per_command
                )
                force[channel] = after
                for i in range(n):
                    new[i] += held[channel, i] * before
                if switches:
                    change = after - before
                    for i in range(n):
                        new[i] += late[lane, channel, i] * change
            for j in range(k):
                for i in range(n):
                    new[i] += ramp_start[j, i] * w_0[j] + ramp_end[j, i] * w_1[j]
            x[:] = new
            y = recorded[lane, substep]
            y[:] = 0.0
            for j in range(n):
                x_j = x[j]
                for i in range(p):
                    y[i] += output_state[j, i] * x_j
            for channel in range(m):
                for i in range(p):
                    y[i] += output_force[channel, i] * force[channel]
            for j in range(k):
                for i in range(p):
                    y[i] += output_track[j, i] * w_1[j]
