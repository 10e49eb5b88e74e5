"""How fast stable-baselines3 trains here: environment steps per second of PPO.

The setting is fixed so that numbers compare: the default observation, delays drawn from 0 to
300 ms, PPO's default networks (actor and critic of 64 and 64 units), 64 steps per lane and rollout,
4 epochs, a torch thread per core. Collecting and training are both in the rate; the gradients of
the networks are most of it.
"""

import os
import time

from railenv.errors import RailenvError, check_count, check_positive

ROLLOUT_STEPS = 64
"""Steps per lane between two trainings."""

EPOCHS = 4
"""How often a training goes through the rollout."""

BATCH = 4096
"""Largest number of steps per gradient."""

WARM_UP_ROLLOUTS = 2
"""Rollouts that are thrown away: compiling and the first allocations are in them."""


def ppo_rate(num_lanes: int, seconds: float) -> float:
    """Return the environment steps per second of a training by PPO.

    Args:
        num_lanes: Lanes of the environment.
        seconds: Training goes on until this long has passed [s], one rollout at least; the start
            is not counted.

    Returns:
        Steps of all lanes together per second of wall time [1/s].

    Raises:
        ArgumentError: An argument is out of its range.
        RailenvError: stable-baselines3 is not installed.
    """
    check_count("num_lanes", num_lanes)
    check_positive("seconds", seconds, "seconds")
    try:
        import torch
        from stable_baselines3 import PPO

        from baselines.sb3 import make_vec_env
    except ModuleNotFoundError:
        raise RailenvError(
            'PPO needs stable-baselines3, which is not installed; pip install "railenv[train]"'
        ) from None
    threads = torch.get_num_threads()
    torch.set_num_threads(os.cpu_count() or 1)
    env = make_vec_env(num_lanes, seed=0, delay=(0.0, 0.3))
    try:
        rollout = ROLLOUT_STEPS * num_lanes
        model = PPO(
            "MlpPolicy",
            env,
            n_steps=ROLLOUT_STEPS,
            batch_size=min(BATCH, rollout),
            n_epochs=EPOCHS,
            seed=0,
            device="cpu",
        )
        model.learn(WARM_UP_ROLLOUTS * rollout)
        before, begin = model.num_timesteps, time.perf_counter()
        passed = 0.0
        while passed < seconds:
            model.learn(rollout, reset_num_timesteps=False)
            passed = time.perf_counter() - begin
        return (model.num_timesteps - before) / passed
    finally:
        env.close()
        torch.set_num_threads(threads)
