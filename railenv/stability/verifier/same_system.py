"""Compares the system in a certificate with the one that somebody means, number by number."""

from typing import Any, cast

from railenv.errors import ArgumentError
from railenv.stability.verifier.quasipolynomial import RejectedError

_MATRICES = ("A", "B", "K", "feedthrough")
_FAMILY = ("A", "B", "K")


def plain_numbers(system: Any) -> dict[str, Any]:
    """Return a loop's numbers as lists, in the form in which certificates hold them.

    Args:
        system: An object with `A`, `B`, `K`, `feedthrough`; or with `nominal`, radii and
            `directions`; or with `to_plain()`.

    Raises:
        ArgumentError: It is none of them.
    """
    try:
        if hasattr(system, "to_plain") and not hasattr(system, "nominal"):
            plain = cast(dict[str, Any], system.to_plain())
            kind = "finite history loop" if "measured" in plain else "sampled loop"
            return {"kind": kind, **plain}
        if not hasattr(system, "nominal"):
            return {"kind": "delay system", **_lists(system, _MATRICES)}
        return {
            **_lists(system.nominal, _MATRICES),
            "kind": "uncertain delay system",
            **_lists(system, tuple(f"{name}_radius" for name in _FAMILY)),
            "directions": [
                {name: _rows(part) for name, part in zip(_FAMILY, direction, strict=True)}
                for direction in system.directions
            ],
        }
    except (AttributeError, TypeError, ValueError):
        raise ArgumentError(
            f"a {type(system).__name__} has no matrices A, B, K and feedthrough to compare a "
            "certificate with; give the DelaySystem that it should be about"
        ) from None


def require_same(here: Any, meant: dict[str, Any]) -> None:
    """Require that a certificate's system is the one that is meant.

    Raises:
        RejectedError: It is another one; the reason names the first entry that differs.
    """
    if not isinstance(here, dict):
        raise RejectedError("the certificate's system is not a table of entries")
    table = cast(dict[str, Any], here)
    if table.get("kind") != meant["kind"]:
        raise RejectedError(
            f"the certificate is about a {table.get('kind')!r:.40}, meant is a {meant['kind']!r}"
        )
    _compare("the system", table, meant)


def _lists(source: Any, names: tuple[str, ...]) -> dict[str, Any]:
    return {name: _rows(getattr(source, name)) for name in names}


def _rows(matrix: Any) -> list[list[float]]:
    rows = matrix.tolist() if hasattr(matrix, "tolist") else matrix
    return [[float(value) for value in row] for row in rows]


def _compare(name: str, here: Any, meant: Any) -> None:
    if isinstance(meant, dict):
        table = cast(dict[str, Any], meant)
        if not isinstance(here, dict) or set(cast(dict[str, Any], here)) != set(table):
            raise RejectedError(f"{name} has other entries than the one that is meant")
        for key, value in table.items():
            _compare(key if name == "the system" else f"{name}.{key}", here[key], value)
    elif isinstance(meant, list):
        values = cast(list[Any], meant)
        if not isinstance(here, list) or len(cast(list[Any], here)) != len(values):
            raise RejectedError(f"{name} has another size than in the system that is meant")
        for i, value in enumerate(values):
            _compare(f"{name}[{i}]", here[i], value)
    elif isinstance(here, bool) or here != meant:
        raise RejectedError(f"{name} is {here!r:.40}, and {meant!r} in the system that is meant")
