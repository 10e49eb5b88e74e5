"""The stability oracle beside independent programs: the same roots, crossings and Pade models.

tdcpy finds roots on a discretised generator, qpmr by level curves of a quasi-polynomial, YALTApy
crossings by following polynomial roots round the unit circle, python-control has Pade coefficients.
None of them shares a line with railenv. Where a peer is wrong, a test says so beside the residual
that decides who is right.
"""

import warnings
from itertools import pairwise
from types import ModuleType

import numpy as np
import pytest
from scipy.optimize import linear_sum_assignment

from railenv.stability import (
    DelaySystem,
    critical_delays,
    pade_roots,
    rightmost_roots,
)
from railenv.stability.pade import pade_block


def peer(name: str) -> ModuleType:
    """Import a peer; yaltapy silences every warning of the process while it is imported."""
    with warnings.catch_warnings():
        return pytest.importorskip(name, reason=f"{name} is not installed: railenv[dev] has it")


def delayed_integrator() -> DelaySystem:
    """x' = -x(t - tau)."""
    return DelaySystem([[0.0]], [[1.0]], [[1.0]])


def oscillator() -> DelaySystem:
    """Sky-hook on one mass: x'' + 0.6 x' + (2 pi 1.2)^2 x = -4 x'(t - tau)."""
    return DelaySystem(
        [[0.0, 1.0], [-((2 * np.pi * 1.2) ** 2), -0.6]], [[0.0], [1.0]], [[0.0, 4.0]]
    )


def quarter_car() -> DelaySystem:
    """Body 320 kg on 18 kN/m and 1 kN s/m over a wheel of 40 kg on 200 kN/m; sky-hook 2 kN s/m."""
    spring, damper, tyre = 18e3, 1e3, 200e3
    A = [
        [0.0, 0.0, 1.0, 0.0],
        [0.0, 0.0, 0.0, 1.0],
        [-spring / 320, spring / 320, -damper / 320, damper / 320],
        [spring / 40, -(spring + tyre) / 40, damper / 40, -damper / 40],
    ]
    return DelaySystem(A, [[0.0], [0.0], [1 / 320], [-1 / 40]], [[0.0, 0.0, 2e3, 0.0]])


def random_system(seed: int) -> tuple[DelaySystem, np.random.Generator]:
    """One to six states, one to three channels; two thirds of them shifted to the left."""
    rng = np.random.default_rng(seed)
    n, m = int(rng.integers(1, 7)), int(rng.integers(1, 4))
    A = rng.normal(size=(n, n)) - 1.2 * np.eye(n) * (seed % 3 > 0)
    return DelaySystem(A, rng.normal(size=(n, m)), rng.normal(size=(m, n))), rng


SMALL = {"integrator": delayed_integrator, "oscillator": oscillator, "quarter car": quarter_car}


def roots_and_edge(system: DelaySystem, delay: object, count: int) -> tuple[np.ndarray, float]:
    """Our rightmost roots, and a real part halfway to the next one: the peer gives all beyond."""
    roots = np.array([mode.root for mode in rightmost_roots(system, delay, count + 1)])
    return roots[:count], float(roots[count - 1 : count + 1].real.mean())


def assert_same_roots(ours: np.ndarray, theirs: np.ndarray, rtol: float) -> None:
    """As many roots, one for one: none is missing on either side. Ours have one per pair."""
    upper = theirs[theirs.imag > -1e-9 * np.abs(theirs)]
    assert len(upper) == len(ours)
    distance = np.abs(ours[:, None] - upper[None, :]) / np.abs(ours)[:, None]
    assert distance[linear_sum_assignment(distance)].max() < rtol


def tdcpy_roots(
    system: DelaySystem, delay: object, right_of: float, nodes: int | None = None
) -> np.ndarray:
    tdcpy = peer("tdcpy")
    delays = system.delays(delay)
    matrices, times = [system.A], [0.0]
    for tau in np.unique(delays):
        now = delays == tau
        matrices.append(-system.B[:, now] @ system.K[now])
        times.append(tau)
    equation = tdcpy.RDDE(np.stack(matrices, axis=2), np.array(times))
    return tdcpy.roots(equation, r=right_of, discretization=nodes)[0]


def quasipolynomial(system: DelaySystem) -> np.ndarray:
    """Rows p_k of det(sI - A + B K z) = sum_k p_k(s) z^k, falling powers of s, z = exp(-s tau)."""
    rank = np.linalg.matrix_rank(system.B @ system.K)
    unit = np.exp(2j * np.pi * np.arange(rank + 1) / (rank + 1))
    values = np.array([np.poly(system.A - z * (system.B @ system.K)) for z in unit])
    return np.real(np.fft.fft(values, axis=0) / (rank + 1))


def qpmr_roots(system: DelaySystem, delay: float, right_of: float, ours: np.ndarray) -> np.ndarray:
    qpmr = peer("qpmr")
    rows = quasipolynomial(system)
    top = 1.5 * float(np.abs(ours.imag).max()) + 1.0
    region = (right_of, max(float(ours.real.max()), 0.0) + 1.0, -1e-3 * top, top)
    with warnings.catch_warnings():
        # It hands complex heights with no imaginary part to contourpy.
        warnings.simplefilter("ignore", np.exceptions.ComplexWarning)
        rising = np.ascontiguousarray(rows[:, ::-1])
        return qpmr.qpmr(rising, delay * np.arange(len(rows)), region=region)[0]


def yaltapy_answer(system: DelaySystem, max_delay: float) -> dict:
    yaltapy = peer("yaltapy")
    rows = quasipolynomial(system)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        return yaltapy.thread_stability_windows(
            rows, np.arange(1, len(rows)), 1.0, max_delay, plot=0
        )


def slower(system: DelaySystem, times: float) -> DelaySystem:
    """The same loop with a longer unit of time, for peers that need moderate coefficients."""
    scaled = system.scaled
    return DelaySystem(scaled.A * times, scaled.B * times, scaled.K)


@pytest.mark.parametrize("name", ["oscillator", "quarter car"])
@pytest.mark.parametrize("delay", [0.02, 0.2, 0.7])
def test_tdcpy_has_the_same_roots_of_small_loops(name: str, delay: float) -> None:
    system = SMALL[name]()
    ours, edge = roots_and_edge(system, delay, 5)
    # its Newton iteration leaves some 1e-10
    assert_same_roots(ours, tdcpy_roots(system, delay, edge), 1e-9)


@pytest.mark.parametrize("seed", range(24))
def test_tdcpy_has_the_same_roots_of_random_loops(seed: int) -> None:
    system, rng = random_system(seed)
    m = system.num_channels
    # every other loop has a delay of its own per channel
    delay = rng.uniform(0.05, 1.5, m).tolist() if seed % 2 else float(rng.uniform(0.05, 1.5))
    ours, edge = roots_and_edge(system, delay, 5)
    # given 24 nodes: its own choice for three distinct delays takes a second
    assert_same_roots(ours, tdcpy_roots(system, delay, edge, 24), 1e-9)


@pytest.mark.parametrize("delay", [0.1, 0.2])
def test_tdcpy_has_the_same_roots_of_the_vehicle(loop: DelaySystem, delay: float) -> None:
    ours, edge = roots_and_edge(loop, delay, 4)
    # it does not balance 38 states in newtons, metres and radians: some 4e-10
    assert_same_roots(ours, tdcpy_roots(loop, delay, edge), 5e-9)


@pytest.mark.slow
@pytest.mark.parametrize("delay", [[0.05, 0.05, 0.15, 0.15], [0.2, 0.1, 0.2, 0.1]])
def test_tdcpy_has_the_same_roots_of_the_vehicle_with_two_delays(
    loop: DelaySystem, delay: list[float]
) -> None:
    ours, edge = roots_and_edge(loop, delay, 4)
    assert_same_roots(ours, tdcpy_roots(loop, delay, edge, 14), 5e-9)


def test_tdcpy_takes_a_loop_without_undelayed_part_for_one_without_delay() -> None:
    # The peer's defect: with A_0 = 0 it solves x' = -x(t). s + exp(-s) = 0 tells who is right, and
    # so does the peer itself as soon as A_0 is not quite zero.
    ours = rightmost_roots(delayed_integrator(), 1.0, 1)[0].root
    assert abs(ours + np.exp(-ours)) < 1e-15
    assert tdcpy_roots(delayed_integrator(), 1.0, -2.0) == pytest.approx([-1.0])
    nearly = DelaySystem([[-1e-6]], [[1.0]], [[1.0]])
    roots, edge = roots_and_edge(nearly, 1.0, 4)
    assert_same_roots(roots, tdcpy_roots(nearly, 1.0, edge), 1e-9)


@pytest.mark.parametrize("name", SMALL)
@pytest.mark.parametrize("delay", [0.2, 0.7])
def test_qpmr_has_the_same_roots_of_small_loops(name: str, delay: float) -> None:
    system = SMALL[name]()
    ours, edge = roots_and_edge(system, delay, 5)
    # both at rounding of the polynomial's coefficients
    assert_same_roots(ours, qpmr_roots(system, delay, edge, ours), 1e-11)


@pytest.mark.parametrize("seed", [k for k in range(24) if k != 2])
@pytest.mark.slow
def test_qpmr_has_the_same_roots_of_random_loops(seed: int) -> None:
    system, rng = random_system(seed)
    delay = float(rng.uniform(0.05, 1.5))
    ours, edge = roots_and_edge(system, delay, 5)
    assert_same_roots(ours, qpmr_roots(system, delay, edge, ours), 1e-11)


@pytest.mark.parametrize("delay", [0.1, pytest.param(0.2, marks=pytest.mark.slow)])
def test_qpmr_has_the_same_roots_of_the_vehicle(loop: DelaySystem, delay: float) -> None:
    # coefficients of degree 38, in a unit of 0.1 s so that their powers stay within 1e40
    system = slower(loop, 0.1)
    ours, edge = roots_and_edge(system, 10 * delay, 4)
    assert_same_roots(ours, qpmr_roots(system, 10 * delay, edge, ours), 1e-9)


def test_qpmr_may_count_one_root_thrice_in_place_of_its_neighbours() -> None:
    # The peer's defect: its count of roots in the region is right, but it lists -1.1339 three times
    # and leaves out the pair -1.1408 +- 1.2713j beside it.
    system, rng = random_system(2)
    delay = float(rng.uniform(0.05, 1.5))
    ours, edge = roots_and_edge(system, delay, 5)
    theirs = qpmr_roots(system, delay, edge, ours)
    missed = ours[np.abs(ours[:, None] - theirs[None, :]).min(axis=1) > 1e-3]
    assert missed == pytest.approx([-1.140839362779502 + 1.27130452899j], rel=1e-10)
    assert np.sum(np.abs(theirs - ours[1]) < 1e-9) == 3
    M = system.characteristic_matrix(complex(missed[0]), system.delays(delay))
    assert np.linalg.svd(M)[1][-1] < 1e-14
    assert_same_roots(ours, tdcpy_roots(system, delay, edge), 1e-9)


def assert_same_staircase(system: DelaySystem, max_delay: float, rtol: float) -> None:
    ours, theirs = critical_delays(system, max_delay), yaltapy_answer(system, max_delay)
    expected = sorted(
        (float(first + k * period), float(omega), int(direction))
        for first, period, omega, direction in theirs["CrossingTable"]
        for k in range(1 + int(max(0.0, max_delay - first) / period))
        if 0.0 < first + k * period <= max_delay
    )
    found = [(c.delay, c.mode.root.imag, c.direction) for c in ours.crossings]
    assert [d for *_, d in found] == [d for *_, d in expected]
    assert [t for t, *_ in found] == pytest.approx([t for t, *_ in expected], rel=rtol)
    assert [w for _, w, _ in found] == pytest.approx([w for _, w, _ in expected], rel=rtol)
    delays, flags = theirs["StabilityWindows"]
    windows = [span for span, stable in zip(pairwise(delays), flags, strict=False) if stable]
    assert np.ravel(ours.stable_windows) == pytest.approx(np.ravel(windows), rel=rtol)
    delays, numbers = theirs["NbUnstablePoles"]
    for (low, high), number in zip(pairwise(delays), numbers, strict=False):
        assert ours.unstable_roots(float(low + high) / 2) == number


@pytest.mark.parametrize("name", SMALL)
def test_yaltapy_has_the_same_crossings_and_windows_of_small_loops(name: str) -> None:
    assert_same_staircase(SMALL[name](), 3.0, 1e-12)


@pytest.mark.parametrize("seed", range(12))
@pytest.mark.slow
def test_yaltapy_has_the_same_crossings_and_windows_of_random_loops(seed: int) -> None:
    # brentq stops at 1e-15 in the phase; small angles and flat crossings cost digits
    assert_same_staircase(random_system(seed)[0], 4.0, 1e-10)


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(12, 120))
def test_yaltapy_agrees_on_many_more_random_loops(seed: int) -> None:
    assert_same_staircase(random_system(seed)[0], 4.0, 1e-9)


@pytest.mark.slow
def test_yaltapy_has_the_same_crossings_and_windows_of_the_vehicle(loop: DelaySystem) -> None:
    # 1e-10 was asked for; 5e-13 is reached from coefficients of degree 38
    assert_same_staircase(slower(loop, 0.1), 20.0, 1e-10)


@pytest.mark.parametrize("order", range(1, 11))
@pytest.mark.parametrize("delay", [0.002, 0.2, 1.0])
def test_the_ladder_has_python_controls_pade_polynomials(order: int, delay: float) -> None:
    control = peer("control")
    numerator, denominator = control.pade(delay, order)
    A, B, C, D = pade_block(order, delay)
    # det(s I - A) of a tridiagonal matrix, from the last state up
    minors = [np.array([0.0]), np.array([1.0])]
    for k in reversed(range(order)):
        link = -A[k, k + 1] * A[k + 1, k] if k + 1 < order else 0.0
        minors.append(np.polyadd(np.polymul([1.0, -A[k, k]], minors[-1]), link * minors[-2]))
    lower, determinant = minors[-2:]
    # C (s I - A)^-1 B = C_1 B_1 lower / determinant, since B and C see the first state only
    assert not np.any(B[1:])
    through = np.polyadd(D * determinant, C[0] * B[0] * lower)
    # some ten roundings, no cancellation: neighbouring powers have different parity
    np.testing.assert_allclose(determinant, denominator, rtol=2e-14)
    np.testing.assert_allclose(through, numerator, rtol=2e-14)


@pytest.mark.parametrize("order", [1, 2, 4, 6])
def test_the_pade_loop_has_the_poles_of_python_controls_feedback(order: int) -> None:
    control = peer("control")
    plant = control.tf([4.0, 0.0], [1.0, 0.6, (2 * np.pi * 1.2) ** 2])
    closed = control.feedback(plant * control.tf(*control.pade(0.2, order)))
    ours = np.array([mode.root for mode in pade_roots(oscillator(), 0.2, order, 2 + order)])
    # roots of a polynomial with coefficients up to 1e10
    assert_same_roots(ours, closed.poles(), 1e-9)
