"""The folder of a training run: what lies where, and where a run goes on after a kill.

    run.json                 settings with nothing left to defaults, command, versions, whether done
    references.json          what classical laws reach on the development tracks
    learning.csv             one row per checkpoint: steps, seconds, metrics, judgement
    checkpoints/STEPS/       the newest ones and the best
    tensorboard/             the learning curve, update by update
    policy.safetensors, card.json     the best policy, once the run is done

Every file is replaced as a whole. The checkpoints hold the rows of `learning.csv` too: what was
learnt after the newest checkpoint is forgotten in every file alike.
"""

import csv
import io
import json
import shutil
from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, cast

from baselines.policies.folder import CARD_FILE, POLICY_FILE
from baselines.training.checkpoint import WRITING, Checkpoint, checkpoint_name, read_checkpoint
from baselines.training.run_lock import LOCK_FILE, held
from railenv.errors import ArgumentError, InputFileError, OutputError
from railenv.files import make_folder, replacing

_FORMAT, _VERSION = "railenv-training-run", 1


class RunFolder:
    """The files of one run.

    Args:
        path: The folder.
    """

    def __init__(self, path: Path) -> None:
        self.path = path
        self.checkpoints = path / "checkpoints"
        self.tensorboard = path / "tensorboard"
        self._run = path / "run.json"
        self._references = path / "references.json"

    @contextmanager
    def held(self) -> Generator[None, None, None]:
        """Keep other trainings out of the folder, which is made if it does not exist.

        Raises:
            ArgumentError: Another training is in it.
            OutputError: It cannot be written to.
        """
        if self.path.exists() and not self.path.is_dir():
            raise OutputError(f"cannot write to {self.path}: it is a file")
        if not self.exists():
            self._refuse_used()  # before a lock is left in a folder of somebody else's
        make_folder(self.path)
        with held(self.path):
            yield

    def begin(self, about: dict[str, Any]) -> None:
        """Begin a new run.

        Args:
            about: The content of run.json.

        Raises:
            ArgumentError: There is something in the folder already.
            OutputError: It cannot be written.
        """
        self._refuse_used()
        make_folder(self.checkpoints)
        self.write_about(about)

    def about(self) -> dict[str, Any]:
        """Return the content of run.json.

        Raises:
            InputFileError: The folder holds no run, or the file is damaged.
        """
        found = read_json(self._run)
        kept = {"config": dict, "done": bool}
        whole = all(isinstance(found.get(key), kind) for key, kind in kept.items())
        if found.get("format") != _FORMAT or found.get("version") != _VERSION or not whole:
            raise InputFileError(
                f"{self._run} is no training run of this version; start a new one with --out"
            )
        return found

    def exists(self) -> bool:
        """Return whether a run has begun here."""
        return self._run.is_file()

    def write_about(self, about: dict[str, Any]) -> None:
        """Write run.json."""
        self._write_json(self._run, {"format": _FORMAT, "version": _VERSION, **about})

    def references(self) -> dict[str, Any] | None:
        """Return what classical laws reach; None if that was not computed yet."""
        return read_json(self._references) if self._references.is_file() else None

    def write_references(self, references: dict[str, Any]) -> None:
        """Write references.json."""
        self._write_json(self._references, references)

    def newest(self) -> tuple[Checkpoint | None, list[str]]:
        """Return the newest whole checkpoint, and clear away what is none.

        Returns:
            The checkpoint, None if there is none, and a sentence about every damaged one that was
            newer; those are removed, and what they would have been is computed again.
        """
        complaints: list[str] = []
        make_folder(self.checkpoints)
        for folder in self.checkpoints.glob(f"{WRITING}*"):
            shutil.rmtree(folder, ignore_errors=True)
        for folder in sorted(self._all(), reverse=True):
            try:
                found = read_checkpoint(folder)
                if found.steps != int(folder.name):
                    raise InputFileError(
                        f"{folder} says that it stands after {found.steps} lane-steps"
                    )
                return found, complaints
            except InputFileError as error:
                complaints.append(f"{error}; removed, the run goes on from the one before")
                shutil.rmtree(folder, ignore_errors=True)
        return None, complaints

    def prune(self, keep: int, best_of: dict[int, int | None]) -> None:
        """Remove old checkpoints.

        Args:
            keep: How many of the newest stay.
            best_of: For every checkpoint of this run by its steps, the steps of the best one then;
                that of each that stays, stays too: the run may have to go on from any of them.
        """
        newest = sorted(self._all())[-keep:]
        stay = {int(folder.name) for folder in newest}
        stay |= {best for steps in list(stay) if (best := best_of.get(steps)) is not None}
        for folder in self._all():
            if int(folder.name) not in stay:
                shutil.rmtree(folder, ignore_errors=True)

    def has_policy(self) -> bool:
        """Whether the best policy lies in the folder, with its card."""
        return all((self.path / name).is_file() for name in (POLICY_FILE, CARD_FILE))

    def policy_at(self, steps: int) -> Path:
        """Return the folder of the policy of a judged checkpoint."""
        return self.checkpoints / checkpoint_name(steps) / "policy"

    def put_policy(self, steps: int) -> None:
        """Put the policy of a checkpoint into the run's folder, as that has it.

        Raises:
            InputFileError: The checkpoint is gone or damaged; what lies in the folder is untouched.
            OutputError: It cannot be written.
        """
        source = self.policy_at(steps)
        try:
            read_checkpoint(source.parent)
            contents = {name: (source / name).read_bytes() for name in (POLICY_FILE, CARD_FILE)}
        except (InputFileError, OSError) as error:
            raise InputFileError(
                f"the best policy of the run in {self.path} cannot be taken from its checkpoint: "
                f"{error}; train it anew with another --out"
            ) from None
        try:
            # Without its card the folder is no policy while the arrays change.
            (self.path / CARD_FILE).unlink(missing_ok=True)
        except OSError as error:
            raise OutputError(f"cannot write to {self.path}: {error.strerror or error}") from None
        for name, content in contents.items():
            with replacing(self.path / name) as stream:
                stream.write(content)

    def write_curve(self, rows: list[dict[str, float]]) -> None:
        """Write learning.csv, one row per checkpoint; all rows have the columns of the first."""
        text = io.StringIO()
        if rows:
            writer = csv.DictWriter(text, list(rows[0]), lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        with replacing(self.path / "learning.csv") as stream:
            stream.write(text.getvalue().encode("ascii"))

    def _refuse_used(self) -> None:
        if self.path.is_dir() and not self._untouched():
            raise ArgumentError(
                f"{self.path} is not empty; go on with the run in it by --resume, or give another "
                "folder by --out"
            )

    def _untouched(self) -> bool:
        """Whether nothing is there but what a run killed in its first moment leaves."""
        left = [
            path
            for path in self.path.iterdir()
            if not path.name.startswith(".run.") and path.name != LOCK_FILE
        ]
        return all(path == self.checkpoints and not any(path.iterdir()) for path in left)

    def _all(self) -> list[Path]:
        found = self.checkpoints.iterdir() if self.checkpoints.is_dir() else iter(())
        return [path for path in found if path.is_dir() and path.name.isdecimal()]

    def _write_json(self, path: Path, content: dict[str, Any]) -> None:
        with replacing(path) as stream:
            stream.write(json.dumps(content, indent=1, allow_nan=False).encode("ascii"))
            stream.write(b"\n")


def read_json(path: Path) -> dict[str, Any]:
    """Return the JSON object of a file.

    Raises:
        InputFileError: It cannot be read, or holds something else.
    """
    try:
        found: Any = json.loads(path.read_text(encoding="ascii"))
    except OSError as error:
        raise InputFileError(f"cannot read {path}: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise InputFileError(f"{path} is not valid JSON: {error}") from None
    if not isinstance(found, dict):
        raise InputFileError(f"{path} holds no JSON object")
    return cast("dict[str, Any]", found)
