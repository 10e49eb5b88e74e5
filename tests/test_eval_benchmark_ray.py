"""Work on a Ray cluster: the rows of local workers, also where a node is lost on the way."""

import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Iterator
from pathlib import Path
from typing import Any

import psutil
import pytest
from benchmark_examples import BROKEN, TEXT, benchmark_of, cells, run
from ray_nodes import TESTS, two_nodes
from worker_tasks import gone, held

from eval.cli import main
from eval.store.digest import digest
from eval.store.reader import Reader
from eval.store.schema import MEASURES
from eval.workers import LocalPool, Outcome, RayPool

pytest.importorskip("ray.cluster_utils")
ray_print = pytest.importorskip("ray._private.worker").print_to_stdstream
pytestmark = [pytest.mark.slow, pytest.mark.cluster]

KEY = "v0/lateral17/nominal/4/300/german_low/jitter:100/1"


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    with two_nodes() as made:
        yield made


class Doomed:
    """A pool that loses a node of its cluster while that is at work."""

    def __init__(self, pool: RayPool, cluster: Any, folder: Path) -> None:
        self.pool, self.cluster, self.folder = pool, cluster, folder
        self.node = cluster.add_node(num_cpus=1)
        raylet = self.node.all_processes["raylet"][0].process.pid
        (folder / "doomed").write_text(str(raylet))

    def run(self, function: Callable[[Any], Any], tasks: Iterable[Any]) -> Iterator[Outcome[Any]]:
        killer = threading.Thread(target=self._kill)
        killer.start()
        given = ((self.folder, function, task) for task in tasks)
        for outcome in self.pool.run(held, given):
            yield Outcome(
                outcome.task[2], outcome.status, outcome.value, outcome.message, outcome.seconds
            )
        killer.join()

    def _kill(self) -> None:
        deadline = time.monotonic() + 100.0
        while not (self.folder / "held").exists() and time.monotonic() < deadline:
            time.sleep(0.05)
        self.cluster.remove_node(self.node, allow_graceful=False)


def test_a_run_that_loses_a_node_at_work_has_the_rows_of_local_workers(
    cluster: Any, tmp_path: Path
) -> None:
    benchmark = benchmark_of("skyhook:gain=15e3", "zero", "skyhook:gain=5e3", f"{BROKEN}Raises")
    marks = tmp_path / "marks"
    marks.mkdir()
    with RayPool(cluster.address, benchmark.limits) as pool:
        run(tmp_path / "ray", benchmark, Doomed(pool, cluster, marks))  # type: ignore[arg-type]
    assert (marks / "held").exists()
    expected = digest(tmp_path / "ray")
    assert len(cells(tmp_path / "ray", status="ok")) >= 3 * 9
    for jobs in (1, 2, 4):
        with LocalPool(jobs, benchmark.limits) as local:
            run(tmp_path / str(jobs), benchmark, local)
        assert digest(tmp_path / str(jobs)) == expected


def test_the_command_prints_one_object_and_resumes_what_it_left(
    cluster: Any, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    suite = tmp_path / "tiny.toml"
    suite.write_text(TEXT)
    given = ["benchmark", "--suite", str(suite), "--ray", cluster.address, "--json"]
    out = ["--out", str(tmp_path / "run")]
    assert main([*given, *out]) == 0
    (line,) = capfd.readouterr().out.splitlines()
    assert json.loads(line)["records"] == str(tmp_path / "run" / "records.sqlite")
    assert main([*given, *out, "--resume"]) == 0
    assert main([*given, "--cell", KEY]) == 0
    (found,) = json.loads(capfd.readouterr().out.splitlines()[1])["cells"]
    (row,) = cells(tmp_path / "run", key=KEY)
    assert {name: found[name] for name in MEASURES} == {name: row[name] for name in MEASURES}


def test_standard_output_is_left_alone_while_ray_may_print_there(
    cluster: Any, capsys: pytest.CaptureFixture[str]
) -> None:
    with RayPool(cluster.address):
        # As the thread does in which Ray tells that a node was lost.
        ray_print({"lines": ["a node is lost"], "pid": "raylet", "is_err": False}, False)
    print("result")
    out, err = capsys.readouterr()
    assert out == "result\n"
    assert "a node is lost" in err


def test_ctrl_c_ends_what_hangs_on_the_nodes_and_leaves_records_to_be_resumed(
    cluster: Any, tmp_path: Path
) -> None:
    suite = tmp_path / "tiny.toml"
    suite.write_text(TEXT)
    out = tmp_path / "run"
    given = ("--suite", str(suite), "--out", str(out), "--ray", cluster.address)
    own = ("--controller", f"{BROKEN}Hangs", "--controller", "zero", "--seconds", "600")
    process = subprocess.Popen(
        [sys.executable, "-c", INTERRUPTIBLE, "benchmark", *given, *own],
        env={**os.environ, "PYTHONPATH": f"{TESTS}{os.pathsep}{TESTS.parent}"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    deadline = time.monotonic() + 100.0
    while time.monotonic() < deadline:
        time.sleep(0.2)
        # Passive, reference, and a node that is not stuck in the other one's packages.
        if (out / "records.sqlite").exists() and len(cells(out)) >= 3 + 3:
            break
    time.sleep(2.0)
    hanging = workers()
    os.killpg(process.pid, signal.SIGINT)
    printed, err = process.communicate(timeout=30.0)
    assert (printed, process.returncode) == ("", 130)
    assert err.rstrip().endswith("railenv benchmark: interrupted")
    assert hanging
    assert all(gone(pid) for pid in hanging)
    with Reader.open(out) as reader:
        assert reader.done()


INTERRUPTIBLE = """
import signal, sys
signal.signal(signal.SIGINT, signal.default_int_handler)
from eval.cli import main
sys.exit(main(sys.argv[1:]))
"""


def workers() -> list[int]:
    """The processes on this machine that Ray workers have started for tasks."""
    return [
        process.pid
        for process in psutil.process_iter(["name", "cmdline"])
        if "multiprocessing.spawn" in " ".join(process.info["cmdline"] or ())
        and (parent := process.parent()) is not None
        and "ray::" in " ".join(parent.cmdline())
    ]
