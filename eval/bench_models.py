"""Section `models` of `railenv bench-speed`: how fast the vehicle models run.

One control period of 10 ms is one step, so a hundred steps per second are real time. The nonlinear
vehicle runs on TB/T 3352 at 300 km/h with four actuators and small random commands, all eight
wheels in contact. Beside it: the linear vehicle, and the same nonlinear equations left to SciPy's
adaptive integrator, as one would do without a stepper of one's own.
"""

import subprocess
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from os import cpu_count
from typing import Any

import gymnasium as gym
import numpy as np
from scipy.integrate import solve_ivp

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
from railenv.envs.registration import FULL50
from railenv.simulation import LateralSimulation, wheelset_inputs
from railenv.simulation.full import DEFAULT_FULL_STEP
from railenv.simulation.full_run import FullSimulation
from railenv.track import make_track
from railenv.vehicle import lateral17
from railenv.vehicle.nonlinear import ContactSettings, equilibrium, full50, rate_of_change

PERIOD = 0.01
"""Time between commands, one step [s]."""

SECONDS = 60.0
"""Length of the track [s]; a run begins anew at its end."""

FULL = "50 coordinates, one vehicle, one core"
LINEAR = "17 coordinates, one vehicle, one core"
ENVIRONMENT = "railenv/Full50-v0"
START = "a second process, from start to its first step"

LAWS = ("fastsim-table", "fastsim", "polach", "shen-hedrick-elkins")
_FLOOR = ("floor_front_lateral_acceleration", "floor_rear_lateral_acceleration")
_AMPLITUDE = 300.0  # [N]
_START_UP = """
import gymnasium, numpy, railenv
env = gymnasium.make("{name}")
env.reset(seed=0)
env.step(numpy.zeros(4, dtype=numpy.float32))
"""


@dataclass(frozen=True)
class ModelSizes:
    """How large what is measured is.

    Attributes:
        lanes: Numbers of vehicles of the vectorised environment.
        threads: Threads of all cores.
    """

    lanes: tuple[int, ...] = (16, 64)
    threads: int = field(default_factory=lambda: cpu_count() or 1)


def full_stepper(law: str, time_step: float) -> Stepper:
    """Return the nonlinear vehicle under small random commands."""
    vehicle = full50("paper_fit", 4, 300.0, ContactSettings(law=law))
    simulation = FullSimulation(vehicle, _FLOOR, time_step=time_step)
    track = make_track("tb3352", vehicle.speed * SECONDS, 0)
    return _looped(simulation, [track])


def linear_stepper() -> Stepper:
    """Return the linear vehicle under the same commands."""
    vehicle = lateral17("paper_fit", 4, 300.0)
    simulation = LateralSimulation(vehicle, _FLOOR)
    track = make_track("tb3352", vehicle.speed * SECONDS, 0)
    steps = round(SECONDS / simulation.time_step)
    inputs = wheelset_inputs(vehicle, track, simulation.time_step, steps)
    return _looped(simulation, inputs[None])


def _looped(simulation: Any, track: Any) -> Stepper:
    """Run a simulation over a track, again and again."""
    commands = np.random.default_rng(0).normal(0.0, _AMPLITUDE, (round(SECONDS / PERIOD), 1, 4))

    def step(call: int) -> int:
        number = call % (len(commands) - 1)
        if number == 0:
            simulation.reset(np.full((1, 4), 0.1), track)
        simulation.advance(commands[number])
        return 1

    return Stepper(step)


def adaptive_stepper() -> Stepper:
    """Return the nonlinear vehicle left to SciPy's LSODA, on smooth track, one period a step."""
    vehicle = full50("paper_fit", 4, 300.0)
    states = [equilibrium(vehicle).state]
    states[0][: len(vehicle.arrays.mass)] += 1e-5

    def step(_: int) -> int:
        found = solve_ivp(
            lambda _, x: rate_of_change(vehicle, x)[0],
            (0.0, PERIOD),
            states[0],
            method="LSODA",
            rtol=1e-5,
            atol=1e-9,
        )
        states[0] = found.y[:, -1]
        return 1

    return Stepper(step)


def environment_stepper(lanes: int, threads: int) -> Stepper:
    """Return the environment, single for one lane, else vectorised, in episodes of 10 s."""
    draw = np.random.default_rng(0)
    settings: dict[str, Any] = {"delay": (0.0, 0.3), "episode_seconds": 10.0}
    if lanes == 1:
        env = gym.make(FULL50, **settings)
        env.reset(seed=0)
        action = draw.uniform(-0.1, 0.1, (64, 4)).astype(np.float32)

        def single(call: int) -> int:
            _, _, ended, late, _ = env.step(action[call % 64])
            if ended or late:
                env.reset()
            return 1

        return Stepper(single, env.close)
    envs = gym.make_vec(
        FULL50,
        num_envs=lanes,
        vectorization_mode="vector_entry_point",
        threads=threads,
        autoreset_mode="same_step",
        **settings,
    )
    envs.reset(seed=0)
    actions = draw.uniform(-0.1, 0.1, (16, lanes, 4)).astype(np.float32)

    def vector(call: int) -> int:
        envs.step(actions[call % 16])
        return lanes

    return Stepper(vector, envs.close)


def start_row(repeat: int) -> Row:
    """Time a new process that makes the environment and steps it once, code compiled before."""
    script = _START_UP.format(name=FULL50)
    times: list[float] = []
    for _ in range(repeat + 1):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-c", script], check=True)  # noqa: S603 (our own text)
        times.append(time.perf_counter() - start)
    middle = sorted(times[1:])[(len(times) - 1) // 2]
    shown = f"{middle:.2f} s"
    return {"task": START, "method": FULL50, "seconds": middle, "shown": shown, "note": ""}


def models_section(sizes: ModelSizes) -> Section:
    """Return the section."""
    steps: list[tuple[str, str, str, int, int, Callable[[], Stepper]]] = [
        (law, FULL, law, 1, 1, lambda law=law: full_stepper(law, DEFAULT_FULL_STEP)) for law in LAWS
    ]
    steps += [
        ("SciPy", FULL, "the same equations by SciPy's LSODA", 1, 1, adaptive_stepper),
        ("linear", LINEAR, "exact steps of 5 ms", 1, 1, linear_stepper),
        ("single", ENVIRONMENT, "single", 1, 1, lambda: environment_stepper(1, 1)),
    ]
    steps += [
        (
            f"{lanes} lanes",
            ENVIRONMENT,
            "vectorised",
            lanes,
            sizes.threads,
            lambda lanes=lanes: environment_stepper(lanes, sizes.threads),
        )
        for lanes in sizes.lanes
    ]

    def measured(repeat: int, tell: Tell) -> list[Row]:
        rows: list[Row] = []
        for word, task, method, lanes, threads, make in steps:
            tell(word)
            with closing(make()) as stepper:
                found = rates(stepper, repeat)
            row = rate_row(task, method, lanes, threads, found)
            times = row["median_per_s"] * PERIOD
            row["times_real_time"] = times
            row["note"] = f"{times:.3g} times real time"
            rows.append(row)
            compare(row, rows[0])
        tell("start")
        rows.append(start_row(repeat))
        return rows

    return Section(len(steps) + 1, measured, _table)


def _table(rows: Sequence[Row]) -> list[str]:
    lines = rate_table(rows)
    heading = f"control steps of {1000 * PERIOD:g} ms per second; physics of the nonlinear vehicle "
    return [f"{heading}every {1000 * DEFAULT_FULL_STEP:g} ms", *lines]
