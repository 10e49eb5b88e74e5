"""Writing a benchmark's records, package by package."""

import re
import sqlite3
from collections.abc import Iterable, Mapping
from contextlib import ExitStack, nullcontext, suppress
from datetime import UTC, datetime
from pathlib import Path
from types import TracebackType
from typing import Any

from baselines.training.run_lock import held
from eval.records import provenance
from eval.store.answers import Place, answer_row, write_answer
from eval.store.cell import Cell, check_name
from eval.store.connection import (
    check_free,
    close_writing,
    open_writing,
    records_path,
    transaction,
)
from eval.store.packages import write_package
from eval.store.reader import Reader
from eval.store.schema import DIVISIONS, PLANNED, blank_file, session_values, set_meta
from eval.store.settings import RunSettings, differences
from railenv.errors import (
    ArgumentError,
    RailenvError,
    check_not_negative,
    unknown_name,
)
from railenv.files import make_folder, replacing
from railenv.units import KilometrePerHour, Second


class Store(Reader):
    """Records that are being written; the folder belongs to this process until they are closed.

    Made by `create` or `resume`. Of each call that writes all is in the file or nothing, after a
    full disk or a kill too. Nothing must be written while rows of the same store are iterated.
    """

    def __init__(self, folder: Path, connection: sqlite3.Connection, exits: ExitStack) -> None:
        super().__init__(folder, connection)
        self._exits = exits
        self._session: int | None = None

    @classmethod
    def create(cls, folder: Path, settings: RunSettings) -> "Store":
        """Begin the records of a new run.

        Args:
            folder: The run's folder; made if missing.
            settings: What the results will depend on.

        Raises:
            ArgumentError: The folder has records already, or another process is using it.
            OutputError: The folder cannot be written.
        """
        make_folder(folder)
        with ExitStack() as exits:
            _lock(folder, exits)
            path = check_free(folder)
            with replacing(path) as stream:
                stream.write(blank_file({**settings.plain(), "created": _now()}))
            return cls._opened(folder, exits)

    @classmethod
    def resume(cls, folder: Path, settings: RunSettings) -> "Store":
        """Open a run's records to go on with them; a file of an older version is brought up.

        Args:
            folder: The run's folder.
            settings: The same as those the run was started with.

        Raises:
            ArgumentError: The settings differ, or another process is using the folder.
            InputFileError: There are no records, or they are damaged or of a newer version.
            OutputError: The folder cannot be written.
        """
        records_path(folder)  # before a lock is left in a folder of somebody else's
        with ExitStack() as exits:
            _lock(folder, exits)
            # Asked before the file is touched.
            with Reader.open(folder) as there:
                found = differences(there.settings, settings)
            if found:
                raise ArgumentError(
                    f"{folder} was written with other settings: {found}; resume with those of the "
                    "first run, or give another folder by --out"
                )
            return cls._opened(folder, exits)

    @classmethod
    def _opened(cls, folder: Path, exits: ExitStack) -> "Store":
        connection = open_writing(records_path(folder))
        exits.callback(close_writing, connection)
        store = cls(folder, connection, exits)
        store._exits = exits.pop_all()
        return store

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            # An error that is on its way says more than what it brings about here.
            with nullcontext() if kind is None else suppress(RailenvError):
                self.end_session()
        finally:
            self.close()

    def close(self) -> None:
        """Close the file and give the folder back; a session that has not ended stays so."""
        self._exits.close()

    def begin_session(self, command: str) -> int:
        """Note who writes from now on: versions, revision, machine, cores and the time.

        Args:
            command: How the program was called.

        Returns:
            The session's number in the file.

        Raises:
            ArgumentError: A session has begun and has not ended.
            OutputError: The file cannot be written.
        """
        if self._session is not None:
            raise ArgumentError(f"session {self._session} has not ended; call end_session first")
        values = session_values(provenance(command, 0.0))
        with transaction(self._connection, self.path):
            done = self._connection.execute(
                "INSERT INTO sessions (command, versions, revision, machine, cores, started) "
                "VALUES (?, ?, ?, ?, ?, ?)",
                values,
            )
        assert done.lastrowid is not None  # an INSERT has one
        self._session = done.lastrowid
        return self._session

    def end_session(self) -> None:
        """Note that the session has ended; nothing happens where none has begun.

        Raises:
            OutputError: The file cannot be written.
        """
        if self._session is not None:
            with transaction(self._connection, self.path):
                self._connection.execute(
                    "UPDATE sessions SET ended = ? WHERE id = ?", (_now(), self._session)
                )
            self._session = None

    def add_controller(self, spec: str, division: str, sha256: str | None = None) -> None:
        """Name a controller of the run; one that is there already must be the same.

        Args:
            spec: Its SPEC.
            division: "told" if it knows the delay, else "untold".
            sha256: SHA-256 of the file behind it; None if it needs none.

        Raises:
            ArgumentError: The division is unknown, or the controller is there and differs.
            OutputError: The file cannot be written.
        """
        check_name("controller", spec)
        if division not in DIVISIONS:
            raise unknown_name("division", division, DIVISIONS)
        if sha256 is not None and not re.fullmatch("[0-9a-f]{64}", sha256):
            raise ArgumentError(
                f"sha256 = {sha256[:70]!r} is no SHA-256; give 64 hexadecimal digits, or None"
            )
        now = {"spec": spec, "division": division, "sha256": sha256}
        for there in self.controllers():
            if there["spec"] == spec:
                if there != now:
                    changed = [name for name in now if now[name] != there[name]]
                    raise ArgumentError(
                        f"controller {spec} is not the one that {self.folder} was begun with: "
                        + "; ".join(f"{n} was {there[n]} and is {now[n]}" for n in changed)
                        + "; give another folder by --out"
                    )
                return
        with transaction(self._connection, self.path):
            self._connection.execute(
                "INSERT INTO controllers VALUES (?, ?, ?)", (spec, division, sha256)
            )

    def plan(self, runs: Mapping[str, Mapping[str, int]]) -> None:
        """Note how many runs there are to be, beside what earlier sessions have noted.

        Args:
            runs: Their number by controller and layout.

        Raises:
            OutputError: The file cannot be written.
        """
        self.planned |= {spec: dict(layouts) for spec, layouts in runs.items()}
        with transaction(self._connection, self.path):
            set_meta(self._connection, PLANNED, self.planned)

    def add_package(
        self,
        controller: str,
        package: str,
        cells: Iterable[Cell],
        seconds: Second,
        failed: bool = False,
    ) -> None:
        """Write a package's cells and the mark that it is done.

        A package that is there as failed is replaced, so that it can be tried again.

        Args:
            controller: SPEC of a controller of the run.
            package: The package's name.
            cells: Its cells, at least one.
            seconds: What it took [s].
            failed: Whether its worker was lost; its cells then say how.

        Raises:
            ArgumentError: Something does not fit, e.g. an infinite measure or a package that is
                done already; nothing is written.
            OutputError: The file cannot be written; nothing of the package is.
        """
        check_name("package", package)
        taken = check_not_negative("seconds", seconds, "seconds")
        if self._session is None:
            raise ArgumentError("no session has begun; call begin_session first")
        self._check_controller(controller)
        rows = [cell.row(controller, package) for cell in cells]
        if not rows:
            raise ArgumentError(f"package {package} of {controller} has no cells; give them")
        mark = (controller, package, "failed" if failed else "done", taken, self._session)
        with transaction(self._connection, self.path):
            write_package(self._connection, mark, rows)

    def add_stability(
        self,
        controller: str,
        layout: str,
        vehicle: str,
        speed_kmh: KilometrePerHour,
        answer: Mapping[str, Any],
    ) -> None:
        """Write, or replace, the answer on the stability of one loop.

        Args:
            controller: SPEC of a controller of the run.
            layout: The actuators' layout.
            vehicle: Vehicle and its state.
            speed_kmh: Running speed [km/h].
            answer: What the oracle or the simulation says, ready for JSON.

        Raises:
            ArgumentError: The answer holds something that JSON has not, or a name is unusable.
            OutputError: The file cannot be written.
        """
        self._add_answer("stability", (controller, layout, vehicle, speed_kmh), answer)

    def add_motion(
        self,
        controller: str,
        layout: str,
        vehicle: str,
        speed_kmh: KilometrePerHour,
        answer: Mapping[str, Any],
    ) -> None:
        """Write, or replace, a controller's time histories and roots; see `add_stability`."""
        self._add_answer("motion", (controller, layout, vehicle, speed_kmh), answer)

    def _add_answer(self, table: str, place: Place, answer: Mapping[str, Any]) -> None:
        self._check_controller(place[0])
        with transaction(self._connection, self.path):
            write_answer(self._connection, table, answer_row(place, answer))

    def _check_controller(self, controller: str) -> None:
        known = [row["spec"] for row in self.controllers()]
        if controller not in known:
            raise unknown_name("controller of this run", controller, known)


def _lock(folder: Path, exits: ExitStack) -> None:
    try:
        exits.enter_context(held(folder))
    except ArgumentError:
        raise ArgumentError(
            f"{folder} is in use by another benchmark or training; wait for it, or give another "
            "folder by --out"
        ) from None


def _now() -> str:
    return datetime.now(UTC).isoformat(timespec="seconds")
