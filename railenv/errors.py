"""Every exception that railenv raises on purpose, and the checks that raise them.

A message names the argument, the value it got, the rule, and the way out, in one line. The command
line turns `ArgumentError` and `InputFileError` into exit status 2, every other `RailenvError` into
exit status 1, and never shows a traceback for one of them.
"""

import difflib
import math
from collections.abc import Iterable
from typing import SupportsFloat


class RailenvError(Exception):
    """Root of all exceptions raised on purpose."""


class ArgumentError(RailenvError, ValueError):
    """An argument, a setting or a name is not usable."""


class NeutralLoopError(ArgumentError):
    """A loop with direct feedthrough was given where only retarded loops have an answer."""


class InputFileError(RailenvError, ValueError):
    """A file that was handed over cannot be read or does not follow its format."""


class OutputError(RailenvError, OSError):
    """A result could not be written; what stood there before is untouched."""


class ControllerError(RailenvError, RuntimeError):
    """A controller broke the protocol: wrong shape, not finite, or it raised."""


def unknown_name(kind: str, name: str, known: Iterable[str]) -> ArgumentError:
    """Build the error for a name that does not exist.

    Args:
        kind: What was named, e.g. "vehicle".
        name: What was given.
        known: Every valid name.

    Returns:
        The exception, to be raised by the caller; it names the nearest valid names.
    """
    choices = sorted(known)
    near = difflib.get_close_matches(name, choices, n=3, cutoff=0.5)
    if near:
        hint = "did you mean " + " or ".join(repr(n) for n in near) + "?"
    else:
        hint = "known: " + ", ".join(choices) if choices else "none exists"
    return ArgumentError(f"unknown {kind} {name!r}; {hint}")


def check_finite(name: str, value: SupportsFloat, unit: str = "") -> float:
    """Return `value` as a float, or raise `ArgumentError` if it is not a finite number."""
    try:
        if isinstance(value, str | bool) or type(value).__name__ in ("bool", "bool_"):
            raise TypeError  # a truth value is no number, numpy's neither
        number = float(value)
    except (TypeError, ValueError, OverflowError):
        shown = f"{value!r}"[:40]
        raise ArgumentError(f"{name} = {shown} is not a number; give one{_in(unit)}") from None
    if not math.isfinite(number):
        raise ArgumentError(f"{name} = {number} must be finite; give a number{_in(unit)}")
    return number


def check_positive(name: str, value: SupportsFloat, unit: str = "") -> float:
    """Return `value` as a float, or raise `ArgumentError` unless it is finite and above zero."""
    number = check_finite(name, value, unit)
    if number <= 0.0:
        raise ArgumentError(
            f"{name} = {number:g} must be above zero; give a positive value{_in(unit)}"
        )
    return number


def check_not_negative(name: str, value: SupportsFloat, unit: str = "") -> float:
    """Return `value` as a float, or raise `ArgumentError` unless it is finite and at least zero."""
    number = check_finite(name, value, unit)
    if number < 0.0:
        raise ArgumentError(
            f"{name} = {number:g} must not be negative; give zero or more{_in(unit)}"
        )
    return number


def check_text(name: str, text: str, unit: str = "") -> float:
    """Return the finite number that a text spells, or raise `ArgumentError`."""
    try:
        # float() alone also reads 1_000, digits of other scripts and spaces around.
        if not text.isascii() or "_" in text or text != text.strip():
            raise ValueError(text)
        return check_finite(name, float(text), unit)
    except ValueError:
        raise ArgumentError(
            f"{name} = {text[:40]!r} is not a finite number; give one{_in(unit)}"
        ) from None


def check_count(name: str, value: object, minimum: int = 1) -> int:
    """Return `value` as an int, or raise `ArgumentError` unless it is whole and large enough."""
    if isinstance(value, bool) or not hasattr(value, "__index__"):
        raise ArgumentError(f"{name} = {value!r} is not a whole number; give {minimum} or more")
    number = int(value)  # type: ignore[call-overload]
    if number < minimum:
        raise ArgumentError(f"{name} = {number} is too small; give {minimum} or more")
    return number


def _in(unit: str) -> str:
    return f" in {unit}" if unit else ""
