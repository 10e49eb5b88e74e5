"""Families of loops: proofs about every member, and the re-check that catches planted faults."""

import copy
import json
import math
from typing import Any

import numpy as np
import pytest
from flint import arb, arb_mat, fmpq

from baselines import make_controller
from railenv.errors import ArgumentError, NeutralLoopError
from railenv.stability import DelaySystem, count_unstable
from railenv.stability.proof.counting import Effort
from railenv.stability.proof.uncertain import prove_uncertain
from railenv.stability.proof.uncertain_boxes import guess, modal_bases, proves
from railenv.stability.proof.uncertain_frames import Balls, Floats, Frame, Part, Scaled
from railenv.stability.uncertain import UncertainDelaySystem
from railenv.stability.verifier.contour import check_delay_box
from railenv.stability.verifier.quasipolynomial import RejectedError
from railenv.stability.verifier.uncertain import check_uncertain
from railenv.stability.verifier.uncertain_family import Family
from railenv.vehicle import LateralVehicle
from railenv.vehicle.catalogue import paper_fit

COMMON = [[0, 1, 2, 3]]


def scalar(gain: float) -> DelaySystem:
    """x' = -gain x(t - tau): stable if and only if gain tau < pi / 2."""
    return DelaySystem([[0.0]], [[1.0]], [[gain]])


def oscillator(stiffness: float, damping: float, gain: float) -> DelaySystem:
    """x'' + c x' + k x = -g x'(t - tau)."""
    return DelaySystem([[0.0, 1.0], [-stiffness, -damping]], [[0.0], [1.0]], [[0.0, gain]])


def loop_at(speed_kmh: float, conicity: float = 1.0, mass: float = 1.0) -> DelaySystem:
    """The paper's loop at a speed, with conicity and carbody mass as shares of the nominal."""
    p = paper_fit().parameters
    p = p.replace(conicity=p.conicity * conicity, carbody_mass=p.carbody_mass * mass)
    vehicle = LateralVehicle(p, "4", speed_kmh / 3.6)
    return make_controller("skyhook:gain=35e3", 4).to_delay_system(vehicle)


def asked(share: float = 1.0) -> UncertainDelaySystem:
    """Speed 295 to 305 km/h, conicity +-5 %, carbody mass +-2 %, times `share`."""
    speed, conicity, mass = 5.0 * share, 0.05 * share, 0.02 * share
    ranges = [(300 - speed, 300 + speed), (1 - conicity, 1 + conicity), (1 - mass, 1 + mass)]
    # Rows of the carbody have 1/m, those of wheelsets the axle load: convex or concave in m, all.
    return UncertainDelaySystem.between(loop_at, ranges, curved=2).inflate(1e-12)


def count_reasons(certificate: dict[str, Any]) -> list[str]:
    try:
        check_delay_box(certificate)
    except RejectedError as reason:
        return [str(reason)]
    return []


def proved(
    family: UncertainDelaySystem,
    low: list[float],
    high: list[float],
    groups: list[list[int]],
    rate: float = 0.0,
) -> tuple[str, dict[str, Any], dict[str, Any]]:
    """Return the verdict, the claim and the evidence as a file would bring it; check it if any."""
    verdict, roots, reason, evidence = prove_uncertain(family, low, high, groups, rate)
    evidence = json.loads(json.dumps(evidence, allow_nan=False))
    claim = {
        "verdict": verdict,
        "unstable_roots": roots,
        "groups": groups,
        "low": low,
        "high": high,
        "decay_rate": rate,
    }
    if verdict == "UNDECIDED":
        assert reason
    else:
        assert check_uncertain(family.to_plain(), claim, evidence, count_reasons) == []
    return verdict, claim, evidence


def random_member(family: UncertainDelaySystem, rng: np.random.Generator) -> DelaySystem:
    system = family.member(rng.uniform(-1, 1, family.num_parameters).tolist())
    return DelaySystem(
        *(
            getattr(system, name)
            + getattr(family, f"{name}_radius") * rng.uniform(-1, 1, getattr(system, name).shape)
            for name in "ABK"
        )
    )


# Values.


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"A_radius": [[1.0, 2.0]]}, r"A_radius has shape \(1, 2\); it must be \(1, 1\)"),
        ({"K_radius": [[-1.0]]}, "must not be negative"),
        ({"B_radius": [[math.inf]]}, "not finite"),
        ({"directions": (([[1.0]], [[1.0]]),)}, r"directions\[0\] has 2 matrices"),
        ({"directions": (([[1.0]], [[1.0]], [[1.0, 2.0]]),)}, r"directions\[0\] for K has shape"),
    ],
)
def test_a_bad_family_is_refused_by_name(change: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        UncertainDelaySystem(scalar(1.0), **change)


def test_a_neutral_loop_has_no_family() -> None:
    with pytest.raises(NeutralLoopError, match="uncertain"):
        UncertainDelaySystem(DelaySystem([[0.0]], [[1.0]], [[1.0]], [[0.5]]))


@pytest.mark.parametrize(
    ("ranges", "curved", "message"),
    [
        ([(2.0, 1.0)], None, "reversed"),
        ([3.0], None, "no range"),
        ([(1.0, 2.0)], 1, "no position"),
        ([(1.0, 2.0)] * 9, None, "at most 8"),
    ],
)
def test_bad_ranges_are_refused(ranges: list[Any], curved: int | None, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        UncertainDelaySystem.between(scalar, ranges, curved)


def test_the_hull_holds_what_it_was_made_of_exactly() -> None:
    rng = np.random.default_rng(5)
    loops = [
        DelaySystem(*(rng.standard_normal(shape) for shape in ((3, 3), (3, 2), (2, 3))))
        for _ in range(4)
    ]
    family = UncertainDelaySystem.hull(loops)
    for loop in loops:
        for name in "ABK":
            for x, middle, radius in zip(
                getattr(loop, name).ravel(),
                getattr(family.nominal, name).ravel(),
                getattr(family, f"{name}_radius").ravel(),
                strict=True,
            ):
                away = abs(fmpq(*x.as_integer_ratio()) - fmpq(*middle.as_integer_ratio()))
                assert away <= fmpq(*radius.as_integer_ratio())


def test_the_hull_of_one_loop_has_no_width() -> None:
    family = UncertainDelaySystem.hull([scalar(0.1)])
    assert family.K_radius.max() == 0.0
    assert family.nominal.K[0, 0] == 0.1


def test_balls_are_covered_outwards() -> None:
    third = arb(fmpq(1, 3))
    family = UncertainDelaySystem.from_balls(
        arb_mat([[third]]), arb_mat([[1]]), arb_mat([[arb(2, 0.25)]])
    )
    middle, radius = family.nominal.A[0, 0], family.A_radius[0, 0]
    assert abs(fmpq(1, 3) - fmpq(*middle.as_integer_ratio())) <= fmpq(*radius.as_integer_ratio())
    assert family.K_radius[0, 0] >= 0.25
    with pytest.raises(ArgumentError, match="A is no matrix of finite real balls"):
        UncertainDelaySystem.from_balls([[1.0]], arb_mat([[1]]), arb_mat([[1]]))


def test_a_curved_parameter_is_covered_where_entries_bend_both_ways() -> None:
    def bent(m: float, k: float) -> DelaySystem:
        A = [[k / m, -k * m**2], [m, 1.0]]
        return DelaySystem(A, [[1 / m], [0.0]], [[0.0, math.sqrt(m)]])

    family = UncertainDelaySystem.between(bent, [(1.0, 2.0), (3.0, 4.0)], curved=0)
    for m in np.linspace(1.0, 2.0, 21):
        for k in (3.0, 3.3, 4.0):
            member = family.member([2 * (m - 1.5), 2 * (k - 3.5)])
            loop = bent(m, k)
            for name in "ABK":
                away = np.abs(getattr(loop, name) - getattr(member, name))
                # 1e-14: rounding of the two doubles compared here, entries up to 16
                assert np.all(away <= getattr(family, f"{name}_radius") + 1e-14)


def test_entries_as_parameters_are_the_same_family() -> None:
    family = UncertainDelaySystem(oscillator(4.0, 0.2, 0.3), A_radius=[[0, 0], [0.5, 0.1]])
    tied = family.with_entries_as_parameters()
    assert tied.num_parameters == 2
    assert tied.A_radius.max() == 0.0
    corner = family.nominal.A + np.array([[0.0, 0.0], [0.5, -0.1]])
    np.testing.assert_array_equal(tied.member([1.0, -1.0]).A, corner)


# Closed forms.


@pytest.mark.parametrize("share", [0.5, 0.9, 0.99, 0.9999])
def test_the_scalar_family_is_proved_up_to_a_quarter_turn(share: float) -> None:
    # gain tau < pi / 2 for all gains up to 2 at all delays up to share * pi / 4
    family = UncertainDelaySystem.between(scalar, [(1.0, 2.0)])
    assert proved(family, [0.0], [share * math.pi / 4], [[0]])[0] == "STABLE"


def test_beyond_a_quarter_turn_a_member_is_proved_unstable() -> None:
    family = UncertainDelaySystem.between(scalar, [(1.0, 2.0)])
    verdict, claim, evidence = proved(family, [0.0], [1.001 * math.pi / 4], [[0]])
    assert verdict == "UNSTABLE"
    assert claim["unstable_roots"] == 2
    assert evidence["member"]["K"] == [[2.0]]


def test_a_radius_that_reaches_instability_is_proved_unstable_at_its_worst_entries() -> None:
    family = UncertainDelaySystem(scalar(1.5), K_radius=[[0.5]])
    assert proved(family, [0.8], [0.8], [[0]])[0] == "UNSTABLE"


def test_a_radius_is_undecided_where_its_phase_would_matter_and_a_parameter_is_not() -> None:
    # Gains up to 1.57 at tau = 1: 1.5700 < 1.5708. The radius counts in every phase, 1.285 + 0.285
    # at the wrong one reaches the axis.
    family = UncertainDelaySystem(scalar(1.285), K_radius=[[0.285]])
    assert proved(family, [1.0], [1.0], [[0]])[0] == "UNDECIDED"
    assert proved(family.with_entries_as_parameters(), [1.0], [1.0], [[0]])[0] == "STABLE"


def test_velocity_feedback_weaker_than_damping_is_stable_for_every_delay() -> None:
    # |g| < c: stable whatever the delay (closed form of the 1-DOF oscillator)
    family = UncertainDelaySystem.between(oscillator, [(48.0, 52.0), (0.45, 0.5), (0.1, 0.3)])
    assert proved(family, [0.0], [50.0], [[0]])[0] == "STABLE"


def test_the_oscillator_family_turns_at_its_worst_members_critical_delay() -> None:
    # cos(omega tau) = -c/g with omega = (sqrt(g^2 - c^2) + sqrt(g^2 - c^2 + 4 k)) / 2: the critical
    # delay falls with k and g and rises with c, so that one corner decides.
    k, c, g = 60.0, 0.1, 0.3
    root = math.sqrt(g**2 - c**2)
    critical = math.acos(-c / g) / ((root + math.sqrt(root**2 + 4 * k)) / 2)
    family = UncertainDelaySystem.between(oscillator, [(55.0, k), (c, 0.12), (0.28, g)])
    assert proved(family, [0.0], [0.999 * critical], [[0]])[0] == "STABLE"
    assert proved(family.inflate(1e-14), [0.0], [1.001 * critical], [[0]])[0] == "UNSTABLE"


def test_a_decay_rate_moves_the_line() -> None:
    # x' = -a x(t - tau) has all roots left of -r if a e^(r tau) tau is below the turn of W: at
    # tau = 0 the root is -a itself.
    family = UncertainDelaySystem.between(scalar, [(1.0, 1.5)])
    assert proved(family, [0.0], [0.1], [[0]], 0.9)[0] == "STABLE"
    assert proved(family, [0.0], [0.1], [[0]], 1.05)[0] == "UNSTABLE"
    assert proved(family, [2.0], [2.1], [[0]], -1.0)[0] == "STABLE"


def test_a_defective_plant_is_proved_by_schur_vectors() -> None:
    def loop(gain: float) -> DelaySystem:
        return DelaySystem([[0.0, 1.0], [0.0, 0.0]], [[0.0], [1.0]], [[1.0, gain]])

    family = UncertainDelaySystem.between(loop, [(1.0, 1.2)])
    # The double integrator under PD (1, 1) stands 0.711 s.
    assert proved(family, [0.0], [0.6], [[0]])[0] == "STABLE"


def test_independent_delays_are_held_apart() -> None:
    loop = DelaySystem(np.zeros((2, 2)), np.eye(2), np.diag([1.0, 2.0]))
    family = UncertainDelaySystem.hull([loop])
    assert proved(family, [0.0, 0.0], [1.5, 0.7], [[0], [1]])[0] == "STABLE"
    assert proved(family, [0.0, 0.0], [1.5, 0.9], [[0], [1]])[0] == "UNSTABLE"


def test_a_loop_without_channels_is_a_family_too() -> None:
    plant = DelaySystem([[-1.0, 2.0], [0.0, -1.0]], np.zeros((2, 0)), np.zeros((0, 2)))
    assert proved(UncertainDelaySystem(plant).inflate(0.01), [0.0], [0.0], [[]])[0] == "STABLE"


def test_the_effort_is_counted_in_tests_not_in_seconds() -> None:
    family = UncertainDelaySystem.between(scalar, [(1.0, 2.0)])
    verdict, _, reason, evidence = prove_uncertain(family, [0.0], [0.78], [[0]], effort=Effort(9))
    assert (verdict, evidence) == ("UNDECIDED", {})
    assert "more than 9 tests" in reason


@pytest.mark.parametrize(
    ("low", "high", "groups", "message"),
    [
        ([0.0], [0.1], [[0, 0]], "every channel"),
        ([0.0], [0.1], [[]], "every channel"),
        ([0.2], [0.1], [[0]], "low"),
        ([-0.2], [0.1], [[0]], "low"),
        ([0.0, 0.0], [0.1], [[0]], "one delay per group"),
    ],
)
def test_a_bad_question_is_refused(
    low: list[float], high: list[float], groups: list[list[int]], message: str
) -> None:
    with pytest.raises(ArgumentError, match=message):
        prove_uncertain(UncertainDelaySystem(scalar(1.0)), low, high, groups)


# Never contradicted.


def random_family(
    rng: np.random.Generator,
) -> tuple[UncertainDelaySystem, list[float], list[float]]:
    n, m = int(rng.integers(1, 6)), int(rng.integers(1, 3))
    shapes = ((n, n), (n, m), (m, n))
    A, B, K = (rng.standard_normal(shape) for shape in shapes)
    A = A - (rng.uniform(-0.2, 1.0) + np.linalg.eigvals(A).real.max()) * np.eye(n)
    width = 10.0 ** rng.uniform(-3, -0.5)
    radii = [rng.uniform(0, 0.1 * width, shape) for shape in shapes]
    directions = tuple(
        tuple(width * rng.standard_normal(shape) for shape in shapes)
        for _ in range(int(rng.integers(0, 3)))
    )
    loop = DelaySystem(A, B, 0.5 * rng.uniform(0.2, 1.0) * K)
    low = rng.uniform(0.0, 1.0, m)
    high = low + rng.uniform(0.0, 0.5, m)
    return UncertainDelaySystem(loop, *radii, directions), low.tolist(), high.tolist()


def check_random(first: int, number: int) -> list[str]:
    verdicts: list[str] = []
    for seed in range(first, first + number):
        rng = np.random.default_rng(seed)
        family, low, high = random_family(rng)
        groups = [[k] for k in range(len(low))]
        verdict, roots, _, _ = prove_uncertain(family, low, high, groups, effort=Effort(400))
        verdicts.append(verdict)
        if verdict == "UNSTABLE":
            assert roots is not None
            assert roots > 0
        if verdict == "STABLE":
            for _ in range(6):
                delays = rng.uniform(low, high).tolist()
                assert count_unstable(random_member(family, rng), delays) == 0, seed
    return verdicts


@pytest.mark.slow
def test_no_sampled_member_contradicts_a_proof() -> None:
    verdicts = check_random(0, 15)
    assert {"STABLE", "UNSTABLE"} <= set(verdicts)


@pytest.mark.slow
def test_no_sampled_member_of_many_families_contradicts_a_proof() -> None:
    verdicts = check_random(1000, 120)
    # Most of these families are far from the edge; a test that proves nothing would be no test.
    assert verdicts.count("UNDECIDED") < 30


def test_balls_never_prove_a_part_that_floats_deny() -> None:
    rng = np.random.default_rng(3)
    proofs = 0
    for seed in range(40):
        family, low, high = random_family(np.random.default_rng(seed))
        groups = [[k] for k in range(len(low))]
        omega = rng.uniform(0.0, 3.0)
        parameters = family.num_parameters
        part = Part((omega, *low, *[-1.0] * parameters), (omega + 0.3, *high, *[1.0] * parameters))
        floats, balls = (Scaled(kind, family, groups, 0.1) for kind in (Floats(), Balls()))
        plain = Frame(floats, np.eye(family.nominal.num_states, dtype=complex))
        for free in (True, False):
            for basis in modal_bases(plain, part, free=free):
                told = guess(Frame(floats, basis).terms(part, free=free))
                holds = proves(Frame(balls, basis), part, told, free=free)
                # The same formulas in two arithmetics.
                assert holds <= told.holds
                proofs += holds
    assert proofs > 10


def offsets_of_a_member(
    family: UncertainDelaySystem, part: Part, groups: int, rng: np.random.Generator
) -> tuple[DelaySystem, float, list[float], np.ndarray]:
    """Return a member's loop, frequency and delays, and where it is within the part: -1 to 1.

    Half of the time at a corner with all radii used up, where bounds are tightest.
    """
    low, high = np.array(part.low), np.array(part.high)
    corner = rng.random() < 0.5
    x = rng.choice([-1.0, 1.0], len(low)) if corner else rng.uniform(-1.0, 1.0, len(low))
    point = (low + high) / 2 + x * (high - low) / 2
    system = family.member(np.clip(point[1 + groups :], -1.0, 1.0).tolist())
    signs = ((rng.choice([-1.0, 1.0], size=getattr(system, n).shape), n) for n in "ABK")
    moved = [getattr(system, n) + s * getattr(family, f"{n}_radius") for s, n in signs]
    return DelaySystem(*moved), float(point[0]), point[1 : 1 + groups].tolist(), x


def seen_error(
    terms: tuple[Any, Any, Any],
    W: np.ndarray,
    V: np.ndarray,
    member: tuple[DelaySystem, float, list[float], np.ndarray],
    rate: float,
    free: bool,
) -> np.ndarray:
    """Return by how much a member's W M V leaves what the terms allow, entry by entry."""
    centre, lines, rest = terms
    system, omega, delays, x = member
    M = system.characteristic_matrix(complex(-rate, omega), np.array(delays))
    # Lines: delays (unless exponentials are free), frequency, parameters.
    groups = len(delays)
    order = [x[0], *x[1 + groups :]] if free else [*x[1 : 1 + groups], x[0], *x[1 + groups :]]
    off = W @ M @ V - centre - sum(k * line for k, line in zip(order, lines, strict=True))
    return np.abs(off) - rest


def a_part(
    family: UncertainDelaySystem, low: list[float], high: list[float], rng: np.random.Generator
) -> Part:
    omega, wide = rng.uniform(0.0, 3.0), 10.0 ** rng.uniform(-2, 0)
    p = family.num_parameters
    return Part((omega, *low, *[-1.0] * p), (omega + wide, *high, *[0.5] * p))


@pytest.mark.parametrize("free", [True, False])
def test_the_terms_of_a_part_enclose_every_sampled_member(free: bool) -> None:
    tightest = -np.inf
    for seed in range(60):
        rng = np.random.default_rng(seed)
        family, low, high = random_family(rng)
        groups, rate = [[k] for k in range(len(low))], rng.uniform(-0.5, 0.5)
        part = a_part(family, low, high, rng)
        floats = Scaled(Floats(), family, groups, rate)
        n, d = family.nominal.num_states, family.nominal.state_scale
        V = rng.standard_normal((n, n)) + 1j * rng.standard_normal((n, n))
        terms = Frame(floats, V).terms(part, free=free)
        W = np.linalg.inv(V)
        for _ in range(20):
            member = offsets_of_a_member(family, part, len(low), rng)
            error = seen_error(terms, W / d, d[:, None] * V, member, rate, free)
            # Rounding of these sums and products, sizes up to some hundred, inverses to 1e3
            assert np.all(error <= 1e-10 * np.abs(W).max())
            tightest = max(tightest, float((error / terms[2]).max()))
    # Zero would be a bound that is reached; far below it, the test would tell nothing.
    assert tightest > -0.6


@pytest.mark.parametrize("free", [True, False])
def test_the_verifiers_terms_enclose_every_sampled_member(
    free: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    caught: list[tuple[Any, Any, Any]] = []

    def comparison(self: Family, at: Any, moves: Any, slack: Any) -> Any:
        del self
        caught.append((at, moves, slack))
        return arb_mat([[1]])

    monkeypatch.setattr(Family, "comparison", comparison)
    for seed in range(30):
        rng = np.random.default_rng(seed)
        family, low, high = random_family(rng)
        groups, rate = [[k] for k in range(len(low))], rng.uniform(-0.5, 0.5)
        part = a_part(family, low, high, rng)
        n = family.nominal.num_states
        whole = rng.integers(-64, 64, (n, 2 * n))
        V = (whole[:, ::2] + 1j * whole[:, 1::2]) / 64.0
        if abs(np.linalg.det(V)) < 0.01:
            continue
        claim = {"groups": groups, "low": low, "high": high, "decay_rate": rate}
        evidence = {"scale": [0] * n, "bases": [whole.tolist()], "basis_bits": 6}
        seen = Family(family.to_plain(), claim, evidence)
        assert seen.is_regular(list(zip(part.low, part.high, strict=True)), 0, free)
        at, moves, slack = caught.pop()
        terms = (numbers(at), [numbers(move) for move in moves], numbers(slack).real)
        W = np.linalg.inv(V)
        for _ in range(20):
            member = offsets_of_a_member(family, part, len(low), rng)
            error = seen_error(terms, W, V, member, rate, free)
            assert np.all(error <= 1e-10 * np.abs(W).max())


def numbers(matrix: Any) -> np.ndarray:
    """Return the middles of a ball matrix."""
    values = np.array([complex(v) for v in matrix.entries()])
    return values.reshape(matrix.nrows(), matrix.ncols())


def test_a_comparison_matrix_bounds_the_diagonal_below_and_the_rest_above() -> None:
    rng = np.random.default_rng(11)
    n = 3
    for _ in range(50):
        at, *lines = rng.standard_normal((4, n, n)) + 1j * rng.standard_normal((4, n, n))
        lines, slack = [0.2 * line for line in lines], 0.1 * rng.random((n, n))
        balls = Balls()
        of_verifier = numbers(
            Family.comparison(
                type("Sized", (), {"n": n})(),  # type: ignore[arg-type]
                balls.complex_matrix(at),
                [balls.complex_matrix(line) for line in lines],
                balls.real_matrix(slack),
            )
        ).real
        for _ in range(20):
            N = at + sum(rng.uniform(-1, 1) * line for line in lines)
            N = N + slack * np.exp(2j * np.pi * rng.random((n, n)))
            on = np.diag(of_verifier)
            assert np.all(on <= np.abs(np.diag(N)) + 1e-12)
            rest = -(of_verifier - np.diag(on))
            assert np.all(rest + 1e-12 >= np.abs(N - np.diag(np.diag(N))))


# The vehicle.


@pytest.mark.slow
def test_the_vehicle_of_the_question_is_proved_at_100_ms() -> None:
    assert proved(asked(), [0.1], [0.1], COMMON)[0] == "STABLE"


@pytest.mark.slow
def test_the_vehicle_of_the_question_is_proved_for_all_delays_to_150_ms() -> None:
    assert proved(asked(), [0.0], [0.15], COMMON)[0] == "STABLE"


@pytest.mark.slow
def test_a_family_five_times_as_wide_is_proved_for_all_delays_to_150_ms() -> None:
    assert proved(asked(5.0), [0.0], [0.15], COMMON)[0] == "STABLE"


@pytest.mark.slow
def test_a_speed_range_beyond_the_hunting_speed_is_proved_unstable() -> None:
    family = UncertainDelaySystem.between(loop_at, [(250.0, 400.0)]).inflate(1e-12)
    assert proved(family, [0.0], [0.15], COMMON)[0] == "UNSTABLE"


@pytest.mark.slow
def test_the_family_of_the_question_stands_independent_delays() -> None:
    groups = [[0], [1], [2], [3]]
    assert proved(asked(), [0.0] * 4, [0.1] * 4, groups)[0] == "STABLE"


@pytest.mark.slow
def test_the_hull_of_the_corners_is_narrower_than_their_parameters() -> None:
    corners = [loop_at(v) for v in (295.0, 305.0)]
    assert proved(UncertainDelaySystem.hull(corners), [0.0], [0.15], COMMON)[0] == "STABLE"
    wide = [loop_at(v, c) for v in (295.0, 305.0) for c in (0.95, 1.05)]
    assert proved(UncertainDelaySystem.hull(wide), [0.0], [0.15], COMMON)[0] == "UNDECIDED"


# Planted faults.


@pytest.fixture(scope="module")
def sound() -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    family = UncertainDelaySystem.between(oscillator, [(50.0, 60.0), (0.1, 0.14), (0.25, 0.3)])
    verdict, claim, evidence = proved(family, [0.0], [0.235], [[0]])
    assert verdict == "STABLE"
    return family.to_plain(), claim, evidence


FAULTS = {
    "wider radius": lambda s, c, e: s["A_radius"][1].__setitem__(1, 0.2),
    "wider parameter": lambda s, c, e: s["directions"][2]["K"][0].__setitem__(1, 0.2),
    "negative radius": lambda s, c, e: s["A_radius"][1].__setitem__(1, -0.01),
    "another plant": lambda s, c, e: s["A"][1].__setitem__(1, 0.4),
    "longer delays": lambda s, c, e: c["high"].__setitem__(0, 0.26),
    "reversed delays": lambda s, c, e: c["low"].__setitem__(0, 0.3),
    "another decay rate": lambda s, c, e: c.__setitem__("decay_rate", 0.2),
    "decay rate not a number": lambda s, c, e: c.__setitem__("decay_rate", math.nan),
    "another count": lambda s, c, e: c.__setitem__("unstable_roots", 2),
    "another verdict": lambda s, c, e: c.__setitem__("verdict", "UNSTABLE"),
    "channel twice": lambda s, c, e: c.__setitem__("groups", [[0, 0]]),
    "count elsewhere": lambda s, c, e: e["count"]["delays"].__setitem__(0, 0.5),
    "count at other delays": lambda s, c, e: e["count"]["delays"].__setitem__(0, 0.05),
    "count cut short": lambda s, c, e: e["count"]["evidence"]["pieces"][0].__delitem__(
        slice(2, None)
    ),
    "smaller radius": lambda s, c, e: e.__setitem__("radius", 1.0),
    "pieces missing": lambda s, c, e: e["pieces"].__delitem__(slice(1, -1)),
    "last piece missing": lambda s, c, e: e["pieces"].pop(),
    "pieces out of order": lambda s, c, e: e["pieces"].reverse(),
    "cut undone": lambda s, c, e: next(p for p in e["pieces"] if p["cuts"][0] >= 0).__setitem__(
        "cuts", [-1]
    ),
    "cuts end early": lambda s, c, e: e["pieces"][0]["cuts"].clear(),
    "cuts go on": lambda s, c, e: e["pieces"][0]["cuts"].append(-1),
    "no such axis": lambda s, c, e: e["pieces"][0]["cuts"].__setitem__(0, 9),
    "no such basis": lambda s, c, e: e["pieces"][-1]["cuts"].__setitem__(0, -4001),
    "cut without end": lambda s, c, e: e["pieces"][0].__setitem__("cuts", [1] * 3000),
    "singular basis": lambda s, c, e: e["bases"].__setitem__(0, [[1, 0, 1, 0], [1, 0, 1, 0]]),
    "useless basis": lambda s, c, e: e["bases"].__setitem__(
        0, [[2**24, 0, 0, 0], [0, 0, 2**24, 0]]
    ),
    "short basis": lambda s, c, e: e["bases"][0].pop(),
    "basis of text": lambda s, c, e: e["bases"][0][0].__setitem__(0, "1"),
    "scale of another size": lambda s, c, e: e["scale"].pop(),
    "low precision": lambda s, c, e: e.__setitem__("bits", 2),
    "no evidence": lambda s, c, e: e.clear(),
    "another method": lambda s, c, e: e.__setitem__("method", "trust me"),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_the_verifier_rejects_a_planted_fault(
    fault: str, sound: tuple[dict[str, Any], dict[str, Any], dict[str, Any]]
) -> None:
    system, claim, evidence = copy.deepcopy(sound)
    FAULTS[fault](system, claim, evidence)
    assert check_uncertain(system, claim, evidence, count_reasons)


def test_the_verifier_rejects_a_member_from_outside_the_family() -> None:
    family = UncertainDelaySystem.between(scalar, [(1.0, 2.0)])
    _, claim, evidence = proved(family, [0.9], [0.9], [[0]])
    system = family.to_plain()
    assert check_uncertain(system, claim, evidence, count_reasons) == []
    evidence["member"]["K"] = [[math.nextafter(2.0, 3.0)]]
    reasons = check_uncertain(system, claim, evidence, count_reasons)
    assert "outside the family" in reasons[0]
    evidence["member"]["parameters"] = [1.5]
    assert "out of its range" in check_uncertain(system, claim, evidence, count_reasons)[0]


def test_the_verifier_hands_on_what_is_wrong_with_the_count(
    sound: tuple[dict[str, Any], dict[str, Any], dict[str, Any]],
) -> None:
    reasons = check_uncertain(*sound, lambda certificate: ["miscounted"])
    assert reasons == ["the count: miscounted"]


@pytest.mark.parametrize("evidence", [None, [], 3, "text", {"method": "parts"}])
def test_evidence_of_any_shape_is_rejected_with_a_reason(
    evidence: Any, sound: tuple[dict[str, Any], dict[str, Any], dict[str, Any]]
) -> None:
    system, claim, _ = sound
    assert check_uncertain(system, claim, evidence, count_reasons)
