"""Time-domain simulation: exact stepping of batches of vehicles on tracks."""

from railenv.simulation.batch import VehicleBatch
from railenv.simulation.excitation import required_length, wheelset_inputs
from railenv.simulation.lateral import (
    DEFAULT_CONTROL_PERIOD,
    DEFAULT_TIME_STEP,
    LateralSimulation,
    whole_multiple,
)
from railenv.simulation.plant import PlantTable
from railenv.simulation.semi_active import SemiActiveSimulation
from railenv.simulation.trajectory import Trajectory

__all__ = [
    "DEFAULT_CONTROL_PERIOD",
    "DEFAULT_TIME_STEP",
    "LateralSimulation",
    "PlantTable",
    "SemiActiveSimulation",
    "Trajectory",
    "VehicleBatch",
    "required_length",
    "wheelset_inputs",
    "whole_multiple",
]
