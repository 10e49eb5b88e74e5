"""A damper whose coefficient is commanded, in the place of an actuator.

Order in the channel: command, range, hold, delay, response, coefficient, force. A commanded
coefficient is limited to the damper's range, arrives after the delay and is held until the next one
does. The coefficient follows with a first-order response, and the force on the carbody is the
coefficient times the present stroke rate, whatever it was when the command was computed:

    T_r c' = c_command(t - tau) - c,   F = -c s',   |F| <= blow-off,   c_min <= c <= c_max

s is the stroke, carbody minus bogie at the damper's place. F s' <= 0 always: the damper can take
energy out of the vehicle, never put any in. Beyond the force at which its valve blows off it
dissipates with less than c. The law is that of Karnopp, Crosby and Harwood, J. Eng. Ind. 96 (1974)
619; response and range as in Savaresi et al., Semi-Active Suspension Control Design for Vehicles
(2010).

Not modelled: the rubber in the damper's ends (a spring in series), friction, a force at rest.
"""

from dataclasses import dataclass

import numpy as np

from railenv.errors import ArgumentError, check_not_negative, check_positive
from railenv.units import FloatArray, NewtonSecondPerMetre, Second
from railenv.vehicle.coordinates import Layout, actuator_positions


@dataclass(frozen=True)
class SemiActiveDamper:
    """What a semi-active damper can do.

    Attributes:
        lowest: Smallest coefficient c_min [N s/m]; chosen, a third of a passive lateral damper's
            15 kN s/m (Chen, Shi, Yu, Appendix 2). It also holds before the first command arrives.
        highest: Largest coefficient c_max [N s/m]; chosen, twice that of the passive damper. Real
            ones go higher (a public CRH380A parameter set has passive dampers of 58.8 kN s/m), but
            tie the carbody to the bogies' motion.
        response_time: Time constant T_r of the coefficient [s]; 0 for at once. Chosen, of the order
            of a fast valve or a magnetorheological fluid.

    Raises:
        ArgumentError: A number is negative or not finite, `highest` is zero, or the range is empty.
    """

    lowest: NewtonSecondPerMetre = 5e3
    highest: NewtonSecondPerMetre = 30e3
    response_time: Second = 0.01

    def __post_init__(self) -> None:
        for name, value in (
            ("lowest", check_not_negative("lowest", self.lowest, "N s/m")),
            ("highest", check_positive("highest", self.highest, "N s/m")),
            ("response_time", check_not_negative("response_time", self.response_time, "seconds")),
        ):
            object.__setattr__(self, name, value)
        if self.lowest > self.highest:
            raise ArgumentError(
                f"lowest = {self.lowest:g} N s/m must not be above highest = {self.highest:g} "
                "N s/m; swap them"
            )

    def limited(self, command: FloatArray) -> FloatArray:
        """Return commanded coefficients within the damper's range, any shape [N s/m]."""
        return np.clip(command, self.lowest, self.highest)

    def towards(self, force: FloatArray, stroke_rate: FloatArray) -> FloatArray:
        """Return the coefficient whose force comes nearest to a wanted one ("clipping").

        -force / stroke_rate within the range where the wanted force resists the stroke, else the
        lowest one: a damper cannot push. Response, delay and blow-off are not foreseen.

        Args:
            force: Wanted force on the carbody, any shape [N].
            stroke_rate: Rate of the stroke, same shape [m/s].

        Returns:
            Coefficients, same shape [N s/m].
        """
        force, stroke_rate = np.broadcast_arrays(force, stroke_rate)
        size, speed = np.abs(force), np.abs(stroke_rate)
        resists = force * stroke_rate < 0.0
        # Compared first and divided after: near rest the quotient would overflow.
        within = resists & (size < self.highest * speed)
        wanted = np.where(resists, self.highest, self.lowest)
        np.divide(size, speed, out=wanted, where=within)
        return self.limited(wanted)


def coefficient_names(layout: Layout) -> tuple[str, ...]:
    """Return the names of the dampers' coefficients, `damping_coefficient_1` and so on."""
    return tuple(f"damping_coefficient_{k}" for k in actuator_positions(layout))
