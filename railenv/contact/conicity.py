"""Equivalent conicity of a wheelset on a track, EN 15302 (UIC 519).

A free wheelset that rolls without sliding moves by y'' = -dr(y) / (e r0) over the distance, where
dr is the rolling radius on the right minus that on the left, y the shift to the right, e the
lateral distance of the contact points and r0 the nominal radius. Its yaw is y', so that

    yaw^2 = 2 / (e r0) (C - S(y)),    S' = dr,

with S = C at both turning points. One period covers the wavelength L, twice the integral of
dy / yaw between them. A cone of angle g has dr = 2 y tan g and L = 2 pi sqrt(e r0 / (2 tan g))
(Klingel); the equivalent conicity is that of the cone with the same wavelength,

    tan g = (pi / L)^2 2 e r0.

It depends on neither e nor r0, which only scale the wavelength.

The amplitude is half the distance between the turning points. dr is sampled every 0.01 mm (the
standard asks for 0.2 mm or less) and linear in between.

Not known here: elasticity. Contacts are rigid, which makes dr jump where the contact point does.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import brentq

from railenv.contact.geometry import WheelRail, rolling_radius_difference
from railenv.errors import ArgumentError, check_positive
from railenv.units import FloatArray, Metre

AMPLITUDES = (0.001, 0.002, 0.003, 0.004, 0.005, 0.006, 0.007)
"""Amplitudes for which the standard wants the conicity [m]."""

CONTACT_SPACING: Metre = 1.5
"""Lateral distance of the contact points by the standard, for a gauge of 1435 mm [m]."""

_STEP = 1e-5
_LARGEST_AMPLITUDE = 0.015
_PHASES = 8000
_MIDDLES = 401


@dataclass(frozen=True, eq=False)
class Conicity:
    """Equivalent conicity of a wheelset on a track.

    Attributes:
        amplitude: Half the distance of the turning points, shape (n,) [m].
        conicity: Equivalent conicity at each, shape (n,) [1]; NaN where no periodic motion of that
            amplitude exists.
        wavelength: Length of a period, shape (n,) [m]; NaN likewise.
        shift: Lateral shifts at which the geometry was evaluated, shape (k,) [m].
        difference: Rolling radius right minus left at each shift, shape (k,) [m].
    """

    amplitude: FloatArray
    conicity: FloatArray
    wavelength: FloatArray
    shift: FloatArray
    difference: FloatArray


def conicity(pair: WheelRail, amplitudes: Sequence[float] = AMPLITUDES) -> Conicity:
    """Return the equivalent conicity of a wheelset of two equal wheels on two equal rails.

    Args:
        pair: Wheel on rail.
        amplitudes: Amplitudes of the motion [m], each up to 15 mm.

    Returns:
        Conicities, and the rolling-radius difference they follow from.

    Raises:
        ArgumentError: An amplitude is not usable.
    """
    wanted = _amplitudes(amplitudes)
    steps = int(np.ceil(float(wanted.max()) / _STEP - 1e-9)) + 1
    # Both sides are equal, so half the shifts are enough, and the centred wheelset's zero is exact.
    half = _STEP * np.arange(steps + 1, dtype=np.float64)
    right = np.asarray(rolling_radius_difference(pair, half), dtype=np.float64)
    shift = np.concatenate([-half[:0:-1], half])
    difference = np.concatenate([-right[:0:-1], [0.0], right[1:]])
    found = [
        kinematic_wavelength(shift, difference, amplitude, pair.wheel_radius)
        for amplitude in wanted.tolist()
    ]
    wavelength = np.array(found)
    value = conicity_of_wavelength(wavelength, pair.wheel_radius)
    return Conicity(wanted, value, wavelength, shift, difference)


def conicity_of_wavelength(
    wavelength: FloatArray, wheel_radius: float, spacing: float = CONTACT_SPACING
) -> FloatArray:
    """Return tan g = (pi / L)^2 2 e r0, the conicity that belongs to a wavelength (Klingel).

    Args:
        wavelength: Any shape [m].
        wheel_radius: Nominal radius r0 [m].
        spacing: Lateral distance e of the contact points [m].
    """
    return (np.pi / np.asarray(wavelength)) ** 2 * 2.0 * spacing * wheel_radius


def kinematic_wavelength(
    shift: FloatArray,
    difference: FloatArray,
    amplitude: float,
    wheel_radius: float,
    spacing: float = CONTACT_SPACING,
) -> float:
    """Return the wavelength of the free rolling motion of one amplitude (EN 15302).

    With y = m + A sin t between the turning points m - A and m + A, dt takes the place of dy / yaw,
    whose integrand is infinite at both ends, by A cos t dt / yaw, which is not.

    Args:
        shift: Shifts to the right, rising, shape (k,) [m].
        difference: Rolling radius right minus left at each, shape (k,) [m]; it may come from a
            measurement and need not be odd.
        amplitude: Half the distance of the turning points A [m].
        wheel_radius: Nominal radius r0 [m].
        spacing: Lateral distance e of the contact points [m].

    Returns:
        The wavelength of the motion around the place nearest to zero shift [m]; NaN if there is no
        periodic motion of this amplitude, because the shifts do not reach far enough or the
        difference pushes away from the middle.
    """
    check_positive("amplitude", amplitude, "metres")
    check_positive("wheel_radius", wheel_radius, "metres")
    check_positive("spacing", spacing, "metres")
    shift, difference = _curve(shift, difference)
    area = np.concatenate(
        [[0.0], np.cumsum(0.5 * np.diff(shift) * (difference[1:] + difference[:-1]))]
    )
    slope = np.append(np.diff(difference) / np.diff(shift), 0.0)

    def potential(y: FloatArray | float) -> FloatArray:
        """Return S, the exact integral of the linear pieces."""
        index = np.clip(np.searchsorted(shift, y, side="right") - 1, 0, len(shift) - 2)
        t = y - shift[index]
        return area[index] + t * (difference[index] + 0.5 * t * slope[index])

    def uneven(middle: FloatArray | float) -> FloatArray:
        return potential(middle + amplitude) - potential(middle - amplitude)

    low, high = float(shift[0]) + amplitude, float(shift[-1]) - amplitude
    if low > high:
        return float("nan")
    middles = np.linspace(low, high, _MIDDLES, dtype=np.float64)
    balance = np.sign(uneven(middles))
    balance[balance == 0.0] = 1.0
    changes = np.flatnonzero(balance[1:] != balance[:-1])
    if len(changes) == 0:
        return float("nan")
    # A curve that pushes away from its zero has other motions to its sides, which are not meant.
    nearest = changes[int(np.argmin(np.abs(middles[changes] + middles[changes + 1])))]
    ends = float(middles[nearest]), float(middles[nearest + 1])
    middle = float(brentq(lambda m: float(uneven(m)), *ends, xtol=1e-12))
    step = np.pi / _PHASES
    # At midpoints the integrand, 0/0 at both ends, is never asked for there.
    phase = step * (np.arange(_PHASES) + 0.5) - 0.5 * np.pi
    y = middle + amplitude * np.sin(phase)
    level = 0.5 * float(potential(middle - amplitude) + potential(middle + amplitude))
    height = level - potential(y)
    if bool(np.any(height <= 0.0)):
        return float("nan")
    yaw = np.sqrt(2.0 * height / (spacing * wheel_radius))
    return 2.0 * step * float(np.sum(amplitude * np.cos(phase) / yaw))


def harmonic_conicity(shift: FloatArray, difference: FloatArray, amplitude: float) -> float:
    """Return the conicity by harmonic linearisation: another definition, close to the standard's.

    The motion is taken as a sine around zero; the conicity is half the ratio of the first
    harmonic of dr to the amplitude, 1 / (2 pi A) times the integral of dr(A sin t) sin t over a
    period. A cone has its own conicity in either way.

    Args:
        shift: Shifts, rising, shape (k,) [m].
        difference: Rolling radius right minus left, shape (k,) [m].
        amplitude: Amplitude A [m]; the shifts must reach it.
    """
    check_positive("amplitude", amplitude, "metres")
    shift, difference = _curve(shift, difference)
    if -amplitude < shift[0] or amplitude > shift[-1]:
        raise ArgumentError(
            f"amplitude = {amplitude:g} m is beyond the shifts {shift[0]:g} to {shift[-1]:g} m; "
            "give a smaller one or a longer curve"
        )
    sine = np.sin(2.0 * np.pi * (np.arange(_PHASES) + 0.5) / _PHASES)
    radius = np.interp(amplitude * sine, shift, difference)
    return float(np.mean(radius * sine)) / amplitude


def _amplitudes(amplitudes: Sequence[float]) -> FloatArray:
    if len(amplitudes) == 0:
        raise ArgumentError("amplitudes is empty; give one amplitude or more in metres")
    wanted = [check_positive("amplitudes", amplitude, "metres") for amplitude in amplitudes]
    if max(wanted) > _LARGEST_AMPLITUDE:
        raise ArgumentError(
            f"amplitudes = {max(wanted):g} m is beyond what a track allows; give "
            f"{_LARGEST_AMPLITUDE:g} m or less"
        )
    return np.array(wanted)


def _curve(shift: FloatArray, difference: FloatArray) -> tuple[FloatArray, FloatArray]:
    shift = np.asarray(shift, dtype=np.float64)
    difference = np.asarray(difference, dtype=np.float64)
    if shift.ndim != 1 or shift.shape != difference.shape or len(shift) < 2:
        raise ArgumentError(
            f"shift and difference have shapes {shift.shape} and {difference.shape}; give two rows "
            "of the same length, two points or more"
        )
    if not bool(np.isfinite(shift).all() and np.isfinite(difference).all()):
        raise ArgumentError("shift and difference must be finite throughout")
    if bool(np.any(np.diff(shift) <= 0.0)):
        raise ArgumentError("shift must rise from point to point; sort the curve")
    return shift, difference
