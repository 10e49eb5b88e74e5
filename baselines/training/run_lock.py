"""One training or search at a time in a folder: a lock that ends with the process that holds it.

Where the system has no such lock (it is POSIX), nothing is held and nothing is refused.
"""

from collections.abc import Generator
from contextlib import contextmanager
from pathlib import Path

from railenv.errors import ArgumentError, OutputError

try:
    import fcntl
except ModuleNotFoundError:  # not POSIX
    fcntl = None

LOCK_FILE = ".lock"


@contextmanager
def held(folder: Path) -> Generator[None, None, None]:
    """Hold a folder, which exists, while the block runs.

    Raises:
        ArgumentError: Another process holds it.
        OutputError: The folder cannot be written to.
    """
    if fcntl is None:
        yield
        return
    try:
        stream = (folder / LOCK_FILE).open("ab")
    except OSError as error:
        raise OutputError(f"cannot write to {folder}: {error.strerror or error}") from None
    with stream:
        try:
            fcntl.flock(stream, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise ArgumentError(
                f"{folder} is in use by another training or search; wait for it, or give another "
                "folder by --out"
            ) from None
        yield
