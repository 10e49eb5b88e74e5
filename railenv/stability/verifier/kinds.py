"""The kinds of claims, and what their parts have to agree on before the evidence is looked at."""

from collections.abc import Callable
from typing import Any

from railenv.stability.verifier.claim import entries
from railenv.stability.verifier.contour import check_delay_box
from railenv.stability.verifier.history import check_history
from railenv.stability.verifier.jitter import check_jitter
from railenv.stability.verifier.quasipolynomial import RejectedError, rational
from railenv.stability.verifier.sampled import check_sampled
from railenv.stability.verifier.uncertain import check_uncertain

Plain = dict[str, Any]

_SYSTEM = {"kind", "A", "B", "K", "feedthrough"}
_FAMILY = _SYSTEM | {"A_radius", "B_radius", "K_radius", "directions"}
_SAMPLED = {"kind", "A", "B", "C", "D", "period", "told", "Ac", "Bc", "Cc", "Dc"}
_HISTORY = {"kind", "A", "B", "C", "D", "period", "told", "measured", "commanded", "spread"}

_JITTER_CLAIM = {"kind", "verdict", "delays", "jitter", "common"}
_SAMPLED_CLAIM = {
    "kind",
    "period",
    "verdict",
    "low",
    "high",
    "told_error",
    "unstable_roots",
    "witness",
    "witness_told",
}
_HISTORY_CLAIM = _SAMPLED_CLAIM - {"unstable_roots"}
_FAMILY_CLAIM = {
    "kind",
    "verdict",
    "unstable_roots",
    "common",
    "groups",
    "low",
    "high",
    "decay_rate",
}


def _delay_box(certificate: Plain) -> None:
    _require_system(certificate, "delay system", _SYSTEM)
    check_delay_box(certificate)


def _jitter(certificate: Plain) -> None:
    _require_system(certificate, "delay system", _SYSTEM)
    _require_claim(certificate, _JITTER_CLAIM, ("verdict",))
    system, evidence = certificate["system"], certificate["evidence"]
    count = evidence["count"]
    # To the right of another line there may be fewer roots than to the right of the axis.
    of_axis = rational(count["region"]["decay_rate"]) == 0
    _require_same_roots(certificate["unstable_roots"], count["roots"] if of_axis else None)

    def counted(part: Plain) -> list[str]:
        claim = {
            "kind": "delay box",
            "common": len(part["groups"]) == 1,
            "groups": part["groups"],
            "low": part["delays"],
            "high": part["delays"],
            "region": part["region"],
        }
        return _reasons(
            {
                "verdict": certificate["verdict"],
                "unstable_roots": part["roots"],
                "claim": claim,
                "system": system,
                "evidence": part,
            }
        )

    _raise(check_jitter(system, certificate["claim"], evidence, counted))


def _uncertain(certificate: Plain) -> None:
    _require_system(certificate, "uncertain delay system", _FAMILY)
    claim = certificate["claim"]
    _require_claim(certificate, _FAMILY_CLAIM, ("verdict", "unstable_roots"))
    if claim["common"] is not (len(claim["groups"]) == 1):
        raise RejectedError("the claim does not say whether all channels share one delay")
    if any(rational(v) != 0 for row in certificate["system"]["feedthrough"] for v in row):
        raise RejectedError("a family of neutral loops cannot be checked")
    _raise(check_uncertain(certificate["system"], claim, certificate["evidence"], _reasons))


def _sampled(certificate: Plain) -> None:
    _require_system(certificate, "sampled loop", _SAMPLED)
    claim, system = certificate["claim"], certificate["system"]
    _require_claim(certificate, _SAMPLED_CLAIM, ("verdict", "unstable_roots"))
    if rational(claim["period"]) != rational(system["period"]):
        raise RejectedError("the claim names another period than the system has")
    if certificate["verdict"] == "STABLE" and (claim["witness"], claim["witness_told"]) != (
        None,
        None,
    ):
        raise RejectedError("a stable loop has no unstable delay")
    _raise(check_sampled(system, claim, certificate["evidence"]))


def _history(certificate: Plain) -> None:
    _require_system(certificate, "finite history loop", _HISTORY)
    claim, system = certificate["claim"], certificate["system"]
    _require_claim(certificate, _HISTORY_CLAIM, ("verdict",))
    if rational(claim["period"]) != rational(system["period"]):
        raise RejectedError("the claim names another period than the system has")
    witness = (claim["witness"], claim["witness_told"])
    if certificate["verdict"] == "STABLE" and witness != (None, None):
        raise RejectedError("a stable loop has no unstable delay")
    check_history(system, claim, certificate["unstable_roots"])


CHECKS: dict[str, Callable[[Plain], None]] = {
    "delay box": _delay_box,
    "jitter": _jitter,
    "uncertain": _uncertain,
    "sampled": _sampled,
    "sampled history": _history,
}
"""The check of each kind; raises `RejectedError`."""


def _require_system(certificate: Plain, kind: str, known: set[str]) -> None:
    entries("system", certificate["system"], known)
    if certificate["system"]["kind"] != kind:
        raise RejectedError(f"the claim is not about a {certificate['system']['kind']!r:.40}")


def _require_claim(certificate: Plain, known: set[str], same: tuple[str, ...]) -> None:
    entries("claim", certificate["claim"], known)
    for name in same:
        here, claimed = certificate[name], certificate["claim"][name]
        if type(here) is not type(claimed) or here != claimed:
            raise RejectedError(f"{name} is not the one of the claim")


def _require_same_roots(claimed: Any, counted: Any) -> None:
    if type(claimed) is not type(counted) or claimed != counted:
        raise RejectedError(f"unstable_roots is {claimed!r:.40}, and {counted!r:.40} is shown")


def _reasons(certificate: Plain) -> list[str]:
    """Return why a count is not to be believed; none if it is."""
    try:
        check_delay_box(certificate)
    except RejectedError as error:
        return [str(error)]
    return []


def _raise(reasons: list[str]) -> None:
    if reasons:
        raise RejectedError("; ".join(reasons))
