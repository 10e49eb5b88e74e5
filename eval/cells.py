"""Runs the cells of a package: one batch of closed loops, one row of numbers per scenario."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from baselines import LinearDynamic, LinearFeedback
from baselines.controller import Controller
from baselines.lqg import DelayLqg
from baselines.policies.linear import LinearPolicy
from eval.cell_safety import SafetyOfLanes
from eval.designs import designed
from eval.measures import measure
from eval.packages import PASSIVE, REFERENCE, Package
from eval.rollout import ACCELERATIONS, force_names, rollout
from eval.scenarios import Scenario, Suite, TestTracks
from eval.scenarios.scenario import lateral_of, vehicle_of
from eval.simulations import Vehicle
from eval.told_designs import PLACE, ToldDesigns
from eval.varying_delay import VaryingDelay
from railenv.simulation import DEFAULT_CONTROL_PERIOD, required_length
from railenv.stability.lifted_roots import at_multiple
from railenv.track import make_track
from railenv.units import FloatArray, Second
from railenv.vehicle import LateralVehicle, state_space


@dataclass(frozen=True)
class CellWork:
    """A package and what it needs to be run anywhere; small, and can be pickled.

    Attributes:
        suite: The suite.
        salt: Private salt of the test tracks; "" for the public ones.
        package: What is run.
    """

    suite: Suite
    salt: str
    package: Package


def run_package(work: CellWork) -> list[dict[str, Any]]:
    """Run a package.

    Returns:
        One row per scenario, in their order: `key` and what it is made of, `status` ("ok", or
        "diverged" where the run did or the oracle says that the loop grows), `unstable` (the
        oracle's word, None where it has none), the fields of `eval.measures.RunMeasures`, and the
        largest stroke [m]; on the nonlinear vehicle also `derailment_quotient` and
        `wheel_unloading` [1]. None where there is no number.

    Raises:
        ArgumentError: The controller cannot run on this vehicle.
        ControllerError: It broke the protocol.
    """
    suite, scenarios = work.suite, work.package.scenarios
    place = scenarios[0].place
    controller = controller_for(work.package.controller, place)
    layout = "passive" if work.package.controller == PASSIVE else place[2]
    vehicle = vehicle_of(place, layout)
    stepping = suite.stepping(getattr(controller, "control_period", None))
    duration = suite.duration(place[0])
    test = TestTracks(suite.version, work.salt)
    pairs = list(dict.fromkeys((s.track, s.seed) for s in scenarios))
    length = _length(vehicle, lateral_of(place), duration)
    tracks = [make_track(track, length, test.seed(seed)) for track, seed in pairs]
    channels = vehicle.num_actuators
    delays: FloatArray = np.array([s.channel.delays(channels) for s in scenarios])
    strokes = tuple(f"suspension_stroke_{k}" for k in (1, 2, 3, 4))
    safety = SafetyOfLanes(vehicle)
    # Noise, jitter and losses of a lane follow from its track and channel, not from its place in
    # the batch, so that all controllers meet the same.
    streams = [test.stream(draws_name(s)) for s in scenarios]
    varying = VaryingDelay(
        jitter=np.array([s.channel.jitter for s in scenarios]),
        dropout=np.array([s.channel.dropout for s in scenarios]),
        seeds=tuple(streams),
    )
    trajectory = rollout(
        controller,
        vehicle,
        delays.reshape(len(scenarios), channels),
        duration,
        tracks=tracks,
        track_of_lane=np.array([pairs.index((s.track, s.seed)) for s in scenarios]),
        record=(*ACCELERATIONS, *force_names(vehicle), *strokes),
        stepping=stepping,
        channel=varying if channels else None,
        noise_seeds=streams,
        watch=safety.watch,
    )
    measures = measure(trajectory, suite.skip, suite.force_limit)
    start = int(np.searchsorted(trajectory.time, suite.skip * (1 + 1e-12), side="right"))
    stroke = np.stack([np.abs(trajectory.signal(name)[:, start:]) for name in strokes])
    peaks = stroke.max(axis=(0, 2))
    unstable = _unstable(controller, vehicle, scenarios)
    rows: list[dict[str, Any]] = []
    for lane, scenario in enumerate(scenarios):
        numbers = measures.lane(lane)
        diverged = bool(numbers.pop("diverged"))
        numbers["stroke_peak"] = float(peaks[lane]) if np.isfinite(peaks[lane]) else None
        numbers.update(safety.lane(lane))
        numbers["unstable"] = unstable.get(scenario.channel.key)
        status = "diverged" if diverged or numbers["unstable"] else "ok"
        rows.append({**described(scenario), "status": status, **numbers})
    return rows


def _unstable(
    controller: Controller, vehicle: Vehicle, scenarios: tuple[Scenario, ...]
) -> dict[str, bool]:
    """Return by channel whether the linear loop grows at its constant delay, told the truth.

    A run of half a minute does not show growth that takes minutes. Of a controller that is not
    linear the loop at rest is not asked: it may leave rest and go on within bounds.
    """
    if not isinstance(vehicle, LateralVehicle):
        return {}
    constant = [s.channel for s in scenarios if s.channel.kind == "constant"]
    if not vehicle.num_actuators:
        alone = bool(np.linalg.eigvals(state_space(vehicle).A).real.max() > 0.0)
        return {channel.key: alone for channel in constant}
    if not is_linear(controller):
        return {}
    return {
        channel.key: grows(controller, vehicle, channel.delay)
        for channel in dict.fromkeys(constant)
    }


def grows(controller: Any, vehicle: LateralVehicle, delay: Second) -> bool:
    """Whether a linear loop grows at this very delay, the controller told the truth.

    Right beside a whole multiple of the control period is another question.

    Args:
        controller: One that `is_linear`.
        vehicle: The vehicle, with actuators.
        delay: Of every channel [s].
    """
    law = controller.law_at(delay) if hasattr(controller, "law_at") else controller
    period: float = getattr(controller, "control_period", None) or DEFAULT_CONTROL_PERIOD
    loop = law.to_sampled_loop(vehicle, period)
    return bool(loop.growth_rate(at_multiple(delay, period)) > 0.0)


def is_linear(controller: Controller) -> bool:
    """Whether a controller is linear at each told delay, so that the oracle's word is whole."""
    if isinstance(controller, ToldDesigns):
        return is_linear(controller.law_at(0.0))
    return isinstance(controller, LinearFeedback | LinearDynamic | LinearPolicy)


def described(scenario: Scenario) -> dict[str, Any]:
    """Return a scenario's key and its parts as a row's first columns."""
    s = scenario
    return {
        "key": s.key,
        "model": s.model,
        "vehicle": s.vehicle,
        "layout": s.layout,
        "speed_kmh": s.speed_kmh,
        "track": s.track,
        "channel": s.channel.kind,
        "delay_s": s.channel.delay,
        "seed": s.seed,
    }


def controller_for(spec: str, place: tuple[str, str, str, float]) -> Controller:
    """Make a controller for a place.

    Laws with a model in them are designed for the nominal vehicle at the place's speed: that the
    vehicle is another one is what the benchmark tries. The reference knows its vehicle.

    Raises:
        ArgumentError: The SPEC is not understood, or the law cannot be designed.
    """
    _, _, layout, speed = place
    if spec == REFERENCE:
        return DelayLqg(lateral_of(place), 0.0)
    if PLACE in spec:
        return ToldDesigns(lambda delay: designed(spec.replace(PLACE, repr(delay)), layout, speed))
    return designed(spec, layout, speed)


def _length(vehicle: Vehicle, twin: LateralVehicle, duration: float) -> float:
    """Return how much track a run needs [m]."""
    if isinstance(vehicle, LateralVehicle):
        return required_length(vehicle, duration)
    return required_length(twin, duration)


def draws_name(scenario: Scenario) -> str:
    """Name what is drawn for a scenario beside the track: the same on all vehicles."""
    return f"{scenario.track}/{scenario.channel.key}/{scenario.seed}"
