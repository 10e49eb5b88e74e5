"""How to run a benchmark again, and one cell of it alone."""

import json
import shlex
from typing import Any

from eval.store.reader import Reader

_SALT = "--private-salt"


def command_of(command: str) -> str:
    """Return a session's command without a private salt, which is not for the page."""
    try:
        words = shlex.split(command)
    except ValueError:
        return command
    shown: list[str] = []
    hidden = False
    for word in words:
        name, equals, _ = word.partition("=")
        # A long option may be cut short as long as it is the only one that begins so.
        salt = len(name) > 2 and _SALT.startswith(name)
        if hidden:
            shown.append("SALT")
        else:
            shown.append(f"{name}=SALT" if salt and equals else word)
        hidden = salt and not equals and not hidden
    return shlex.join(shown)


def suite_argument(reader: Reader) -> str:
    """Return what stood after --suite: the suite's name, or the file it came from."""
    for session in reversed(reader.sessions()):
        try:
            words = shlex.split(session["command"])
        except ValueError:
            continue
        for word, after in zip(words, [*words[1:], ""], strict=True):
            if word == "--suite" and after:
                return after
            if word.startswith("--suite="):
                return word.partition("=")[2]
    return reader.settings.suite


def cell_command(suite: str, spec: str, key: str, *, salted: bool) -> str:
    """Return the command that runs one cell of one controller alone."""
    words = ["railenv", "benchmark", "--suite", suite]
    # After an equals sign a SPEC may begin with anything.
    words += [f"--controller={spec}" if spec.startswith("-") else "--controller"]
    words += [] if spec.startswith("-") else [spec]
    words += ["--cell", key]
    return shlex.join(words) + (f" {_SALT} SALT" if salted else "")


def sessions_of(reader: Reader) -> list[dict[str, Any]]:
    """Return every session with words on its versions and a command that can be shown."""
    return [
        {
            **session,
            "command": command_of(session["command"]),
            "versions": ", ".join(f"{name} {v}" for name, v in session["versions"].items()),
        }
        for session in reader.sessions()
    ]


def suite_lines(reader: Reader) -> list[str]:
    """Return the suite's full settings as lines of JSON."""
    return json.dumps(dict(reader.settings.content), indent=1).splitlines()
