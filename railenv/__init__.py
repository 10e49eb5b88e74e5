"""railenv: railway vehicles under delayed active suspension.

Importing this package registers the Gymnasium ids and loads nothing heavy. The parts:

- `railenv.vehicle`, `railenv.track`, `railenv.actuation`, `railenv.simulation`: the plant;
- `railenv.stability`: the oracle, how much delay a linear feedback stands;
- `railenv.metrics`: ride indices;
- `railenv.envs`: the environments, e.g. `gymnasium.make("railenv/Lateral17-v0")`.
"""

from railenv.envs.registration import register_envs
from railenv.errors import ArgumentError, InputFileError, OutputError, RailenvError

__all__ = ["ArgumentError", "InputFileError", "OutputError", "RailenvError", "__version__"]
__version__ = "0.1.0"

register_envs()
