"""`railenv list` and `railenv simulate`."""

import argparse
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import replace

from baselines import Controller, registered_controllers
from baselines.policies import HistoryPolicy
from baselines.policies.shipped import shipped_descriptions
from baselines.registered import Registered
from eval.arguments import (
    MODELS,
    parse_delay,
    parse_number,
    parse_output,
    parse_run,
    parse_stepping,
    parse_whole,
    print_json,
    progress_bar,
)
from eval.full50_safety import VERTICAL, SafetyWatch
from eval.measures import STARTED, measure
from eval.rollout import ACCELERATIONS, ControlledBatch, Stepping, force_names, rollout
from eval.sampled_answers import sampled_loop
from eval.scenarios import load_suite
from eval.simulations import Vehicle, physics_step
from eval.stability_answers import delay_system, is_sampled_only
from eval.told_delay import check_can_be_told, told_delays
from railenv.actuation import DelaySpec
from railenv.config import config_names
from railenv.envs.registration import env_ids
from railenv.errors import (
    ArgumentError,
    RailenvError,
    check_count,
    check_not_negative,
    check_positive,
)
from railenv.metrics import grade
from railenv.simulation import whole_multiple
from railenv.stability import sampled_growth_rate
from railenv.track import get_spectrum, make_track, spectrum_names
from railenv.units import FloatArray
from railenv.vehicle import get_vehicle, vehicle_names
from railenv.vehicle.nonlinear import FullVehicle

_QUICK_PERIODS = 200
"""Delays of more control periods make the lifted map too large for an answer by the way."""

_RISE = 100.0  # [m] over which a realised track rises from nothing
_SHORTEST_MEASURE = 5.0
"""One segment of the ride index [s]."""


def command_list(options: argparse.Namespace) -> None:
    """Print what can be named."""
    tables: dict[str, dict[str, str]] = {
        "vehicles": {name: get_vehicle(name).description for name in vehicle_names()},
        "models": MODELS,
        "tracks": {
            "flat": "straight and level",
            **{name: get_spectrum(name).description for name in spectrum_names()},
            "FILE.csv": "a measured track: distance_m and alignment_mm, cross_level_mm, ...",
        },
        "controllers": {
            _spec_of(entry): f"{entry.description} [{entry.source}]"
            for entry in registered_controllers()
        }
        | shipped_descriptions()
        | {
            "FOLDER": "a trained policy: its folder or .safetensors file",
            "py:module:function": "a controller of your own",
        },
        "envs": dict.fromkeys(env_ids(), "Gymnasium id"),
        "suites": {name: load_suite(name).version for name in config_names("benchmark")},
    }
    chosen = {options.kind: tables[options.kind]} if options.kind else tables
    if options.json:
        print_json(chosen)
        return
    shipped = shipped_descriptions() if "controllers" in chosen else {}
    for kind, entries in chosen.items():
        _print_section(kind, {name: entries[name] for name in entries if name not in shipped})
        if kind == "controllers" and shipped:
            _print_section("shipped policies", shipped)


def _print_section(kind: str, entries: dict[str, str]) -> None:
    print(f"{kind}:")
    width = max(len(name) for name in entries)
    for name, description in entries.items():
        print(f"  {name:<{width}}  {' '.join(description.split())}")


def _spec_of(entry: Registered) -> str:
    """Return the SPEC of a controller with every setting at its default."""
    settings = ",".join(
        f"{key}={value if isinstance(value, str) else format(value, 'g')}"
        for key, (value, _) in entry.settings.items()
    )
    return f"{entry.name}:{settings}" if settings else entry.name


def command_simulate(options: argparse.Namespace) -> None:
    """Run one simulation and print its measures."""
    controller, vehicle = parse_run(options)
    seconds = check_positive("seconds", parse_number("seconds", options.seconds), "seconds")
    skip = _skip(options.skip, seconds)
    seed = check_count("seed", parse_whole("seed", options.seed), minimum=0)
    delays = DelaySpec(parse_delay(options.delay)).per_channel(vehicle.num_actuators or 1)
    delays = delays[: vehicle.num_actuators]
    noise = check_not_negative("sensor_noise", parse_number("sensor_noise", options.sensor_noise))
    told_error = parse_number("told_error", options.told_error)
    check_can_be_told(controller, told_error, options.controller)
    stepping = replace(parse_stepping(options), sensor_noise=noise, told_error=told_error)
    plot = parse_output(options.plot, (".png", ".svg", ".pdf"))
    out = parse_output(options.out, (".npz",))
    video = parse_output(options.video, (".mp4",))
    periods = whole_multiple("seconds", seconds, "control_period", stepping.control_period)
    track = make_track(options.track, vehicle.speed * seconds, seed)
    record, safety = (*ACCELERATIONS, *force_names(vehicle)), None
    watches: list[Callable[[ControlledBatch, FloatArray], None]] = []
    if isinstance(vehicle, FullVehicle):
        record, safety = (*record, *VERTICAL), SafetyWatch(vehicle)
        watches.append(safety.watch)

    def watch(batch: ControlledBatch, outputs: FloatArray) -> None:
        for each in watches:
            each(batch, outputs)

    with ExitStack() as stack:
        if video is not None:
            from eval.video import Film, film_file

            film = Film(vehicle, track, delays, stepping, stack.enter_context(film_file(video)))
            watches.append(film.watch)
        bar = stack.enter_context(progress_bar(options, periods, "period"))
        trajectory = rollout(
            controller,
            vehicle,
            delays[None, :],
            seconds,
            tracks=(track,),
            record=record,
            stepping=stepping,
            seed=seed,
            progress=bar.update,
            watch=watch,
        )
    # Until the last wheelset is on the whole irregularity.
    risen = max(STARTED, (_RISE + vehicle.wheelset_setback[-1]) / vehicle.speed)
    measures = measure(trajectory, skip, stepping.actuator.force_limit, float(risen)).lane(0)
    found = None if safety is None else safety.answer(trajectory, skip)
    settings = {
        "controller": options.controller,
        "layout": vehicle.layout,
        "vehicle": options.vehicle,
        "model": options.model,
        "speed_kmh": float(options.speed_kmh),
        "track": options.track,
        "seed": seed,
        "delay_s": list(map(float, delays)),
        "seconds": seconds,
        "skip_s": skip,
        "control_period_s": stepping.control_period,
        "time_step_s": stepping.time_step,
        "physics_step_s": physics_step(vehicle, stepping.time_step),
        "actuator_lag_s": stepping.actuator.lag,
        "force_limit_n": stepping.actuator.force_limit,
        "sensor_noise": stepping.sensor_noise,
    }
    if getattr(controller, "is_told", hasattr(controller, "tell")):
        settings["told_error_s"] = stepping.told_error
    if isinstance(vehicle, FullVehicle):
        settings |= {
            "wheel": vehicle.contact.wheel,
            "rail": vehicle.contact.rail,
            "friction": vehicle.contact.friction,
            "creep_law": vehicle.contact.law,
        }
    trajectory = replace(trajectory, settings=settings)
    if out is not None:
        trajectory.save(out)
    if plot is not None:
        from eval.run_plot import plot_run

        plot_run(trajectory, plot)
    growth = _growth_rate(controller, vehicle, delays, stepping)
    if options.json:
        answer = {"settings": settings, "measures": measures, "growth_rate": growth}
        print_json(answer if found is None else {**answer, "safety": found})
        return
    worse = max(
        (w for w in (measures["ride_index_front"], measures["ride_index_rear"]) if w is not None),
        default=None,
    )
    state = "DIVERGED" if measures["diverged"] else "did not diverge"
    if found is not None and found["derailed"]:
        state = f"DERAILED after {found['derailed_at_s']:g} s"
    print(f"{options.controller}, layout {vehicle.layout}, {options.track}: {state}")
    if growth is not None:
        word = "UNSTABLE at this delay" if growth > 0.0 else "stable at this delay"
        where = "itself" if getattr(controller, "is_linear", True) else "at rest"
        print(f"  the sampled loop {where} is {word}: growth rate {growth:+.4f} 1/s")
    for name, value in (measures | (found or {})).items():
        if name not in ("diverged", "derailed", "derailed_at_s"):
            print(f"  {name:<28} {'-' if value is None else format(value, '.4g')} {_unit(name)}")
    if worse is not None:
        print(f"  worse floor end: Wz {worse:.3f} ({grade(worse)})")


def _growth_rate(
    controller: Controller, vehicle: Vehicle, delays: FloatArray, stepping: Stepping
) -> float | None:
    """Return the sampled loop's growth rate [1/s], None where the oracle has no quick answer."""
    periods = float(delays.max(initial=0.0)) / stepping.control_period
    if isinstance(vehicle, FullVehicle):
        return None
    if periods > _QUICK_PERIODS:
        return None
    try:
        law, told = controller, None
        if len(delays):
            told = float(told_delays(delays[None, :], stepping.told_error)[0])
        if isinstance(controller, HistoryPolicy) and told is not None:
            # A policy that is no linear law is one at rest, as long as it is told one delay.
            law = controller.law_at(told)
        if is_sampled_only(law):
            loop = sampled_loop(law, vehicle, stepping.control_period, stepping.actuator)
            return loop.growth_rate(list(delays) or 0.0, told)
        system = delay_system(controller, vehicle, stepping.actuator)
        return sampled_growth_rate(system, list(delays) or 0.0, stepping.control_period)
    except RailenvError:
        return None  # a neutral loop, say: the run itself stands


def _skip(text: str | None, seconds: float) -> float:
    skip = (
        (5.0 if seconds >= 5.0 + _SHORTEST_MEASURE else 0.0)
        if text is None
        else check_not_negative("skip", parse_number("skip", text), "seconds")
    )
    if seconds - skip < _SHORTEST_MEASURE:
        raise ArgumentError(
            f"seconds = {seconds:g} with skip = {skip:g} leaves less than one segment of "
            f"{_SHORTEST_MEASURE:g} s; make the run longer"
        )
    return skip


def _unit(measure: str) -> str:
    """Return the unit of a measure of `eval.measures.RunMeasures` or `eval.full50_safety`."""
    if measure.startswith(("force", "guiding")):
        return "N"
    if measure == "wheelset_shift":
        return "m"
    if measure.startswith(("comfort", "floor", "bogie")):
        return "m/s^2"
    return ""
