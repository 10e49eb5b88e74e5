"""The policies that come with the package: one folder each under `baselines/shipped`."""

from pathlib import Path
from typing import Any

from baselines.policies.folder import CARD_FILE, load_trained
from baselines.policies.tensor_file import parse_json, read_bytes
from railenv.errors import unknown_name

_LARGEST_CARD = 2_000_000


def shipped_folder() -> Path:
    """Return the folder that holds the shipped policies; it may be missing."""
    return Path(__file__).resolve().parent.parent / "shipped"


def shipped_names() -> list[str]:
    """List the names of the shipped policies, sorted."""
    return sorted(path.parent.name for path in shipped_folder().glob(f"*/{CARD_FILE}"))


def shipped_descriptions() -> dict[str, str]:
    """Return one line per shipped policy, from its card."""
    found: dict[str, str] = {}
    for name in shipped_names():
        path = shipped_folder() / name / CARD_FILE
        card = parse_json(path, "card", read_bytes(path, _LARGEST_CARD))
        found[name] = str(card.get("description", "a trained policy"))
    return found


def load_shipped(name: str) -> Any:
    """Read a shipped policy.

    Raises:
        ArgumentError: No shipped policy has that name.
        InputFileError: Its files are damaged.
    """
    names = shipped_names()
    if name not in names:
        raise unknown_name("shipped policy", name, names)
    return load_trained(shipped_folder() / name)
