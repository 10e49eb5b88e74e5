"""Reads a certificate file and hands it to the check for its kind of claim."""

import hashlib
import json
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, cast

from railenv.errors import InputFileError
from railenv.stability.verifier.kinds import CHECKS
from railenv.stability.verifier.quasipolynomial import RejectedError
from railenv.stability.verifier.same_system import plain_numbers, require_same

_LARGEST_FILE = 512 * 1024 * 1024
_MOST_LISTS = 10_000_000
"""Lists and tables in a file: some gigabytes once read. Whole proofs have thousands."""

_KEYS = (
    "format",
    "schema",
    "verdict",
    "unstable_roots",
    "reason",
    "claim",
    "system",
    "evidence",
    "seconds",
    "made_by",
    "digest",
)
_LONGEST_REASON = 400


@dataclass(frozen=True)
class Verification:
    """The outcome.

    Attributes:
        accepted: Whether the evidence proves the claim.
        reasons: Why not; empty if accepted.
        certificate: The content of the file. Proved are, if accepted, `verdict`, `unstable_roots`
            and `claim` for `system`; `reason`, `seconds` and `made_by` are words of the maker.
    """

    accepted: bool
    reasons: tuple[str, ...]
    certificate: dict[str, Any]


def verify_certificate(path: str | Path, system: Any = None) -> Verification:
    """Re-check a certificate file.

    Without `system`, what is accepted is proved for the matrices in the file, whatever they are.

    Args:
        path: The file.
        system: The loop that the certificate must be about: an object with matrices `A`, `B`, `K`
            and `feedthrough`, or an uncertain or sampled loop; compared number by number.

    Raises:
        InputFileError: The file cannot be read or is no certificate at all.
        ArgumentError: `system` is no loop.
    """
    meant = None if system is None else plain_numbers(system)
    content, digest = _read(Path(path))
    try:
        if digest != content["digest"]:
            raise RejectedError("the digest does not fit: the file was changed")
        if content["verdict"] not in ("STABLE", "UNSTABLE"):
            said = f"{content['verdict']}"[:40]
            raise RejectedError(f"the verdict is {said}: there is no proof to check")
        if not isinstance(content["reason"], str) or isinstance(content["unstable_roots"], float):
            raise RejectedError("reason or unstable_roots is of another type")
        if meant is not None:
            require_same(content["system"], meant)
        kind = content["claim"]["kind"]
        if kind not in CHECKS:
            raise RejectedError(f"claims of the kind {kind!r:.40} are not known")
        CHECKS[kind](content)
    except RejectedError as error:
        return Verification(False, (str(error)[:_LONGEST_REASON],), content)
    except Exception as error:  # whatever a malformed file leads to is a reason, not a failure
        reason = f"the certificate is malformed ({type(error).__name__}: {error})"
        return Verification(False, (reason[:_LONGEST_REASON],), content)
    return Verification(True, (), content)


def _read(path: Path) -> tuple[dict[str, Any], str]:
    """Return the content of a certificate and the digest it should have."""
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise ValueError("it is no ordinary file")
        if path.stat().st_size > _LARGEST_FILE:
            raise ValueError("it is larger than any certificate")
        raw = path.read_bytes()
        if raw.count(b"[") + raw.count(b"{") > _MOST_LISTS:
            raise ValueError("it has more lists than any certificate")
        content: Any = json.loads(raw, parse_constant=_no_constant, object_pairs_hook=_table)
        digest = _digest(content)
    except OSError as error:
        raise InputFileError(f"cannot read {path}: {error.strerror or error}") from None
    except (RecursionError, MemoryError):
        raise InputFileError(
            f"{path} is not a certificate: it is nested or grown too far"
        ) from None
    except ValueError as error:
        raise InputFileError(f"{path} is not a certificate: {error}") from None
    if not isinstance(content, dict):
        raise InputFileError(f"{path} is not a certificate made by railenv certify --save")
    content = cast(dict[str, Any], content)
    if content.get("format") != "railenv stability certificate":
        raise InputFileError(f"{path} is not a certificate made by railenv certify --save")
    if type(content.get("schema")) is not int or content["schema"] != 1:
        raise InputFileError(
            f"{path} has schema {content.get('schema')!r:.40}; this version reads schema 1"
        )
    missing = [key for key in _KEYS if key not in content]
    if missing:
        raise InputFileError(f"{path} is not a whole certificate: {', '.join(missing)} missing")
    more = sorted(set(content) - set(_KEYS))
    if more:
        raise InputFileError(f"{path} has an entry {more[0]!r:.40} that no certificate has")
    return content, digest


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")


def _table(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    """Build a table; a key that stands twice would show two readers two different claims."""
    table = dict(pairs)
    if len(table) != len(pairs):
        raise ValueError("an entry stands twice in one table")
    return table


def _digest(content: Any) -> str:
    """Return the digest; a number like 1e400, which no double can hold, raises `ValueError`."""
    if not isinstance(content, dict):
        return ""
    rest = {k: v for k, v in cast(dict[str, Any], content).items() if k != "digest"}
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"), allow_nan=False)
    return hashlib.sha256(text.encode()).hexdigest()
