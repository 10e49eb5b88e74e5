"""Runs that are killed at any moment and resumed end in the records of one that was not."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import psutil
import pytest
from benchmark_examples import TEXT, cells

from eval.store.digest import digest
from eval.store.reader import Reader

KILLS = 5
SPECS = ("skyhook:gain=15e3", "skyhook:gain=35e3", "lqg-delay:delay={delay}", "apg-linear")


def started(suite: Path, folder: Path, *arguments: str) -> "subprocess.Popen[bytes]":
    given = [word for spec in SPECS for word in ("--controller", spec)]
    command = ["benchmark", "--suite", str(suite), "--out", str(folder), "--jobs", "2", "--json"]
    return subprocess.Popen(
        [sys.executable, "-m", "eval.cli", *command, *given, *arguments],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parent.parent)},
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
    )


def packages(folder: Path) -> int:
    """Check that whole packages are there; return how many."""
    if not (folder / "records.sqlite").exists():
        return 0
    with Reader.open(folder) as reader:
        done = {(row["controller"], row["package"]) for row in reader.packages()}
        rows = list(reader.rows())
    assert {(row["controller"], row["package"]) for row in rows} == done
    return len(done)


@pytest.mark.slow
def test_five_kills_at_random_moments_and_resuming_give_the_undisturbed_rows(
    tmp_path: Path,
) -> None:
    suite = tmp_path / "tiny.toml"
    suite.write_text(TEXT.replace("speeds_kmh = [250.0]", "speeds_kmh = [200.0, 250.0, 350.0]"))
    whole, killed = tmp_path / "whole", tmp_path / "killed"
    process = started(suite, whole)
    out, _ = process.communicate(timeout=300.0)
    assert (process.returncode, out.count(b"\n")) == (0, 1)
    generator = np.random.Generator(np.random.PCG64(5))
    counts = [0]
    for _ in range(KILLS):
        resume = ("--resume",) if (killed / "records.sqlite").exists() else ()
        process = started(suite, killed, *resume)
        before = packages(killed)
        deadline = time.monotonic() + 60.0
        # From the first package of its own on, so that every kill hits the work.
        while packages(killed) == before and process.poll() is None:
            assert time.monotonic() < deadline
            time.sleep(0.02)
        time.sleep(generator.uniform(0.0, 0.3))
        workers = psutil.Process(process.pid).children(recursive=True)
        process.send_signal(signal.SIGKILL)
        process.communicate()
        counts.append(packages(killed))
        _, alive = psutil.wait_procs(workers, timeout=30.0)
        assert not alive
    # Otherwise nothing was tested: each kill came within the work, after progress.
    assert counts == sorted(set(counts))
    assert counts[-1] < packages(whole)
    process = started(suite, killed, "--resume")
    process.communicate(timeout=300.0)
    assert process.returncode == 0
    assert packages(killed) == packages(whole)
    assert digest(killed) == digest(whole)
    assert cells(killed) == cells(whole)
    with Reader.open(killed) as reader:
        ended = [session["ended"] is not None for session in reader.sessions()]
        killed_answers = reader.stability()
    assert ended == [False] * KILLS + [True]
    with Reader.open(whole) as reader:
        assert reader.stability() == killed_answers
