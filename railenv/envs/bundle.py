"""All that the compiled step reads and writes, as one object.

Handing a compiled function the environment's arrays one by one takes as long, at every call and
while no other thread can run, as stepping thirty lanes. The bundle is made once and holds them all.
"""

from typing import Any, NamedTuple

import numpy as np
from numba import njit
from numba import types as numba_types
from numba.experimental import structref as numba_structref
from numpy.typing import NDArray

from railenv.units import FloatArray

# The compiler's own tools, which have no type stubs.
structref: Any = numba_structref
types: Any = numba_types

BoolArray = NDArray[np.bool_]
IntArray = NDArray[np.int64]
Float32Array = NDArray[np.float32]


class Exchange(NamedTuple):
    """What goes into the steps of the lanes and comes out of them.

    Attributes:
        active: Lanes that take part; the others stay as they are, shape (lanes,).
        actions: Shape (lanes, actions), finite.
        commands: Wanted forces, shape (lanes, channels) [N].
        later: What these are late beyond the delay, shape (lanes, channels) [s].
        lost: Which of these get lost, shape (lanes, channels).
        true_delay: Time from the measurement to the force of the newest action, infinite for a
            lost one, shape (lanes, channels) [s].
        recorded: What the reward sees, shape (lanes, steps, 8).
        sampled: What the observation is made of, shape (lanes, measured or more).
        periods: Control periods since the start, shape (lanes,).
        reward: Shape (lanes,); zero where a lane takes no part.
        terminated: Lanes that have just left the gauge or diverged, shape (lanes,).
        truncated: Lanes that have just reached the length of an episode, shape (lanes,).
        observation: Shape (lanes, columns).
    """

    active: BoolArray
    actions: FloatArray
    commands: FloatArray
    later: FloatArray
    lost: BoolArray
    true_delay: FloatArray
    recorded: FloatArray
    sampled: FloatArray
    periods: IntArray
    reward: FloatArray
    terminated: BoolArray
    truncated: BoolArray
    observation: Float32Array


class Limits(NamedTuple):
    """Numbers of the step.

    Attributes:
        action_scale: Force of an action of one [N].
        force: Largest force in either direction [N]; infinite for none.
        force_step: Largest change between two commands [N]; infinite for none.
        periods: Control periods of an episode.
        told_factor: What a told delay is multiplied by in the observation.
    """

    action_scale: float
    force: float
    force_step: float
    periods: int
    told_factor: float


@structref.register
class BundleType(types.StructRef):
    """The compiler's type of a bundle."""

    def preprocess_fields(self, fields: Any) -> tuple[tuple[str, Any], ...]:
        """Let no field's type hold a value, as the compiler may make it of a constant."""
        return tuple((name, types.unliteral(kind)) for name, kind in fields)


class Bundle(structref.StructRefProxy):
    """The bundle; made by `bundle_of`."""


structref.define_proxy(
    Bundle,
    BundleType,
    [
        "plant",
        "lanes",
        "queue",
        "table",
        "places",
        "wheels",
        "constants",
        "reward",
        "memory",
        "episode",
        "exchange",
        "limits",
    ],
)


@njit(cache=True)
def bundle_of(
    plant: Any,
    lanes: Any,
    queue: Any,
    table: Any,
    places: Any,
    wheels: Any,
    constants: Any,
    reward: Any,
    memory: Any,
    episode: Any,
    exchange: Any,
    limits: Any,
) -> Any:
    """Make a bundle; it holds the arrays themselves, and keeps them alive.

    Args:
        plant: `PlantArrays`.
        lanes: `LaneArrays`.
        queue: `QueueArrays`.
        table: `TrackArrays`.
        places: `Places`.
        wheels: `Wheels`.
        constants: `RewardConstants`.
        reward: `RewardArrays`.
        memory: `ObservationArrays`.
        episode: `EpisodeArrays`.
        exchange: `Exchange`.
        limits: `Limits`.
    """
    return Bundle(
        plant,
        lanes,
        queue,
        table,
        places,
        wheels,
        constants,
        reward,
        memory,
        episode,
        exchange,
        limits,
    )
