"""What stable-baselines3 is shown: the features of a history, whitened, and the told delay.

The environment observes every sensor and every past action up to the oldest age. Here the columns
of the policy's history are picked (`History.columns`), multiplied by a fixed matrix, and the told
delay in seconds follows as the last column (zero if the delay is hidden).

Whitening. The features of one run are nearly collinear: their covariance spans four decades with
noise of the sensors and ten without. A gradient step is then long in the few directions that
move and short in all others. With C the covariance of the features in a first drive of
the vehicle under a mild sky-hook, the learner sees z = M x with the symmetric square root

    M = (C + ridge tr(C) / F)^(-1/2),

fixed from then on (a matrix that follows the policy would change the policy), and folded into the
exported weights.

Rewards are shifted and scaled to r' = (r + offset) (1 - discount) scale, so that returns are of
order `scale`: a value network that has to learn returns of -100 learns nothing for a million steps,
and its gradients crowd out the policy's where both are limited together. The shift changes no
ranking, since episodes are truncated with a bootstrap and not ended; only divergence ends one.
"""

from typing import Any

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from baselines.policies.history import History
from baselines.sb3 import StableBaselinesEnv
from railenv.errors import ArgumentError, check_positive
from railenv.units import FloatArray

try:
    from stable_baselines3.common.vec_env import VecEnvWrapper
except ModuleNotFoundError as missing:
    missing.add_note('this needs stable-baselines3: pip install "railenv[train]"')
    raise

Observations = NDArray[np.float32]

TOLD_MIDDLE = 0.15
"""A told delay tau is shown as tau / TOLD_MIDDLE - 1, which is of order one [s]."""


class PolicyColumns(VecEnvWrapper):
    """The adapter with the observation that a policy sees, and rewards of order one.

    Args:
        venv: The adapter; its environment observes what `history.environment()` asks for.
        history: What the policy sees.
        discount: The learner's discount per control period, gamma [1].
        reward_offset: Added to every reward [1].
        reward_scale: Size of the returns [1].

    Attributes:
        history: As given.
        matrix: What features are multiplied by, shape (F, F); the identity until `whiten`.

    Raises:
        ArgumentError: The environment does not observe a feature.
    """

    def __init__(
        self,
        venv: StableBaselinesEnv,
        history: History,
        discount: float,
        reward_offset: float = 0.0,
        reward_scale: float = 1.0,
    ) -> None:
        self.history = history
        names = venv.get_attr("observation_names")[0]
        scales = venv.get_attr("observation_scales")[0]
        self._columns = history.columns(names)
        told = history.told_columns(names)
        self._told_columns = told if history.is_told else told[:0]
        self._told_scales = np.asarray(scales[self._told_columns], dtype=np.float64)
        self._factor = (1.0 - discount) * check_positive("reward_scale", reward_scale)
        self._offset = float(reward_offset)
        self.matrix: FloatArray = np.eye(history.num_features)
        self._earned: list[float] = []
        space = spaces.Box(-np.inf, np.inf, (history.num_features + 1,), np.float32)
        super().__init__(venv, observation_space=space)

    def features(self, observations: NDArray[Any]) -> FloatArray:
        """Return the features of observations of the environment, shape (lanes, F), not whitened.

        Args:
            observations: Shape (lanes, columns).
        """
        return np.asarray(observations[:, self._columns], dtype=np.float64)

    def told(self, observations: NDArray[Any]) -> FloatArray:
        """Return the told delays, shape (lanes,) [s]; zeros if the delay is hidden."""
        if not len(self._told_columns):
            return np.zeros(len(observations))
        return (observations[:, self._told_columns] * self._told_scales).mean(axis=1)

    def seen(self, observations: NDArray[Any]) -> Observations:
        """Return what the learner sees: whitened features, then the told delay (`TOLD_MIDDLE`)."""
        whitened = self.features(observations) @ self.matrix.T
        told = self.told(observations) / TOLD_MIDDLE - 1.0
        return np.concatenate([whitened, told[:, None]], axis=1).astype(np.float32)

    def whiten(self, ridge: float, record: FloatArray) -> None:
        """Fix the matrix by a record of features, shape (samples, F); see the module's text.

        Args:
            ridge: Share of the mean variance that every direction is given at least [1].
            record: Features of a drive.
        """
        self.matrix = whitening(ridge, record)

    def reset(self) -> Observations:
        """Start new episodes; return what the learner sees."""
        self._earned = []
        return self.seen(np.asarray(self.venv.reset()))

    def step_wait(
        self,
    ) -> tuple[Observations, NDArray[np.float32], NDArray[np.bool_], list[dict[str, Any]]]:
        """Advance by one control period; see `StableBaselinesEnv.step_wait`."""
        observations, rewards, dones, infos = self.venv.step_wait()
        for lane in np.nonzero(dones)[0].tolist():
            last = infos[lane]["terminal_observation"]
            infos[lane]["terminal_observation"] = self.seen(last[None])[0]
        self._earned.append(float(rewards.mean()))
        scaled = ((rewards + self._offset) * self._factor).astype(np.float32)
        return self.seen(np.asarray(observations)), scaled, dones, infos

    def mean_reward(self) -> float:
        """Return the mean reward of a control period since this was asked last or lanes were reset.

        In the environment's units, all lanes together; 0 before the first period.
        """
        earned, self._earned = self._earned, []
        return float(np.mean(earned)) if earned else 0.0


def whitening(ridge: float, record: FloatArray) -> FloatArray:
    """Return the symmetric whitening matrix of a record; see the module's text.

    Args:
        ridge: Share of the mean variance added to every direction [1].
        record: Shape (samples, F).

    Returns:
        Shape (F, F).

    Raises:
        ArgumentError: The record does not move, or the ridge is not positive.
    """
    covariance = record.T @ record / len(record)
    variances, axes = np.linalg.eigh(covariance)
    mean = float(variances.mean())
    if not mean > 0.0:
        raise ArgumentError("record has no motion; drive on a track that is not flat")
    floor = check_positive("ridge", ridge) * mean
    return (axes / np.sqrt(np.maximum(variances, 0.0) + floor)) @ axes.T


def mild_drive(
    env: PolicyColumns, seconds: float, gain: float, exploration: float, seed: int
) -> FloatArray:
    """Drive under a mild sky-hook with exploration, and return the features.

    The sky-hook acts on the lateral velocities of the carbody at the actuators, which the
    environment observes whether the policy reads them or not.

    Args:
        env: All lanes begin anew.
        seconds: Length of the drive [s].
        gain: Of the sky-hook [N s/m].
        exploration: Standard deviation of white noise on the action [1].
        seed: Of episodes and noise.

    Returns:
        Features of all lanes and periods, shape (samples, F).
    """
    history, venv = env.history, env.venv
    names = list(venv.get_attr("observation_names")[0])
    scales = venv.get_attr("observation_scales")[0]
    chosen = [i for i, name in enumerate(names) if _is_speed(name)]
    generator = np.random.default_rng(seed)
    venv.seed(seed)
    observations = np.asarray(venv.reset())
    record: list[FloatArray] = []
    for _ in range(max(1, round(seconds / history.control_period))):
        speeds = observations[:, chosen] * scales[chosen]
        by_action = speeds.reshape(len(speeds), history.num_actions, -1).mean(axis=2)
        actions = -gain / history.action_scale * by_action
        actions += exploration * generator.standard_normal(actions.shape)
        observations = np.asarray(venv.step(np.clip(actions, -1.0, 1.0))[0])
        record.append(env.features(observations))
    return np.concatenate(record)


def _is_speed(name: str) -> bool:
    return name.startswith("carbody_lateral_velocity_") and "_ago_" not in name
