"""Delays that vary in time: the small-gain proof, its re-check, and what it is held against."""

import copy
import json
import math
import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from flint import fmpq, fmpq_mat, fmpq_poly
from scipy import linalg

from railenv.errors import ArgumentError, NeutralLoopError
from railenv.stability import DelaySystem, count_unstable, critical_delays
from railenv.stability.proof.jitter import largest_jitter, prove_jitter
from railenv.stability.verifier.contour import check_delay_box
from railenv.stability.verifier.jitter import check_jitter
from railenv.stability.verifier.jitter_gain import GainGap
from railenv.stability.verifier.quasipolynomial import RejectedError

FREQUENCY = 2 * np.pi * 1.2
# The one-degree-of-freedom sky-hook: damping ratio 0.05, gain 0.3 of critical damping.
OSCILLATOR = DelaySystem(
    [[0.0, 1.0], [-(FREQUENCY**2), -2 * 0.05 * FREQUENCY]],
    [[0.0], [1.0]],
    [[0.0, 2 * 0.3 * FREQUENCY]],
)
# Two masses, a spring between them, each with its own actuator and a bit of the other's velocity.
PAIR = DelaySystem(
    [[0.0, 1.0, 0.0, 0.0], [-9.0, -0.2, 4.0, 0.0], [0.0, 0.0, 0.0, 1.0], [6.0, 0.0, -20.0, -0.3]],
    [[0.0, 0.0], [1.0, 0.3], [0.0, 0.0], [0.2, 2.0]],
    [[0.0, 1.0, 0.0, 0.4], [0.5, -0.2, 0.0, 0.8]],
)


def plain(system: DelaySystem) -> dict[str, Any]:
    return {name: getattr(system, name).tolist() for name in ("A", "B", "K", "feedthrough")}


def count_checker(system: DelaySystem) -> Callable[[dict[str, Any]], list[str]]:
    """The verifier's own check of a count at constant delays."""

    def check(count: dict[str, Any]) -> list[str]:
        claim = {
            "kind": "delay box",
            "common": len(count["groups"]) == 1,
            "groups": count["groups"],
            "low": count["delays"],
            "high": count["delays"],
            "region": count["region"],
        }
        verdict = "UNSTABLE" if count["roots"] else "STABLE"
        certificate = {
            "claim": claim,
            "system": plain(system),
            "evidence": count,
            "verdict": verdict,
            "unstable_roots": count["roots"],
        }
        try:
            check_delay_box(certificate)
        except RejectedError as error:
            return [str(error)]
        return []

    return check


def recheck(
    system: DelaySystem,
    delays: list[float],
    jitter: float,
    common: bool,
    evidence: Any,
    verdict: str = "STABLE",
) -> list[str]:
    claim = {"delays": delays, "jitter": jitter, "common": common, "verdict": verdict}
    return check_jitter(plain(system), claim, evidence, count_checker(system))


def accepted(system: DelaySystem, delays: list[float], jitter: float, common: bool) -> None:
    """Prove, pass the evidence through a file's text, and re-check it."""
    verdict, reason, evidence = prove_jitter(system, delays, jitter, common)
    assert (verdict, reason) == ("STABLE", "")
    again = json.loads(json.dumps(evidence, allow_nan=False))
    assert recheck(system, delays, jitter, common, again) == []


def growth(
    system: DelaySystem,
    delays: list[float],
    jitter: float,
    late: np.ndarray,
    step: float,
) -> float:
    """Return the size of the motion in the last tenth of a simulation over its largest size.

    The measurement at step k is that of whole steps ago, and is held for the step: exactly a delay
    that grows from those steps to one more. So the simulation is an exact solution.

    Args:
        system: The loop.
        delays: Nominal delays, one per channel [s].
        jitter: Every delay stays within the nominal one and this much more [s].
        late: For every step and channel, the share of the room that is taken, in [0, 1].
        step: Length of a step [s].
    """
    n, m = system.num_states, system.num_channels
    least = np.ceil(np.array(delays) / step - 1e-9).astype(int)
    most = np.floor((np.array(delays) + jitter) / step + 1e-9).astype(int) - 1
    assert np.all(most > least), "the step is too long for this jitter"
    whole = least + np.rint(late * (most - least)).astype(int)
    flow = linalg.expm(step * np.block([[system.A, system.B], [np.zeros((m, n + m))]]))[:n]
    longest = int(most.max()) + 1
    x = np.zeros((len(late) + longest + 1, n))
    x[: longest + 1] = np.random.default_rng(5).standard_normal(n) / system.state_scale
    for k in range(len(late)):
        old = x[longest + k - whole[k]]
        force = -np.einsum("ij,ij->i", system.K, old)
        x[longest + k + 1] = flow @ np.concatenate([x[longest + k], force])
    size = np.linalg.norm(x / np.abs(x).max(axis=0).clip(1e-300), axis=1)
    return float(size[-len(late) // 10 :].max() / size.max())


def switching(steps: int, channels: int, step: float, common: bool) -> list[np.ndarray]:
    """Delays that jump at random, between the ends at random, and to and fro at some periods."""
    rng = np.random.default_rng(11)
    width = 1 if common else channels
    found = [rng.random((steps, width)), rng.integers(0, 2, (steps, width)).astype(float)]
    for period in (0.02, 0.1, 0.35, 0.5):
        half = max(1, round(period / step / 2))
        square = (np.arange(steps) // half % 2).astype(float)[:, None]
        found.append(np.repeat(square, width, axis=1))
        if width > 1:
            found.append(np.abs(square - np.arange(width) % 2))
    return [np.broadcast_to(late, (steps, channels)) for late in found]


@pytest.mark.parametrize("tau", [0.0, 0.3, 1.0])
def test_the_scalar_loop_has_the_gain_of_its_closed_form(tau: float) -> None:
    a = 0.8
    omega = np.linspace(1e-3, 400.0, 2_000_001)
    gain = a * omega / np.abs(1j * omega + a * np.exp(-1j * omega * tau))
    # T -> a at infinity, which is the supremum without delay; three digits, rounded down.
    exact = 1.0 / max(gain.max(), a)
    assert exact * (1 - 1e-2) < largest_jitter(DelaySystem([[0.0]], [[1.0]], [[a]]), tau) <= exact


@pytest.mark.parametrize(
    ("tau", "jitter", "room"),
    # A float sweep of 3000 points, in whole milliseconds, and the distance to the critical delay.
    [(0.0, 0.145, 0.172), (0.05, 0.115, 0.122), (0.1, 0.067, 0.072), (0.15, 0.019, 0.022)],
)
def test_the_oscillator_stands_the_jitter_of_a_float_sweep(
    tau: float, jitter: float, room: float
) -> None:
    proved = largest_jitter(OSCILLATOR, tau)
    assert proved == pytest.approx(jitter, abs=1.1e-3)
    critical = critical_delays(OSCILLATOR).critical_delay
    assert critical - tau == pytest.approx(room, abs=0.6e-3)
    assert proved < critical - tau
    accepted(OSCILLATOR, [tau], proved, False)


def test_what_is_proved_holds_for_all_jitters_below_and_is_tight_above() -> None:
    proved = largest_jitter(OSCILLATOR, 0.05)
    assert prove_jitter(OSCILLATOR, 0.05, proved / 3)[0] == "STABLE"
    verdict, reason, evidence = prove_jitter(OSCILLATOR, 0.05, proved * 1.01)
    assert (verdict, evidence) == ("UNDECIDED", {})
    assert "small-gain bound allows about 0.115 s" in reason


def test_without_jitter_the_proof_is_that_of_the_constant_delay() -> None:
    verdict, _, evidence = prove_jitter(OSCILLATOR, 0.17, 0.0)
    assert verdict == "STABLE"
    assert evidence["pieces"] == []
    assert recheck(OSCILLATOR, [0.17], 0.0, False, evidence) == []
    assert prove_jitter(OSCILLATOR, 0.175, 0.0)[0] == "UNSTABLE"


@pytest.mark.parametrize(("tau", "jitter", "at"), [(0.2, 0.01, 0.2), (0.1, 0.1, 0.2)])
def test_an_unstable_constant_delay_of_the_family_makes_it_unstable(
    tau: float, jitter: float, at: float
) -> None:
    verdict, reason, evidence = prove_jitter(OSCILLATOR, tau, jitter)
    assert verdict == "UNSTABLE"
    assert f"{at:g} s" in reason
    assert evidence["count"]["roots"] == count_unstable(OSCILLATOR, at) == 2
    assert recheck(OSCILLATOR, [tau], jitter, False, evidence, "UNSTABLE") == []
    # The same count says nothing of a family that ends before it, and nothing of stability.
    assert recheck(OSCILLATOR, [tau / 2], jitter / 2, False, evidence, "UNSTABLE") != []
    assert recheck(OSCILLATOR, [tau], jitter, False, evidence, "STABLE") != []


def test_fast_switching_within_the_proved_jitter_never_makes_the_oscillator_grow() -> None:
    proved, step = largest_jitter(OSCILLATOR, 0.05), 1e-3
    for late in switching(8000, 1, step, common=True):
        # Eight seconds are ten periods: a motion that decays is below a fifth by then.
        assert growth(OSCILLATOR, [0.05], proved, late, step) < 0.2
    # The same simulation does grow where the constant delay at the end is unstable.
    assert growth(OSCILLATOR, [0.05], 0.15, np.ones((10_000, 1)), step) == 1.0


@pytest.mark.slow
@pytest.mark.parametrize("delays", [[0.05, 0.05], [0.02, 0.08]])
def test_two_channels_are_proved_with_one_jitter_and_with_their_own(delays: list[float]) -> None:
    proved = {common: largest_jitter(PAIR, delays, common) for common in (False, True)}
    # Independent jitters include the common one, and a block holds every diagonal.
    assert 0.0 < proved[False] <= proved[True]
    for common, jitter in proved.items():
        accepted(PAIR, delays, jitter, common)
        for late in switching(3000, 2, 5e-3, common):
            assert growth(PAIR, delays, jitter, late, 5e-3) < 0.2


def test_the_unit_of_time_only_scales_the_jitter() -> None:
    slow = DelaySystem(PAIR.A / 8, PAIR.B / 8, PAIR.K)
    assert largest_jitter(slow, 0.4) == pytest.approx(8 * largest_jitter(PAIR, 0.05), rel=0.01)


def test_units_of_the_channels_do_not_change_the_jitter() -> None:
    d = np.array([1e-4, 1e3])
    scaled = DelaySystem(PAIR.A, PAIR.B / d, PAIR.K * d[:, None])
    # The last of three digits: floating point proposes the weight.
    assert largest_jitter(scaled, 0.05) == pytest.approx(largest_jitter(PAIR, 0.05), rel=0.011)


def test_a_channel_twice_stands_what_it_stands_once() -> None:
    twice = DelaySystem(
        OSCILLATOR.A, np.hstack([OSCILLATOR.B] * 2) / 2, np.vstack([OSCILLATOR.K] * 2)
    )
    for common in (False, True):
        assert largest_jitter(twice, 0.05, common) == largest_jitter(OSCILLATOR, 0.05)
        accepted(twice, [0.05, 0.05], 0.1, common)


def test_a_channel_without_effect_does_not_limit_the_jitter() -> None:
    idle = DelaySystem(PAIR.A, PAIR.B, PAIR.K * [[1.0], [0.0]])
    alone = DelaySystem(PAIR.A, PAIR.B[:, :1], PAIR.K[:1])
    assert largest_jitter(idle, 0.05) == largest_jitter(alone, 0.05)
    accepted(idle, [0.05, 0.05], 0.05, False)
    none = DelaySystem(PAIR.A, PAIR.B, PAIR.K * 0.0)
    assert largest_jitter(none, 0.05) == math.inf
    accepted(none, [0.05, 0.05], 50.0, True)


def test_plants_with_poles_on_the_axis_are_no_special_case() -> None:
    # A double integrator under proportional-derivative control: A has a defective double zero.
    system = DelaySystem([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, 1.0]])
    proved = largest_jitter(system, 0.1)
    assert 0.1 < proved < critical_delays(system).critical_delay - 0.1
    accepted(system, [0.1], proved, False)


@pytest.mark.slow
def test_proofs_on_random_loops_are_never_contradicted() -> None:
    rng = np.random.default_rng(3)
    proofs = 0
    for _ in range(9):
        n, m = int(rng.integers(2, 6)), int(rng.integers(1, 4))
        A = rng.standard_normal((n, n)) - 1.5 * np.eye(n)
        system = DelaySystem(A, rng.standard_normal((n, m)), rng.standard_normal((m, n)))
        delays = rng.choice([0.0, 0.05, 0.1], m).tolist()
        common = bool(rng.integers(2))
        proved = largest_jitter(system, delays, common)
        if proved == 0.0:
            assert count_unstable(system, delays) > 0
            continue
        proofs += 1
        for share in (0.5, 1.0):
            assert count_unstable(system, np.array(delays) + share * proved) == 0
        for late in switching(2000, m, 0.02, common)[:4]:
            step = proved / 10
            early = growth(system, [step * round(d / step) for d in delays], proved, late, step)
            assert early < 1.0
        accepted(system, delays, proved, common)
    assert proofs >= 4


def test_a_neutral_loop_and_bad_arguments_are_refused() -> None:
    neutral = DelaySystem(PAIR.A, PAIR.B, PAIR.K, np.eye(2) * 0.1)
    with pytest.raises(NeutralLoopError, match="neutral"):
        prove_jitter(neutral, 0.1, 0.1)
    with pytest.raises(ArgumentError, match="jitter"):
        prove_jitter(OSCILLATOR, 0.1, -0.1)
    with pytest.raises(ArgumentError, match="delay"):
        largest_jitter(OSCILLATOR, math.nan)


def test_a_proof_that_takes_more_than_its_effort_is_undecided() -> None:
    verdict, reason, _ = prove_jitter(OSCILLATOR, 0.05, 0.11, effort=5)
    assert verdict == "UNDECIDED"
    assert "more than 5 tests" in reason


def _set(path: str, value: Any) -> Callable[[dict[str, Any]], None]:
    def change(parts: dict[str, Any]) -> None:
        *way, last = path.split("/")
        place: Any = parts
        for key in way:
            place = place[int(key) if isinstance(place, list) else key]
        place[int(last) if isinstance(place, list) else last] = value

    return change


def _without(first: int, last: int) -> Callable[[dict[str, Any]], None]:
    def change(parts: dict[str, Any]) -> None:
        del parts["evidence"]["pieces"][first:last]

    return change


FAULTS = {
    "a larger jitter": (_set("claim/jitter", 0.25), "not bounded"),
    "other delays": (_set("claim/delays/0", 0.051), "count is for other delays"),
    "a negative jitter": (_set("claim/jitter", -0.1), "negative"),
    "one delay too few": (_set("claim/delays", [0.05]), "one delay per channel"),
    "independent for common": (_set("claim/common", False), "the weight mixes blocks"),
    "a stronger gain": (_set("system/K/0/1", 3.0), "not bounded|roots"),
    "a feedthrough": (_set("system/feedthrough/0/0", 0.1), "neutral"),
    "a system that does not fit": (_set("system/B", [[0.0]]), "B must have"),
    "pieces that end early": (_without(8, 10_000), "high frequency"),
    "pieces that start late": (_without(0, 1), "do not rise from 0"),
    "no pieces": (_set("evidence/pieces", []), "too few"),
    "pieces out of order": (_set("evidence/pieces/3", 0.0), "do not rise"),
    "a number that is none": (_set("evidence/pieces/3", math.nan), "malformed|not finite"),
    "a text for a number": (_set("evidence/pieces/3", "1"), "is not a number"),
    "a weight that is not symmetric": (_set("evidence/weight/0/1", 0.7), "symmetric"),
    "a weight that is not definite": (_set("evidence/weight/0/0", -1.0), "definite"),
    "a weight that does not do": (
        _set("evidence/weight", [[1.0, 0.0], [0.0, 1e6]]),
        "not bounded",
    ),
    "a unit of zero": (_set("evidence/unit", 0.0), "unit"),
    "no precision": (_set("evidence/bits", 2), "bits"),
    "another method": (_set("evidence/method", "witness"), "no evidence of stability"),
    "a count of another verdict": (_set("evidence/count/roots", 2), "does not show stability"),
    "a count of another region": (
        _set("evidence/count/region/decay_rate", -0.5),
        "does not show stability",
    ),
    "a count that is too coarse": (_set("evidence/count/pieces/0", [0.0, 4096.0]), "."),
    "groups that miss a channel": (_set("evidence/count/groups", [[0]]), "no partition"),
    "no count": (_set("evidence/count", None), "malformed"),
    "no evidence": (_set("evidence", {}), "malformed"),
    "evidence of another kind": (_set("evidence", 3), "malformed"),
}


@pytest.fixture(scope="module")
def parts() -> dict[str, Any]:
    """A claim with its evidence, as they come out of a file."""
    jitter = largest_jitter(PAIR, 0.05, common=True)
    evidence = prove_jitter(PAIR, 0.05, jitter, common=True)[2]
    claim = {"delays": [0.05, 0.05], "jitter": jitter, "common": True}
    return json.loads(json.dumps({"claim": claim, "system": plain(PAIR), "evidence": evidence}))


@pytest.mark.parametrize("fault", FAULTS)
@pytest.mark.slow
def test_planted_faults_are_rejected_with_their_reason(parts: dict[str, Any], fault: str) -> None:
    change, message = FAULTS[fault]
    changed = copy.deepcopy(parts)
    change(changed)
    system = plain(PAIR)
    checker = count_checker(PAIR)
    assert check_jitter(system, parts["claim"], parts["evidence"], checker) == []
    reasons = check_jitter(changed["system"], changed["claim"], changed["evidence"], checker)
    assert len(reasons) == 1
    assert re.search(message, reasons[0])


def test_a_piece_over_the_peak_is_not_believed(parts: dict[str, Any]) -> None:
    # Just above what is proved, the pieces away from the peak still hold, the one there does not.
    claim = {**parts["claim"], "jitter": parts["claim"]["jitter"] * 1.02}
    reasons = check_jitter(plain(PAIR), claim, parts["evidence"], count_checker(PAIR))
    assert "not bounded between" in reasons[0]


@pytest.mark.parametrize(("high", "holds"), [(0.999, True), (1.001, False)])
def test_the_inequality_is_shown_up_to_where_it_ends(high: float, holds: bool) -> None:
    # h = N = 1: the gap is 1 - omega^2, one expansion of it is exact.
    one = [(fmpq_poly([1]), 0)]
    gap = GainGap(one, [[one]], fmpq_mat([[1]]), fmpq_mat([[1]]), 0)
    assert gap.between(fmpq(0), fmpq(*high.as_integer_ratio()), 0) is holds


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tau", "jitter", "common"),
    [
        (0.0, 0.165, False),
        (0.0, 0.171, True),
        (0.05, 0.122, False),
        (0.1, 0.0814, False),
        (0.15, 0.0426, False),
    ],
)
def test_the_vehicle_stands_this_jitter(
    loop: DelaySystem, tau: float, jitter: float, common: bool
) -> None:
    proved = largest_jitter(loop, tau, common)
    # Measured; the last of three digits is left to the proposed weight.
    assert proved == pytest.approx(jitter, rel=0.011)
    assert proved < critical_delays(loop).critical_delay - tau
    accepted(loop, [tau] * 4, proved, common)
    for late in switching(15_000, 4, 2e-3, common)[:6]:
        assert growth(loop, [tau] * 4, proved, late, 2e-3) < 0.2
