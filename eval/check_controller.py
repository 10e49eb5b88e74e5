"""Says what is wrong with a controller before a benchmark runs it."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from baselines.controller import Controller, measured_by
from baselines.passive import Passive
from eval.cells import controller_for, grows, is_linear
from eval.check_runs import LANES, MANY, SECONDS, CheckRuns
from eval.entries import Entry, entry_of
from eval.packages import packages_of
from eval.policy_score_oracle import is_told
from eval.rollout import ACCELERATIONS, ControlledBatch, Stepping
from eval.scenarios import Suite
from eval.scenarios.scenario import vehicle_of
from railenv.envs.observation import DEFAULT_ACTION_SCALE, Observer, pipe_length
from railenv.errors import ControllerError, RailenvError
from railenv.simulation import whole_multiple
from railenv.units import FloatArray, Second
from railenv.vehicle import LateralVehicle

_SPEED_KMH = 300.0
_SLOW: Second = 60.0
"""Longest time of the suite's largest package before a controller is said to be slow [s]."""

_AT_LIMIT = 0.01
"""Share of the time at the force limit above which a run counts as diverged, `eval.measures`."""

_FAINT = 1.0
"""Largest force that does nothing [N]."""


@dataclass(frozen=True)
class Finding:
    """One thing that was looked at.

    Attributes:
        name: What.
        good: Whether it is as it should be; None for what is only told.
        words: What was found.
    """

    name: str
    good: bool | None
    words: str


@dataclass(frozen=True)
class CheckWork:
    """A check as work for a worker process: a controller may hang or end its process.

    Attributes:
        suite: Says how runs are stepped, and on which layouts and models.
        controller: SPEC.
    """

    suite: Suite
    controller: str


def check_work(work: CheckWork) -> list[Finding]:
    """Return all findings, see `check_controller`."""
    return list(check_controller(work.suite, work.controller))


def check_controller(suite: Suite, spec: str) -> Iterator[Finding]:
    """Make a controller, drive it for some seconds, and yield what is found.

    Args:
        suite: Says how runs are stepped, and on which layouts and models.
        spec: The controller's SPEC.
    """
    try:
        entry = entry_of(spec)
    except RailenvError as error:
        yield Finding("made", False, str(error))
        return
    only = entry.layout
    layouts = list(dict.fromkeys(s.layout for s in suite.scenarios))
    if only is not None and only not in layouts:
        yield Finding("layouts", False, f"it acts on layout {only}, the suite has {layouts}")
    for layout in layouts:
        name = f"layout {layout}"
        if only not in (None, layout):
            yield Finding(name, None, f"not run here: it acts on layout {only}")
            continue
        try:
            controller = controller_for(spec, ("lateral17", "nominal", layout, _SPEED_KMH))
        except RailenvError as error:
            yield Finding(f"{name}: made", False, str(error))
            continue
        for finding in _Drive(suite, entry, controller, layout).findings():
            yield replace(finding, name=f"{name}: {finding.name}")


class _Drive:
    """Runs of one controller on one layout.

    Args:
        suite: Says how runs are stepped.
        entry: The controller's SPEC, and the models that it acts on.
        controller: Made from it.
        layout: The layout it is asked for.
    """

    def __init__(self, suite: Suite, entry: Entry, controller: Controller, layout: str) -> None:
        self._suite, self._entry, self._controller = suite, entry, controller
        self._place = ("lateral17", "nominal", layout, _SPEED_KMH)
        self._layout = "passive" if getattr(controller, "layout", None) == "passive" else layout
        vehicle = vehicle_of(self._place, self._layout)
        assert isinstance(vehicle, LateralVehicle)
        self._vehicle = vehicle
        # Taken as given: what is wrong with it, the first run says.
        self._period: Any = getattr(controller, "control_period", None)
        self._scale: Any = getattr(controller, "action_scale", DEFAULT_ACTION_SCALE)

    def findings(self) -> Iterator[Finding]:
        """Yield them; the first failure is the last one."""
        told = is_told(self._controller)
        yield Finding("division", None, "told the delay" if told else "untold the delay")
        try:
            stepping = self._stepping()
            yield self._columns(stepping)
            for model in dict.fromkeys(s.model for s in self._suite.scenarios):
                length = self._suite.duration(model)
                whole_multiple("the run", length, "control_period", stepping.control_period)
            runs = CheckRuns(self._suite, self._vehicle, stepping)
            whole, again = runs.forces(self._controller), runs.forces(self._controller)
            alone = self._alone(runs)
            free = runs.free_forces(self._controller)
            yield Finding("runs", True, f"{SECONDS:g} s with {LANES} lanes, and alone")
            yield self._oracle()
            yield from self._force(free)
            yield self._repeatable(runs, whole, again)
            yield self._apart(whole, alone)
            yield from _manners(runs)
            yield self._ride(runs)
            yield self._speed(runs, stepping)
            yield self._to_the_end(runs)
            yield from self._nonlinear(stepping)
        except RailenvError as error:
            yield Finding("runs", False, str(error))

    def _alone(self, runs: CheckRuns) -> FloatArray:
        """Return the forces of the second lane by itself."""
        try:
            return runs.forces(self._controller, lanes=[1])
        except RailenvError as error:
            raise ControllerError(
                f"{error}; in a run with one lane after one with {LANES}: reset(num_lanes, seed) "
                "must make all that is kept for num_lanes lanes anew"
            ) from error

    def _stepping(self) -> Stepping:
        stepping = self._suite.stepping(self._period)
        # Says what is wrong with the controller's words on itself.
        ControlledBatch(self._controller, self._vehicle, ACCELERATIONS, stepping)
        return stepping

    def _columns(self, stepping: Stepping) -> Finding:
        names = measured_by(self._controller, self._vehicle.layout)
        channels = self._vehicle.num_actuators
        length = pipe_length(stepping.max_delay, stepping.control_period)
        number = len(Observer(names, channels, length).columns)
        words = (
            f"act gets {number} columns: {len(names)} measured in SI units ({names[0]} to "
            f"{names[-1]}), then {length} past actions of {channels} channels, the newest first"
        )
        return Finding("columns", None, words)

    def _oracle(self) -> Finding:
        if not self._vehicle.num_actuators:
            return Finding("oracle", None, "no actuators: no delay makes it unstable")
        if not is_linear(self._controller):
            return Finding("oracle", None, "not linear: simulations answer on its stability")
        unstable = grows(self._controller, self._vehicle, 0.0)
        words = "linear: the oracle answers on its stability; "
        words += "without delay the loop grows" if unstable else "without delay the loop is stable"
        return Finding("oracle", None, words)

    def _force(self, forces: FloatArray) -> Iterator[Finding]:
        """Judge the forces without delay, where no law that fits the vehicle needs much."""
        if not forces.shape[2]:
            yield Finding("force", None, "no actuators")
            return
        limit = self._suite.force_limit
        peak = float(np.abs(forces).max())
        share = float(np.mean(np.abs(forces) >= limit))
        unit = f"an action of one is action_scale = {self._scale / 1e3:g} kN"
        if getattr(self._controller, "damper", None) is not None:
            unit = f"an action of one is action_scale = {self._scale / 1e3:g} kN s/m"
        words = f"largest force without delay {peak / 1e3:.3g} kN"
        if share > _AT_LIMIT:
            words += (
                f", at the limit of {limit / 1e3:g} kN for {100 * share:.0f} % of the time, which "
                f"counts as diverged; {unit}: are the actions in newtons?"
            )
        elif peak < _FAINT:
            words += f", next to nothing; {unit}"
        yield Finding("force", False if share > _AT_LIMIT else None, words)

    def _repeatable(self, runs: CheckRuns, first: FloatArray, again: FloatArray) -> Finding:
        if np.array_equal(first, again, equal_nan=True):
            return Finding("repeatable", True, "two runs are the same bit for bit")
        self._controller = controller_for(self._entry.spec, self._place)
        words = (
            "two runs with one seed differ, also of a new controller: draw from a generator that "
            "reset(num_lanes, seed) makes from the seed, and keep nothing in the class or module"
        )
        if np.array_equal(first, runs.forces(self._controller), equal_nan=True):
            words = (
                "a second run differs from the first, and a new controller's first run does not: "
                "reset(num_lanes, seed) must forget all that the last run has left"
            )
        return Finding("repeatable", False, words)

    def _apart(self, whole: FloatArray, alone: FloatArray) -> Finding:
        apart = float(np.nan_to_num(np.abs(whole[1] - alone[0])).max(initial=0.0))
        # Rounding of matrix products may depend on how many rows there are.
        if apart <= 1e-6 * max(float(np.nan_to_num(np.abs(whole)).max(initial=0.0)), 1.0):
            return Finding("lanes", True, "a lane does not depend on the others")
        words = (
            f"a lane alone differs by {apart:.3g} N from the same one among {LANES}: state, noise "
            "or the told delay is shared between lanes"
        )
        return Finding("lanes", False, words)

    def _ride(self, runs: CheckRuns) -> Finding:
        """Compare the floor's acceleration without delay with the passive vehicle's."""
        if not self._vehicle.num_actuators:
            return Finding("ride", None, "no actuators")
        passive = vehicle_of(self._place, "passive")
        assert isinstance(passive, LateralVehicle)
        idle = CheckRuns(self._suite, passive, self._suite.stepping()).floor(Passive())
        own = runs.floor(self._controller)
        words = f"without delay the floor shakes {own / idle:.2f} times as on passive dampers"
        if not own < idle and getattr(self._controller, "damper", None) is None:
            words += "; is the sign right? a positive action pushes the carbody to positive y"
        return Finding("ride", None, words)

    def _speed(self, runs: CheckRuns, stepping: Stepping) -> Finding:
        """Tell what the largest package of the suite would take, from runs of few and of many."""
        few, many = (runs.step_seconds(self._controller, lanes) for lanes in (LANES, MANY))
        spec, layout = self._entry.spec, self._place[2]
        packages = packages_of(self._suite, spec, layout, ["lateral17"])
        largest = max((len(package.scenarios) for package in packages), default=1)
        growth = max(0.0, many - few) / (MANY - LANES)
        step = few + growth * max(0, largest - LANES)
        seconds = step * self._suite.duration("lateral17") / stepping.control_period
        words = (
            f"{1e3 * few:.2f} ms per step with {LANES} lanes, {1e3 * many:.2f} ms with {MANY}; "
            f"about {seconds:.2g} s for a package of {largest} runs"
        )
        slow = "" if seconds < _SLOW else "; that is slow: act takes all lanes at once, no loop"
        return Finding("speed", None if slow else True, words + slow)

    def _to_the_end(self, runs: CheckRuns) -> Finding:
        """Run it as long, and as late, as the suite does."""
        delay = max(s.channel.delay for s in self._suite.scenarios)
        what = f"{self._suite.duration('lateral17'):g} s at {1e3 * delay:g} ms"
        try:
            bounded = runs.to_the_end(self._controller, delay)
        except RailenvError as error:
            return Finding("whole run", False, f"in a run of {what}: {error}")
        words = what if bounded else f"{what}: the vehicle diverged, which counts -1"
        return Finding("whole run", True if bounded else None, words)

    def _nonlinear(self, stepping: Stepping) -> Iterator[Finding]:
        if not any(s.model == "full50" for s in self._suite.scenarios):
            return
        if "full50" not in (self._entry.models or ("full50",)):
            words = "not run on full50, which has actuators alone"
            if getattr(self._controller, "damper", None) is None:
                words = (
                    "not run on full50: the controller measures a state of the linear vehicle that "
                    "the nonlinear one does not have"
                )
            yield Finding("nonlinear vehicle", None, words)
            return
        vehicle = vehicle_of(("full50", *self._place[1:]), self._layout)
        try:
            batch = ControlledBatch(self._controller, vehicle, ACCELERATIONS, stepping)
            batch.reset(np.zeros((1, vehicle.num_actuators)))
            batch.advance()
        except RailenvError as error:
            yield Finding("nonlinear vehicle", None, f"its cells on full50 fail: {error}")
            return
        yield Finding("nonlinear vehicle", True, "it runs on full50")


def _manners(runs: CheckRuns) -> Iterator[Finding]:
    """Say what does no harm here and may do so elsewhere."""
    if runs.changed:
        what = " and ".join(sorted(runs.changed))
        words = f"it writes to {what}; make new arrays, elsewhere others read them too"
        yield Finding("arguments", None, words)
    if runs.numpy_errors:
        words = (
            "it changes how numpy takes errors for the whole program; use `with np.errstate(...)`"
        )
        yield Finding("numpy's errors", None, words)
