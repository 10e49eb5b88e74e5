"""The kinds of claims a certificate can make: what is asked, in plain values, and who proves it."""

from collections.abc import Callable, Sequence
from typing import Any, cast

from railenv.errors import ArgumentError
from railenv.stability.certificate import UNDECIDED, UNSTABLE
from railenv.stability.delay_system import DelaySystem
from railenv.stability.history_loop import FiniteHistoryLoop
from railenv.stability.proof.contour import Box
from railenv.stability.proof.counting import Effort
from railenv.stability.proof.delay_box import Proof, prove_box
from railenv.stability.proof.history import MOST_BOXES, prove_history
from railenv.stability.proof.jitter import MOST_TESTS as MOST_JITTER_TESTS
from railenv.stability.proof.jitter import prove_jitter
from railenv.stability.proof.neutral import difference_part_is_unstable
from railenv.stability.proof.region import Region
from railenv.stability.proof.sampled import prove_sampled
from railenv.stability.proof.uncertain import MOST_TESTS as MOST_FAMILY_TESTS
from railenv.stability.proof.uncertain import prove_uncertain
from railenv.stability.sampled_loop import SampledLoop
from railenv.stability.uncertain import UncertainDelaySystem
from railenv.units import FloatArray

MOST_BOX_TESTS = 200_000
"""Tests of pieces and parts of a box after which a proof is given up; some minutes."""

MOST_PIECES = 4_000
"""Pieces of an interval of delays of a sampled loop."""

Groups = Sequence[Sequence[int]]
Progress = Callable[[float], None] | None
Answer = tuple[dict[str, Any], Proof]


def box(
    loop: DelaySystem,
    groups: Groups,
    delays: Box,
    region: Region,
    tests: int | None,
    progress: Progress,
) -> Answer:
    """Constant delays in a box."""
    claim = {
        "kind": "delay box",
        "common": len(groups) == 1,
        "groups": [list(group) for group in groups],
        "low": list(delays.low),
        "high": list(delays.high),
        "region": region.to_plain(),
    }
    if (
        loop.neutral
        and len(groups) == 1
        and delays.high[0] > 0.0
        and region.damping_ratio is None
        and region.decay_rate >= 0.0
        and difference_part_is_unstable(loop.feedthrough)
    ):
        text = (
            "the loop is neutral and its difference part unstable: infinitely many roots to the "
            f"right of the axis at delay {delays.high[0]:.6g} s, and at any other above zero; "
            "low-pass the fed-back signal or give the actuator a lag"
        )
        return claim, Proof(UNSTABLE, None, text, {"method": "neutral", "delays": [delays.high[0]]})
    try:
        most = MOST_BOX_TESTS if tests is None else tests
        return claim, prove_box(loop, groups, delays, region, most, progress)
    except ArgumentError as error:
        return claim, Proof(UNDECIDED, None, str(error), {})


def jitter(
    loop: DelaySystem, delays: FloatArray, width: float, common: bool, tests: int | None
) -> Answer:
    """Delays that vary in time."""
    most = MOST_JITTER_TESTS if tests is None else tests
    try:
        verdict, reason, evidence = prove_jitter(loop, delays, width, common, most)
    except ArgumentError as error:
        verdict, reason, evidence = UNDECIDED, str(error), {}
    claim = {
        "kind": "jitter",
        "verdict": verdict,
        "delays": delays.tolist(),
        "jitter": float(width),
        "common": common,
    }
    roots = None
    if evidence and evidence["count"]["region"]["decay_rate"] == 0.0:
        roots = evidence["count"]["roots"]
    return claim, Proof(verdict, roots, reason, evidence)


def family(
    loops: UncertainDelaySystem,
    groups: Groups,
    delays: Box,
    region: Region,
    tests: int | None,
    progress: Progress,
) -> Answer:
    """Constant delays in a box, for every member of a family."""
    effort = Effort(MOST_FAMILY_TESTS if tests is None else tests, progress=progress)
    verdict, roots, reason, evidence = prove_uncertain(
        loops, delays.low, delays.high, groups, region.decay_rate, effort
    )
    claim = {
        "kind": "uncertain",
        "verdict": verdict,
        "unstable_roots": roots,
        "common": len(groups) == 1,
        "groups": [list(group) for group in groups],
        "low": list(delays.low),
        "high": list(delays.high),
        "decay_rate": region.decay_rate,
    }
    return claim, Proof(verdict, roots, reason, evidence)


def sampled(
    loop: SampledLoop, delay: Any, told_error: float, tests: int | None, progress: Progress
) -> Answer:
    """A sampled loop at one delay, or for every common delay of an interval."""
    low: Any = delay
    high: Any = None
    if isinstance(delay, tuple):
        low, high = cast(tuple[float, float], delay)
    elif isinstance(delay, list) and any(
        isinstance(entry, tuple | list) for entry in cast(list[Any], delay)
    ):
        raise ArgumentError(
            f"delay = {delay!r} has intervals per channel; a sampled loop is proved for one common "
            "interval (low, high), or for one fixed delay per channel"
        )

    def share(reached: float) -> None:
        if progress is not None and high is not None and high > low:
            progress((reached - low) / (high - low))

    most = MOST_PIECES if tests is None else tests
    proof = prove_sampled(loop, low, high, told_error, most, progress=share)
    claim = {"kind": "sampled", "period": loop.period, **proof.claim}
    reason = proof.reason
    if proof.verdict == UNSTABLE:
        reason = f"{proof.unstable_roots} roots outside the unit circle at delay {proof.witness} s"
    return claim, Proof(proof.verdict, proof.unstable_roots, reason, proof.evidence or {})


def history(
    loop: FiniteHistoryLoop,
    delays: tuple[float, float],
    told_error: float,
    boxes: int | None,
    progress: Progress,
) -> Answer:
    """A law of finite history, at every common delay and told delay of a range."""
    low, high = delays
    most = MOST_BOXES if boxes is None else boxes
    proof = prove_history(loop, low, high, told_error, most, progress)
    claim = {
        "kind": "sampled history",
        "verdict": proof.verdict,
        "period": loop.period,
        "low": low,
        "high": high,
        "told_error": told_error,
        "witness": proof.witness,
        "witness_told": proof.witness_told,
    }
    evidence = {"method": "arcs of the unit circle", "arcs": proof.arcs, "boxes": proof.boxes}
    return claim, Proof(proof.verdict, proof.unstable_roots, proof.reason, evidence)


def plain_system(system: DelaySystem) -> dict[str, Any]:
    """Return a system's numbers as lists."""
    return {
        "kind": "delay system",
        "A": system.A.tolist(),
        "B": system.B.tolist(),
        "K": system.K.tolist(),
        "feedthrough": system.feedthrough.tolist(),
    }


def plain_family(loops: UncertainDelaySystem) -> dict[str, Any]:
    """Return a family's numbers as lists."""
    return {**loops.to_plain(), "feedthrough": loops.nominal.feedthrough.tolist()}
