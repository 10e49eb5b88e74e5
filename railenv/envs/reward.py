"""The environment's reward, term by term.

    reward = comfort + effort + divergence

- comfort = -min(a / comfort_reference, comfort_cap) with a the root mean square, over the physics
  steps of the control period and both floor ends, of the Wd-weighted lateral acceleration (EN
  12299, ISO 2631-1). The root, not the square: returns are not dominated by a few bad moments.
- effort = -effort_weight times the mean square of the actions as applied.
- divergence = -divergence_penalty on the step that leaves the gauge or diverges. Rewards are
  negative, so ending early must cost more than going on: 500 is the worst comfort for ever at a
  discount of 0.99.

Every reward lies in [-(comfort_cap + effort_weight + divergence_penalty), 0].
"""

from dataclasses import dataclass

import numpy as np

from railenv.envs.settings import EnvSettings
from railenv.metrics import weighting_filter
from railenv.units import FloatArray


@dataclass(frozen=True)
class RewardTerms:
    """The terms of one step's reward, each zero or negative [1]."""

    comfort: float
    effort: float
    divergence: float

    @property
    def total(self) -> float:
        """Their sum."""
        return self.comfort + self.effort + self.divergence


class ComfortFilter:
    """Wd-weighting of the floor accelerations, sample by sample.

    Args:
        sample_rate: Physics steps per second [Hz].
        num_signals: Signals filtered side by side.
    """

    def __init__(self, sample_rate: float, num_signals: int) -> None:
        from scipy.signal import sosfilt  # slow to import; needed only where a reward is computed

        self._sosfilt = sosfilt
        self._sections = weighting_filter("Wd", sample_rate)
        self._memory = np.zeros((len(self._sections), num_signals, 2))

    def reset(self) -> None:
        """Forget the past."""
        self._memory[:] = 0.0

    def weighted_rms(self, samples: FloatArray) -> float:
        """Filter the next samples and return their root mean square over all signals [m/s^2].

        Args:
            samples: Accelerations, shape (signals, samples) [m/s^2].
        """
        filtered, self._memory = self._sosfilt(self._sections, samples, axis=-1, zi=self._memory)
        return float(np.sqrt(np.mean(np.square(filtered))))


def reward_terms(
    settings: EnvSettings, weighted_acceleration: float, actions: FloatArray, ended: bool
) -> RewardTerms:
    """Compute the reward of one step; see the module's text.

    Args:
        settings: Weights, reference and cap.
        weighted_acceleration: a [m/s^2].
        actions: Actions as applied, shape (channels,).
        ended: Whether this step ended the episode by divergence or gauge.
    """
    return RewardTerms(
        comfort=-min(weighted_acceleration / settings.comfort_reference, settings.comfort_cap),
        effort=-settings.effort_weight * float(np.mean(np.square(actions))),
        divergence=-settings.divergence_penalty if ended else 0.0,
    )
