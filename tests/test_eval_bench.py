"""`railenv bench-speed` and its yardstick: what is timed and printed, never how long it took."""

import json
import sys

import numpy as np
import pytest
from scipy.special import lambertw

from eval import bench, command_bench
from eval.bench import Entry, measure, measure_section, table, timed_section
from eval.bench_oracle import OracleQuestions, oracle_entries
from eval.cli import main
from eval.generic_delay import (
    generator_matrix,
    generic_critical_delays,
    generic_roots,
    generic_unstable,
)
from railenv.errors import ArgumentError, NeutralLoopError
from railenv.stability import DelaySystem, count_unstable, critical_delays, rightmost_roots


def oscillator() -> DelaySystem:
    """x'' + 0.6 x' + (2 pi 1.2)^2 x = -4 x'(t - tau); 176.1 ms is critical."""
    return DelaySystem(
        [[0.0, 1.0], [-((2 * np.pi * 1.2) ** 2), -0.6]], [[0.0], [1.0]], [[0.0, 4.0]]
    )


def two_channels() -> DelaySystem:
    """Two masses of their own gain, coupled, with one actuator each."""
    A = [[0, 0, 1, 0], [0, 0, 0, 1], [-60, 20, -0.6, 0.1], [20, -50, 0.1, -0.5]]
    return DelaySystem(
        A, [[0, 0], [0, 0], [1, 0], [0, 1]], [[0.0, 0.0, 3.0, 0.5], [0.0, 0.0, 0.3, 2.0]]
    )


SMALL = OracleQuestions(
    oscillator,
    max_delay=0.3,
    bracket=(0.16, 0.19),
    stable=(0.0, 0.17),
    unstable=0.2,
    box=0.15,
    step=0.05,
    corners=2,
)


def small_section() -> list[Entry]:
    return oracle_entries(SMALL)


@pytest.fixture
def small(monkeypatch: pytest.MonkeyPatch) -> None:
    """The command with one section, and a loop of two states in place of the vehicle."""
    only = {"oracle": lambda: timed_section(small_section())}
    monkeypatch.setattr(command_bench, "SECTIONS", only)


def test_the_generator_has_lamberts_roots() -> None:
    # s = W_k(-tau) / tau solves s + exp(-s tau) = 0
    exact = sorted((lambertw(-0.7, k) / 0.7 for k in range(3)), key=lambda s: -s.real)
    system = DelaySystem([[0.0]], [[1.0]], [[1.0]])
    np.testing.assert_allclose(generic_roots(system, 0.7, 3, 30), exact, rtol=1e-9)


@pytest.mark.parametrize("delay", [0.1, [0.05, 0.2], [0.0, 0.3], [0.2, 0.2]])
def test_the_generator_has_the_oracles_roots(delay: float | list[float]) -> None:
    ours = [mode.root for mode in rightmost_roots(two_channels(), delay, 4)]
    # spectral accuracy: at rounding for |s| tau of a few
    np.testing.assert_allclose(generic_roots(two_channels(), delay, 4, 20), ours, rtol=1e-9)


def test_the_error_of_the_generator_falls_faster_than_any_power() -> None:
    exact = rightmost_roots(oscillator(), 0.2, 1)[0].root
    errors = [abs(generic_roots(oscillator(), 0.2, 1, N)[0] - exact) for N in (4, 6, 8, 10)]
    ratios = np.array(errors[:-1]) / np.array(errors[1:])
    assert np.all(ratios > 30.0)
    assert ratios[1] > ratios[0]


def test_the_generator_takes_the_whole_history() -> None:
    assert generator_matrix(two_channels(), [0.1, 0.2], 5).shape == (4 * 6, 4 * 6)
    np.testing.assert_array_equal(
        generator_matrix(two_channels(), 0.0, 5), two_channels().undelayed
    )


def test_the_generator_is_refused_for_a_neutral_loop() -> None:
    neutral = DelaySystem([[-1.0]], [[1.0]], [[1.0]], [[0.5]])
    with pytest.raises(NeutralLoopError, match="generic"):
        generator_matrix(neutral, 0.1)


def test_the_scan_finds_the_oracles_critical_delays() -> None:
    found = generic_critical_delays(oscillator(), 0.9, 0.05, 16, 1e-9)
    expected = [crossing.delay for crossing in critical_delays(oscillator(), 0.9).crossings]
    # half the width at which bisection stops
    assert found == pytest.approx(expected, abs=1e-9)
    assert len(found) == 3


@pytest.mark.parametrize("delay", [0.1, 0.2, 0.79, 0.85])
def test_the_generic_count_is_the_oracles(delay: float) -> None:
    assert generic_unstable(oscillator(), delay, 24) == count_unstable(oscillator(), delay)


@pytest.mark.parametrize(
    ("given", "name"),
    [
        ({"max_delay": 0.0}, "max_delay"),
        ({"max_delay": 1.0, "step": -1.0}, "step"),
        ({"max_delay": 1.0, "tolerance": 0.1}, "tolerance"),
        ({"max_delay": 1.0, "nodes": 0}, "nodes"),
    ],
)
def test_a_search_that_cannot_end_is_refused(given: dict[str, float], name: str) -> None:
    with pytest.raises(ArgumentError, match=name):
        generic_critical_delays(oscillator(), **given)  # type: ignore[arg-type]


def test_every_method_gives_the_same_answer() -> None:
    rows = measure_section(small_section(), 1)
    by_task: dict[str, list[str]] = {}
    for row in rows:
        by_task.setdefault(row["task"], []).append(row["answer"])
    crossings, roots, interval, fixed, box = by_task.values()
    assert len(set(crossings)) == len(set(roots)) == 1
    assert "first at 176.1" in crossings[0]
    assert [answer.split()[-3:-1] for answer in fixed] == [["2", "unstable"]] * 2
    for ours, generic in (interval, box):
        assert ours.startswith("STABLE")
        assert generic == "stable there, 0 unstable roots"


def test_only_certificates_are_called_proved() -> None:
    for row in measure_section(small_section(), 1):
        if row["method"] == "railenv, certify":
            assert row["proved"]
        elif not row["method"].startswith("railenv"):
            assert not row["proved"]


def test_every_run_gets_a_loop_of_its_own() -> None:
    made: list[object] = []

    def prepare() -> object:
        made.append(object())
        return made[-1]

    given: list[object] = []

    def run(value: object) -> tuple[str, bool]:
        given.append(value)
        return "done", False

    row = measure(Entry("task", "method", prepare, run), 3)
    # the first run was short and is thrown away as start-up
    assert row["runs"] == 3
    assert given == made
    assert len(set(map(id, made))) == 4


def test_a_long_entry_is_not_repeated(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "START_UP", 0.0)
    monkeypatch.setattr(bench, "LONG_ENOUGH", 0.0)
    assert measure(Entry("task", "method", lambda: None, lambda _: ("done", False)), 9)["runs"] == 1


def test_ratios_are_multiples_of_the_tasks_first_entry() -> None:
    def entry(task: str, method: str) -> Entry:
        return Entry(task, method, lambda: None, lambda _: ("done", False))

    rows = measure_section([entry("a", "ours"), entry("a", "other"), entry("b", "ours")], 2)
    assert [row["ratio"] for row in rows] == [1.0, rows[1]["best_s"] / rows[0]["best_s"], 1.0]


@pytest.mark.usefixtures("small")
def test_json_is_one_object_with_every_number(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench-speed", "--only", "oracle", "--repeat", "1", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    rows = answer["sections"]["oracle"]
    assert len({row["task"] for row in rows}) == 5
    for row in rows:
        assert row["best_s"] <= row["median_s"]
        assert row["runs"] == 1
        assert row["ratio"] > 0.0
    assert {"python", "platform", "packages"} <= set(answer["provenance"])


@pytest.mark.usefixtures("small")
def test_the_table_says_what_proves_nothing(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench-speed", "--repeat", "1"]) == 0
    out = capsys.readouterr().out
    assert out.count("proves nothing") == 3
    assert "all crossings up to 300 ms" in out


def test_without_peers_their_rows_are_left_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "tdcpy", None)
    assert not [entry for entry in small_section() if "tdcpy" in entry.method]


def test_entries_of_one_task_stand_together_in_the_table() -> None:
    rows = [
        {
            "task": task,
            "method": method,
            "best_s": 0.5,
            "median_s": 2.0,
            "runs": 3,
            "answer": "done",
            "proved": False,
            "note": "",
            "ratio": 1.0,
        }
        for task in ("first", "second")
        for method in ("ours", "other")
    ]
    lines = table(rows)
    words = [line.split()[0] for line in lines]
    assert words == ["best", "first", "ours", "other", "second", "ours", "other"]
    assert lines[2].split() == ["ours", "500", "ms", "2", "s", "3", "1", "no", "done"]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--only", "orakel"], "oracle"),
        (["--repeat", "0"], "repeat"),
        (["--repeat", "x"], "repeat"),
    ],
)
def test_bad_arguments_are_one_line(
    capsys: pytest.CaptureFixture[str], arguments: list[str], words: str
) -> None:
    assert main(["bench-speed", *arguments]) == 2
    line = capsys.readouterr().err
    assert words in line
    assert line.count("\n") == 1
