"""The linear 17-coordinate lateral vehicle, assembled from its elements.

    M q'' + (C + C_creep / v) q' + K q + sum_e r_e^T k_e (r_e q - z_e) = H^T F + T w + T' w'

with q of `coordinates.COORDINATES`, one Maxwell node z_e per yaw and remaining lateral damper, the
actuator forces F and the track's alignment and roll w at the four wheelsets. Wheel on rail is
linear (Kalker) with one equivalent conicity and gravitational stiffness. The speed v stands in one
place only: the creep damping divides by it.

Not modelled: longitudinal and vertical motion, wheelset roll, carbody pendulum, flange contact,
bump stops. For those see the nonlinear vehicle.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from railenv.errors import ArgumentError, check_positive
from railenv.units import FloatArray, MetrePerSecond
from railenv.vehicle.coordinates import (
    BOGIES,
    NUM_COORDINATES,
    WHEELSETS,
    Layout,
    actuator_positions,
    bogie_of_wheelset,
    bogie_sign,
    coordinate_index,
    end_sign,
    parse_layout,
)
from railenv.vehicle.parameters import VehicleParameters
from railenv.vehicle.suspension import (
    NUM_TRACK,
    MaxwellElement,
    ParallelElement,
    damper_row,
    maxwell_elements,
    parallel_elements,
)

SLOWEST, FASTEST = 1e-3, 1e3
"""Speeds at which the creep terms, which grow as 1/v, can still be computed [m/s]."""


@dataclass(frozen=True, eq=False)
class LateralVehicle:
    """The linear lateral vehicle at one speed: three fields, and the matrices that follow.

    Attributes:
        parameters: The vehicle's numbers.
        layout: "passive", "2" or "4".
        speed: Running speed v [m/s].

    Raises:
        ArgumentError: The layout does not exist or the speed is not above zero.
    """

    parameters: VehicleParameters
    layout: Layout
    speed: MetrePerSecond

    def __post_init__(self) -> None:
        object.__setattr__(self, "layout", parse_layout(self.layout))
        speed = check_positive("speed", self.speed, "m/s")
        if not SLOWEST <= speed <= FASTEST:
            raise ArgumentError(
                f"speed = {speed:g} m/s is beyond the model; give {SLOWEST:g} to {FASTEST:g} m/s "
                f"({3.6 * SLOWEST:g} to {3.6 * FASTEST:g} km/h)"
            )
        object.__setattr__(self, "speed", speed)

    @property
    def num_actuators(self) -> int:
        """Number of actuator channels."""
        return len(actuator_positions(self.layout))

    @cached_property
    def elements(self) -> tuple[ParallelElement, ...]:
        """Primary and secondary suspension."""
        return parallel_elements(self.parameters)

    @cached_property
    def dampers(self) -> tuple[MaxwellElement, ...]:
        """Yaw dampers and the remaining lateral dampers."""
        return maxwell_elements(self.parameters, self.layout)

    @cached_property
    def mass(self) -> FloatArray:
        """Mass matrix M [kg, kg m^2], shape (17, 17), diagonal."""
        p = self.parameters
        diagonal = [p.wheelset_mass, p.wheelset_yaw_inertia] * len(WHEELSETS)
        diagonal += [p.bogie_mass, p.bogie_yaw_inertia, p.bogie_roll_inertia] * len(BOGIES)
        diagonal += [p.carbody_mass, p.carbody_yaw_inertia, p.carbody_roll_inertia]
        return np.diag(diagonal)

    @cached_property
    def suspension_stiffness(self) -> FloatArray:
        """Sum of k r^T r over the parallel elements, shape (17, 17), positive semidefinite."""
        return _gram(self.elements, "stiffness")

    @cached_property
    def suspension_damping(self) -> FloatArray:
        """Sum of c r^T r over the parallel elements, shape (17, 17), positive semidefinite."""
        return _gram(self.elements, "damping")

    @cached_property
    def contact_stiffness(self) -> FloatArray:
        """Conicity, creep and gravity terms in displacements, shape (17, 17), not symmetric."""
        p = self.parameters
        K = np.zeros((NUM_COORDINATES, NUM_COORDINATES))
        for wheelset in WHEELSETS:
            y = coordinate_index(f"wheelset{wheelset}_lateral")
            psi = coordinate_index(f"wheelset{wheelset}_yaw")
            K[y, y] += p.axle_load * p.conicity / p.half_contact_spacing
            K[y, psi] += -2 * p.creep_lateral
            K[psi, y] += self._steering
            K[psi, psi] += 2 * p.creep_lateral_spin
            K[psi, psi] += -p.axle_load * p.half_contact_spacing * p.conicity
        return K

    @cached_property
    def creep_damping(self) -> FloatArray:
        """Creep terms in velocities times the speed, C_creep [N], shape (17, 17)."""
        p = self.parameters
        C = np.zeros((NUM_COORDINATES, NUM_COORDINATES))
        for wheelset in WHEELSETS:
            y = coordinate_index(f"wheelset{wheelset}_lateral")
            psi = coordinate_index(f"wheelset{wheelset}_yaw")
            C[y, y] += 2 * p.creep_lateral
            C[y, psi] += 2 * p.creep_lateral_spin
            C[psi, y] += -2 * p.creep_lateral_spin
            C[psi, psi] += 2 * p.creep_longitudinal * p.half_contact_spacing**2
            C[psi, psi] += 2 * p.creep_spin
        return C

    @cached_property
    def track_stiffness(self) -> FloatArray:
        """Force on the coordinates per track displacement, shape (17, 8).

        Columns: alignment at wheelsets 1 to 4 [m], track roll at wheelsets 1 to 4 [rad, right rail
        down]. Alignment acts through conicity and gravitational stiffness only (the rail does not
        move sideways); track roll turns the axle load and the primary vertical suspension.
        """
        p = self.parameters
        T = np.zeros((NUM_COORDINATES, NUM_TRACK))
        for column, wheelset in enumerate(WHEELSETS):
            y = coordinate_index(f"wheelset{wheelset}_lateral")
            psi = coordinate_index(f"wheelset{wheelset}_yaw")
            T[y, column] += p.axle_load * p.conicity / p.half_contact_spacing
            T[psi, column] += self._steering
            T[y, len(WHEELSETS) + column] += p.axle_load
        for element in self.elements:
            T[:] += element.stiffness * np.outer(element.row, element.track_row)
        return T

    @cached_property
    def track_damping(self) -> FloatArray:
        """Force on the coordinates per rate of the track displacements, shape (17, 8)."""
        T = np.zeros((NUM_COORDINATES, NUM_TRACK))
        for element in self.elements:
            T[:] += element.damping * np.outer(element.row, element.track_row)
        return T

    @cached_property
    def actuator_rows(self) -> FloatArray:
        """Stretch of each actuator per coordinate, H, shape (channels, 17).

        A force +F on the carbody and -F on the bogie is the generalised force H^T F.
        """
        rows = [damper_row(self.parameters, p) for p in actuator_positions(self.layout)]
        return np.array(rows).reshape(self.num_actuators, NUM_COORDINATES)

    @cached_property
    def wheelset_setback(self) -> FloatArray:
        """Distance of each wheelset behind the leading one [m], shape (4,)."""
        p = self.parameters
        places = [
            bogie_sign(bogie_of_wheelset(w)) * p.half_bogie_spacing + end_sign(w) * p.half_wheelbase
            for w in WHEELSETS
        ]
        return places[0] - np.array(places)

    @property
    def _steering(self) -> float:
        """Yaw moment per lateral offset from coned wheels, 2 f_11 b lambda / r_0 [N]."""
        p = self.parameters
        return 2 * p.creep_longitudinal * p.half_contact_spacing * p.conicity / p.wheel_radius


def _gram(elements: tuple[ParallelElement, ...], weight: str) -> FloatArray:
    total = np.zeros((NUM_COORDINATES, NUM_COORDINATES))
    for element in elements:
        total += getattr(element, weight) * np.outer(element.row, element.row)
    return total
