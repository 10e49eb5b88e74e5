"""Sampled loops: lifted map against simulation, proofs against closed forms, the re-checker."""

import copy
import json
from typing import Any

import numpy as np
import pytest
from scipy import linalg

from railenv.errors import ArgumentError
from railenv.stability.delay_system import DelaySystem
from railenv.stability.proof.sampled import SampledProof, prove_sampled
from railenv.stability.proof.sampled_critical import proved_critical_delay
from railenv.stability.sampled import sampled_critical_delay, sampled_growth_rate
from railenv.stability.sampled_loop import SampledLoop
from railenv.stability.verifier.sampled import check_sampled


def scalar(a: float, gain: float, period: float) -> SampledLoop:
    """x' = a x + f, u = -gain x."""
    return SampledLoop.from_delay_system(DelaySystem([[a]], [[1.0]], [[gain]]), period)


def random_loop(rng: np.random.Generator, n: int = 3, m: int = 2, c: int = 2) -> SampledLoop:
    """A random plant with feedthrough and a random dynamic controller."""
    draw = rng.standard_normal
    return SampledLoop(
        A=draw((n, n)) - 1.5 * np.eye(n),
        B=draw((n, m)),
        C=draw((m, n)),
        D=0.2 * draw((m, m)),
        period=0.3,
        Ac=0.4 * draw((c, c)),
        Bc=0.3 * draw((c, m)),
        Cc=0.3 * draw((m, c)),
        Dc=0.3 * draw((m, m)),
    )


def scheduled(period: float = 0.1) -> SampledLoop:
    """An oscillator with a history of measurements and commands, scheduled on the delay."""
    return SampledLoop.from_feedback(
        A=[[0.0, 1.0], [-4.0, -0.2]],
        B=[[0.0], [1.0]],
        C=[[0.0, 1.0]],
        D=[[0.0]],
        period=period,
        measured=[[[[3.0]], [[0.3]]], [[[0.4]], [[0.1]]], [[[0.1]], [[-0.1]]]],
        commanded=[[[[0.2]]], [[[0.1]]], [[[0.0]]]],
        told=[0.0, 0.25, 0.5],
    )


def recheck(loop: SampledLoop, proof: SampledProof) -> list[str]:
    """Send everything through JSON and re-check it."""
    return check_sampled(*json.loads(json.dumps([loop.to_plain(), proof.claim, proof.evidence])))


def simulated(loop: SampledLoop, delays: list[float], told: float, steps: int) -> list[np.ndarray]:
    """Return the measurements y_k, event by event, from a random start without past commands."""
    n, m, T = loop.num_states, loop.num_channels, loop.period
    Ac, Bc, Cc, Dc = loop.controller(told)
    x, xc = np.linspace(1.0, 2.0, n), np.zeros(Ac.shape[0])
    force, now = np.zeros(m), 0.0
    switches: list[tuple[float, int, float]] = []
    block, seen = np.zeros((n + m, n + m)), []
    block[:n, :n], block[:n, n:] = loop.A, loop.B
    for k in range(steps):
        # Switches strictly before the sample act on it, one at the same instant does not.
        for when, channel, value in sorted(s for s in switches if s[0] < k * T - 1e-12):
            x = (linalg.expm(block * (when - now)) @ np.r_[x, force])[:n]
            force[channel], now = value, when
        switches = [s for s in switches if s[0] >= k * T - 1e-12]
        x, now = (linalg.expm(block * (k * T - now)) @ np.r_[x, force])[:n], k * T
        y = loop.C @ x + loop.D @ force
        u = Cc @ xc + Dc @ y
        xc = Ac @ xc + Bc @ y
        switches += [(k * T + tau, i, u[i]) for i, tau in enumerate(delays)]
        seen.append(x.copy())
    return seen


@pytest.mark.parametrize(
    "delays", [[0.0, 0.0], [0.1, 0.1], [0.3, 0.3], [0.65, 0.65], [0.0, 0.47], [0.6, 0.3]]
)
def test_the_lifted_map_steps_as_the_plant_does_between_events(delays: list[float]) -> None:
    loop = random_loop(np.random.default_rng(3))
    F = loop.lifted_matrix(delays)
    z = np.zeros(len(F))
    z[:3] = np.linspace(1.0, 2.0, 3) / loop.state_scale
    for x in simulated(loop, delays, 0.0, 12):
        # Rounding grows with the unstable plant over twelve periods.
        np.testing.assert_allclose(z[:3] * loop.state_scale, x, rtol=1e-9, atol=1e-9)
        z = F @ z


def test_a_scheduled_history_steps_as_the_plant_does_between_events() -> None:
    loop = scheduled()
    F = loop.lifted_matrix(0.27, told=0.31)
    z = np.zeros(len(F))
    z[:2] = np.array([1.0, 2.0]) / loop.state_scale
    for x in simulated(loop, [0.27], 0.31, 12):
        np.testing.assert_allclose(z[:2] * loop.state_scale, x, rtol=1e-10, atol=1e-10)
        z = F @ z


@pytest.mark.parametrize("delay", [0.0, 0.05, 0.0533, 0.196])
def test_static_feedback_is_what_the_older_map_says(loop: DelaySystem, delay: float) -> None:
    sampled = SampledLoop.from_delay_system(loop, 0.01)
    # Two roundings of one map with eigenvalues near one.
    assert sampled.growth_rate(delay) == pytest.approx(
        sampled_growth_rate(loop, delay, 0.01), abs=1e-9
    )


def test_a_history_without_a_past_is_static_feedback(loop: DelaySystem) -> None:
    m = loop.num_channels
    sampled = SampledLoop.from_feedback(loop.A, loop.B, loop.K, np.zeros((m, m)), 0.01, [np.eye(m)])
    assert sampled.growth_rate(0.1) == pytest.approx(sampled_growth_rate(loop, 0.1, 0.01), abs=1e-9)


@pytest.mark.parametrize(("gain", "roots"), [(1.9, 0), (2.1, 1), (-0.1, 1)])
def test_a_held_integrator_without_delay_is_stable_between_zero_and_two(
    gain: float, roots: int
) -> None:
    # x+ = (1 - gain T) x with T = 1
    loop = scalar(0.0, gain, 1.0)
    proof = prove_sampled(loop, 0.0)
    assert proof.verdict == ("UNSTABLE" if roots else "STABLE")
    assert proof.unstable_roots == roots
    assert recheck(loop, proof) == []


def test_a_root_exactly_on_the_circle_is_undecided() -> None:
    # x+ = (1 - 2) x, an eigenvalue of exactly minus one
    for high in (0.0, 0.3):
        proof = prove_sampled(scalar(0.0, 2.0, 1.0), 0.0, high)
        assert (proof.verdict, proof.unstable_roots) in {("UNDECIDED", None), ("UNSTABLE", 2)}
        assert high > 0.0 or "on the unit circle" in proof.reason


@pytest.mark.parametrize("a", [-1.0, 0.0, 0.5])
def test_one_period_of_delay_allows_gains_up_to_one_over_the_held_input(a: float) -> None:
    # z^2 - e^(a T) z + g k = 0 with g = (e^(a T) - 1) / a leaves the circle at k = 1 / g.
    T = 0.4
    g = T if a == 0.0 else np.expm1(a * T) / a
    for share, verdict, roots in ((0.999, "STABLE", 0), (1.001, "UNSTABLE", 2)):
        loop = scalar(a, share / g, T)
        proof = prove_sampled(loop, T)
        assert (proof.verdict, proof.unstable_roots) == (verdict, roots)
        assert recheck(loop, proof) == []


def test_a_pair_of_roots_with_product_one_is_counted() -> None:
    # Two loops side by side with roots 2 and 1/2: the Stein equation itself has no solution.
    plant = DelaySystem(np.diag([np.log(2.0), -np.log(2.0)]), np.zeros((2, 1)), np.zeros((1, 2)))
    loop = SampledLoop.from_delay_system(plant, 1.0)
    proof = prove_sampled(loop, 0.5)
    assert (proof.verdict, proof.unstable_roots) == ("UNSTABLE", 1)
    assert recheck(loop, proof) == []


def test_an_unstable_root_beside_one_on_the_circle_is_proved_but_not_counted() -> None:
    # An integrator that nothing feeds back, beside a root at 2.
    plant = DelaySystem(np.diag([np.log(2.0), 0.0]), np.zeros((2, 1)), np.zeros((1, 2)))
    loop = SampledLoop.from_delay_system(plant, 1.0)
    proof = prove_sampled(loop, 0.5)
    assert (proof.verdict, proof.unstable_roots) == ("UNSTABLE", None)
    assert recheck(loop, proof) == []
    assert proof.evidence is not None
    proof.evidence["point"]["radius"] = 0.9
    assert len(recheck(loop, proof)) == 1


def test_counts_on_random_loops_are_those_of_the_eigenvalues() -> None:
    rng, verdicts = np.random.default_rng(11), set[str]()
    for trial in range(24):
        loop = random_loop(rng)
        delays = [0.55 * (trial % 3), 0.3] if trial % 2 else [0.25 * (trial % 5)] * 2
        z = np.abs(np.linalg.eigvals(loop.lifted_matrix(delays)))
        if np.abs(z - 1.0).min() < 1e-6:
            continue
        proof = prove_sampled(loop, delays)
        assert proof.unstable_roots == np.sum(z > 1.0)
        assert recheck(loop, proof) == []
        verdicts.add(proof.verdict)
    assert verdicts == {"STABLE", "UNSTABLE"}


def test_ranges_on_random_loops_agree_with_a_scan() -> None:
    rng, verdicts = np.random.default_rng(5), set[str]()
    for _ in range(8):
        loop = random_loop(rng, n=2, m=1, c=1)
        worst = max(loop.growth_rate(d) for d in np.linspace(0.1, 0.7, 200))
        proof = prove_sampled(loop, 0.1, 0.7, max_pieces=150)
        if abs(worst) > 0.05:
            assert proof.verdict == ("UNSTABLE" if worst > 0.0 else "STABLE")
        assert proof.verdict == "UNDECIDED" or recheck(loop, proof) == []
        verdicts.add(proof.verdict)
    assert verdicts >= {"STABLE", "UNSTABLE"}


def test_a_range_that_holds_the_critical_delay_is_not_stable() -> None:
    # Integrator with whole delays of one period: critical at k T = 1, d = 1.
    loop = scalar(0.0, 1.0, 1.0)
    proof = prove_sampled(loop, 0.9, 1.1)
    assert proof.verdict == "UNSTABLE"
    assert proof.witness is not None
    assert isinstance(proof.witness, float)
    assert 1.0 < proof.witness <= 1.1
    assert recheck(loop, proof) == []


def test_up_to_the_critical_delay_itself_is_undecided() -> None:
    proof = prove_sampled(scalar(0.0, 1.0, 1.0), 0.9, 1.0)
    assert proof.verdict == "UNDECIDED"
    assert "no proof was found at delay = " in proof.reason


def test_the_critical_delay_is_bracketed() -> None:
    # z^2 - z + k T ((1 - r) z + r) = 0 leaves the circle at k T r = 1.
    bracket = proved_critical_delay(scalar(0.0, 2.0, 0.8), 2.0)
    assert bracket.low is not None
    assert bracket.high is not None
    # tau = r T = 1 / k
    assert bracket.low < 0.5 < bracket.high
    assert bracket.high - bracket.low == pytest.approx(0.5e-3, rel=1e-6)


def test_a_loop_unstable_without_delay_has_its_critical_delay_at_zero() -> None:
    bracket = proved_critical_delay(scalar(0.0, 3.0, 1.0), 2.0)
    assert (bracket.low, bracket.high) == (None, 0.0)


def test_no_crossing_within_the_search_is_proved_stable() -> None:
    bracket = proved_critical_delay(scalar(0.0, 0.1, 0.5), 2.0)
    assert (bracket.low, bracket.high, bracket.reason) == (2.0, None, "")


def test_a_scheduled_controller_is_proved_with_an_error_in_what_it_is_told() -> None:
    loop = scheduled()
    proof = prove_sampled(loop, 0.0, 0.45, told_error=0.02)
    assert proof.verdict == "STABLE"
    assert recheck(loop, proof) == []
    rng = np.random.default_rng(1)
    for delay in rng.uniform(0.0, 0.45, 50):
        told = max(0.0, delay + rng.uniform(-0.02, 0.02))
        assert loop.growth_rate(delay, told) < 0.0


def test_a_large_error_in_what_is_told_is_found_unstable() -> None:
    loop = scheduled()
    # Told nothing of half a second of delay, the full gain is kept, which is too much.
    assert loop.growth_rate(0.5) < 0.0 < loop.growth_rate(0.5, told=0.0)
    proof = prove_sampled(loop, 0.45, 0.5, told_error=0.5)
    assert proof.verdict == "UNSTABLE"
    assert proof.witness_told is not None
    assert recheck(loop, proof) == []


def test_a_range_ending_on_a_whole_period_is_right_continuous_with_feedthrough() -> None:
    loop = random_loop(np.random.default_rng(8), n=2, m=1, c=1)
    T = loop.period
    proof = prove_sampled(loop, 0.0, 2 * T)
    assert proof.verdict == "STABLE"
    assert proof.evidence is not None
    assert proof.evidence["pieces"][-1]["whole"] == 2
    assert recheck(loop, proof) == []


def planted(change: str) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return a proved range with one fault planted."""
    loop = scalar(-0.3, 0.8, 0.5)
    proof = prove_sampled(loop, 0.1, 1.2)
    assert proof.verdict == "STABLE"
    assert recheck(loop, proof) == []
    data, claim, evidence = copy.deepcopy((loop.to_plain(), proof.claim, proof.evidence))
    assert evidence is not None
    pieces = evidence["pieces"]
    if change == "P":
        pieces[1]["P"][1][0] += 0.9 * pieces[1]["P"][1][1]
    elif change == "bounds":
        claim["high"] = 1.3
    elif change == "gap":
        del pieces[1]
    elif change == "shrunk piece":
        pieces[1]["high"] = float(np.nextafter(pieces[1]["high"], 0.0))
    elif change == "system":
        data["A"][0][0] = 1.0
    elif change == "gain":
        data["Dc"][0][0][0] = -3.0
    elif change == "count":
        claim["unstable_roots"] = 1
    elif change == "verdict":
        claim["verdict"] = "UNSTABLE"
    elif change == "size":
        pieces[0]["P"].pop()
    elif change == "not a number":
        pieces[0]["P"][0][0] = float("nan")
    elif change == "negative P":
        pieces[0]["P"][0][0] *= -1.0
    elif change == "another period":
        data["period"] = 0.4
    elif change == "type":
        evidence["pieces"] = 3
    elif change == "bits":
        evidence["bits"] = 10**12
    return data, claim, evidence


_FAULTS = {
    "P": "not positive definite",
    "bounds": "no piece covers",
    "gap": "no piece covers",
    "shrunk piece": "no piece covers",
    "system": "not positive definite",
    "gain": "not positive definite",
    "count": "differ",
    "verdict": "differ",
    "size": "rows",
    "not a number": "triangle",
    "negative P": "not positive definite",
    "another period": "within one period",
    "type": "malformed",
    "bits": "precision",
}


@pytest.mark.parametrize("change", _FAULTS)
def test_a_planted_fault_is_rejected(change: str) -> None:
    reasons = check_sampled(*planted(change))
    assert len(reasons) == 1
    assert _FAULTS[change] in reasons[0]


@pytest.mark.parametrize("change", ["count", "witness", "told", "P", "system"])
def test_a_planted_fault_in_an_instability_is_rejected(change: str) -> None:
    loop = scheduled()
    proof = prove_sampled(loop, 0.45, 0.5, told_error=0.5)
    data, claim, evidence = copy.deepcopy((loop.to_plain(), proof.claim, proof.evidence))
    assert evidence is not None
    if change == "count":
        claim["unstable_roots"] += 1
    elif change == "witness":
        claim["witness"] = 0.46
    elif change == "told":
        claim["witness_told"] = evidence["point"]["told"] = 1.2
    elif change == "P":
        evidence["point"]["P"][0][0] *= 4.0
    else:
        data["A"][1][1] = -4.0
    assert len(check_sampled(data, claim, evidence)) == 1


@pytest.mark.parametrize("what", [None, {}, [], {"bits": 192, "exponents": []}, "x"])
def test_what_is_no_evidence_is_rejected_without_an_exception(what: Any) -> None:
    loop = scalar(0.0, 1.0, 0.5)
    claim = prove_sampled(loop, 0.1).claim
    assert len(check_sampled(loop.to_plain(), claim, what)) == 1


def test_an_undecided_answer_has_nothing_to_re_check() -> None:
    proof = prove_sampled(scalar(0.0, 1.0, 1.0), 0.9, 1.0)
    assert len(recheck(scalar(0.0, 1.0, 1.0), proof)) == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"low": -0.1}, "delay"),
        ({"low": np.nan}, "delay"),
        ({"low": 0.2, "high": 0.1}, "high"),
        ({"low": 0.1, "told_error": -1.0}, "told_error"),
        ({"low": 0.1, "max_pieces": 0}, "max_pieces"),
        ({"low": 0.1, "budget_s": 0.0}, "budget_s"),
        ({"low": 1e6}, "too many parts"),
        ({"low": [0.1, 0.2]}, "entries"),
    ],
)
def test_a_bad_argument_is_refused(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        prove_sampled(scalar(0.0, 1.0, 0.5), **arguments)


@pytest.mark.parametrize("period", [0.0, -1.0, np.nan])
def test_a_bad_period_is_refused(period: float) -> None:
    with pytest.raises(ArgumentError, match="period"):
        scalar(0.0, 1.0, period)


def test_a_matrix_of_the_wrong_shape_is_refused() -> None:
    loop = scheduled()
    for name, value in (("Dc", [[1.0]]), ("told", [0.3, 0.2, 0.1]), ("C", [[1.0, np.inf]])):
        fields = {f: getattr(loop, f) for f in SampledLoop.__dataclass_fields__}
        with pytest.raises(ArgumentError, match=name):
            SampledLoop(**{**fields, name: value})


def test_the_work_allowed_ends_a_search_without_a_verdict(loop: DelaySystem) -> None:
    proof = prove_sampled(SampledLoop.from_delay_system(loop, 0.01), 0.0, 0.19, max_pieces=1)
    assert proof.verdict == "UNDECIDED"
    assert "work allowed" in proof.reason


def test_the_vehicle_is_proved_on_both_sides_of_its_critical_delay(loop: DelaySystem) -> None:
    # 197.05 ms, see test_stability_sampled
    sampled = SampledLoop.from_delay_system(loop, 0.01)
    for delay, roots in ((0.196, 0), (0.197, 0), (0.198, 2)):
        proof = prove_sampled(sampled, delay)
        assert proof.unstable_roots == roots
    assert recheck(sampled, proof) == []


@pytest.mark.slow
def test_the_vehicle_is_proved_stable_for_a_whole_period_of_delays(loop: DelaySystem) -> None:
    sampled = SampledLoop.from_delay_system(loop, 0.01)
    proof = prove_sampled(sampled, 0.1, 0.11)
    assert proof.verdict == "STABLE"
    assert recheck(sampled, proof) == []


def test_the_vehicle_with_different_delays_per_channel_is_proved(loop: DelaySystem) -> None:
    sampled = SampledLoop.from_delay_system(loop, 0.01)
    proof = prove_sampled(sampled, [0.1, 0.12, 0.1, 0.155])
    assert proof.verdict == "STABLE"
    assert recheck(sampled, proof) == []


@pytest.mark.slow
def test_the_vehicle_is_proved_stable_from_no_delay_to_196_ms(loop: DelaySystem) -> None:
    sampled = SampledLoop.from_delay_system(loop, 0.01)
    proof = prove_sampled(sampled, 0.0, 0.196)
    assert proof.verdict == "STABLE"
    assert recheck(sampled, proof) == []
    beyond = prove_sampled(sampled, 0.0, 0.198)
    assert (beyond.verdict, beyond.unstable_roots) == ("UNSTABLE", 2)


@pytest.mark.slow
def test_the_vehicles_critical_delay_is_bracketed(loop: DelaySystem) -> None:
    from railenv.stability import critical_delays

    bracket = proved_critical_delay(SampledLoop.from_delay_system(loop, 0.01), 0.5)
    located = sampled_critical_delay(loop, critical_delays(loop, 0.5), 0.01)
    assert bracket.low is not None
    assert bracket.high is not None
    assert located is not None
    assert bracket.low < located < bracket.high
    assert bracket.high - bracket.low < 0.3e-3


@pytest.mark.slow
@pytest.mark.parametrize(("period", "delay"), [(0.005, 0.19), (0.002, 0.19)])
def test_shorter_periods_are_proved_at_one_delay(
    loop: DelaySystem, period: float, delay: float
) -> None:
    sampled = SampledLoop.from_delay_system(loop, period)
    proof = prove_sampled(sampled, delay)
    assert proof.verdict == "STABLE"
    assert recheck(sampled, proof) == []
