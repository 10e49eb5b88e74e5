"""Dynamic classical laws: sky-hook from accelerometers, sky-hook with lead, modal PID."""

from typing import Any

import control
import numpy as np
import pytest
from scipy import signal

from baselines import LinearDynamic, SkyHook
from baselines.lead import SkyHookLead
from baselines.pid import ModalGains, ModalPid
from baselines.skyhook import SkyHookAccelerometer
from railenv.errors import ArgumentError
from railenv.stability import critical_delays, rightmost_roots
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, lateral17, state_space
from railenv.vehicle.coordinates import actuator_positions

OMEGA = 2 * np.pi * np.geomspace(0.02, 40.0, 60)
NONE = ModalGains(0.0, 0.0, 0.0)


def response(controller: LinearDynamic, omega: FloatArray) -> np.ndarray:
    """The law at s = j omega, shape (frequencies, channels, sensors)."""
    A, B, C, D = (getattr(controller.law, name) for name in "ABCD")
    eye = np.eye(len(A))
    return np.array([C @ np.linalg.solve(1j * w * eye - A, B) + D for w in omega])


def fraction(numerator: list[float], denominator: list[float]) -> Any:
    """A transfer function of python-control."""
    return control.tf(numerator, denominator)


def critical(controller, vehicle: LateralVehicle) -> float:
    delay = critical_delays(controller.to_delay_system(vehicle)).critical_delay
    assert delay is not None
    return delay


class TestAccelerometer:
    def test_each_actuator_integrates_its_own_accelerometer_behind_a_high_pass(self) -> None:
        law = SkyHookAccelerometer(20e3, 0.15, 0.6, 4)
        assert law.sensors == tuple(f"carbody_lateral_acceleration_{k}" for k in (1, 2, 3, 4))
        w = 2 * np.pi * 0.15
        _, expected = signal.freqs([20e3, 0.0], [1.0, 2 * 0.6 * w, w**2], OMEGA)
        np.testing.assert_allclose(
            response(law, OMEGA), expected[:, None, None] * np.eye(4), rtol=1e-10
        )

    def test_a_constant_reading_leaves_no_force(self) -> None:
        np.testing.assert_array_equal(response(SkyHookAccelerometer(), np.zeros(1)), 0.0)

    def test_accelerometers_leave_the_loop_retarded(self, vehicle: LateralVehicle) -> None:
        assert not SkyHookAccelerometer().to_delay_system(vehicle).neutral

    @pytest.mark.parametrize("highpass_hz", [0.05, 0.1])
    @pytest.mark.slow
    def test_the_high_pass_leads_and_so_adds_its_phase_to_the_critical_delay(
        self, vehicle: LateralVehicle, highpass_hz: float
    ) -> None:
        first = critical_delays(SkyHook(35e3, 4).to_delay_system(vehicle)).first
        assert first is not None
        omega, w = 2 * np.pi * first.frequency_hz, 2 * np.pi * highpass_hz
        lead = np.angle((1j * omega) ** 2 / ((1j * omega) ** 2 + 1.4 * w * 1j * omega + w**2))
        gained = critical(SkyHookAccelerometer(35e3, highpass_hz), vehicle) - first.delay
        # the filter's gain differs from one by (w / omega)^4 / 2 at zeta = 0.7: some 2e-5, which
        # moves the crossing by about as much
        assert gained == pytest.approx(lead / omega, rel=0.02)

    def test_a_corner_at_the_slow_motion_is_unstable_without_delay(
        self, vehicle: LateralVehicle
    ) -> None:
        # the limit that the docstring states, 0.405 Hz
        rates = [
            np.linalg.eigvals(
                SkyHookAccelerometer(35e3, hz).to_delay_system(vehicle).undelayed
            ).real.max()
            for hz in (0.40, 0.41)
        ]
        assert rates[0] < 0.0 < rates[1]

    def test_the_slow_modes_lose_the_damping_that_the_docstring_states(
        self, vehicle: LateralVehicle
    ) -> None:
        for hz, damping in ((0.2, 0.36), (0.3, 0.09)):
            loop = SkyHookAccelerometer(35e3, hz).to_delay_system(vehicle)
            roots = [m.root for m in rightmost_roots(loop, 0.0, 8)]
            slow = min(-s.real / abs(s) for s in roots if 1.0 < abs(s) < 4.0)
            assert slow == pytest.approx(damping, abs=0.005)


class TestLead:
    @pytest.mark.parametrize("delay", [0.02, 0.1, 0.2, 0.3, 0.38])
    def test_lead_makes_up_for_the_delay_at_its_frequency(self, delay: float) -> None:
        omega = 2 * np.pi * 1.3
        at = response(SkyHookLead(delay, 10e3, 1.3, 4), np.array([omega]))[0]
        # sky-hook without delay: a real gain at the right channel, nothing at the others
        np.testing.assert_allclose(at * np.exp(-1j * omega * delay), 10e3 * np.eye(4), atol=1e-7)

    @pytest.mark.parametrize(("delay", "stages"), [(0.0, 0), (0.117, 1), (0.118, 2), (0.38, 4)])
    def test_a_stage_leads_by_fifty_five_degrees_at_most(self, delay: float, stages: int) -> None:
        # 55 degrees at 1.3 Hz are 117.5 ms
        assert SkyHookLead(delay).stages == stages
        assert len(SkyHookLead(delay).law.A) == 4 * stages

    def test_the_stages_are_a_product_of_first_order_leads(self) -> None:
        law = SkyHookLead(0.2, 10e3, 1.3, 2)
        phase = 2 * np.pi * 1.3 * 0.2 / 2
        # tan(45 deg + phase / 2)^2 is (1 + sin) / (1 - sin) in another form
        a = np.tan(np.pi / 4 + phase / 2) ** 2
        T = 1 / (2 * np.pi * 1.3 * np.sqrt(a))
        stage = fraction([a * T, 1.0], [np.sqrt(a) * T, np.sqrt(a)])
        expected = np.array([(10e3 * stage * stage)(1j * w) for w in OMEGA])
        np.testing.assert_allclose(
            response(law, OMEGA), expected[:, None, None] * np.eye(2), rtol=1e-10
        )

    def test_without_delay_it_is_sky_hook_to_the_bit(self) -> None:
        readings = np.random.default_rng(0).normal(size=(3, 136))
        lead = SkyHookLead(0.0, 35e3)
        lead.reset(3, 0)
        np.testing.assert_array_equal(lead.act(readings), SkyHook(35e3).act(readings))

    def test_the_critical_delay_grows_by_nearly_the_delay_made_up_for(
        self, vehicle: LateralVehicle
    ) -> None:
        plain = critical(SkyHook(35e3, 4), vehicle)
        for delay in (0.05, 0.1):
            # the crossing lies 2 % above 1.3 Hz, where the lead is past its best
            assert critical(SkyHookLead(delay), vehicle) - plain == pytest.approx(delay, rel=0.05)

    def test_too_much_lead_at_full_gain_leaves_less_delay_than_none(
        self, vehicle: LateralVehicle
    ) -> None:
        plain = critical(SkyHook(35e3, 4), vehicle)
        assert critical(SkyHookLead(0.25, 35e3), vehicle) < plain / 3

    def test_a_delay_of_half_a_period_is_refused_with_the_way_out(self) -> None:
        with pytest.raises(ArgumentError, match=r"delay = 0\.39 s is half a period.*0\.385 s"):
            SkyHookLead(0.39)


class TestPid:
    sway, yaw = ModalGains(30e3, 40e3, 4e3), ModalGains(8e3, 9e3, 2e3)

    def part(self, gains: ModalGains) -> np.ndarray:
        """P + I / (s + w_leak) + D s / (1 + s / w_d) from python-control."""
        leak, corner = 2 * np.pi * 0.1, 2 * np.pi * 10.0
        law = (
            fraction([gains.proportional], [1.0])
            + fraction([gains.integral], [1.0, leak])
            + fraction([gains.derivative, 0.0], [1 / corner, 1.0])
        )
        return np.array([law(1j * w) for w in OMEGA])

    @pytest.mark.parametrize("layout", [2, 4])
    def test_each_mode_has_a_pid_of_its_own(self, layout: int) -> None:
        now = response(ModalPid(self.sway, self.yaw, layout=layout), OMEGA)
        end = np.repeat([1.0, -1.0], layout // 2)
        for motion, gains in ((np.ones(layout), self.sway), (end, self.yaw)):
            # a motion of the mode at one metre per second asks for its force at every actuator
            np.testing.assert_allclose(now @ motion, self.part(gains)[:, None] * motion, rtol=1e-10)

    @pytest.mark.parametrize("layout", [2, 4])
    def test_on_the_carbody_sway_makes_no_yaw_and_yaw_no_sway(self, layout: int) -> None:
        vehicle = lateral17(layout=layout)
        system = state_space(vehicle)
        places = actuator_positions(vehicle.layout)
        velocities = tuple(f"carbody_lateral_velocity_{k}" for k in places)
        now = response(ModalPid(self.sway, self.yaw, layout=layout), OMEGA)
        coupled = {
            "carbody_lateral": ("yaw",),
            "carbody_roll": ("yaw",),
            "carbody_yaw": ("lateral", "roll"),
        }
        for moved, others in coupled.items():
            seen = system.output_rows(velocities)[0][:, system.states.index(f"{moved}_velocity")]
            force = now @ seen
            assert np.abs(force).max() > 1e3
            for other in others:
                _, D = system.output_rows((f"carbody_{other}_acceleration",))
                alone = np.abs(D[0, :layout]).sum() * np.abs(force).max()
                # a sum of a few products that cancel
                assert np.abs(force @ D[0, :layout]).max() < 1e-13 * alone

    def test_equal_dampers_in_both_modes_are_sky_hook_with_two_actuators(self) -> None:
        only = ModalGains(35e3, 0.0, 0.0)
        law = ModalPid(only, only, layout=2)
        assert len(law.law.A) == 0
        np.testing.assert_allclose(law.law.D, SkyHook(35e3, 2).gain, atol=1e-11)

    def test_damping_alone_takes_energy_out_of_every_motion_of_the_carbody(self) -> None:
        law = ModalPid(ModalGains(35e3, 0.0, 0.0), ModalGains(20e3, 0.0, 0.0))
        velocity = np.random.default_rng(2).normal(size=(50, 4))
        law.reset(50, 0)
        readings = np.zeros((50, 136))
        readings[:, :4] = velocity
        assert np.all(np.sum(law.act(readings) * velocity, axis=1) < 0.0)

    def test_a_part_without_gain_has_no_state(self) -> None:
        assert len(ModalPid(NONE, NONE).law.A) == 0
        assert len(ModalPid(ModalGains(1e3, 1e3, 0.0), NONE).law.A) == 1
        assert len(ModalPid(self.sway, self.yaw).law.A) == 4

    @pytest.mark.parametrize(("layout", "speed"), [(4, 300.0), (2, 300.0), (4, 200.0), (2, 200.0)])
    def test_the_default_gains_keep_the_margin_they_were_searched_with(
        self, layout: int, speed: float
    ) -> None:
        assert critical(ModalPid(layout=layout), lateral17("paper_fit", layout, speed)) > 0.2

    @pytest.mark.parametrize(
        ("gains", "message"),
        [
            ((-1.0, 0.0, 0.0), "proportional = -1"),
            ((0.0, -1.0, 0.0), "integral = -1"),
            ((0.0, 0.0, float("inf")), "derivative = inf"),
        ],
    )
    def test_a_gain_out_of_range_is_refused_by_its_name(self, gains, message: str) -> None:
        with pytest.raises(ArgumentError, match=message):
            ModalGains(*gains)
