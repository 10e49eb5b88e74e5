"""Our environment in section `env` of `railenv bench-speed`: its rate, its resets, its memory.

The standard case: four actuators, a delay drawn from 0 to 0.3 s per episode, TB/T 3352 at 300 km/h,
the whole default observation and reward, 10 ms between actions, physics and accelerations every
5 ms, episodes of 10 s and autoreset in the same step. Actions are random, small enough for nobody
to diverge, and drawn beforehand. The episodes of a batch begin evenly spread, so that every window
holds its share of resets.
"""

import gc
import statistics
import time
import tracemalloc
from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np
from numpy.typing import NDArray

from eval.bench import Row, Stepper
from eval.bench_peers import POOL, single_stepper
from railenv.envs.registration import LATERAL17

STANDARD: dict[str, Any] = {
    "layout": 4,
    "delay": (0.0, 0.3),
    "track": "tb3352",
    "speed_kmh": 300.0,
    "control_period": 0.01,
    "time_step": 0.005,
    "episode_seconds": 10.0,
    "vehicle_ranges": "none",
}
"""The standard case; all else is the environment's default."""

VARIATIONS: dict[str, dict[str, Any]] = {
    "vehicles from a pool of 64": {"vehicle_ranges": "wide", "vehicle_pool": 64},
    "jitter and dropouts": {
        "delay": (0.0, 0.28),
        "jitter": 0.02,
        "dropout": 0.05,
        "sensor_dropout": 0.05,
    },
    "autoreset in the next step": {"autoreset_mode": "next_step"},
}
"""Changes of the standard case that are measured too."""

AMPLITUDE = 0.1
"""Largest action."""

Actions = NDArray[np.float32]


def make_ours(lanes: int, threads: int, **changes: Any) -> Any:
    """Make the vector environment in the standard case with changes."""
    settings = {"autoreset_mode": "same_step", **STANDARD, **changes}
    return gym.make_vec(
        LATERAL17,
        num_envs=lanes,
        vectorization_mode="vector_entry_point",
        threads=threads,
        **settings,
    )


def single_ours() -> Stepper:
    """Step the single environment through `gym.make`."""
    return single_stepper(gym.make(LATERAL17, **STANDARD), drawn_actions())


def vector_ours(lanes: int, threads: int, **changes: Any) -> Stepper:
    """Step the vector environment with its episodes evenly spread; resets are no steps."""
    env = make_ours(lanes, threads, **changes)
    actions = drawn_actions(lanes)
    spread_out(env, actions)
    waits = changes.get("autoreset_mode") == "next_step"
    to_reset = 0

    def step(call: int) -> int:
        nonlocal to_reset
        _, _, terminated, truncated, _ = env.step(actions[call % POOL])
        taken = lanes - to_reset
        if waits:
            to_reset = int(np.count_nonzero(terminated | truncated))
        return taken

    return Stepper(step, env.close)


def spread_out(env: Any, actions: Actions) -> None:
    """Let the episodes of the lanes begin evenly over the length of one."""
    periods = num_periods()
    env.reset(seed=0)
    begins = np.arange(env.num_envs) * periods // env.num_envs
    for period in range(1, periods):
        env.step(actions[period % POOL])
        due = begins == period
        if due.any():
            env.reset(options={"reset_mask": due})


def drawn_actions(*lanes: int) -> Actions:
    """Return a pool of random actions, shape (POOL, *lanes, 4)."""
    drawn = np.random.default_rng(0).uniform(-AMPLITUDE, AMPLITUDE, (POOL, *lanes, 4))
    return drawn.astype(np.float32)


def num_periods() -> int:
    """Return the steps of an episode of the standard case."""
    return round(STANDARD["episode_seconds"] / STANDARD["control_period"])


def resets_row(task: str, lanes: int, threads: int, repeat: int) -> Row:
    """Measure what resets cost in a run of whole episodes.

    Of a batch whose episodes begin together the last step holds all resets; one whose episodes
    begin evenly spread resets every lane once in as many steps.
    """
    together, spread = make_ours(lanes, threads), make_ours(lanes, threads)
    actions, periods = drawn_actions(lanes), num_periods()
    spread_out(spread, actions)
    times: list[tuple[float, float, float]] = []
    for _ in range(min(repeat, 3)):
        together.reset(seed=0)
        before = _seconds(together, actions, periods - 1)
        last = _seconds(together, actions, 1)
        times.append((before, last, _seconds(spread, actions, periods)))
    together.close()
    spread.close()
    before, last, evenly = (statistics.median(column) for column in zip(*times, strict=True))
    without, at_once = before * periods / (periods - 1), before + last
    share_evenly, share_at_once = (100.0 * (1.0 - without / whole) for whole in (evenly, at_once))
    return {
        "task": task,
        "method": f"{lanes} lanes, {periods} steps",
        "lanes": lanes,
        "threads": threads,
        "without_s": without,
        "evenly_spread_s": evenly,
        "all_at_once_s": at_once,
        "per_cent_evenly_spread": share_evenly,
        "per_cent_all_at_once": share_at_once,
        "shown": f"without {without:.3f} s; spread {evenly:.3f} s: {share_evenly:.1f} %; "
        f"at once {at_once:.3f} s: {share_at_once:.1f} %",
        "note": f"{threads} threads; every lane is reset once, evenly spread over the steps or "
        "all in the last one; per cent of the whole run",
    }


def memory_row(task: str, lanes: int, before: Sequence[Row]) -> Row:
    """Measure what an environment in use holds, and what lanes add to the row before."""
    held = held_bytes(lanes)
    more = None
    shown = f"{held / 1e6:.2f} MB"
    if before:
        more = (held - before[-1]["bytes"]) / (lanes - before[-1]["lanes"])
        shown += f"; {more:,.0f} bytes for every lane more"
    return {
        "task": task,
        "method": f"{lanes} lanes",
        "lanes": lanes,
        "bytes": held,
        "bytes_per_lane_more": more,
        "shown": shown,
        "note": "",
    }


def held_bytes(lanes: int) -> int:
    """Return what Python allocates for the environment with one thread, its pools included."""
    make_ours(1, 1).close()  # what is loaded once and kept is no memory of the lanes
    gc.collect()
    tracemalloc.start()
    try:
        env = make_ours(lanes, 1)
        env.reset(seed=0)
        env.step(np.zeros((lanes, 4), dtype=np.float32))
        gc.collect()
        held = tracemalloc.get_traced_memory()[0]
        env.close()
    finally:
        tracemalloc.stop()
    return held


def _seconds(env: Any, actions: Actions, steps: int) -> float:
    start = time.perf_counter()
    for call in range(steps):
        env.step(actions[call % POOL])
    return time.perf_counter() - start
