"""Other environments in section `env` of `railenv bench-speed`, each if it is installed.

Their actions are random and drawn beforehand, resets included, as ours. Every lane of every call
counts as a step, also where the call only resets it.
"""

import importlib
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import gymnasium as gym
import numpy as np

from eval import bench
from eval.bench import Row, Stepper, closing, missing_row, rate_row, rates

POOL = 16
"""How many actions are drawn beforehand; a run goes round them."""

ENVPOOL_LANES = (64, 256, 1024, 4096)
"""Numbers of environments with which EnvPool is tried, waiting for all of them or for half."""

CARTPOLE = "CartPole-v1"


@dataclass(frozen=True)
class Peer:
    """Somebody else's environment.

    Attributes:
        method: What is run.
        lanes: How many environments.
        threads: Threads that step them.
        package: What must be installed.
        make: Makes it.
        note: What must be known to compare it.
    """

    method: str
    lanes: int
    threads: int
    package: str
    make: Callable[[], Stepper]
    note: str = ""


INSTALL = {
    "envpool": "pip install envpool",
    "mujoco": "pip install mujoco",
    "controlgym": "pip install --no-deps controlgym",
    "stable_baselines3": "pip install railenv[train]",
}
"""How to get the packages."""


def single_peers() -> list[Peer]:
    """Return the environments that stand beside one vehicle through `gym.make`."""
    return [
        Peer("CartPole-v1, gym.make", 1, 1, "gymnasium", lambda: _single(CARTPOLE), "4 states"),
        Peer("HalfCheetah-v5, gym.make", 1, 1, "mujoco", lambda: _single("HalfCheetah-v5")),
        Peer("controlgym lah", 1, 1, "controlgym", _controlgym, "48 states, linear, without delay"),
    ]


def entry_point(lanes: int) -> Peer:
    """Return Gymnasium's own vectorised CartPole."""
    return Peer(
        "CartPole-v1, vector entry point",
        lanes,
        1,
        "gymnasium",
        lambda: _vector(CARTPOLE, lanes, "vector_entry_point"),
    )


def vector_peers(lanes: Sequence[int]) -> list[Peer]:
    """Return the batches of environments; `lanes` are those of CartPole's vector entry point."""
    return [
        Peer("CartPole-v1, sync", 64, 1, "gymnasium", lambda: _vector(CARTPOLE, 64, "sync")),
        *map(entry_point, lanes),
        Peer("HalfCheetah-v5, sync", 8, 1, "mujoco", lambda: _vector("HalfCheetah-v5", 8, "sync")),
        Peer("EnvPool CartPole-v1", 64, 1, "envpool", lambda: envpool_stepper(64, 64, 1)),
    ]


def peer_row(task: str, peer: Peer, repeat: int) -> Row:
    """Measure an environment, or say why not."""
    with warnings.catch_warnings():
        why = _why_not(peer.package)
        if why:
            return missing_row(task, peer.method, why)
        with closing(peer.make()) as stepper:
            found = rates(stepper, repeat)
    return rate_row(task, peer.method, peer.lanes, peer.threads, found, peer.note)


def envpool_best(task: str, repeat: int, threads: int) -> Row:
    """Measure EnvPool's CartPole where it is fastest with this number of threads."""
    method = "EnvPool CartPole-v1, at its best"
    with warnings.catch_warnings():
        why = _why_not("envpool")
        if why:
            return missing_row(task, method, why)
        tried = [(n, batch) for n in ENVPOOL_LANES for batch in (n, n // 2)]
        quick: list[float] = []
        for lanes, batch in tried:
            with closing(envpool_stepper(lanes, batch, threads)) as stepper:
                quick += rates(stepper, 1, bench.WINDOW / 3)
        lanes, batch = tried[int(np.argmax(quick))]
        with closing(envpool_stepper(lanes, batch, threads)) as stepper:
            found = rates(stepper, repeat)
    waits = "all of them" if batch == lanes else f"{batch} of them"
    note = f"fastest of {len(tried)} settings; every call waits for {waits}"
    return rate_row(task, method, lanes, threads, found, note)


def ppo_row(task: str, lanes: int, repeat: int) -> Row:
    """Measure PPO of stable-baselines3 on ours: steps per second of training, gradients included.

    Args:
        task: Under which heading.
        lanes: Number of lanes.
        repeat: Number of runs; each lasts some windows, since PPO works in rounds.
    """
    method = "PPO on ours, through the adapter"
    with warnings.catch_warnings():
        why = _why_not("stable_baselines3")
        if why:
            return missing_row(task, method, why)
        rate = importlib.import_module("eval.bench_ppo").ppo_rate
        found = [float(rate(lanes, 4 * bench.WINDOW)) for _ in range(min(repeat, 3))]
    cores = os.cpu_count() or 1
    return rate_row(task, method, lanes, cores, found, "collection and gradient steps")


def envpool_stepper(lanes: int, batch: int, threads: int) -> Stepper:
    """Step EnvPool's CartPole, waiting for `batch` of its `lanes` environments every time."""
    pool = importlib.import_module("envpool").make_gymnasium(
        CARTPOLE, num_envs=lanes, batch_size=batch, num_threads=threads
    )
    actions = _rng().integers(0, 2, (POOL, batch)).astype(np.int32)
    if batch == lanes:
        pool.reset()

        def together(call: int) -> int:
            pool.step(actions[call % POOL])
            return lanes

        return Stepper(together, pool.close)
    pool.async_reset()

    def in_turn(call: int) -> int:
        *_, info = pool.recv()
        pool.send(actions[call % POOL], info["env_id"])
        return batch

    return Stepper(in_turn, pool.close)


def single_stepper(env: Any, actions: Any) -> Stepper:
    """Step one environment, with a reset at the end of every episode."""
    env.reset(seed=0)

    def step(call: int) -> int:
        _, _, terminated, truncated, _ = env.step(actions[call % POOL])
        if terminated or truncated:
            env.reset()
        return 1

    return Stepper(step, env.close)


def _single(name: str) -> Stepper:
    env = gym.make(name)
    return single_stepper(env, _actions(env.action_space))


def _vector(name: str, lanes: int, mode: str) -> Stepper:
    env = gym.make_vec(name, num_envs=lanes, vectorization_mode=mode)
    env.reset(seed=0)
    actions = _actions(env.action_space)

    def step(call: int) -> int:
        env.step(actions[call % POOL])
        return lanes

    return Stepper(step, env.close)


def _controlgym() -> Stepper:
    env = importlib.import_module("controlgym").make("lah")
    return single_stepper(env, _rng().uniform(-0.1, 0.1, (POOL, *env.action_space.shape)))


def _actions(space: Any) -> list[Any]:
    space.seed(0)
    return [space.sample() for _ in range(POOL)]


def _rng() -> np.random.Generator:
    return np.random.default_rng(0)


def _why_not(package: str) -> str:
    """Import a package; return why it cannot be measured, or nothing.

    What others warn of is none of our users' business; one package even makes errors of it.
    """
    warnings.simplefilter("ignore")
    how = INSTALL.get(package, f"pip install {package}")
    try:
        importlib.import_module(package)
    except ModuleNotFoundError as error:
        lacks = "" if error.name == package else f" (it lacks {error.name})"
        return f"not installed{lacks}: {how}"
    except ImportError as error:
        return f"cannot be imported: {error}"
    warnings.simplefilter("ignore")
    return ""
