"""What the physics step of the 50-coordinate vehicle costs in accuracy.

`python -m eval.full50_steps` runs the same track with several steps and prints RMS accelerations,
forces and their change against the finest step. Floors are taken as they are every millisecond,
bogie and wheelset accelerations as means over a millisecond (differences of velocity), wheel forces
as means over 10 ms.
"""

import argparse
import sys
from collections.abc import Sequence

import numpy as np

from railenv.simulation.full_run import FullSimulation
from railenv.track import Track, make_track
from railenv.units import FloatArray
from railenv.vehicle.nonlinear import ContactSettings, FullVehicle, full50

STEPS = (1e-3, 5e-4, 2.5e-4, 1.25e-4)
_RECORD = 1e-3
_START = 2.0  # [s] what is left out at the beginning of a run
_FLOOR = tuple(
    f"floor_{end}_{way}_acceleration"
    for way in ("lateral", "vertical")
    for end in ("front", "rear")
)
_MOVING = tuple(
    f"{body}_{way}_velocity" for body in ("bogie1", "wheelset1") for way in ("lateral", "vertical")
)
NAMES = (
    *(name.replace("_", " ") for name in _FLOOR),
    *(name.replace("_velocity", "_acceleration").replace("_", " ") for name in _MOVING),
    "load of wheel 1, change",
    "guiding force of wheel 1",
)


def measured(
    vehicle: FullVehicle, track: Track, seconds: float, time_step: float
) -> tuple[FloatArray, FloatArray]:
    """Run once.

    Returns:
        RMS of everything in `NAMES` (m/s^2, the last two N), and floor accelerations, shape
        (records, 4).
    """
    simulation = FullSimulation(
        vehicle, (*_FLOOR, *_MOVING), time_step=time_step, record_step=_RECORD
    )
    simulation.reset(np.zeros((1, vehicle.num_actuators)), [track])
    command = np.zeros((1, vehicle.num_actuators))
    each: list[FloatArray] = []
    forces: list[FloatArray] = []
    for _ in range(round(seconds / 0.01)):
        each.append(simulation.advance(command)[0])
        forces.append(simulation.wheels[0, 0, :2])
    run = np.concatenate(each)[round(_START / _RECORD) :]
    wheel = np.array(forces)[round(_START / 0.01) :]
    wheel[:, 0] -= wheel[:, 0].mean()
    changes = np.diff(run[:, len(_FLOOR) :], axis=0) / _RECORD
    floor = run[:, : len(_FLOOR)]
    sizes = [np.sqrt(np.mean(part**2, axis=0)) for part in (floor, changes, wheel)]
    return np.concatenate(sizes), floor


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(prog="python -m eval.full50_steps", description=__doc__)
    parser.add_argument("--speed", type=float, default=300.0, help="running speed [km/h]")
    parser.add_argument("--track", default="tb3352", help="irregularity")
    parser.add_argument("--wheel", default="s1002cn", help="wheel profile")
    parser.add_argument("--seconds", type=float, default=20.0, help="length of the run [s]")
    parser.add_argument("--layout", default="4", help="passive, 2 or 4 actuators, without force")
    given = parser.parse_args(arguments)
    contact = ContactSettings(wheel=given.wheel)
    vehicle = full50("paper_fit", given.layout, given.speed, contact)
    track = make_track(given.track, vehicle.speed * (given.seconds + 1.0), 1)
    runs = [measured(vehicle, track, given.seconds, step) for step in STEPS]
    best, floor = runs[-1]
    head = " | ".join(f"{1e3 * step:g} ms" for step in STEPS[:-1])
    sys.stdout.write(f"| RMS of | {1e3 * STEPS[-1]:g} ms | {head} |\n")
    sys.stdout.write("| --- " * (len(STEPS) + 1) + "|\n")
    for k, name in enumerate(NAMES):
        changes = " | ".join(f"{100 * (run[0][k] / best[k] - 1):+.3f} %" for run in runs[:-1])
        sys.stdout.write(f"| {name} | {best[k]:.4g} | {changes} |\n")
    for k, name in enumerate(NAMES[: len(_FLOOR)]):
        errors = [
            np.sqrt(np.mean((run[1][:, k] - floor[:, k]) ** 2)) / best[k] for run in runs[:-1]
        ]
        cells = " | ".join(f"{100 * error:.3f} %" for error in errors)
        sys.stdout.write(f"| {name}, RMS of the difference | | {cells} |\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
