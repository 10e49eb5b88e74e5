"""A controller of your own for railenv's benchmark: a sky-hook with a filter, told the delay.

From the folder where this file lies:

    railenv benchmark --check py:my_controller:controller                  # what is wrong with it
    railenv benchmark --suite smoke --controller py:my_controller:controller
    railenv benchmark --suite quick --controller py:my_controller:controller --jobs 2

The law resists the carbody's sideways velocity over each actuator, F = -gain * v, as a damper
would that is hooked to the sky. Velocities below the corner of a high-pass filter are left out,
since a slow drift is a curve and no swaying. The later its commands come, the less it dares.
Everything here is yours to change; what has to stay is said where it stands.
"""

import math

import numpy as np

GAIN = 12e3
"""Force over velocity without delay [N s/m]."""

CORNER = 0.1
"""Frequency below which velocities are left out [Hz]."""

HALVED_AT = 0.15
"""Delay at which half the gain is left [s]."""

PERIOD = 0.01
"""Time between two calls of `act` [s]."""


class FilteredSkyHook:
    """Filtered velocity in, force out, for many vehicles (lanes) at a time.

    All arrays have one row per lane. A lane's actions must follow from its own row alone, whatever
    the other lanes do and however many there are: no means over rows, no state that lanes share.

    Args:
        layout: "2" or "4": how many actuators, and so how many columns `act` returns.
    """

    # Force of an action of one [N]. Actions are numbers around one, forces are held to 30 kN.
    action_scale = 3e3

    # Time between two calls of act [s]; leave it out to take whatever the benchmark has.
    control_period = PERIOD

    def __init__(self, layout):
        self.channels = int(layout)
        # What `measures` names comes as the first columns of an observation, in this order, in SI
        # units. Leave it out for the standard sensors.
        places = (1, 2, 3, 4) if self.channels == 4 else (1, 4)
        self.measures = tuple(f"carbody_lateral_velocity_{place}" for place in places)
        # Share of its memory that the filter keeps from one period to the next.
        self.kept = math.exp(-2.0 * math.pi * CORNER * PERIOD)

    def reset(self, num_lanes, seed):
        """Forget everything: a new run of so many lanes begins.

        A run must come out the same again: whoever draws at random draws from
        np.random.default_rng(seed).
        """
        del seed  # nothing is drawn here
        self.slow = np.zeros((num_lanes, self.channels))
        self.gain = np.full((num_lanes, 1), GAIN)

    def tell(self, delays):
        """Take notice of the delay of every lane [s], shape (lanes,), after each reset.

        Whoever has this method is in the division that is told the delay. Remove it to stand in
        the other one; there 300 ms must be borne without knowing.
        """
        self.gain = GAIN / (1.0 + delays[:, None] / HALVED_AT)

    def act(self, observations):
        """Return actions, shape (lanes, channels), for observations, shape (lanes, columns).

        The columns are what is measured, with noise, and then past actions, the newest first. What
        comes in must not be changed: make new arrays. Every number that goes out must be finite.
        A positive action pushes the carbody to positive y.
        """
        velocity = observations[:, : self.channels]
        self.slow = self.kept * self.slow + (1.0 - self.kept) * velocity
        return -self.gain * (velocity - self.slow) / self.action_scale


def controller(layout):
    """Return the controller; `railenv benchmark` calls this, once per vehicle and layout."""
    return FilteredSkyHook(layout)
