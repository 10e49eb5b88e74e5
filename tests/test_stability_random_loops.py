"""The oracle on random loops: exact crossings, counts, boxes and simulations that must agree.

A proof is wrong if anything contradicts it, so every system is answered in several ways that share
little: crossings by elimination, counts by the argument principle, counts and crossings in floating
point, and for some a simulation in time. What is not decided is counted too.
"""

from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import pytest
from scipy.linalg import block_diag

from railenv.errors import ArgumentError, RailenvError
from railenv.stability import (
    CriticalDelays,
    DelaySystem,
    count_unstable,
    critical_delays,
    estimated_critical_delays,
    rightmost_roots,
)
from railenv.stability.certificate import Certificate
from railenv.stability.certify import certify

KINDS = {
    "plain": 0.22,
    "stable": 0.24,
    "weak": 0.12,
    "defective": 0.08,
    "integer": 0.08,
    "nearly tangent": 0.08,
    "scaled": 0.08,
    "tangent": 0.05,
    "identical": 0.05,
}
PLANTED = ("tangent", "identical")
"""Kinds that are made degenerate: a question there may stay undecided."""

CHUNKS, PER_CHUNK = 10, 200
MOST_TESTS = 5000


def oscillator(k: float, c: float, g: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """x'' + c x' + k x = -g x'(t - tau)."""
    return np.array([[0.0, 1.0], [-k, -c]]), np.array([[0.0], [1.0]]), np.array([[0.0, g]])


def random_loop(rng: np.random.Generator) -> tuple[str, DelaySystem]:
    """Draw a loop of 1 to 12 states and 1 to 4 channels."""
    kind = str(rng.choice(list(KINDS), p=list(KINDS.values())))
    n, m = int(rng.integers(1, 13)), int(rng.integers(1, 5))
    A = rng.normal(size=(n, n)) - rng.uniform(0.0, 1.4) * np.sqrt(n) * np.eye(n)
    B, K = rng.normal(size=(n, m)), rng.normal(size=(m, n)) * 10.0 ** rng.uniform(-2.0, 0.5)
    if kind == "stable":
        A -= max(0.0, 0.2 + np.linalg.eigvals(A - B @ K).real.max()) * np.eye(n)
    elif kind == "weak":
        A -= max(0.0, 0.1 + np.linalg.eigvals(A).real.max()) * np.eye(n)
        K *= 0.05
    elif kind == "defective":
        A = rng.normal() * np.eye(n) + np.eye(n, k=1)
    elif kind == "integer":
        A = rng.integers(-2, 3, (n, n)) - 2.0 * np.eye(n)
        B, K = rng.integers(-1, 2, (n, m)) + 0.0, rng.integers(-1, 2, (m, n)) + 0.0
    elif kind == "scaled":
        units = 10.0 ** rng.uniform(-4.0, 4.0, n)
        A, B, K = A * units / units[:, None], B / units[:, None], K * units
    elif kind in ("nearly tangent", "tangent"):
        k, c = rng.uniform(1.0, 4.0), rng.uniform(0.1, 1.0)
        off = rng.choice([-1.0, 1.0]) * 10.0 ** rng.uniform(-9.0, -3.0)
        A, B, K = oscillator(k, c, c if kind == "tangent" else c * (1.0 + off))
    elif kind == "identical":
        k, c, g = rng.uniform(1.0, 4.0), rng.uniform(0.1, 1.0), rng.uniform(0.1, 2.0)
        A, B, K = (block_diag(M, M) for M in oscillator(k, c, g))
    return kind, DelaySystem(A, B, K)


def growth(system: DelaySystem, delays: list[float], rng: np.random.Generator) -> float | None:
    """Growth rate of the state in a simulation, in units of the loop's size; None if not done.

    Runge-Kutta steps of order four, the past interpolated linearly; shares no line with the oracle.
    """
    size = float(np.linalg.norm(system.A) + np.linalg.norm(system.B @ system.K))
    step, steps = 0.05 / size, 12_000
    taus = np.array(delays)
    if np.any((taus > 0.0) & (taus < step)) or taus.max() > 0.2 * step * steps:
        return None
    A = system.A - system.B[:, taus == 0.0] @ system.K[taus == 0.0]
    late = np.flatnonzero(taus > 0.0)
    B, K, lag = system.B[:, late], system.K[late], taus[late] / step
    signal = np.zeros((steps + 1, len(late)))
    start = K @ rng.normal(size=system.num_states)  # what the channels saw before time zero
    x = rng.normal(size=system.num_states)
    columns = np.arange(len(late))
    sizes = np.empty(steps)
    signal[0] = K @ x
    for k in range(steps):
        forces = []
        for part in (0.0, 0.5, 1.0):
            at = k + part - lag
            low = np.clip(np.floor(at).astype(int), 0, steps)
            share = at - low
            past = (1 - share) * signal[low, columns] + share * signal[
                np.minimum(low + 1, max(k, 0)), columns
            ]
            forces.append(-B @ np.where(at < 0.0, start, past))
        f0, f1, f2 = forces
        k1 = A @ x + f0
        k2 = A @ (x + step / 2 * k1) + f1
        k3 = A @ (x + step / 2 * k2) + f1
        k4 = A @ (x + step * k3) + f2
        x = x + step / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        signal[k + 1] = K @ x
        sizes[k] = np.linalg.norm(x)
        if not 1e-100 < sizes[k] < 1e100:
            return float(np.log(sizes[k] / sizes[0]) / (step * k) / size)
    quarter = steps // 4
    before, after = sizes[2 * quarter : 3 * quarter].max(), sizes[3 * quarter :].max()
    return float(np.log(after / before) / (step * quarter) / size)


# The past is interpolated with an error of some 0.05^2 / 8 of the signal, and the state may beat.
_CLEAR_GROWTH = 0.01


@dataclass
class Tally:
    """What came out of a number of systems."""

    seen: Counter[str]

    def share(self, part: str, whole: str) -> float:
        return self.seen[part] / max(1, self.seen[whole])

    def __str__(self) -> str:
        return ", ".join(f"{name} {count}" for name, count in sorted(self.seen.items()))


def examine(seed: int, tally: Tally) -> None:
    """Ask everything about one random system, and assert that nothing contradicts anything."""
    rng = np.random.default_rng([7, seed])
    kind, system = random_loop(rng)
    longest = 10.0 ** rng.uniform(-1.0, 0.7)
    tally.seen["systems"] += 1
    try:
        exact = critical_delays(system, longest)
    except ArgumentError:
        exact = None  # not proved, and the estimate refuses as well
    proved = exact is not None and exact.proved
    tally.seen["proved"] += proved
    # whole numbers are degenerate by chance
    assert proved or kind in (*PLANTED, "integer"), f"{kind}: {exact and exact.reason}"
    if exact is not None and exact.proved:
        check_estimate(kind, system, exact, tally)
        check_staircase(kind, system, exact, rng, tally)
    check_box(kind, system, longest, rng, tally)


def check_estimate(kind: str, system: DelaySystem, exact: CriticalDelays, tally: Tally) -> None:
    """The floating-point search finds the same crossings, where it answers."""
    try:
        estimate = estimated_critical_delays(system, exact.max_delay)
    except RailenvError:
        tally.seen["estimate refused"] += 1
        return
    if kind == "tangent":
        return  # a touch is no crossing for the float search
    assert [c.direction for c in estimate.crossings] == [c.direction for c in exact.crossings]
    assert estimate.unstable_without_delay == exact.unstable_without_delay
    # near a tangent the float search keeps half the digits
    assert [c.delay for c in estimate.crossings] == pytest.approx(
        [c.delay for c in exact.crossings], rel=1e-6
    )


def check_staircase(
    kind: str,
    system: DelaySystem,
    exact: CriticalDelays,
    rng: np.random.Generator,
    tally: Tally,
) -> None:
    """Between crossings the argument principle counts what the crossings say."""
    ends = [0.0, *(c.delay for c in exact.crossings), exact.max_delay]
    gaps = [(a, b) for a, b in pairwise(ends) if b - a > 1e-9 * exact.max_delay]
    for index in rng.permutation(len(gaps))[:2]:
        low, high = gaps[index]
        delay = float(low + (high - low) * rng.uniform(0.05, 0.95))
        answer = certify(system, delay)
        note(kind, answer, "point", tally)
        if not answer.proved:
            continue
        number = exact.unstable_roots(delay)
        assert (answer.verdict == "STABLE") == (number == 0 and exact.marginal == 0)
        if answer.evidence["region"]["decay_rate"] == 0.0:
            assert answer.unstable_roots == number


def check_box(
    kind: str, system: DelaySystem, longest: float, rng: np.random.Generator, tally: Tally
) -> None:
    """No spectrum and no simulation inside a stable box is unstable; a witness is unstable."""
    m = system.num_channels
    if rng.random() < 0.7 or m == 1:
        low, high = np.sort(rng.uniform(0.0, longest, 2))
        box: object = (float(low), float(high))
        lows, highs = np.array([low]), np.array([high])
    else:
        # the more delays vary, the longer the proof: widths shrink with their number
        lows = rng.uniform(0.0, longest / 2, m)
        highs = lows + rng.uniform(0.0, longest / 4, m) * (rng.random(m) < 0.7) / m**2
        box = [(float(a), float(b)) for a, b in zip(lows, highs, strict=True)]
    answer = certify(system, box, most_tests=MOST_TESTS)  # type: ignore[arg-type]
    note(kind, answer, "box", tally)
    if answer.verdict == "STABLE":
        points = rng.uniform(lows, highs, (1, len(lows)))
        for point in [highs, *points]:
            assert counted(system, point.tolist()) in (0, None), f"{kind}: {point} in {box}"
        check_simulation(system, points[0].tolist(), True, rng, tally)
    elif answer.verdict == "UNSTABLE":
        delays = answer.evidence["delays"]
        spread = np.empty(m)
        for group, delay in zip(answer.claim["groups"], delays, strict=True):
            spread[group] = delay
        inside = np.broadcast_to(lows, m) <= spread
        assert np.all(inside & (spread <= np.broadcast_to(highs, m)))
        number = counted(system, spread.tolist())
        tally.seen["witness counted"] += number is not None
        # a pair that has hardly crossed is not seen in floating point
        assert number is None or number > 0 or nearly_marginal(system, spread), f"{kind}: {spread}"
        check_simulation(system, spread.tolist(), False, rng, tally)


def counted(system: DelaySystem, delays: list[float]) -> int | None:
    try:
        return count_unstable(system, delays[0] if len(delays) == 1 else delays)
    except ArgumentError:
        return None


def nearly_marginal(system: DelaySystem, delays: np.ndarray) -> bool:
    root = rightmost_roots(system, delays.tolist(), 1)[0].root
    return abs(root.real) < 1e-9 * abs(root)


def check_simulation(
    system: DelaySystem,
    delays: list[float],
    stable: bool,
    rng: np.random.Generator,
    tally: Tally,
) -> None:
    """A simulation (one system in forty) does not clearly go the other way."""
    if rng.random() > 1 / 40:
        return
    rate = growth(system, list(np.broadcast_to(delays, system.num_channels)), rng)
    if rate is None:
        return
    tally.seen["simulated"] += 1
    assert rate < _CLEAR_GROWTH if stable else rate > -_CLEAR_GROWTH


def note(kind: str, answer: Certificate, what: str, tally: Tally) -> None:
    tally.seen[f"{what} {answer.verdict}"] += 1
    if kind not in PLANTED:
        tally.seen["questions"] += 1
        tally.seen["undecided"] += not answer.proved


def examine_all(seeds: range) -> Tally:
    tally = Tally(Counter())
    for seed in seeds:
        try:
            examine(seed, tally)
        except Exception as error:
            error.add_note(f"random loop with seed {seed}")
            raise
    return tally


@pytest.mark.slow
@pytest.mark.parametrize("chunk", range(CHUNKS))
def test_nothing_contradicts_a_proof_on_two_hundred_random_loops(
    chunk: int, record_property: Callable[[str, object], None]
) -> None:
    tally = examine_all(range(chunk * PER_CHUNK, (chunk + 1) * PER_CHUNK))
    record_property("printed", f"undecided {tally.share('undecided', 'questions'):.2%}: {tally}")
    # all 2000 systems together must stay below 1 %; a chunk of 200 has some 600 questions
    assert tally.share("undecided", "questions") < 0.01, str(tally)
    assert tally.share("proved", "systems") > 0.99, str(tally)
    assert tally.seen["simulated"] > 0


@pytest.mark.slow
def test_nothing_contradicts_a_proof_on_sixty_random_loops() -> None:
    tally = examine_all(range(10_000, 10_060))
    assert tally.share("undecided", "questions") < 0.02, str(tally)
    assert tally.share("proved", "systems") > 0.95, str(tally)


@pytest.mark.parametrize(
    ("delay", "expected"), [(1.0, lambda r: r < 0), (2.0, lambda r: r > 0)], ids=["decay", "growth"]
)
@pytest.mark.slow
def test_the_simulation_itself_grows_past_the_known_crossing(
    delay: float, expected: object
) -> None:
    loop = DelaySystem([[0.0]], [[1.0]], [[1.0]])
    rate = growth(loop, [delay], np.random.default_rng(0))
    assert rate is not None
    assert expected(rate)  # type: ignore[operator]
