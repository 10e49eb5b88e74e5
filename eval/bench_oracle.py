"""Section `oracle` of `railenv bench-speed`: questions about a delayed loop, and who answers them.

The yardstick is `eval.generic_delay`: dense eigenvalues of the collocated state history. For
certificates it can only try a grid of delays, which proves nothing between them.
"""

import importlib
import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines import SkyHook
from eval.bench import Entry, Outcome
from eval.generic_delay import (
    generic_critical_delays,
    generic_roots,
    generic_unstable,
    rightmost_first,
)
from railenv.stability import DelaySystem, critical_delays, rightmost_roots
from railenv.stability.certify import certify
from railenv.units import ComplexArray
from railenv.vehicle import lateral17


@dataclass(frozen=True)
class OracleQuestions:
    """The questions of section `oracle` and the sizes of the generic method.

    Attributes:
        loop: Makes the loop.
        max_delay: Longest delay searched for crossings [s].
        bracket: Two delays around the first crossing, for a peer that has to be told [s].
        delay: Delay at which roots are asked for [s].
        count: How many roots.
        stable: Lowest and highest delay of the interval that is stable throughout [s].
        unstable: A delay beyond it [s].
        box: Highest delay of channels that are delayed independently, from zero [s].
        step: Distance of the delays that the generic method tries on an interval [s].
        corners: Delays that it tries per channel of the box.
        nodes: Its degree.
    """

    loop: Callable[[], DelaySystem]
    max_delay: float = 0.4
    bracket: tuple[float, float] = (0.19, 0.21)
    delay: float = 0.2
    count: int = 4
    stable: tuple[float, float] = (0.0, 0.2019)
    unstable: float = 0.203
    box: float = 0.150
    step: float = 0.01
    corners: int = 3
    nodes: int = 16


def vehicle_loop() -> DelaySystem:
    """The paper's loop: four actuators, sky-hook 35 kN s/m, 300 km/h; 38 states."""
    return SkyHook(35e3, 4).to_delay_system(lateral17("paper_fit", 4, 300.0))


def oracle_entries(ask: OracleQuestions) -> list[Entry]:
    """Return the entries of section `oracle`."""
    channels = ask.loop().num_channels
    crossings = f"all crossings up to {1000 * ask.max_delay:g} ms"
    roots = f"{ask.count} rightmost roots at {1000 * ask.delay:g} ms"
    interval = f"every delay from {1000 * ask.stable[0]:g} to {1000 * ask.stable[1]:g} ms"
    fixed = f"stability at {1000 * ask.unstable:g} ms"
    box = f"{channels} independent delays in 0 to {1000 * ask.box:g} ms"
    along = np.linspace(*ask.stable, round(np.ptp(ask.stable) / ask.step) + 1).tolist()
    across = list(itertools.product(np.linspace(0.0, ask.box, ask.corners), repeat=channels))
    peers = _tdcpy(ask)

    def ours(task: str, method: str, run: Callable[[DelaySystem], Outcome]) -> Entry:
        return Entry(task, f"railenv, {method}", ask.loop, run)

    def yardstick(task: str, run: Callable[[DelaySystem], Outcome], note: str) -> Entry:
        return Entry(task, f"generic, N = {ask.nodes}", ask.loop, run, note)

    def tried(delays: Sequence[Any]) -> Callable[[DelaySystem], Outcome]:
        def run(system: DelaySystem) -> Outcome:
            most = max(generic_unstable(system, delay, ask.nodes) for delay in delays)
            return f"{'unstable' if most else 'stable'} there, {most} unstable roots", False

        return run

    def searched(system: DelaySystem) -> Outcome:
        found = critical_delays(system, ask.max_delay)
        return _crossings([c.delay for c in found.crossings], found.proved)

    def scanned(system: DelaySystem) -> Outcome:
        return _crossings(generic_critical_delays(system, ask.max_delay, ask.step, ask.nodes))

    def rightmost(system: DelaySystem) -> Outcome:
        return _roots([mode.root for mode in rightmost_roots(system, ask.delay, ask.count)])

    def estimated(system: DelaySystem) -> Outcome:
        return _roots(generic_roots(system, ask.delay, ask.count, ask.nodes))

    return [
        ours(crossings, "critical_delays", searched),
        yardstick(crossings, scanned, f"every {1000 * ask.step:g} ms, then bisection to 1e-7 s"),
        *(Entry(crossings, *peer) for peer in peers[:1]),
        ours(roots, "rightmost_roots", rightmost),
        yardstick(roots, estimated, "not corrected"),
        *(Entry(roots, *peer) for peer in peers[1:]),
        ours(interval, "certify", lambda s: _certificate(s, ask.stable)),
        yardstick(interval, tried(along), f"proves nothing: tries {len(along)} delays"),
        ours(fixed, "certify", lambda s: _certificate(s, ask.unstable)),
        yardstick(fixed, tried([ask.unstable]), "proves nothing: estimates the roots"),
        ours(box, "certify", lambda s: _certificate(s, [(0.0, ask.box)] * channels)),
        yardstick(box, tried(across), f"proves nothing: tries {len(across)} sets of delays"),
    ]


def _certificate(system: DelaySystem, delay: Any) -> Outcome:
    answer = certify(system, delay=delay)
    number = answer.unstable_roots
    shown = answer.verdict if number is None else f"{answer.verdict}, {number} unstable roots"
    return shown, answer.proved


def _crossings(delays: Sequence[float], proved: bool = False) -> Outcome:
    first = f", first at {1000 * min(delays):.4f} ms" if delays else ""
    return f"{len(delays)} crossing{'s' * (len(delays) != 1)}{first}", proved


def _roots(roots: Sequence[complex] | ComplexArray) -> Outcome:
    return f"{len(roots)} roots, first at {roots[0]:.6f} 1/s", False


Peer = tuple[str, Callable[[], Any], Callable[[Any], Outcome], str]


def _tdcpy(ask: OracleQuestions) -> list[Peer]:
    """First crossing and rightmost roots by tdcpy (GPL-3), if it happens to be installed."""
    try:
        tdcpy = importlib.import_module("tdcpy")
    except ImportError:
        return []

    def found(system: DelaySystem, delay: float, right_of: float) -> ComplexArray:
        matrices = np.stack([system.A, -system.B @ system.K], axis=2)
        return tdcpy.roots(tdcpy.RDDE(matrices, np.array([0.0, delay])), r=right_of)[0]

    def prepare() -> tuple[DelaySystem, float]:
        system = ask.loop()
        ends = [m.root.real for m in rightmost_roots(system, ask.delay, ask.count + 1)][-2:]
        return system, sum(ends) / 2

    def rightmost(given: tuple[DelaySystem, float]) -> Outcome:
        return _roots(rightmost_first(found(given[0], ask.delay, given[1])))

    def first(system: DelaySystem) -> Outcome:
        low, high = ask.bracket
        while high - low > 1e-7:
            middle = (low + high) / 2
            low, high = (low, middle) if len(found(system, middle, 0.0)) else (middle, high)
        return _crossings([(low + high) / 2])

    told = f"told {1000 * ask.bracket[0]:g} to {1000 * ask.bracket[1]:g} ms, that crossing only"
    return [
        ("tdcpy, bisection", ask.loop, first, told),
        ("tdcpy, roots", prepare, rightmost, "told the half-plane they lie in"),
    ]
