"""Controllers by name: `make_controller("skyhook:gain=35e3")`.

A SPEC is a registered name with settings after a colon; the name of a shipped policy; the path of a
saved law (`gain.npz`) or of a trained policy (its folder, or its `.safetensors`); or
`py:module:function` for a controller of the user's own. The function, or class, is called without
arguments, or with `layout="2"` or "4" if it has a parameter of that name. A name goes before a
folder that is called the same; write `./name` for the folder.
"""

import importlib
import inspect
import sys
from pathlib import Path
from typing import Any

import numpy as np

from baselines import (
    clipped_lqg,
    groundhook,
    hinfinity,
    hinfinity_shaping,
    lead,
    lqg,
    lqr,
    mixedhook,
    optimum,
    passive,
    pid,
    predictor,
    relative,
    robust,
    semi_active,
    skyhook,
    smith,
)
from baselines.controller import Controller, users_own_code
from baselines.policies.folder import is_policy, load_trained
from baselines.policies.shipped import load_shipped, shipped_names
from baselines.policy_file import load_policy
from baselines.registered import Registered
from railenv.errors import (
    ArgumentError,
    ControllerError,
    InputFileError,
    RailenvError,
    check_text,
    unknown_name,
)
from railenv.vehicle import LateralVehicle, lateral17
from railenv.vehicle.coordinates import parse_layout

_REGISTRY: dict[str, Registered] = {
    entry.name: entry
    for entry in (
        passive.PASSIVE,
        passive.ZERO,
        skyhook.SKYHOOK,
        skyhook.SKYHOOK_ACCELEROMETER,
        lead.SKYHOOK_LEAD,
        groundhook.GROUNDHOOK,
        mixedhook.MIXEDHOOK,
        relative.RELATIVE,
        pid.PID,
        lqr.LQR,
        lqg.LQG,
        lqg.DELAY_LQG,
        hinfinity.HINFINITY,
        hinfinity_shaping.HINFINITY_SHAPING,
        robust.ROBUST_ABSCISSA,
        robust.ROBUST_DELAY,
        smith.SMITH,
        predictor.PREDICTOR,
        semi_active.SEMIACTIVE_ONOFF,
        semi_active.SEMIACTIVE_SKYHOOK,
        clipped_lqg.CLIPPED_LQG,
        optimum.OPTIMUM,
    )
}


def registered_controllers() -> list[Registered]:
    """List every controller that can be named."""
    return list(_REGISTRY.values())


def make_controller(
    spec: str, layout: object = 4, vehicle: str = "paper_fit", speed_kmh: float = 300.0
) -> Controller:
    """Make a controller from its SPEC.

    Args:
        spec: `name`, `name:key=value,key=value`, `FILE.npz`, `FOLDER`, `FILE.safetensors`, or
            `py:module:function`.
        layout: 2 or 4 (or "passive"); `passive` and a saved policy bring their own.
        vehicle: Name of the vehicle that a law with a model in it is designed for.
        speed_kmh: Running speed that it is designed for [km/h].

    Returns:
        The controller.

    Raises:
        ArgumentError: The name, a key or a value is not valid.
        ControllerError: The user's own function failed or returned no controller.
        InputFileError: The file of a saved policy cannot be used.
    """
    place = parse_layout(layout)
    if spec.endswith(".npz"):
        return load_policy(spec)
    name, _, rest = spec.partition(":")
    if name == "py":
        return _from_module(rest, place)
    if name not in _REGISTRY:
        if spec in shipped_names():
            return load_shipped(spec)
        if is_policy(spec):
            return load_trained(spec)
        if _is_folder(spec):
            raise InputFileError(
                f"{spec} is a folder without card.json, no FOLDER of a trained policy; if it is a "
                "training that is not done, finish it with --resume, or give its "
                "checkpoints/STEPS/policy"
            )
        others = ("py:module:function", "FILE.npz", "FOLDER of a trained policy")
        raise unknown_name("controller", name, [*_REGISTRY, *shipped_names(), *others])
    entry = _REGISTRY[name]
    values: dict[str, float | str] = {key: default for key, (default, _) in entry.settings.items()}
    given: set[str] = set()
    for item in rest.split(",") if rest else []:
        key, equals, text = item.partition("=")
        if key in given:
            raise ArgumentError(f"controller {spec!r}: {key} is given twice; give it once")
        given.add(key)
        if not equals:
            raise ArgumentError(f"controller {spec!r}: {item!r} has no value; write key=value")
        if key not in values:
            if not values:
                raise ArgumentError(f"controller {name!r} has no settings; drop {item!r}")
            raise unknown_name(f"setting of {name}", key, values)
        default, unit = entry.settings[key]
        values[key] = text if isinstance(default, str) else check_text(key, text, unit)
    return _built(spec, entry, lateral17(vehicle, place, speed_kmh), values)


def _is_folder(spec: str) -> bool:
    try:
        return bool(spec) and Path(spec).is_dir()
    except OSError:  # no name that a file can have
        return False


def _built(
    spec: str, entry: Registered, vehicle: LateralVehicle, values: dict[str, float | str]
) -> Controller:
    """Make a registered controller; numbers that its design cannot compute with are an error."""
    try:
        # What overflows on the way is told by what comes out.
        with np.errstate(all="ignore"):
            return entry.build(vehicle, **values)
    except RailenvError:
        raise
    except (np.linalg.LinAlgError, ArithmeticError, ValueError, MemoryError) as error:
        raise ArgumentError(
            f"controller {spec!r} cannot be designed ({type(error).__name__}: {error}); its "
            "settings are beyond what can be computed with, move them towards the defaults"
        ) from None


def _from_module(rest: str, layout: str) -> Controller:
    module_name, colon, function_name = rest.partition(":")
    if not colon or not module_name or not function_name:
        raise ArgumentError(f"controller 'py:{rest}' must be py:module:function")
    if module_name.startswith(".") or "/" in module_name or "\\" in module_name:
        raise ArgumentError(
            f"controller 'py:{rest}' must be py:module:function, the module by its name as after "
            "`import`, not by a path; run the command from the folder that holds it"
        )
    # The user's module usually lies in the folder the command is run from.
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.insert(0, here)
    try:
        with users_own_code(f"controller module {module_name!r}"):
            module = importlib.import_module(module_name)
    except ControllerError as error:
        missing = error.__cause__
        name = missing.name if isinstance(missing, ModuleNotFoundError) else None
        if name and f"{module_name}.".startswith(f"{name}."):
            raise ArgumentError(
                f"controller module {module_name!r} was not found; it must be importable from here"
            ) from None
        raise
    function: Any = getattr(module, function_name, None)
    if not callable(function):
        raise ArgumentError(f"module {module_name!r} has no function {function_name!r}")
    with users_own_code(f"{module_name}:{function_name}"):
        wants_layout = "layout" in inspect.signature(function).parameters
        controller = function(layout=layout) if wants_layout else function()
    if not isinstance(controller, Controller):
        raise ControllerError(
            f"{module_name}:{function_name} returned {type(controller).__name__}; a controller "
            "needs reset(num_lanes, seed) and act(observations)"
        )
    return controller
