"""Writes a controller of the user's own to begin with: `railenv benchmark --template FILE`."""

import importlib.util
import keyword
from pathlib import Path

from railenv.errors import ArgumentError, OutputError

_TEMPLATE = Path(__file__).parent / "templates" / "controller.py"
_ITS_NAME = "my_controller"


def write_template(path: Path) -> Path:
    """Write a commented controller that works, and return where.

    It is named by `py:NAME:controller` in commands run from its folder, NAME being the file's name
    without `.py`.

    Args:
        path: A file that does not exist, named as a Python module is, e.g. my_controller.py.

    Raises:
        ArgumentError: The file exists, or its name is none that a module of one's own can have.
        OutputError: The file cannot be written.
    """
    name = path.stem
    if path.suffix != ".py" or not name.isidentifier() or keyword.iskeyword(name):
        raise ArgumentError(
            f"{path.name!r} is no name of a Python module; give letters, digits and underscores "
            "and the ending .py, as my_controller.py"
        )
    if path.exists() or path.is_symlink():
        raise ArgumentError(f"{path} exists and is not overwritten; give another name")
    if importlib.util.find_spec(name) is not None:
        raise ArgumentError(
            f"{path.name!r} is called as the module {name!r} that Python knows already, and one of "
            "the two would not be found; give another name, as my_controller.py"
        )
    text = _TEMPLATE.read_text(encoding="utf-8").replace(_ITS_NAME, name)
    try:
        with path.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError:
        raise ArgumentError(f"{path} exists and is not overwritten; give another name") from None
    except OSError as error:
        raise OutputError(f"cannot write {path}: {error.strerror or error}") from None
    return path
