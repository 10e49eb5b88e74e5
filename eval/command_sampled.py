"""`railenv critical-delay` of loops with a hold: a sampled law's windows, and proved brackets."""

import argparse
from collections.abc import Callable
from typing import Any

from eval.arguments import parse_loop, print_json, progress_bar
from eval.loops import is_typed, loop_name, parse_sampled_loop
from eval.sampled_answers import LONGEST_SCAN, design_delays, proofs_inside, windows_answer
from eval.stability_answers import words_of_rest
from railenv.errors import ArgumentError
from railenv.stability import DelaySystem, SampledLoop, proved_critical_delay
from railenv.vehicle import LateralVehicle

_SHOWN = 20
"""Most lines of a list; --json gives all."""


def critical_delay_of_law(
    options: argparse.Namespace, loop: SampledLoop, vehicle: LateralVehicle, longest: float
) -> None:
    """Print the stable windows of a sampled law.

    Args:
        options: Those of the command.
        loop: The law's loop.
        vehicle: The vehicle, which names the modes.
        longest: Longest delay searched if it was typed [s]; else `LONGEST_SCAN` is.
    """
    if options.method != "exact":
        raise ArgumentError(
            f"method = {options.method!r} is for continuous loops and {options.controller!r} is a "
            "sampled law; give --method exact or simulation"
        )
    if not is_typed(options, "max_delay"):
        longest = LONGEST_SCAN
    controller = parse_loop(options)[0]
    at_rest = words_of_rest(controller)
    with progress_bar(options, None, "delay") as bar:

        def tell(delay: float) -> None:
            bar.set_postfix_str(f"{1000 * delay:.0f} ms", refresh=False)
            bar.update()

        also = design_delays(controller, longest)
        answer = windows_answer(loop, vehicle, longest, also, tell)
        answer["local"] = at_rest is not None
        if options.prove_sampled:
            answer["sampled_proofs"] = proofs_inside(loop, answer, tell)
    if options.json:
        print_json(answer)
        return
    print(f"{loop_name(options, vehicle)}, {options.speed_kmh} km/h, {options.vehicle}")
    print(f"  method sampled: every {1000 * loop.period:g} ms, delays from 0 to {longest:g} s")
    if at_rest is not None:
        print(f"  local: {at_rest}")
    _print_first_loss(answer, longest)
    print_crossings(answer)
    if not answer["stable_windows_s"]:
        print(f"  stable: at no delay that was looked at (searched to {longest:g} s)")
    if any(crossing["jump"] for crossing in answer["crossings"]):
        print(
            "  jump: at a whole multiple of the period a reading begins to see an older force; a "
            "window contains the multiple it begins at, not the one it ends at"
        )
    _print_proofs(answer)


def _print_first_loss(answer: dict[str, Any], longest: float) -> None:
    first = answer["critical_delay_sampled_s"]
    if answer["unstable_roots_without_delay"]:
        number = answer["unstable_roots_without_delay"]
        print(f"  UNSTABLE WITHOUT DELAY: {number} unstable roots")
    elif first is None:
        print(f"  critical delay, sampled               none up to {longest:g} s")
    else:
        print(f"  critical delay, sampled               {1000 * first:.3f} ms")
        print(f"  first unstable: {answer['frequency_hz']:.4f} Hz, {answer['mode']}")


def _print_proofs(answer: dict[str, Any]) -> None:
    proofs = answer.get("sampled_proofs")
    if proofs is None:
        print(f"  proved: no (exact to rounding; {answer['reason']})")
        return
    print("  proved at the middle of each window and gap only:")
    for proof in proofs:
        number = proof["unstable_roots"]
        roots = f", {number} unstable roots" if number else ""
        reason = f" ({proof['reason']})" if proof["reason"] else ""
        print(f"    {1000 * proof['delay_s']:10.3f} ms  {proof['verdict']}{roots}{reason}")


def sampled_critical_delay_of_file(
    options: argparse.Namespace, loop: SampledLoop, longest: float, method: str
) -> None:
    """Print the proved bracket of a sampled loop's first critical delay."""
    if method != "exact":
        raise ArgumentError(
            f"method = {options.method!r} is for continuous loops and {options.system!r} holds a "
            "sampled one; drop --method"
        )
    with progress_bar(options, None, "delay") as bar:

        def tell(delay: float) -> None:
            bar.set_postfix_str(f"{1000 * delay:.0f} ms", refresh=False)
            bar.update()

        found = proved_critical_delay(loop, longest, progress=tell)
    low, high = found.low, found.high
    middle = None if low is None or high is None else (low + high) / 2.0
    unstable = found.unstable.unstable_roots if low is None and found.unstable else None
    if options.json:
        print_json(
            {
                "critical_delay_s": None,
                "critical_delay_sampled_s": middle,
                "critical_delay_sampled_bracket_s": [low, high],
                "control_period_s": loop.period,
                "crossings": [],
                "max_delay_s": longest,
                "method": "sampled",
                "proved": not found.reason,
                "sampled_proved": not found.reason,
                "reason": found.reason,
            }
        )
        return
    print(f"{options.system}, method sampled")
    label = f"critical delay, sampled every {1000 * loop.period:g} ms"
    if low is None and high == 0.0:
        number = "" if unstable is None else f": {unstable} unstable roots"
        print(f"  UNSTABLE WITHOUT DELAY{number}")
    elif high is None and not found.reason:
        print(f"  {label}  none up to {longest:g} s")
    else:
        print(f"  {label}  {'not found' if middle is None else f'{1000 * middle:.3f} ms'}")
    if low is not None:
        # In full: a rounded end would claim more than is proved.
        print(f"  STABLE for every delay from 0 to {low!r} s")
    if high is not None:
        print(f"  UNSTABLE at {high!r} s")
    print(f"  proved: {'no (' + found.reason + ')' if found.reason else 'yes'}")


def sampled_bracket(
    options: argparse.Namespace,
    system: DelaySystem,
    answer: dict[str, Any],
    progress: Callable[[float], None],
) -> dict[str, Any]:
    """Prove the loop with hold stable up to one delay and unstable at the next."""
    period = answer["control_period_s"]
    if period is None:
        raise ArgumentError("--prove-sampled needs a control period; give --control-period")
    loop = (
        SampledLoop.from_delay_system(system, period)
        if options.controller is None
        else parse_sampled_loop(options)
    )
    found = proved_critical_delay(loop, answer["max_delay_s"], progress=progress)
    return {
        "critical_delay_sampled_bracket_s": [found.low, found.high],
        "sampled_proved": not found.reason,
        "sampled_reason": found.reason,
    }


def print_crossings(answer: dict[str, Any]) -> None:
    """Print the crossings of an answer, and the windows in which the loop is stable."""
    crossings = answer["crossings"]
    if crossings:
        print("    delay [ms]  frequency [Hz]  turns     mode")
    for crossing in crossings[:_SHOWN]:
        print(
            f"    {1000 * crossing['delay_s']:10.3f}  {crossing['frequency_hz']:14.4f}  "
            f"{crossing['direction']:<8}  {crossing['mode'] or '-'}"
            f"{' (jump)' if crossing.get('jump') else ''}"
        )
    if len(crossings) > _SHOWN:
        print(f"    ... and {len(crossings) - _SHOWN} more (--json lists all)")
    windows = [
        f"{1000 * low:.1f} to {1000 * high:.1f} ms"
        for low, high in answer.get("stable_windows_s", [])
    ]
    if windows:
        print(f"  stable: {', '.join(windows[:_SHOWN])} (searched to {answer['max_delay_s']:g} s)")
