"""Linear controllers as systems of scipy.signal and python-control.

What is exported maps the readings y to the forces u [N], sign included: with u = -law(y) it is
-law. `control.feedback(plant, exported, sign=+1)` closes it, since that function subtracts by
default; `DelaySystem.from_loop(plant, controller)` takes u = -controller(y) and is given
`-exported`.

A continuous law stays continuous: what a run does with it from sample to sample is another system
(`to_sampled_loop`). A sampled law comes in discrete time with its control period, and without the
hold and the delay, which belong to the loop. A gain has no time of its own.
"""

from typing import Any

import numpy as np

from railenv.errors import ArgumentError
from railenv.stability.loops import LinearSystem
from railenv.vehicle.coordinates import Layout, actuator_positions


def to_scipy(law: LinearSystem, period: float | None) -> Any:
    """Return -law as a state space of scipy.signal.

    Args:
        law: The law, u = -law(y).
        period: Control period of a sampled law [s]; None for a continuous law or a gain.

    Raises:
        ArgumentError: The law has no input or no output.
    """
    # Half a second of import that no other command needs.
    from scipy import signal

    _check_ends(law)
    matrices = (law.A.copy(), law.B.copy(), -law.C, -law.D)
    return (
        signal.StateSpace(*matrices) if period is None else signal.StateSpace(*matrices, dt=period)
    )


def to_control(
    law: LinearSystem, period: float | None, sensors: tuple[str, ...], layout: Layout
) -> Any:
    """Return -law as a state space of python-control.

    Args:
        law: The law, u = -law(y).
        period: Control period of a sampled law [s]; None for a continuous law or a gain.
        sensors: Names of the inputs.
        layout: The actuators' layout; the outputs are `actuator_force_1` and so on.

    Returns:
        The system with these labels; a gain has no time base (dt is None) and joins any plant.

    Raises:
        ArgumentError: The law has no input or no output, or python-control is not installed.
    """
    _check_ends(law)
    try:
        import control
    except ImportError:
        raise ArgumentError(
            "to_control needs python-control, which is not installed; pip install control, or ask "
            "to_scipy"
        ) from None
    time_base: float | None = period
    if period is None and law.A.size:
        time_base = 0
    return control.ss(
        law.A,
        law.B,
        -law.C,
        -law.D,
        dt=time_base,
        inputs=list(sensors),
        outputs=[f"actuator_force_{place}" for place in actuator_positions(layout)],
    )


def _check_ends(law: LinearSystem) -> None:
    if 0 in np.shape(law.D):
        outputs, inputs = law.D.shape
        raise ArgumentError(
            f"a law of {inputs} sensors and {outputs} actuators is no system to export; give one "
            "with at least one of each"
        )
