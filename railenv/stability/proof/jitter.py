"""Delays that vary in time, as fast as they like: tau_i(t) = tau_i + delta_i(t), 0 <= delta_i <= J.

With u_i = -K_i x(t - tau_i - delta_i(t)),

    u_i = -K_i x(t - tau_i) + (Delta_i v_i)(t),   v_i(t) = K_i x'(t - tau_i),
    (Delta_i v)(t) = integral of v over [t - delta_i(t), t],

and |(Delta v)(t)|^2 <= delta(t) times the integral of |v|^2 over [t - J, t] (Schwarz), so that the
gain of Delta on L2 is at most J, whatever the measurable function delta (Kao and Lincoln,
Automatica 40 (2004) 1429-1434). From Delta v to v the constant loop answers with Z(s) T(s),

    T(s) = s K M(s)^-1 B,   M(s) = s I - A + sum_i b_i K_i exp(-s tau_i),   Z = diag(exp(-s tau_i)),

proper, with limit K B. If the constant loop is stable, and

    J sup_omega sigma_max( D T(j omega) D^-1 ) < 1

for a constant regular D that commutes with Delta and Z (unitary on the axis), the small-gain
theorem bounds v, and with it x, in L2 by disturbances in L2 that enter at the channels. D is
diagonal if every channel has a jitter of its own. If all share one jitter delta(t), Delta is a
scalar operator times the identity and commutes with any constant matrix: D then has a full block
for channels of the same nominal delay (only those, for the sake of Z).

What a motion before t_0 leaves behind is such a disturbance: the constant loop forgets its state
exponentially, and delta reaches back no further than J. So |x| in L2 over [t_0, infinity) is
bounded by the same multiple of the state at t_0 (the history over the longest delay) for every t_0
and every admissible delta. For linear evolutions that grow at most exponentially, as here, this
means uniform exponential stability (Datko, SIAM J. Math. Anal. 3 (1972) 428-445). STABLE therefore
says: every solution decays exponentially, at one rate for all measurable jitters within [0, J].

The small gain is sufficient, not necessary: UNDECIDED where it fails, and UNSTABLE only where one
constant delay of the family is proved unstable. The interval is [tau_i, tau_i + J], with the
nominal delay at its lower end and not in its middle.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from railenv.errors import check_count, check_not_negative
from railenv.stability.delay_system import DelaySystem
from railenv.stability.proof.contour import Box
from railenv.stability.proof.counting import Effort
from railenv.stability.proof.delay_box import Proof, prove_box
from railenv.stability.proof.jitter_gain import GainBound
from railenv.stability.proof.jitter_loop import JitterLoop
from railenv.stability.proof.jitter_scaling import propose_weight
from railenv.stability.proof.polynomials import UndecidedError
from railenv.stability.proof.precision import precision
from railenv.stability.proof.region import Region
from railenv.units import FloatArray

MOST_TESTS = 20_000
"""Pieces of the axis after which a proof is given up; the vehicle's takes some 1000."""

_FIRST_BITS = 128
# What the estimate of the largest gain may lack; less room than this is not worth a proof.
_MARGIN = 1e-6
# Steps of the last digit that `largest_jitter` goes back at most.
_MOST_STEPS = 4

Answer = tuple[str, str, dict[str, Any]]


def prove_jitter(
    system: DelaySystem,
    delays: float | Sequence[float] | FloatArray,
    jitter: float,
    common: bool = False,
    effort: int = MOST_TESTS,
) -> Answer:
    """Prove a loop stable for all delays that vary in [tau_i, tau_i + jitter] arbitrarily fast.

    Args:
        system: The loop; a neutral one has no answer.
        delays: Nominal delays tau_i, one for all channels or one per channel [s].
        jitter: J [s].
        common: Whether all channels share one delta(t); else each has its own.
        effort: Tests of pieces of the axis after which the proof is given up.

    Returns:
        Verdict "STABLE", "UNSTABLE" (at constant delays of the family, by count) or "UNDECIDED";
        the reason, empty if STABLE; the evidence in plain values, empty if UNDECIDED.

    Raises:
        ArgumentError: A bad delay or jitter, or too many different delays.
        NeutralLoopError: The loop is neutral.
    """
    question = _Question.of(system, delays, common, effort)
    J = check_not_negative("jitter", jitter, "seconds")
    if question.count.verdict == "UNSTABLE":
        return "UNSTABLE", question.count.reason, _witness(question.count_evidence)
    if question.count.verdict != "STABLE":
        return "UNDECIDED", question.count.reason, {}
    reason = ""
    if J == 0.0 or not question.loop.blocks:
        return "STABLE", "", question.evidence([], [], 0)
    weight, gain = propose_weight(question.loop)
    if J * gain < 1.0 - _MARGIN:
        try:
            return "STABLE", "", question.proved(weight, J)
        except UndecidedError as error:
            reason = f"{error}; "
    # The longest constant delay of the family is in it as well.
    longest = _later(question.delays, J)
    other = _Question.of(system, longest, common, effort)
    if other.count.verdict == "UNSTABLE":
        return "UNSTABLE", other.count.reason, _witness(other.count_evidence)
    return (
        "UNDECIDED",
        f"{reason}the small-gain bound allows about {1.0 / gain:.3g} s of jitter, not {J:.6g} s; "
        "this does not mean that the loop is unstable",
        {},
    )


def largest_jitter(
    system: DelaySystem,
    delays: float | Sequence[float] | FloatArray,
    common: bool = False,
    effort: int = MOST_TESTS,
) -> float:
    """Return a jitter up to which the small-gain bound proves a loop stable.

    It is proved for what is returned, so for everything below; beyond it nothing is said.

    Args:
        system: The loop; a neutral one has no answer.
        delays: Nominal delays, one for all channels or one per channel [s].
        common: Whether all channels share one jitter.
        effort: Tests of pieces of the axis after which a proof is given up.

    Returns:
        J, rounded down to three significant digits [s]; infinite if no channel has any effect; 0 if
        nothing is proved, the constant delays included.

    Raises:
        ArgumentError: A bad delay, or too many different delays.
        NeutralLoopError: The loop is neutral.
    """
    question = _Question.of(system, delays, common, effort)
    if question.count.verdict != "STABLE":
        return 0.0
    if not question.loop.blocks:
        return math.inf
    weight, gain = propose_weight(question.loop)
    if not 0.0 < gain < math.inf:
        return 0.0
    step = 10.0 ** (math.floor(-math.log10(gain)) - 2)
    digits = math.floor((1.0 - _MARGIN) / gain / step)
    for number in range(digits, max(digits - _MOST_STEPS, 0), -1):
        # Read from its digits, so that it is the double that prints as them.
        J = float(f"{number * step:.3g}")
        try:
            question.proved(weight, J)
        except UndecidedError:
            continue
        return J
    return 0.0


@dataclass(frozen=True, eq=False)
class _Question:
    """A loop with nominal delays: the count of its unstable roots, and the loop reduced."""

    delays: FloatArray
    groups: list[list[int]]
    count: Proof
    loop: JitterLoop
    effort: int

    @classmethod
    def of(cls, system: DelaySystem, delays: Any, common: bool, effort: int) -> "_Question":
        system.require_retarded("prove_jitter")
        tests = check_count("effort", effort)
        tau = system.delays(delays)
        distinct = list(dict.fromkeys(tau.tolist()))
        groups = [[k for k in range(len(tau)) if tau[k] == value] for value in distinct]
        box = Box(tuple(distinct), tuple(distinct))
        count = prove_box(system, groups, box, Region(), tests)
        return cls(tau, groups, count, JitterLoop.of(system, tau, common), tests)

    @property
    def count_evidence(self) -> dict[str, Any]:
        """The count in plain values, with the channels that share each of its delays."""
        return {
            **self.count.evidence,
            "groups": self.groups,
            "roots": self.count.evidence.get("roots", 0),
        }

    def evidence(self, weight: list[Any], pieces: list[float], bits: int) -> dict[str, Any]:
        """Return the evidence of stability."""
        unit = self.loop.unit
        return {
            "method": "small gain",
            "count": self.count_evidence,
            "weight": weight,
            "unit": float(unit.p) / float(unit.q),
            "pieces": pieces,
            "bits": bits,
        }

    def proved(self, weight: FloatArray, jitter: float) -> dict[str, Any]:
        """Prove the small gain.

        Raises:
            UndecidedError: Not proved.
        """
        effort = Effort(self.effort)
        bits = max(_FIRST_BITS, 4 * self.loop.A.nrows())
        while True:
            try:
                with precision(bits):
                    pieces = GainBound(self.loop, weight, jitter).pieces(effort)
                return self.evidence(weight.tolist(), pieces, bits)
            except UndecidedError:
                if bits > 4 * _FIRST_BITS or effort.spent > effort.allowed:
                    raise
            bits *= 4


def _witness(count: dict[str, Any]) -> dict[str, Any]:
    return {"method": "witness", "count": count}


def _later(delays: FloatArray, jitter: float) -> list[float]:
    """Return tau_i + J as doubles that are not above it."""
    found: list[float] = []
    for tau in delays.tolist():
        late = tau + jitter
        if Fraction(late) > Fraction(tau) + Fraction(jitter):
            late = math.nextafter(late, 0.0)
        found.append(late)
    return found
