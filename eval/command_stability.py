"""`railenv critical-delay` and `railenv roots`: the stability oracle on the command line."""

import argparse
from collections.abc import Callable
from typing import Any

from eval.arguments import (
    parse_delay,
    parse_number,
    parse_run,
    parse_stepping,
    parse_whole,
    print_json,
    progress_bar,
)
from eval.delay_sweep import simulated_critical_delay
from eval.full50_linear import linear_loop
from eval.loops import is_typed, parse_linear_loop, parse_sampled_loop
from eval.simulations import Vehicle, lateral_twin
from eval.stability_answers import (
    critical_delay_answer,
    enclosed_root_answers,
    root_answers,
)
from railenv.errors import ArgumentError, NeutralLoopError, check_count, check_positive
from railenv.stability import (
    DelaySystem,
    SampledLoop,
    enclosed_roots,
    pade_roots,
    proved_critical_delay,
    rightmost_roots,
)
from railenv.vehicle import LateralVehicle
from railenv.vehicle.nonlinear import FullVehicle

_SHOWN = 20
"""Most lines of a list; --json gives all."""


def _loop_name(options: argparse.Namespace, vehicle: Vehicle | None) -> str:
    if vehicle is None:
        return str(options.system)
    return f"{options.controller}, layout {vehicle.layout}"


def command_critical_delay(options: argparse.Namespace) -> None:
    """Print every critical delay of a loop."""
    longest = check_positive("max_delay", parse_number("max_delay", options.max_delay), "seconds")
    stepping = parse_stepping(options)
    method, order = _method(options.method, ("exact", "simulation"))
    if options.prove_sampled and method != "exact":
        raise ArgumentError("--prove-sampled goes with --method exact")
    if method == "simulation":
        if options.controller is None:
            raise ArgumentError(
                "--method simulation runs a vehicle; give --controller instead of --system"
            )
        controller, vehicle = parse_run(options)
        with progress_bar(options, None, "batch") as bar:

            def tell(word: str) -> None:
                bar.set_postfix_str(word, refresh=False)
                bar.update()

            answer = simulated_critical_delay(
                controller, vehicle, stepping=stepping, max_delay=longest, progress=tell
            )
    else:
        system, vehicle = _small_motion(options) or parse_linear_loop(options)
        if isinstance(system, SampledLoop):
            _sampled_critical_delay(options, system, longest, method)
            return
        # A loop of the user's own has no control period unless one is named.
        sampled = vehicle is not None or is_typed(options, "control_period")
        with progress_bar(options, None, "delay") as bar:

            def tell_delay(delay: float) -> None:
                bar.set_postfix_str(f"{1000 * delay:.0f} ms", refresh=False)
                bar.update()

            answer = critical_delay_answer(
                system,
                vehicle,
                stepping.control_period if sampled else None,
                longest,
                order,
                progress=tell_delay,
            )
            if options.prove_sampled:
                answer |= _sampled_bracket(options, system, answer, tell_delay)
    if options.json:
        print_json(answer)
        return
    train = f", {options.speed_kmh} km/h, {options.vehicle}" if vehicle is not None else ""
    if options.model != "lateral17":
        train += f", {options.model}" + ("" if method == "simulation" else " linearised")
    print(f"{_loop_name(options, vehicle)}{train}, method {answer['method']}")
    _print_critical(answer, method, longest)
    _print_crossings(answer)
    print(_proved_text(answer, method))


def _small_motion(options: argparse.Namespace) -> tuple[DelaySystem, LateralVehicle] | None:
    """Return the loop around small motion of the nonlinear vehicle, and what names its modes."""
    if options.controller is None:
        of_a_vehicle = [options.wheel, options.rail, options.friction, options.creep_law]
        if options.model != "lateral17" or any(value is not None for value in of_a_vehicle):
            raise ArgumentError(
                "--model, --wheel, --rail, --friction and --creep-law say something of a vehicle "
                f"and {options.system!r} is a loop of its own; drop them, or give --controller "
                "instead of --system"
            )
        return None
    controller, vehicle = parse_run(options)
    if not isinstance(vehicle, FullVehicle):
        return None
    if options.prove_sampled:
        raise ArgumentError("--prove-sampled goes with --model lateral17")
    lag = parse_stepping(options).actuator.lag
    return linear_loop(controller, vehicle.replace(actuator_lag=lag)), lateral_twin(vehicle)


def _sampled_critical_delay(
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


def _sampled_bracket(
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


def _proved_text(answer: dict[str, Any], method: str) -> str:
    if method == "pade":
        return _pade_text(answer)
    if method == "simulation":
        return "  proved: no (an estimate)"
    if not answer["proved"]:
        return f"  proved: no (exact to rounding; {answer['reason']})"
    if answer["delay_independent"]:
        return "  proved: yes; no root meets the imaginary axis for any delay at all"
    return "  proved: yes; no crossing is missing"


def _pade_text(answer: dict[str, Any]) -> str:
    """Set the Pade answer beside the exact one."""
    exact = answer["exact_critical_delay_s"]
    lines = ["  proved: no (an estimate; Pade models err on the unsafe side)"]
    if exact is not None:
        lines.append(f"  exact critical delay                  {1000 * exact:.3f} ms")
    if answer["relative_error"] is not None:
        lines.append(f"  relative error of the Pade answer     {answer['relative_error']:.1e}")
    if answer["order_by_the_rule"] is not None:
        lines.append(
            f"  order by the rule 3.631 f tau + 0.421  {answer['order_by_the_rule']} "
            "(correlation 0.99 at the crossing)"
        )
    return "\n".join(lines)


def _print_critical(answer: dict[str, Any], method: str, longest: float) -> None:
    if answer.get("unstable_roots_without_delay"):
        number = answer["unstable_roots_without_delay"]
        print(f"  UNSTABLE WITHOUT DELAY: {number} unstable roots")
    if answer.get("marginal_roots"):
        print(
            f"  NEVER ASYMPTOTICALLY STABLE: {answer['marginal_roots']} root(s) stay on the "
            "imaginary axis whatever the delay"
        )
    continuous = _ms(answer["critical_delay_s"], longest)
    if method == "simulation":
        continuous = "not known to this method"
    print(f"  critical delay, continuous            {continuous}")
    if answer["control_period_s"] is not None:
        period = f"every {1000 * answer['control_period_s']:g} ms"
        exact = "  (exact map)" if method == "pade" else ""
        print(
            f"  critical delay, sampled {period:<13} "
            f"{_ms(answer['critical_delay_sampled_s'], longest)}{exact}"
        )
    if "critical_delay_sampled_bracket_s" in answer:
        low, high = answer["critical_delay_sampled_bracket_s"]
        parts = [] if low is None else [f"STABLE from 0 to {1000 * low:.3f} ms"]
        parts += [] if high is None else [f"UNSTABLE at {1000 * high:.3f} ms"]
        parts += [answer["sampled_reason"]] if answer["sampled_reason"] else []
        print(f"    sampled, proved: {', '.join(parts)}")
    if answer["frequency_hz"] is not None:
        print(f"  first unstable: {answer['frequency_hz']:.4f} Hz, {answer['mode'] or '-'}")
    if answer.get("bracket_s"):
        low, high = (1000 * b for b in answer["bracket_s"])
        print(f"  bracket {low:.1f} to {high:.1f} ms (estimate)")
    if answer.get("hunting_hz"):
        print(
            f"  the vehicle hunts by itself at {answer['hunting_hz']:.1f} Hz; judged is the "
            "carbody's slower motion"
        )
    if answer.get("limit_cycle"):
        cycle = answer["limit_cycle"]
        word = "limit cycle" if cycle["settled"] else "still growing"
        floor = " / ".join(
            _size(cycle[f"floor_{end}_amplitude"], 1.0, 2) for end in ("front", "rear")
        )
        force = _size(cycle["force_amplitude"], 1e-3, 1)
        at = f"at {1000 * cycle['delay_s']:.0f} ms"
        if cycle["floor_front_amplitude"] is None:
            print(f"  the motion leaves all bounds {at}")
        else:
            print(f"  {word} {at}: floor {floor} m/s^2, force {force} kN")


def _size(value: float | None, factor: float, digits: int) -> str:
    """Return a number, or what a run that left every bound has instead."""
    return "beyond any bound" if value is None else f"{factor * value:.{digits}f}"


def _print_crossings(answer: dict[str, Any]) -> None:
    crossings = answer["crossings"]
    if crossings:
        print("    delay [ms]  frequency [Hz]  turns     mode")
    for crossing in crossings[:_SHOWN]:
        print(
            f"    {1000 * crossing['delay_s']:10.3f}  {crossing['frequency_hz']:14.4f}  "
            f"{crossing['direction']:<8}  {crossing['mode'] or '-'}"
        )
    if len(crossings) > _SHOWN:
        print(f"    ... and {len(crossings) - _SHOWN} more (--json lists all)")
    windows = [
        f"{1000 * low:.1f} to {1000 * high:.1f} ms"
        for low, high in answer.get("stable_windows_s", [])
    ]
    if windows:
        print(f"  stable: {', '.join(windows[:_SHOWN])} (searched to {answer['max_delay_s']:g} s)")


def command_roots(options: argparse.Namespace) -> None:
    """Print the rightmost characteristic roots at one delay."""
    delay = parse_delay(options.delay)
    count = check_count("count", parse_whole("count", options.count))
    method, order = _method(options.method, ("exact",))
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
        f"{_loop_name(options, vehicle)}, delay {options.delay} s, method {method}"
        + (f":{order}" if order is not None else "")
    )
    verdict = _verdict(answers)
    word = "proved" if proved else "not proved"
    print(f"  {verdict} at this delay (continuous feedback, {word})")
    print("         re [1/s]      im [1/s]  |s|/2pi [Hz]  damping ratio  mode")
    for root in answers:
        print(
            f"    {root['re']:13.6f} {root['im']:13.6f}  {root['frequency_hz']:12.4f}  "
            f"{root['damping_ratio']:13.5f}  {root['mode'] or '-'}"
        )
    if proved:
        print(
            f"  complete: no other root is right of {region:.6g} 1/s; each is enclosed to "
            f"{max(root['radius'] for root in answers):.1e} 1/s"
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


def _method(text: str, plain: tuple[str, ...]) -> tuple[str, int | None]:
    name, colon, order = text.partition(":")
    if name == "pade" and colon:
        return name, check_count("order", parse_whole("order", order))
    if text in plain:
        return text, None
    raise ArgumentError(f"method = {text!r} does not exist; choose {', '.join(plain)} or pade:N")


def _ms(value: float | None, longest: float) -> str:
    return f"none up to {longest:g} s" if value is None else f"{1000 * value:.3f} ms"
