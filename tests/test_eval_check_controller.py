"""The check of a controller: what is wrong is said, what is said is true, what is right passes."""

from typing import Any

import numpy as np
import pytest
from benchmark_examples import BROKEN, block, suite_of
from broken_controllers import Law

from eval.check_controller import CheckWork, Finding, check_controller, check_work
from eval.rollout import rollout
from railenv.vehicle import lateral17

# Beside test_eval_benchmark.py and test_eval_store.py, which the default run has.
pytestmark = pytest.mark.slow

CHECKED = suite_of(block(delays_ms=(0.0, 300.0)))


def findings(name: str, suite: Any = CHECKED) -> dict[str, Finding]:
    return {f.name: f for f in check_controller(suite, f"{BROKEN}{name}")}


def problems(found: dict[str, Finding]) -> list[str]:
    return [name for name, finding in found.items() if finding.good is False]


@pytest.mark.parametrize(
    "spec",
    [
        f"{BROKEN}Law",
        f"{BROKEN}Told",
        f"{BROKEN}SinglePrecision",
        f"{BROKEN}View",
        "skyhook",
        "apg-linear",
        "passive",
        "semiactive-onoff",
    ],
)
def test_a_controller_without_fault_has_no_problem(spec: str) -> None:
    found = {f.name: f for f in check_controller(CHECKED, spec)}
    assert problems(found) == []
    assert found["layout 4: repeatable"].good
    assert found["layout 4: lanes"].good


@pytest.mark.parametrize(
    ("name", "finding", "words"),
    [
        ("Raises", "runs", "act raised RuntimeError: gave up"),
        ("RaisesInReset", "runs", "reset raised RuntimeError"),
        ("RaisesLate", "runs", "ZeroDivisionError"),
        ("Nan", "runs", "not finite"),
        ("WrongShape", "runs", "(4,); it must be (3, 4)"),
        ("Complex", "runs", "complex128 are no real numbers"),
        ("BeyondColumns", "runs", "(3, 0); it must be (3, 4)"),
        ("OnlyTwo", "runs", "(3, 2); it must be (3, 4)"),
        ("OddPeriod", "runs", "whole multiple"),
        ("Newtons", "force", "are the actions in newtons?"),
        ("Forgetful", "repeatable", "reset(num_lanes, seed) must forget"),
        ("Unseeded", "repeatable", "draw from a generator that reset(num_lanes, seed) makes"),
        ("OfTheClass", "repeatable", "keep nothing in the class or module"),
        ("Shared", "lanes", "state, noise or the told delay is shared between lanes"),
        ("ToldTheFirst", "lanes", "state, noise or the told delay is shared between lanes"),
        ("SizedOnce", "runs", "must make all that is kept for num_lanes lanes anew"),
        ("NanAtTheEnd", "whole run", "in a run of 6 s at 300 ms: act returned a value that is not"),
        ("not_made", "made", "no licence"),
        ("nothing", "made", "a controller needs reset(num_lanes, seed) and act"),
    ],
)
def test_what_is_wrong_with_a_controller_is_said(name: str, finding: str, words: str) -> None:
    found = findings(name)
    assert f"layout 4: {finding}" in problems(found)
    assert words in found[f"layout 4: {finding}"].words


@pytest.mark.parametrize(
    ("name", "finding", "words"),
    [
        ("WrongSign", "ride", "the sign right? a positive action pushes the carbody to positive y"),
        ("Overwrites", "arguments", "writes to the delays that it is told and the observations"),
        ("RaisesWarnings", "numpy's errors", "use `with np.errstate(...)`"),
        ("Faint", "force", "next to nothing; an action of one is action_scale = 3 kN"),
    ],
)
def test_what_may_be_meant_is_said_and_is_no_problem(name: str, finding: str, words: str) -> None:
    found = findings(name)
    assert problems(found) == []
    assert found[f"layout 4: {finding}"].good is None
    assert words in found[f"layout 4: {finding}"].words


def test_a_fault_on_one_layout_is_a_fault_of_that_layout() -> None:
    found = findings("Law", suite_of(block(layouts=("2", "4"))))
    assert problems(found) == ["layout 2: runs"]


def test_a_policy_of_one_layout_is_not_run_on_the_other() -> None:
    suite = suite_of(block(layouts=("2", "4")))
    found = {f.name: f for f in check_controller(suite, "apg-linear")}
    assert problems(found) == []
    assert found["layout 2"].words == "not run here: it acts on layout 4"


def test_a_policy_for_another_layout_than_the_suites_is_unfit() -> None:
    suite = suite_of(block(layouts=("2",)))
    found = {f.name: f for f in check_controller(suite, "apg-linear")}
    assert problems(found) == ["layouts"]


def test_a_spec_that_names_nothing_is_unfit() -> None:
    (finding,) = check_controller(CHECKED, "skyhok")
    assert not finding.good
    assert "skyhook" in finding.words


def test_the_nonlinear_vehicle_is_tried_where_the_suite_has_it() -> None:
    suite = suite_of(block(), block(models=("full50",)))
    assert findings("Law", suite)["layout 4: nonlinear vehicle"].good
    for spec, words in (
        ("lqr", "a state of the linear vehicle that the nonlinear one does not have"),
        ("semiactive-onoff", "not run on full50"),
    ):
        found = {f.name: f for f in check_controller(suite, spec)}["layout 4: nonlinear vehicle"]
        assert found.good is None
        assert words in found.words


def test_the_columns_that_act_gets_are_those_that_are_said() -> None:
    seen: list[int] = []

    class Looks(Law):
        def act(self, observations: np.ndarray) -> np.ndarray:
            seen.append(observations.shape[1])
            return super().act(observations)

    vehicle = lateral17("paper_fit", 4, 300.0)
    rollout(Looks(), vehicle, np.zeros((1, 4)), 0.01, stepping=CHECKED.stepping())
    words = findings("Law")["layout 4: columns"].words
    assert words.startswith(f"act gets {seen[0]} columns: 16 measured in SI units")


def test_a_positive_action_pushes_the_carbody_to_positive_y() -> None:
    class Pushes(Law):
        def act(self, observations: np.ndarray) -> np.ndarray:
            return np.ones((len(observations), 4))

    vehicle = lateral17("paper_fit", 4, 300.0)
    record = ("carbody_lateral_velocity_1", "carbody_lateral_velocity_4")
    run = rollout(Pushes(), vehicle, np.zeros((1, 4)), 0.2, record=record)
    # The hint on the sign says so, and the sensors that a sky-hook reads do.
    assert run.values[0, -1].min() > 0.0


def test_what_a_package_takes_is_said_and_is_no_problem(monkeypatch: pytest.MonkeyPatch) -> None:
    fast = findings("Law")["layout 4: speed"]
    assert (fast.good, "slow" in fast.words) == (True, False)
    assert fast.words.endswith("for a package of 2 runs")
    monkeypatch.setattr("eval.check_controller._SLOW", 1e-9)
    slow = findings("Law")["layout 4: speed"]
    assert slow.good is None
    assert "that is slow: act takes all lanes at once" in slow.words


def test_a_loop_over_lanes_is_told_by_what_it_takes_of_many() -> None:
    suite = suite_of(block(delays_ms=(0.0, 300.0), seeds=100))
    words = findings("Loops", suite)["layout 4: speed"].words
    seconds = float(words.split("about ")[1].split(" s ")[0])
    # 200 lanes of 0.1 ms in 600 steps sleep 12 s; with three lanes it would seem 0.2 s.
    assert seconds > 12.0


def test_what_a_controller_does_to_numpy_is_undone() -> None:
    with np.errstate(all="warn"):
        before = np.geterr()
        findings("RaisesWarnings")
        assert np.geterr() == before


def test_a_worker_gives_all_findings_at_once() -> None:
    spec = f"{BROKEN}Nan"
    assert check_work(CheckWork(CHECKED, spec)) == list(check_controller(CHECKED, spec))
