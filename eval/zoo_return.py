"""Returns of the environment: the delay-aware optimum beside passive and every sky-hook gain.

Every lane of the vector environment is one episode; all controllers meet the same tracks, places
and noise. The passive vehicle has no actuators and so no environment: its reward is computed from a
recorded run on tracks of the same spectrum.
"""

from collections.abc import Sequence
from typing import Any

import gymnasium as gym
import numpy as np

from baselines.controller import Controller
from baselines.design.model import DESIGN_NOISE
from baselines.lqg import DETUNED, SHARP_EFFORT, DelayLqg
from baselines.passive import Passive
from baselines.skyhook import SkyHook
from eval.rollout import rollout
from eval.zoo import SKYHOOK_GAINS
from railenv.envs.registration import LATERAL17
from railenv.envs.reward import RECORDED, rewards_of_record
from railenv.envs.settings import EnvSettings
from railenv.track import make_track
from railenv.units import FloatArray
from railenv.vehicle import lateral17

EPISODES = 16
_SETTINGS: dict[str, Any] = {"observation_scale": "si", "sensor_noise": DESIGN_NOISE}


def environment_return(
    controller: Controller, delay: float, track: str, layout: str, seed: int, episodes: int
) -> FloatArray:
    """Return each episode's return.

    Args:
        controller: A law on the standard sensors.
        delay: Delay of every episode [s].
        track: Spectrum of the tracks.
        layout: Layout of the actuators.
        seed: Seed of the episodes.
        episodes: Their number.
    """
    envs = gym.make_vec(
        LATERAL17,
        num_envs=episodes,
        vectorization_mode="vector_entry_point",
        delay=delay,
        track=track,
        layout=layout,
        **_SETTINGS,
    )
    observation, _ = envs.reset(seed=seed)
    controller.reset(episodes, seed)
    returns, running = np.zeros(episodes), np.ones(episodes, dtype=bool)
    while np.any(running):
        action = np.clip(controller.act(observation.astype(np.float64)), -1.0, 1.0)
        observation, reward, terminated, truncated, _ = envs.step(action.astype(np.float32))
        returns += np.where(running, reward, 0.0)
        running &= ~(terminated | truncated)
    envs.close()
    return returns


def passive_return(track: str, seeds: Sequence[int]) -> FloatArray:
    """Return what the passive vehicle would have earned on tracks of a spectrum."""
    settings = EnvSettings(track=track)
    vehicle = lateral17("paper_fit", "passive", settings.speed_kmh)
    length = vehicle.speed * settings.episode_seconds
    tracks = [make_track(track, length, seed) for seed in seeds]
    run = rollout(
        Passive(),
        vehicle,
        np.zeros((len(tracks), 0)),
        settings.episode_seconds,
        tracks=tracks,
        track_of_lane=np.arange(len(tracks)),
        record=RECORDED,
    )
    return rewards_of_record(settings, run.values).sum(axis=1)


def compared(
    delay: float, track: str, layout: str = "4", seed: int = 1000, episodes: int = EPISODES
) -> dict[str, FloatArray]:
    """Return the returns of passive, every sky-hook gain and the delay-aware optimum at a delay."""
    vehicle = lateral17("paper_fit", layout, 300.0)
    laws: dict[str, Controller] = {
        f"skyhook:gain={gain:g}": SkyHook(gain, layout) for gain in SKYHOOK_GAINS
    }
    for word, preview in (("", False), (", preview", True)):
        laws[f"lqg-delay, sharp{word}"] = DelayLqg(vehicle, delay, preview=preview)
        laws[f"lqg-delay, detuned{word}"] = DelayLqg(
            vehicle,
            delay,
            effort=DETUNED * SHARP_EFFORT,
            noise=DETUNED * DESIGN_NOISE,
            preview=preview,
        )
    answer = {"passive": passive_return(track, range(seed, seed + episodes))}
    for name, law in laws.items():
        answer[name] = environment_return(law, delay, track, layout, seed, episodes)
    return answer
