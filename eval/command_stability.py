"""`railenv critical-delay`: the stability oracle on the command line."""

import argparse
from typing import Any

from eval.arguments import parse_number, parse_run, parse_stepping, print_json, progress_bar
from eval.command_sampled import (
    critical_delay_of_law,
    print_crossings,
    sampled_bracket,
    sampled_critical_delay_of_file,
)
from eval.delay_sweep import simulated_critical_delay
from eval.full50_linear import linear_loop
from eval.loops import is_typed, loop_name, parse_linear_loop, parse_method
from eval.simulations import lateral_twin
from eval.stability_answers import critical_delay_answer
from railenv.errors import ArgumentError, check_positive
from railenv.stability import DelaySystem, SampledLoop
from railenv.vehicle import LateralVehicle
from railenv.vehicle.nonlinear import FullVehicle


def command_critical_delay(options: argparse.Namespace) -> None:
    """Print every critical delay of a loop."""
    longest = check_positive("max_delay", parse_number("max_delay", options.max_delay), "seconds")
    stepping = parse_stepping(options)
    method, order = parse_method(options.method, ("exact", "simulation"))
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
        if isinstance(system, SampledLoop) and vehicle is not None:
            critical_delay_of_law(options, system, vehicle, longest)
            return
        if isinstance(system, SampledLoop):
            sampled_critical_delay_of_file(options, system, longest, method)
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
                answer |= sampled_bracket(options, system, answer, tell_delay)
    if options.json:
        print_json(answer)
        return
    train = f", {options.speed_kmh} km/h, {options.vehicle}" if vehicle is not None else ""
    if options.model != "lateral17":
        train += f", {options.model}" + ("" if method == "simulation" else " linearised")
    print(f"{loop_name(options, vehicle)}{train}, method {answer['method']}")
    _print_critical(answer, method, longest)
    print_crossings(answer)
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


def _ms(value: float | None, longest: float) -> str:
    return f"none up to {longest:g} s" if value is None else f"{1000 * value:.3f} ms"
