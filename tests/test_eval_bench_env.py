"""Section `env` of `railenv bench-speed`: what is measured and printed, never how long it took."""

import json
import sys
import threading
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from eval import bench, bench_env, bench_ours, command_bench
from eval.bench import Row, Stepper, compare, missing_row, rate_row, rate_table, rates
from eval.bench_bare import SUBSTEPS, TIME_STEP, BareUpdate
from eval.bench_env import Sizes, env_section, env_table
from eval.cli import main
from railenv.vehicle import lateral17
from railenv.vehicle.statespace import state_space

TINY = Sizes((1, 4), (4, 6), 2, 4, (4, 6), (4,), (4,))
PACKAGES = ("envpool", "mujoco", "controlgym", "stable_baselines3")


@pytest.fixture(autouse=True, scope="module")
def _quick() -> Iterator[None]:
    """Windows and episodes as short as they can be; no peer is installed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(bench, "WINDOW", 0.005)
        patch.setitem(bench_ours.STANDARD, "episode_seconds", 0.1)
        for package in PACKAGES:
            patch.setitem(sys.modules, package, None)
        yield


@pytest.fixture(scope="module")
def measured() -> list[Row]:
    return env_section(TINY).measure(2, lambda _: None)


def of(rows: list[Row], task: str) -> list[Row]:
    return [row for row in rows if row["task"] == task]


def counted(lanes: int = 1) -> tuple[Stepper, list[int]]:
    calls: list[int] = []

    def step(call: int) -> int:
        calls.append(call)
        return lanes

    return Stepper(step), calls


def test_a_rate_is_steps_over_the_time_they_took(monkeypatch: pytest.MonkeyPatch) -> None:
    # a clock that a step moves on by 2 s, in windows of 5 s: three steps of 7 lanes in 6 s
    now = [0.0]
    monkeypatch.setattr(bench.time, "perf_counter", lambda: now[0])

    def step(_: int) -> int:
        now[0] += 2.0
        return 7

    assert rates(Stepper(step), 2, 5.0) == [3.5, 3.5]


def test_the_warm_up_is_in_no_window_and_calls_are_numbered() -> None:
    stepper, calls = counted()
    assert rates(stepper, 0) == []
    assert calls == list(range(bench.WARM_UP))
    rates(stepper, 1)
    assert calls[bench.WARM_UP :] == list(range(len(calls) - bench.WARM_UP))


@pytest.mark.parametrize("threads", [1, 2, 3])
def test_the_bare_update_is_what_its_note_says(threads: int) -> None:
    update = BareUpdate(7, threads)
    x, u = update.x.copy(), update.u.copy()
    assert "38 states and 12 inputs" in update.note
    assert f"{SUBSTEPS} substeps" in update.note
    assert x.dtype == u.dtype == np.float64
    system = state_space(lateral17("paper_fit", 4, 300.0))
    block = np.zeros((50, 50))
    block[:38, :38], block[:38, 38:] = system.A, system.B[:, :12]
    both = linalg.expm(block * TIME_STEP)
    for _ in range(3):
        assert update.step() == 7
        for lane in range(7):
            for _ in range(2):
                x[lane] = both[:38, :38] @ x[lane] + both[:38, 38:] @ u[lane]
    update.close()
    # rounding of sums of 50 products
    np.testing.assert_allclose(update.x, x, rtol=1e-9, atol=1e-12 * np.abs(x).max())


def test_the_threads_of_the_bare_update_share_its_rows(monkeypatch: pytest.MonkeyPatch) -> None:
    update = BareUpdate(7, 3)
    seen: list[tuple[int, int]] = []
    monkeypatch.setattr(update, "_part", lambda first, end: seen.append((first, end)))
    update.step()
    update.close()
    assert sorted(seen) == [(0, 2), (2, 4), (4, 7)]


@pytest.mark.slow
def test_every_part_of_the_section_is_measured(measured: list[Row]) -> None:
    shown = {
        task: [(row.get("lanes"), row.get("threads")) for row in of(measured, task)]
        for task in bench_env._ORDER
    }
    assert shown[bench_env.ONE_CORE] == [(1, 1), (4, 1)]
    assert shown[bench_env.ALL_CORES] == [(4, 2), (6, 2)]
    best = max(of(measured, bench_env.ALL_CORES), key=lambda row: row["median_per_s"])["lanes"]
    assert shown[bench_env.CHANGED] == [(best, 2)] * 3
    assert {lanes for lanes, _ in shown[bench_env.BARE]} == {best, 4}
    assert [lanes for lanes, _ in shown[bench_env.MEMORY]] == [4, 6]
    assert len(shown[bench_env.RESETS]) == 1
    assert [row["task"] for row in measured] == sorted(
        (row["task"] for row in measured), key=bench_env._ORDER.index
    )


@pytest.mark.slow
def test_every_rate_has_its_windows_in_order(measured: list[Row]) -> None:
    for row in measured:
        if "median_per_s" in row:
            assert row["windows"] == 2
            assert 0.0 < row["lowest_per_s"] <= row["median_per_s"] <= row["highest_per_s"]


@pytest.mark.slow
def test_ratios_are_ours_over_the_row(measured: list[Row]) -> None:
    best = max(of(measured, bench_env.ALL_CORES), key=lambda row: row["median_per_s"])
    by_lanes = {row["lanes"]: row for row in of(measured, bench_env.ALL_CORES)}
    assert best["ours_over_this"] == 1.0
    for row in of(measured, bench_env.BARE):
        ours = by_lanes[row["lanes"]]["median_per_s"]
        assert row["ours_over_this"] == ours / row["median_per_s"]
    single, cartpole = of(measured, bench_env.SINGLE)[:2]
    assert cartpole["ours_over_this"] == single["median_per_s"] / cartpole["median_per_s"]


@pytest.mark.slow
def test_missing_peers_are_said_with_the_way_to_get_them(measured: list[Row]) -> None:
    missing = [row for row in measured if "missing" in row]
    assert len(missing) == 6
    assert all(row["missing"].startswith("not installed: pip install") for row in missing)
    lines = "\n".join(env_table(measured))
    assert "EnvPool CartPole-v1, at its best        not installed: pip install envpool" in lines


@pytest.mark.slow
def test_memory_is_linear_in_lanes() -> None:
    rows: list[Row] = []
    for lanes in (64, 256, 1024):
        rows.append(bench_ours.memory_row("memory", lanes, rows))
    first, second = (row["bytes_per_lane_more"] for row in rows[1:])
    # lists and dictionaries of Python grow in jumps
    assert second == pytest.approx(first, rel=0.02)
    # 136 columns of single precision, in the environment and once more in what it returned
    assert first > 2 * 4 * 136


def test_resets_are_taken_out_of_the_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    # the last step of the batch that began together holds the resets: 9 steps of 1 s, then 3 s
    given = iter([9.0, 3.0, 16.0])
    monkeypatch.setattr(bench_ours, "_seconds", lambda *_: next(given))
    row = bench_ours.resets_row("resets", 4, 1, 1)
    assert row["without_s"] == pytest.approx(10.0)
    assert row["per_cent_all_at_once"] == pytest.approx(100.0 * 2.0 / 12.0)
    assert row["per_cent_evenly_spread"] == pytest.approx(100.0 * 6.0 / 16.0)


def test_episodes_of_a_batch_begin_evenly_spread() -> None:
    env = bench_ours.make_ours(10, 1)
    bench_ours.spread_out(env, bench_ours.drawn_actions(10))
    ended = []
    for _ in range(10):
        *_, truncated, _ = env.step(np.zeros((10, 4), dtype=np.float32))
        ended.append(np.flatnonzero(truncated).tolist())
    env.close()
    assert ended == [[lane] for lane in range(10)]


@pytest.mark.parametrize(("changes", "expected"), [({}, 40), ({"autoreset_mode": "next_step"}, 36)])
def test_steps_that_only_reset_are_not_counted(changes: dict[str, Any], expected: int) -> None:
    # ten calls after the last reset every lane of four has ended once
    stepper = bench_ours.vector_ours(4, 1, **changes)
    taken = sum(stepper.step(call) for call in range(11))
    stepper.close()
    assert taken == expected + 4


@pytest.mark.slow
def test_the_table_is_aligned_and_narrow(measured: list[Row]) -> None:
    lines = env_table(measured)
    assert max(map(len, lines)) <= bench.WIDTH
    assert lines[0].endswith(f"cores; medians of 2 windows of {bench.WINDOW:g} s")
    assert "OMP_NUM_THREADS=" in lines[1]
    numbers = [line for line in rate_table(measured) if line.startswith("    vector ")]
    assert len(numbers) == 4
    assert len({len(line) for line in numbers}) == 1
    assert any("best number of lanes: " in line for line in lines)


def test_a_row_without_a_rate_is_shown_as_text() -> None:
    rows = [missing_row("t", "theirs", "not installed"), rate_row("t", "ours", 4, 2, [2.0, 1.0])]
    compare(rows[1], rows[1])
    lines = rate_table(rows)
    assert lines[3:5] == ["  t", f"    {'theirs':<40}not installed"]
    assert lines[5].split() == ["ours", "4", "2", "2", "1", "2", "1"]


@pytest.mark.slow
def test_json_holds_rows_threads_and_cores(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(command_bench.SECTIONS, "env", lambda: env_section(TINY))
    assert main(["bench-speed", "--only", "env", "--repeat", "1", "--json"]) == 0
    answer = json.loads(capsys.readouterr().out)
    assert {"numeric_threads", "cores"} <= set(answer["provenance"])
    rows = answer["sections"]["env"]
    assert {row["task"] for row in rows} == set(bench_env._ORDER)


@pytest.mark.slow
def test_no_thread_is_left_behind() -> None:
    before = set(threading.enumerate())
    env_section(Sizes((), (4,), 2, 4, (), (), ())).measure(1, lambda _: None)
    left = set(threading.enumerate()) - before
    assert not [thread for thread in left if thread.name.startswith("railenv-lanes")]


@pytest.mark.slow
def test_progress_is_told_as_often_as_announced() -> None:
    section = env_section(Sizes((), (4,), 1, 4, (), (), ()))
    told: list[str] = []
    tell: Callable[[str], None] = told.append
    section.measure(1, tell)
    assert len(told) == section.total
