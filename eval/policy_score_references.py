"""What a policy is set beside: passive, sky-hook, the delay-aware LQG, the law that is told all.

Sky-hook is given its best gain at every delay, chosen by the very number that is compared (the ride
index of the worse end) on the very tracks, which favours it; and the best single gain. The LQG is
designed anew for every delay. Nothing here depends on the policy, and nothing is kept between runs
of the command: computing it takes less than a minute, and a stale file would be worse than none.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from baselines import make_controller
from baselines.controller import Controller, LinearFeedback
from eval.policy_score_runs import Comfort, Trial, comfort_of
from eval.told_designs import PLACE, ToldDesigns
from eval.zoo import SKYHOOK_GAINS
from railenv.errors import ArgumentError
from railenv.simulation import DEFAULT_CONTROL_PERIOD
from railenv.stability.lifted_roots import unstable_at
from railenv.units import FloatArray

DESIGNED = {
    "LQG, told the delay": "lqg-delay:delay={delay}",
    "LQG with preview, told the delay": "lqg-delay:delay={delay},preview=1",
    "full information with preview": "optimum:delay={delay},preview=1",
}
"""Laws that are designed for the delay of the column; the last one reads the state without noise
and stands for what is possible."""

PASSIVE = "passive"
SKYHOOK = "sky-hook, best gain at each delay"
SINGLE = "sky-hook, best single gain"
LQG, PREVIEW, YARDSTICK = DESIGNED

MISTAKEN = {
    "LQG": "lqg-delay:delay={delay}",
    "LQG with preview": "lqg-delay:delay={delay},preview=1",
    "LQG, detuned": "lqg-delay:delay={delay},noise=1,effort=1e-2",
    "LQG with preview, detuned": "lqg-delay:delay={delay},preview=1,noise=1,effort=1e-2",
}
"""Laws that are also shown designed for a wrong delay, sharp and detuned."""

SINGLE_FROM = 0.05
"""The best single gain is chosen for delays from here up [s]."""


@dataclass(frozen=True, eq=False)
class References:
    """Comfort of everything that a policy is compared with.

    Attributes:
        rows: Comfort by name, on one trial.
        gains: Best sky-hook gain at each delay [N s/m]; NaN where none of the grid is stable.
        single_gain: Best single gain [N s/m], None where none is stable at all its delays.
        layout: Layout that all but the passive vehicle act on.
    """

    rows: Mapping[str, Comfort]
    gains: FloatArray
    single_gain: float | None
    layout: str = "4"


def passive_and_skyhook(
    trial: Trial,
    progress: Callable[[str], None] | None = None,
    *,
    by_eigenvalues: bool = True,
    layout: str = "4",
) -> References:
    """Run the passive vehicle and every sky-hook gain of the grid.

    Args:
        trial: What is run.
        progress: Called with a word on every run that starts.
        by_eigenvalues: Whether a gain must be stable by the oracle too, not only in the runs; the
            linear vehicle stands for the nonlinear one.
        layout: Layout that the sky-hook acts on, and the laws that are added later.
    """
    tell = progress or (lambda _: None)
    tell(PASSIVE)
    rows = {PASSIVE: comfort_of(make_controller("passive", "passive"), trial)}
    found: dict[float, Comfort] = {}
    unfit = np.ones((len(SKYHOOK_GAINS), len(trial.delays)), dtype=bool)
    for k, gain in enumerate(SKYHOOK_GAINS):
        tell(f"sky-hook, {gain / 1e3:g} kN s/m")
        law = make_controller(f"skyhook:gain={gain}", layout)
        found[gain] = comfort_of(law, trial)
        unfit[k] = found[gain].lost
        if by_eigenvalues:
            unfit[k] |= _unstable(law, trial, layout)
    worse = np.where(unfit, np.inf, np.stack([found[g].worse for g in SKYHOOK_GAINS]))
    best = np.argmin(worse, axis=0)
    none = np.all(unfit, axis=0)
    # Where no gain is stable the lowest one stands in the table, marked as diverged.
    best[none] = 0
    gains = np.array(SKYHOOK_GAINS)[best]
    rows[SKYHOOK] = _pieced([found[gain] for gain in gains], none)
    single = _single(worse, trial)
    if single is not None:
        rows[SINGLE] = found[single]
    return References(rows, np.where(none, np.nan, gains), single, layout)


def with_designs(
    references: References,
    trial: Trial,
    progress: Callable[[str], None] | None = None,
    errors: Sequence[float] = (),
) -> References:
    """Add the laws that are designed for the delay of the column.

    Args:
        references: To what they are added.
        trial: What is run.
        progress: Called with a word on every run that starts.
        errors: Errors of the delay that the laws of `MISTAKEN` are designed for [s].

    Raises:
        ArgumentError: The trial's vehicle is none of the catalogue: laws are designed by name.
    """
    tell = progress or (lambda _: None)
    rows = dict(references.rows)
    if not isinstance(trial.parameters, str):
        raise ArgumentError("laws are designed for catalogued vehicles; give the vehicle's name")
    wanted = [(name, spec, 0.0) for name, spec in DESIGNED.items()]
    wanted += [
        (f"{name}, {error_words(error)}", spec, error)
        for error in errors
        for name, spec in MISTAKEN.items()
    ]
    for name, spec, error in wanted:
        if name in rows:
            continue
        tell(name)
        made = _mistaken(spec, error, references.layout, trial.parameters, trial.speed_kmh)
        laws = ToldDesigns(made)
        noise = 0.0 if name == YARDSTICK else None
        rows[name] = comfort_of(laws, trial, sensor_noise=noise)
    return replace(references, rows=rows)


def layout_beside(policies: Sequence[tuple[str, object]]) -> str:
    """Return the layout of actuators that references have beside some policies: that of them all.

    Args:
        policies: Name and controller of each; one without actuators takes any layout.

    Raises:
        ArgumentError: Two of them act on different layouts.
    """
    found: dict[str, str] = {}
    for name, each in policies:
        own = str(getattr(each, "layout", "4"))
        if own != "passive":
            found.setdefault(own, name)
    if len(found) > 1:
        one, other = (f"{name!r} on layout {own!r}" for own, name in list(found.items())[:2])
        raise ArgumentError(
            f"{one} acts on other actuators than {other}, and the references stand on one layout; "
            "score them one by one"
        )
    return next(iter(found), "4")


def error_words(error: float) -> str:
    """Return in words with which error the delay is told [s]."""
    if error == 0.0:
        return "told the delay"
    word = "much" if error > 0.0 else "little"
    return f"told {abs(1000 * error):g} ms too {word}"


def _mistaken(
    spec: str, error: float, layout: str, vehicle: str, speed_kmh: float
) -> Callable[[float], Controller]:
    """Return what makes the law that is designed for a delay and an error [s]."""

    def made(delay: float) -> Controller:
        told = repr(max(0.0, delay + error))
        return make_controller(spec.replace(PLACE, told), layout, vehicle, speed_kmh)

    return made


def _unstable(law: object, trial: Trial, layout: str) -> list[bool]:
    """Say for each delay whether the sampled loop of a linear feedback has a root that grows."""
    if not isinstance(law, LinearFeedback):
        raise ArgumentError(f"law is a {type(law).__name__}; give a LinearFeedback")
    loop = law.to_sampled_loop(trial.lateral(layout), DEFAULT_CONTROL_PERIOD)
    return [unstable_at(loop, delay) > 0 for delay in trial.delays]


def _single(worse: FloatArray, trial: Trial) -> float | None:
    """Return the gain with the least mean over the longer delays, stable at all of them."""
    longer = [k for k, delay in enumerate(trial.delays) if delay >= SINGLE_FROM]
    if not longer:
        return None
    mean = worse[:, longer].mean(axis=1)
    best = int(np.argmin(mean))
    return SKYHOOK_GAINS[best] if np.isfinite(mean[best]) else None


def _pieced(parts: list[Comfort], diverged: FloatArray) -> Comfort:
    """Return the comfort whose k-th delay is that of the k-th part."""
    fields = ("front", "rear", "force", "weighted", "diverged")
    rows = {f: np.stack([getattr(p, f)[k] for k, p in enumerate(parts)]) for f in fields}
    rows["diverged"] = rows["diverged"] | diverged[:, None]
    return Comfort(**rows)
