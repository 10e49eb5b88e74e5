"""Section `env` of `railenv bench-speed`: environment steps per second, ours and others'.

All in one process and one call, since rates on a shared machine change from hour to hour. What is
measured of ours: `eval.bench_ours`; beside it the bare array update (`eval.bench_bare`), other
environments (`eval.bench_peers`) and PPO.

Every rate is compared with one of ours: single environments with our single one, the bare update
with ours of the same size, all else with ours at its best number of lanes on all cores.
"""

import os
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

from eval.bench import (
    Row,
    Section,
    Stepper,
    Tell,
    closing,
    compare,
    rate_row,
    rate_table,
    rates,
)
from eval.bench_bare import BareUpdate
from eval.bench_ours import VARIATIONS, memory_row, resets_row, single_ours, vector_ours
from eval.bench_peers import (
    entry_point,
    envpool_best,
    peer_row,
    ppo_row,
    single_peers,
    vector_peers,
)

SINGLE = "one environment"
ONE_CORE = "ours, one thread"
ALL_CORES = "ours, a thread per core"
CHANGED = "ours with changes, at the best number of lanes"
BARE = "the bare array update"
OTHERS = "others"
TRAINING = "training on ours"
RESETS = "resets of ours, episodes of 10 s"
MEMORY = "memory of ours"


@dataclass(frozen=True)
class Sizes:
    """How large what is measured is.

    Attributes:
        one_core: Numbers of lanes with one thread.
        all_cores: Numbers of lanes with a thread per core.
        threads: Threads of all cores.
        resets: Lanes whose resets are measured; one of `all_cores`, the bare update is taken there.
        memory: Numbers of lanes whose memory is measured, ascending.
        entry_point: Numbers of lanes of CartPole's vector entry point, besides our best.
        training: Numbers of lanes that are trained on.
    """

    one_core: tuple[int, ...] = (1, 16, 128, 1024)
    all_cores: tuple[int, ...] = (256, 512, 1024, 2048, 4096)
    threads: int = field(default_factory=lambda: os.cpu_count() or 1)
    resets: int = 1024
    memory: tuple[int, ...] = (256, 1024, 4096)
    entry_point: tuple[int, ...] = (64, 1024)
    training: tuple[int, ...] = (64, 256)


class Measured:
    """Rows measured so far, for what comes later to build on.

    Args:
        sizes: How large.
        repeat: Windows per rate.
    """

    def __init__(self, sizes: Sizes, repeat: int) -> None:
        self.sizes = sizes
        self.repeat = repeat
        self.rows: list[Row] = []

    def of(self, task: str) -> list[Row]:
        """Return the rows of a task that hold a rate."""
        return [row for row in self.rows if row["task"] == task and "median_per_s" in row]

    @property
    def best(self) -> Row:
        """Ours with a thread per core where its median is highest."""
        return max(self.of(ALL_CORES), key=lambda row: row["median_per_s"])

    def rate(
        self, task: str, method: str, lanes: int, threads: int, stepper: Stepper, note: str = ""
    ) -> Row:
        """Measure a stepper."""
        with closing(stepper):
            found = rates(stepper, self.repeat)
        return rate_row(task, method, lanes, threads, found, note)

    def ours(self, task: str, method: str, lanes: int, threads: int, **changes: Any) -> Row:
        """Measure our vector environment."""
        used = min(lanes, threads)
        return self.rate(task, method, lanes, used, vector_ours(lanes, threads, **changes))

    def bare(self, lanes: int) -> Row | None:
        """Measure the bare update with as many threads as ours of that size, once."""
        if any(row["lanes"] == lanes for row in self.of(BARE)):
            return None
        threads = min(lanes, self.sizes.threads)
        update = BareUpdate(lanes, threads)
        stepper = Stepper(update.step, update.close)
        return self.rate(BARE, "x <- x Phi + u Gamma", lanes, threads, stepper, update.note)

    def compare(self) -> None:
        """Write into every row how many times as fast ours is."""
        single, best = self.of(SINGLE)[0], self.best
        same_size = {row["lanes"]: row for row in self.of(ALL_CORES)}
        for row in self.rows:
            if "median_per_s" not in row or row["task"] == TRAINING:
                continue
            if row["task"] == SINGLE:
                compare(row, single)
            else:
                compare(row, same_size[row["lanes"]] if row["task"] == BARE else best)


Step = tuple[str, Callable[[Measured], Row | None]]
"""What comes, and what measures it; nothing where that has been measured already."""


def env_section(sizes: Sizes) -> Section:
    """Return the section."""
    steps = [*_our_steps(sizes), *_other_steps(sizes)]

    def measure(repeat: int, tell: Tell) -> list[Row]:
        measured = Measured(sizes, repeat)
        for name, step in steps:
            tell(name)
            row = step(measured)
            if row is not None:
                measured.rows.append(row)
        measured.compare()
        return sorted(measured.rows, key=lambda row: _ORDER.index(row["task"]))

    return Section(len(steps), measure, env_table)


_ORDER = (SINGLE, ONE_CORE, ALL_CORES, CHANGED, BARE, RESETS, MEMORY, OTHERS, TRAINING)


def _our_steps(sizes: Sizes) -> list[Step]:
    """What is measured of ours, in order: what is changed needs the best number of lanes."""

    def vector(task: str, lanes: int, threads: int) -> Step:
        return f"{task}, {lanes}", lambda m: m.ours(task, "vector", lanes, threads)

    def changed(name: str) -> Step:
        def step(m: Measured) -> Row:
            lanes = m.best["lanes"]
            return m.ours(CHANGED, name, lanes, sizes.threads, **VARIATIONS[name])

        return name, step

    def memory(lanes: int) -> Step:
        def step(m: Measured) -> Row:
            return memory_row(MEMORY, lanes, [row for row in m.rows if row["task"] == MEMORY])

        return MEMORY, step

    return [
        ("ours, single", lambda m: m.rate(SINGLE, "ours, gym.make", 1, 1, single_ours())),
        *(vector(ONE_CORE, lanes, 1) for lanes in sizes.one_core),
        *(vector(ALL_CORES, lanes, sizes.threads) for lanes in sizes.all_cores),
        (BARE, lambda m: m.bare(m.best["lanes"])),
        (BARE, lambda m: m.bare(sizes.resets)),
        *map(changed, VARIATIONS),
        (RESETS, lambda m: resets_row(RESETS, sizes.resets, sizes.threads, m.repeat)),
        *map(memory, sizes.memory),
    ]


def _other_steps(sizes: Sizes) -> list[Step]:
    """What is measured of others, and of training on ours."""

    def training(lanes: int) -> Step:
        return f"{TRAINING}, {lanes}", lambda m: ppo_row(TRAINING, lanes, m.repeat)

    def as_ours(m: Measured) -> Row | None:
        lanes = m.best["lanes"]
        known = lanes in sizes.entry_point
        return None if known else peer_row(OTHERS, entry_point(lanes), m.repeat)

    return [
        *((p.method, lambda m, p=p: peer_row(SINGLE, p, m.repeat)) for p in single_peers()),
        *(
            (p.method, lambda m, p=p: peer_row(OTHERS, p, m.repeat))
            for p in vector_peers(sizes.entry_point)
        ),
        ("CartPole with as many lanes", as_ours),
        ("EnvPool at its best", lambda m: envpool_best(OTHERS, m.repeat, sizes.threads)),
        *map(training, sizes.training),
    ]


def env_table(rows: Sequence[Row]) -> list[str]:
    """Return the lines of the section's table, and what they come to."""
    best = max(
        (row for row in rows if row["task"] == ALL_CORES), key=lambda row: row["median_per_s"]
    )
    lines = [
        *rate_table(rows),
        f"  best number of lanes: {best['lanes']}, {best['median_per_s']:,.0f} steps per second; "
        "ours/this: against our single one,",
        "  against ours of the same size for the bare update, else against ours at its best",
    ]
    bare = next(row for row in rows if row["task"] == BARE)
    lines.append(f"  ours at its best / bare update there: {bare['ours_over_this']:.2f}")
    return lines
