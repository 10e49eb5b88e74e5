"""A run's folder belongs to one training at a time."""

import subprocess
import sys
from pathlib import Path

import pytest

from baselines.training.run_folder import RunFolder
from baselines.training.run_lock import LOCK_FILE
from railenv.errors import ArgumentError, OutputError

HOLDER = """
import sys
from pathlib import Path
from baselines.training.run_lock import held

with held(Path(sys.argv[1])):
    print("held", flush=True)
    sys.stdin.read()
"""


def test_a_second_training_is_refused_until_the_first_is_gone(tmp_path: Path) -> None:
    place = tmp_path / "run"
    place.mkdir()
    first = subprocess.Popen(
        [sys.executable, "-c", HOLDER, str(place)],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert first.stdout is not None
    assert first.stdout.readline() == "held\n"
    with pytest.raises(ArgumentError, match="in use by another training"), RunFolder(place).held():
        pass
    first.kill()  # SIGKILL: nothing of its own can give the lock back
    first.communicate()
    with RunFolder(place).held():
        pass


def test_a_lock_that_was_left_does_not_make_a_folder_used(tmp_path: Path) -> None:
    folder = RunFolder(tmp_path / "run")
    with folder.held():
        folder.begin({"config": {}})
    assert (folder.path / LOCK_FILE).is_file()


def test_a_file_in_place_of_the_folder_is_refused(tmp_path: Path) -> None:
    place = tmp_path / "run"
    place.write_text("mine")
    with pytest.raises(OutputError, match="it is a file"), RunFolder(place).held():
        pass
    assert place.read_text() == "mine"
