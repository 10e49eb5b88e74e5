"""Commands that are late or get lost, in the three simulations that take commands by hand."""

from itertools import pairwise

import numpy as np
import pytest

from railenv.actuation import ActuatorSpec, SemiActiveDamper, held_input
from railenv.errors import ArgumentError
from railenv.simulation import LateralSimulation, SemiActiveSimulation
from railenv.simulation.full_run import FullSimulation
from railenv.units import FloatArray
from railenv.vehicle import lateral17, state_space
from railenv.vehicle.nonlinear import full50

Simulation = LateralSimulation | FullSimulation

PERIOD = 0.01
FORCES = tuple(f"actuator_force_{k}" for k in (1, 2, 3, 4))
COEFFICIENTS = tuple(f"damping_coefficient_{k}" for k in (1, 2, 3, 4))
MODELS = ("linear", "dampers", "nonlinear")
LINEAR = lateral17("paper_fit", 4, 300.0)
NONLINEAR = full50("paper_fit", 4, 300.0)
LANES, PERIODS, LONGEST = 3, 40, 0.087


def made(model: str, threads: int = 1) -> Simulation:
    """A simulation whose first four outputs are what its commands become at once."""
    if model == "linear":
        return LateralSimulation(LINEAR, (*FORCES, "carbody_lateral"))
    if model == "dampers":
        damper = SemiActiveDamper(0.0, 100e3, 0.0)
        return SemiActiveSimulation(LINEAR, (*COEFFICIENTS, "carbody_lateral"), damper=damper)
    return FullSimulation(NONLINEAR, (*FORCES, "carbody_lateral"), threads=threads)


def pushed(model: str, lanes: int) -> FloatArray | None:
    """A start in motion where commands alone move nothing."""
    if model != "dampers":
        return None
    size = len(state_space(LINEAR).states)
    return np.random.default_rng(5).normal(0.0, 1e-3, (LANES, size))[:lanes]


def drawn() -> tuple[FloatArray, FloatArray, FloatArray, np.ndarray]:
    """Delays, commands, lateness and losses."""
    rng = np.random.default_rng(0)
    shape = (PERIODS, LANES, 4)
    delays, commands = rng.uniform(0.0, 0.03, shape[1:]), rng.uniform(0.0, 9e3, shape)
    return delays, commands, rng.uniform(0.0, LONGEST, shape), rng.random(shape) < 0.3


def run(
    model: str,
    delays: FloatArray,
    commands: FloatArray,
    later: FloatArray | None = None,
    lost: np.ndarray | None = None,
    longest: float = LONGEST,
    simulation: Simulation | None = None,
) -> FloatArray:
    """Outputs of a run on level track, shape (lanes, records, outputs)."""
    stepped = made(model) if simulation is None else simulation
    state = pushed(model, len(delays))
    stepped.reset(delays, initial_state=state, longest_jitter=longest)
    periods = [
        stepped.advance(
            commands[k], None if later is None else later[k], None if lost is None else lost[k]
        )
        for k in range(len(commands))
    ]
    return np.concatenate(periods, axis=1)


def close(found: FloatArray, true: FloatArray, share: float) -> None:
    """Each output, up to a share of its largest value."""
    for column in range(true.shape[2]):
        size = np.abs(true[..., column]).max()
        np.testing.assert_allclose(found[..., column], true[..., column], atol=share * size, rtol=0)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("lateness", [0.02, 0.0612345, 0.3])
def test_a_constant_lateness_is_a_longer_constant_delay(model: str, lateness: float) -> None:
    delays, commands, _, _ = drawn()
    delays[0] = 0.0
    found = run(model, delays, commands, np.full(commands.shape, lateness), longest=lateness)
    # Instants differ by their rounding, 1e-16 s: what a command does meanwhile is as small a share.
    close(found, run(model, delays + lateness, commands, longest=0.0), 1e-12)


def newest_arrived(delays: FloatArray, lane: int, channel: int, now: float) -> float:
    """What the newest command that has arrived says, from the draws alone."""
    _, commands, later, lost = drawn()
    value = 0.0
    for k in range(PERIODS):
        instant = PERIOD * k + delays[lane, channel] + later[k, lane, channel]
        if instant < now and not lost[k, lane, channel]:
            value = float(commands[k, lane, channel])
    return value


@pytest.mark.parametrize("model", MODELS)
def test_what_acts_is_the_newest_command_that_has_arrived(model: str) -> None:
    delays, commands, later, lost = drawn()
    found = run(model, delays, commands, later, lost)[..., :4]
    each = found.shape[1] // PERIODS
    times = PERIOD / each * np.arange(1, PERIODS * each + 1)
    true = [
        [[newest_arrived(delays, lane, c, now) for c in range(4)] for now in times]
        for lane in range(LANES)
    ]
    # A coefficient is integrated, and its record a sum of two numbers that are as large.
    np.testing.assert_allclose(found, true, rtol=1e-14, atol=0.0)


def test_the_linear_vehicle_moves_as_under_the_newest_commands() -> None:
    delays, commands, later, lost = drawn()
    system = state_space(LINEAR)
    simulation = made("linear")
    run("linear", delays, commands, later, lost, simulation=simulation)
    end = PERIODS * PERIOD
    for lane in range(LANES):
        instants = PERIOD * np.arange(PERIODS)[:, None] + delays[lane] + later[:, lane]
        edges = np.unique([0.0, *instants[instants < end], end])
        x = np.zeros(len(system.A))
        for left, right in pairwise(edges):
            transition, effect = held_input(system.A, system.actuator_input, right - left)
            middle = 0.5 * (left + right)
            forces = [newest_arrived(delays, lane, c, middle) for c in range(4)]
            x = transition @ x + effect @ np.array(forces)
        # some hundred products of matrices of norm one to ten
        np.testing.assert_allclose(simulation.state[lane], x, atol=1e-11 * np.abs(x).max())


@pytest.mark.parametrize("model", MODELS)
def test_when_all_commands_are_lost_from_an_instant_on_the_last_one_holds(model: str) -> None:
    delays, commands, later, _ = drawn()
    lost = np.zeros(commands.shape, dtype=bool)
    lost[10:] = True
    found = run(model, delays, commands, later, lost)[..., :4]
    each = found.shape[1] // PERIODS
    # By then the last one has arrived, whatever its delay; an older one that is later than it does
    # not count.
    settled = found[:, round((10 * PERIOD + 0.03 + LONGEST) / PERIOD * each) :]
    last = np.broadcast_to(commands[9][:, None], settled.shape)
    np.testing.assert_allclose(settled, last, rtol=1e-14, atol=0.0)  # as above


@pytest.mark.parametrize("model", MODELS)
def test_no_lateness_and_no_loss_change_no_bit(model: str) -> None:
    delays, commands, later, lost = drawn()
    plain = run(model, delays, commands, longest=0.0)
    given = run(model, delays, commands, 0.0 * later, np.zeros_like(lost))
    np.testing.assert_array_equal(given, plain)


@pytest.mark.parametrize("model", MODELS)
def test_what_varied_in_one_period_is_forgotten_in_the_next(model: str) -> None:
    simulation = made(model)
    simulation.reset(np.zeros((1, 4)), longest_jitter=LONGEST)
    command, everything = np.full((1, 4), 1e3), np.ones((1, 4), dtype=bool)
    assert not simulation.advance(command, None, everything)[0, :, :4].any()
    assert not simulation.advance(command, np.full((1, 4), LONGEST))[0, :, :4].any()
    # A damper without response time has its command to the rounding of its two halves of a step.
    at_once = simulation.advance(2.0 * command)[0, :, :4]
    np.testing.assert_allclose(at_once, 2e3, rtol=1e-14)


@pytest.mark.parametrize("model", MODELS)
def test_a_second_run_knows_nothing_of_the_first(model: str) -> None:
    delays, commands, later, lost = drawn()
    simulation = made(model)
    run(model, delays, commands, later, lost, simulation=simulation)
    again = run(model, delays, commands, simulation=simulation)
    np.testing.assert_array_equal(again, run(model, delays, commands))


@pytest.mark.parametrize("model", MODELS)
def test_a_lane_of_a_batch_is_bit_for_bit_the_batch_of_one(model: str) -> None:
    delays, commands, later, lost = drawn()
    together = run(model, delays, commands, later, lost)
    # The first lane alone: it has the start in motion of lane 0.
    alone = run(model, delays[:1], commands[:, :1], later[:, :1], lost[:, :1], longest=0.2)
    np.testing.assert_array_equal(alone[0], together[0])
    assert not np.array_equal(together[1], together[2])


def test_threads_change_no_bit_of_lanes_with_varying_delay() -> None:
    draws = drawn()
    shared = run("nonlinear", *draws, simulation=made("nonlinear", threads=2))
    np.testing.assert_array_equal(shared, run("nonlinear", *draws))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("later", "lost", "message"),
    [
        (np.zeros((1, 3)), None, r"later has shape \(1, 3\); it must be \(1, 4\)"),
        (np.full((1, 4), -1e-3), None, "later holds a value that is negative"),
        (np.full((1, 4), np.nan), None, "later holds a value that is negative, not finite"),
        (np.full((1, 4), 0.0201), None, r"above longest_jitter = 0\.02 s; give seconds"),
        (None, np.zeros((4,), dtype=bool), r"lost has shape \(4,\)"),
        (None, np.zeros((1, 4)), "lost has shape .* type float64; it must be .* of bool"),
    ],
)
def test_impossible_lateness_is_refused_by_name_and_changes_nothing(
    model: str, later: FloatArray | None, lost: np.ndarray | None, message: str
) -> None:
    command = np.full((1, 4), 1e3)
    runs = [made(model), made(model)]
    for simulation in runs:
        simulation.reset(np.full((1, 4), 0.004), longest_jitter=0.02)
        simulation.advance(command)
    before = runs[0].state
    with pytest.raises(ArgumentError, match=message):
        runs[0].advance(9.0 * command, later, lost)
    np.testing.assert_array_equal(runs[0].state, before)
    refused, other = (simulation.advance(2.0 * command) for simulation in runs)
    np.testing.assert_array_equal(refused, other)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    ("longest", "message"),
    [
        (-0.01, "longest_jitter = -0.01 must not be negative"),
        (np.inf, "longest_jitter = inf must be finite"),
        (999.9, r"longest_jitter = 999\.9 s makes a delay of 1000\.1 s, above 1000 s"),
    ],
)
def test_impossible_room_for_jitter_is_refused_by_name(
    model: str, longest: float, message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        made(model).reset(np.full((1, 4), 0.2), longest_jitter=longest)


@pytest.mark.parametrize("model", MODELS)
def test_the_room_for_jitter_is_that_of_the_last_reset(model: str) -> None:
    simulation = made(model)
    simulation.reset(np.zeros((1, 4)), longest_jitter=0.1)
    simulation.reset(np.zeros((1, 4)), longest_jitter=0.02)
    with pytest.raises(ArgumentError, match=r"above longest_jitter = 0\.02 s"):
        simulation.advance(np.zeros((1, 4)), np.full((1, 4), 0.1))
    simulation.reset(np.zeros((1, 4)))
    with pytest.raises(ArgumentError, match="above longest_jitter = 0 s"):
        simulation.advance(np.zeros((1, 4)), np.full((1, 4), 1e-9))


def test_an_actuator_far_faster_than_the_step_may_have_losses_but_no_jitter() -> None:
    stiff = LateralSimulation(LINEAR, FORCES, actuator=ActuatorSpec(lag=1e-5))
    with pytest.raises(ArgumentError, match=r"jitter = 0\.02 s cannot be simulated"):
        stiff.reset(np.zeros((1, 4)), longest_jitter=0.02)
    stiff.reset(np.zeros((1, 4)))
    every = np.ones((1, 4), dtype=bool)
    assert not stiff.advance(np.full((1, 4), 1e3), None, every).any()
    # the lag of 10 microseconds is over after a step: exp(-500)
    assert stiff.advance(np.full((1, 4), 1e3))[0, -1].tolist() == pytest.approx([1e3] * 4)


def test_the_rate_limit_counts_from_the_last_command_that_was_not_lost() -> None:
    limited = LateralSimulation(LINEAR, FORCES, actuator=ActuatorSpec(30e3, 1e5))
    limited.reset(np.zeros((1, 4)))
    wanted, every = np.full((1, 4), 30e3), np.ones((1, 4), dtype=bool)
    # 100 kN/s is 1 kN from one command to the next
    reached = [
        limited.advance(wanted, None, every if k in (1, 2) else None)[0, -1, 0] for k in range(5)
    ]
    assert reached == [1e3, 1e3, 1e3, 2e3, 3e3]
