"""Delay values, the delay line, limits, and the exact holds."""

from itertools import pairwise

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import integrate

from railenv.actuation import (
    ActuatorSpec,
    DelayLine,
    DelaySpec,
    held_input,
    ramped_input,
    split_delay,
)
from railenv.errors import ArgumentError

A = np.array([[0.0, 1.0], [-40.0, -0.6]])
B = np.array([[0.0], [2.0]])


@pytest.mark.parametrize("delay", [-0.1, np.nan, np.inf, (0.1, -0.1), ()])
def test_a_delay_that_is_negative_or_not_finite_is_refused(delay: object) -> None:
    with pytest.raises(ArgumentError, match="delay"):
        DelaySpec(delay)  # type: ignore[arg-type]


def test_one_delay_serves_every_channel() -> None:
    assert DelaySpec(0.1).per_channel(4).tolist() == [0.1] * 4


def test_a_wrong_number_of_delays_is_refused_with_both_numbers() -> None:
    with pytest.raises(ArgumentError, match="2 entries for 4 channels"):
        DelaySpec((0.1, 0.2)).per_channel(4)


def test_the_sensors_share_is_added_to_every_channel() -> None:
    spec = DelaySpec((0.1, 0.2), sensor_delay=0.05)
    # one sum
    np.testing.assert_allclose(spec.per_channel(2), [0.15, 0.25], rtol=1e-15)


def test_the_longest_delay_has_every_part_in_it() -> None:
    # two sums
    assert DelaySpec((0.1, 0.2), sensor_delay=0.05, jitter=0.02).longest == pytest.approx(0.27)


@pytest.mark.parametrize("name", ["dropout", "sensor_dropout"])
@pytest.mark.parametrize("value", [-0.1, 1.0, np.nan, True, "half"])
def test_a_probability_outside_of_its_range_is_refused_by_name(name: str, value: object) -> None:
    with pytest.raises(ArgumentError, match=rf"^{name} "):
        DelaySpec(0.1, **{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize("name", ["sensor_delay", "jitter"])
def test_a_negative_part_of_the_delay_is_refused_by_name(name: str) -> None:
    with pytest.raises(ArgumentError, match=rf"^{name} "):
        DelaySpec(0.1, **{name: -1e-9})


@given(
    delay=st.floats(0.0, 1.0),
    time_step=st.sampled_from([0.001, 0.002, 0.0025, 0.005, 0.01]),
)
def test_whole_steps_and_remainder_add_up_to_the_delay(delay: float, time_step: float) -> None:
    whole, rest = split_delay(np.array([delay]), time_step)
    assert 0.0 <= rest[0] <= time_step
    # one rounding each in product and difference
    assert whole[0] * time_step + rest[0] == pytest.approx(delay, abs=1e-15)


@pytest.mark.parametrize("time_step", [0.0025, 0.005, 0.01])
def test_the_remainder_of_a_multiple_of_the_step_is_less_than_a_step(time_step: float) -> None:
    numbers = np.arange(1, 301)
    written = np.round(numbers * time_step, 6)
    assert np.all(split_delay(written, time_step)[1] < time_step)


Arrival = tuple[int, float, float]


def arrivals(line: DelayLine, step: int, channel: int = 0) -> list[Arrival]:
    """Take what arrives before the end of a physics step out of the queue, as the stepping does."""
    queue, out = line.arrays, []
    slots = queue.arrival_step.shape[1]
    while queue.waiting[0, channel] > 0:
        slot = queue.head[0, channel]
        if queue.arrival_step[0, slot, channel] > step:
            break
        out.append(
            (
                int(queue.arrival_step[0, slot, channel]),
                float(queue.arrival_rest[0, slot, channel]),
                float(queue.arrival_force[0, slot, channel]),
            )
        )
        queue.head[0, channel] = (slot + 1) % slots
        queue.waiting[0, channel] -= 1
    return out


STEP, PER_COMMAND = 0.004, 3


def played(
    delay: float,
    later: list[float],
    lost: list[bool],
    forces: list[float],
    actuator: ActuatorSpec | None = None,
) -> list[Arrival]:
    """Every command that takes force, in the order in which they do."""
    longest = delay + max(later)
    actuator = ActuatorSpec(None) if actuator is None else actuator
    line = DelayLine(1, 1, STEP, PER_COMMAND, longest, actuator)
    line.start(np.array([0]), np.array([[delay]]))
    out: list[Arrival] = []
    last = len(later) * PER_COMMAND + int(longest / STEP) + 2
    for step in range(last):
        number = step // PER_COMMAND
        if step % PER_COMMAND == 0 and number < len(later):
            line.issue(
                np.array([step]),
                np.array([True]),
                0,
                1,
                np.array([[forces[number]]]),
                np.array([[later[number]]]),
                np.array([[lost[number]]]),
            )
        out += arrivals(line, step)
    assert line.arrays.waiting[0, 0] == 0
    return out


@given(
    delay=st.floats(0.0, 0.1),
    sent=st.lists(st.tuples(st.floats(0.0, 0.06), st.booleans()), min_size=1, max_size=12),
)
def test_of_the_commands_that_have_arrived_the_newest_acts(
    delay: float, sent: list[tuple[float, bool]]
) -> None:
    later, lost = [t for t, _ in sent], [gone for _, gone in sent]
    found = played(delay, later, lost, [float(k + 1) for k in range(len(sent))])
    instants = [k * PER_COMMAND * STEP + delay + t for k, t in enumerate(later)]
    for step, rest, _ in found:
        assert 0.0 <= rest < STEP or rest == pytest.approx(STEP)
        assert step >= 0
    # By definition, at instants between two arrivals; 1e-12 is far above the rounding of either.
    edges = sorted({*instants, 1e3})
    for left, right in pairwise(edges):
        if right - left < 1e-12:
            continue
        now = 0.5 * (left + right)
        arrived = [k for k, at in enumerate(instants) if at <= now and not lost[k]]
        acting = [force for step, rest, force in found if step * STEP + rest <= now]
        assert (acting[-1] if acting else 0.0) == (max(arrived) + 1.0 if arrived else 0.0)


def test_a_command_that_is_overtaken_never_acts() -> None:
    # the first would arrive at 0.05, the second at 0.012 + 0.01
    assert [force for *_, force in played(0.01, [0.04, 0.0], [False, False], [1.0, 2.0])] == [2.0]


def test_a_lost_command_leaves_no_trace_in_the_rate_limit() -> None:
    slow = ActuatorSpec(force_limit=None, rate_limit=1000.0 / (PER_COMMAND * STEP))
    found = played(0.0, [0.0] * 3, [False, True, False], [1000.0, -5000.0, 5000.0], slow)
    # from 1000 N on by at most 1000 N; a seen -5000 N would have made it 1000 N
    assert [force for *_, force in found] == [1000.0, 2000.0]


def test_the_rate_limit_counts_from_what_was_sent_and_not_from_what_was_wanted() -> None:
    slow = ActuatorSpec(force_limit=2500.0, rate_limit=1000.0 / (PER_COMMAND * STEP))
    found = played(0.0, [0.0] * 4, [False] * 4, [5000.0] * 4, slow)
    assert [force for *_, force in found] == [1000.0, 2000.0, 2500.0, 2500.0]


def test_a_start_empties_the_queue_of_its_lane_only() -> None:
    line = DelayLine(2, 1, STEP, 1, 0.1, ActuatorSpec())
    both = np.array([0, 1])
    line.start(both, np.full((2, 1), 0.05))
    one = np.ones((2, 1))
    line.issue(both * 0, np.ones(2, dtype=bool), 0, 2, one, 0 * one, np.zeros((2, 1), dtype=bool))
    line.start(np.array([0]), np.zeros((1, 1)))
    assert line.arrays.waiting[:, 0].tolist() == [0, 1]


def test_the_queue_holds_as_many_commands_as_the_longest_delay_can_keep_waiting() -> None:
    # Every command as late as can be: none may be written over by one that comes around the ring.
    found = played(0.1, [0.05] * 40, [False] * 40, [float(k) for k in range(40)])
    assert [force for *_, force in found] == [float(k) for k in range(40)]


def test_the_force_limit_cuts_and_the_rate_limit_slows() -> None:
    actuator = ActuatorSpec(force_limit=30e3, rate_limit=1e5)
    wanted, previous = np.array([[50e3, -500.0]]), np.array([[29.5e3, 0.0]])
    np.testing.assert_array_equal(actuator.limited(wanted, previous, 0.01), [[30e3, -500.0]])
    np.testing.assert_array_equal(actuator.limited(wanted, 0 * previous, 0.01), [[1e3, -500.0]])


@pytest.mark.parametrize(
    "settings", [{"force_limit": 0.0}, {"rate_limit": -1.0}, {"lag": -0.01}, {"lag": np.nan}]
)
def test_an_impossible_actuator_is_refused_by_name(settings: dict[str, float]) -> None:
    with pytest.raises(ArgumentError, match=next(iter(settings))):
        ActuatorSpec(**settings)


def test_a_lagged_force_approaches_its_command_exponentially() -> None:
    plant, drive = ActuatorSpec(lag=0.05).with_lag(A, B)
    _, response = held_input(plant, drive, 0.02)
    # unit step after 20 ms: 1 - exp(-0.02 / 0.05)
    assert response[-1, 0] == pytest.approx(1.0 - np.exp(-0.4), rel=1e-13)


def test_a_held_input_moves_an_oscillator_as_quadrature_says() -> None:
    transition, effect = held_input(A, B, 0.3)
    solution = integrate.solve_ivp(
        lambda t, x: A @ x + B[:, 0], (0, 0.3), [0.7, -0.2], rtol=1e-12, atol=1e-14
    )
    # the quadrature's own tolerance
    np.testing.assert_allclose(
        transition @ [0.7, -0.2] + effect[:, 0], solution.y[:, -1], rtol=1e-9
    )


def test_a_held_input_needs_no_inverse_of_the_plant() -> None:
    _, effect = held_input(np.array([[0.0, 1.0], [0.0, 0.0]]), np.array([[0.0], [1.0]]), 2.0)
    np.testing.assert_allclose(effect[:, 0], [2.0, 2.0], rtol=1e-15)


def test_a_ramp_and_its_rate_move_an_oscillator_as_quadrature_says() -> None:
    E, rate = np.array([[0.3], [5.0]]), np.array([[0.0], [0.8]])
    start, end = ramped_input(A, E, rate, 0.2)
    w0, w1 = 1.5, -0.4

    def slope(t: float, x: np.ndarray) -> np.ndarray:
        w = w0 + (w1 - w0) * t / 0.2
        return A @ x + E[:, 0] * w + rate[:, 0] * (w1 - w0) / 0.2

    solution = integrate.solve_ivp(slope, (0, 0.2), [0.0, 0.0], rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(start[:, 0] * w0 + end[:, 0] * w1, solution.y[:, -1], rtol=1e-9)


def test_more_commands_than_there_is_room_for_are_an_error_and_no_other_lanes() -> None:
    line = DelayLine(2, 1, STEP, 1, 0.1, ActuatorSpec())
    still, one = np.zeros(2, dtype=np.int64), np.ones((2, 1))
    active, nothing = np.array([True, False]), np.zeros((2, 1), dtype=bool)
    room = line.arrays.arrival_step.shape[1]
    for k in range(room):
        # The clock stands still and each is later than the one before.
        line.issue(still, active, 0, 2, one, 1e-4 * k * one, nothing)
    with pytest.raises(IndexError, match="room"):
        line.issue(still, active, 0, 2, one, 1e-4 * room * one, nothing)
    assert line.arrays.waiting.tolist() == [[room], [0]]
    assert not line.arrays.arrival_force[1].any()
