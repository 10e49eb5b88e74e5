"""A benchmark's run: same rows on any workers, what is resumed, what a broken controller costs."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from benchmark_examples import BROKEN, LIMITS, SUITE, benchmark_of, block, cells, run, suite_of
from broken_controllers import Law
from policy_examples import linear

from baselines import SkyHook, make_controller
from baselines.policies.folder import save_trained
from eval import benchmark as benchmark_module
from eval.benchmark import GIVE_UP, Benchmark, missing, open_store, run_benchmark, run_work
from eval.benchmark_stability import StabilityWork, design_answer, stability_answer
from eval.cells import CellWork
from eval.entries import Entry
from eval.policy_score_oracle import stable_windows
from eval.store.digest import digest
from eval.store.reader import Reader
from eval.told_designs import ToldDesigns
from eval.workers import InlinePool, Limits, LocalPool, Outcome
from railenv.errors import ArgumentError, InputFileError, OutputError
from railenv.stability import critical_delays
from railenv.vehicle import lateral17

SPEC = "skyhook:gain=15e3"
TWO = benchmark_of(SPEC, "zero")
SHORT = suite_of(block(delays_ms=(0.0, 100.0), seeds=2))
WIDE = benchmark_of(
    SPEC,
    "zero",
    suite=suite_of(block(delays_ms=(0.0, 100.0), speeds_kmh=(200.0, 250.0, 300.0, 350.0))),
)
"""Four packages of two scenarios per controller."""


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return run(tmp_path_factory.mktemp("whole"), TWO)


def ended(folder: Path) -> dict[str, list[str]]:
    """How the cells of every controller ended."""
    found: dict[str, list[str]] = {}
    for row in cells(folder):
        found.setdefault(row["controller"], []).append(row["status"])
    return found


class Interrupted(InlinePool):
    """Ends with Ctrl-C after some outcomes."""

    def __init__(self, after: int) -> None:
        self.after = after

    def run(self, function: Any, tasks: Any) -> Any:
        for number, outcome in enumerate(super().run(function, tasks)):
            if number == self.after:
                raise KeyboardInterrupt
            yield outcome


class Ends(InlinePool):
    """Does nothing: lets every task of one controller end in some way, and others in failure."""

    def __init__(self, spec: str, status: str, stop_at: int | None = None) -> None:
        self.spec, self.status, self.asked, self.stop_at = spec, status, 0, stop_at

    def run(self, function: Any, tasks: Any) -> Any:
        for task in tasks:
            spec = task.package.controller if isinstance(task, CellWork) else task.controller
            self.asked += spec == self.spec
            if self.asked == self.stop_at:
                raise KeyboardInterrupt
            status: Any = self.status if spec == self.spec else "failed"
            yield Outcome(task, status, None, "stopped", 1.0)


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


@pytest.mark.parametrize("after", [0, 3, 7, 10])
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
    # Eight packages, and three questions on stability: none on the reference.
    assert len(asked) == 11 - after
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


FAILURES = {
    "Raises": "the controller's act raised RuntimeError: gave up",
    "RaisesInReset": "the controller's reset raised RuntimeError: not today",
    "RaisesLate": "the controller's act raised ZeroDivisionError: late",
    "Nan": "act returned a value that is not finite",
    "WrongShape": "act returned shape (4,); it must be (4, 4): (lanes, channels)",
    "Complex": "the controller's act raised TypeError: actions of type complex128",
    "BeyondColumns": "act returned shape (4, 0); it must be (4, 4)",
    "OnlyTwo": "act returned shape (4, 2); it must be (4, 4)",
    "nothing": "returned NoneType; a controller needs",
    "not_made": "raised RuntimeError: no licence",
}


def test_what_a_broken_controller_does_is_said_and_costs_its_own_rows_alone(
    tmp_path: Path,
) -> None:
    specs = [f"{BROKEN}{name}" for name in FAILURES]
    folder = run(tmp_path, benchmark_of(*specs, "zero", suite=SHORT))
    statuses = ended(folder)
    assert statuses.pop("zero") == ["ok"] * 4
    assert statuses.pop("passive") == statuses.pop("reference") == ["ok"] * 2
    assert statuses == {spec: ["failed"] * 4 for spec in specs}
    for name, words in FAILURES.items():
        rows = cells(folder, controller=f"{BROKEN}{name}")
        assert all(words in row["message"] for row in rows), rows[0]["message"]
        assert {row["ride_index_rear"] for row in rows} == {None}
    with Reader.open(folder) as reader:
        answers = {row["controller"]: row["answer"] for row in reader.stability()}
    assert all("error" in answers[spec] for spec in specs)


@pytest.mark.parametrize("status", ["timeout", "memory"])
def test_a_controller_that_hangs_in_three_packages_is_left_out_of_the_rest(
    tmp_path: Path, status: str
) -> None:
    assert GIVE_UP == 3
    pool = Ends("zero", status)
    told: list[tuple[str, int]] = []
    with open_store(WIDE, tmp_path, resume=False) as store:
        run_benchmark(WIDE, store, pool, "test", lambda *done: told.append(done))
    assert pool.asked == 3
    rows = cells(tmp_path, controller="zero")
    # As a word for all, so that the number of workers makes no difference.
    assert {row["status"] for row in rows} == {status}
    left = [row for row in rows if row["message"].startswith("left out after 3 packages")]
    assert (len(rows), len(left)) == (8, 2)
    assert ended(tmp_path)[SPEC] == ["failed"] * 8
    assert sum(number for _, number in told) == 8 + 8 + 4 + 4
    with Reader.open(tmp_path) as reader:
        (answer,) = (r["answer"] for r in reader.stability() if r["controller"] == "zero")
    assert answer == {"error": "left out"}


def test_what_an_earlier_session_lost_is_counted(tmp_path: Path) -> None:
    with pytest.raises(KeyboardInterrupt):
        run(tmp_path, WIDE, Ends("zero", "timeout", stop_at=3))
    pool = Ends("zero", "timeout")
    run(tmp_path, WIDE, pool, resume=True)
    assert pool.asked == 1
    assert ended(tmp_path)["zero"] == ["timeout"] * 8


@pytest.mark.parametrize("status", ["failed", "crashed"])
def test_what_costs_no_time_is_tried_to_the_end(tmp_path: Path, status: str) -> None:
    pool = Ends("zero", status)
    run(tmp_path, WIDE, pool)
    assert pool.asked == 4 + 1
    assert ended(tmp_path)["zero"] == [status] * 8


@pytest.mark.slow
@pytest.mark.parametrize("jobs", [1, 2])
def test_what_hangs_eats_or_exits_is_stopped_within_its_limits(tmp_path: Path, jobs: int) -> None:
    limits = Limits(8.0, 700 * 2**20)
    ends = {"Hangs": "timeout", "EatsMemory": "memory", "Exits": "crashed", "Raises": "failed"}
    specs = [f"{BROKEN}{name}" for name in ends]
    benchmark = benchmark_of(*specs, SPEC, suite=SHORT, limits=limits)
    with LocalPool(jobs, limits) as pool:
        run(tmp_path / "pool", benchmark, pool)
    statuses = ended(tmp_path / "pool")
    assert statuses[SPEC] == ["ok"] * 4
    for name, status in ends.items():
        assert statuses[f"{BROKEN}{name}"] == [status] * 4
    words = {row["status"]: row["message"] for row in cells(tmp_path / "pool")}
    assert words["timeout"] == "stopped after the time limit of 8 s"
    assert words["memory"] == "stopped above the memory limit of 700 MiB"
    assert words["crashed"] == "the worker process ended itself with exit code 3"
    alone = run(tmp_path / "alone", benchmark_of(SPEC, suite=SHORT))
    rows = {row["key"]: row for row in cells(alone, controller=SPEC)}
    assert rows == {row["key"]: row for row in cells(tmp_path / "pool", controller=SPEC)}


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


def test_a_sky_hooks_critical_delay_is_its_first_crossing() -> None:
    answer = stability_answer(StabilityWork("skyhook:gain=35e3", "4"))
    crossings = critical_delays(SkyHook(35e3, 4).to_delay_system(lateral17()), 2.0).crossings
    assert answer["method"] == "exact"
    assert answer["critical_delay_s"] == crossings[0].delay == pytest.approx(0.20203, abs=1e-5)
    assert answer["critical_delay_sampled_s"] == pytest.approx(0.19705, abs=1e-5)


def test_the_passive_vehicle_has_no_critical_delay() -> None:
    answer = stability_answer(StabilityWork("passive", "4"))
    assert (answer["critical_delay_s"], answer["longest_s"]) == (None, None)


def test_a_sampled_laws_windows_are_those_of_the_oracle(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[Any] = []

    def windows(*given: Any) -> dict[str, Any]:
        asked.append(given)
        return stable_windows(*given, longest=0.02)

    monkeypatch.setattr("eval.benchmark_stability.stable_windows", windows)
    answer = stability_answer(StabilityWork("lqg", "4"))
    assert answer == {"method": "sampled", **stable_windows(*asked[0], longest=0.02)}
    assert asked[0][1].layout == "4"


class Family:
    """Stands for designs that hold up to some delay, and notes which are asked."""

    def __init__(self, holds_up_to: float) -> None:
        self.limit, self.asked = holds_up_to, list[float]()

    def grows(self, _: Any, vehicle: Any, delay: float) -> bool:
        self.asked.append(delay)
        return delay > self.limit + 1e-9


@pytest.mark.parametrize(
    ("limit", "critical"),
    [
        (-1.0, 0.0),
        (0.0, 0.0),
        (0.07, 0.07),
        (0.099, 0.09),
        (0.55, 0.55),
        (0.594, 0.59),
        (0.7, None),
    ],
)
def test_designs_per_delay_are_bracketed_to_a_control_period(
    monkeypatch: pytest.MonkeyPatch, limit: float, critical: float | None
) -> None:
    family = Family(limit)
    monkeypatch.setattr("eval.benchmark_stability.grows", family.grows)
    designs = ToldDesigns(lambda _: Law())
    answer = design_answer(designs, lateral17(), 0.01)
    assert answer["critical_delay_s"] == (None if critical is None else pytest.approx(critical))
    assert answer["longest_s"] == pytest.approx(0.6)
    # Thirteen delays 50 ms apart, and three to halve five periods twice or so.
    assert len(family.asked) <= 13 + 3


@pytest.mark.slow
def test_a_lqg_that_is_designed_for_its_delay_holds_the_vehicle_at_every_delay() -> None:
    answer = stability_answer(StabilityWork("lqg-delay:delay={delay}", "4"))
    assert (answer["method"], answer["critical_delay_s"]) == ("sampled", None)
    assert answer["proved"] is False


@pytest.mark.slow
def test_a_law_that_is_not_linear_is_bracketed_by_simulation() -> None:
    answer = stability_answer(StabilityWork(f"{BROKEN}Law", "4"))
    assert answer["method"] == "simulation"
    low, high = answer["bracket_s"]
    loop = SkyHook(10e3, 4).to_sampled_loop(lateral17(), 0.01)
    # The same law, known to the oracle. A simulation cannot tell growth over hours from none: the
    # bracket is off by a few milliseconds.
    assert loop.growth_rate(low - 0.005) < 0.0 < loop.growth_rate(high + 0.005)


def test_work_is_done_by_its_kind() -> None:
    question = StabilityWork("passive", "2")
    assert run_work(question) == stability_answer(question)
    assert question.place == ("passive", "2", "nominal", 300.0)


def test_an_entry_that_was_never_made_fails_by_its_packages(tmp_path: Path) -> None:
    spec = f"{BROKEN}not_made"
    wanted = Benchmark(SHORT, (Entry(spec, "untold", None),), LIMITS)
    folder = run(tmp_path, wanted)
    assert ended(folder)[spec] == ["failed"] * 4


def test_numbers_are_those_of_the_controller_by_name(whole: Path) -> None:
    idle = cells(whole, controller="zero")
    assert {row["force_rms"] for row in idle} == {0.0}
    assert np.all([row["force_rms"] > 100.0 for row in cells(whole, controller=SPEC)])
    assert make_controller("zero").act(np.zeros((2, 0))).shape == (2, 4)
