"""`railenv critical-delay` and `railenv roots`: the stability oracle on the command line."""

import argparse
from typing import Any

from eval.arguments import (
    parse_delay,
    parse_loop,
    parse_number,
    parse_stepping,
    parse_whole,
    print_json,
    progress_bar,
)
from eval.delay_sweep import simulated_critical_delay
from eval.stability_answers import critical_delay_answer, delay_system, root_answers
from railenv.errors import ArgumentError, check_count, check_positive
from railenv.stability import pade_roots, rightmost_roots

_SHOWN = 20
"""Most lines of a list; --json gives all."""


def command_critical_delay(options: argparse.Namespace) -> None:
    """Print every critical delay of a loop."""
    controller, vehicle = parse_loop(options)
    longest = check_positive("max_delay", parse_number("max_delay", options.max_delay), "seconds")
    stepping = parse_stepping(options)
    method, order = _method(options.method, ("exact", "simulation"))
    if method == "simulation":
        with progress_bar(options, None, "batch") as bar:

            def tell(word: str) -> None:
                bar.set_postfix_str(word, refresh=False)
                bar.update()

            answer = simulated_critical_delay(
                controller, vehicle, stepping=stepping, max_delay=longest, progress=tell
            )
    else:
        system = delay_system(controller, vehicle, stepping.actuator)
        with progress_bar(options, None, "delay") as bar:

            def tell_delay(delay: float) -> None:
                bar.set_postfix_str(f"{1000 * delay:.0f} ms", refresh=False)
                bar.update()

            answer = critical_delay_answer(
                system,
                vehicle,
                stepping.control_period,
                longest,
                order,
                progress=tell_delay,
            )
    if options.json:
        print_json(answer)
        return
    print(
        f"{options.controller}, layout {vehicle.layout}, {options.speed_kmh} km/h, "
        f"{options.vehicle}, method {answer['method']}"
    )
    _print_critical(answer, method, longest)
    _print_crossings(answer)
    print(
        "  proved: no (exact to rounding)"
        if order is None and method == "exact"
        else "  proved: no (an estimate)"
    )


def _print_critical(answer: dict[str, Any], method: str, longest: float) -> None:
    if answer.get("unstable_roots_without_delay"):
        number = answer["unstable_roots_without_delay"]
        print(f"  UNSTABLE WITHOUT DELAY: {number} unstable roots")
    continuous = _ms(answer["critical_delay_s"], longest)
    if method == "simulation":
        continuous = "not known to this method"
    period = f"every {1000 * answer['control_period_s']:g} ms"
    exact = "  (exact map)" if method == "pade" else ""
    print(f"  critical delay, continuous            {continuous}")
    print(
        f"  critical delay, sampled {period:<13} "
        f"{_ms(answer['critical_delay_sampled_s'], longest)}{exact}"
    )
    if answer["frequency_hz"] is not None:
        print(f"  first unstable: {answer['frequency_hz']:.4f} Hz, {answer['mode']}")
    if answer.get("bracket_s"):
        low, high = (1000 * b for b in answer["bracket_s"])
        print(f"  bracket {low:.1f} to {high:.1f} ms (estimate)")
    if answer.get("limit_cycle"):
        cycle = answer["limit_cycle"]
        word = "limit cycle" if cycle["settled"] else "still growing"
        floor = " / ".join(
            _size(cycle[f"floor_{end}_amplitude"], 1.0, 2) for end in ("front", "rear")
        )
        force = _size(cycle["force_amplitude"], 1e-3, 1)
        print(
            f"  {word} at {1000 * cycle['delay_s']:.0f} ms: floor {floor} m/s^2, force {force} kN"
        )


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
            f"{crossing['direction']:<8}  {crossing['mode']}"
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
    controller, vehicle = parse_loop(options)
    delay = parse_delay(options.delay)
    count = check_count("count", parse_whole("count", options.count))
    method, order = _method(options.method, ("exact",))
    system = delay_system(controller, vehicle, parse_stepping(options).actuator)
    if order is None:
        modes = rightmost_roots(system, delay, count)
    else:
        if isinstance(delay, tuple):
            raise ArgumentError("the Pade method takes one delay for all channels; give one number")
        modes = pade_roots(system, delay, order, count)
    answers = root_answers(modes, vehicle)
    if options.json:
        print_json({"method": options.method, "proved": False, "roots": answers})
        return
    print(
        f"{options.controller}, layout {vehicle.layout}, delay {options.delay} s, method {method}"
        + (f":{order}" if order is not None else "")
    )
    growing = sum(root["re"] > 0.0 for root in answers)
    print(
        f"  {'UNSTABLE' if growing else 'stable'} at this delay (continuous feedback, not proved)"
    )
    print("         re [1/s]      im [1/s]  |s|/2pi [Hz]  damping ratio  mode")
    for root in answers:
        print(
            f"    {root['re']:13.6f} {root['im']:13.6f}  {root['frequency_hz']:12.4f}  "
            f"{root['damping_ratio']:13.5f}  {root['mode']}"
        )


def _method(text: str, plain: tuple[str, ...]) -> tuple[str, int | None]:
    name, colon, order = text.partition(":")
    if name == "pade" and colon:
        return name, check_count("order", parse_whole("order", order))
    if text in plain:
        return text, None
    raise ArgumentError(f"method = {text!r} does not exist; choose {', '.join(plain)} or pade:N")


def _ms(value: float | None, longest: float) -> str:
    return f"none up to {longest:g} s" if value is None else f"{1000 * value:.3f} ms"
