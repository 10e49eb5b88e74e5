"""Sway and yaw of the carbody: readings taken together, and forces shared out.

    y_sway = mean of the readings of all places,    y_yaw = half of (front mean - rear mean)
    F = F_sway + F_yaw at each front actuator,      F_sway - F_yaw at each rear one

Equal forces make no yaw moment and opposite ones no lateral force, so that sway (with roll) and yaw
are two loops as far as the carbody goes; they meet in the bogies alone.
"""

from dataclasses import dataclass

import numpy as np

from railenv.errors import unknown_name
from railenv.units import FloatArray
from railenv.vehicle.coordinates import (
    DAMPER_POSITIONS,
    Layout,
    actuator_positions,
    bogie_of_position,
    bogie_sign,
)

SIGNALS = ("velocity", "stroke", "roll_rate")
"""Carbody velocity at damper level [m/s], stroke at the dampers [m], carbody roll rate [rad/s]."""


@dataclass(frozen=True, eq=False)
class ModalSignals:
    """Modal readings of standard sensors, and the forces of the modes.

    Attributes:
        names: Names of the readings.
        sensors: Names of the sensors.
        readings: What each reading takes of each sensor, shape (readings, sensors).
        forces: What each actuator gives to sway and to yaw, shape (channels, 2).
        mode: 0 for a reading of sway, 1 for one of yaw.
    """

    names: tuple[str, ...]
    sensors: tuple[str, ...]
    readings: FloatArray
    forces: FloatArray
    mode: tuple[int, ...]


def modal_signals(layout: Layout, kinds: tuple[str, ...]) -> ModalSignals:
    """Return the readings of some kinds, each of sway and of yaw; roll rate belongs to sway alone.

    Args:
        layout: "2" or "4".
        kinds: Some of `SIGNALS`.

    Raises:
        ArgumentError: A kind does not exist.
    """
    places = actuator_positions(layout)
    sources = {
        "velocity": [(f"carbody_lateral_velocity_{k}", k) for k in places],
        "stroke": [(f"suspension_stroke_{k}", k) for k in DAMPER_POSITIONS],
        "roll_rate": [],
    }
    sensors: list[str] = []
    for kind in kinds:
        if kind not in SIGNALS:
            raise unknown_name("signal", kind, SIGNALS)
        sensors += [name for name, _ in sources[kind]] or ["carbody_roll_rate"]
    names: list[str] = []
    mode: list[int] = []
    rows: list[FloatArray] = []
    for number, motion in enumerate(("sway", "yaw")):
        for kind in kinds:
            row = np.zeros(len(sensors))
            for name, place in sources[kind]:
                row[sensors.index(name)] = _sign(place, number) / len(sources[kind])
            if not sources[kind]:
                if motion == "yaw":
                    continue
                row[sensors.index("carbody_roll_rate")] = 1.0
            names.append(f"{kind}_{motion}")
            mode.append(number)
            rows.append(row)
    forces = np.array([[_sign(k, 0), _sign(k, 1)] for k in places])
    return ModalSignals(
        tuple(names), tuple(sensors), np.array(rows).reshape(-1, len(sensors)), forces, tuple(mode)
    )


def _sign(place: int, mode: int) -> float:
    return 1.0 if mode == 0 else float(bogie_sign(bogie_of_position(place)))
