"""`railenv roots`: rightmost characteristic roots, or a sampled law's growth rates."""

import argparse
from typing import Any

from baselines import Controller
from eval.arguments import parse_delay, parse_loop, parse_whole, print_json
from eval.loops import controllers_loop, loop_name, parse_linear_loop, parse_method
from eval.stability_answers import enclosed_root_answers, root_answers, words_of_rest
from railenv.errors import ArgumentError, NeutralLoopError, check_count
from railenv.stability import (
    DelaySystem,
    SampledLoop,
    enclosed_roots,
    lifted_roots,
    pade_roots,
    rightmost_roots,
)
from railenv.vehicle import LateralVehicle


def command_roots(options: argparse.Namespace) -> None:
    """Print the rightmost characteristic roots at one delay."""
    delay = parse_delay(options.delay)
    count = check_count("count", parse_whole("count", options.count))
    method, order = parse_method(options.method, ("exact",))
    if options.controller is not None:
        controller, vehicle = parse_loop(options)
        system = controllers_loop(options, controller, vehicle)
        if isinstance(system, SampledLoop):
            _sampled_law(options, controller, system, vehicle, delay, count)
            return
    else:
        system, vehicle = parse_linear_loop(options)
    if isinstance(system, SampledLoop):
        raise ArgumentError(
            f"{options.system!r} holds a sampled loop, and the characteristic roots are those of a "
            "continuous one; use certify or critical-delay"
        )
    proved, region = False, None
    if order is None:
        answers, region = _enclosed(system, delay, count, vehicle)
        proved = region is not None
    else:
        if isinstance(delay, tuple):
            raise ArgumentError("the Pade method takes one delay for all channels; give one number")
        answers = root_answers(pade_roots(system, delay, order, count), vehicle)
    if options.json:
        print_json(
            {"method": options.method, "proved": proved, "right_of": region, "roots": answers}
        )
        return
    print(
        f"{loop_name(options, vehicle)}, delay {options.delay} s, method {method}"
        + (f":{order}" if order is not None else "")
    )
    verdict = _verdict(answers)
    word = "proved" if proved else "not proved"
    print(f"  {verdict} at this delay (continuous feedback, {word})")
    _print_roots(answers)
    if proved:
        print(
            f"  complete: no other root is right of {region:.6g} 1/s; each is enclosed to "
            f"{max(root['radius'] for root in answers):.1e} 1/s"
        )


def _sampled_law(
    options: argparse.Namespace,
    controller: Controller,
    loop: SampledLoop,
    vehicle: LateralVehicle,
    delay: float | tuple[float, ...],
    count: int,
) -> None:
    """Print the dominant eigenvalues of a sampled law's one-period map as growth rates."""
    if options.method != "exact":
        raise ArgumentError(
            f"method = {options.method!r} is for continuous loops and {options.controller!r} is a "
            "sampled law; drop --method"
        )
    answers = root_answers(lifted_roots(loop, delay, count), vehicle)
    at_rest = words_of_rest(controller)
    if options.json:
        shown = {"control_period_s": loop.period, "right_of": None, "roots": answers}
        local = at_rest is not None
        print_json({"method": "sampled", "proved": False, "local": local, **shown})
        return
    print(f"{loop_name(options, vehicle)}, delay {options.delay} s, method sampled")
    print(
        f"  {_verdict(answers)} at this delay (sampled every {1000 * loop.period:g} ms, "
        "growth rates ln(z) / T, not proved)"
    )
    if at_rest is not None:
        print(f"  local: {at_rest}")
    _print_roots(answers)


def _print_roots(answers: list[dict[str, Any]]) -> None:
    print("         re [1/s]      im [1/s]  |s|/2pi [Hz]  damping ratio  mode")
    for root in answers:
        print(
            f"    {root['re']:13.6f} {root['im']:13.6f}  {root['frequency_hz']:12.4f}  "
            f"{root['damping_ratio']:13.5f}  {root['mode'] or '-'}"
        )


def _verdict(answers: list[dict[str, Any]]) -> str:
    """Say where the rightmost root is; a ball that meets the imaginary axis decides nothing."""
    if any(root["re"] > root.get("radius", 0.0) for root in answers):
        return "UNSTABLE"
    if any(root["re"] >= -root.get("radius", 0.0) for root in answers):
        return "a root on the imaginary axis, or not told from it: neither stable nor unstable"
    return "stable"


def _enclosed(
    system: DelaySystem,
    delay: float | tuple[float, ...],
    count: int,
    vehicle: LateralVehicle | None,
) -> tuple[list[dict[str, Any]], float | None]:
    """Return proved roots and the line they are all of to the right of; estimates and None else."""
    try:
        found = enclosed_roots(system, delay, count)
    except NeutralLoopError:
        raise
    except ArgumentError:
        return root_answers(rightmost_roots(system, delay, count), vehicle), None
    return enclosed_root_answers(found, vehicle), found.right_of
