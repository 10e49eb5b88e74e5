"""Names for the modes of the lateral vehicle, by shape and never by frequency.

A mode is named from the kinetic-energy share of its motion, m_i |v_i|^2 over the 17 coordinates,
and then from the phase of the decisive pair of coordinates:

- a damper node that moves more than `NODE_RATIO` times every coordinate: "yaw damper relaxation" or
  "lateral damper relaxation" (the node's own decay; the bodies stand still);
- carbody share at least `BODY_SHARE`: "carbody yaw" if yaw holds more than half of the carbody's
  share, else "upper centre roll" if lateral and roll move against each other (more than 90 degrees
  apart: the centre of rotation lies above the centre of gravity) and "lower centre roll" if they
  move together;
- else, if the damping ratio is below `HUNTING_DAMPING` and the wheelsets follow their frames
  (motion across the primary suspension below `FOLLOWING` of the wheelsets' own): "bogie hunting in
  phase" or "... in anti phase" by front against rear lateral motion, or "front bogie hunting" or
  "rear bogie hunting" if one bogie with its wheelsets holds more than `SINGLE_BOGIE_RATIO` times
  the other's share;
- else the body and motion with the largest share, e.g. "bogie1 roll".

A real root does not oscillate; its name ends in "(overdamped)".
"""

import numpy as np

from railenv.units import ComplexArray, FloatArray
from railenv.vehicle.coordinates import (
    BOGIES,
    COORDINATES,
    NUM_COORDINATES,
    WHEELSETS,
    bogie_of_wheelset,
    coordinate_index,
)
from railenv.vehicle.linear import LateralVehicle

BODY_SHARE = 0.5
"""Kinetic-energy share from which the carbody owns a mode [1]."""

SINGLE_BOGIE_RATIO = 10.0
"""Ratio of the two bogies' shares from which hunting belongs to one bogie alone [1]."""

HUNTING_DAMPING = 0.5
"""Damping ratio from which running-gear motion is creep relaxation, not hunting [1]."""

FOLLOWING = 0.5
"""Largest ratio of motion across the primary suspension to wheelset motion in hunting [1]."""

NODE_RATIO = 10.0
"""Ratio of node motion to body motion from which a mode is a damper's own relaxation [1]."""


def energy_shares(vehicle: LateralVehicle, shape: ComplexArray) -> FloatArray:
    """Return each coordinate's share of the kinetic energy.

    Args:
        vehicle: The vehicle, for its masses.
        shape: Mode shape over the states, at least the 17 displacements; the common factor |s|^2
            between displacement and velocity cancels in the share.

    Returns:
        Shares in the order of `COORDINATES`, summing to one, shape (17,).
    """
    energy = np.diag(vehicle.mass) * np.abs(shape[:NUM_COORDINATES]) ** 2
    total = float(energy.sum())
    return energy / total if total > 0.0 else energy


def phase_degrees(shape: ComplexArray, of: str, against: str) -> float:
    """Return the phase of one coordinate minus that of another [deg], in (-180, 180]."""
    ratio = shape[coordinate_index(of)] * np.conj(shape[coordinate_index(against)])
    return float(np.degrees(np.angle(ratio)))


def mode_name(vehicle: LateralVehicle, root: complex, shape: ComplexArray) -> str:
    """Name a mode by its shape; see the module's text for the rules.

    Args:
        vehicle: The vehicle.
        root: Characteristic root s [1/s].
        shape: Mode shape over the vehicle's states (more entries are ignored).

    Returns:
        The name, in the field's words.
    """
    name = _relaxation_name(vehicle, shape) or _shape_name(vehicle, root, shape)
    overdamped = abs(root.imag) <= 1e-9 * abs(root)
    return f"{name} (overdamped)" if overdamped else name


def _relaxation_name(vehicle: LateralVehicle, shape: ComplexArray) -> str | None:
    nodes = np.abs(shape[2 * NUM_COORDINATES : 2 * NUM_COORDINATES + len(vehicle.dampers)])
    bodies = float(np.abs(shape[:NUM_COORDINATES]).max())
    if nodes.size == 0 or nodes.max() <= NODE_RATIO * bodies:
        return None
    largest = vehicle.dampers[int(np.argmax(nodes))].name
    return "yaw damper relaxation" if "yaw" in largest else "lateral damper relaxation"


def _shape_name(vehicle: LateralVehicle, root: complex, shape: ComplexArray) -> str:
    shares = energy_shares(vehicle, shape)
    share = dict(zip(COORDINATES, shares, strict=True))
    carbody = sum(share[f"carbody_{motion}"] for motion in ("lateral", "yaw", "roll"))
    if carbody >= BODY_SHARE:
        if share["carbody_yaw"] > carbody / 2:
            return "carbody yaw"
        apart = abs(phase_degrees(shape, "carbody_lateral", "carbody_roll")) > 90.0
        return "upper centre roll" if apart else "lower centre roll"
    if -root.real < HUNTING_DAMPING * abs(root) and _wheelsets_follow(vehicle, shape):
        front, rear = (_bogie_share(share, bogie) for bogie in BOGIES)
        if front > SINGLE_BOGIE_RATIO * rear:
            return "front bogie hunting"
        if rear > SINGLE_BOGIE_RATIO * front:
            return "rear bogie hunting"
        apart = abs(phase_degrees(shape, "bogie1_lateral", "bogie2_lateral")) > 90.0
        return "bogie hunting in anti phase" if apart else "bogie hunting in phase"
    return COORDINATES[int(np.argmax(shares))].replace("_", " ")


def _bogie_share(share: dict[str, float], bogie: int) -> float:
    """Energy share of a bogie frame together with its two wheelsets."""
    own = [f"bogie{bogie}_{motion}" for motion in ("lateral", "yaw", "roll")]
    for wheelset in WHEELSETS:
        if bogie_of_wheelset(wheelset) == bogie:
            own += [f"wheelset{wheelset}_lateral", f"wheelset{wheelset}_yaw"]
    return sum(share[name] for name in own)


def _wheelsets_follow(vehicle: LateralVehicle, shape: ComplexArray) -> bool:
    q = shape[:NUM_COORDINATES]
    primary = [e for e in vehicle.elements if e.name.startswith("primary_lateral")]
    across = sum(abs(element.row @ q) ** 2 for element in primary)
    own = sum(abs(q[coordinate_index(f"wheelset{w}_lateral")]) ** 2 for w in WHEELSETS)
    return bool(across < FOLLOWING**2 * own)
