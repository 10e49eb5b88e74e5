"""The track that laws are designed for: its density, its wheelsets, its delays."""

from itertools import pairwise

import numpy as np
import pytest
from scipy import integrate
from scipy.linalg import solve_discrete_lyapunov

from baselines.design.track_filter import WheelProcess, wheel_process
from railenv.errors import ArgumentError
from railenv.track.spectra import get_spectrum
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, lateral17

STEP = 0.005
CHANNELS = ("alignment", "cross_level")


def covariance(process: WheelProcess) -> FloatArray:
    """Stationary covariance of the states, by scipy."""
    return np.asarray(solve_discrete_lyapunov(process.F, process.N @ process.N.T), dtype=float)


def lagged(process: WheelProcess, lag: int) -> FloatArray:
    """E[w(t + lag h) w(t)'] of what the wheelsets meet, shape (8, 8)."""
    power = np.linalg.matrix_power(process.F, lag)
    return process.H @ power @ covariance(process) @ process.H.T


def per_channel(vehicle: LateralVehicle) -> tuple[float, float]:
    """What turns a channel's height into what a wheelset meets: nothing, or an angle."""
    return 1.0, 0.5 / vehicle.parameters.half_contact_spacing


def variance_by_quadrature(vehicle: LateralVehicle, track: str, kind: int) -> float:
    """Integral of the published density over all wavenumbers, without its formula."""
    spectrum, unit = get_spectrum(track), per_channel(vehicle)[kind]

    def density(omega: float) -> float:
        return unit**2 * float(spectrum.angular_density(CHANNELS[kind], omega))

    edges = np.geomspace(1e-9, 1e3, 25)
    return sum(integrate.quad(density, *ends)[0] for ends in pairwise(edges))


def autocovariance(vehicle: LateralVehicle, kind: int, time: float) -> float:
    """R(t) of German low, the integral of S(Omega) cos(Omega v t), in closed form.

    In partial fractions over Omega^2 every r / (Omega^2 + c^2) gives pi r exp(-c v |t|) / (2 c).
    """
    density = getattr(get_spectrum("german_low"), CHANNELS[kind])
    squares = np.square(density.corners)
    total = 0.0
    for corner, square in zip(density.corners, squares, strict=True):
        others = np.prod([other - square for other in squares if other != square])
        residue = density.amplitude * (-square) ** (density.zeros // 2) / others
        total += np.pi * residue * np.exp(-corner * vehicle.speed * abs(time)) / (2.0 * corner)
    return per_channel(vehicle)[kind] ** 2 * total


@pytest.mark.parametrize("kind", [0, 1])
@pytest.mark.parametrize("preview", [False, True])
def test_every_wheelset_meets_the_variance_of_the_published_density(
    vehicle: LateralVehicle, kind: int, preview: bool
) -> None:
    process = wheel_process(vehicle, "german_low", STEP, preview=preview)
    variance = np.diag(lagged(process, 0))[4 * kind : 4 * kind + 4]
    expected = variance_by_quadrature(vehicle, "german_low", kind)
    # the integral ends at 1000 rad/m: 1e-9 of it is missing; quadrature is better than that
    np.testing.assert_allclose(variance, expected, rtol=1e-7)


@pytest.mark.parametrize("track", ["german_low", "german_high", "fra5"])
@pytest.mark.parametrize("kind", [0, 1])
def test_the_sampled_process_has_the_published_density_folded_at_the_steps(
    vehicle: LateralVehicle, track: str, kind: int
) -> None:
    process = wheel_process(vehicle, track, STEP, preview=False)
    sampling = 2.0 * np.pi / (STEP * vehicle.speed)
    spectrum, unit = get_spectrum(track), per_channel(vehicle)[kind]
    # 200 m is where the process of FRA, without a corner of its own, bends off: stay above
    for wavenumber in (0.3, 0.8, 2.0, 5.0):
        z = np.exp(1j * wavenumber * vehicle.speed * STEP)
        inner = np.linalg.solve(z * np.eye(len(process.F)) - process.F, process.N)
        rows = process.H[4 * kind] @ inner
        # density of a sequence: h / (2 pi) |H|^2 over omega, two-sided; v times that over Omega
        sampled = 2.0 * vehicle.speed * STEP / (2.0 * np.pi) * np.sum(np.abs(rows) ** 2)
        folds = np.abs(wavenumber + sampling * np.arange(-300, 301))
        density = spectrum.angular_density(CHANNELS[kind], folds)
        if track.startswith("fra") and kind == 0:
            density *= folds**2 / (folds**2 + (2.0 * np.pi / 200.0) ** 2)
        # an Omega^-4 density leaves 1e-8 beyond 300 foldings, twice that for 5 rad/m
        np.testing.assert_allclose(sampled, unit**2 * density.sum(), rtol=1e-6)


def test_alignment_and_roll_are_independent(vehicle: LateralVehicle) -> None:
    both = lagged(wheel_process(vehicle, "german_low", STEP, preview=True), 3)
    # they are drawn from streams of their own; nothing links them, so that the zero is exact
    np.testing.assert_array_equal(both[:4, 4:], 0.0)


@pytest.mark.parametrize("lag", [0, 7])
def test_wheelsets_apart_are_independent_copies(vehicle: LateralVehicle, lag: int) -> None:
    both = lagged(wheel_process(vehicle, "german_low", STEP, preview=False), lag)
    for kind in (0, 1):
        block = both[4 * kind : 4 * kind + 4, 4 * kind : 4 * kind + 4]
        expected = autocovariance(vehicle, kind, lag * STEP)
        # closed form against a Lyapunov equation and matrix exponentials: rounding
        np.testing.assert_allclose(block, expected * np.eye(4), atol=1e-9 * abs(expected))


@pytest.mark.parametrize("speed_kmh", [300.0, 237.0])
@pytest.mark.parametrize("lag", [0, 11])
def test_in_a_row_each_wheelset_meets_the_track_of_the_first_exactly_later(
    speed_kmh: float, lag: int
) -> None:
    # at 300 km/h the axles of a bogie are six steps apart; all other distances are broken steps
    car = lateral17("paper_fit", 4, speed_kmh)
    behind = car.wheelset_setback / car.speed
    found = lagged(wheel_process(car, "german_low", STEP, preview=True), lag)
    for kind in (0, 1):
        variance = autocovariance(car, kind, 0.0)
        for later in range(4):
            for now in range(4):
                # w_i(t) = w_1(t - behind_i)
                apart = lag * STEP - behind[later] + behind[now]
                expected = autocovariance(car, kind, apart)
                value = found[4 * kind + later, 4 * kind + now]
                # rounding; a wheelset one step late is off by 1e-4 of the variance and more
                assert value == pytest.approx(expected, abs=1e-9 * variance)


def test_a_track_in_a_row_is_one_track_at_any_step() -> None:
    # what passes at one instant does not depend on how finely the steps cut the time
    car = lateral17("paper_fit", 4, 237.0)
    coarse = lagged(wheel_process(car, "german_low", 0.005, preview=True), 2)
    fine = lagged(wheel_process(car, "german_low", 0.0025, preview=True), 4)
    # two exact samplings of one process: rounding only
    np.testing.assert_allclose(coarse, fine, atol=1e-11 * np.abs(coarse).max())


def test_a_corner_at_zero_ends_at_the_longest_wave(vehicle: LateralVehicle) -> None:
    process = wheel_process(vehicle, "fra6", STEP, preview=False)
    corner, lowest = 0.8245, 2.0 * np.pi / 200.0
    amplitude = 0.25e-4 * 0.0339 * corner**2
    # integral of a / ((w^2 + p^2) (w^2 + q^2)) over w > 0: pi a / (2 p q (p + q))
    expected = np.pi * amplitude / (2.0 * corner * lowest * (corner + lowest))
    # closed form against a Lyapunov equation of stable, well scaled lags
    np.testing.assert_allclose(np.diag(lagged(process, 0))[:4], expected, rtol=1e-10)


@pytest.mark.parametrize("preview", [False, True])
def test_the_process_is_stable(vehicle: LateralVehicle, preview: bool) -> None:
    F = wheel_process(vehicle, "fra1", STEP, preview=preview).F
    assert np.abs(np.linalg.eigvals(F)).max() < 1.0


def test_a_spectrum_that_is_not_rational_is_refused_by_its_name(vehicle: LateralVehicle) -> None:
    with pytest.raises(ArgumentError, match="'tb3352' has no rational density"):
        wheel_process(vehicle, "tb3352", STEP, preview=False)


def test_an_unknown_spectrum_names_the_nearest(vehicle: LateralVehicle) -> None:
    with pytest.raises(ArgumentError, match="german_low"):
        wheel_process(vehicle, "german_lo", STEP, preview=False)
