"""Laws that are robust by design: gains found with the stability oracle in the loop.

Two questions, put to static feedback of sway and yaw (velocity and stroke, four numbers in all):

- `minimise_abscissa`: which gains make the slowest root decay fastest, at the worst of several
  delays? The spectral abscissa is continuous and has kinks and cusps where roots change places
  (Burke, Lewis and Overton, SIAM J. Optimization 15, 2005, 751-779; for delays Vanbiervliet,
  Verheyden, Michiels and Vandewalle, ESAIM: COCV 14, 2008, 478-493).
- `maximise_critical_delay`: which gains stand the longest delay while the ride stays as good as
  asked and every motion decays? The first crossing of the oracle (`critical_delays`) is pushed
  away, and those behind it. It may jump where a pair of crossings is born; the search then stays on
  its side.

Gradients come from the roots' left and right vectors (`baselines.robust_family`), steps from linear
programmes (`baselines.robust_search`). The searches are deterministic; further starts, if asked
for, are drawn with a seed. Their results are local optima.

What comes out is a negative stiffness beside a small sky-hook: force along the stroke, which the
delay turns into damping. Its price: a steady stroke, as in a curve, is answered with a steady force
that enlarges it.
"""

from collections.abc import Callable

import numpy as np

from baselines.controller import LinearFeedback
from baselines.registered import OF_THE_RUN, Registered, designed_for
from baselines.robust_design import LONGEST, RobustDesign, finished, first_crossing
from baselines.robust_family import ModalFamily
from baselines.robust_search import Pieces, SearchResult, minimise_largest
from railenv.errors import ArgumentError, check_count, check_not_negative, check_positive
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle

DELAYS = (0.0, 0.1, 0.2, 0.3)
"""Delays at which the slowest root counts [s]."""

COMFORT_DELAYS = (0.0, 0.05, 0.1, 0.15, 0.2)
"""Delays over which comfort is averaged [s]; decay is asked for at the first, third and last."""

DECAY = 0.25
"""Least decay at those delays [1/s]; that of the best sky-hook gain."""

SIGNALS = ("velocity", "stroke")

_SKY_HOOKS = np.geomspace(2e3, 60e3, 25)
_SPREAD = 0.5
_MOST_STEPS = 25
# By how much comfort [1] and decay [1/s] may be missed at a jump.
_INDEX_MISSED, _DECAY_MISSED = 0.01, 0.02
# What a step must promise: 1e-4 1/s of decay, 0.001 of the ride index, 1 ms of delay.
_DECAY_STEP, _INDEX_STEP, _DELAY_STEP = 1e-4, 1e-3, 1e-3
# Between two results, a constraint that one of them misses weighs this much more.
_DEAR = 100.0


def minimise_abscissa(
    vehicle: LateralVehicle,
    delays: tuple[float, ...] = DELAYS,
    signals: tuple[str, ...] = SIGNALS,
    start: FloatArray | None = None,
    starts: int = 1,
    seed: int = 0,
) -> RobustDesign:
    """Find the gains whose slowest root decays fastest at the worst of several delays.

    Args:
        vehicle: With two or four actuators.
        delays: Delays that count [s].
        signals: Kinds of reading; see `baselines.modal_signals.SIGNALS`.
        start: One gain per reading to begin with [N per unit of the reading]; unless given, the
            sky-hook gain that does best.
        starts: Number of searches; further ones begin at random near the first start.
        seed: Of those.

    Returns:
        The best law found.

    Raises:
        ArgumentError: A delay is negative, a reading does not exist, or the start has another size.
    """
    taus = _checked(delays)
    family = ModalFamily(vehicle, signals)

    def worst(point: FloatArray) -> float:
        return max(family.roots(point, tau)[0][0] for tau in taus)

    def pieces(point: FloatArray) -> Pieces:
        return Pieces([piece for tau in taus for piece in family.roots(point, tau)], [])

    first = (
        min((family.sky_hook(gain) for gain in _SKY_HOOKS), key=worst)
        if start is None
        else _start(family, start)
    )
    found, evaluations = _best(pieces, first, starts, seed)
    return finished(family, first, found, evaluations, taus)


def maximise_critical_delay(
    vehicle: LateralVehicle,
    comfort: float | None = None,
    delays: tuple[float, ...] = COMFORT_DELAYS,
    decay: float = DECAY,
    signals: tuple[str, ...] = SIGNALS,
) -> RobustDesign:
    """Find the gains that stand the longest delay at a given comfort.

    Args:
        vehicle: With two or four actuators.
        comfort: Ride index estimate not to be passed, of the mean square over both floors and all
            `delays` on German low [1]; unless given, midway between the best sky-hook gain and the
            best that these readings can do.
        delays: Delays over which comfort is averaged [s].
        decay: Least decay at the shortest, the middle and the longest of them [1/s].
        signals: Kinds of reading; see `baselines.modal_signals.SIGNALS`.

    Returns:
        The law. Its `start` is the best sky-hook gain. The search ends up to 0.002 of the index
        outside the bound where it meets a jump.

    Raises:
        ArgumentError: A value is out of its range, no sky-hook gain is stable at all delays, or
            comfort or decay cannot be had.
    """
    taus = _checked(delays)
    if taus[-1] >= LONGEST:
        raise ArgumentError(
            f"delays = {delays} must stay below {LONGEST:g} s, to where crossings are looked for"
        )
    least = check_not_negative("decay", decay, "1/s")
    bound = None if comfort is None else check_positive("comfort", comfort)
    family = ModalFamily(vehicle, signals)

    def decays(point: FloatArray) -> list[tuple[float, FloatArray]] | None:
        some = {taus[0], taus[len(taus) // 2], taus[-1]}
        roots = [piece for tau in sorted(some) for piece in family.roots(point, tau)]
        if max(value for value, _ in roots) >= 0.0:
            return None
        return [(value + least, slope) for value, slope in roots]

    def comfortable(point: FloatArray) -> Pieces | None:
        roots = decays(point)
        return None if roots is None else Pieces([family.index(point, taus)], [roots])

    # The most comfortable sky-hook whose first stable window holds all delays.
    usable = [point for point in map(family.sky_hook, _SKY_HOOKS) if decays(point) is not None]
    usable.sort(key=lambda point: family.index(point, taus)[0])
    start = next((point for point in usable if first_crossing(family, point) > taus[-1]), None)
    if start is None:
        raise ArgumentError(
            f"delays = {delays}: no sky-hook gain is stable up to {taus[-1]:g} s; give shorter ones"
        )
    # First as comfortable as can be, then as far in delay as the bound allows: from there, and from
    # the sky-hook itself, since either way may end at a jump.
    calm = minimise_largest(comfortable, start, most_steps=_MOST_STEPS, enough=_INDEX_STEP)
    if bound is None:
        bound = (family.index(start, taus)[0] + family.index(calm.point, taus)[0]) / 2.0

    def tolerant(point: FloatArray) -> Pieces | None:
        roots = decays(point)
        if roots is None:
            return None
        crossings = family.crossings(point, LONGEST)
        if not crossings or crossings[0][0] <= taus[-1]:
            return None  # roots are stable at the delays, but not between them
        index, slope = family.index(point, taus)
        away = [(-delay, -by_gain) for delay, by_gain in crossings]
        return Pieces(away, [roots, [(index - bound, slope)]])

    results = [
        minimise_largest(tolerant, point, most_steps=_MOST_STEPS, enough=_DELAY_STEP)
        for point in (calm.point, start)
        if tolerant(point) is not None
    ]
    found = min(results, key=lambda result: result.merit + _DEAR * result.missed)
    evaluations = calm.evaluations + sum(result.evaluations for result in results)
    design = finished(family, start, found, evaluations, taus)
    if not design.index[1] <= bound + _INDEX_MISSED:
        raise ArgumentError(
            f"comfort = {bound:g} cannot be had: the search came to {design.index[1]:.4g}; give "
            "more, or leave it out"
        )
    slowest = max(value for value, _ in decays(found.point) or [(np.inf, start)])
    if slowest > _DECAY_MISSED:
        raise ArgumentError(
            f"decay = {least:g} 1/s cannot be had beside that comfort: the search came to "
            f"{least - slowest:.3g}; give less"
        )
    return design


def _checked(delays: tuple[float, ...]) -> tuple[float, ...]:
    """Return delays in rising order."""
    values = tuple(sorted(check_not_negative("delays", delay, "seconds") for delay in delays))
    if not values:
        raise ArgumentError("delays is empty; give at least one delay in seconds")
    return values


def _start(family: ModalFamily, start: FloatArray) -> FloatArray:
    gains = np.asarray(start, dtype=np.float64)
    if gains.shape != family.scale.shape or not np.all(np.isfinite(gains)):
        raise ArgumentError(
            f"start has shape {gains.shape}; it must be {len(family.scale)} finite gains, one for "
            f"each of {', '.join(family.signals.names)}"
        )
    return family.point(gains)


def _best(
    pieces: Callable[[FloatArray], Pieces], first: FloatArray, starts: int, seed: int
) -> tuple[SearchResult, int]:
    """Search from a start and from points near it; return the best, and all evaluations."""
    rng = np.random.default_rng(check_count("seed", seed, 0))
    others = [
        first + _SPREAD * rng.normal(size=len(first))
        for _ in range(check_count("starts", starts) - 1)
    ]
    results = [minimise_largest(pieces, point, enough=_DECAY_STEP) for point in (first, *others)]
    best = min(results, key=lambda result: result.merit)
    return best, sum(result.evaluations for result in results)


def _spread(longest: float, number: int) -> tuple[float, ...]:
    """Return so many delays from zero to the longest; one if that is zero."""
    last = check_not_negative("delay", longest, "seconds")
    if last >= LONGEST:
        raise ArgumentError(f"delay = {last:g} s is too long; give less than {LONGEST:g} s")
    return tuple(float(tau) for tau in np.linspace(0.0, last, number)) if last else (0.0,)


def _fastest(vehicle: LateralVehicle, delay: float, design_kmh: float) -> LinearFeedback:
    design = minimise_abscissa(designed_for(vehicle, design_kmh), _spread(delay, len(DELAYS)))
    return design.controller


def _longest(
    vehicle: LateralVehicle, comfort: float, delay: float, decay: float, design_kmh: float
) -> LinearFeedback:
    bound = None if comfort == 0.0 else comfort
    delays = _spread(delay, len(COMFORT_DELAYS))
    return maximise_critical_delay(
        designed_for(vehicle, design_kmh), bound, delays, decay
    ).controller


ROBUST_ABSCISSA = Registered(
    "robust-abscissa",
    "sway and yaw gains whose slowest root decays fastest at the worst delay up to a longest one",
    "this project; Burke, Lewis, Overton 2005; Vanbiervliet et al. 2008",
    {"delay": (DELAYS[-1], "s"), "design_kmh": (OF_THE_RUN, "km/h")},
    _fastest,
)

ROBUST_DELAY = Registered(
    "robust-delay",
    "sway and yaw gains that stand the longest delay at a given comfort (0: better than sky-hook)",
    "this project; Madsen 1975 for the search",
    {
        "comfort": (0.0, "ride index"),
        "delay": (COMFORT_DELAYS[-1], "s"),
        "decay": (DECAY, "1/s"),
        "design_kmh": (OF_THE_RUN, "km/h"),
    },
    _longest,
)
