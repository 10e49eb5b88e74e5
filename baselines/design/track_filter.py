"""Random track as filtered white noise, seen by the four wheelsets at the physics steps.

A rational density S(Omega) = a Omega^z / prod (Omega^2 + corner^2), one-sided over the angular
wavenumber, is met at speed v as a stationary process in time: white noise of unit intensity through

    H(s) = sqrt(pi a / v) (s / v)^(z/2) / prod (s / v + corner).

Sampled exactly at the physics step. Two ways to bring it to four wheelsets:

- apart: every wheelset has a track of its own, with the same density, independent of the others.
  Who designs for that knows the statistics and takes no use of what a wheelset in front has met.
- in a row: one track, which each wheelset meets later than the first by its distance over the
  speed. Between physics steps the process is sampled at the instants that the trailing wheelsets
  need, so that no delay is rounded.

Not modelled: the band limits of a realised track (2 to 200 m). Its long waves move the carbody
slowly: on German low as realised, `lqg-delay` with preview at 100 ms and 300 km/h spends 20 % less
force (RMS) than in the model, and has 1 % less ride-filtered acceleration.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy import linalg

from railenv.errors import ArgumentError
from railenv.track.spectra import RationalDensity, Spectrum, get_spectrum
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle
from railenv.vehicle.coordinates import WHEELSETS
from railenv.vehicle.suspension import NUM_TRACK

# States of the longest line of track: designs take seconds (250 states: 0.1 s, 750: 17 s).
_LARGEST_LINE = 600
# Instants closer than this share of a physics step are one.
_SAME_INSTANT = 1e-6


@dataclass(frozen=True, eq=False)
class WheelProcess:
    """s_(k+1) = F s_k + N e_k, w_k = H s_k, with e white, of unit covariance.

    Attributes:
        F: Shape (q, q), stable.
        N: Shape (q, noises).
        H: Alignment at wheelsets 1 to 4 [m], then track roll there [rad], shape (8, q).
    """

    F: FloatArray
    N: FloatArray
    H: FloatArray


def wheel_process(
    vehicle: LateralVehicle, track: str, time_step: float, *, preview: bool
) -> WheelProcess:
    """Return what the wheelsets meet, step by step.

    Args:
        vehicle: Gives speed, wheelset places and contact spacing.
        track: Name of a spectrum whose densities are rational.
        time_step: Physics step [s].
        preview: Whether the wheelsets run in a row on one track, or on tracks of their own.

    Raises:
        ArgumentError: The spectrum does not exist or is not rational.
    """
    A, B, C = _time_filter(vehicle, get_spectrum(track))
    if preview:
        return _in_a_row(A, B, C, vehicle.wheelset_setback / vehicle.speed, time_step)
    F, N = _sampled(A, B, time_step)
    order = [kind * len(WHEELSETS) + w for w in range(len(WHEELSETS)) for kind in (0, 1)]
    H = np.zeros((NUM_TRACK, len(WHEELSETS) * len(A)))
    H[order] = repeated(len(WHEELSETS), C)
    return WheelProcess(repeated(len(WHEELSETS), F), repeated(len(WHEELSETS), N), H)


def repeated(times: int, block: FloatArray) -> FloatArray:
    """Return a block-diagonal matrix of equal blocks."""
    return np.asarray(np.kron(np.eye(times), block), dtype=np.float64)


def _time_filter(
    vehicle: LateralVehicle, spectrum: Spectrum
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return x' = A x + B n and (alignment, track roll) = C x for two white noises n."""
    parts: list[tuple[FloatArray, FloatArray, FloatArray]] = []
    per_roll = 2.0 * vehicle.parameters.half_contact_spacing
    for channel, unit in (("alignment", 1.0), ("cross_level", per_roll)):
        density = getattr(spectrum, channel)
        if not isinstance(density, RationalDensity):
            raise ArgumentError(
                f"track = {spectrum.name!r} has no rational density to design for; design for "
                "german_low, german_high or a class of fra (a law carries over to other tracks)"
            )
        # A corner at zero would let the track drift away: its band ends somewhere.
        lowest = 2.0 * math.pi / spectrum.longest_wavelength
        corners = [vehicle.speed * (corner or lowest) for corner in density.corners]
        scale = math.sqrt(math.pi * spectrum.level * density.amplitude / vehicle.speed) / unit
        scale *= vehicle.speed ** (len(corners) - density.zeros / 2)
        parts.append(_cascade(np.array(corners), scale, density.zeros // 2))
    A, B, C = (linalg.block_diag(*matrices) for matrices in zip(*parts, strict=True))
    return A, B, C


def _cascade(
    corners: FloatArray, scale: float, zeros: int
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return scale s^zeros / prod (s + corner) as lags one behind the other, zeros 0 or 1."""
    n = len(corners)
    A = np.diag(-corners) + np.diag(corners[1:], -1)
    B, C = np.zeros((n, 1)), np.zeros((1, n))
    # Every lag behind the first has gain one at rest: states of like size.
    B[0, 0] = scale / float(np.prod(corners[1:]))
    # The derivative of the last lag's state is an output of the states as well.
    C[0] = A[-1] if zeros else np.eye(n)[-1]
    return A, B, C


def _sampled(A: FloatArray, B: FloatArray, time: float) -> tuple[FloatArray, FloatArray]:
    """Return F = exp(A t) and N with N N' = the integral of exp(A s) B B' exp(A' s) (Van Loan)."""
    n = len(A)
    block = np.block([[-A, B @ B.T], [np.zeros((n, n)), A.T]])
    power = linalg.expm(block * time)
    F = power[n:, n:].T
    covariance = F @ power[:n, n:]
    sizes, vectors = linalg.eigh((covariance + covariance.T) / 2)
    return F, vectors * np.sqrt(np.maximum(sizes, 0.0))


def _in_a_row(
    A: FloatArray, B: FloatArray, C: FloatArray, behind: FloatArray, time_step: float
) -> WheelProcess:
    """Return one process and the delay lines that bring it to the wheelsets behind the first.

    A wheelset that is n h - r behind, r in [0, h), meets at t_k what passed the first at
    t_(k-n) + r: the process is sampled at the instants r too, and each keeps a line of its values.
    """
    h, n = time_step, len(A)
    whole = np.ceil(behind / h - _SAME_INSTANT).astype(int)
    rest = np.maximum(whole * h - behind, 0.0)
    instants = sorted({0.0 if r < _SAME_INSTANT * h else float(r) for r in rest})
    which = [int(np.argmin(np.abs(np.array(instants) - r))) for r in rest]
    longest = [
        max(int(whole[w]) for w in range(len(behind)) if which[w] == i)
        for i in range(len(instants))
    ]
    # Values at instant r of the step that ends now, for r > 0, and now, for r = 0: both are known
    # at the end of a step. A line of length L keeps the present value and L - 1 or L older ones.
    lengths = [longest[i] + (1 if instants[i] == 0.0 else 0) for i in range(len(instants))]
    size = n + sum(2 * length for length in lengths)
    if size > _LARGEST_LINE:
        raise ArgumentError(
            f"preview with the last wheelset {behind.max():.3g} s behind the first has {size} "
            f"states of track, more than {_LARGEST_LINE}; design for a higher speed, or without "
            "preview"
        )
    pieces = np.diff([*instants, h])
    F, N = np.zeros((size, size)), np.zeros((size, n * len(pieces)))
    # The process from the present to every instant of the coming step.
    step, noise = np.eye(n), np.zeros((n, N.shape[1]))
    at_instant = [(step, noise)]
    for k, piece in enumerate(pieces):
        f, g = _sampled(A, B, float(piece))
        step, noise = f @ step, f @ noise
        noise[:, k * n : (k + 1) * n] = g
        at_instant.append((step, noise))
    F[:n, :n], N[:n] = at_instant[-1]
    start = n
    starts: list[int] = []
    for i, length in enumerate(lengths):
        f, g = at_instant[-1] if instants[i] == 0.0 else at_instant[i]
        F[start : start + 2, :n], N[start : start + 2] = C @ f, C @ g
        F[start + 2 : start + 2 * length, start : start + 2 * (length - 1)] = np.eye(
            2 * (length - 1)
        )
        starts.append(start)
        start += 2 * length
    H = np.zeros((NUM_TRACK, size))
    for w in range(len(behind)):
        i = which[w]
        age = int(whole[w]) - (0 if instants[i] == 0.0 else 1)
        for kind in (0, 1):
            H[kind * len(WHEELSETS) + w, starts[i] + 2 * age + kind] = 1.0
    return WheelProcess(F, N, H)
