"""H-infinity control: the problem that is posed, the Riccati equations, the norm of the loop."""

import control
import numpy as np
import pytest
from scipy import linalg

from baselines import SkyHook
from baselines.hinfinity import HINFINITY, HInfinity, central_controller, smallest_level
from baselines.hinfinity_plant import (
    FLOORS,
    GeneralisedPlant,
    balanced,
    generalised_plant,
    ride_system,
    track_filter,
)
from baselines.modal_signals import modal_signals
from eval.measures import measure
from eval.rollout import rollout
from railenv.errors import ArgumentError
from railenv.metrics import sperling_filter
from railenv.stability import certify, critical_delays
from railenv.stability.loops import LinearSystem
from railenv.track import german_low, make_track
from railenv.vehicle import LateralVehicle, lateral17, state_space

DELAY = 0.1
OMEGA = 2 * np.pi * np.geomspace(0.02, 60.0, 1500)


@pytest.fixture(scope="module")
def law(vehicle: LateralVehicle) -> HInfinity:
    return HInfinity(vehicle, DELAY)


@pytest.fixture(scope="module")
def reduced(law: HInfinity) -> GeneralisedPlant:
    return balanced(law.design.plant, 40)[0]


def response(system: LinearSystem, points: np.ndarray) -> np.ndarray:
    """C (s - A)^-1 B + D at points s, shape (points, outputs, inputs)."""
    base = points[:, None, None] * np.eye(len(system.A)) - system.A
    return system.C @ np.linalg.solve(base, system.B.astype(complex)) + system.D


def norm_by_hamiltonian(system: LinearSystem) -> float:
    """H-infinity norm of a strictly proper system: Boyd, Balakrishnan and Kabamba 1989, bisected.

    Below the norm, and only there, [[A, B B'/g], [-C'C/g, -A']] has roots on the imaginary axis.
    """
    _, (scale, _) = linalg.matrix_balance(system.A, permute=False, separate=True)
    A, B, C = system.A * scale / scale[:, None], system.B / scale[:, None], system.C * scale
    low, high = 0.0, 1e3
    while high - low > 1e-4 * high:
        g = (low + high) / 2 if low else high / 4
        hamiltonian = np.block([[A, B @ B.T / g], [-C.T @ C / g, -A.T]])
        roots = np.linalg.eigvals(hamiltonian)
        # Rounding moves roots of size 1 to 100 by 1e-7 at most; the loop's slowest is at 0.3 1/s.
        on_axis = np.abs(roots.real) < 1e-5
        if np.any(on_axis):
            low = g
        else:
            high = g
            if not low and g < 1e-9:
                return 0.0
    return high


def test_the_ride_filter_has_sperlings_magnitude() -> None:
    f = np.array([0.1, 0.5, 1.0, 5.4, 20.0, 80.0])
    found = np.abs(response(ride_system(), 2j * np.pi * f)[:, 0, 0])
    np.testing.assert_allclose(found, sperling_filter(f), rtol=1e-12)


@pytest.mark.parametrize("speed", [30.0, 83.0])
def test_the_tracks_filter_has_half_the_one_sided_density(speed: float) -> None:
    f = np.array([0.5, 1.0, 3.0, 10.0])
    found = response(track_filter(speed), 2j * np.pi * f)[:, :, 0]
    density = german_low().density("alignment", f / speed) / speed  # per hertz
    np.testing.assert_allclose(2 * np.abs(found[:, 0]) ** 2, density, rtol=1e-12)
    # the second output is the rate of the first
    np.testing.assert_allclose(found[:, 1], 2j * np.pi * f * found[:, 0], rtol=1e-12)


@pytest.mark.parametrize("layout", [2, 4])
def test_sway_force_does_not_yaw_the_carbody_and_yaw_force_does_not_shift_it(layout: int) -> None:
    system = state_space(lateral17("paper_fit", layout, 300.0))
    forces = modal_signals(str(layout), ("velocity",)).forces  # type: ignore[arg-type]
    pushed = system.actuator_input @ forces
    lateral = pushed[system.states.index("carbody_lateral_velocity")]
    yaw = pushed[system.states.index("carbody_yaw_velocity")]
    # sums of four equal numbers with signs: exact up to the last digit
    assert abs(yaw[0]) < 1e-12 * abs(yaw[1])
    assert abs(lateral[1]) < 1e-12 * abs(lateral[0])


def test_each_reading_sees_its_own_motion_of_the_carbody() -> None:
    system = state_space(lateral17("paper_fit", 4, 300.0))
    signals = modal_signals("4", ("velocity", "stroke", "roll_rate"))
    C, _ = system.output_rows(signals.sensors)
    seen = dict(zip(signals.names, signals.readings @ C, strict=True))
    lateral = system.states.index("carbody_lateral_velocity")
    yaw = system.states.index("carbody_yaw_velocity")
    assert seen["velocity_sway"][[lateral, yaw]] == pytest.approx([1.0, 0.0], abs=1e-12)
    # at damper level a yaw rate moves the front by half the bogie spacing
    assert seen["velocity_yaw"][[lateral, yaw]] == pytest.approx([0.0, 8.69], abs=1e-12)


@pytest.mark.parametrize("delay", [0.0, 0.1])
def test_the_problem_holds_the_vehicles_own_path_from_force_to_floor(
    vehicle: LateralVehicle, delay: float
) -> None:
    design = generalised_plant(vehicle, delay, 2e-4, 1e-3)
    plant, points = design.plant, 2j * np.pi * np.array([0.3, 1.0, 3.0, 5.0])
    found = response(LinearSystem(plant.A, plant.B2, plant.C1, np.zeros((2, 2))), points)
    system = state_space(vehicle)
    C, D = system.output_rows(FLOORS)
    whole = LinearSystem(system.A, system.actuator_input, C, D[:, :4])
    ride = response(ride_system(), points)
    late = np.exp(-points * delay)[:, None, None]
    expected = ride * late * (response(whole, points) @ design.signals.forces) / 2e-4
    # Pade of order 3 at 5 Hz and 0.1 s: 2.3 times pi / 2 of phase, 1 % of error
    size = np.abs(expected).max()
    np.testing.assert_allclose(found, expected, atol=(0.02 if delay else 1e-10) * size)


def test_the_problem_measures_what_the_vehicle_measures(vehicle: LateralVehicle) -> None:
    design = generalised_plant(vehicle, 0.0, 2e-4, 1e-3)
    plant, points = design.plant, 2j * np.pi * np.array([0.3, 1.0, 3.0])
    found = response(LinearSystem(plant.A, plant.B2, plant.C2, np.zeros((4, 2))), points)
    system = state_space(vehicle)
    C, D = system.output_rows(design.signals.sensors)
    own = response(LinearSystem(system.A, system.actuator_input, C, D[:, :4]), points)
    expected = design.signals.readings @ own @ design.signals.forces / 2e-4
    # noise of the strokes is 0.3 s times that of the velocities
    expected /= np.array([1e-3, 3e-4, 1e-3, 3e-4])[:, None]
    np.testing.assert_allclose(found, expected, atol=1e-10 * np.abs(expected).max())


def test_truncation_stays_within_twice_the_hankel_values_left_out(law: HInfinity) -> None:
    plant = law.design.plant
    # The bound holds for the plant shifted by 0.5 1/s (all of its modes are stable).
    points = 1j * OMEGA[::5] + 0.5
    small, bound = balanced(plant, 24)

    def outer(p: GeneralisedPlant) -> np.ndarray:
        B, C = np.hstack([p.B1, p.B2]), np.vstack([p.C1, p.C2])
        return response(LinearSystem(p.A, B, C, np.zeros((len(C), B.shape[1]))), points)

    error = np.linalg.norm(outer(plant) - outer(small), 2, axis=(1, 2)).max()
    assert error < bound
    # and the bound is no empty one
    assert error > 0.01 * bound


def test_both_riccati_equations_hold_to_rounding(law: HInfinity) -> None:
    # 40 states, entries of X over ten powers of ten; a wrong term leaves 1e-3 and more
    assert max(law.central.residuals) < 1e-10


def test_without_a_bound_on_the_level_the_controller_is_lqg(reduced: GeneralisedPlant) -> None:
    p = reduced
    found = central_controller(p, 1e6)
    assert found is not None
    X = linalg.solve_continuous_are(p.A, p.B2, p.C1.T @ p.C1, np.eye(2))
    Y = linalg.solve_continuous_are(p.A.T, p.C2.T, p.B1 @ p.B1.T, np.eye(4))
    A = p.A - p.B2 @ p.B2.T @ X - Y @ p.C2.T @ p.C2
    # 1 / level^2 = 1e-12 is all that is left, times the size of X and Y
    np.testing.assert_allclose(found.C, -p.B2.T @ X, atol=1e-6 * np.abs(found.C).max())
    np.testing.assert_allclose(found.B, Y @ p.C2.T, atol=1e-6 * np.abs(found.B).max())
    np.testing.assert_allclose(found.A, A, atol=1e-6 * np.abs(A).max())


@pytest.mark.slow
def test_the_loop_with_the_whole_plant_stays_below_the_level(law: HInfinity) -> None:
    loop = law.central.around(law.design.plant)
    size = norm_by_hamiltonian(loop)
    # the reduction costs less than the 4 % that are left below the level
    assert 0.8 * law.central.level < size < law.central.level
    # a grid is a lower bound; 1500 lines miss a peak of this damping by less than 1 %
    on_grid = np.linalg.norm(response(loop, 1j * OMEGA), 2, axis=(1, 2)).max()
    assert 0.99 * size < on_grid < (1 + 1e-3) * size


def test_python_control_finds_the_same_norm(law: HInfinity, reduced: GeneralisedPlant) -> None:
    loop = law.central.around(reduced)
    # python-control 0.10.2 takes square systems alone; outputs of zero change no singular value
    square = np.zeros((6, loop.C.shape[1]))
    square[:4] = loop.C
    system = control.ss(loop.A, loop.B, square, np.zeros((6, 6)))
    other = control.system_norm(system, p="inf", tol=1e-4)
    assert norm_by_hamiltonian(loop) == pytest.approx(other, rel=1e-3)


@pytest.mark.parametrize("seed", range(6))
def test_near_the_smallest_level_the_norm_is_that_level_in_random_problems(seed: int) -> None:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(5, 5)) - rng.uniform(-0.5, 2.0) * np.eye(5)
    shapes = ((5, 2), (5, 2), (2, 5), (3, 5))
    plant = GeneralisedPlant(A, *(rng.normal(size=shape) for shape in shapes))
    smallest = smallest_level(plant)
    central = central_controller(plant, 1.002 * smallest)
    assert central is not None
    loop = central.around(plant)
    assert np.linalg.eigvals(loop.A).real.max() < 0.0
    # No controller is below the optimum, the central one is below its level, and the bisection has
    # found the optimum to 0.1 %.
    assert 0.998 * smallest < norm_by_hamiltonian(loop) < 1.0021 * smallest


def test_no_controller_is_found_below_the_smallest_level(reduced: GeneralisedPlant) -> None:
    smallest = smallest_level(reduced)
    assert central_controller(reduced, 0.995 * smallest) is None
    assert central_controller(reduced, 1.005 * smallest) is not None


def test_lqg_has_a_larger_norm_than_the_smallest_level(
    law: HInfinity, reduced: GeneralisedPlant
) -> None:
    lqg = central_controller(reduced, 1e6)
    assert lqg is not None
    assert norm_by_hamiltonian(lqg.around(reduced)) > 1.1 * law.smallest


def test_the_law_commands_what_the_scaled_controller_does(law: HInfinity) -> None:
    points = 2j * np.pi * np.array([0.4, 1.3, 4.0])
    design, central = law.design, law.central
    scaled = response(LinearSystem(central.A, central.B, central.C, np.zeros((2, 4))), points)
    signals = design.signals
    force = signals.forces @ (scaled / design.noise / design.force_weight) @ signals.readings
    # u = -law(y)
    np.testing.assert_allclose(response(law.law, points), -force, rtol=1e-9, atol=1e-6)


def test_the_nominal_loop_is_proved_stable_at_its_own_delay(
    vehicle: LateralVehicle, law: HInfinity
) -> None:
    found = critical_delays(law.to_delay_system(vehicle))
    assert found.proved
    assert any(low < DELAY < high for low, high in found.stable_windows)


@pytest.mark.slow
@pytest.mark.parametrize("layout", [2, 4])
@pytest.mark.parametrize("delay", [0.0, 0.1, 0.3])
def test_the_loop_is_certified_at_the_delay_it_is_designed_for(layout: int, delay: float) -> None:
    vehicle = lateral17("paper_fit", layout, 300.0)
    loop = HInfinity(vehicle, delay).to_delay_system(vehicle)
    assert certify(loop, delay).verdict == "STABLE"


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.05, 0.15, 0.25])
def test_it_rides_better_at_both_ends_than_any_sky_hook_at_its_delay(
    vehicle: LateralVehicle, delay: float
) -> None:
    tracks = [make_track("german_low", 3500.0, seed) for seed in range(4)]

    def index(controller: object) -> tuple[float, float]:
        lanes = np.full((4, 4), delay)
        run = rollout(controller, vehicle, lanes, 40.0, tracks=tracks, track_of_lane=np.arange(4))  # type: ignore[arg-type]
        found = measure(run, 10.0, 30e3)
        assert not np.any(found.diverged)
        return float(found.ride_index_front.mean()), float(found.ride_index_rear.mean())

    front, rear = index(HInfinity(vehicle, delay))
    for gain in (5e3, 7.5e3, 10e3):
        sky_front, sky_rear = index(SkyHook(gain, 4))
        # the same tracks for all; measured margins are 0.13 and more
        assert front < sky_front - 0.08
        assert rear < sky_rear - 0.08


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"delay": -0.1}, "delay = -0.1"),
        ({"force_weight": 0.0}, "force_weight = 0"),
        ({"noise": -1.0}, "noise = -1"),
        ({"slack": 1.0}, "slack = 1 must be above 1"),
    ],
)
def test_a_bad_setting_is_refused_by_name(
    vehicle: LateralVehicle, settings: dict[str, float], message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        HInfinity(vehicle, **settings)  # type: ignore[arg-type]


def test_the_passive_vehicle_has_nothing_to_control() -> None:
    with pytest.raises(ArgumentError, match="passive"):
        HInfinity(lateral17("paper_fit", "passive", 300.0))


def test_an_unknown_reading_is_refused_with_the_nearest() -> None:
    with pytest.raises(ArgumentError, match="roll_rate"):
        modal_signals("4", ("rol_rate",))


def test_the_entry_builds_the_law_for_the_speed_that_is_asked(vehicle: LateralVehicle) -> None:
    values = {key: default for key, (default, _) in HINFINITY.settings.items()}
    made = HINFINITY.build(vehicle, **{**values, "design_kmh": 200.0})
    other = HInfinity(lateral17("paper_fit", 4, 200.0))
    np.testing.assert_array_equal(made.law.A, other.law.A)  # type: ignore[attr-defined]
