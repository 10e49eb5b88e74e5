"""Runs a suite: every cell's measures, every group's critical delays and root locus.

A group (controller, layout, speed) runs as one batch over delays, tracks and seeds. Groups are
independent, so that the result does not depend on the number of worker processes.
"""

import multiprocessing
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from typing import Any

import numpy as np

from baselines import make_controller
from eval.delay_sweep import simulated_critical_delay, unstable_by_simulation
from eval.measures import measure
from eval.records import provenance, write_records
from eval.rollout import rollout
from eval.sampled_answers import LONGEST_SCAN, design_delays, sampled_loop, windows_answer
from eval.scenarios import Suite, cell_key
from eval.stability_answers import (
    critical_delay_answer,
    delay_system,
    is_sampled_only,
    root_locus,
)
from railenv.config import to_dict
from railenv.errors import RailenvError
from railenv.files import make_folder
from railenv.simulation import required_length
from railenv.stability import sampled_growth_rate, unstable_at
from railenv.track import make_track
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, lateral17

MAX_DELAY = 2.0
"""Longest delay searched for crossings [s]."""

Group = tuple[str, str, float]


def run_benchmark(
    suite: Suite,
    folder: Path,
    command: str,
    jobs: int = 1,
    progress: Callable[[Group], None] | None = None,
) -> dict[str, Any]:
    """Run a suite and write its records.

    Args:
        suite: What to run.
        folder: Where `records.json` goes; made if missing.
        command: How it was called, for the record.
        jobs: Worker processes; the result does not depend on it.
        progress: Called when a group is done.

    Returns:
        The records.

    Raises:
        OutputError: The folder cannot be written.
    """
    make_folder(folder)
    started = time.perf_counter()
    groups = list(suite.groups())
    results: dict[Group, dict[str, Any]] = {}
    for group, result in _results(suite, groups, jobs):
        results[group] = result
        if progress is not None:
            progress(group)
    ordered = [results[group] for group in groups]
    records = {
        "suite": to_dict(suite),
        "provenance": provenance(command, time.perf_counter() - started),
        "cells": [cell for result in ordered for cell in result["cells"]],
        "stability": [result["stability"] for result in ordered if result["stability"]],
        "failures": [result["failure"] for result in ordered if result["failure"]],
    }
    write_records(folder, records)
    return records


def _results(
    suite: Suite, groups: list[Group], jobs: int
) -> Iterator[tuple[Group, dict[str, Any]]]:
    if jobs <= 1:
        for group in groups:
            yield group, run_group(suite, group)
        return
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(max_workers=jobs, mp_context=context) as pool:
        futures = {pool.submit(run_group, suite, group): group for group in groups}
        try:
            for future in as_completed(futures):
                yield futures[future], future.result()
        except BrokenProcessPool:
            raise RailenvError(
                "a worker process died, perhaps killed by a controller; "
                "run with --jobs 1 to see which one"
            ) from None
        finally:
            # After an interruption nobody waits for the groups that are still running.
            if not all(future.done() for future in futures):
                pool.shutdown(wait=False, cancel_futures=True)
                for process in multiprocessing.active_children():
                    process.terminate()


def run_group(suite: Suite, group: Group) -> dict[str, Any]:
    """Run one group's cells and ask the oracle about its loop.

    A controller that fails costs its own cells only: the group then has a `failure` and no cells.
    If only the oracle cannot answer, the cells stay and the failure says why.
    """
    spec, layout, speed_kmh = group
    where = {"controller": spec, "layout": layout, "speed_kmh": speed_kmh}
    vehicle = lateral17(suite.vehicle, layout, speed_kmh)
    result: dict[str, Any] = {"cells": [], "stability": None, "failure": None}
    try:
        result["cells"] = _cells(suite, spec, vehicle, speed_kmh)
        answer, unstable = _stability(suite, spec, vehicle)
        result["stability"] = {**where, "vehicle": suite.vehicle, **answer}
    except RailenvError as error:
        unstable = {}
        result["failure"] = {**where, "error": str(error)}
    for cell in result["cells"]:
        cell["unstable"] = unstable.get(cell["delay_s"])
    return result


def _cells(
    suite: Suite, spec: str, vehicle: LateralVehicle, speed_kmh: float
) -> list[dict[str, Any]]:
    stepping = suite.stepping()
    length = required_length(vehicle, suite.duration)
    places = [(track, seed) for track in suite.tracks for seed in suite.seeds]
    tracks = [make_track(track, length, seed) for track, seed in places]
    # Without actuators the delay means nothing: one run serves all delays.
    delays = suite.delays if vehicle.num_actuators else suite.delays[:1]
    lanes = [(place, delay) for place in range(len(places)) for delay in delays]
    lane_delays: FloatArray = np.array(
        [[delay] * vehicle.num_actuators for _, delay in lanes], dtype=float
    ).reshape(len(lanes), vehicle.num_actuators)
    trajectory = rollout(
        make_controller(spec, vehicle.layout, suite.vehicle, speed_kmh),
        vehicle,
        lane_delays,
        suite.duration,
        tracks=tracks,
        track_of_lane=np.array([place for place, _ in lanes]),
        stepping=stepping,
    )
    measures = measure(trajectory, suite.skip, suite.force_limit)
    cells: list[dict[str, Any]] = []
    for lane, (place, delay) in enumerate(lanes):
        track, seed = places[place]
        for shown in [delay] if vehicle.num_actuators else suite.delays:
            key = cell_key(spec, vehicle.layout, speed_kmh, track, seed, shown)
            where = {"key": key, "controller": spec, "layout": vehicle.layout}
            run = {"speed_kmh": speed_kmh, "track": track, "seed": seed, "delay_s": shown}
            cells.append({**where, **run, **measures.lane(lane)})
    return cells


def _stability(
    suite: Suite, spec: str, vehicle: LateralVehicle
) -> tuple[dict[str, Any], dict[float, bool | None]]:
    """Return the oracle's answer, and for each delay whether the sampled loop is unstable there.

    A law that is linear only from sample to sample has its stable windows as answer; one that is
    not linear is bracketed by simulation.
    """
    controller = make_controller(spec, vehicle.layout, suite.vehicle, 3.6 * vehicle.speed)
    period = suite.control_period
    if is_sampled_only(controller):
        loop = sampled_loop(controller, vehicle, period)
        longest = max(LONGEST_SCAN, *suite.delays)
        # Looked at beside the others, so that a window as narrow as one cell is not missed.
        also = (*suite.delays, *design_delays(controller, longest))
        answer = windows_answer(loop, vehicle, longest, also)
        return {**answer, "root_locus": None}, {d: unstable_at(loop, d) > 0 for d in suite.delays}
    if not hasattr(controller, "to_delay_system"):
        longest = max(*suite.delays, period)
        answer = simulated_critical_delay(
            controller, vehicle, stepping=suite.stepping(), max_delay=longest
        )
        return {**answer, "root_locus": None}, unstable_by_simulation(answer, suite.delays)
    system = delay_system(controller, vehicle)
    answer = critical_delay_answer(system, vehicle, period, MAX_DELAY)
    # Without channels the delay means nothing: one look serves all.
    looked = suite.delays if system.num_channels else suite.delays[:1]
    grows = [sampled_growth_rate(system, delay, period) > 0.0 for delay in looked]
    unstable: dict[float, bool | None] = dict(
        zip(suite.delays, grows * (len(suite.delays) // len(looked)), strict=True)
    )
    return {**answer, "root_locus": root_locus(system, vehicle)}, unstable
