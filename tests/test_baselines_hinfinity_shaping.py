"""H-infinity loop shaping: the closed form of the least gamma, its four blocks, and the shape."""

import numpy as np
import pytest
from scipy import linalg

from baselines import SkyHook
from baselines.hinfinity_shaping import (
    GAIN,
    HINFINITY_SHAPING,
    HInfinityShaping,
    coprime_law,
    shape,
)
from railenv.errors import ArgumentError
from railenv.stability import certify, critical_delays
from railenv.stability.loops import LinearSystem
from railenv.vehicle import LateralVehicle, lateral17, state_space

DELAY = 0.1


@pytest.fixture(scope="module")
def law(vehicle: LateralVehicle) -> HInfinityShaping:
    return HInfinityShaping(vehicle, DELAY)


def response(system: LinearSystem, points: np.ndarray) -> np.ndarray:
    base = points[:, None, None] * np.eye(len(system.A)) - system.A
    return system.C @ np.linalg.solve(base, system.B.astype(complex)) + system.D


def random_plant(seed: int) -> LinearSystem:
    rng = np.random.default_rng(seed)
    A = rng.normal(size=(5, 5))
    return LinearSystem(A, rng.normal(size=(5, 2)), rng.normal(size=(3, 5)), np.zeros((3, 2)))


def four_blocks(plant: LinearSystem, law: LinearSystem) -> float:
    """Largest singular value of [K; I] (I - G K)^-1 [G, I] over a fine grid."""
    points = 1j * np.concatenate([[0.0], np.geomspace(1e-3, 1e3, 6000)])
    G, K = response(plant, points), response(law, points)
    eye = np.eye(G.shape[1])
    right = np.concatenate([G, np.broadcast_to(eye, (len(points), *eye.shape))], axis=2)
    inner = np.linalg.solve(eye - G @ K, right)
    return float(np.linalg.norm(np.concatenate([K @ inner, inner], axis=1), 2, (1, 2)).max())


@pytest.mark.parametrize("seed", range(4))
def test_the_least_gamma_follows_from_the_hankel_norm_of_the_coprime_factors(seed: int) -> None:
    plant = random_plant(seed)
    A, B, C = plant.A, plant.B, plant.C
    Z = linalg.solve_continuous_are(A.T, C.T, B @ B.T, np.eye(3))
    H = -Z @ C.T
    # [N, M] = (A + H C, [B, H], C, [0, I])
    F, G = A + H @ C, np.hstack([B, H])
    P = linalg.solve_continuous_lyapunov(F, -G @ G.T)
    Q = linalg.solve_continuous_lyapunov(F.T, -C.T @ C)
    hankel = np.sqrt(np.abs(linalg.eigvals(P @ Q)).max())
    # Glover and McFarlane 1989: gamma_min = (1 - |[N, M]|_H^2)^(-1/2)
    assert coprime_law(plant, 1.1)[2] == pytest.approx((1 - hankel**2) ** -0.5, rel=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_near_the_optimum_the_four_blocks_have_that_norm(seed: int) -> None:
    plant = random_plant(seed)
    law, gamma, least = coprime_law(plant, 1.005)
    loop = np.block([[plant.A, plant.B @ law.C], [law.B @ plant.C, law.A]])
    assert np.linalg.eigvals(loop).real.max() < 0.0
    # no law is below the least gamma, this one is below its own; a grid loses less than 0.1 %
    assert 0.999 * least < four_blocks(plant, law) < gamma * (1 + 1e-6)


def test_the_vehicles_loop_keeps_its_gamma(law: HInfinityShaping) -> None:
    assert four_blocks(law.shaped, law.law_of_shaped) < law.gamma
    # below 4 a shape counts as one that can be had
    assert 1.0 < law.least_gamma < 2.0


def test_the_shape_is_sky_hook_between_its_corners() -> None:
    f = np.array([0.03, 0.3, 1.2, 5.0, 50.0])
    found = response(shape(GAIN, 0.3, 5.0), 2j * np.pi * f)
    expected = GAIN * 1j * f / (1j * f + 0.3) * 5.0 / (1j * f + 5.0)
    np.testing.assert_allclose(found[:, 0, 0], expected, rtol=1e-12)
    np.testing.assert_allclose(found[:, 1, 1], expected, rtol=1e-12)
    np.testing.assert_array_equal(found[:, 0, 1], 0.0)


def test_the_law_for_sensors_is_shape_times_central_law(law: HInfinityShaping) -> None:
    points = 2j * np.pi * np.array([0.4, 1.3, 4.0])
    central = response(shape(GAIN, 0.3, 5.0), points) @ response(law.law_of_shaped, points)
    forces = np.array([[1.0, 1.0], [1.0, 1.0], [1.0, -1.0], [1.0, -1.0]])
    # the mean of four velocities, and half the difference of the ends; u = -law(y)
    np.testing.assert_allclose(
        response(law.law, points), -forces @ central @ forces.T / 4, rtol=1e-9, atol=1e-6
    )


def test_it_damps_the_carbody_as_sky_hook_does_where_its_delay_is_made_up_for(
    vehicle: LateralVehicle, law: HInfinityShaping
) -> None:
    # at lower sway, 0.55 Hz, force and velocity have opposite sign after the delay
    point = np.array([2j * np.pi * 0.545])
    sway = response(law.law, point)[0].sum() * np.exp(-point[0] * DELAY)
    assert sway.real > 0.0
    assert abs(np.angle(sway)) < np.pi / 4
    assert law.law.A.shape[0] < len(state_space(vehicle).A)


def test_it_stands_more_delay_than_sky_hook_of_its_gain(
    vehicle: LateralVehicle, law: HInfinityShaping
) -> None:
    found = critical_delays(law.to_delay_system(vehicle))
    sky = critical_delays(SkyHook(GAIN, 4).to_delay_system(vehicle))
    assert found.proved
    assert found.critical_delay is not None
    assert sky.critical_delay is not None
    # 458 against 252 ms
    assert found.critical_delay > 1.6 * sky.critical_delay


@pytest.mark.slow
@pytest.mark.parametrize("layout", [2, 4])
@pytest.mark.parametrize("delay", [0.0, 0.2])
def test_the_loop_is_certified_from_no_delay_to_the_one_it_is_designed_for(
    layout: int, delay: float
) -> None:
    vehicle = lateral17("paper_fit", layout, 300.0)
    loop = HInfinityShaping(vehicle, delay).to_delay_system(vehicle)
    assert certify(loop, (0.0, delay) if delay else 0.0).verdict == "STABLE"


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"delay": -0.1}, "delay = -0.1"),
        ({"gain": 0.0}, "gain = 0"),
        ({"highpass_hz": 0.0}, "highpass_hz = 0"),
        ({"lowpass_hz": 0.2}, "lowpass_hz = 0.2 must be above highpass_hz"),
        ({"slack": 1.0}, "slack = 1 must be above 1"),
    ],
)
def test_a_bad_setting_is_refused_by_name(
    vehicle: LateralVehicle, settings: dict[str, float], message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        HInfinityShaping(vehicle, **settings)  # type: ignore[arg-type]


def test_the_passive_vehicle_has_nothing_to_shape() -> None:
    with pytest.raises(ArgumentError, match="passive"):
        HInfinityShaping(lateral17("paper_fit", "passive", 300.0))


def test_the_entry_builds_the_law_for_the_speed_that_is_asked(vehicle: LateralVehicle) -> None:
    values = {key: default for key, (default, _) in HINFINITY_SHAPING.settings.items()}
    made = HINFINITY_SHAPING.build(vehicle, **{**values, "design_kmh": 200.0})
    other = HInfinityShaping(lateral17("paper_fit", 4, 200.0))
    np.testing.assert_array_equal(made.law.A, other.law.A)  # type: ignore[attr-defined]
