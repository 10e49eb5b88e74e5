"""What a training method is, and finding one by its name.

A method improves a policy from episode to episode. It knows nothing of checkpoints, files and
judging, which `baselines.training.trainer` does for all of them alike.
"""

import importlib
import zlib
from typing import TYPE_CHECKING, Any, Protocol

import numpy as np
from numpy.typing import NDArray

from railenv.errors import ArgumentError, check_count, unknown_name
from railenv.track.seed_domains import TRAINING_POOLS

if TYPE_CHECKING:
    from baselines.training.settings import TrainingSettings

Arrays = dict[str, NDArray[Any]]
Plain = dict[str, Any]

METHODS = {
    "apg": "baselines.training.apg:AnalyticPolicyGradient",
    "imitation": "baselines.training.imitation:Imitation",
    "ppo": "baselines.training.sb3_on_policy:OnPolicy",
    "recurrent_ppo": "baselines.training.sb3_on_policy:OnPolicy",
    "sac": "baselines.training.sb3_off_policy:OffPolicy",
    "td3": "baselines.training.sb3_off_policy:OffPolicy",
    "tqc": "baselines.training.sb3_off_policy:OffPolicy",
}
"""Every method and where its class is."""


class Method(Protocol):
    """A training method in mid-run.

    The trainer calls `begin` before the first update, after every checkpoint and after `restore`.
    What follows `begin` may depend on nothing but the settings, the seed, `steps` and what `state`
    holds; so a run that is killed and resumed equals an undisturbed one bit for bit.

    Attributes:
        name: Its name in `METHODS`.
        steps: Lane-steps taken so far: control periods, summed over the lanes.
    """

    name: str
    steps: int

    def __init__(self, settings: "TrainingSettings", seed: int) -> None:
        """Make the policy and the environment; the settings' hyper-parameters are `hyper`."""
        ...

    @classmethod
    def hyper_parameters(cls, name: str) -> type[Any]:
        """Return the frozen dataclass of the table [method] for one of its names."""
        ...

    def begin(self) -> None:
        """Start new episodes in all lanes, seeded by `episode_seed(seed, name, steps)`."""
        ...

    def update(self) -> dict[str, float]:
        """Improve the policy once, within seconds, and add to `steps`.

        Returns:
            Numbers for the learning curve, by name: finite, and always the same names.
        """
        ...

    def module(self) -> Any:
        """Return the policy as it stands, a module of `baselines.policies.torch_modules`."""
        ...

    def state(self) -> tuple[Arrays, Plain]:
        """Return all that the coming updates depend on: weights, moments, counters.

        Returns:
            Arrays by name, in any dtype of numpy but objects, as copies; and plain values for JSON.
        """
        ...

    def restore(self, arrays: Arrays, plain: Plain) -> None:
        """Go back to what `state` returned, `steps` included."""
        ...


def method_class(name: str) -> type[Method]:
    """Return the class of a method.

    Raises:
        ArgumentError: There is no such method, or a package that it needs is not installed.
    """
    if name not in METHODS:
        raise unknown_name("training method", name, METHODS)
    module, _, kind = METHODS[name].partition(":")
    try:
        found: type[Method] = getattr(importlib.import_module(module), kind)
    except ModuleNotFoundError as missing:
        if missing.name and missing.name.partition(".")[0] in ("baselines", "railenv"):
            raise
        raise ArgumentError(
            f"method {name!r} needs {missing.name}, which is not installed: "
            'pip install "railenv[train]"'
        ) from None
    return found


def episode_seed(seed: int, stream: str, number: int) -> int:
    """Return a seed for the episodes of training, from 0 to 899 999.

    Args:
        seed: The run's seed.
        stream: What it is for; different words have independent seeds.
        number: Which one, e.g. the lane-steps taken before.

    Returns:
        A seed for `reset(seed=...)` of up to 100 000 lanes, all below
            `railenv.track.seed_domains.TRAINING_SEEDS`.
    """
    entropy = [
        check_count("seed", seed, minimum=0),
        zlib.crc32(stream.encode()),
        check_count("number", number, minimum=0),
    ]
    drawn = int(np.random.SeedSequence(entropy).generate_state(1, np.uint64)[0])
    return drawn % TRAINING_POOLS
