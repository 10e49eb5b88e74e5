"""The optimum at a given force: what a law could have had for the force it spends.

The effort weight of the H2 design is turned until the optimum's force has the root mean square that
is asked for; the force falls with the weight, so that there is one such design at most.
"""

import numpy as np
from scipy.optimize import brentq

from baselines.design.model import DesignModel
from baselines.design.optimum import Estimator, Optimum, regulator
from railenv.errors import RailenvError, check_positive
from railenv.units import Newton

_LEAST, _MOST = 1e-9, 1e4
# Relative accuracy of the effort; the force then fits to a thousandth, the cost to far better.
_EFFORT_TOLERANCE = 1e-4


def optimum_at_force(model: DesignModel, knowledge: Estimator, force: Newton) -> Optimum | None:
    """Return the optimal law whose force has a given root mean square.

    Args:
        model: Vehicle, track and delay.
        knowledge: What the law knows: an estimator on sensors, or perfect knowledge.
        force: Root mean square over all channels [N].

    Returns:
        The law; None if no effort weight from 1e-9 to 1e4 (m/s^2)^2 leads to that force.
    """
    wanted = np.log(check_positive("force", force, "N"))

    def excess(log_effort: float) -> float:
        try:
            found = Optimum(model, regulator(model, float(np.exp(log_effort))), knowledge)
        except RailenvError:
            # The equation runs into rounding only where effort is next to nothing.
            return np.inf
        return float(np.log(found.force_rms) - wanted)

    # From the expensive side: a first bracket around the answer, a decade at a time.
    high = np.log(_MOST)
    if excess(high) > 0.0:
        return None
    while high > np.log(_LEAST):
        low = high - np.log(10.0)
        surplus = excess(low)
        if surplus > 0.0:
            if not np.isfinite(surplus):
                return None
            root = float(brentq(excess, low, high, xtol=_EFFORT_TOLERANCE))
            return Optimum(model, regulator(model, float(np.exp(root))), knowledge)
        high = low
    return None
