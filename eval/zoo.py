"""Every controller at every delay: comfort, force, damping, and the distance from the optimum.

One entry (a controller on a layout at a speed) is run on several German-low tracks with sensor
noise at each delay; a law that knows its delay is designed anew for each. Linear laws are also
judged by the oracle (eigenvalues of the sampled loop) and by the covariance of the loop on the
design's track, next to the optimum with the same force.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from scipy import signal

from baselines import make_controller
from baselines.controller import Controller
from baselines.design.model import DESIGN_NOISE
from eval.measures import measure
from eval.rollout import ACCELERATIONS, Stepping, force_names, rollout
from eval.zoo_judge import distance, distances, first_critical_delay, judged
from railenv.errors import ArgumentError
from railenv.metrics.ride_filter import ride_filter
from railenv.simulation import Trajectory
from railenv.track import make_track
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, lateral17

DELAYS = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
"""Delays of the table [s]."""

SKYHOOK_GAINS = (3e3, 5e3, 7.5e3, 10e3, 15e3, 20e3, 25e3, 30e3, 35e3, 45e3, 60e3)
"""Gains among which the best sky-hook is chosen [N s/m]."""

TOLD = ("lqr", "optimum")
"""Laws that are told what no vehicle measures; their readings carry no noise."""

MISMATCH = (0.0, 0.5, 0.8, 0.9, 1.0, 1.1, 1.2, 1.5, 2.0)
"""True delays as shares of the one a law was designed for."""


@dataclass(frozen=True)
class Entry:
    """One controller on a layout at a speed.

    Attributes:
        label: How the table calls it.
        spec: Its SPEC; "{delay}" stands for the delay it is designed for [s].
        layout: "2", "4" or "passive".
        speed_kmh: Running speed [km/h].
    """

    label: str
    spec: str
    layout: str
    speed_kmh: float

    @property
    def knows_delay(self) -> bool:
        """Whether it is designed anew for every delay."""
        return "{delay}" in self.spec

    @property
    def noise(self) -> float:
        """Noise of its readings, in units of the columns' controlled response [1]."""
        return 0.0 if self.spec.partition(":")[0] in TOLD else DESIGN_NOISE

    def controller(self, delay: float) -> Controller:
        """Make it, for a delay [s]."""
        spec = self.spec.replace("{delay}", repr(delay))
        return make_controller(spec, self.layout, "paper_fit", self.speed_kmh)


@dataclass(frozen=True)
class Scale:
    """How much is run.

    Attributes:
        tracks: Number of tracks.
        duration: Length of a run [s].
        skip: Time left out at its start [s].
        delays: Delays [s].
    """

    tracks: int = 8
    duration: float = 70.0
    skip: float = 10.0
    delays: tuple[float, ...] = DELAYS


def evaluate(entry: Entry, scale: Scale) -> list[dict[str, Any]]:
    """Return one cell per delay, plain values."""
    if entry.spec == "passive":
        return _passive(entry, scale)
    vehicle = lateral17("paper_fit", entry.layout, entry.speed_kmh)
    if entry.knows_delay:
        laws = [entry.controller(delay) for delay in scale.delays]
        cells = [
            _run(entry, law, vehicle, (delay,), scale)[0]
            for law, delay in zip(laws, scale.delays, strict=True)
        ]
    else:
        laws = [entry.controller(0.0)] * len(scale.delays)
        cells = _run(entry, laws[0], vehicle, scale.delays, scale)
    first = first_critical_delay(laws[0], vehicle) if not entry.knows_delay else {}
    for cell, law, delay in zip(cells, laws, scale.delays, strict=True):
        cell |= first
        cell |= judged(law, vehicle, delay, window=entry.knows_delay)
        cell |= distances(law, vehicle, delay, entry.noise, cell)
    return cells


def _passive(entry: Entry, scale: Scale) -> list[dict[str, Any]]:
    """Return the passive vehicle's cell once per delay; its dampers are a law without delay."""
    vehicle = lateral17("paper_fit", "passive", entry.speed_kmh)
    cell = _run(entry, entry.controller(0.0), vehicle, (0.0,), scale)[0]
    active = lateral17("paper_fit", "4", entry.speed_kmh)
    beside = distance("in_a_row", cell["weighted"], cell["force_rms"], active, 0.0, preview=True)
    return [{**cell, "delay_s": d, **(beside if d == 0.0 else {})} for d in scale.delays]


def _run(
    entry: Entry,
    controller: Controller,
    vehicle: LateralVehicle,
    delays: Sequence[float],
    scale: Scale,
) -> list[dict[str, Any]]:
    """Run a controller at some delays on all tracks."""
    length = vehicle.speed * scale.duration
    tracks = [make_track("german_low", length, seed) for seed in range(scale.tracks)]
    of_lane = np.tile(np.arange(scale.tracks), len(delays))
    lanes = np.repeat(np.array(delays), scale.tracks)[:, None] * np.ones(vehicle.num_actuators)
    stepping = replace(Stepping(), sensor_noise=entry.noise)
    passive = entry.spec == "passive"
    dampers = tuple(f"lateral_damper_{k}_force" for k in (1, 2, 3, 4)) if passive else ()
    run = rollout(
        controller,
        vehicle,
        lanes.reshape(len(of_lane), vehicle.num_actuators),
        scale.duration,
        tracks=tracks,
        track_of_lane=of_lane,
        record=(*ACCELERATIONS, *force_names(vehicle), *dampers),
        stepping=stepping,
    )
    values = measure(run, scale.skip, stepping.actuator.force_limit)
    weighted = weighted_acceleration(run, scale.skip)
    cells: list[dict[str, Any]] = []
    for k, delay in enumerate(delays):
        own = slice(k * scale.tracks, (k + 1) * scale.tracks)
        force = _root_mean(values.force_rms[own])
        if dampers:
            begin = int(scale.skip * run.sample_rate)
            force = float(np.sqrt(np.mean([run.signal(d)[:, begin:] ** 2 for d in dampers])))
        cells.append(
            {
                "delay_s": delay,
                "front": float(np.mean(values.ride_index_front[own])),
                "rear": float(np.mean(values.ride_index_rear[own])),
                "spread": float(
                    max(
                        np.std(end[own], ddof=1) / np.sqrt(scale.tracks)
                        for end in (values.ride_index_front, values.ride_index_rear)
                    )
                )
                if scale.tracks > 1
                else None,
                "force_rms": force,
                "weighted": _root_mean(weighted[own]),
                "diverged": bool(
                    np.any(np.isnan(values.ride_index_front[own]))
                    or np.any(values.saturated_share[own] > 0.0)
                ),
            }
        )
    return cells


def weighted_acceleration(run: Trajectory, skip: float) -> FloatArray:
    """Return each lane's RMS ride-filtered acceleration over both floor ends [m/s^2]."""
    rate = run.sample_rate
    floors = np.stack([run.signal(name) for name in ACCELERATIONS[:2]])
    filtered = signal.sosfilt(ride_filter(rate), floors, axis=-1)[..., int(skip * rate) :]
    return np.sqrt(np.mean(filtered**2, axis=(0, 2)))


def _root_mean(values: FloatArray) -> float:
    """Return the root of the mean square of root mean squares."""
    return float(np.sqrt(np.mean(np.square(values))))


def best_skyhook(
    candidates: dict[float, list[dict[str, Any]]], index: int
) -> tuple[float, dict[str, Any]]:
    """Return gain and cell of the sky-hook that is best at one delay by the mean of both ends.

    Args:
        candidates: Cells by gain [N s/m].
        index: Which delay.

    Raises:
        ArgumentError: None is stable there.
    """
    stable = {
        gain: cells[index]
        for gain, cells in candidates.items()
        if not cells[index]["unstable_roots"]
    }
    if not stable:
        raise ArgumentError("no sky-hook gain of the grid is stable at this delay; give lower ones")
    gain = min(stable, key=lambda g: stable[g]["front"] + stable[g]["rear"])
    return gain, stable[gain]


def mismatched(entry: Entry, nominal: float, scale: Scale) -> list[dict[str, Any]]:
    """Return cells of a law designed for one delay at true delays from zero to twice that."""
    law = entry.controller(nominal)
    vehicle = lateral17("paper_fit", entry.layout, entry.speed_kmh)
    delays = [share * nominal for share in MISMATCH]
    cells = _run(entry, law, vehicle, delays, scale)
    for cell, delay in zip(cells, delays, strict=True):
        cell |= judged(law, vehicle, delay, window=delay == nominal)
    return cells
