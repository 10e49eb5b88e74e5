"""`railenv certify`: a proof of stability or instability, saved and re-checked."""

import argparse
from typing import Any

from baselines import make_controller
from baselines.policies import is_policy
from baselines.policies.history_loop import has_history_loop, to_history_loop
from baselines.policies.shipped import shipped_names
from eval.arguments import (
    parse_delay_box,
    parse_loop,
    parse_number,
    parse_output,
    parse_stepping,
    parse_whole,
    print_json,
    progress_bar,
)
from eval.families import parse_family
from eval.loops import is_typed, parse_linear_loop, parse_sampled_loop
from eval.stability_answers import is_sampled_only, words_of_rest
from eval.told_delay import check_can_be_told
from railenv.errors import ArgumentError, RailenvError
from railenv.stability import (
    Certificate,
    DelaySystem,
    FiniteHistoryLoop,
    SampledLoop,
    certify,
)
from railenv.stability.verifier import verify_certificate
from railenv.vehicle import LateralVehicle

_SAMPLED = ("sampled", "sampled history")

EXIT_OF = {"STABLE": 0, "UNSTABLE": 3, "UNDECIDED": 4}
"""Exit status of each verdict."""


def command_certify(options: argparse.Namespace) -> int:
    """Prove a loop stable or unstable, or re-check a saved certificate."""
    if options.verify is not None:
        return _verify(options)
    if options.delay is None:
        raise ArgumentError(
            "--delay is missing: give 0.19, an interval 0:0.19, or one of either per channel with "
            "commas; or --verify FILE"
        )
    if options.controller is None and options.system is None:
        raise ArgumentError("give the loop: --controller SPEC or --system FILE.npz")
    path = parse_output(options.save, (".json",))
    delay = parse_delay_box(options.delay)
    loop, title = _loop(options)
    policy = _history_loop(options)
    if policy is not None and not isinstance(delay, list):
        loop = policy
    settings: dict[str, Any] = {}
    for name in ("decay_rate", "damping_ratio", "max_frequency_hz", "jitter", "told_error"):
        text = getattr(options, name)
        if text is not None:
            settings[name] = parse_number(name, text)
    if "told_error" in settings:
        _check_told(options, loop, settings["told_error"])
    if options.common_jitter:
        settings["common_jitter"] = True
    if options.max_tests is not None:
        settings["most_tests"] = parse_whole("max_tests", options.max_tests)
    if is_typed(options, "control_period") and not isinstance(
        loop, SampledLoop | FiniteHistoryLoop
    ):
        settings["control_period"] = parse_number("control_period", options.control_period)
    with progress_bar(options, 100, "%") as bar:

        def tell(share: float) -> None:
            bar.update(100.0 * share - bar.n)

        certificate = certify(loop, delay, progress=tell, **settings)
    if path is not None:
        certificate.save(path)
    at_rest = _words_of_policy(options.controller)
    if options.json:
        print_json({**_plain(certificate, options.save), "local": at_rest is not None})
    else:
        _print(title, certificate, options)
        if at_rest is not None:
            print(f"  local: {at_rest}")
    return EXIT_OF[certificate.verdict]


def _loop(options: argparse.Namespace) -> tuple[Any, str]:
    """Return the loop, the family of loops or the sampled loop that is meant, and its title."""
    if options.vary:
        if options.controller is None:
            raise ArgumentError("--vary varies a vehicle; give --controller instead of --system")
        if is_sampled_only(parse_loop(options)[0]):
            raise ArgumentError(
                f"--vary varies a continuous loop and controller {options.controller!r} is a "
                "sampled law; drop --vary and give --control-period"
            )
        varied = ", ".join(options.vary)
        return parse_family(options), f"{options.controller}, {options.vehicle}, {varied}"
    if options.controller is not None and is_typed(options, "control_period"):
        return parse_sampled_loop(options), _title(options, parse_loop(options)[1])
    system, vehicle = parse_linear_loop(options)
    if isinstance(system, SampledLoop) and vehicle is not None:
        raise ArgumentError(
            f"controller {options.controller!r} is a sampled law and has no continuous loop; say "
            f"that its hold is meant: --control-period {system.period:g}"
        )
    return system, _title(options, vehicle)


def _history_loop(options: argparse.Namespace) -> FiniteHistoryLoop | None:
    """Return the loop of a linear policy of finite history, or None for any other."""
    if options.vary or options.controller is None or not is_typed(options, "control_period"):
        return None
    controller, vehicle = parse_loop(options)
    if not has_history_loop(controller):
        return None
    stepping = parse_stepping(options)
    return to_history_loop(controller, vehicle, stepping.control_period, stepping.actuator)


def _check_told(options: argparse.Namespace, loop: Any, told_error: float) -> None:
    """Raise `ArgumentError` if a told error is given and nothing in the loop is told a delay."""
    if options.controller is not None:
        check_can_be_told(parse_loop(options)[0], told_error, options.controller)
    elif isinstance(loop, SampledLoop) and loop.told is None and told_error != 0.0:
        raise ArgumentError(
            f"told_error = {told_error:g} s has no effect on {options.system!r}, whose controller "
            "is not told the delay; leave it out"
        )


def _title(options: argparse.Namespace, vehicle: LateralVehicle | None) -> str:
    if vehicle is None:
        return str(options.system)
    train = f"layout {vehicle.layout}, {options.speed_kmh} km/h, {options.vehicle}"
    return f"{options.controller}, {train}"


def _plain(certificate: Certificate, saved: str | None) -> dict[str, Any]:
    return {
        "verdict": certificate.verdict,
        "unstable_roots": certificate.unstable_roots,
        "seconds": certificate.seconds,
        "reason": certificate.reason,
        "claim": certificate.claim,
        "method": certificate.evidence.get("method"),
        "saved": saved,
    }


def _words_of_policy(spec: str | None) -> str | None:
    """Say what a verdict on a trained policy that is not linear is about; None for the rest."""
    if spec is None or not (is_policy(spec) or spec in shipped_names()):
        return None
    return words_of_rest(make_controller(spec))


def _print(title: str, certificate: Certificate, options: argparse.Namespace) -> None:
    print(title)
    print(f"  {certificate.verdict}: {claim_text(certificate.claim, certificate.verdict)}")
    if certificate.reason:
        print(f"  {certificate.reason}")
    word = "proved" if certificate.proved else "tried for"
    saved = f"; saved to {options.save}" if options.save else ""
    print(f"  {word} {'in ' if certificate.proved else ''}{certificate.seconds:.2f} s{saved}")


def claim_text(claim: dict[str, Any], verdict: str = "STABLE") -> str:
    """Return the question of a certificate in words; unstable is a set if one of it is."""
    every, combination = "every constant delay", "every combination of independent delays"
    if verdict == "UNSTABLE":
        every, combination = "at some constant delay", "at some combination of independent delays"
    if claim["kind"] == "jitter":
        low = high = claim["delays"]
    else:
        low, high = (_listed(claim[end]) for end in ("low", "high"))
    if low == high:
        shown = ", ".join(f"{1000 * tau:.6g}" for tau in dict.fromkeys(low))
        text = f"delay {shown} ms"
    elif len(low) == 1 or claim["kind"] in _SAMPLED:
        text = f"{every} from {1000 * low[0]:.6g} to {1000 * high[0]:.6g} ms"
    else:
        parts = [f"{1000 * a:.6g} to {1000 * b:.6g}" for a, b in zip(low, high, strict=True)]
        text = f"{combination} in {', '.join(parts)} ms"
    region = claim.get("region") or {"decay_rate": claim.get("decay_rate"), "damping_ratio": None}
    if region["damping_ratio"] is not None:
        text += (
            f", damping ratio at least {region['damping_ratio']:g} "
            f"up to {region['max_frequency_hz']:g} Hz"
        )
    elif region["decay_rate"]:
        text += f", decay rate {region['decay_rate']:g} 1/s"
    if claim["kind"] == "uncertain":
        text += ", some member" if verdict == "UNSTABLE" else ", every member"
        text += " of the family"
    if claim["kind"] == "jitter":
        who = "all channels together" if claim["common"] else "each channel by itself"
        text += f" and up to {1000 * claim['jitter']:.6g} ms more, varying in time, {who}"
        if verdict == "UNSTABLE":
            text += ": for some of these"
    if claim["kind"] in _SAMPLED:
        text += f", sampled every {1000 * claim['period']:g} ms"
        if claim["told_error"]:
            text += f", told with an error of up to {1000 * claim['told_error']:g} ms"
    return text


def _listed(value: Any) -> list[float]:
    return list(value) if isinstance(value, list | tuple) else [value]


def _verify(options: argparse.Namespace) -> int:
    """Re-check a certificate; with a loop beside it, that it is about this very loop."""
    for name in ("delay", "save", "jitter", "decay_rate", "damping_ratio", "told_error"):
        if getattr(options, name) is not None:
            raise ArgumentError(
                f"--{name.replace('_', '-')} says what to prove; --verify re-checks what the file "
                "claims: drop one of the two"
            )
    meant = None
    if options.controller is not None or options.system is not None:
        meant = _history_loop(options) or _loop(options)[0]
        if is_typed(options, "control_period") and isinstance(meant, DelaySystem):
            period = parse_number("control_period", options.control_period)
            meant = SampledLoop.from_delay_system(meant, period)
    result = verify_certificate(options.verify, meant)
    certificate = result.certificate
    if options.json:
        print_json(
            {
                "accepted": result.accepted,
                "reasons": list(result.reasons),
                "verdict": certificate["verdict"] if result.accepted else None,
                "unstable_roots": certificate["unstable_roots"] if result.accepted else None,
                "claim": certificate["claim"] if result.accepted else None,
            }
        )
    if not result.accepted:
        raise RailenvError(f"{options.verify} is rejected: {'; '.join(result.reasons)}")
    if not options.json:
        print(f"{options.verify}: accepted")
        verdict = certificate["verdict"]
        print(f"  {verdict}: {claim_text(certificate['claim'], verdict)}")
        if verdict == "UNSTABLE":
            # The file's own words are not checked; these numbers are.
            roots = certificate["unstable_roots"]
            print(f"  unstable roots: {'more than can be counted' if roots is None else roots}")
    return 0
