"""A pool on a Ray cluster: outcomes of bad tasks, what is lost, what is under way, how it ends."""

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from ray_nodes import two_nodes
from worker_tasks import MIB, NotReadable, alive, gone, only, work

from eval.workers import Limits, LocalPool, Outcome, RayPool, ray_pool
from railenv.errors import ArgumentError, RailenvError

pytest.importorskip("ray.cluster_utils")
pytestmark = [pytest.mark.slow, pytest.mark.cluster]

LIMITS = Limits(seconds=3.0, memory_bytes=500 * MIB)


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with two_nodes() as made:
        yield made


@pytest.fixture
def pool(cluster: Any) -> Iterator[RayPool]:
    with RayPool(cluster.address, LIMITS) as made:
        yield made


BAD: list[tuple[str, Any]] = [
    ("refuse", "the force is not finite"),
    ("exit", 3),
    ("unsendable", 0),
    ("unreadable", 0),
    ("value", NotReadable()),
    ("hold", 1000),
    ("eat", 5000),
    ("_exit", 5),
    ("null", 0),
    ("kill", 0),
]


def test_bad_tasks_end_as_with_local_workers_and_cost_themselves_alone(pool: RayPool) -> None:
    tasks = [("noise", 1), *BAD, ("noise", 2)]
    with LocalPool(2, LIMITS) as local:
        expected = {id(o.task): o for o in local.run(work, tasks)}
    found = {id(o.task): o for o in pool.run(work, tasks)}
    for task in tasks:
        here, there = expected[id(task)], found[id(task)]
        assert (there.status, there.value) == (here.status, here.value), task[0]
        # Without the line of our own code where what cannot be sent was found.
        assert there.message.split(" (")[0] == here.message.split(" (")[0]
    assert [o.status for o in found.values()].count("done") == 2
    assert all(o.seconds < LIMITS.seconds + 2.0 for o in found.values())


def test_numeric_libraries_have_one_thread_on_a_node(cluster: Any) -> None:
    with RayPool(cluster.address) as pool:
        assert only(pool.run(work, [("threads", 0)])).value == (1, 1, "1")


def test_a_task_is_begun_again_where_its_ray_worker_is_lost(pool: RayPool, tmp_path: Path) -> None:
    outcome = only(pool.run(work, [("kill the parent", str(tmp_path))]))
    assert (outcome.status, outcome.value) == ("done", "second attempt")


def test_a_task_that_loses_every_ray_worker_is_crashed_and_no_other(pool: RayPool) -> None:
    tasks = [("value", 1), ("kill the parent", ""), ("value", 2)]
    # The first tells that the cluster as such is sound.
    assert only(pool.run(work, tasks[:1])).value == 1
    found = {task: (status, message) for task, status, message in told(pool.run(work, tasks))}
    assert found[tasks[0]] == found[tasks[2]] == ("done", "")
    status, message = found[tasks[1]]
    assert status == "crashed"
    assert message == "its Ray worker or node was lost in each of 4 attempts (WorkerCrashedError)"


def told(outcomes: Iterator[Outcome[Any]]) -> Iterator[tuple[Any, str, str]]:
    for outcome in outcomes:
        yield outcome.task, outcome.status, outcome.message


def test_a_cluster_that_has_done_nothing_yet_and_loses_all_ends_the_run(pool: RayPool) -> None:
    with pytest.raises(RailenvError, match=r"finished no task so far.* 4 attempts"):
        list(pool.run(work, [("kill the parent", "")]))


def test_a_worker_on_a_node_that_ran_somebodys_code_runs_nobody_elses(cluster: Any) -> None:
    with RayPool(cluster.address, LIMITS, jobs=1, owner=lambda task: task[1]) as pool:
        (spoilt,) = {o.value for o in pool.run(work, [("spoil", "A")])}
        tasks = [("division", "A"), ("division", "B")] * 3
        found = [(o.task[1], o.value) for o in pool.run(work, tasks)]
    assert {value[1] for owner, value in found if owner == "B"} == {"warn"}
    assert spoilt not in {value[0] for owner, value in found if owner == "B"}


def test_a_forked_child_that_returns_on_a_node_neither_answers_nor_takes_tasks(
    cluster: Any,
) -> None:
    tasks = [("fork and return", 0.2), *(("value", number) for number in range(8))]
    with RayPool(cluster.address, LIMITS, jobs=1) as pool:
        found = {o.task: (o.status, o.value) for o in pool.run(work, tasks)}
    assert found.pop(tasks[0]) == ("done", "parent")
    assert found == {("value", number): ("done", number) for number in range(8)}


def test_an_answer_too_many_on_a_node_is_nobodys(cluster: Any) -> None:
    tasks = [("answer twice", 2), *(("value", number) for number in range(5))]
    with RayPool(cluster.address, LIMITS, jobs=1) as pool:
        found = {o.task: (o.status, o.value) for o in pool.run(work, tasks)}
    # Of its own task it says what it likes; here that is nothing that can be read.
    assert found.pop(tasks[0]) == ("failed", None)
    assert found == {("value", number): ("done", number) for number in range(5)}


def test_a_worker_on_a_node_is_buried_while_a_child_holds_its_pipes(
    pool: RayPool, tmp_path: Path
) -> None:
    outcome = only(pool.run(work, [("escape and die", str(tmp_path))]))
    (child,) = (int(path.name) for path in tmp_path.iterdir())
    os.kill(child, signal.SIGKILL)  # alive until now
    assert outcome.status == "crashed"
    assert outcome.seconds < 2.0


def test_tasks_are_taken_as_the_cluster_gets_free(pool: RayPool) -> None:
    taken = 0

    def endless() -> Iterator[tuple[str, int]]:
        nonlocal taken
        while True:
            taken += 1
            yield "value", taken

    outcomes = pool.run(work, endless())
    for seen in range(1, 30):
        next(outcomes)
        # Two cores; what was shown has made room for one more.
        assert taken <= seen + 2 * ray_pool.AHEAD
    outcomes.close()  # type: ignore[attr-defined]
    assert only(pool.run(work, [("value", 7)])).value == 7


def test_no_more_than_jobs_are_under_way(cluster: Any) -> None:
    taken: list[int] = []

    def tasks() -> Iterator[tuple[str, int]]:
        for number in range(5):
            taken.append(number)
            yield "value", number

    with RayPool(cluster.address, LIMITS, jobs=1) as pool:
        for seen, outcome in enumerate(pool.run(work, tasks())):
            assert outcome.value == seen
            assert len(taken) == seen + 1


def test_more_tasks_are_under_way_when_a_node_joins_and_fewer_when_it_leaves(
    cluster: Any, pool: RayPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ray_pool, "_LOOK", 0.1)

    def until(places: int) -> None:
        deadline = time.monotonic() + 60.0
        while pool._places() != places:
            assert time.monotonic() < deadline
            time.sleep(0.1)

    until(2 * ray_pool.AHEAD)
    node = cluster.add_node(num_cpus=3)
    until(5 * ray_pool.AHEAD)
    cluster.remove_node(node)
    until(2 * ray_pool.AHEAD)


def test_a_cluster_without_cores_is_waited_for_and_then_given_up(
    pool: RayPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pool._ray, "cluster_resources", dict)
    monkeypatch.setattr(ray_pool, "_LOOK", 0.1)
    monkeypatch.setattr(ray_pool, "WITHOUT_CORES", 1.0)
    with pytest.raises(RailenvError, match="no processor core for 1 s"):
        list(pool.run(work, [("hold", 1000)] * 3))


def test_closing_the_iterator_stops_what_hangs_on_the_nodes(cluster: Any, tmp_path: Path) -> None:
    with RayPool(cluster.address) as pool:
        outcomes = pool.run(work, [("value", 0), ("note and hang", str(tmp_path))])
        next(outcomes)
        deadline = time.monotonic() + 20.0
        while not list(tmp_path.iterdir()) and time.monotonic() < deadline:
            time.sleep(0.1)
        (pid,) = (int(path.name) for path in tmp_path.iterdir())
        assert alive(pid)
        outcomes.close()  # type: ignore[attr-defined]
        # It holds the interpreter's lock, and cannot see by itself that nobody waits for it.
        assert gone(pid, within=5.0)
        assert only(pool.run(work, [("value", 7)])).value == 7


def test_a_pool_is_used_once_at_a_time_and_not_after_its_end(cluster: Any) -> None:
    with RayPool(cluster.address, LIMITS) as pool:
        first = pool.run(work, [("value", 1), ("value", 2)])
        next(first)
        with pytest.raises(ArgumentError, match="at work"):
            next(pool.run(work, [("value", 3)]))
        with pytest.raises(ArgumentError, match="connected to a Ray cluster already"):
            RayPool(cluster.address)
    with pytest.raises(ArgumentError, match="closed"):
        pool.run(work, [])


def test_what_cannot_be_sent_or_read_is_refused(cluster: Any, pool: RayPool) -> None:
    with pytest.raises(ArgumentError, match=r"the function cannot be sent .*of a module"):
        list(pool.run(lambda task: task, [1]))
    with pytest.raises(ArgumentError, match="the task cannot be sent"):
        list(pool.run(work, [("value", lambda: 0)]))


def test_a_memory_limit_below_what_a_worker_needs_is_refused(cluster: Any) -> None:
    little = RayPool(cluster.address, Limits(memory_bytes=MIB))
    with little as pool, pytest.raises(ArgumentError, match="less than a worker needs at rest"):
        list(pool.run(work, [("value", 1)]))


def test_nodes_with_other_versions_are_refused(
    pool: RayPool, monkeypatch: pytest.MonkeyPatch
) -> None:
    ours = dict(ray_pool.build())
    monkeypatch.setattr(ray_pool, "build", lambda: tuple({**ours, "numpy": "1.26.0"}.items()))
    words = rf"node .* has numpy {ours['numpy']} and not 1\.26\.0; .*install the same"
    with pytest.raises(RailenvError, match=words):
        list(pool.run(work, [("value", 1)]))
