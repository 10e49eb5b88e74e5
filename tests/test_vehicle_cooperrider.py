"""Cooperrider's bogie: its equations in two ways, limits with a closed form, published results."""

import dataclasses

import numpy as np
import pytest
from scipy import linalg, optimize

from railenv.errors import ArgumentError
from railenv.simulation.bifurcation import Kind, bifurcation_diagram
from railenv.simulation.linear_speed import linear_critical_speed
from railenv.simulation.periodic_orbits import follow_orbits
from railenv.simulation.settling import Settling, settle
from railenv.vehicle.cooperrider import COORDINATES, CooperriderBogie, CooperriderParameters
from railenv.vehicle.cooperrider_rates import creep_forces, flange_force

PUBLISHED = CooperriderParameters()
FREE = {  # no contact force but the flanges'
    "creep_stiffness": 0.0,
}
UNDAMPED = {"secondary_lateral_damping": 0.0, "secondary_vertical_damping": 0.0}


def bogie(**changes: float) -> CooperriderBogie:
    return CooperriderBogie(dataclasses.replace(PUBLISHED, **changes))


def rate(system: CooperriderBogie, state: np.ndarray, speed: float = 60.0) -> np.ndarray:
    return system.rate(state[None], np.array([speed]))[0]


def random_state(seed: int, size: float = 0.02) -> np.ndarray:
    draw = np.random.default_rng(seed).normal(size=14)
    return size * np.concatenate([draw[:7], 10 * draw[7:]])


def masses(p: CooperriderParameters) -> np.ndarray:
    wheelset = [p.wheelset_mass, p.wheelset_yaw_inertia]
    return np.array([*wheelset, *wheelset, p.frame_mass, p.frame_yaw_inertia, p.frame_roll_inertia])


def spring_energy(p: CooperriderParameters, q: np.ndarray) -> float:
    """Energy in every single spring from where its two ends are; written apart from the model."""
    y1, psi1, y2, psi2, y, psi, phi = q
    energy = 0.5 * p.secondary_yaw_stiffness * psi**2
    for yw, psiw, x in ((y1, psi1, p.half_wheelbase), (y2, psi2, -p.half_wheelbase)):
        for side in (1.0, -1.0):
            d = side * p.half_primary_spacing
            # Below the centre of gravity by h, a point moves sideways by h times the roll more.
            sideways = yw - (y + x * psi + p.frame_to_primary_height * phi)
            lengthways = -d * psiw + d * psi
            upwards = d * phi
            energy += 0.5 * p.primary_lateral_stiffness * sideways**2
            energy += 0.5 * p.primary_longitudinal_stiffness * lengthways**2
            energy += 0.5 * p.primary_vertical_stiffness * upwards**2
        excess = max(abs(yw) - p.flange_clearance, 0.0)
        energy += 0.5 * p.flange_stiffness * excess**2
    for side in (1.0, -1.0):
        # The secondary springs lie above the centre of gravity and so move with the opposite sign
        # of the published height.
        sideways = y - p.frame_to_secondary_height * phi
        upwards = side * p.half_secondary_spacing * phi
        energy += 0.5 * p.secondary_lateral_stiffness * sideways**2
        energy += 0.5 * p.secondary_vertical_stiffness * upwards**2
    return energy


def energy(p: CooperriderParameters, state: np.ndarray) -> float:
    return spring_energy(p, state[:7]) + 0.5 * float(masses(p) @ state[7:] ** 2)


@pytest.mark.parametrize("seed", range(3))
def test_suspension_forces_are_the_gradient_of_the_springs_energy(seed: int) -> None:
    p = bogie(**FREE, **UNDAMPED).parameters
    state = random_state(seed)
    gradient = optimize.approx_fprime(state[:7], lambda q: spring_energy(p, q), 1e-7)
    # Forward differences of a quadratic: half its curvature, below 2e8 N/m, times the step.
    np.testing.assert_allclose(
        -gradient, masses(p) * rate(CooperriderBogie(p), state)[7:], rtol=1e-4, atol=20.0
    )


def test_energy_is_kept_without_creep_and_dampers() -> None:
    system = bogie(**FREE, **UNDAMPED)
    start = random_state(5, 0.01)
    before = energy(system.parameters, start)
    end, outputs = system.advance(start[None], np.array([60.0]), np.array([2.0]), 20000)
    assert abs(outputs).max() > PUBLISHED.flange_clearance  # flanges took part
    # 20 000 steps of 0.1 ms at up to 100 Hz: a kink costs up to (h omega)^2 once per contact.
    assert energy(system.parameters, end[0]) == pytest.approx(before, rel=1e-4)


def test_dampers_take_what_their_speeds_say() -> None:
    system = bogie(**FREE)
    p, state = system.parameters, random_state(6)
    change = rate(system, state)
    gradient = optimize.approx_fprime(state[:7], lambda q: spring_energy(p, q), 1e-7)
    power = gradient @ state[7:] + float(masses(p) * state[7:] @ change[7:])
    lateral = state[11] - p.frame_to_secondary_height * state[13]
    upward = p.half_secondary_spacing * state[13]
    lost = 2 * (p.secondary_lateral_damping * lateral**2 + p.secondary_vertical_damping * upward**2)
    assert power == pytest.approx(-lost, rel=1e-3)  # rounding of the differences


def test_creep_only_takes_energy_from_a_bogie_with_cylindrical_wheels_at_rest_in_yaw() -> None:
    # With lambda = 0 and no yaw the creepages are the wheel's own velocities.
    state = np.zeros(14)
    state[7:11] = 0.1, 0.2, -0.3, 0.1
    p = bogie(conicity=0.0).parameters
    without = rate(bogie(conicity=0.0, **FREE), state)
    creep = masses(p) * (rate(CooperriderBogie(p), state) - without)[7:]
    assert creep @ state[7:] < 0.0


def test_the_linearisation_is_the_rates_derivative_at_rest() -> None:
    system, step = bogie(), 1e-9
    # Creep deviates from linear by u / 3 of itself, u = 656 creepage / phi: 4e-7 at this step.
    points = step * np.concatenate([np.eye(14), -np.eye(14)])
    rates = system.rate(points, np.full(28, 63.0))
    difference = (rates[:14] - rates[14:]).T / (2 * step)
    np.testing.assert_allclose(difference, system.linearisation(63.0), rtol=1e-5, atol=1e-7)


def test_the_mirrored_motion_is_a_motion() -> None:
    state = random_state(2)
    assert np.array_equal(rate(bogie(), -state), -rate(bogie(), state))


@pytest.mark.parametrize("u", [0.0, 0.3, 1.5, 2.999, 3.0, 10.0])
def test_creep_saturates_after_vermeulen_and_johnson(u: float) -> None:
    p = bogie()._numbers
    creepage = u * p.friction_limit / p.creep_stiffness * p.divisor_lateral
    along, across = creep_forces(p, 0.0, creepage)
    law = 1.0 - (1.0 - min(u, 3.0) / 3.0) ** 3  # the cube, multiplied out in the model
    assert across / p.friction_limit == pytest.approx(law, rel=1e-12, abs=1e-15)
    assert along == 0.0


def test_a_flange_touches_at_its_clearance_on_either_side() -> None:
    p = bogie()._numbers
    shifts = np.array([-0.0191, -0.0091, 0.0, 0.0091, 0.0191])
    forces = [flange_force(p, float(shift)) for shift in shifts]
    np.testing.assert_allclose(forces, [-146e3, 0, 0, 0, 146e3], rtol=1e-12)


def test_a_free_wheelset_follows_klingels_wavelength() -> None:
    loose = {
        f.name: 0.0
        for f in dataclasses.fields(PUBLISHED)
        if "primary" in f.name and "stiffness" in f.name
    }
    speed = 0.1  # slow: inertia against creep is m V / f, 1e-5
    roots = np.linalg.eigvals(bogie(**loose).linearisation(speed))
    p = PUBLISHED
    klingel = speed * np.sqrt(p.conicity / (p.half_contact_spacing * p.wheel_radius))
    frequencies = np.sort(abs(roots.imag))[::-1]
    hunting = frequencies[np.argmin(abs(frequencies - klingel))]
    # (1 / (a r0 / lambda))'s own correction by the creep ratio is of second order in inertia.
    assert hunting == pytest.approx(klingel, rel=1e-6)


def test_a_stiff_primary_suspension_makes_one_rigid_body_of_the_bogie() -> None:
    hard = 1e6
    system = bogie(
        primary_lateral_stiffness=hard * PUBLISHED.primary_lateral_stiffness,
        primary_longitudinal_stiffness=hard * PUBLISHED.primary_longitudinal_stiffness,
        primary_vertical_stiffness=hard * PUBLISHED.primary_vertical_stiffness,
    )
    p = PUBLISHED
    mass = p.frame_mass + 2 * p.wheelset_mass
    b, a, steer = p.half_wheelbase, p.half_contact_spacing, p.conicity / p.wheel_radius
    inertia = p.frame_yaw_inertia + 2 * p.wheelset_yaw_inertia + 2 * p.wheelset_mass * b**2
    fx = 4 * p.creep_stiffness / p.creep_divisor_longitudinal
    fy = 4 * p.creep_stiffness / p.creep_divisor_lateral

    def rigid(speed: float) -> np.ndarray:
        """Lateral and yaw of one body on four wheels, both wheelsets' contributions summed."""
        K = np.array(
            [[2 * p.secondary_lateral_stiffness, -fy], [a * fx * steer, p.secondary_yaw_stiffness]]
        )
        C = np.diag([2 * p.secondary_lateral_damping + fy / speed, (a**2 * fx + b**2 * fy) / speed])
        inverse = np.diag([1 / mass, 1 / inertia])
        return np.block([[np.zeros((2, 2)), np.eye(2)], [-inverse @ K, -inverse @ C]])

    seven = linear_critical_speed(system.linearisation, 30.0, 90.0)
    two = linear_critical_speed(rigid, 30.0, 90.0)
    assert seven is not None
    assert two is not None
    # The difference falls as 12 / hard: 1e-5 here.
    assert seven.speed == pytest.approx(two.speed, rel=3e-5)
    assert seven.frequency == pytest.approx(two.frequency, rel=3e-5)


def test_small_motions_are_those_of_the_matrix_exponential_to_fourth_order() -> None:
    # 1e-10 m: creep is linear to 1e-7 of itself, less than the method's error at these steps.
    start = np.zeros(14)
    start[:5] = 1e-10
    exact = linalg.expm(0.2 * bogie().linearisation(60.0)) @ start
    errors = []
    for samples in (50, 100):
        system = CooperriderBogie(time_step=0.2 / samples)
        end, _ = system.advance(start[None], np.array([60.0]), np.array([0.2]), samples)
        errors.append(float(abs(end[0] - exact).max()))
    assert 12.0 < errors[0] / errors[1] < 24.0  # 16 for small steps


def test_a_lane_does_not_depend_on_its_neighbours() -> None:
    starts = np.stack([random_state(seed, 0.003) for seed in range(3)])
    speeds, durations = np.array([50.0, 70.0, 90.0]), np.array([0.5, 0.7, 0.3])
    together = bogie().advance(starts, speeds, durations, 50)
    for lane in range(3):
        part = slice(lane, lane + 1)
        alone = bogie().advance(starts[part], speeds[part], durations[part], 50)
        assert np.array_equal(alone[0], together[0][part])
        assert np.array_equal(alone[1], together[1][part])


def test_advancing_leaves_the_given_states_as_they_are() -> None:
    start = random_state(1)[None]
    before = start.copy()
    end, _ = bogie().advance(start, np.array([60.0]), np.array([0.1]), 1)
    assert np.array_equal(start, before)
    assert not np.shares_memory(start, end)


def test_the_output_is_the_coordinate_named() -> None:
    system = CooperriderBogie(output="frame_yaw")
    end, outputs = system.advance(random_state(1)[None], np.array([60.0]), np.array([0.1]), 3)
    assert outputs[0, -1] == end[0, COORDINATES.index("frame_yaw")]


# Published: bifurcation.de, example 10 "railway bogie", after Kaas-Petersen 1986: the straight run
# loses its stability at 68.66 (printed as mph; the parameters are metric and give it in m/s) "with
# a hard loss of stability"; figures: from a shift of 0.1 to a periodic orbit at 70, to rest at 60.


def test_the_straight_run_loses_its_stability_where_it_was_published() -> None:
    found = linear_critical_speed(bogie().linearisation, 20.0, 120.0)
    assert found is not None
    # 68.644 here. Their creep stiffness is not certain (their source misprints its shear modulus):
    # -0.3 % of it would make up the difference of 0.016.
    assert found.speed == pytest.approx(68.66, abs=0.03)


@pytest.mark.parametrize(("speed", "hunts"), [(70.0, True), (60.0, False)])
def test_a_shift_of_a_decimetre_ends_as_published(speed: float, hunts: bool) -> None:
    start = 0.1 * np.eye(14)[:1]
    result = settle(bogie().advance, start, np.array([speed]), Settling())
    assert result.settled[0]
    assert result.hunting[0] == hunts


@pytest.mark.slow
def test_stability_is_lost_hard_and_ramp_and_shooting_find_one_fold() -> None:
    system = bogie()
    small, large = 1e-5 * np.eye(14)[0], 0.01 * np.eye(14)[0]
    diagram = bifurcation_diagram(
        system,
        np.arange(66.0, 71.0),
        small,
        large,
        Settling(samples=2000),
        linear=linear_critical_speed(system.linearisation, 20.0, 120.0),
        tolerance=0.01,
    )
    assert diagram.kind is Kind.SUBCRITICAL
    down = diagram.down
    branch = follow_orbits(
        system,
        down.states[0],
        1.0 / float(down.frequencies[0]),
        float(down.speeds[0]),
        lowest=60.0,
        highest=71.0,
        least_amplitude=1e-3,
    )
    (fold,) = branch.folds
    # The ramp's bracket is 0.01 wide and lies lower by what its drift lets pass, some 0.01.
    assert diagram.hunting_speed == pytest.approx(fold.speed, abs=0.02)
    assert fold.speed == pytest.approx(66.6554, abs=1e-3)  # own value, converged to 1e-4


@pytest.mark.slow
def test_the_unstable_cycle_shrinks_to_the_hopf_point() -> None:
    system = bogie()
    begun = settle(system.advance, 0.01 * np.eye(14)[:1], np.array([68.0]), Settling())
    period = 1.0 / float(begun.frequencies[0])
    branch = follow_orbits(
        system, begun.states[0], period, 68.0, lowest=60.0, highest=70.0, least_amplitude=1e-4
    )
    last, before = branch.orbits[-1], branch.orbits[-3]
    slope = (last.speed - before.speed) / (last.amplitude - before.amplitude)
    hopf = linear_critical_speed(system.linearisation, 20.0, 120.0)
    assert hopf is not None
    assert not last.stable
    # Speed falls linearly with amplitude here: creep is u - u^2 / 3; the curvature is left out.
    assert last.speed - slope * last.amplitude == pytest.approx(hopf.speed, abs=2e-3)
    assert 1.0 / last.period == pytest.approx(hopf.frequency, rel=1e-3)


def test_exchanged_creep_divisors_give_another_speed() -> None:
    found = linear_critical_speed(
        bogie(
            creep_divisor_longitudinal=PUBLISHED.creep_divisor_lateral,
            creep_divisor_lateral=PUBLISHED.creep_divisor_longitudinal,
        ).linearisation,
        20.0,
        120.0,
    )
    assert found is not None
    assert found.speed == pytest.approx(65.29, abs=0.005)


@pytest.mark.parametrize("name", ["wheelset_mass", "wheel_radius", "creep_divisor_lateral"])
def test_a_number_that_must_be_above_zero_is_named(name: str) -> None:
    with pytest.raises(ArgumentError, match=name):
        bogie(**{name: 0.0})


def test_a_negative_stiffness_is_refused() -> None:
    with pytest.raises(ArgumentError, match="flange_stiffness"):
        bogie(flange_stiffness=-1.0)


def test_an_unknown_output_is_named_with_the_nearest() -> None:
    with pytest.raises(ArgumentError, match="frame_roll"):
        CooperriderBogie(output="frame_rol")


def test_arrays_that_do_not_fit_are_refused() -> None:
    system, states, one = bogie(), np.zeros((1, 14)), np.array([60.0])
    with pytest.raises(ArgumentError, match="states"):
        system.rate(np.zeros((1, 13)), one)
    with pytest.raises(ArgumentError, match="speeds"):
        system.rate(states, np.array([0.0]))
    with pytest.raises(ArgumentError, match="durations"):
        system.advance(states, one, np.array([1.0, 2.0]), 1)
    with pytest.raises(ArgumentError, match="speed"):
        system.linearisation(-1.0)
