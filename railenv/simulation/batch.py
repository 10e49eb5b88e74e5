"""A batch of linear vehicles, each lane with its own vehicle, delays and clock: the physics loop.

The lanes know nothing of tracks or controllers: before every period somebody writes the track
inputs and the commands, afterwards reads the outputs. Parts of the lanes may be advanced by
different threads at the same time.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from railenv.actuation import ActuatorSpec, DelayLine
from railenv.actuation.delay_line import BoolArray, IntArray
from railenv.errors import ArgumentError
from railenv.simulation.plant import PlantTable
from railenv.simulation.stepping import LaneArrays, advance, begin
from railenv.units import FloatArray
from railenv.vehicle.suspension import NUM_TRACK


class VehicleBatch:
    """Lanes of vehicles out of a table.

    Args:
        table: The vehicles, ready for stepping.
        num_lanes: Number of lanes.
        steps_per_command: Physics steps in one control period.
        longest_delay: Longest delay, jitter included, that a lane may get [s].
        actuator: Force and rate limit; its lag is in the table.

    Attributes:
        plant: What the table holds for the compiled stepping, in whole cache lines.
        step: Physics steps since each lane's start, shape (lanes,).
        track: Track inputs (alignment at wheelsets 1 to 4 [m], track roll there [rad]) at the start
            of the coming period and the end of each of its steps, shape (lanes, steps + 1, 8).
        commands: Wanted forces of the coming period, shape (lanes, channels) [N].
        later: What these are late beyond the delay, shape (lanes, channels) [s].
        lost: Which of these get lost, shape (lanes, channels).
        active: Lanes that take part in the coming period, shape (lanes,).
        recorded: The table's `outputs` after each step of the last period, (lanes, steps, p).
        sampled: The table's `sampled` at its end, shape (lanes, q).
    """

    def __init__(
        self,
        table: PlantTable,
        num_lanes: int,
        steps_per_command: int,
        longest_delay: float,
        actuator: ActuatorSpec,
    ) -> None:
        n, m = table.num_modes, table.num_channels
        self.table = table
        arrays: dict[str, Any] = table.arrays._asdict()
        del arrays["time_step"]
        self.plant = table.arrays._replace(
            **{name: _on_cache_lines(values) for name, values in arrays.items()}
        )
        self.line = DelayLine(
            num_lanes, m, table.time_step, steps_per_command, longest_delay, actuator
        )
        self.lanes = LaneArrays(
            vehicle=np.zeros(num_lanes, dtype=np.int64),
            state=_on_cache_lines(np.zeros((num_lanes, n))),
            step=np.zeros(num_lanes, dtype=np.int64),
            force=np.zeros((num_lanes, m)),
            late=_on_cache_lines(np.zeros((num_lanes, m, n))),
            late_rest=np.full((num_lanes, m), -1.0),
            track=_on_cache_lines(np.zeros((num_lanes, steps_per_command + 1, NUM_TRACK))),
        )
        self.commands: FloatArray = np.zeros((num_lanes, m))
        self.later: FloatArray = np.zeros((num_lanes, m))
        self.lost: BoolArray = np.zeros((num_lanes, m), dtype=bool)
        self.active: BoolArray = np.ones(num_lanes, dtype=bool)
        self.recorded: FloatArray = np.zeros((num_lanes, steps_per_command, len(table.outputs)))
        self.sampled: FloatArray = np.zeros((num_lanes, len(table.sampled)))

    @property
    def step(self) -> IntArray:
        """Physics steps since each lane's start, shape (lanes,)."""
        return self.lanes.step

    @property
    def track(self) -> FloatArray:
        """Track inputs of the coming period, shape (lanes, steps + 1, 8)."""
        return self.lanes.track

    def start(
        self,
        lanes: IntArray,
        vehicles: IntArray,
        delays: FloatArray,
        state: FloatArray | None = None,
    ) -> None:
        """Put lanes back to time zero; their `track[:, -1]` must hold the track input there.

        Args:
            lanes: Lane numbers, shape (k,).
            vehicles: Vehicle of each in the table, shape (k,).
            delays: Delay of every channel, shape (k, channels) [s].
            state: States x of the vehicles, shape (k, n); None for rest.
        """
        self.line.start(lanes, delays)
        modes = self.modes(vehicles, state)
        begin(self.plant, self.lanes, lanes, vehicles, modes, self.sampled)
        self.prepare_late(lanes)

    def modes(self, vehicles: IntArray, state: FloatArray | None) -> FloatArray:
        """Return the modes xi of states x, one per vehicle number, shape (k, n); None for rest."""
        modes = np.zeros((len(vehicles), self.table.num_modes))
        if state is not None:
            for k, vehicle in enumerate(vehicles):
                modes[k] = self.table.to_modes(int(vehicle), state[k])
        return modes

    def advance(self, first: int, end: int) -> None:
        """Send the commands of the lanes from `first` to before `end` and advance them a period."""
        self.line.issue(
            self.lanes.step, self.active, first, end, self.commands, self.later, self.lost
        )
        advance(
            self.plant,
            self.lanes,
            self.line.arrays,
            self.active,
            first,
            end,
            self.recorded,
            self.sampled,
        )

    def end_track(self) -> None:
        """Go on on straight level track."""
        here = self.lanes
        modes = here.state.copy()
        for lane, vehicle in enumerate(here.vehicle):
            modes[lane] += here.track[lane, -1] @ self.table.arrays.ramp_end[vehicle]
        here.track[:] = 0.0
        here.state[:] = modes

    def states(self) -> FloatArray:
        """Return the states x of all lanes, shape (lanes, n)."""
        here = self.lanes
        return np.array(
            [
                self.table.from_modes(int(vehicle), state, track)
                for vehicle, state, track in zip(
                    here.vehicle, here.state, here.track[:, -1], strict=True
                )
            ]
        )

    def prepare_late(self, lanes: IntArray) -> None:
        """Without a series the effect of a late command is found once for constant delays."""
        here, rest = self.lanes, self.line.arrays.rest
        for lane in lanes if not self.table.smooth else ():
            for channel, late_by in enumerate(rest[lane]):
                effect = self.table.late_effect(int(here.vehicle[lane]), float(late_by))
                here.late[lane, channel] = effect[channel]
                here.late_rest[lane, channel] = late_by

    def refuse_jitter_if_stiff(self, jitter: float) -> None:
        """Refuse a varying delay where the effect of a late command is known for one delay only.

        Raises:
            ArgumentError: There is jitter and the plant is too stiff for it.
        """
        if jitter > 0.0 and not self.table.smooth:
            raise ArgumentError(
                f"jitter = {jitter:g} s cannot be simulated with an actuator so much faster than "
                f"the physics step of {self.table.time_step:g} s; make the actuator's lag longer, "
                "or zero, or time_step shorter"
            )


def _on_cache_lines(values: NDArray[Any]) -> NDArray[Any]:
    """Return a copy that begins where a cache line of 64 bytes does, for the vectors' sake."""
    line = 64
    raw = np.empty(values.nbytes + line, dtype=np.uint8)
    start = -raw.ctypes.data % line
    copy = raw[start : start + values.nbytes].view(values.dtype).reshape(values.shape)
    copy[...] = values
    return copy
