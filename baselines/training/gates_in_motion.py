"""The gates of gated policies in motion.

A gated policy finds the delay out as it drives; at rest there is nothing to find out, and its gates
there are one mixture for all delays. What it does at a delay is nearer to the law of its mean gates
on a drive at that delay. That law is an approximation: the gates scatter around their mean, and a
loop whose gates move is not judged by loops whose gates stand still.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from baselines.policies.gated import GatedPolicy
from baselines.training.dev_drive import DevDrive
from baselines.training.judge_settings import CheckpointSettings
from railenv.envs.settings import EnvSettings
from railenv.units import FloatArray, Second


class GateDrive:
    """Drives over one development track at many delays, to see the gates.

    Args:
        environment: Settings of the training environment.
        chosen: How long a drive is, and what of its start does not count.
        delays: Delays, rising, shape (delays,) [s].
    """

    def __init__(
        self, environment: EnvSettings, chosen: CheckpointSettings, delays: FloatArray
    ) -> None:
        looks = tuple(float(delay) for delay in delays)
        alone = dataclasses.replace(chosen, delays=looks, dev_tracks=1)
        self._drive = DevDrive(environment, alone)

    def gates(
        self, policy: GatedPolicy, told_error: Second = 0.0
    ) -> tuple[FloatArray, NDArray[np.bool_]]:
        """Return the mean gates at every delay.

        Args:
            policy: The policy.
            told_error: Error of the delay that it is told, if it is told [s].

        Returns:
            Means over the periods that count, shape (delays, experts), each row one in sum, and
            which drives diverged, shape (delays,).
        """
        seen: list[FloatArray] = []
        # A copy: nothing is taken for granted about what the policy does with its own array.
        _, diverged = self._drive.powers(
            policy, told_error, lambda: seen.append(policy.gates.copy())
        )
        return np.mean(seen, axis=0), diverged
