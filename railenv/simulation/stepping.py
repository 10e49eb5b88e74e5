"""The compiled physics step of linear vehicles: exact, lane by lane.

The state is held in the vehicle's own modes (see `railenv.simulation.plant`), where the transition
falls into blocks of two. One physics step of length h:

    z <- Phi z + Gamma w + G(h) f + sum over switches of G(h - r) (f_after - f_before)

w is the track input at the start of the step, linear over the step (first-order hold; z stands for
the state less what the present input will still contribute, which halves the work), f the force at
the start and r the instant inside the step at which a late command takes over, so that a delay
needs no rounding.

Every lane is computed on its own with a fixed order of operations: no matrix library, no
reassociation, no reduction across lanes. A lane's numbers do not depend on how many lanes there
are or on how they are shared among threads. Matrices are passed transposed so that the inner loops
run over contiguous memory, and rows are taken four at a time. Inside the loops arrays are indexed
in full, through names taken before, and no function is handed one: a view, a field of a tuple or an
argument would touch the array's shared reference count, which threads fight for. So the same short
loop over four rows stands here several times.

Compiled functions that call each other stand in one file, because the compiler's cache
watches only the file of the function that is called: a change elsewhere would go on running as it
was.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from llvmlite import ir as llvm_ir  # pyright: ignore[reportMissingTypeStubs]
from numba import njit
from numba.core import cgutils as code_generation
from numba.core import types
from numba.extending import intrinsic as compiled_from
from numpy.typing import NDArray

from railenv.actuation.delay_line import QueueArrays
from railenv.units import FloatArray

# The compiler's own tools, which have no type stubs.
ir: Any = llvm_ir
cgutils: Any = code_generation
intrinsic: Any = compiled_from

IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]

AT_ONCE = (40, 24, 8, 1)
"""Columns that `add_rows` takes at once: as many as are left at most, the largest number first."""


class PlantArrays(NamedTuple):
    """Matrices of every vehicle; n states, m channels, k track inputs, v = (z, w, f).

    n is a multiple of four, and so is the number of rows of all that multiplies v or (w, f): states
    and rows without meaning fill up, and stay zero.

    Attributes:
        pairs: Phi of modes taken two by two, mode i with mode n/2 + i: the 2 x 2 blocks' entries
            (here to here, there to here, here to there, there to there), shape (vehicles, 4, n/2).
        full: Phi where the modes do not separate, shape (vehicles, n, n); else without vehicles.
        inputs: Gamma and G(h) transposed, shape (vehicles, k + m or more, n).
        ramp_end: W_1 transposed, shape (vehicles, k, n).
        late: Chebyshev coefficients of G(s) over s in [0, h], shape (vehicles, terms, m, n).
        record: Outputs of every step from v, transposed, shape
            (vehicles, n + k + m or more, p).
        final: Those and then the outputs of every control period from v, transposed, shape
            (vehicles, n + k + m or more, p + q).
        time_step: h [s].
    """

    pairs: FloatArray
    full: FloatArray
    inputs: FloatArray
    ramp_end: FloatArray
    late: FloatArray
    record: FloatArray
    final: FloatArray
    time_step: float


class LaneArrays(NamedTuple):
    """What every lane carries from one call to the next.

    Attributes:
        vehicle: Number of its vehicle, shape (lanes,).
        state: z, shape (lanes, n).
        step: Physics steps since its start, shape (lanes,).
        force: Command in effect, shape (lanes, m) [N].
        late: G(h - r) for the latest r of each channel, shape (lanes, m, n).
        late_rest: That r, shape (lanes, m) [s]; negative for none yet.
        track: Track inputs at every step of the control period, shape (lanes, steps + 1, k).
    """

    vehicle: IntArray
    state: FloatArray
    step: IntArray
    force: FloatArray
    late: FloatArray
    late_rest: FloatArray
    track: FloatArray


@intrinsic
def add_rows(
    _: Any, rows: Any, number: Any, values: Any, first: Any, sums: Any
) -> tuple[Any, Callable[..., Any]]:
    """Add rows of a matrix times a number each: sums += values[first:] @ rows[number].

    What the plain loops over groups of four rows a, b, c, d would give, to the last bit,

        sums[i] += rows[number, a, i] * values[first + a] + ... + rows[number, d, i] * ...

    with the sums of some columns held in registers from the first row to the last: the loops, left
    to the compiler, take two to three times as long.

    Args:
        rows: Shape (any, a multiple of four, columns).
        number: Which of the matrices.
        values: One number per row, from `first` on.
        first: Where they begin.
        sums: Shape (columns,); changed.
    """
    signature = types.void(rows, number, values, first, sums)

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        matrix, value, total = (
            context.make_array(signature.args[k])(context, builder, arguments[k]) for k in (0, 2, 4)
        )
        _, count, width = cgutils.unpack_tuple(builder, matrix.shape, 3)
        size = builder.mul(count, width)
        matrix_at = builder.gep(matrix.data, [builder.mul(arguments[1], size)])
        value_at = builder.gep(value.data, [arguments[3]])
        groups = builder.sdiv(count, count.type(4))
        begin = count.type(0)
        for columns in AT_ONCE:
            blocks = builder.sdiv(builder.sub(width, begin), count.type(columns))
            with cgutils.for_range(builder, blocks) as block:
                here = builder.add(begin, builder.mul(block.index, count.type(columns)))
                _add_block(
                    builder,
                    columns,
                    builder.gep(matrix_at, [here]),
                    width,
                    groups,
                    value_at,
                    builder.gep(total.data, [here]),
                )
            begin = builder.add(begin, builder.mul(blocks, count.type(columns)))
        return context.get_dummy_value()

    return signature, generate


def _add_block(
    builder: Any, columns: int, matrix: Any, width: Any, groups: Any, value: Any, total: Any
) -> None:
    """Write the code that adds up some neighbouring columns, eight in each vector."""
    lanes = min(columns, 8)
    vector = ir.VectorType(ir.DoubleType(), lanes)
    everywhere = ir.Constant(ir.VectorType(ir.IntType(32), lanes), [0] * lanes)
    integer = width.type

    def load(pointer: Any, *offset: Any) -> Any:
        for steps in offset:
            pointer = builder.gep(pointer, [steps])
        return builder.load(builder.bitcast(pointer, vector.as_pointer()), align=8)

    parts = [integer(start) for start in range(0, columns, lanes)]
    sums = [cgutils.alloca_once_value(builder, load(total, part)) for part in parts]
    with cgutils.for_range(builder, groups) as group:
        row = builder.mul(group.index, integer(4))
        numbers = [builder.add(row, integer(k)) for k in range(4)]
        factors: list[Any] = []
        for k in numbers:
            one = builder.load(builder.gep(value, [k]))
            single = builder.insert_element(vector(ir.Undefined), one, ir.IntType(32)(0))
            factors.append(builder.shuffle_vector(single, vector(ir.Undefined), everywhere))
        offsets = [builder.mul(k, width) for k in numbers]
        for part, place in zip(parts, sums, strict=True):
            products = [
                builder.fmul(load(matrix, offset, part), factor)
                for offset, factor in zip(offsets, factors, strict=True)
            ]
            four = products[0]
            for product in products[1:]:
                four = builder.fadd(four, product)
            builder.store(builder.fadd(builder.load(place), four), place)
    for part, place in zip(parts, sums, strict=True):
        there = builder.bitcast(builder.gep(total, [part]), vector.as_pointer())
        builder.store(builder.load(place), there, align=8)


@njit(cache=True, nogil=True, error_model="numpy")
def begin(
    plant: PlantArrays,
    lanes: LaneArrays,
    which: IntArray,
    vehicles: IntArray,
    modes: FloatArray,
    sampled: FloatArray,
) -> None:
    """Put some lanes back to time zero and take their outputs before anything has moved.

    Args:
        plant: Matrices by vehicle.
        lanes: The track input now stands in `track[:, -1]`; everything else is set.
        which: Lane numbers, shape (count,).
        vehicles: Vehicle of each of them, shape (count,).
        modes: xi of these lanes, shape (count, n).
        sampled: Outputs, shape (lanes, q); overwritten for these lanes.
    """
    final_rows, ramp_end, state, force_of = plant.final, plant.ramp_end, lanes.state, lanes.force
    track, vehicle_of = lanes.track, lanes.vehicle
    step_of, late_rest = lanes.step, lanes.late_rest
    n, m, k = state.shape[1], force_of.shape[1], track.shape[2]
    width = final_rows.shape[2]
    p = width - sampled.shape[1]
    v = np.zeros(final_rows.shape[1])
    share = np.empty(n)
    y = np.empty(width)
    for number in range(len(which)):
        lane = which[number]
        vehicle = vehicles[number]
        vehicle_of[lane] = vehicle
        step_of[lane] = 0
        for j in range(k):
            v[n + j] = track[lane, -1, j]
        for c in range(m):
            force_of[lane, c] = 0.0
            late_rest[lane, c] = -1.0
        for i in range(n):
            share[i] = 0.0
        add_rows(ramp_end, vehicle, v, n, share)
        for i in range(n):
            v[i] = modes[number, i] - share[i]
            state[lane, i] = v[i]
        for i in range(len(y)):
            y[i] = 0.0
        add_rows(final_rows, vehicle, v, 0, y)
        for i in range(width - p):
            sampled[lane, i] = y[p + i]


@njit(cache=True, nogil=True, error_model="numpy")
def effect_of_rest(
    series: FloatArray,
    vehicle: int,
    channel: int,
    place: float,
    work: FloatArray,
    lane: int,
    late: FloatArray,
) -> None:
    """Sum the series of one channel's column of G(h - r) by Clenshaw's rule.

    A function of its own, although it is handed arrays: it is needed seldom, and in the middle of
    `advance` it would cost the loops around it registers.

    Args:
        series: Chebyshev coefficients, shape (vehicles, terms, m, n).
        vehicle: Number of the vehicle.
        channel: Which channel.
        place: h - r on the scale from -1 to 1 of the series.
        work: Two rows to work in, shape (2, n); overwritten.
        lane: Number of the lane.
        late: Shape (lanes, m, n); overwritten for this lane and channel.
    """
    n = work.shape[1]
    for i in range(n):
        work[0, i] = 0.0
        work[1, i] = 0.0
    for term in range(series.shape[1] - 1, 0, -1):
        one, other = term % 2, (term + 1) % 2
        for i in range(n):
            work[one, i] = (
                2.0 * place * work[other, i] - work[one, i] + series[vehicle, term, channel, i]
            )
    for i in range(n):
        late[lane, channel, i] = place * work[1, i] - work[0, i] + series[vehicle, 0, channel, i]


@njit(cache=True, nogil=True, error_model="numpy")
def advance(
    plant: PlantArrays,
    lanes: LaneArrays,
    queue: QueueArrays,
    active: BoolArray,
    first: int,
    end: int,
    recorded: FloatArray,
    sampled: FloatArray,
) -> None:
    """Advance lanes by one control period, in place.

    Args:
        plant: Matrices by vehicle.
        lanes: States, forces, track; changed.
        queue: Commands on their way; changed.
        active: Lanes that take part, shape (lanes,).
        first: First lane.
        end: One past the last lane.
        recorded: Outputs at the end of each step, just before any switch that falls on that
            instant, shape (lanes, steps, p); overwritten.
        sampled: Outputs at the end of the period, shape (lanes, q); overwritten.
    """
    record_rows, final_rows, input_rows = plant.record, plant.final, plant.inputs
    pairs, full, series, h = plant.pairs, plant.full, plant.late, plant.time_step
    state, force_of, track, vehicle_of, step_of, late_rest, late = (
        lanes.state,
        lanes.force,
        lanes.track,
        lanes.vehicle,
        lanes.step,
        lanes.late_rest,
        lanes.late,
    )
    arrival_step, waiting, head, arrival_rest, arrival_force = (
        queue.arrival_step,
        queue.waiting,
        queue.head,
        queue.arrival_rest,
        queue.arrival_force,
    )
    n = state.shape[1]
    m = force_of.shape[1]
    k = track.shape[2]
    p, width = record_rows.shape[2], final_rows.shape[2]
    slots = arrival_step.shape[1]
    steps = track.shape[1] - 1
    # Rows come in fours: what v has too few stays zero.
    v = np.zeros(final_rows.shape[1])
    half, whole = n // 2, len(full) > 0
    new = np.empty(n)
    work = np.empty((2, n))
    y = np.empty(p)
    last = np.empty(width)
    for lane in range(first, end):
        if not active[lane]:
            continue
        vehicle = vehicle_of[lane]
        for i in range(n):
            v[i] = state[lane, i]
        for c in range(m):
            v[n + k + c] = force_of[lane, c]
        for substep in range(steps):
            step = step_of[lane] + substep
            for j in range(k):
                v[n + j] = track[lane, substep, j]
            if whole:
                for i in range(n):
                    total = 0.0
                    for j in range(n):
                        total += full[vehicle, i, j] * v[j]
                    new[i] = total
            else:
                for i in range(half):
                    here, there = v[i], v[half + i]
                    new[i] = pairs[vehicle, 0, i] * here + pairs[vehicle, 1, i] * there
                    new[half + i] = pairs[vehicle, 2, i] * here + pairs[vehicle, 3, i] * there
            add_rows(input_rows, vehicle, v, n, new)
            for c in range(m):
                while waiting[lane, c] > 0:
                    slot = head[lane, c]
                    if arrival_step[lane, slot, c] > step:
                        break
                    rest = arrival_rest[lane, slot, c]
                    if rest != late_rest[lane, c]:
                        place = 2.0 * (h - rest) / h - 1.0
                        effect_of_rest(series, vehicle, c, place, work, lane, late)
                        late_rest[lane, c] = rest
                    change = arrival_force[lane, slot, c] - v[n + k + c]
                    for i in range(n):
                        new[i] += late[lane, c, i] * change
                    v[n + k + c] = arrival_force[lane, slot, c]
                    head[lane, c] = slot + 1 if slot + 1 < slots else 0
                    waiting[lane, c] -= 1
            for i in range(n):
                v[i] = new[i]
            for j in range(k):
                v[n + j] = track[lane, substep + 1, j]
            if substep + 1 < steps:
                for i in range(len(y)):
                    y[i] = 0.0
                add_rows(record_rows, vehicle, v, 0, y)
                for i in range(p):
                    recorded[lane, substep, i] = y[i]
        for i in range(len(last)):
            last[i] = 0.0
        add_rows(final_rows, vehicle, v, 0, last)
        for i in range(p):
            recorded[lane, steps - 1, i] = last[i]
        for i in range(width - p):
            sampled[lane, i] = last[p + i]
        for i in range(n):
            state[lane, i] = v[i]
        for c in range(m):
            force_of[lane, c] = v[n + k + c]
        step_of[lane] += steps
