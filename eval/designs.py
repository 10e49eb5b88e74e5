"""Laws of this project for the packages of a benchmark: each is designed once per process.

A design takes up to seconds, and packages that differ in the vehicle alone need the same one. What
is handed out is a copy, so that no run meets what another one left in a law.
"""

import copy
from functools import cache, lru_cache

from baselines import make_controller
from baselines.controller import Controller
from baselines.registry import registered_controllers
from eval.scenarios.scenario import NOMINAL
from railenv.units import KilometrePerHour

_KEPT = 64


def designed(spec: str, layout: str, speed_kmh: KilometrePerHour) -> Controller:
    """Return a controller for the nominal vehicle, see `baselines.make_controller`.

    Args:
        spec: SPEC. Files and the user's own controllers are made anew each time.
        layout: Layout of actuators.
        speed_kmh: Running speed [km/h].

    Raises:
        ArgumentError: The SPEC is not understood, or the law cannot be designed.
        ControllerError: The user's own function failed.
        InputFileError: The file of a saved policy cannot be used.
    """
    if spec.partition(":")[0] not in _names():
        return make_controller(spec, layout, NOMINAL, speed_kmh)
    return copy.deepcopy(_kept(spec, layout, speed_kmh))


@lru_cache(maxsize=_KEPT)
def _kept(spec: str, layout: str, speed_kmh: KilometrePerHour) -> Controller:
    return make_controller(spec, layout, NOMINAL, speed_kmh)


@cache
def _names() -> frozenset[str]:
    return frozenset(entry.name for entry in registered_controllers())
