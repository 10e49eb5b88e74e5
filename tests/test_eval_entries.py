"""Who takes part in a benchmark, what is known of it beforehand, and its packages."""

import hashlib
from pathlib import Path

import pytest

from baselines.policies.folder import POLICY_FILE
from baselines.policies.shipped import shipped_folder, shipped_names
from eval.entries import SHIPPED, Entry, entries_of, entry_of
from eval.packages import PASSIVE, REFERENCE, packages_of, reference_scenario, references_of
from eval.scenarios import load_suite
from eval.workers import InlinePool, Limits, LocalPool
from railenv.errors import ArgumentError, InputFileError

QUICK = load_suite("quick")

MODULE = """
class Law:
    layout = {layout}
    def reset(self, num_lanes, seed):
        pass
    def act(self, observations):
        return observations[:, :4]

class Told(Law):
    def tell(self, delays):
        pass

class Four(Law):
    layout = "4"

def either(layout):
    law = Law()
    law.layout = layout
    return law

def broken():
    raise RuntimeError("no")

def ends():
    import os
    os._exit(3)
"""


@pytest.fixture
def module(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> str:
    """A module of the user's own, importable here and in workers."""
    (tmp_path / "entry_laws.py").write_text(MODULE.replace("{layout}", "None"))
    monkeypatch.syspath_prepend(str(tmp_path))
    monkeypatch.setenv("PYTHONPATH", str(tmp_path), prepend=":")
    monkeypatch.delitem(__import__("sys").modules, "entry_laws", raising=False)
    return "py:entry_laws"


# Entries.


@pytest.mark.parametrize(
    ("spec", "division"),
    [
        ("passive", "untold"),
        ("skyhook:gain=15e3", "untold"),
        ("lqg-delay:delay=0.1", "untold"),  # designed for one delay, whatever it meets
        ("lqg-delay:delay={delay}", "told"),
        ("skyhook-lead:delay={delay},gain=20e3", "told"),
        ("apg-linear", "told"),
        ("apg-hidden", "untold"),
    ],
)
def test_the_division_is_whether_the_delay_is_known(spec: str, division: str) -> None:
    assert entry_of(spec).division == division


def test_shipped_stands_for_all_policies_and_nobody_enters_twice() -> None:
    found = entries_of(["skyhook", SHIPPED, "apg-linear", "skyhook"])
    assert [entry.spec for entry in found] == ["skyhook", *shipped_names()]


def test_a_shipped_policy_has_its_own_layout_and_the_hash_of_its_file() -> None:
    entry = entry_of("apg-linear")
    assert entry.layout == "4"
    policy = (shipped_folder() / "apg-linear" / POLICY_FILE).read_bytes()
    assert entry.sha256 == hashlib.sha256(policy).hexdigest()
    assert entry_of("skyhook").sha256 is None


def test_a_law_of_this_project_takes_either_layout() -> None:
    assert entry_of("skyhook").layout is None
    assert entry_of("passive").layout is None


def test_semi_active_dampers_are_run_on_the_linear_vehicle_alone() -> None:
    # The nonlinear one has none: that they do not run there is not their failure.
    for spec in ("semiactive-skyhook", "clipped-lqg:delay={delay}"):
        entry = entry_of(spec)
        assert entry.models == ("lateral17",)
        found = [*packages_of(QUICK, spec, entry.layout, entry.models)]
        assert {s.model for package in found for s in package.scenarios} == {"lateral17"}
    assert entry_of("skyhook").models is None


def test_feedback_of_states_that_the_nonlinear_vehicle_lacks_is_run_on_the_linear_one_alone() -> (
    None
):
    # The nodes of the yaw dampers' springs.
    assert entry_of("lqr").models == ("lateral17",)
    # These are states too, and the nonlinear vehicle has them.
    assert entry_of("relative").models is None


def test_the_reference_cannot_be_entered() -> None:
    with pytest.raises(ArgumentError, match="run with every benchmark"):
        entry_of(REFERENCE)


@pytest.mark.parametrize(
    "spec",
    [
        "{delay}",
        "skyhook:gain={delay}",
        "lqg-delay:dealy={delay}",
        "lqg-delay:delay={delay}{delay}",
        "lqg-delay:delay=0.0{delay}",
        "lqg-delay:delay={delay},delay={delay}",
        "py:mine:law{delay}",
    ],
)
def test_the_delays_place_is_the_whole_value_of_a_parameter_called_delay(spec: str) -> None:
    with pytest.raises(ArgumentError) as found:
        entry_of(spec)
    # The SPEC is said as it was typed, and how it should be.
    assert f"controller {spec!r}: " in str(found.value)
    assert "as in lqg-delay:delay={delay}" in str(found.value)


@pytest.mark.parametrize("spec", ["zero:", "passive:", "skyhook:"])
def test_a_colon_with_nothing_behind_is_refused_so_that_a_law_has_one_name(spec: str) -> None:
    with pytest.raises(ArgumentError, match=f"write '{spec[:-1]}'"):
        entry_of(spec)


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("skyhok", "did you mean"),
        ("skyhook:gian=1", "did you mean 'gain'"),
        ("lqg-delay:dealy=0.1", "did you mean 'delay'"),
        ("py:nowhere_at_all:law", "was not found"),
        ("py:", "py:module:function"),
        ("missing.npz", "missing.npz"),
    ],
)
def test_a_spec_that_is_not_understood_is_an_error(spec: str, words: str) -> None:
    with pytest.raises((ArgumentError, InputFileError), match=words):
        entries_of([spec])
    with pytest.raises((ArgumentError, InputFileError), match=words):
        entries_of([spec], InlinePool())


def test_a_controller_of_ones_own_enters_with_the_hash_of_its_module(module: str) -> None:
    (entry,) = entries_of([f"{module}:Law"])
    assert (entry.division, entry.layout) == ("untold", None)
    source = MODULE.replace("{layout}", "None").encode()
    assert entry.sha256 == hashlib.sha256(source).hexdigest()
    assert entry_of(f"{module}:Told").division == "told"


def test_a_controller_of_ones_own_has_a_layout_only_if_it_is_always_that_one(module: str) -> None:
    assert entry_of(f"{module}:Four").layout == "4"
    assert entry_of(f"{module}:either").layout is None


def test_a_controller_that_cannot_be_made_is_an_entry_whose_result_is_that(module: str) -> None:
    assert entry_of(f"{module}:broken").division == "untold"


def test_entries_made_in_workers_are_the_same(module: str) -> None:
    specs = ["skyhook", f"{module}:Told", "lqg-delay:delay={delay}", f"{module}:Four"]
    assert entries_of(specs, InlinePool()) == entries_of(specs)


@pytest.mark.slow
def test_a_module_that_ends_its_process_ends_a_worker(module: str) -> None:
    spec = f"{module}:ends"
    with LocalPool(1, Limits(seconds=60.0)) as pool:
        assert entries_of(["skyhook", spec], pool) == [
            entry_of("skyhook"),
            Entry(spec, "untold", None),
        ]


# Packages.


def test_packages_hold_every_scenario_once_and_share_a_place() -> None:
    found = [*packages_of(QUICK, "skyhook")]
    scenarios = [s for package in found for s in package.scenarios]
    assert sorted(s.key for s in scenarios) == sorted(s.key for s in QUICK.scenarios)
    assert all(len({s.place for s in package.scenarios}) == 1 for package in found)
    assert len({package.name for package in found}) == len(found)


def test_packages_follow_from_the_suite_alone() -> None:
    one, other = ([p.scenarios for p in packages_of(QUICK, spec)] for spec in ("a", "b"))
    assert one == other


def test_a_layout_leaves_the_other_out() -> None:
    found = [s for p in packages_of(QUICK, "apg-linear", "4") for s in p.scenarios]
    assert found
    assert {s.layout for s in found} == {"4"}


def test_passive_and_reference_are_run_once_per_vehicle_and_track_without_delay() -> None:
    references = references_of(QUICK)
    assert {(s.channel.key) for s in references} == {"constant:0"}
    assert {reference_scenario(s) for s in QUICK.scenarios} == {*references}
    assert len({*references}) == len(references)
    for spec in (PASSIVE, REFERENCE):
        found = [s for p in packages_of(QUICK, spec) for s in p.scenarios]
        assert sorted(s.key for s in found) == sorted(s.key for s in references)
