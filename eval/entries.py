"""Who takes part in a benchmark: controllers by SPEC, their division, and the file behind each.

Two divisions. A controller of "told" knows the delay: it has a method `tell`, or its SPEC has
{delay} in it and stands for a design per delay. All others are "untold"; they may be compared with
the told ones, not the other way round.
"""

import hashlib
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Any

from baselines import make_controller
from baselines.controller import measured_by
from baselines.policies.folder import CARD_FILE, POLICY_FILE
from baselines.policies.shipped import shipped_folder, shipped_names
from eval.packages import REFERENCE
from eval.policy_score_oracle import is_told
from eval.told_designs import PLACE, check_place
from eval.workers import Pool
from railenv.errors import ArgumentError, ControllerError, InputFileError
from railenv.simulation.full_outputs import output_names
from railenv.vehicle import lateral17, state_space
from railenv.vehicle.coordinates import Layout, parse_layout
from railenv.vehicle.nonlinear import full50

SHIPPED = "shipped"
"""Stands for all shipped policies in a suite's list of controllers."""

_OWN = "py:"
_LAYOUTS = ("4", "2")


@dataclass(frozen=True)
class Entry:
    """One controller of a benchmark.

    Attributes:
        spec: Its SPEC.
        division: "told" or "untold".
        sha256: SHA-256 of the files behind it; None if it needs none.
        layout: The only layout that it acts on; None if it takes either, or has no actuators.
        models: Vehicle models that it can act on; None for all. Semi-active dampers are known to
            the linear vehicle alone, and so are some states that state feedback measures, which is
            no fault of the laws.
    """

    spec: str
    division: str
    sha256: str | None
    layout: str | None = None
    models: tuple[str, ...] | None = None


def entries_of(specs: Sequence[str], pool: Pool | None = None) -> list[Entry]:
    """Return the entries of some SPECs, each once; "shipped" is replaced by the shipped policies.

    A controller of the user's own that cannot even be made is an entry all the same: that it fails
    is its result.

    Args:
        specs: The SPECs.
        pool: Makes the user's own controllers, whose code may hang or end its process; None makes
            them here.

    Raises:
        ArgumentError: A SPEC is not understood.
        InputFileError: The file of a saved policy cannot be used.
    """
    whole: list[str] = []
    for spec in specs:
        whole += shipped_names() if spec == SHIPPED else [spec]
    whole = list(dict.fromkeys(whole))
    own = [spec for spec in whole if spec.startswith(_OWN)] if pool is not None else []
    found = _made_apart(own, pool) if pool is not None and own else {}
    return [found[spec] if spec in found else entry_of(spec) for spec in whole]


def entry_of(spec: str) -> Entry:
    """Return the entry of one SPEC; see `entries_of`."""
    if spec == REFERENCE:
        raise ArgumentError(f"controller {REFERENCE!r} is run with every benchmark; leave it out")
    if spec.endswith(":") and spec != _OWN:
        raise ArgumentError(
            f"controller {spec!r} has nothing behind its colon; write {spec.rstrip(':')!r}"
        )
    if PLACE in spec:
        check_place(spec)
        law = make_controller(spec.replace(PLACE, "0.1"))
        return Entry(spec, "told", None, models=_models(law))
    try:
        controller = make_controller(spec)
    except ControllerError:
        return Entry(spec, "untold", _digest(spec))
    division = "told" if is_told(controller) else "untold"
    return Entry(spec, division, _digest(spec), _only_layout(spec, controller), _models(controller))


def _made_apart(specs: Sequence[str], pool: Pool) -> dict[str, Entry]:
    """Return entries that are made in workers; one that is lost there is an entry all the same."""
    found: dict[str, Entry] = {}
    for outcome in pool.run(_entry_or_words, specs):
        if isinstance(outcome.value, str):
            raise ArgumentError(outcome.value)
        lost = Entry(outcome.task, "untold", None)
        found[outcome.task] = lost if outcome.value is None else outcome.value
    return found


def _entry_or_words(spec: str) -> Entry | str:
    """Return an entry, or what is wrong with its SPEC."""
    try:
        return entry_of(spec)
    except (ArgumentError, InputFileError) as error:
        return str(error)


def _only_layout(spec: str, controller: Any) -> str | None:
    """Return the layout that a controller has whichever is asked for; None if it has none."""
    layout = getattr(controller, "layout", None)
    if layout is None or layout == "passive":
        return None
    if spec in shipped_names() or _file_of(spec) is not None:
        return str(layout)
    if not spec.startswith(_OWN):
        return None
    try:
        others = [getattr(make_controller(spec, other), "layout", None) for other in _LAYOUTS]
    except ControllerError:
        return None
    return str(layout) if len(set(others)) == 1 else None


def _models(controller: object) -> tuple[str, ...] | None:
    if getattr(controller, "damper", None) is not None:
        return ("lateral17",)
    try:
        layout = parse_layout(getattr(controller, "layout", "4"))
        measured = set(measured_by(controller, layout))
    except ArgumentError:
        return None  # that it cannot be run is its result
    missing = measured - _nonlinear_outputs(layout)
    return ("lateral17",) if missing and missing <= _linear_states() else None


@cache
def _nonlinear_outputs(layout: Layout) -> frozenset[str]:
    return frozenset(output_names(full50(layout=layout)))


@cache
def _linear_states() -> frozenset[str]:
    return frozenset(state_space(lateral17()).states)


def _file_of(spec: str) -> Path | None:
    """Return the file of a saved policy that a SPEC names; None if it names none."""
    folder = shipped_folder() / spec if spec in shipped_names() else Path(spec)
    if (folder / CARD_FILE).is_file():
        # The card is left out: it holds the score, which changes nothing of the policy.
        return folder / POLICY_FILE
    if spec.endswith((".npz", ".safetensors")) and folder.is_file():
        return folder
    return None


def _digest(spec: str) -> str | None:
    """Return the SHA-256 of the file behind a SPEC; None if it needs none.

    Of the user's own controller that is the module's file; what it imports is not looked at.
    """
    file = _file_of(spec)
    if file is None and spec.startswith(_OWN):
        module = sys.modules.get(spec.split(":")[1])
        name = getattr(module, "__file__", None)
        file = Path(name) if isinstance(name, str) else None
    if file is None or not file.is_file():
        return None
    return hashlib.sha256(file.read_bytes()).hexdigest()
