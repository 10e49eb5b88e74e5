"""Trained policies as files: `policy.safetensors` and `card.json`; nothing is ever executed.

The `.safetensors` holds the card as well, so that the one file is enough. `card.json` is the same
card for people and other programs, with the digest of the file beside it. A folder that is written
over holds at every moment files that can be read each by itself.
"""

import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from baselines.policies.card import LARGEST_CARD, card_of, policy_from
from baselines.policies.policy import HistoryPolicy
from baselines.policies.tensor_file import (
    LARGEST_FILE,
    parse_json,
    parse_tensors,
    read_bytes,
    tensor_bytes,
)
from railenv.errors import ArgumentError, InputFileError, OutputError
from railenv.files import make_folder, replacing

POLICY_FILE = "policy.safetensors"
CARD_FILE = "card.json"


def is_policy(spec: str | Path) -> bool:
    """Whether a text is the path of a saved policy: a `.safetensors`, or a folder with a card."""
    text = str(spec)
    if "\0" in text:
        return False
    return text.endswith(".safetensors") or (Path(text) / CARD_FILE).is_file()


def save_trained(
    policy: HistoryPolicy, folder: str | Path, card: Mapping[str, Any] | None = None
) -> None:
    """Write a policy into a folder, which is made if it does not exist.

    Args:
        policy: A `LinearPolicy`, `NetworkPolicy` or `RecurrentPolicy`.
        folder: The folder; other files in it stay.
        card: What is said of the policy; see `baselines.policies.card`. What it does not say, it
            does not hold.

    Raises:
        ArgumentError: The card has a key that is not known, or is too large.
        OutputError: A file cannot be written.
    """
    told, arrays = card_of(policy, {} if card is None else card)
    text = json.dumps(told, allow_nan=False)
    if len(text) > LARGEST_CARD:
        raise ArgumentError(f"card has {len(text)} bytes; give {LARGEST_CARD} or less")
    content = tensor_bytes(arrays, {"card": text})
    shown = json.dumps({**told, "sha256": _digest(content)}, indent=2, allow_nan=False) + "\n"
    place = Path(folder)
    make_folder(place)
    try:
        # Without its card the folder is no policy while the arrays change.
        (place / CARD_FILE).unlink(missing_ok=True)
    except OSError as error:
        raise OutputError(f"cannot write {place / CARD_FILE}: {error.strerror}") from None
    with replacing(place / POLICY_FILE) as stream:
        stream.write(content)
    with replacing(place / CARD_FILE) as stream:
        stream.write(shown.encode())


def load_trained(path: str | Path) -> Any:
    """Read a policy that `save_trained` wrote; it acts bit for bit like the one that was saved.

    Args:
        path: The folder, or its `.safetensors` file alone.

    Returns:
        The `LinearPolicy`, `NetworkPolicy` or `RecurrentPolicy`.

    Raises:
        InputFileError: A file is missing, damaged, of another kind, or its values do not fit.
    """
    place, card, arrays = _read(path)
    return policy_from(place, card, arrays)


def load_card(path: str | Path) -> dict[str, Any]:
    """Read the card of a policy; the policy itself is checked as well.

    Args:
        path: The folder, or its `.safetensors` file alone.

    Raises:
        InputFileError: See `load_trained`.
    """
    place, card, arrays = _read(path)
    policy_from(place, card, arrays)
    return card


def _read(path: str | Path) -> tuple[Path, dict[str, Any], dict[str, Any]]:
    """Return the file's name, its card and its arrays."""
    place = Path(path)
    inside = place if place.suffix == ".safetensors" else place / POLICY_FILE
    if inside != place and not (place / CARD_FILE).is_file():
        raise InputFileError(
            f"{place} is no folder of a policy: it has no {CARD_FILE}; give one that save_trained "
            f"wrote, or a {POLICY_FILE}"
        )
    content = read_bytes(inside, LARGEST_FILE)
    arrays, texts = parse_tensors(inside, content)
    if set(texts) != {"card"}:
        raise InputFileError(
            f"{inside} is no trained policy: its header holds no card; write it with save_trained"
        )
    card = parse_json(inside, "card", texts["card"].encode())
    if inside != place:
        _check_beside(place / CARD_FILE, card, content)
    return inside, card, arrays


def _check_beside(path: Path, card: dict[str, Any], content: bytes) -> None:
    """Raise `InputFileError` unless `card.json` belongs to the file beside it."""
    beside = parse_json(path, "card", read_bytes(path, 4 * LARGEST_CARD))
    digest = beside.pop("sha256", None)
    if digest != _digest(content):
        raise InputFileError(
            f"{path}: sha256 is {digest!r:.80}, and that of {POLICY_FILE} is {_digest(content)}; "
            "one of the two was changed or damaged, take both from one save_trained"
        )
    if beside != card:
        raise InputFileError(
            f"{path} differs from the card in {POLICY_FILE}; take both from one save_trained"
        )


def _digest(content: bytes) -> str:
    return hashlib.sha256(content).hexdigest()
