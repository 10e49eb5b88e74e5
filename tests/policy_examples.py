"""Policies of every class with random numbers in them, for the tests."""

from itertools import pairwise
from typing import Any

import numpy as np

from baselines.policies import (
    GatedPolicy,
    History,
    HistoryPolicy,
    LinearPolicy,
    NetworkPolicy,
    RecurrentPolicy,
)
from railenv.envs.observation import bound
from railenv.vehicle import lateral17

VEHICLE = lateral17("paper_fit", 4, 300.0)
TOLD = (0.0, 0.1, 0.3)
PERIOD = 0.01


def history(**fields: Any) -> History:
    made: dict[str, Any] = {
        "sensor_lags": (0, 1, 3),
        "action_lags": (1, 2, 4),
        "told_knots": TOLD,
        **fields,
    }
    return History.of(made.pop("layout", 4), made.pop("sensors", None), **made)


def linear(seed: int = 0, size: float = 0.03, base: Any = None, **fields: Any) -> LinearPolicy:
    seen = history(**fields)
    shape = (seen.num_knots, seen.num_actions, seen.num_features)
    weights = size * np.random.default_rng(seed).normal(size=shape)
    return LinearPolicy(seen, weights, base)


def network(seed: int = 0, base: Any = None, **fields: Any) -> NetworkPolicy:
    plain = linear(seed, 0.03, None, **fields)
    seen, rng = plain.history, np.random.default_rng(seed + 100)
    sizes = (seen.num_features + int(seen.is_told), 7, 5, seen.num_actions)
    layers = [
        (0.3 * rng.normal(size=(rows, columns)), 0.3 * rng.normal(size=rows))
        for columns, rows in pairwise(sizes)
    ]
    return NetworkPolicy(seen, plain.weights, layers, base=base)


def recurrent(seed: int = 0, base: Any = None, **fields: Any) -> RecurrentPolicy:
    plain = linear(seed, 0.03, None, **fields)
    seen, rng, units = plain.history, np.random.default_rng(seed + 200), 6
    shapes = (
        (3 * units, seen.num_features + int(seen.is_told)),
        (3 * units, units),
        (3 * units,),
        (3 * units,),
        (seen.num_actions, units),
    )
    arrays = [0.3 * rng.normal(size=shape) for shape in shapes]
    return RecurrentPolicy(seen, plain.weights, *arrays, base=base)


def gated(seed: int = 0, base: Any = None, **fields: Any) -> GatedPolicy:
    plain = linear(seed, 0.03, None, **fields)
    seen, rng, units, number = plain.history, np.random.default_rng(seed + 300), 6, 3
    shapes = (
        (number, seen.num_actions, seen.num_features),
        (3 * units, seen.num_features + int(seen.is_told)),
        (3 * units, units),
        (3 * units,),
        (3 * units,),
        (number, units),
        (number,),
    )
    arrays = [0.05 * rng.normal(size=shape) for shape in shapes]
    return GatedPolicy(seen, plain.weights, *arrays, base=base)


MAKERS = [linear, network, recurrent, gated]


def played(policy: HistoryPolicy, readings: np.ndarray, told: np.ndarray) -> np.ndarray:
    """Return the actions after each of some readings, shape (steps, lanes, channels)."""
    policy.reset(readings.shape[1], 0)
    policy.tell(told)
    return np.array([policy.act(reading) for reading in readings])


def small_readings(policy: HistoryPolicy, steps: int, lanes: int, size: float) -> np.ndarray:
    scales = np.array([bound(name)[2] for name in policy.measures])
    shape = (steps, lanes, len(scales))
    return size * scales * np.random.default_rng(5).normal(size=shape)
