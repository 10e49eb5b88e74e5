"""Laws that are designed per delay and told it, and designs that a process keeps."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines import make_controller, save_policy
from baselines.controller import Controller
from eval.cells import controller_for, is_linear
from eval.designs import designed
from eval.scenarios import Scenario
from eval.told_designs import PLACE, ToldDesigns
from railenv.errors import ArgumentError

# Beside test_eval_benchmark.py and test_eval_store.py, which the default run has.
pytestmark = pytest.mark.slow

# Designs that are kept.


@pytest.mark.parametrize(
    "spec",
    [
        "lqg-delay:delay=0.1",
        pytest.param("robust-delay", marks=pytest.mark.slow),
        "clipped-lqg",
        "pid",
    ],
)
def test_a_law_that_is_kept_is_handed_out_as_it_was_made(spec: str) -> None:
    readings = np.random.default_rng(0).normal(size=(20, 2, 64))

    def actions(law: Controller) -> np.ndarray:
        law.reset(2, 0)
        return np.array([law.act(one) for one in readings])

    first = actions(designed(spec, "4", 300.0))
    second = designed(spec, "4", 300.0)
    assert second is not designed(spec, "4", 300.0)
    np.testing.assert_array_equal(actions(second), first)
    np.testing.assert_array_equal(actions(make_controller(spec, "4")), first)


def test_what_a_run_does_to_a_law_stays_with_that_run() -> None:
    one = designed("lqg-delay:delay=0.1", "4", 300.0)
    vars(one).clear()
    designed("lqg-delay:delay=0.1", "4", 300.0).reset(2, 0)


def test_laws_are_kept_by_layout_and_speed() -> None:
    for place in (("4", 300.0), ("2", 300.0), ("4", 250.0)):
        law = designed("lqg", *place)
        alone = make_controller("lqg", place[0], "paper_fit", place[1])
        readings = np.ones((1, 64))
        for each in (law, alone):
            each.reset(1, 0)
        np.testing.assert_array_equal(law.act(readings), alone.act(readings))


def test_a_file_is_read_anew_each_time(tmp_path: Path) -> None:
    path = str(tmp_path / "law.npz")
    hooks: list[Any] = [make_controller(f"skyhook:gain={gain}") for gain in (1e3, 2e3)]
    save_policy(hooks[0], path)
    gentle = designed(path, "4", 300.0)
    save_policy(hooks[1], path)
    strong = designed(path, "4", 300.0)
    readings = np.ones((1, 64))
    for law in (gentle, strong):
        law.reset(1, 0)
    np.testing.assert_allclose(strong.act(readings), 2.0 * gentle.act(readings), rtol=1e-12)


# Families of designs.


class Echo:
    """Says its delay in every action; `started` are its numbers of lanes."""

    measures = ("carbody_lateral",)
    action_scale = 5.0

    def __init__(self, delay: float) -> None:
        self.delay = delay
        self.started: list[tuple[int, int]] = []

    def reset(self, num_lanes: int, seed: int) -> None:
        self.started.append((num_lanes, seed))

    def act(self, observations: np.ndarray) -> np.ndarray:
        return np.full((len(observations), 2), self.delay) + observations[:, :1]


def test_every_lane_runs_the_law_of_its_delay_on_its_own_readings() -> None:
    laws: dict[float, Echo] = {}
    family = ToldDesigns(lambda delay: laws.setdefault(delay, Echo(delay)))
    family.reset(5, 7)
    family.tell(np.array([0.3, 0.1, 0.3, 0.0, 0.1]))
    readings = 10.0 * np.arange(5.0)[:, None]
    expected = np.array([0.3, 10.1, 20.3, 30.0, 40.1])
    np.testing.assert_allclose(family.act(readings), expected[:, None] * [1, 1], rtol=1e-15)
    assert {d: law.started for d, law in laws.items()} == {
        0.0: [(1, 7)],
        0.1: [(2, 7)],
        0.3: [(2, 7)],
    }


def test_a_family_has_the_attributes_of_its_laws_and_only_those() -> None:
    family = ToldDesigns(Echo)
    assert getattr(family, "measures", None) == ("carbody_lateral",)
    assert getattr(family, "action_scale", None) == 5.0
    assert not hasattr(family, "layout")
    assert not hasattr(family, "damper")
    semi_active = ToldDesigns(lambda d: make_controller(f"clipped-lqg:delay={d!r}"))
    assert hasattr(semi_active, "damper")


def test_a_family_that_is_not_told_says_so() -> None:
    family = ToldDesigns(Echo)
    family.reset(2, 0)
    with pytest.raises(ArgumentError, match="call tell after reset"):
        family.act(np.zeros((2, 1)))


def test_a_family_is_told_anew_after_every_reset() -> None:
    family = ToldDesigns(Echo)
    family.reset(1, 0)
    family.tell(np.array([0.2]))
    family.reset(3, 0)
    with pytest.raises(ArgumentError, match="call tell after reset"):
        family.act(np.zeros((3, 1)))


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.123456789012345])
def test_a_spec_with_a_delay_in_it_makes_the_law_of_that_delay_to_the_last_bit(
    delay: float,
) -> None:
    place = Scenario.of("v0/lateral17/nominal/4/300/german_low/constant:0/0").place
    family = controller_for(f"lqg-delay:delay={PLACE}", place)
    assert isinstance(family, ToldDesigns)
    alone = make_controller(f"lqg-delay:delay={delay!r}", "4")
    family.reset(3, 0)
    family.tell(np.full(3, delay))
    alone.reset(3, 0)
    rng = np.random.default_rng(0)
    measured = len(getattr(alone, "measures", ())) or 8
    for _ in range(30):
        readings = rng.normal(size=(3, measured))
        np.testing.assert_array_equal(family.act(readings), alone.act(readings))


def test_a_delay_is_designed_for_once_and_its_law_started_anew() -> None:
    delays: list[float] = []

    def made(delay: float) -> Echo:
        delays.append(delay)
        return Echo(delay)

    family = ToldDesigns(made)
    for seed in (3, 4):
        family.reset(2, seed)
        family.tell(np.array([0.1, 0.0]))
    assert delays == [0.0, 0.1]
    law = family.law_at(0.1)
    assert isinstance(law, Echo)
    assert law.started == [(1, 3), (1, 4)]


def test_a_second_run_of_a_family_is_the_first_one_again() -> None:
    family = ToldDesigns(lambda d: make_controller(f"lqg-delay:delay={d!r}"))
    readings = np.random.default_rng(0).normal(size=(20, 2, 64))
    runs = []
    for _ in range(2):
        family.reset(2, 0)
        family.tell(np.array([0.1, 0.2]))
        runs.append([family.act(one) for one in readings])
    np.testing.assert_array_equal(*runs)


def test_a_family_is_as_linear_as_its_laws() -> None:
    assert is_linear(ToldDesigns(lambda d: make_controller(f"lqg-delay:delay={d!r}")))
    assert not is_linear(ToldDesigns(lambda d: make_controller(f"clipped-lqg:delay={d!r}")))
