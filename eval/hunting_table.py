"""Linear critical speeds of the nonlinear vehicle beside the 17-coordinate one's.

`python -m eval.hunting_table` prints the table of docs/hunting.md: for every wheel the stretches of
speed on which the straight run is unstable, with everything on and with single effects off, and
the same of the 17-coordinate model with the conicity and creep coefficients that the contact has
at rest.
"""

import itertools
import sys
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.optimize import brentq

from railenv.contact.conicity import conicity
from railenv.contact.geometry import TREAD
from railenv.contact.hertz import SHEAR_MODULUS
from railenv.contact.table import patch, touch
from railenv.simulation.full_hunting import FullHunting
from railenv.units import FloatArray
from railenv.vehicle import VehicleParameters, get_vehicle, lateral17, state_space
from railenv.vehicle.nonlinear import ContactSettings, FullVehicle, equilibrium, full50

LOWEST, HIGHEST, STEP = 60.0, 1200.0, 15.0  # [km/h]

_HEAD = 0.01  # radius of the round rail under the cone: small, so that its conicity is the cone's
_SLOPE_STEP = 1e-6  # of shift and roll, as small as rounding allows


class AtRest(NamedTuple):
    """The contact of a centred wheelset.

    Attributes:
        slope: Half of the rolling radius difference by the shift, the wheelset's roll included [1].
        parameters: The lateral model's numbers with it, and with creep coefficients as computed.
        own_creep: The same with the vehicle's own creep coefficients.
    """

    slope: float
    parameters: VehicleParameters
    own_creep: VehicleParameters


def contact_at_rest(vehicle: FullVehicle) -> AtRest:
    """Return the conicity and creep coefficients that the table of contact has at rest."""
    arrays, d = vehicle.contact_arrays, _SLOPE_STEP
    _, by_shift, by_roll, *_ = touch(arrays, TREAD, 0.0, 0.0, 0.0)
    roll = -d * by_shift / by_roll  # both wheels stay on their rails
    right, left = patch(arrays, TREAD, d, roll, 0.0), patch(arrays, TREAD, -d, -roll, 0.0)
    slope = float(right[0] - left[0]) / (2.0 * d)
    *_, a1, b1, c11, c22, c23, c33 = patch(arrays, TREAD, 0.0, 0.0, 0.0)
    size = a1 * b1 * float(equilibrium(vehicle).wheels[0, 2]) ** (2.0 / 3.0)  # a b [m^2]
    own = vehicle.parameters.lateral.replace(conicity=slope)
    computed = own.replace(
        creep_longitudinal=SHEAR_MODULUS * size * c11,
        creep_lateral=SHEAR_MODULUS * size * c22,
        creep_lateral_spin=SHEAR_MODULUS * size**1.5 * c23,
        creep_spin=SHEAR_MODULUS * size**2 * c33,
    )
    return AtRest(slope, computed, own)


def unstable_stretches(linearisation: Callable[[float], FloatArray]) -> str:
    """Return on which speeds [km/h] a system is unstable, with the frequency at each boundary."""

    def root(speed_kmh: float) -> complex:
        roots = np.linalg.eigvals(linearisation(speed_kmh / 3.6))
        return complex(roots[np.argmax(roots.real)])

    speeds = np.arange(LOWEST, HIGHEST + STEP / 2.0, STEP).tolist()
    growth = [root(speed).real for speed in speeds]
    parts = [f"below {LOWEST:g}"] if growth[0] >= 0.0 else []
    for (left, before), (right, after) in itertools.pairwise(zip(speeds, growth, strict=True)):
        if (before >= 0.0) == (after >= 0.0):
            continue
        edge = float(brentq(lambda v: root(v).real, left, right, xtol=1e-6))
        frequency = abs(root(edge).imag) / (2.0 * np.pi)
        word = "from" if after >= 0.0 else "to"
        parts.append(f"{word} {edge:.1f} ({frequency:.2f} Hz)")
    return " ".join(parts) if parts else f"stable up to {HIGHEST:g}"


def _passive(contact: ContactSettings, **settings: bool) -> FullVehicle:
    return full50("paper_fit", "passive", 300.0, contact, **settings)


def _unstable(vehicle: FullVehicle) -> str:
    return unstable_stretches(FullHunting(vehicle).linearisation)


def _unstable17(parameters: VehicleParameters) -> str:
    return unstable_stretches(
        lambda speed: np.array(state_space(lateral17(parameters, "passive", 3.6 * speed)).A)
    )


def _cone(angle: float) -> ContactSettings:
    """A cone that touches at half the contact spacing, with the given creep coefficients."""
    spacing = get_vehicle("paper_fit").parameters.half_contact_spacing
    return ContactSettings(
        wheel=f"cone:angle={angle}",
        rail=f"arc:radius={_HEAD}",
        cant=0.0,
        rail_lateral=spacing + _HEAD * float(np.sin(np.arctan(angle))),
        law="given",
    )


def _say(line: str) -> None:
    sys.stdout.write(line + "\n")
    sys.stdout.flush()  # a line takes seconds


def main() -> None:
    """Print the table."""
    preset = get_vehicle("paper_fit").parameters
    _say(f"unstable speeds [km/h], looked for from {LOWEST:g} to {HIGHEST:g}")
    _say(f"17 coordinates as they are, conicity {preset.conicity:g}: {_unstable17(preset)}")
    cone = _cone(preset.conicity)
    for text, settings in (
        ("gravity coupling and roll off", {"gravity_coupling": False, "roll_coupling": False}),
        ("gravity coupling off", {"gravity_coupling": False}),
        ("roll off", {"roll_coupling": False}),
        ("everything on", {}),
    ):
        _say(
            f"cone {preset.conicity:g}, given creep, {text}: "
            f"{_unstable(_passive(cone, **settings))}"
        )
    for wheel in ("s1002cn", "lmb10", "lma"):
        contact = ContactSettings(wheel=wheel)
        vehicle = _passive(contact)
        rest = contact_at_rest(vehicle)
        p = rest.parameters
        three = float(conicity(vehicle.wheel_rail, [0.003]).conicity[0])
        _say(
            f"\n{wheel} on cn60: conicity {rest.slope:.4f} at rest, {three:.3f} at 3 mm (EN 15302)"
        )
        _say(
            f"  f11 {p.creep_longitudinal / 1e6:.2f} MN, f22 {p.creep_lateral / 1e6:.2f} MN, "
            f"f23 {p.creep_lateral_spin / 1e3:.1f} kN m, f33 {p.creep_spin:.0f} N m^2"
        )
        _say(f"  50 coordinates                            {_unstable(vehicle)}")
        for text, changed in (
            ("gravity coupling off", _passive(contact, gravity_coupling=False)),
            ("roll off", _passive(contact, roll_coupling=False)),
            ("Kalker's linear law", _passive(ContactSettings(wheel=wheel, law="linear"))),
            ("given creep coefficients", _passive(ContactSettings(wheel=wheel, law="given"))),
        ):
            _say(f"    {text:<40}{_unstable(changed)}")
        _say(f"  17 coordinates, computed creep            {_unstable17(rest.parameters)}")
        _say(f"    own creep coefficients                  {_unstable17(rest.own_creep)}")
        _say(
            "    computed creep, conicity at 3 mm        "
            f"{_unstable17(rest.parameters.replace(conicity=three))}"
        )


if __name__ == "__main__":
    main()
