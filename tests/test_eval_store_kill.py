"""A writer killed at any moment leaves whole packages; going on ends in the undisturbed results."""

import subprocess
import time
from pathlib import Path

import numpy as np
import pytest
from store_examples import CELLS, PACKAGES, SETTINGS, SPEC, go_on, package, write
from test_eval_store_files import child

from eval.store.digest import digest
from eval.store.reader import Reader
from eval.store.store import Store


def whole_packages(folder: Path) -> int:
    """Check that what is in the folder is whole packages with their numbers; return how many."""
    with Reader.open(folder) as records:
        done = records.done()
        rows = list(records.rows())
    assert len(rows) == len(done) * CELLS
    found = {row["key"]: row for row in rows}
    for spec, name in done:
        assert spec == SPEC
        for cell in package(int(name[1:])):
            row = found[cell.key]
            assert row["package"] == name
            assert {measure: row[measure] for measure in cell.measures} == cell.measures
    return len(done)


def killed_after(folder: Path, seconds: float) -> bool:
    """Let a writer go on and kill it some time after it has opened the file.

    Returns:
        Whether it was killed before it came to the end.
    """
    writer: subprocess.Popen[str] = child(folder)
    assert writer.stdout is not None
    assert writer.stdout.readline() == "open\n"
    time.sleep(seconds)
    writer.kill()
    writer.communicate()
    return writer.returncode == -9


@pytest.mark.slow
def test_a_killed_writer_leaves_whole_packages_and_its_folder_free(tmp_path: Path) -> None:
    assert killed_after(tmp_path / "run", 0.05)
    count = whole_packages(tmp_path / "run")
    assert count < PACKAGES
    # the lock died with its holder
    with Store.resume(tmp_path / "run", SETTINGS) as store:
        go_on(store, range(PACKAGES))
    assert whole_packages(tmp_path / "run") == PACKAGES
    with Reader.open(tmp_path / "run") as records:
        sessions = records.sessions()
    # the first session may not have come to its row
    assert [s["ended"] is None for s in sessions] in ([True, False], [False])


@pytest.mark.slow
def test_kills_at_random_moments_and_going_on_end_in_the_undisturbed_file(tmp_path: Path) -> None:
    write(tmp_path / "undisturbed", range(PACKAGES))
    expected = digest(tmp_path / "undisturbed")
    generator = np.random.Generator(np.random.PCG64(8))
    kills = partly = 0
    for repetition in range(4):
        place = tmp_path / f"run{repetition}"
        before = 0
        # a writer writes a package in about 10 ms: each gets through some of the forty
        for seconds in generator.uniform(0.0, 0.12, size=5):
            kills += killed_after(place, seconds)
            count = whole_packages(place)
            assert count >= before
            partly += before < count < PACKAGES
            before = count
        last = child(place)
        last.communicate(timeout=60)
        assert last.returncode == 0
        assert digest(place) == expected
    # otherwise nothing was tested
    assert kills >= 10
    assert partly >= 5
