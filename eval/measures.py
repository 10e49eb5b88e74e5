"""From recorded signals to the numbers of a run: comfort, accelerations, forces, divergence."""

from dataclasses import dataclass, fields

import numpy as np

from eval.rollout import ACCELERATIONS
from railenv.metrics import continuous_comfort, mean_comfort, rms, sperling, sperling_original
from railenv.simulation import Trajectory
from railenv.units import FloatArray

GROWTH_LIMIT = 2.0
"""A floor acceleration whose RMS over the last third is this many times that over the first third
has diverged; on stationary track the two differ by some tens of percent at most."""

STARTED = 5.0
"""Time [s] that must be left out for growth to be judged: a run begins at rest, its track rises."""

SATURATION_LIMIT = 0.01
"""A run that holds its commands at the force limit for more than this share has diverged."""


@dataclass(frozen=True, eq=False)
class RunMeasures:
    """Numbers of a batch of runs, one entry per lane; NaN where a lane blew up.

    Attributes:
        ride_index_front: Sperling Wz of the front floor, GB/T 5599 amplitude form [1].
        ride_index_rear: The same at the rear floor [1].
        ride_index_original_front: Wz in the original integral form, front [1].
        ride_index_original_rear: The same, rear [1].
        comfort_front: EN 12299 continuous comfort C_Cy, mean over 5 s blocks, front [m/s^2].
        comfort_rear: The same, rear [m/s^2].
        mean_comfort_front: EN 12299 N_MV from the lateral direction alone, front [1].
        mean_comfort_rear: The same, rear [1].
        floor_rms_front: RMS lateral acceleration of the front floor [m/s^2].
        floor_rms_rear: The same, rear [m/s^2].
        bogie_rms: RMS lateral acceleration of the worse bogie frame [m/s^2].
        force_rms: RMS force over all actuators [N]; zero without actuators.
        force_peak: Largest force [N].
        saturated_share: Share of samples at the force limit [1].
        diverged: Blown up, saturated beyond `SATURATION_LIMIT`, or grown beyond `GROWTH_LIMIT`;
            growth is judged only where the start is left out.
    """

    ride_index_front: FloatArray
    ride_index_rear: FloatArray
    ride_index_original_front: FloatArray
    ride_index_original_rear: FloatArray
    comfort_front: FloatArray
    comfort_rear: FloatArray
    mean_comfort_front: FloatArray
    mean_comfort_rear: FloatArray
    floor_rms_front: FloatArray
    floor_rms_rear: FloatArray
    bogie_rms: FloatArray
    force_rms: FloatArray
    force_peak: FloatArray
    saturated_share: FloatArray
    diverged: np.ndarray

    def lane(self, index: int) -> dict[str, float | bool | None]:
        """Return one lane's numbers as plain values, None for NaN."""
        values: dict[str, float | bool | None] = {}
        for field in fields(self):
            value = getattr(self, field.name)[index]
            if field.name == "diverged":
                values[field.name] = bool(value)
            else:
                values[field.name] = float(value) if np.isfinite(value) else None
        return values


def measure(
    trajectory: Trajectory, skip: float, force_limit: float | None, risen: float = STARTED
) -> RunMeasures:
    """Compute the numbers of a batch of runs.

    Args:
        trajectory: Signals of `eval.rollout.rollout`.
        skip: Time left out at the start [s].
        force_limit: The actuators' limit [N].
        risen: Time that must be left out for growth to be judged [s].

    Returns:
        One number per lane and measure.
    """
    rate = trajectory.sample_rate
    start = int(np.searchsorted(trajectory.time, skip * (1 + 1e-12), side="right"))
    acceleration = np.stack([trajectory.signal(name)[:, start:] for name in ACCELERATIONS])
    blown_up = ~np.all(np.isfinite(acceleration), axis=(0, 2))
    # Metrics refuse signals that are not finite; a blown-up lane is measured as silence and then
    # marked, so that nothing of it is taken for a result.
    acceleration = np.where(blown_up[:, None], 0.0, acceleration)
    front, rear, bogie1, bogie2 = acceleration

    def marked(values: object) -> FloatArray:
        return np.where(blown_up, np.nan, np.asarray(values, dtype=float))

    forces = [n for n in trajectory.names if n.startswith("actuator_force")]
    zero = np.zeros(acceleration.shape[1])
    force_rms, force_peak, saturated = zero, zero, zero
    if forces:
        force = np.stack([trajectory.signal(n)[:, start:] for n in forces], axis=1)
        force = np.nan_to_num(force)
        force_rms = np.sqrt(np.mean(force**2, axis=(1, 2)))
        force_peak = np.abs(force).max(axis=(1, 2))
        if force_limit is not None:
            # Forces reach the limit itself only by being cut there.
            saturated = np.mean(np.abs(force) >= force_limit * (1 - 1e-12), axis=(1, 2))
    third = acceleration.shape[2] // 3
    first = rms(acceleration[:2, :, :third])
    last = rms(acceleration[:2, :, -third:])
    grown = np.any(np.asarray(last) > GROWTH_LIMIT * np.asarray(first), axis=0)
    grown &= skip >= risen
    blocks = int(acceleration.shape[2] / rate / 5.0 + 1e-9)
    return RunMeasures(
        ride_index_front=marked(sperling(front, rate)),
        ride_index_rear=marked(sperling(rear, rate)),
        ride_index_original_front=marked(sperling_original(front, rate, form="integral")),
        ride_index_original_rear=marked(sperling_original(rear, rate, form="integral")),
        comfort_front=marked(np.mean(continuous_comfort(front, rate), axis=-1)),
        comfort_rear=marked(np.mean(continuous_comfort(rear, rate), axis=-1)),
        mean_comfort_front=marked(mean_comfort(None, front, None, rate, blocks=blocks)),
        mean_comfort_rear=marked(mean_comfort(None, rear, None, rate, blocks=blocks)),
        floor_rms_front=marked(rms(front)),
        floor_rms_rear=marked(rms(rear)),
        bogie_rms=marked(np.maximum(rms(bogie1), rms(bogie2))),
        force_rms=marked(force_rms),
        force_peak=marked(force_peak),
        saturated_share=marked(saturated),
        diverged=blown_up | (saturated > SATURATION_LIMIT) | grown,
    )
