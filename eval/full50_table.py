"""Modes of the linearised 50-coordinate vehicle beside the 17-coordinate model's.

`python -m eval.full50_table` prints two tables, each for the passive vehicle and for sky-hook. The
first one compares like with like: a cone of the lateral model's conicity, its creep coefficients,
no pendulum terms, no roll of the wheelsets felt. The second one starts there and switches on what
the lateral model leaves out, one thing after the other, so that the changes add up to the whole
difference.

Listed are the lateral model's modes below 15 Hz and under 50 % damping. A mode of the larger
model is taken as the same one where its shape in the 17 shared coordinates is (modal assurance
criterion), and of several such the one whose root is nearest.
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from railenv.simulation.full_outputs import output_rows
from railenv.units import FloatArray
from railenv.vehicle import VehicleParameters, get_vehicle, lateral17, state_space
from railenv.vehicle.coordinates import COORDINATES as LATERAL_COORDINATES
from railenv.vehicle.nonlinear import (
    ContactSettings,
    FullVehicle,
    full50,
    linearised,
)
from railenv.vehicle.nonlinear.coordinates import coordinate_index
from railenv.vehicle.nonlinear.equilibrium import actuator_matrix

HIGHEST_HZ = 15.0
LARGEST_DAMPING = 0.5
_ALIKE = 0.3  # least assurance criterion of a mode that may be the same one
_WELL_ALIKE = 0.9  # below it the table shows the criterion
_SENSORS = tuple(f"carbody_lateral_velocity_{k}" for k in (1, 2, 3, 4))
_SHARED = np.array([coordinate_index(name) for name in LATERAL_COORDINATES])
_SMALL_ARC = 0.010
_LARGE_ARC = 0.3

ComplexArray = NDArray[np.complex128]


@dataclass(frozen=True)
class Mode:
    """A mode of the lateral model and its counterpart.

    Attributes:
        frequency: |s| / 2 pi of the lateral model [Hz].
        damping: Its damping ratio [1].
        other_frequency: Of the larger model [Hz].
        other_damping: Of the larger model [1].
        alike: Modal assurance criterion of the two shapes [1].
    """

    frequency: float
    damping: float
    other_frequency: float
    other_damping: float
    alike: float

    @property
    def frequency_change(self) -> float:
        """Of the frequency, relative [1]."""
        return self.other_frequency / self.frequency - 1.0

    @property
    def damping_change(self) -> float:
        """Of the damping ratio [1]."""
        return self.other_damping - self.damping


def cone_contact(parameters: VehicleParameters, arc: float, law: str) -> ContactSettings:
    """Return a cone of the lateral model's conicity that touches at its half contact spacing.

    Args:
        parameters: The lateral model's numbers.
        arc: Radius of the rail's head [m].
        law: Creep law.
    """
    slope = parameters.conicity
    return ContactSettings(
        wheel=f"cone:angle={slope:.12g}",
        rail=f"arc:radius={arc:.12g}",
        cant=slope,  # as steep as the cone, so that they touch in the middle of the head
        rail_lateral=parameters.half_contact_spacing,
        back_to_back=2.0 * parameters.half_contact_spacing - 0.14,  # tape circles 70 mm from backs
        law=law,
    )


def comparable(
    parameters: VehicleParameters, layout: object = "passive", speed_kmh: float = 300.0
) -> FullVehicle:
    """Return the 50-coordinate vehicle with what the lateral model leaves out switched off."""
    return full50(
        parameters,
        layout,
        speed_kmh,
        cone_contact(parameters, _SMALL_ARC, "given"),
        gravity_coupling=False,
        roll_coupling=False,
    )


def switched_on(start: FullVehicle) -> tuple[tuple[str, FullVehicle], ...]:
    """Return vehicles that begin with `comparable`'s and each have one thing more."""
    p = start.parameters.lateral
    light = start.parameters.replace(wheelset_pitch_inertia=1e-3)
    chain: list[tuple[str, FullVehicle]] = [("comparable", start)]

    def add(what: str, **changes: object) -> None:
        chain.append((what, chain[-1][1].replace(**changes)))

    # Without inertia about the axle there is no gyroscopic moment; slow modes do not feel it
    # otherwise.
    add("wheelset roll felt", roll_coupling=True, parameters=light)
    add("gyroscopic moments", parameters=start.parameters)
    add("preloads on tilted bodies", gravity_coupling=True)
    add("rail head 300 mm round", contact=cone_contact(p, _LARGE_ARC, "given"))
    add("Hertz and Kalker coefficients", contact=cone_contact(p, _LARGE_ARC, "linear"))
    add("friction limit, FASTSIM", contact=cone_contact(p, _LARGE_ARC, "fastsim-table"))
    add("S1002CN wheel, CN60 rail", contact=ContactSettings())
    return tuple(chain)


def state_matrix(vehicle: FullVehicle, gain: float = 0.0) -> FloatArray:
    """Return A of small motion about steady rolling, with sky-hook feedback [N s/m] or none."""
    A = linearised(vehicle)
    if gain == 0.0:
        return A
    rows = output_rows((vehicle,), _SENSORS, (), every=1, time_step=1.0)
    C = np.zeros((len(_SENSORS), vehicle.num_states))
    for k, (first, end) in enumerate(zip(rows.start, rows.start[1:], strict=False)):
        C[k, rows.column[first:end]] = rows.value[0, first:end]
    return A - gain * actuator_matrix(vehicle) @ C


def lateral_modes(
    parameters: VehicleParameters, layout: object, speed_kmh: float, gain: float = 0.0
) -> tuple[ComplexArray, ComplexArray]:
    """Return roots of the lateral model's listed modes and their shapes, slowest first.

    Returns:
        Roots, shape (modes,) [1/s], and displacements of the 17 coordinates, shape (17, modes).
    """
    system = state_space(lateral17(parameters, layout, speed_kmh))
    A = system.A
    if gain != 0.0:
        C, _ = system.output_rows(_SENSORS)
        A = A - gain * system.actuator_input @ C
    roots, shapes = _eigen(A)
    size = np.abs(roots)
    listed = (roots.imag > 0.0) & (size < 2.0 * np.pi * HIGHEST_HZ)
    listed &= -roots.real < LARGEST_DAMPING * size
    order = np.flatnonzero(listed)[np.argsort(size[listed])]
    return roots[order], shapes[: len(LATERAL_COORDINATES), order]


def compare(
    vehicle: FullVehicle, gain: float = 0.0, roots: tuple[ComplexArray, ComplexArray] | None = None
) -> tuple[Mode, ...]:
    """Compare the vehicle's modes with those of its lateral model.

    Args:
        vehicle: The 50-coordinate vehicle.
        gain: Of sky-hook control at the layout's actuators [N s/m]; 0 for none.
        roots: What to look for, as `lateral_modes` gives it; None for the vehicle's own.

    Returns:
        One entry per listed mode of the lateral model, slowest first.
    """
    if roots is None:
        p = vehicle.parameters.lateral
        roots = lateral_modes(p, vehicle.layout, 3.6 * vehicle.speed, gain)
    found, vectors = _eigen(state_matrix(vehicle, gain))
    swinging = np.flatnonzero(found.imag > 0.0)
    found, vectors = found[swinging], vectors[_SHARED][:, swinging]
    modes: list[Mode] = []
    for root, shape in zip(roots[0], roots[1].T, strict=True):
        product = np.abs(shape.conj() @ vectors) ** 2
        sizes = np.sum(np.abs(vectors) ** 2, axis=0) * np.sum(np.abs(shape) ** 2)
        alike = product / np.maximum(sizes, np.finfo(float).tiny)
        near = np.flatnonzero(alike > min(_ALIKE, float(alike.max()) * 0.999))
        same = int(near[np.argmin(np.abs(found[near] - root))])
        modes.append(Mode(*_numbers(root), *_numbers(found[same]), float(alike[same])))
    return tuple(modes)


def _eigen(A: FloatArray) -> tuple[ComplexArray, ComplexArray]:
    """Return eigenvalues and eigenvectors, complex even where all are real."""
    values, vectors = np.linalg.eig(A)
    return np.asarray(values, dtype=np.complex128), np.asarray(vectors, dtype=np.complex128)


def _numbers(root: complex) -> tuple[float, float]:
    return abs(root) / (2.0 * np.pi), -root.real / abs(root)


def like_with_like(modes: Sequence[Mode]) -> str:
    """Return the first table as text."""
    lines = [
        "| 17 coordinates | 50 coordinates | frequency | damping | shape (MAC) |",
        "| --- | --- | --- | --- | --- |",
    ]
    lines += [
        f"| {m.frequency:.4f} Hz, {100 * m.damping:.2f} % "
        f"| {m.other_frequency:.4f} Hz, {100 * m.other_damping:.2f} % "
        f"| {100 * m.frequency_change:+.2f} % | {100 * m.damping_change:+.2f} points "
        f"| {m.alike:.4f} |"
        for m in modes
    ]
    return "\n".join(lines)


def attributed(chain: Sequence[tuple[str, FullVehicle]], gain: float = 0.0) -> str:
    """Return the second table as text: frequency and damping as each thing is switched on."""
    p, first = chain[0][1].parameters.lateral, chain[0][1]
    sought = lateral_modes(p, first.layout, 3.6 * first.speed, gain)
    wanted = [f"{f:.3f} Hz, {100 * z:.1f} %" for f, z in map(_numbers, sought[0])]
    lines = [
        "| added | " + " | ".join(f"mode {k + 1}" for k in range(len(wanted))) + " |",
        "| --- |" + " --- |" * len(wanted),
        "| 17 coordinates | " + " | ".join(wanted) + " |",
    ]
    before: tuple[Mode, ...] | None = None
    for what, vehicle in chain:
        modes = compare(vehicle, gain, sought)
        cells: list[str] = []
        for k, m in enumerate(modes):
            f, z = m.other_frequency, m.other_damping
            old_f = m.frequency if before is None else before[k].other_frequency
            old_z = m.damping if before is None else before[k].other_damping
            change = f"{100 * (f / old_f - 1):+.1f} %"
            unlike = f" MAC {m.alike:.2f}" if m.alike < _WELL_ALIKE else ""
            cells.append(f"{f:.3f} ({change}), {100 * z:.1f} ({100 * (z - old_z):+.1f}){unlike}")
        lines.append(f"| {what} | " + " | ".join(cells) + " |")
        before = modes
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print both tables, passive and with sky-hook."""
    parser = argparse.ArgumentParser(prog="python -m eval.full50_table", description=__doc__)
    parser.add_argument("--vehicle", default="paper_fit", help="catalogued vehicle")
    parser.add_argument("--speed", type=float, default=300.0, help="running speed [km/h]")
    parser.add_argument("--gain", type=float, default=35e3, help="sky-hook gain [N s/m]")
    given = parser.parse_args(arguments)
    parameters = get_vehicle(given.vehicle).parameters
    for layout, gain in (("passive", 0.0), ("4", given.gain)):
        start = comparable(parameters, layout, given.speed)
        control = f"four actuators, sky-hook {gain / 1e3:g} kN s/m" if gain else "passive"
        sys.stdout.write(f"\n{given.vehicle}, {given.speed:g} km/h, {control}: like with like\n\n")
        sys.stdout.write(like_with_like(compare(start, gain)) + "\n")
        sys.stdout.write(
            "\nOne thing after the other switched on, change against the line above\n\n"
        )
        sys.stdout.write(attributed(switched_on(start), gain) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
