"""A benchmark's records: one JSON file with everything a report needs.

Layout of `records.json`: `schema` (number), `suite` (its settings), `provenance` (versions,
machine, command, time), `cells` (one entry per run: key, controller, layout, speed_kmh, track,
seed, delay_s and the fields of `eval.measures.RunMeasures`), `stability` (one entry per group:
critical delays, crossings, root locus), `failures` (groups whose controller failed, with the
reason).
"""

import json
import os
import platform
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
        "packages": {name: metadata.version(name) for name in packages},
    }


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
        records = json.loads(path.read_text(encoding="utf-8"))
    except OSError as error:
        raise InputFileError(
            f"cannot read {path}: {error.strerror}; give the folder of a finished benchmark"
        ) from None
    except (json.JSONDecodeError, UnicodeDecodeError) as error:
        raise InputFileError(f"{path} is not JSON: {error}") from None
    if not isinstance(records, dict) or records.get("schema") != SCHEMA:
        found = records.get("schema") if isinstance(records, dict) else None
        raise InputFileError(f"{path} has schema {found!r}; this version reads schema {SCHEMA}")
    missing = [name for name in _SECTIONS if name not in records]
    if missing:
        raise InputFileError(f"{path} lacks {', '.join(missing)}; run the benchmark again")
    return records
