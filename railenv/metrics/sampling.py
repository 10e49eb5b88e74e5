"""Checks on sampled signals, and cutting them into segments.

A signal is an array of accelerations [m/s^2] with time on its last axis; every axis before that is
a batch of independent signals. The other modules of this room turn such a signal into numbers and
share the rules written here:

* a sample that is not finite is an error, never skipped,
* a length in seconds must be a whole number of samples; it is never rounded to one,
* samples left over after the last whole segment are not used.

The module does not know what moved, how fast, or which standard asks.
"""

import numpy as np
from numpy.typing import ArrayLike

from railenv.errors import ArgumentError, check_finite, check_positive, unknown_name
from railenv.units import FloatArray

_COSINE_TERMS: dict[str, tuple[float, ...]] = {
    "boxcar": (1.0,),
    "hann": (0.5, 0.5),
    "hamming": (0.54, 0.46),
    "blackman": (0.42, 0.50, 0.08),
    "flattop": (0.21557895, 0.41663158, 0.277263158, 0.083578947, 0.006947368),
}
"""Cosine-sum windows: F. J. Harris (1978), Proc. IEEE 66(1), doi 10.1109/PROC.1978.10837; the
flat top: G. D'Antona and A. Ferrero, Digital Signal Processing for Measurement Systems (2006)."""

WINDOW_NAMES: tuple[str, ...] = tuple(_COSINE_TERMS)
"""Names that the argument `window` may have."""

_WHOLE = 1e-9
"""How far seconds times sample rate may lie from a whole number, relative: far above the rounding
of a product of two decimals (1e-16), far below one sample in the longest record in use (1e-8)."""


def as_signal(name: str, value: ArrayLike) -> FloatArray:
    """Return `value` as an array of finite floats with time on the last axis.

    Args:
        name: What the argument is called, for the message.
        value: The samples, shape (..., time).

    Returns:
        The samples as float64, same shape.

    Raises:
        ArgumentError: Not numeric, no time axis, no sample, or a sample that is not finite.
    """
    try:
        raw = np.asarray(value)
        signal = None if np.iscomplexobj(raw) else raw.astype(np.float64, copy=False)
    except (TypeError, ValueError):
        signal = None
    if signal is None:
        raise ArgumentError(f"{name} is not an array of real numbers; give samples in m/s^2")
    if signal.ndim == 0:
        raise ArgumentError(f"{name} is a single number; give samples with time on the last axis")
    if signal.shape[-1] == 0:
        raise ArgumentError(
            f"{name} has shape {signal.shape}, no sample in time; put time on the last axis"
        )
    broken = signal.size - int(np.count_nonzero(np.isfinite(signal)))
    if broken:
        raise ArgumentError(
            f"{name} has {broken} of {signal.size} samples that are not finite; "
            "end the signal before the first of them"
        )
    return signal


def as_frequency(value: ArrayLike) -> FloatArray:
    """Return frequencies [Hz] as an array of floats, each finite and not negative."""
    try:
        frequency = np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError):
        raise ArgumentError("frequency is not an array of numbers; give values in Hz") from None
    if not bool(np.all(np.isfinite(frequency) & (frequency >= 0.0))):
        raise ArgumentError("frequency holds a value that is negative or not finite; give Hz >= 0")
    return frequency


def sampled_above(sample_rate: float, highest: float) -> float:
    """Return the sample rate [Hz], or raise unless it resolves the frequency `highest` [Hz]."""
    rate = check_positive("sample_rate", sample_rate, "Hz")
    if rate <= 2.0 * highest:
        raise ArgumentError(
            f"sample_rate = {rate:g} Hz cannot show {highest:g} Hz (Nyquist); "
            f"sample faster than {2.0 * highest:g} Hz"
        )
    return rate


def whole_samples(name: str, seconds: float, sample_rate: float) -> int:
    """Return how many samples `seconds` are, or raise unless that is a whole number.

    Args:
        name: What the duration is called, for the message.
        seconds: Duration [s].
        sample_rate: Samples per second [Hz].

    Returns:
        The number of samples, at least one.

    Raises:
        ArgumentError: The duration is not a positive whole number of samples.
    """
    duration = check_positive(name, seconds, "s")
    count = duration * sample_rate
    nearest = round(count)
    if nearest < 1 or abs(count - nearest) > _WHOLE * nearest:
        near = max(nearest, 1) / sample_rate
        raise ArgumentError(
            f"{name} = {duration:g} s is {count:.6g} samples at {sample_rate:g} Hz, which is not "
            f"a whole number; use {near:.9g} s"
        )
    return nearest


def segment_step(overlap: float, length: int) -> int:
    """Return by how many samples one segment starts after the one before.

    Args:
        overlap: Share of a segment that the next one repeats, at least 0 and below 1.
        length: Samples in a segment.

    Returns:
        The step in samples, at least one.

    Raises:
        ArgumentError: The overlap is out of range or not a whole number of samples.
    """
    share = check_finite("overlap", overlap)
    if not 0.0 <= share < 1.0:
        raise ArgumentError(f"overlap = {share:g} is out of range; give a share from 0 to below 1")
    step = (1.0 - share) * length
    nearest = round(step)
    if nearest < 1 or abs(step - nearest) > _WHOLE * length:
        raise ArgumentError(
            f"overlap = {share:g} leaves a step of {step:.6g} samples in a segment of {length}, "
            f"which is not a whole number; use {1.0 - max(nearest, 1) / length:.9g}"
        )
    return nearest


def cut(name: str, signal: FloatArray, length: int, step: int) -> FloatArray:
    """Cut signals into segments.

    Args:
        name: What the signal is called, for the message.
        signal: Samples, shape (..., time).
        length: Samples in a segment.
        step: Samples from the start of one segment to the start of the next.

    Returns:
        A read-only view, shape (..., segments, length); leftover samples are not in it.

    Raises:
        ArgumentError: The signal is shorter than one segment.
    """
    have = signal.shape[-1]
    if have < length:
        raise ArgumentError(
            f"{name} has {have} samples, but one segment takes {length}; give a longer signal or "
            "ask for shorter segments"
        )
    return np.lib.stride_tricks.sliding_window_view(signal, length, axis=-1)[..., ::step, :]


def window_samples(window: str, length: int) -> FloatArray:
    """Return a periodic window of `length` samples.

    Args:
        window: One of `WINDOW_NAMES`.
        length: Number of samples.

    Returns:
        The window, shape (length,), its largest value about 1.

    Raises:
        ArgumentError: The window is unknown.
    """
    if window not in _COSINE_TERMS:
        raise unknown_name("window", window, WINDOW_NAMES)
    angle = 2.0 * np.pi * np.arange(length) / length
    samples = np.zeros(length)
    for order, term in enumerate(_COSINE_TERMS[window]):
        samples += (-1) ** order * term * np.cos(order * angle)
    return samples


def float_if_single(value: FloatArray) -> FloatArray | float:
    """Return a float for an array without axes, and any other array as it is."""
    return float(value) if value.ndim == 0 else value
