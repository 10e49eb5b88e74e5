"""A loop of the user's own from a file: `A`, `B`, `K` in an `.npz`, with u = -K x(t - tau)."""

from pathlib import Path
from typing import Any

from baselines.policy_file import exact_floats, read_arrays
from railenv.errors import ArgumentError, InputFileError, unknown_name
from railenv.stability import DelaySystem

_NEEDED = ("A", "B", "K")
_KNOWN = (*_NEEDED, "feedthrough")


def load_system(path: str | Path) -> DelaySystem:
    """Read x' = A x + B f, f_i(t) = u_i(t - tau_i), u = -K x - feedthrough f.

    Args:
        path: An `.npz` file, as written by `numpy.savez(path, A=A, B=B, K=K)`; `feedthrough` may be
            left out. The delays are no part of it.

    Raises:
        InputFileError: The file cannot be read, an array is missing, unknown, of the wrong shape,
            not of finite real numbers, or not exactly held by double precision.
    """
    place = Path(path)
    arrays = read_arrays(place)
    missing = [name for name in _NEEDED if name not in arrays]
    if missing:
        held = ", ".join(f"{name:.40}" for name in arrays) or "nothing"
        raise InputFileError(
            f"{place} has no {' and no '.join(missing)} (it holds {held}); "
            "write it with numpy.savez(path, A=A, B=B, K=K)"
        )
    for name in arrays:
        if name not in _KNOWN:
            # An unread C, D or delay would change the question without a word.
            raise InputFileError(
                f"{place}: {unknown_name('array', name[:40], _KNOWN)}; only {', '.join(_KNOWN)} "
                "are read"
            )
    try:
        matrices: dict[str, Any] = {k: exact_floats(place, k, a) for k, a in arrays.items()}
        return DelaySystem(**matrices)
    except ArgumentError as error:
        raise InputFileError(f"{place}: {error}") from None
