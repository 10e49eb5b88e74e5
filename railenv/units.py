"""Unit types, unit conversion and standard gravity.

A field annotated `Metre` is a plain float at run time; the annotation carries the unit so that
tables, records and tests can read it. No suffix in a name means SI base units; `_kmh`, `_mm`,
`_deg`, `_hz`, `_ms` and `_steps` say otherwise.
"""

from typing import Annotated

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]
ComplexArray = NDArray[np.complex128]

Dimensionless = Annotated[float, "1"]
Metre = Annotated[float, "m"]
Second = Annotated[float, "s"]
Hertz = Annotated[float, "Hz"]
PerSecond = Annotated[float, "1/s"]
Kilogram = Annotated[float, "kg"]
KilogramSquareMetre = Annotated[float, "kg m^2"]
MetrePerSecond = Annotated[float, "m/s"]
MetrePerSecondSquared = Annotated[float, "m/s^2"]
KilometrePerHour = Annotated[float, "km/h"]
Newton = Annotated[float, "N"]
NewtonPerSecond = Annotated[float, "N/s"]
NewtonMetre = Annotated[float, "N m"]
NewtonSquareMetre = Annotated[float, "N m^2"]
NewtonPerMetre = Annotated[float, "N/m"]
NewtonSecondPerMetre = Annotated[float, "N s/m"]
NewtonMetrePerRadian = Annotated[float, "N m/rad"]

STANDARD_GRAVITY: float = 9.80665
"""Standard acceleration of gravity [m/s^2] (ISO 80000-3)."""

_KMH_PER_METRE_PER_SECOND = 3.6


def from_kmh(speed_kmh: float) -> float:
    """Convert a speed from km/h to m/s."""
    return speed_kmh / _KMH_PER_METRE_PER_SECOND
