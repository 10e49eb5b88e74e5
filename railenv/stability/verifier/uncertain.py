"""Re-checks claims about families of delay systems, sharing nothing with the code that found them.

The family is A = A_0 + sum_k p_k A_k + E, |p_k| <= 1, |E| <= radius (B and K alike). For a claim
of stability this is checked: the evidence counts the nominal loop at delays of the box; beyond a
radius s outweighs all matrices; and pieces of the line Re s = -decay_rate follow each other from
the real axis to the radius, each cut into parts of frequency, delays and parameters on which

    N = V^-1 M V,   M = s I - A + sum_g exp(-s tau_g) B_g K_g

has a comparison matrix C (lower bounds of |N_ii| on the diagonal, minus upper bounds of |N_ij| off
it) with C w = 1 for some w > 0: then N is an H-matrix, so M is regular and no root is there. Taken
from the evidence are only V and the cuts. For a claim of instability the matrices of a member are
checked to belong to the family, exactly, and its count is handed on.
"""

from collections.abc import Callable
from typing import Any

import flint

from railenv.stability.verifier.uncertain_family import (
    Family,
    RejectedError,
    number,
    require,
    whole,
)

_MOST_BITS = 4096


def check_uncertain(
    system: dict[str, Any],
    claim: dict[str, Any],
    evidence: Any,
    count_checker: Callable[[dict[str, Any]], list[str]],
) -> list[str]:
    """Return the reasons against a claim about a family; empty if its evidence carries it.

    Args:
        system: `A B K A_radius B_radius K_radius` as lists of rows and `directions`, a list of
            `A B K`.
        claim: `verdict unstable_roots groups low high decay_rate`.
        evidence: Of the prover.
        count_checker: Returns the reasons against the count of one loop at fixed delays, given as a
            certificate for constant delays: `verdict unstable_roots claim system evidence`.
    """
    before = flint.ctx.prec
    try:
        _check(system, claim, evidence, count_checker)
    except RejectedError as reason:
        return [str(reason)]
    except Exception as error:  # whatever a malformed file leads to is a reason, not a failure
        return [f"claim or evidence is malformed: {type(error).__name__}: {error}"[:300]]
    finally:
        flint.ctx.prec = before
    return []


def _check(
    system: dict[str, Any],
    claim: dict[str, Any],
    evidence: dict[str, Any],
    count_checker: Callable[[dict[str, Any]], list[str]],
) -> None:
    groups, low, high = claim["groups"], claim["low"], claim["high"]
    channels = len(system["K"])
    held = [k for group in groups for k in group]
    require(all(type(k) is int for k in held), "a channel is no whole number")
    require(sorted(held) == list(range(channels)), "the groups do not hold every channel once")
    require(len(groups) == len(low) == len(high), "there is not one interval of delays per group")
    for a, b in zip(low, high, strict=True):
        require(0 <= number(a) <= number(b), f"[{a}, {b}] is no interval of delays")
    count = evidence["count"]
    delays = count["delays"]
    require(len(delays) == len(groups), "the count has not one delay per group")
    for a, tau, b in zip(low, delays, high, strict=True):
        require(number(a) <= number(tau) <= number(b), "the count is not at delays of the box")
    stable = claim["verdict"] == "STABLE"
    roots = claim["unstable_roots"]
    same = type(count["unstable_roots"]) is type(roots) and count["unstable_roots"] == roots
    require(same, "another count is claimed")
    if stable:
        none = type(roots) is int and roots == 0
        require(evidence["method"] == "parts" and none, "stability needs parts and no root")
        counted = system
        flint.ctx.prec = whole(evidence["bits"], 64, _MOST_BITS) + 32
        Family(system, claim, evidence).check(evidence)
    else:
        require(claim["verdict"] == "UNSTABLE", f"nothing is claimed by {claim['verdict']!r}")
        # None: the count, to the right of another line, shows some but not how many in all.
        some = roots is None or (type(roots) is int and roots > 0)
        require(evidence["method"] == "member" and some, "instability needs a member's roots")
        counted = evidence["member"]
        _check_member(system, counted)
    rate = float(claim["decay_rate"])
    region = {"decay_rate": rate, "damping_ratio": None, "max_frequency_hz": None}
    reasons = count_checker(
        {
            "verdict": claim["verdict"],
            "unstable_roots": roots,
            "claim": {
                "kind": "delay box",
                "common": len(groups) == 1,
                "groups": groups,
                "low": delays,
                "high": delays,
                "region": region,
            },
            "system": {
                **{name: counted[name] for name in "ABK"},
                "kind": "delay system",
                "feedthrough": [[0.0] * channels for _ in range(channels)],
            },
            "evidence": count["evidence"],
        }
    )
    require(not reasons, f"the count: {'; '.join(reasons)}")


def _check_member(system: dict[str, Any], member: dict[str, Any]) -> None:
    """Require that a member's doubles are within the family, in rational numbers."""
    p, directions = [number(v) for v in member["parameters"]], system["directions"]
    require(all(-1 <= v <= 1 for v in p), "a parameter is out of its range")
    for name in "ABK":
        middle, radius, given = system[name], system[f"{name}_radius"], member[name]
        for i, row in enumerate(middle):
            require(len(given[i]) == len(row) == len(radius[i]), f"{name} has another size")
            for j, value in enumerate(row):
                away = number(given[i][j]) - number(value)
                for v, direction in zip(p, directions, strict=True):
                    away -= v * number(direction[name][i][j])
                inside = -number(radius[i][j]) <= away <= number(radius[i][j])
                require(inside, f"entry ({i}, {j}) of {name} is outside the family")
        require(len(given) == len(middle), f"{name} has another size")
