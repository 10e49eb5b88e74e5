"""One compiled pass over lanes: command, track, physics, reward, observation; and their beginning.

Lanes are taken in blocks, so that what a lane needs is still close to the processor when the next
part asks for it. Threads take such blocks, each of its own share as long as any is left, without a
hand from the interpreter: one that is late, or on a busy processor, leaves more to the others. To
wake a sleeping thread takes as long as stepping some hundred lanes, so a thread stays awake for a
while after a step (`serve`), ready for the next one.

The compiler's cache watches only the file of the function that is called: a change in one of the
parts would go on running as it was. A digest of their source is therefore a part of each function,
as a variable of the scope around it, which the cache does look at.
"""

import hashlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

from railenv.actuation import delay_line
from railenv.actuation.delay_line import begin_queues, issue
from railenv.envs import atomic, bundle, kernels
from railenv.envs.atomic import fetch_add, give_way, load, pause, store
from railenv.envs.kernels import assess, begin_episodes, command, end_period, observe
from railenv.simulation import excitation, stepping
from railenv.simulation.excitation import excite, excite_start
from railenv.simulation.stepping import advance, begin
from railenv.units import FloatArray

AT_ONCE = 64
"""Lanes that go through all parts before the next ones."""

PATIENCE = 10_000
"""How many times a thread looks for work before it sleeps: some tenths of a millisecond."""

APART = 8
"""Distance between the entries of a tally, so that each has a cache line of its own."""

STEPS, DONE, FAILED, OWN = 0, APART, 2 * APART, 3 * APART
"""Entries of a tally: steps begun, blocks done in the present one, whether a thread has failed, and
then, for every thread, how many blocks of its share have been taken and whether it sleeps."""

_PARTS = (delay_line, kernels, excitation, stepping, atomic, bundle)

IntArray = NDArray[np.int64]


def _compiled(sources: str) -> tuple[Callable[..., None], ...]:
    @njit(cache=True, nogil=True, error_model="numpy")
    def _step(bundle: Any, first: int, end: int) -> None:
        """Advance the lanes from `first` to before `end` by one control period."""
        len(sources)  # makes it a part of this function
        plant, lanes, queue, memory = bundle.plant, bundle.lanes, bundle.queue, bundle.memory
        table, places, wheels = bundle.table, bundle.places, bundle.wheels
        constants, reward, limits = bundle.constants, bundle.reward, bundle.limits
        here = bundle.exchange
        h, active = plant.time_step, here.active
        for a in range(first, end, AT_ONCE):
            b = min(a + AT_ONCE, end)
            command(
                memory,
                reward.effort,
                constants.effort_weight,
                active,
                a,
                b,
                here.actions,
                limits.action_scale,
                here.commands,
            )
            excite(table, places, wheels, lanes.vehicle, lanes.step, h, active, a, b, lanes.track)
            issue(
                queue,
                lanes.step,
                active,
                a,
                b,
                here.commands,
                here.later,
                here.lost,
                limits.force,
                limits.force_step,
                h,
            )
            advance(plant, lanes, queue, active, a, b, here.recorded, here.sampled)
            assess(constants, reward, active, a, b, here.recorded, lanes.step, here.reward)
            observe(memory, active, a, b, here.sampled, here.observation)
            end_period(
                active,
                a,
                b,
                reward.ended,
                limits.periods,
                here.periods,
                here.reward,
                here.terminated,
                here.truncated,
            )

    @njit(cache=True, nogil=True, error_model="numpy")
    def _take_blocks(bundle: Any, tally: IntArray, thread: int) -> None:
        """Advance blocks of lanes, of a thread's own share and then of others', while any is left.

        Its own first: they are still in its processor's cache from the last step.
        """
        len(sources)
        lanes, threads = len(bundle.exchange.active), (len(tally) - OWN) // (2 * APART)
        blocks = (lanes + AT_ONCE - 1) // AT_ONCE
        for offset in range(threads):
            owner = (thread + offset) % threads
            first, end = blocks * owner // threads, blocks * (owner + 1) // threads
            taken = OWN + 2 * APART * owner
            block = first + fetch_add(tally, taken, 1)
            while block < end:
                step(bundle, block * AT_ONCE, min(block * AT_ONCE + AT_ONCE, lanes))
                fetch_add(tally, DONE, 1)
                block = first + fetch_add(tally, taken, 1)

    @njit(cache=True, nogil=True, error_model="numpy")
    def _lead(bundle: Any, tally: IntArray) -> None:
        """Advance all lanes, as thread 0, together with the threads that serve."""
        len(sources)
        blocks = (len(bundle.exchange.active) + AT_ONCE - 1) // AT_ONCE
        store(tally, DONE, 0)
        for taken in range(OWN, len(tally), 2 * APART):
            store(tally, taken, 0)
        fetch_add(tally, STEPS, 1)
        take_blocks(bundle, tally, 0)
        waited = 0
        while load(tally, DONE) < blocks and load(tally, FAILED) == 0:
            waited += 1
            pause()
            # More threads than processors: the one that is waited for may wait for this one's.
            if waited > PATIENCE:
                give_way()

    @njit(cache=True, nogil=True, error_model="numpy")
    def _serve(bundle: Any, tally: IntArray, thread: int) -> None:
        """Help with the steps to come, until none has come for a while."""
        len(sources)
        asleep = OWN + 2 * APART * thread + APART
        seen, waited = 0, 0
        while waited < PATIENCE:
            now = load(tally, STEPS)
            if now != seen:
                seen, waited = now, 0
                take_blocks(bundle, tally, thread)
            else:
                pause()
                waited += 1
                if waited == PATIENCE:
                    store(tally, asleep, 1)
                    # What began before anybody could see that this thread sleeps.
                    if load(tally, STEPS) != seen:
                        store(tally, asleep, 0)
                        waited = 0

    @njit(cache=True, nogil=True, error_model="numpy")
    def _begin_lanes(bundle: Any, which: IntArray, modes: FloatArray) -> None:
        """Begin the episodes that were drawn for some lanes; modes xi, shape (lanes, n)."""
        len(sources)
        lanes, episode, here, memory = bundle.lanes, bundle.episode, bundle.exchange, bundle.memory
        vehicle = episode.vehicle
        begin_queues(bundle.queue, which, episode.delay[which], bundle.plant.time_step)
        excite_start(bundle.table, bundle.places, bundle.wheels, vehicle, which, lanes.track)
        begin(bundle.plant, lanes, which, vehicle[which], modes, here.sampled)
        begin_episodes(bundle.reward, memory, which)
        for lane in which:
            here.periods[lane] = 0
            for c in range(episode.delay.shape[1]):
                here.commands[lane, c] = 0.0
                here.true_delay[lane, c] = episode.delay[lane, c]
            for c in range(memory.told.shape[1]):
                memory.told[lane, c] = episode.told[lane, c] * bundle.limits.told_factor
            # The lane may take no part in the present step.
            takes_part = here.active[lane]
            here.active[lane] = True
            observe(memory, here.active, lane, lane + 1, here.sampled, here.observation)
            here.active[lane] = takes_part

    return _step, _take_blocks, _lead, _serve, _begin_lanes


def _digest() -> str:
    texts = [Path(str(part.__file__)).read_bytes() for part in _PARTS]
    return hashlib.sha256(b"".join(texts)).hexdigest()


# By these names they call each other: a compiled function in the scope around another one would be
# a part of it that is new in every process, and the cache would be of no use.
step, take_blocks, lead, serve, begin_lanes = _compiled(_digest())
