"""Vehicles on semi-active dampers, against systems with the dashpots built in.

While no coefficient changes, the vehicle is linear: A - B diag(c) R with R the rows of the stroke
rates. That is stepped exactly here, from one change to the next, by matrix exponentials.
"""

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.integrate import solve_ivp
from scipy.linalg import expm

from railenv.actuation import SemiActiveDamper, coefficient_names, ramped_input
from railenv.errors import ArgumentError
from railenv.simulation import SemiActiveSimulation, required_length, wheelset_inputs
from railenv.track import make_track
from railenv.vehicle import LateralVehicle, lateral17, state_space
from railenv.vehicle.coordinates import actuator_positions

Array = NDArray[np.float64]

AT_ONCE = SemiActiveDamper(0.0, 100e3, 0.0)


def rate_names(vehicle: LateralVehicle) -> tuple[str, ...]:
    return tuple(f"suspension_stroke_rate_{k}" for k in actuator_positions(vehicle.layout))


def force_names(vehicle: LateralVehicle) -> tuple[str, ...]:
    return tuple(f"actuator_force_{k}" for k in actuator_positions(vehicle.layout))


def channels(vehicle: LateralVehicle) -> tuple[str, ...]:
    """Forces, stroke rates and coefficients, m of each."""
    return (*force_names(vehicle), *rate_names(vehicle), *coefficient_names(vehicle.layout))


def with_dashpots(vehicle: LateralVehicle, coefficients: Array) -> Array:
    """A of the vehicle with dashpots between carbody and bogies."""
    system = state_space(vehicle)
    rows, _ = system.output_rows(rate_names(vehicle))
    return np.asarray(system.A - system.actuator_input @ np.diag(coefficients) @ rows)


def irregularity(vehicle: LateralVehicle, duration: float, time_step: float = 0.005) -> Array:
    track = make_track("german_low", required_length(vehicle, duration), 1)
    return wheelset_inputs(vehicle, track, time_step, round(duration / time_step))


def start(vehicle: LateralVehicle, size: float = 1e-3) -> Array:
    return np.random.default_rng(0).normal(0.0, size, len(state_space(vehicle).states))


def relative(found: Array, true: Array) -> float:
    return float(np.abs(found - true).max() / np.abs(true).max())


def random_run(
    vehicle: LateralVehicle, damper: SemiActiveDamper, lanes: int, only: int | None = None
) -> Array:
    """Random coefficients and delays on irregular track, shape (lanes, steps, 3 m)."""
    generator = np.random.default_rng(7)
    m = vehicle.num_actuators
    delays = generator.uniform(0.0, 0.08, (lanes, m))
    commands = generator.uniform(-10e3, 120e3, (100, lanes, m))
    chosen = slice(None) if only is None else slice(only, only + 1)
    simulation = SemiActiveSimulation(vehicle, channels(vehicle), damper=damper)
    simulation.reset(delays[chosen], irregularity(vehicle, 1.0)[None], None, start(vehicle))
    return np.concatenate([simulation.advance(c[chosen]) for c in commands], axis=1)


PAPER = lateral17("paper_fit", 4, 300.0)

# Without conicity its modes do not span the state, and the stepping keeps the full matrix.
DRIFTING = LateralVehicle(PAPER.parameters.replace(conicity=0.0), "4", PAPER.speed)


@pytest.mark.parametrize("vehicle", [lateral17("paper_fit", 2, 300.0), PAPER, DRIFTING])
def test_a_constant_coefficient_is_a_dashpot_to_second_order(vehicle: LateralVehicle) -> None:
    system, m = state_space(vehicle), vehicle.num_actuators
    coefficients = np.array([5e3, 60e3, 20e3, 35e3])[:m]
    A, track = with_dashpots(vehicle, coefficients), irregularity(vehicle, 1.0)
    before, after = ramped_input(A, system.B[:, m : m + 8], system.B[:, m + 8 :], 0.005)
    transition, x = expm(0.005 * A), start(vehicle)
    true = []
    for k in range(200):
        x = transition @ x + before @ track[k] + after @ track[k + 1]
        true.append(x)
    errors = []
    for step in (0.001, 0.0005, 0.00025):
        simulation = SemiActiveSimulation(
            vehicle, system.states, damper=AT_ONCE, force_limit=None, longest_inner_step=step
        )
        simulation.reset(np.zeros((1, m)), track[None], None, start(vehicle))
        found = [simulation.advance(coefficients[None])[0] for _ in range(100)]
        errors.append(relative(np.concatenate(found), np.array(true)))
    # the default step, from a start that shakes every mode: wheelsets at 40 Hz too
    assert errors[0] < 1e-3
    # four to the power of one halving; terms of the fourth order are below 1 % here
    assert errors[0] / errors[1] == pytest.approx(4.0, rel=0.02)
    assert errors[1] / errors[2] == pytest.approx(4.0, rel=0.02)


def test_free_motion_decays_at_the_rate_of_the_slowest_mode_with_dashpots(
    vehicle: LateralVehicle,
) -> None:
    coefficients = np.full(4, 15e3)
    roots, vectors = np.linalg.eig(with_dashpots(vehicle, coefficients))
    slowest = int(np.argmax(np.where(roots.imag > 0.1, roots.real, -np.inf)))
    simulation = SemiActiveSimulation(vehicle, state_space(vehicle).states, damper=AT_ONCE)
    simulation.reset(np.zeros((1, 4)), None, None, 1e-3 * vectors[:, slowest].real)
    for _ in range(200):
        last = simulation.advance(coefficients[None])[0, -1]
    true = 1e-3 * (vectors[:, slowest] * np.exp(2.0 * roots[slowest])).real
    # the splitting moves a root of 1 Hz by some (2 pi f h)^2 / 12 of itself
    assert relative(last, true) < 1e-4


def piecewise(vehicle: LateralVehicle, delays: Array, commands: Array, lowest: float) -> Array:
    """States after the run with coefficients that switch where commands arrive, by exponentials."""
    switches = [
        (0.01 * k + delays[c], c, commands[k, c])
        for k in range(len(commands))
        for c in range(len(delays))
    ]
    x, now, coefficients = start(vehicle), 0.0, np.full(len(delays), lowest)
    for instant, channel, coefficient in sorted(switches):
        if instant >= 0.01 * len(commands):
            break
        x = expm((instant - now) * with_dashpots(vehicle, coefficients)) @ x
        now, coefficients[channel] = instant, coefficient
    last = 0.01 * len(commands) - now
    return np.asarray(expm(last * with_dashpots(vehicle, coefficients)) @ x)


def test_switches_at_any_instant_keep_the_second_order(vehicle: LateralVehicle) -> None:
    delays = np.array([0.0, 0.0137123, 0.02071, 0.0333333])
    commands = np.random.default_rng(3).uniform(1e3, 60e3, (20, 4))
    damper = SemiActiveDamper(1e3, 60e3, 0.0)
    true = piecewise(vehicle, delays, commands, 1e3)
    errors = []
    for step in (0.001, 0.0001):
        simulation = SemiActiveSimulation(
            vehicle, (), damper=damper, force_limit=None, longest_inner_step=step
        )
        simulation.reset(delays[None], None, None, start(vehicle))
        for row in commands:
            simulation.advance(row[None])
        errors.append(relative(simulation.state[0], true))
    # A delay rounded to the inner step would leave an error of the first order, some 1e-2.
    assert errors[0] < 1e-3
    assert errors[0] / errors[1] > 50.0


def test_a_slow_response_agrees_with_an_adaptive_integrator(vehicle: LateralVehicle) -> None:
    system, damper = state_space(vehicle), SemiActiveDamper(2e3, 50e3, 0.02)
    rows, _ = system.output_rows(rate_names(vehicle))
    B, delay = system.actuator_input, 0.0137

    def slope(t: float, x: Array) -> Array:
        share = 1.0 - np.exp(-(t - delay) / 0.02) if t > delay else 0.0
        return np.asarray(system.A @ x - B @ ((2e3 + 48e3 * share) * (rows @ x)))

    x = start(vehicle)
    for begin, end in ((0.0, delay), (delay, 0.1)):
        x = solve_ivp(slope, (begin, end), x, "DOP853", rtol=1e-9, atol=1e-13).y[:, -1]
    simulation = SemiActiveSimulation(vehicle, (), damper=damper, longest_inner_step=1e-4)
    simulation.reset(np.full((1, 4), delay), None, None, start(vehicle))
    for _ in range(10):
        simulation.advance(np.full((1, 4), 50e3))
    # a hundredth of the error at the default step
    assert relative(simulation.state[0], x) < 1e-5


@pytest.mark.parametrize("response_time", [0.0, 0.015])
def test_no_damper_puts_energy_in_at_any_sample(
    vehicle: LateralVehicle, response_time: float
) -> None:
    damper = SemiActiveDamper(2e3, 80e3, response_time)
    values = random_run(vehicle, damper, 6)
    force, rate, coefficient = values[:, :, :4], values[:, :, 4:8], values[:, :, 8:]
    assert np.all(force * rate <= 0.0)
    assert np.array_equal(force, np.clip(-coefficient * rate, -30e3, 30e3))
    assert coefficient.min() >= 2e3
    assert coefficient.max() <= 80e3
    # the run is no rest: the coefficients go over most of the range, the dampers move
    assert np.ptp(coefficient) > 50e3
    assert rate.std() > 0.02


def test_a_damper_of_any_coefficient_never_lets_the_motion_grow(vehicle: LateralVehicle) -> None:
    damper = SemiActiveDamper(1e9, 1e9, 0.0)
    simulation = SemiActiveSimulation(
        vehicle, (), damper=damper, force_limit=None, longest_inner_step=0.005
    )
    x = start(vehicle)
    x[:17], x[34:] = 0.0, 0.0
    simulation.reset(np.zeros((1, 4)), None, None, x)
    energies = [energy(vehicle, x)]
    for _ in range(200):
        simulation.advance(np.zeros((1, 4)))
        energies.append(energy(vehicle, simulation.state[0]))
    # Wheel on rail could feed motion in, but damps what starts as velocity; the dampers only take.
    assert max(energies) == energies[0]
    assert energies[-1] < 0.2 * energies[0]


def energy(vehicle: LateralVehicle, x: Array) -> float:
    """Kinetic energy and that of the springs, those of the yaw dampers included [J]."""
    q, velocity = x[:17], x[17:34]
    series = [
        d.stiffness * (d.row @ q - z) ** 2 for d, z in zip(vehicle.dampers, x[34:], strict=True)
    ]
    stored = velocity @ vehicle.mass @ velocity + q @ vehicle.suspension_stiffness @ q
    return 0.5 * float(stored + sum(series))


def test_the_delay_acts_on_the_coefficient_and_the_force_jumps_there(
    vehicle: LateralVehicle,
) -> None:
    delay, damper = 0.0237, SemiActiveDamper(5e3, 80e3, 0.0)
    simulation = SemiActiveSimulation(
        vehicle, channels(vehicle), damper=damper, time_step=0.001, control_period=0.01
    )
    runs = []
    for second in (5e3, 80e3):
        simulation.reset(np.full((1, 4), delay), None, None, start(vehicle))
        found = [simulation.advance(np.full((1, 4), c))[0] for c in (5e3, second, 5e3, 5e3, 5e3)]
        runs.append(np.concatenate(found))
    time = 0.001 * np.arange(1, 51)
    before = time < 0.01 + delay
    assert np.array_equal(runs[0][before], runs[1][before])
    acts = ~before & (time < 0.02 + delay)
    assert np.all(runs[1][acts, 8:] == 80e3)
    assert np.all(runs[1][~acts, 8:] == 5e3)
    first = int(np.flatnonzero(acts)[0])
    np.testing.assert_array_equal(runs[1][first, :4], -80e3 * runs[1][first, 4:8])


def test_a_command_that_arrives_at_a_record_acts_just_after_it(vehicle: LateralVehicle) -> None:
    simulation = SemiActiveSimulation(
        vehicle, coefficient_names("4"), damper=SemiActiveDamper(5e3, 30e3, 0.0)
    )
    simulation.reset(np.full((1, 4), 0.005))
    found = simulation.advance(np.full((1, 4), 20e3))[0, :, 0]
    assert found.tolist() == [5e3, 20e3]


def test_the_coefficient_follows_with_the_response_time(vehicle: LateralVehicle) -> None:
    simulation = SemiActiveSimulation(
        vehicle, coefficient_names("4"), damper=SemiActiveDamper(5e3, 30e3, 0.02)
    )
    simulation.reset(np.array([[0.0, 0.0031, 0.005, 0.0274]]))
    found = np.concatenate([simulation.advance(np.full((1, 4), 30e3))[0] for _ in range(10)])
    time = 0.005 * np.arange(1, 21)[:, None]
    late = np.maximum(time - np.array([0.0, 0.0031, 0.005, 0.0274]), 0.0)
    # forty multiplications, each rounded once
    np.testing.assert_allclose(found, 30e3 - 25e3 * np.exp(-late / 0.02), rtol=1e-14)


def test_a_damper_blows_off_at_the_force_limit_and_still_converges(
    vehicle: LateralVehicle,
) -> None:
    damper, ends = SemiActiveDamper(5e3, 60e3, 0.0), []
    for step in (0.001, 0.000125, 0.00001):
        simulation = SemiActiveSimulation(
            vehicle, channels(vehicle), damper=damper, force_limit=500.0, longest_inner_step=step
        )
        simulation.reset(np.zeros((1, 4)), irregularity(vehicle, 0.3)[None], None, start(vehicle))
        found = np.concatenate([simulation.advance(np.full((1, 4), 20e3))[0] for _ in range(30)])
        force, rate = found[:, :4], found[:, 4:8]
        assert np.all(np.abs(force) <= 500.0)
        assert 0.2 < np.mean(np.abs(force) == 500.0) < 0.8
        assert np.all(force * rate <= 0.0)
        ends.append(simulation.state[0])
    errors = [relative(end, ends[-1]) for end in ends[:2]]
    assert errors[0] < 1e-3
    # 64 for the second order; kinks fall anywhere in a step, so the error does not fall evenly
    assert errors[0] / errors[1] > 30.0


def test_a_blown_off_damper_brakes_as_dry_friction_does(vehicle: LateralVehicle) -> None:
    # Commanded far beyond what the limit allows, all that acts is the limit, against the motion.
    system = state_space(vehicle)
    simulation = SemiActiveSimulation(
        vehicle, (), damper=SemiActiveDamper(1e7, 1e7, 0.0), force_limit=100.0
    )
    x = np.zeros(38)
    x[system.states.index("carbody_lateral_velocity")] = 1.0
    simulation.reset(np.zeros((1, 4)), None, None, x)
    simulation.advance(np.zeros((1, 4)))
    m = system.num_actuators
    held = expm(
        0.01 * np.block([[system.A, system.actuator_input], [np.zeros((m, 38)), np.zeros((m, m))]])
    )
    true = held[:38, :38] @ x + held[:38, 38:] @ np.full(m, -100.0)
    # 1 m/s needs longer than the run to stop; the rest is the splitting's error
    np.testing.assert_allclose(simulation.state[0], true, atol=1e-6)


def test_a_lane_does_not_depend_on_its_neighbours(vehicle: LateralVehicle) -> None:
    damper = SemiActiveDamper(2e3, 80e3, 0.01)
    together = random_run(vehicle, damper, 5)
    for lane in (0, 3):
        assert np.array_equal(random_run(vehicle, damper, 5, only=lane)[0], together[lane])


def test_the_same_run_gives_the_same_numbers_after_another_reset(vehicle: LateralVehicle) -> None:
    simulation = SemiActiveSimulation(vehicle, channels(vehicle), damper=SemiActiveDamper())
    runs = []
    for _ in range(2):
        simulation.reset(np.full((2, 4), 0.0123), None, None, start(vehicle))
        runs.append([simulation.advance(np.full((2, 4), 1e4 * k)) for k in range(10)])
    assert np.array_equal(runs[0], runs[1])


def test_the_start_is_measured_with_the_lowest_coefficient(vehicle: LateralVehicle) -> None:
    simulation = SemiActiveSimulation(vehicle, channels(vehicle), damper=SemiActiveDamper())
    simulation.reset(np.full((1, 4), 0.1), None, None, start(vehicle))
    force, rate, coefficient = np.split(simulation.measure()[0], 3)
    assert np.all(coefficient == 5e3)
    assert np.array_equal(force, -5e3 * rate)
    rows, _ = state_space(vehicle).output_rows(rate_names(vehicle))
    # rounding in the modal transformation
    np.testing.assert_allclose(rate, rows @ start(vehicle), rtol=1e-9)


def test_accelerations_carry_the_dampers_forces(vehicle: LateralVehicle) -> None:
    system = state_space(vehicle)
    names = ("floor_front_lateral_acceleration", "bogie2_lateral_acceleration")
    simulation = SemiActiveSimulation(
        vehicle, (*names, *force_names(vehicle), *system.states), damper=SemiActiveDamper()
    )
    simulation.reset(np.zeros((1, 4)), None, None, start(vehicle))
    last = simulation.advance(np.full((1, 4), 2e4))[0, -1]
    C, D = system.output_rows(names)
    # rounding in the modal transformation, of accelerations of some m/s^2
    np.testing.assert_allclose(last[:2], C @ last[6:] + D[:, :4] @ last[2:6], atol=1e-9)


def test_the_track_can_end_and_lanes_can_be_stopped(vehicle: LateralVehicle) -> None:
    simulation = SemiActiveSimulation(vehicle, ("carbody_lateral",), damper=SemiActiveDamper())
    simulation.reset(np.zeros((2, 4)), irregularity(vehicle, 0.5)[None])
    for _ in range(50):
        simulation.advance(np.full((2, 4), 2e4))
    with pytest.raises(ArgumentError, match="the track ends after"):
        simulation.advance(np.full((2, 4), 2e4))
    before = simulation.state
    simulation.end_track()
    # the state is the same, in modes with and without the track's part
    np.testing.assert_allclose(simulation.state, before, atol=1e-12)
    simulation.stop(np.array([True, False]))
    simulation.advance(np.full((2, 4), 2e4))
    assert not np.any(simulation.state[0])
    assert np.any(simulation.state[1])
    assert simulation.time == pytest.approx(0.51)


def test_what_cannot_be_run_is_refused(vehicle: LateralVehicle) -> None:
    with pytest.raises(ArgumentError, match="no place for a semi-active damper"):
        SemiActiveSimulation(
            lateral17("paper_fit", "passive", 300.0), (), damper=SemiActiveDamper()
        )
    with pytest.raises(ArgumentError, match="unknown output 'damping_coefficient_9'"):
        SemiActiveSimulation(vehicle, ("damping_coefficient_9",), damper=SemiActiveDamper())
    simulation = SemiActiveSimulation(vehicle, (), damper=SemiActiveDamper())
    with pytest.raises(ArgumentError, match="not finite; give N s/m"):
        simulation.advance(np.full((1, 4), np.nan))
