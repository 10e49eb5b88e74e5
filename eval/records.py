"""Where numbers come from: versions, revision, machine and time; and text files written whole."""

import os
import platform
import subprocess
import sys
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import Any

from railenv.files import replacing


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
