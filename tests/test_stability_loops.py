"""Closing loops: every kind of plant and controller, against closed forms and python-control."""

from fractions import Fraction

import control
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy import signal

from baselines import SkyHook
from railenv.errors import ArgumentError
from railenv.stability import DelaySystem, as_delay_system, critical_delays, rightmost_roots
from railenv.stability.loops import LinearSystem, linear_system
from railenv.vehicle import state_space

A = np.array([[0.0, 1.0], [-4.0, -0.2]])
B = np.array([[0.0], [1.0]])
C = np.array([[1.0, 0.0]])
OSCILLATOR = (A, B, C, np.zeros((1, 1)))
P, I_GAIN = 0.3, 0.2
# x'' + 0.2 x' + 4 x = f, f = -(P x + I int x)(t - tau), by hand
PI_LOOP = DelaySystem(
    [[0, 1, 0], [-4, -0.2, 0], [1, 0, 0]],
    [[0], [1], [0]],
    [[P, 0, I_GAIN]],  # type: ignore[arg-type]
)


def roots_of(system: DelaySystem, delay: float, count: int = 6) -> np.ndarray:
    return np.array([mode.root for mode in rightmost_roots(system, delay, count)])


def response(system: LinearSystem, s: complex) -> np.ndarray:
    n = system.A.shape[0]
    return system.C @ np.linalg.solve(s * np.eye(n) - system.A, system.B + 0j) + system.D


def random_system(rng: np.random.Generator, n: int, inputs: int, outputs: int, direct: bool):
    D = rng.normal(size=(outputs, inputs)) if direct else np.zeros((outputs, inputs))
    return (
        rng.normal(size=(n, n)) - 2.0 * np.eye(n),
        rng.normal(size=(n, inputs)),
        rng.normal(size=(outputs, n)),
        D,
    )


def spectrum(matrix: np.ndarray) -> np.ndarray:
    return np.sort_complex(np.round(np.linalg.eigvals(matrix), 9))


@pytest.mark.parametrize(
    "controller",
    [
        control.tf([P, I_GAIN], [1, 0]),
        signal.TransferFunction([P, I_GAIN], [1, 0]),
        signal.ZerosPolesGain([-I_GAIN / P], [0.0], P),
        control.ss([[0.0]], [[1.0]], [[I_GAIN]], [[P]]),
        signal.StateSpace([[0.0]], [[1.0]], [[I_GAIN]], [[P]]),
        (np.zeros((1, 1)), np.ones((1, 1)), np.array([[I_GAIN]]), np.array([[P]])),
    ],
    ids=["control tf", "scipy tf", "scipy zpk", "control ss", "scipy ss", "tuple"],
)
@pytest.mark.parametrize(
    "plant",
    [
        OSCILLATOR,
        control.tf([1], [1, 0.2, 4]),
        control.ss(*OSCILLATOR),
        signal.StateSpace(*OSCILLATOR),
        signal.TransferFunction([1], [1, 0.2, 4]),
    ],
    ids=["tuple", "control tf", "control ss", "scipy ss", "scipy tf"],
)
def test_a_pi_controller_of_any_origin_has_the_roots_of_the_loop_written_by_hand(
    plant, controller
) -> None:
    loop = DelaySystem.from_loop(plant, controller)
    # the same roots to the accuracy of their correction; scipy's quotient rounds once more
    np.testing.assert_allclose(roots_of(loop, 0.4), roots_of(PI_LOOP, 0.4), rtol=1e-10)


def test_a_gain_matrix_is_the_controller_without_states() -> None:
    loop = DelaySystem.from_loop(OSCILLATOR, [[0.5]])
    np.testing.assert_array_equal(loop.K, [[0.5, 0.0]])
    np.testing.assert_array_equal(loop.A, A)
    np.testing.assert_array_equal(DelaySystem.from_loop(OSCILLATOR, 0.5).K, loop.K)


@pytest.mark.parametrize("direct", [False, True], ids=["proper", "plant with feedthrough"])
@pytest.mark.parametrize("seed", range(5))
def test_a_dynamic_loop_without_delay_has_the_poles_of_python_controls_feedback(
    seed: int, direct: bool
) -> None:
    rng = np.random.default_rng(seed)
    plant = random_system(rng, 4, 2, 3, direct)
    law = random_system(rng, 3, 3, 2, False)
    loop = DelaySystem.from_loop(control.ss(*plant), control.ss(*law))
    assert not loop.neutral
    closed = control.feedback(control.ss(*plant), control.ss(*law))
    np.testing.assert_allclose(spectrum(loop.undelayed), spectrum(closed.A), atol=1e-8)


@pytest.mark.parametrize("seed", range(5))
def test_a_neutral_loop_without_delay_has_the_poles_of_python_controls_feedback(seed: int) -> None:
    rng = np.random.default_rng(seed)
    plant, law = random_system(rng, 4, 2, 3, True), random_system(rng, 3, 3, 2, True)
    loop = DelaySystem.from_loop(plant, law)
    assert loop.neutral
    np.testing.assert_array_equal(loop.feedthrough, law[3] @ plant[3])
    closed = control.feedback(control.ss(*plant), control.ss(*law))
    np.testing.assert_allclose(spectrum(loop.undelayed), spectrum(closed.A), atol=1e-7)


def test_the_loop_satisfies_the_block_diagrams_own_equation_at_its_roots() -> None:
    # plant feedthrough into a low-pass: a delayed force drives the filter
    plant, law = control.tf([1, 0, 0], [1, 0.2, 4]), control.tf([0.8], [0.5, 1])
    loop = DelaySystem.from_loop(plant, law)
    assert not loop.neutral
    for s in roots_of(loop, 0.7):
        residual = 1 + complex(plant(s)) * complex(law(s)) * np.exp(-0.7 * s)
        # terms of size one, roots to 1e-12 of themselves
        assert abs(residual) < 1e-9


def test_independent_delays_sit_at_their_own_channels() -> None:
    rng = np.random.default_rng(3)
    plant, law = random_system(rng, 3, 2, 2, True), random_system(rng, 2, 2, 2, False)
    loop = DelaySystem.from_loop(plant, law)
    P_, L_ = LinearSystem(*plant), LinearSystem(*law)
    delays = [0.3, 0.8]
    for mode in rightmost_roots(loop, delays, 4):
        s = mode.root
        late = np.diag(np.exp(-s * np.array(delays)))
        matrix = np.eye(2) + late @ response(L_, s) @ response(P_, s)
        assert abs(np.linalg.det(matrix)) < 1e-9


def test_matrices_need_no_library_and_lists_will_do() -> None:
    loop = DelaySystem.from_loop(tuple(part.tolist() for part in OSCILLATOR), [[1]])
    assert loop.num_states == 2


def test_states_are_the_plants_followed_by_the_controllers() -> None:
    loop = DelaySystem.from_loop(OSCILLATOR, control.tf([1], [2, 1]))
    np.testing.assert_array_equal(loop.A, [[0, 1, 0], [-4, -0.2, 0], [1, 0, -0.5]])
    np.testing.assert_array_equal(loop.K, [[0, 0, 0.5]])


def test_a_channel_that_is_never_commanded_does_not_make_the_loop_neutral() -> None:
    # the first force is fed through to the only sensor, but nobody commands it
    plant = (A, np.eye(2), C, np.array([[1.0, 0.0]]))
    assert not DelaySystem.from_loop(plant, [[0.0], [0.5]]).neutral
    assert DelaySystem.from_loop(plant, [[0.1], [0.5]]).neutral


def test_a_channel_commanded_through_a_filter_alone_still_carries_a_force() -> None:
    # channel 1 is an integrator's, and its force comes straight back into channel 2
    plant = (A, np.eye(2), C, np.array([[1.0, 0.0]]))
    law = (np.zeros((1, 1)), np.ones((1, 1)), np.array([[1.0], [0.0]]), np.array([[0.0], [0.5]]))
    loop = DelaySystem.from_loop(plant, law)
    np.testing.assert_array_equal(loop.feedthrough, [[0.0, 0.0], [0.5, 0.0]])


def test_a_cancelled_term_between_two_delays_is_neutral_all_the_same() -> None:
    # F K = 0 as matrices, but with two delays the two paths come at different times
    plant = (A, np.eye(2), np.eye(2), np.array([[1.0, -1.0], [1.0, -1.0]]))
    gain = np.full((2, 2), 0.5)
    assert not np.any(gain @ plant[3] @ gain)
    assert DelaySystem.from_loop(plant, gain).neutral


def test_the_fed_back_outputs_with_feedthrough_are_named() -> None:
    plant = control.ss(
        A, B, np.eye(2), [[0.0], [1.0]], inputs=["force"], outputs=["stroke", "accelerometer"]
    )
    assert DelaySystem.from_loop(plant, [[1.0, 0.2]]).direct_outputs == ("accelerometer",)
    assert DelaySystem.from_loop(plant, [[1.0, 0.0]]).direct_outputs == ()
    nameless = (A, B, np.eye(2), [[0.0], [1.0]])
    assert DelaySystem.from_loop(nameless, [[1.0, 0.2]]).direct_outputs == ("output 2",)


TABLE = [[([1], [1, 0]), ([2, 1], [1, 3, 2])], [([3], [2, 0]), ([4], [1])]]


def test_a_transfer_matrix_keeps_its_response_in_every_entry() -> None:
    matrix = control.tf(
        [[num for num, _ in row] for row in TABLE], [[den for _, den in row] for row in TABLE]
    )
    system = linear_system(matrix, "plant")
    for s in (0.3 + 0j, 2j, 1 + 3j):
        np.testing.assert_allclose(response(system, s), matrix(s), rtol=1e-13)
    # 1/s and 3/(2s) stand in one column: one integrator, no hidden one
    assert system.A.shape == (3, 3)


def test_an_integrator_shared_by_inputs_is_one_state() -> None:
    row = control.tf([[[1], [2], [5]]], [[[1, 0], [1, 0], [3, 0]]])
    assert linear_system(row, "controller").A.shape == (1, 1)


def test_scipys_single_input_with_many_outputs_shares_its_denominator() -> None:
    column = signal.TransferFunction([[1.0, 2.0], [3.0, 4.0]], [1.0, 5.0, 6.0])
    system = linear_system(column, "plant")
    assert system.A.shape == (2, 2)
    s = 0.7 + 2j
    expected = [[(s + 2) / (s * s + 5 * s + 6)], [(3 * s + 4) / (s * s + 5 * s + 6)]]
    np.testing.assert_allclose(response(system, s), expected, rtol=1e-14)


coefficient = st.floats(min_value=-1e6, max_value=1e6, allow_subnormal=False).filter(
    lambda v: abs(v) > 1e-6
)


@given(st.lists(coefficient, min_size=3, max_size=3), st.lists(coefficient, min_size=3, max_size=3))
def test_every_entry_of_a_realisation_is_the_exact_quotient_rounded_once(num, den) -> None:
    class Given:
        pass

    given_system = Given()
    given_system.num, given_system.den = np.array(num), np.array(den)  # type: ignore[attr-defined]
    system = linear_system(given_system, "plant")
    b, a = [Fraction(v) for v in num], [Fraction(v) for v in den]
    assert [*system.A[0]] == [float(-a[1] / a[0]), float(-a[2] / a[0])]
    assert system.D[0, 0] == float(b[0] / a[0])
    assert [*system.C[0]] == [float((b[k] - b[0] * a[k] / a[0]) / a[0]) for k in (1, 2)]


def test_zeros_and_poles_are_multiplied_out_exactly() -> None:
    zeros, poles, gain = signal.buttap(5)
    system = linear_system(signal.ZerosPolesGain(zeros, poles, 1.0), "filter")
    s = 0.4 + 0.9j
    np.testing.assert_allclose(response(system, s)[0, 0], 1 / np.prod(s - poles), rtol=1e-13)
    assert gain == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("plant", "controller", "message"),
    [
        (OSCILLATOR, control.tf([1, 0], [1]), r"controller: .*improper: degree 1 over 0.*roll-off"),
        (control.tf([1, 0, 0], [1, 2]), 1.0, "plant: .*improper"),
        (OSCILLATOR, control.tf([1], [1, 1], 0.01), r"controller: .*dt = 0\.01"),
        (OSCILLATOR, control.ss([[0.5]], [[1]], [[1]], [[0]], True), "dt = True"),
        (OSCILLATOR, signal.TransferFunction([1], [1, 1], dt=0.1), r"dt = 0\.1"),
        (signal.dlti(*OSCILLATOR), 1.0, r"plant: .*continuous-time"),
        (OSCILLATOR, signal.ZerosPolesGain([], [-1 + 1j, -2], 1), "conjugate pairs"),
        (OSCILLATOR, control.tf([1], [1e-320, 1, 1]), "change the unit of time"),
        (OSCILLATOR, control.frd([1, 2], [1, 2]), "a FrequencyResponseData is no linear system"),
        (OSCILLATOR, None, "a NoneType is no linear system; give a tuple"),
        (OSCILLATOR, "pi", "a str is no linear system"),
        (OSCILLATOR, ([1], [1, 1]), "tuple of 2"),
        (OSCILLATOR[:3], 1.0, "plant: a tuple of 3"),
        ((A, B, np.ones((1, 3)), np.zeros((1, 1))), 1.0, r"plant: C has shape \(1, 3\)"),
        ((A, B, C, 0.0), 1.0, "plant: D has 0 dimensions"),
        ((A * np.nan, B, C, [[0.0]]), 1.0, "plant: A holds a value that is not finite"),
        ((A + 1j, B, C, [[0.0]]), 1.0, "plant: A is not a matrix of real numbers"),
        (OSCILLATOR, [[1.0, 2.0]], r"the controller has shape \(1, 2\); it must be \(1, 1\)"),
        (OSCILLATOR, [1.0], "controller: the gain has 1 dimensions"),
        (OSCILLATOR, np.nan, "controller: the gain holds a value that is not finite"),
        (1.0, 1.0, "A has shape"),
        ((A * 1e200, B, C * 1e200, [[0.0]]), 1e200, "K holds a value that is not finite"),
    ],
)
def test_what_cannot_be_closed_is_refused_by_name(plant, controller, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        DelaySystem.from_loop(plant, controller)


def test_signals_named_alike_in_another_order_are_not_joined_silently() -> None:
    plant = control.ss(A, B, np.eye(2), np.zeros((2, 1)), outputs=["stroke", "rate"])
    law = control.ss([], [], [], [[1.0, 2.0]], inputs=["rate", "stroke"])
    with pytest.raises(ArgumentError, match=r"stroke, rate.*rate, stroke.*same one"):
        DelaySystem.from_loop(plant, law)


class TestNamedSensors:
    gains = (35e3 * np.eye(4), tuple(f"carbody_lateral_velocity_{k}" for k in (1, 2, 3, 4)))

    def test_a_gain_on_the_vehicles_sensors_is_the_loop_of_the_controller(self, vehicle) -> None:
        loop = DelaySystem.from_sensors(state_space(vehicle), *self.gains)
        own = SkyHook(35e3, 4).to_delay_system(vehicle)
        for name in ("A", "B", "K", "feedthrough"):
            np.testing.assert_array_equal(getattr(loop, name), getattr(own, name))

    def test_a_mapping_names_its_columns(self, vehicle) -> None:
        gain, names = self.gains
        columns = dict(zip(names, gain.T, strict=True))
        loop = DelaySystem.from_sensors(state_space(vehicle), columns)
        np.testing.assert_array_equal(loop.K, SkyHook(35e3, 4).to_delay_system(vehicle).K)

    def test_a_state_is_a_sensor_too(self, vehicle) -> None:
        plant = state_space(vehicle)
        loop = DelaySystem.from_sensors(plant, {"carbody_yaw_velocity": [1.0, 2.0, 3.0, 4.0]})
        expected = np.zeros((4, 38))
        expected[:, plant.states.index("carbody_yaw_velocity")] = [1, 2, 3, 4]
        np.testing.assert_array_equal(loop.K, expected)

    def test_python_controls_names_will_do(self) -> None:
        plant = control.ss(A, B, np.eye(2), np.zeros((2, 1)), outputs=["stroke", "rate"])
        np.testing.assert_array_equal(DelaySystem.from_sensors(plant, {"rate": 3}).K, [[0, 3]])

    def test_an_accelerometer_is_named_where_it_makes_the_loop_neutral(self, vehicle) -> None:
        gain = {"carbody_roll_rate": np.ones(4), "bogie1_lateral_acceleration": np.ones(4)}
        loop = DelaySystem.from_sensors(state_space(vehicle), gain)
        assert loop.direct_outputs == ("bogie1_lateral_acceleration",)

    @pytest.mark.parametrize(
        ("gain", "sensors", "message"),
        [
            ({"carbody_rol_rate": np.ones(4)}, None, "did you mean 'carbody_roll_rate'"),
            ({"carbody_roll_rate": 1.0}, None, r"controller has shape \(1, 1\)"),
            ({"carbody_roll_rate": [1, 2], "carbody_yaw_rate": [1]}, None, "different lengths"),
            ({"carbody_roll_rate": np.ones(4)}, ("carbody_roll_rate",), "drop sensors"),
            (np.ones((4, 1)), None, "sensors is missing"),
            (np.ones((4, 1)), "carbody_roll_rate", "one text"),
            (np.ones((4, 2)), ("carbody_roll_rate",), r"shape \(4, 2\); it must be \(4, 1\)"),
        ],
    )
    def test_a_wrong_name_or_column_is_refused(self, vehicle, gain, sensors, message) -> None:
        with pytest.raises(ArgumentError, match=message):
            DelaySystem.from_sensors(state_space(vehicle), gain, sensors)

    def test_a_plant_without_names_is_refused(self) -> None:
        with pytest.raises(ArgumentError, match="have no names"):
            DelaySystem.from_sensors(OSCILLATOR, {"stroke": 1.0})
        plant = control.ss(*OSCILLATOR, outputs=["stroke"])
        with pytest.raises(ArgumentError, match="unknown sensor 'strok'"):
            DelaySystem.from_sensors(plant, {"strok": 1.0})


class TestAsDelaySystem:
    def test_a_delay_system_is_itself(self) -> None:
        assert as_delay_system(PI_LOOP) is PI_LOOP

    def test_a_controller_closes_its_loop_around_the_vehicle(self, vehicle) -> None:
        loop = as_delay_system(SkyHook(35e3, 4), vehicle)
        assert critical_delays(loop).critical_delay == pytest.approx(0.202, abs=1e-3)

    def test_an_object_that_needs_no_vehicle_is_given_none(self, vehicle) -> None:
        class Own:
            def to_delay_system(self):
                return PI_LOOP

        assert as_delay_system(Own()) is PI_LOOP
        assert as_delay_system(Own(), vehicle) is PI_LOOP

    def test_a_vehicle_may_be_optional(self, vehicle) -> None:
        class Own:
            def to_delay_system(self, vehicle=None):
                return PI_LOOP if vehicle is None else SkyHook(1e3, 4).to_delay_system(vehicle)

        assert as_delay_system(Own()) is PI_LOOP
        assert as_delay_system(Own(), vehicle).num_states == 38

    def test_what_offers_no_loop_is_refused(self, vehicle) -> None:
        class Wrong:
            def to_delay_system(self):
                return 3

        for loop, message in (
            (SkyHook(35e3, 4), "give one, vehicle="),
            (OSCILLATOR, "tuple is no linear loop; give a DelaySystem"),
            (Wrong(), "returned a int"),
        ):
            with pytest.raises(ArgumentError, match=message):
                as_delay_system(loop)
