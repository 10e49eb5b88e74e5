"""Linear lateral vehicles whose actuators are semi-active dampers.

The same face as `LateralSimulation`, but a command is a damping coefficient (see
`railenv.actuation.semi_active`): it is limited to the damper's range, waits for its delay, is held
until the next one arrives and is followed with the damper's response time. The force is that
coefficient times the present stroke rate, up to the force at which the damper blows off.

The stepping (`railenv.simulation.semi_active_stepping`) is a splitting with inner steps of 1 ms or
less: dissipative whatever the coefficient, and with an error that falls with the square of the
inner step. Delays are not rounded: the coefficient's integral over an inner step is exact whatever
instant a command arrives at, and so is the recorded coefficient. Before the first command arrives
a damper has its lowest coefficient.
"""

import math
from collections.abc import Sequence

import numpy as np

from railenv.actuation import ActuatorSpec, SemiActiveDamper, coefficient_names
from railenv.actuation.actuator import PAPER_FORCE_LIMIT
from railenv.actuation.delay_line import BoolArray, IntArray
from railenv.errors import ArgumentError, check_positive
from railenv.simulation.batch import VehicleBatch
from railenv.simulation.lateral import (
    DEFAULT_CONTROL_PERIOD,
    DEFAULT_TIME_STEP,
    LateralSimulation,
    check_time_step,
    whole_multiple,
)
from railenv.simulation.plant import PlantTable
from railenv.simulation.semi_active_stepping import (
    CHANNELS,
    DamperArrays,
    advance_dampers,
    begin_dampers,
)
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle
from railenv.vehicle.coordinates import actuator_positions

LONGEST_INNER_STEP = 0.001
"""Longest inner step [s]. On German low at 300 km/h the ride index differs from its limit by less
than 0.0001 for continuous laws, by 0.005 for on-off switching between 5 and 60 kN s/m, where a
switch that comes one control period sooner changes the run."""


class SemiActiveSimulation(LateralSimulation):
    """A batch of linear lateral vehicles on semi-active dampers.

    Args:
        vehicle: The vehicle, shared by all lanes; layout 2 or 4.
        outputs: Names of the outputs or states recorded at every record step, of the vehicle or
            `damping_coefficient_1` and so on, c at that instant [N s/m].
        damper: The dampers, all alike.
        force_limit: Force at which a damper blows off [N]; None for never.
        control_period: Time between commands [s], a whole multiple of `time_step`.
        time_step: Time between records [s]; divided into equal inner steps. The track is linear
            over it.
        longest_inner_step: Longest inner step [s].
        specific_force: Accelerometers measure y'' - g roll.

    Raises:
        ArgumentError: The vehicle has no actuator, a step size is not above zero, the control
            period is no whole multiple of the record step, or an output's name is unknown.
    """

    def __init__(
        self,
        vehicle: LateralVehicle,
        outputs: Sequence[str],
        *,
        damper: SemiActiveDamper,
        force_limit: float | None = PAPER_FORCE_LIMIT,
        control_period: float = DEFAULT_CONTROL_PERIOD,
        time_step: float = DEFAULT_TIME_STEP,
        longest_inner_step: float = LONGEST_INNER_STEP,
        specific_force: bool = False,
    ) -> None:
        places = actuator_positions(vehicle.layout)
        if not places:
            raise ArgumentError(
                "layout = 'passive' has no place for a semi-active damper; choose 2 or 4"
            )
        step = check_time_step(time_step)
        longest = check_positive("longest_inner_step", longest_inner_step, "seconds")
        # A record step that is a whole number of longest steps must not get one more by rounding.
        inner_steps = max(1, math.ceil(step / longest - 1e-9))
        coefficients = coefficient_names(vehicle.layout)
        plain = tuple(dict.fromkeys(name for name in outputs if name not in coefficients))
        columns = (*plain, *(f"suspension_stroke_rate_{k}" for k in places))
        self.damper = damper
        # The linear vehicle's own lanes come first: they make the table that the dampers need.
        self._dampers: DamperArrays | None = None
        super().__init__(
            vehicle,
            columns,
            actuator=ActuatorSpec(force_limit=None),
            control_period=control_period,
            time_step=step / inner_steps,
            specific_force=specific_force,
        )
        self.outputs = tuple(outputs)
        self.time_step = step
        self.steps_per_command = whole_multiple(
            "control_period", self.control_period, "time_step", step
        )
        known = (*columns, *coefficients)
        limit = np.inf if force_limit is None else check_positive("force_limit", force_limit, "N")
        self._dampers = _damper_arrays(
            self._table,
            damper,
            np.array([known.index(name) for name in self.outputs], dtype=np.int64),
            float(limit),
            inner_steps,
        )
        self._start(1, 0.0)

    def _start(self, num_lanes: int, longest_delay: float) -> None:
        super()._start(num_lanes, longest_delay)
        if self._dampers is not None:
            self._batch = _DamperBatch(
                self._table,
                num_lanes,
                self.steps_per_command,
                longest_delay,
                self._dampers,
                self.damper.lowest,
            )

    def advance(
        self,
        commands: FloatArray,
        later: FloatArray | None = None,
        lost: BoolArray | None = None,
    ) -> FloatArray:
        """Advance every lane by one control period.

        Args:
            commands: Wanted coefficients, before the damper's range, shape (lanes, channels)
                [N s/m].
            later: What each command is late beyond its delay; see `LateralSimulation.advance`.
            lost: Commands that get lost, so that the damper keeps its last one.

        Returns:
            The outputs at the end of each record step, shape (lanes, steps, outputs), a new array.

        Raises:
            ArgumentError: An array has the wrong shape, a value is out of its range, or the track
                ends.
        """
        if not np.all(np.isfinite(commands)):
            raise ArgumentError("commands holds a value that is not finite; give N s/m")
        return super().advance(self.damper.limited(commands), later, lost)


def _damper_arrays(
    table: PlantTable, damper: SemiActiveDamper, source: IntArray, limit: float, inner_steps: int
) -> DamperArrays:
    """Return what the stepping reads of the dampers, for no lane yet.

    Args:
        table: The vehicle over an inner step; its last outputs are the stroke rates.
        damper: The dampers.
        source: See `DamperArrays`.
        limit: Force at which a damper blows off [N]; infinite for never.
        inner_steps: Inner steps in a record step.
    """
    system, m = table.systems[0], table.num_channels
    first = table.num_modes + table.arrays.ramp_end.shape[1]
    rate_rows, _ = system.output_rows(table.outputs[-m:])
    B = system.actuator_input
    spare = (0, CHANNELS - m)
    return DamperArrays(
        rate=np.pad(table.arrays.record[0, :first, -m:], ((0, 0), spare)),
        push=np.pad([table.to_modes(0, column) for column in B.T], (spare, (0, 0))),
        mobility=np.pad(rate_rows @ B, (spare, spare)),
        coefficient=np.zeros((0, m)),
        command=np.zeros((0, m)),
        source=source,
        response_time=damper.response_time,
        force_limit=limit,
        inner_steps=inner_steps,
    )


class _DamperBatch(VehicleBatch):
    """Lanes of one vehicle on dampers; `commands` are coefficients, the lanes count inner steps."""

    def __init__(
        self,
        table: PlantTable,
        num_lanes: int,
        steps_per_command: int,
        longest_delay: float,
        dampers: DamperArrays,
        lowest: float,
    ) -> None:
        super().__init__(
            table, num_lanes, steps_per_command, longest_delay, ActuatorSpec(force_limit=None)
        )
        shape = self.commands.shape
        self._dampers = dampers._replace(
            coefficient=np.full(shape, lowest), command=np.full(shape, lowest)
        )
        self._plain = self.sampled
        self.recorded = np.zeros((num_lanes, steps_per_command, len(dampers.source)))

    def start(
        self,
        lanes: IntArray,
        vehicles: IntArray,
        delays: FloatArray,
        state: FloatArray | None = None,
    ) -> None:
        """Put lanes back to time zero; see `VehicleBatch.start`."""
        # The linear vehicle's start works out its own outputs, without the dampers' forces.
        self.sampled = self._plain
        super().start(lanes, vehicles, delays, state)
        self.sampled = np.zeros((len(self.step), len(self._dampers.source)))
        begin_dampers(self.plant, self._dampers, self.lanes, self.sampled)

    def refuse_jitter_if_stiff(self, jitter: float) -> None:
        """Refuse nothing: a late coefficient is integrated exactly, whatever the vehicle."""

    def advance(self, first: int, end: int) -> None:
        """Send the commands of the lanes from `first` to before `end` and advance them a period."""
        self.line.issue(
            self.lanes.step, self.active, first, end, self.commands, self.later, self.lost
        )
        advance_dampers(
            self.plant, self._dampers, self.lanes, self.line.arrays, first, end, self.recorded
        )
