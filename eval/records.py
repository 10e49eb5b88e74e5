"""A benchmark's records: one JSON file with everything a report needs.

Layout of `records.json`: `schema` (number), `suite` (its settings), `provenance` (versions,
machine, command, time), `cells` (one entry per run: key, controller, layout, speed_kmh, track,
seed, delay_s and the fields of `eval.measures.RunMeasures`, and `unstable`: the oracle's word at
that delay), `stability` (one entry per group: critical delays, crossings, root locus), `failures`
(groups whose controller failed, with the reason).
"""

import json
import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from railenv.errors import InputFileError
from railenv.files import replacing

SCHEMA = 1
RECORDS_FILE = "records.json"
_SECTIONS = ("suite", "provenance", "cells", "stability", "failures")


def provenance(command: str, seconds: float) -> dict[str, Any]:
    """Return versions, machine, command and time."""
    packages = ("railenv", "numpy", "scipy", "numba", "gymnasium")
    return {
        "command": command,
        "created": datetime.now(UTC).isoformat(timespec="seconds"),
        "seconds": round(seconds, 2),
        "python": platform.python_version(),
        "platform": platform.platform(),
        "cores": os.cpu_count(),
        "byte_order": sys.byteorder,
        "revision": _revision(),
        "packages": {name: metadata.version(name) for name in packages},
    }


def _revision() -> str | None:
    """Return the checkout's git revision, None outside a checkout."""
    command = ["git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty"]
    try:
        done = subprocess.run(  # noqa: S603 (nothing of the user's in it)
            command, capture_output=True, text=True, check=True, timeout=10
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None


def write_text(path: Path, text: str) -> None:
    """Write a text file as a whole: what stood there before is replaced or kept, never torn.

    Raises:
        OutputError: The file cannot be written.
    """
    with replacing(path) as stream:
        stream.write(text.encode())


def write_records(folder: Path, records: dict[str, Any]) -> Path:
    """Write a benchmark's records and return the file.

    Raises:
        OutputError: The file cannot be written.
    """
    path = folder / RECORDS_FILE
    write_text(path, json.dumps({"schema": SCHEMA, **records}, indent=1, allow_nan=False) + "\n")
    return path


def read_records(folder: Path) -> dict[str, Any]:
    """Read a benchmark's records.

    Raises:
        InputFileError: There are none, or the file does not follow the format.
    """
    path = folder / RECORDS_FILE
    try:
        records = json.loads(path.read_text(encoding="utf-8"), parse_constant=_refuse)
    except OSError as error:
        raise InputFileError(
            f"cannot read {path}: {error.strerror}; give the folder of a finished benchmark"
        ) from None
    except (ValueError, RecursionError) as error:
        raise InputFileError(f"{path} is not JSON: {error}") from None
    schema = records.get("schema") if isinstance(records, dict) else None
    if type(schema) is not int or schema != SCHEMA:
        raise InputFileError(f"{path} has schema {schema!r}; this version reads schema {SCHEMA}")
    missing = [name for name in _SECTIONS if name not in records]
    if missing:
        raise InputFileError(f"{path} lacks {', '.join(missing)}; run the benchmark again")
    return records


def _refuse(constant: str) -> float:
    raise ValueError(f"{constant} is no JSON number")
