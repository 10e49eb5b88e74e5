"""Reads a certificate file and hands it to the check for its kind of claim."""

import hashlib
import json
import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn, cast

from railenv.errors import InputFileError
from railenv.stability.verifier.contour import check_delay_box
from railenv.stability.verifier.quasipolynomial import RejectedError

_LARGEST_FILE = 512 * 1024 * 1024
_KEYS = ("verdict", "unstable_roots", "reason", "claim", "system", "evidence", "digest")

_CHECKS: dict[str, Callable[[dict[str, Any]], None]] = {
    "delay box": check_delay_box,
}


@dataclass(frozen=True)
class Verification:
    """The outcome.

    Attributes:
        accepted: Whether the evidence proves the claim.
        reasons: Why not; empty if accepted.
        certificate: The content of the file.
    """

    accepted: bool
    reasons: tuple[str, ...]
    certificate: dict[str, Any]


def verify_certificate(path: str | Path) -> Verification:
    """Re-check a certificate file.

    Raises:
        InputFileError: The file cannot be read or is no certificate at all.
    """
    content = _read(Path(path))
    try:
        if _digest(content) != content["digest"]:
            raise RejectedError("the digest does not fit: the file was changed")
        if content["verdict"] not in ("STABLE", "UNSTABLE"):
            raise RejectedError(f"the verdict is {content['verdict']}: there is no proof to check")
        check = _CHECKS.get(content["claim"]["kind"])
        if check is None:
            raise RejectedError(f"claims of the kind {content['claim']['kind']!r} are not known")
        check(content)
    except RejectedError as error:
        return Verification(False, (str(error),), content)
    except (
        KeyError,
        TypeError,
        ValueError,
        IndexError,
        AttributeError,
        OverflowError,
        ZeroDivisionError,
        ArithmeticError,
    ) as error:
        reason = f"the certificate is malformed ({type(error).__name__}: {error})"
        return Verification(False, (reason,), content)
    return Verification(True, (), content)


def _read(path: Path) -> dict[str, Any]:
    try:
        if path.stat().st_size > _LARGEST_FILE:
            raise InputFileError(f"{path} is larger than any certificate")
        content: Any = json.loads(path.read_bytes(), parse_constant=_no_constant)
    except OSError as error:
        raise InputFileError(f"cannot read {path}: {error.strerror or error}") from None
    except (ValueError, RecursionError) as error:
        raise InputFileError(f"{path} is not a certificate: {error}") from None
    if not isinstance(content, dict):
        raise InputFileError(f"{path} is not a certificate made by railenv certify --save")
    content = cast(dict[str, Any], content)
    if content.get("format") != "railenv stability certificate":
        raise InputFileError(f"{path} is not a certificate made by railenv certify --save")
    missing = [key for key in _KEYS if key not in content]
    if missing:
        raise InputFileError(f"{path} is not a whole certificate: {', '.join(missing)} missing")
    if content.get("schema") != 1:
        raise InputFileError(
            f"{path} has schema {content.get('schema')!r}; this version reads schema 1"
        )
    return content


def _no_constant(name: str) -> NoReturn:
    raise ValueError(f"{name} is not a number")


def _digest(content: dict[str, Any]) -> str:
    rest = {key: value for key, value in content.items() if key != "digest"}
    if not _is_finite(rest):
        raise RejectedError("a number is not finite")
    text = json.dumps(rest, sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _is_finite(value: Any) -> bool:
    if isinstance(value, dict):
        return all(_is_finite(v) for v in cast(dict[str, Any], value).values())
    if isinstance(value, list):
        return all(_is_finite(v) for v in cast(list[Any], value))
    return not isinstance(value, float) or math.isfinite(value)
