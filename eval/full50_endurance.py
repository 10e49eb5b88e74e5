"""Long fast runs of many drawn 50-coordinate vehicles: do numbers stay finite, is derailment told?

`python -m eval.full50_endurance` draws vehicles (`railenv.vehicle.randomisation`, ranges "wide" at
one speed; conicity and creep coefficients follow from profiles and friction here, not drawn), runs
each on its own piece of track and prints what became of them.
"""

import argparse
import dataclasses
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from railenv.simulation.full import FullBatch
from railenv.simulation.full_stepping import DERAILED, RUNNING
from railenv.track.table import FULL_CHANNELS, pool_of_tracks
from railenv.units import FloatArray
from railenv.vehicle import get_vehicle
from railenv.vehicle.nonlinear import ContactSettings, FullVehicle, full50
from railenv.vehicle.randomisation import draw_vehicles, get_ranges

CONTROL_PERIOD = 0.01
_TRACKS = 10  # pieces of track; lanes start on them at places of their own
_SENSORS = tuple(f"carbody_lateral_velocity_{k}" for k in (1, 2, 3, 4))


@dataclass(frozen=True, eq=False)
class Endurance:
    """What became of the runs.

    Attributes:
        ended: `RUNNING`, `DERAILED` or `DIVERGED`, shape (runs,).
        finite: Whether all states, outputs and forces were numbers throughout, shape (runs,).
        end_time: When each run ended, or its full length, shape (runs,) [s].
        quotient: Largest Y/Q of a wheel, mean over 10 ms, shape (runs,).
        unloading: Largest 1 - Q/Q_0 of a wheel, mean over 10 ms, shape (runs,).
        shift: Largest displacement of a wheelset on its rails, shape (runs,) [m].
    """

    ended: NDArray[np.int64]
    finite: NDArray[np.bool_]
    end_time: FloatArray
    quotient: FloatArray
    unloading: FloatArray
    shift: FloatArray


def drawn_vehicles(
    number: int, speed_kmh: float, seed: int, contact: ContactSettings, layout: str = "passive"
) -> list[FullVehicle]:
    """Draw vehicles that run straight by the lateral model's measure at this speed."""
    wide = get_ranges("wide")
    ranges = dataclasses.replace(wide, speed_kmh=None, conicity=None, creep=(1.0, 1.0))
    base = get_vehicle("paper_fit").parameters
    drawn = draw_vehicles(base, layout, speed_kmh, ranges, number, seed)
    return [full50(v.parameters, layout, speed_kmh, contact) for v in drawn]


def run(
    vehicles: Sequence[FullVehicle],
    track: str,
    seconds: float,
    *,
    seed: int = 1,
    threads: int = 2,
    gain: float = 0.0,
) -> Endurance:
    """Run every vehicle from steady rolling on its own piece of track.

    Args:
        vehicles: Vehicles of one layout and contact.
        track: Description of the irregularity.
        seconds: Length of a run [s].
        seed: Of tracks and places.
        threads: Threads that share the lanes; the result does not depend on them.
        gain: Of sky-hook control [N s/m]; its forces arrive after 50 ms.
    """
    lanes = len(vehicles)
    rng = np.random.default_rng(seed)
    reach = max(v.speed for v in vehicles) * seconds + 200.0
    pool = pool_of_tracks((track,), min(_TRACKS, lanes), reach, seed, FULL_CHANNELS)
    batch = FullBatch(vehicles, lanes, pool, sampled=_SENSORS, longest_delay=0.05)
    batch.places.track[:] = np.arange(lanes) % len(pool)
    for k in range(lanes):
        length = pool[batch.places.track[k]].length
        batch.places.start[k] = rng.uniform(0.0, length)
    numbers = np.arange(lanes, dtype=np.int64)
    delays = np.full((lanes, vehicles[0].num_actuators), 0.05)
    batch.start(numbers, numbers, delays)
    static = batch.lanes.wheels[:, :, 0].mean(axis=1)
    periods = round(seconds / CONTROL_PERIOD)
    finite, end_time = np.ones(lanes, dtype=bool), np.full(lanes, seconds)
    quotient, unloading, shift = np.zeros(lanes), np.zeros(lanes), np.zeros(lanes)

    def drive(first: int, end: int) -> None:
        own = slice(first, end)
        for period in range(periods):
            if gain:
                batch.commands[own] = -gain * batch.sampled[own]
            before = batch.lanes.ended[own] == RUNNING
            if not before.any():
                return
            batch.advance(first, end)
            wheels, state = batch.lanes.wheels[own], batch.lanes.state[own]
            finite[own] &= np.isfinite(state).all(axis=1) & np.isfinite(wheels).all(axis=(1, 2))
            finite[own] &= np.isfinite(batch.sampled[own]).all(axis=1)
            now = batch.lanes.ended[own] != RUNNING
            end_time[own][before & now] = (period + 1) * CONTROL_PERIOD
            counted = ~now
            load = np.maximum(wheels[:, :, 0], 1.0)
            worst = (np.abs(wheels[:, :, 1]) / load).max(axis=1)
            quotient[own] = np.where(counted, np.maximum(quotient[own], worst), quotient[own])
            lost = (1.0 - wheels[:, :, 0] / static[own, None]).max(axis=1)
            unloading[own] = np.where(counted, np.maximum(unloading[own], lost), unloading[own])
            moved = np.abs(wheels[:, :, 4]).max(axis=1)
            shift[own] = np.where(before, np.maximum(shift[own], moved), shift[own])

    edges = np.linspace(0, lanes, max(1, min(threads, lanes)) + 1).astype(int)
    with ThreadPoolExecutor(len(edges) - 1) as workers:
        jobs = [workers.submit(drive, int(a), int(b)) for a, b in pairwise(edges)]
        for job in jobs:
            job.result()
    return Endurance(batch.lanes.ended.copy(), finite, end_time, quotient, unloading, shift)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run and print."""
    parser = argparse.ArgumentParser(prog="python -m eval.full50_endurance", description=__doc__)
    parser.add_argument("--vehicles", type=int, default=100, help="how many are drawn")
    parser.add_argument("--seconds", type=float, default=60.0, help="length of a run [s]")
    parser.add_argument("--speed", type=float, default=350.0, help="running speed [km/h]")
    parser.add_argument("--track", nargs="+", default=["tb3352", "fra6"], help="irregularity")
    parser.add_argument("--wheel", default="s1002cn", help="wheel profile")
    parser.add_argument("--friction", type=float, default=0.3, help="between wheel and rail [1]")
    parser.add_argument("--layout", default="passive", help="passive, 2 or 4 actuators")
    parser.add_argument("--gain", type=float, default=0.0, help="of sky-hook control [N s/m]")
    parser.add_argument("--seed", type=int, default=1, help="of vehicles, tracks and places")
    parser.add_argument("--threads", type=int, default=2, help="threads that share the runs")
    given = parser.parse_args(arguments)
    contact = ContactSettings(wheel=given.wheel, friction=given.friction)
    vehicles = drawn_vehicles(given.vehicles, given.speed, given.seed, contact, given.layout)
    sys.stdout.write(
        "| track | runs | ran through | derailed | diverged | not finite | largest shift "
        "| largest Y/Q | largest unloading | wall time |\n" + "| --- " * 10 + "|\n"
    )
    for track in given.track:
        start = time.perf_counter()
        found = run(
            vehicles,
            track,
            given.seconds,
            seed=given.seed,
            threads=given.threads,
            gain=given.gain,
        )
        through, derailed = found.ended == RUNNING, found.ended == DERAILED
        sys.stdout.write(
            f"| {track} | {len(vehicles)} | {through.sum()} | {derailed.sum()} "
            f"| {(~through & ~derailed).sum()} | {(~found.finite).sum()} "
            f"| {1e3 * found.shift.max():.1f} mm | {found.quotient.max():.2f} "
            f"| {found.unloading.max():.2f} | {time.perf_counter() - start:.0f} s |\n"
        )
        sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
