"""A loop of the user's own from an `.npz` file, continuous or sampled.

Continuous: `A`, `B`, `K`, with u = -K x(t - tau). Sampled, recognised by `period`: `A`, `B`, `C`,
`Dc` and more; see `railenv.stability.SampledLoop`.
"""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.policy_file import exact_floats, read_arrays
from railenv.errors import ArgumentError, InputFileError, unknown_name
from railenv.stability import DelaySystem, SampledLoop
from railenv.units import FloatArray

_NEEDED = ("A", "B", "K")
_KNOWN = (*_NEEDED, "feedthrough")

_SAMPLED_NEEDED = ("A", "B", "C", "Dc", "period")
_STATES = ("Ac", "Bc", "Cc")
_SAMPLED_KNOWN = (*_SAMPLED_NEEDED, "D", *_STATES, "told")


def load_system(path: str | Path) -> DelaySystem | SampledLoop:
    """Read a loop; the delays are no part of it.

    A continuous one, x' = A x + B f, f_i(t) = u_i(t - tau_i), u = -K x - feedthrough f, is written
    by `numpy.savez(path, A=A, B=B, K=K)`; `feedthrough` may be left out. A file with `period` is a
    `SampledLoop` with the arrays `A`, `B`, `C`, `Dc` and, where they are not zero, empty or None,
    `D`, `Ac`, `Bc`, `Cc` (these three together) and `told`; with `told` the controller's matrices
    have a leading axis, one entry per knot.

    Args:
        path: An `.npz` file.

    Raises:
        InputFileError: The file cannot be read, an array is missing, unknown, of the wrong shape,
            not of finite real numbers, or not exactly held by double precision.
    """
    place = Path(path)
    arrays = read_arrays(place)
    sampled = "period" in arrays
    _check_names(place, arrays, sampled)
    try:
        matrices: dict[str, Any] = {k: exact_floats(place, k, a) for k, a in arrays.items()}
        return _sampled(matrices) if sampled else DelaySystem(**matrices)
    except InputFileError:
        raise
    except (ValueError, MemoryError) as error:
        # `ArgumentError`, or an empty array whose sides no array can have.
        raise InputFileError(f"{place}: {error}") from None


def _check_names(place: Path, arrays: dict[str, NDArray[Any]], sampled: bool) -> None:
    needed, known = (_SAMPLED_NEEDED, _SAMPLED_KNOWN) if sampled else (_NEEDED, _KNOWN)
    missing = [name for name in needed if name not in arrays]
    what = " (a file with period holds a sampled loop)" if sampled else ""
    if missing:
        held = ", ".join(f"{name:.40}" for name in arrays) or "nothing"
        save = ", ".join(f"{name}={name}" for name in needed)
        other = "" if sampled or "Dc" not in arrays else "; a sampled loop needs period too"
        raise InputFileError(
            f"{place} has no {' and no '.join(missing)} (it holds {held}); "
            f"write it with numpy.savez(path, {save}){what}{other}"
        )
    for name in arrays:
        if name not in known:
            # An unread D or delay would change the question without a word.
            raise InputFileError(
                f"{place}: {unknown_name('array', name[:40], known)}; only {', '.join(known)} "
                f"are read{what}"
            )


def _sampled(matrices: dict[str, FloatArray]) -> SampledLoop:
    """Return the sampled loop; what is left out is without feedthrough, without controller states.

    Shapes are checked by `SampledLoop`, which names the array.
    """
    period = matrices["period"]
    if period.size != 1:
        raise ArgumentError(f"period has shape {period.shape}; give one number of seconds")
    have = [name for name in _STATES if name in matrices]
    if have and len(have) < len(_STATES):
        lacking = [name for name in _STATES if name not in matrices]
        raise ArgumentError(
            f"{', '.join(have)} without {', '.join(lacking)}; a controller with states has "
            f"{', '.join(_STATES)}, one without has none of them"
        )
    C, B, Dc = matrices["C"], matrices["B"], matrices["Dc"]
    p, m = C.shape[0] if C.ndim == 2 else 0, B.shape[1] if B.ndim == 2 else 0
    if p * m > Dc.size:
        # Before anything of that size is made: a small file may declare long and thin arrays.
        raise ArgumentError(
            f"Dc has shape {Dc.shape}; it must have {m} rows and {p} columns for each knot of told"
        )
    lead = matrices["told"].shape if "told" in matrices else ()
    absent: dict[str, Any] = {
        "D": np.zeros((p, m)),
        "Ac": np.zeros((*lead, 0, 0)),
        "Bc": np.zeros((*lead, 0, p)),
        "Cc": np.zeros((*lead, m, 0)),
    }
    return SampledLoop(**{**absent, **matrices, "period": float(period.item())})
