"""All critical delays of a loop with one common delay, proved where it can be.

Exact rational and ball arithmetic find every crossing of the imaginary axis
(`railenv.stability.proof.axis_crossings`): none is missing, the directions are certain, and the
delays are right to the last digits of a double. Loops that are too large for that are answered in
floating point and say so.
"""

import math

from flint import arb

from railenv.errors import ArgumentError, check_positive
from railenv.stability.crossings import (
    CriticalDelays,
    Crossing,
    crossing_speeds,
    estimated_critical_delays,
    refuse_too_many,
)
from railenv.stability.delay_system import DelaySystem
from railenv.stability.modes import Mode, normalised
from railenv.stability.proof.axis_crossings import ProvedCrossing, ProvedCrossings, proved_crossings
from railenv.stability.proof.characteristic import characteristic
from railenv.stability.proof.polynomials import UndecidedError
from railenv.stability.proof.precision import precision

_BITS = 128


def critical_delays(system: DelaySystem, max_delay: float = 2.0) -> CriticalDelays:
    """Find every crossing of the imaginary axis for one common delay in (0, max_delay].

    A root on the imaginary axis without delay counts by where the first bit of delay moves it.

    Args:
        system: The loop; all channels share the delay.
        max_delay: Longest delay searched [s].

    Returns:
        The crossings with directions. `proved` tells whether the list is proved to be complete and
        right; if not, it comes from floating point and `reason` says why. Mode shapes are
        floating point in either case.

    Raises:
        ArgumentError: `max_delay` is not above zero or holds more than `MOST_CROSSINGS` crossings,
            or, without a proof, a root stays on the imaginary axis whatever the delay.
        NeutralLoopError: The loop is neutral.
    """
    system.require_retarded("critical_delays")
    longest = check_positive("max_delay", max_delay, "seconds")
    marginal = 0
    try:
        h = characteristic(system, [range(system.num_channels)])
        marginal = int(h.without_delay[0] == 0)
        found = proved_crossings(h)
    except (UndecidedError, ArgumentError) as error:
        answer = estimated_critical_delays(system, longest)
        return CriticalDelays(
            answer.crossings,
            answer.unstable_without_delay,
            longest,
            # h(0) does not depend on the delay, so this much is certain.
            marginal=marginal,
            reason=str(error),
        )
    with precision(_BITS):
        unit = arb(h.unit)
        frequencies = [float(c.frequency / unit) for c in found.crossings]
    refuse_too_many(frequencies, longest)
    crossings: list[Crossing] = []
    for crossing, omega in zip(found.crossings, frequencies, strict=True):
        with precision(_BITS):
            delays = _delays(crossing, unit, longest)
        if delays:
            crossings += _with_shapes(system, crossing, omega, delays)
    return CriticalDelays(
        tuple(sorted(crossings, key=lambda c: c.delay)),
        _unstable_just_above_zero(found),
        longest,
        marginal=found.marginal,
        proved=True,
        delay_independent=not found.crossings and not found.marginal,
    )


def _unstable_just_above_zero(found: ProvedCrossings) -> int:
    """Count the unstable roots for the first bit of delay."""
    leaving = sum(
        2 * c.multiplicity for c in found.crossings if c.phase.is_zero() and c.direction > 0
    )
    return found.unstable_without_delay + leaving


def _delays(crossing: ProvedCrossing, unit: arb, longest: float) -> list[float]:
    """Return the delays (phase + 2 pi k) / omega above zero, rounded to doubles."""
    delays: list[float] = []
    k = 1 if crossing.phase.is_zero() else 0
    while True:
        delay = float(((crossing.phase + 2 * arb.pi() * k) / crossing.frequency * unit).mid())
        if not delay <= longest:
            return delays
        delays.append(delay)
        k += 1


def _with_shapes(
    system: DelaySystem, crossing: ProvedCrossing, omega: float, delays: list[float]
) -> list[Crossing]:
    """Add mode shapes and speeds, which are estimates; they repeat with the crossing.

    The shape is the same at every repetition; the speed follows from
    dtau/ds = (h_s at delay zero) / h_tau - tau / s.
    """
    base = [
        (speed, normalised(vector * system.state_scale))
        for speed, vector in crossing_speeds(system.scaled, omega, delays[0])
    ]
    base = (base * crossing.multiplicity)[: crossing.multiplicity]
    found: list[Crossing] = []
    for delay in delays:
        for speed, shape in base:
            inverse = 1.0 / speed - (delay - delays[0]) / (1j * omega)
            later = 1.0 / inverse if inverse != 0.0 else complex(math.inf)
            found.append(Crossing(delay, Mode(1j * omega, shape), crossing.direction, later))
    return found
