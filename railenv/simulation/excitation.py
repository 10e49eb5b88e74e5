"""What the wheelsets see of a track: its irregularity at their own places, in time.

Wheelset i sees the track delayed by its distance behind the leading one over the speed. Cross level
[m] becomes the roll of the track plane, over the spacing of the rolling circles.
"""

import numpy as np

from railenv.errors import check_count, check_positive
from railenv.track import Track
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle
from railenv.vehicle.suspension import NUM_TRACK


def required_length(vehicle: LateralVehicle, duration: float) -> float:
    """Return how much track a run needs [m]; the leading wheelset starts at distance 0."""
    return vehicle.speed * check_positive("duration", duration, "seconds")


def wheelset_inputs(
    vehicle: LateralVehicle, track: Track, time_step: float, num_steps: int
) -> FloatArray:
    """Sample a track at the four wheelsets.

    Args:
        vehicle: Gives speed, wheelset places and contact spacing.
        track: The irregularity; straight and level before distance 0.
        time_step: Physics step [s].
        num_steps: Number of physics steps.

    Returns:
        Alignment at wheelsets 1 to 4 [m] and track roll there [rad] at every step's start and the
        last one's end, shape (num_steps + 1, 8).

    Raises:
        ArgumentError: The track is shorter than the run.
    """
    steps = np.arange(check_count("num_steps", num_steps) + 1)
    lead = vehicle.speed * time_step * steps
    inputs = np.empty((len(steps), NUM_TRACK))
    for column, setback in enumerate(vehicle.wheelset_setback):
        inputs[:, column] = track.sample("alignment", lead - setback)
        roll = track.sample("cross_level", lead - setback)
        inputs[:, NUM_TRACK // 2 + column] = roll / (2 * vehicle.parameters.half_contact_spacing)
    return inputs
