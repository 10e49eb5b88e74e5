"""A benchmark's run: same rows on any workers, what is resumed, what a broken controller costs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmark_examples import (
    BROKEN,
    LIMITS,
    SHORT,
    SUITE,
    Ends,
    benchmark_of,
    block,
    cells,
    run,
    suite_of,
)
from policy_examples import linear

from baselines import make_controller
from baselines.policies.folder import save_trained
from eval import benchmark as benchmark_module
from eval.benchmark import missing, open_store, run_benchmark, run_work
from eval.benchmark_stability import StabilityWork, stability_answer
from eval.cells import CellWork
from eval.store.digest import digest
from eval.store.reader import Reader
from eval.workers import InlinePool, Limits, LocalPool
from railenv.errors import ArgumentError, InputFileError, OutputError

SPEC = "skyhook:gain=15e3"
TWO = benchmark_of(SPEC, "zero")


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(tmp_path_factory.mktemp("whole"), TWO)


class Interrupted(InlinePool):
    """Ends with Ctrl-C after some outcomes."""

    def __init__(self, after: int) -> None:
        self.after = after

    def run(self, function: Any, tasks: Any) -> Any:
        for number, outcome in enumerate(super().run(function, tasks)):
            if number == self.after:
                raise KeyboardInterrupt
            yield outcome


def test_every_controller_has_a_row_for_every_scenario(whole: Path) -> None:
    keys = sorted(s.key for s in SUITE.scenarios)
    for spec in (SPEC, "zero"):
        assert [row["key"] for row in cells(whole, controller=spec)] == keys
    # Passive and reference run without delay: two seeds at 300 km/h, one at 250 km/h.
    for spec in ("passive", "reference"):
        rows = cells(whole, controller=spec)
        assert len(rows) == 3
        assert {(row["channel"], row["delay_s"]) for row in rows} == {("constant", 0.0)}


def test_passive_and_reference_are_run_once_however_often_they_are_named() -> None:
    assert [e.spec for e in benchmark_of("passive", "zero").everyone()] == [
        "passive",
        "reference",
        "zero",
    ]


def test_the_nonlinear_vehicles_packages_come_first() -> None:
    suite = suite_of(block(), block(models=("full50",)))
    models = [p.scenarios[0].model for p in benchmark_of("zero", suite=suite).packages]
    assert models == ["full50"] * 3 + ["lateral17"] * 3


def test_a_second_run_gives_the_same_rows_bit_for_bit(whole: Path, tmp_path: Path) -> None:
    assert digest(run(tmp_path, TWO)) == digest(whole)


def test_the_order_in_which_packages_are_done_does_not_matter(
    whole: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(benchmark_module, "missing", lambda *asked: list(reversed(missing(*asked))))
    assert digest(run(tmp_path, TWO)) == digest(whole)


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2, 4])
def test_any_number_of_workers_gives_the_same_rows(whole: Path, tmp_path: Path, jobs: int) -> None:
    with LocalPool(jobs, LIMITS) as pool:
        assert digest(run(tmp_path, TWO, pool)) == digest(whole)


@pytest.mark.slow
def test_workers_give_the_nonlinear_vehicles_rows_too(tmp_path: Path) -> None:
    suite = suite_of(block(models=("full50",), delays_ms=(0.0, 50.0, 100.0), seeds=2))
    wanted = benchmark_of(SPEC, "apg-linear", suite=suite)
    with LocalPool(2, LIMITS) as pool:
        assert digest(run(tmp_path / "a", wanted, pool)) == digest(run(tmp_path / "b", wanted))


@pytest.mark.parametrize(
    "after",
    [3, *(pytest.param(number, marks=pytest.mark.slow) for number in (0, 7, 10))],
)
def test_an_interrupted_run_goes_on_where_it_stopped(
    whole: Path, tmp_path: Path, after: int
) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, TWO, Interrupted(after))
    with open_store(TWO, tmp_path, resume=True) as store:
        before = store.done()
    assert len(before) == min(after, 8)
    asked: list[object] = []

    class Counts(InlinePool):
        def run(self, function: Any, tasks: Any) -> Any:
            for outcome in super().run(function, tasks):
                asked.append(outcome.task)
                yield outcome

    run(tmp_path, TWO, Counts(), resume=True)
    packages = [t.package for t in asked if isinstance(t, CellWork)]
    assert not before & {(p.controller, p.name) for p in packages}
    # Eight packages, and three questions each on stability and motion: none on the reference.
    assert len(asked) == 14 - after
    assert digest(tmp_path) == digest(whole)


def test_a_finished_run_has_nothing_to_resume(whole: Path) -> None:
    with open_store(TWO, whole, resume=True) as store:
        assert missing(TWO, store) == []


def test_a_controller_can_be_added_to_a_run(tmp_path: Path) -> None:
    first, both = (benchmark_of(*specs, suite=SHORT) for specs in (("zero",), ("zero", SPEC)))
    grown = run(tmp_path / "grown", first)
    with pytest.raises(ArgumentError, match="--resume, or give another folder by --out"):
        run(grown, both)
    run(grown, both, resume=True)
    assert digest(grown) == digest(run(tmp_path / "once", both))


SALT, OTHER_SALT = "sixteen characters or more", "another sixteen characters"


@pytest.mark.parametrize(
    ("changes", "name"),
    [
        ({"suite": suite_of(block(delays_ms=(50.0,)))}, "blocks"),
        ({"suite": suite_of(*SUITE.blocks, sensor_noise=0.2)}, "sensor_noise"),
        ({"suite": suite_of(*SUITE.blocks, skip=2.0)}, "skip"),
        ({"suite": suite_of(*SUITE.blocks, version="v1")}, "version"),
        ({"limits": Limits(61.0, LIMITS.memory_bytes)}, "limits.seconds"),
        ({"limits": Limits(60.0, 2**30)}, "limits.memory_bytes"),
        ({"salt": OTHER_SALT}, "salt_commitment"),
        ({"salt": ""}, "salt_commitment"),
    ],
    ids=str,
)
def test_a_run_is_resumed_with_its_own_settings_alone(
    tmp_path: Path, changes: dict[str, Any], name: str
) -> None:
    mine = {"suite": SUITE, "limits": LIMITS, "salt": SALT}
    with open_store(benchmark_of("zero", **mine), tmp_path, resume=False):
        pass
    with pytest.raises(ArgumentError, match=rf"{name}.*--out"):
        open_store(benchmark_of("zero", **{**mine, **changes}), tmp_path, resume=True)
    with open_store(benchmark_of("zero", **mine), tmp_path, resume=True):
        pass


def test_a_policy_that_was_changed_is_refused(tmp_path: Path) -> None:
    save_trained(linear(0), tmp_path / "policy")
    spec = str(tmp_path / "policy")
    (entry,) = benchmark_of(spec, suite=SHORT).entries
    assert entry.sha256 is not None
    folder = run(tmp_path / "run", benchmark_of(spec, suite=SHORT), Ends(spec, "failed"))
    run(folder, benchmark_of(spec, suite=SHORT), Ends(spec, "failed"), resume=True)
    for path in (tmp_path / "policy").iterdir():
        path.unlink()
    save_trained(linear(1), tmp_path / "policy")
    changed = benchmark_of(spec, suite=SHORT)
    with pytest.raises(ArgumentError, match=r"is not the one.*sha256 was .* --out"):
        run(folder, changed, Ends(spec, "failed"), resume=True)


def test_a_folder_without_records_cannot_be_resumed(tmp_path: Path) -> None:
    with pytest.raises(InputFileError, match="does not exist"):
        open_store(TWO, tmp_path / "none", resume=True)


def test_a_folder_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        open_store(TWO, tmp_path / "file" / "sub", resume=False)


def test_the_records_hold_the_hash_of_the_salt_and_not_the_salt(tmp_path: Path) -> None:
    benchmark = benchmark_of("zero", suite=SHORT, salt=SALT)
    folder = run(tmp_path / "private", benchmark)
    public = run(tmp_path / "public", benchmark_of("zero", suite=SHORT))
    with Reader.open(folder) as reader:
        # sha256sum of the salt, worked out elsewhere
        assert reader.settings.salt_commitment == (
            "f576a013951a50fe457b4ff693adeb1670ac44c60e11c65156541d361fefe487"
        )
    files = [path.read_bytes() for path in folder.iterdir() if path.is_file()]
    assert not any(SALT.encode() in content for content in files)
    own, others = (
        {row["key"]: row["ride_index_rear"] for row in cells(place)} for place in (folder, public)
    )
    assert own.keys() == others.keys()
    assert not set(own.values()) & set(others.values())


def test_progress_counts_every_cell_once(tmp_path: Path) -> None:
    told: list[tuple[str, int]] = []
    wanted = benchmark_of("zero", f"{BROKEN}Raises", suite=SHORT)
    with open_store(wanted, tmp_path, resume=False) as store:
        run_benchmark(wanted, store, InlinePool(), "test", lambda *done: told.append(done))
    assert sorted(told) == sorted(
        [("passive", 2), ("reference", 2), ("zero", 4), (f"{BROKEN}Raises", 4)]
    )


def test_a_session_says_how_the_program_was_called(whole: Path) -> None:
    with Reader.open(whole) as reader:
        (session,) = reader.sessions()
    assert session["command"] == "railenv benchmark"
    assert session["ended"] is not None


def test_a_controller_for_one_layout_has_rows_on_that_alone(tmp_path: Path) -> None:
    suite = suite_of(block(layouts=("2", "4")))
    folder = run(tmp_path, benchmark_of("apg-linear", suite=suite), Ends("apg-linear", "failed"))
    assert {row["layout"] for row in cells(folder, controller="apg-linear")} == {"4"}
    with Reader.open(folder) as reader:
        places = {(r["controller"], r["layout"]) for r in reader.stability()}
    assert places == {("passive", "2"), ("passive", "4"), ("apg-linear", "4")}


def test_work_is_done_by_its_kind() -> None:
    question = StabilityWork("passive", "2")
    assert run_work(question) == stability_answer(question)
    assert question.place == ("passive", "2", "nominal", 300.0)


def test_numbers_are_those_of_the_controller_by_name(whole: Path) -> None:
    idle = cells(whole, controller="zero")
    assert {row["force_rms"] for row in idle} == {0.0}
    assert np.all([row["force_rms"] > 100.0 for row in cells(whole, controller=SPEC)])
    assert make_controller("zero").act(np.zeros((2, 0))).shape == (2, 4)
