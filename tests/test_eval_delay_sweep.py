"""Critical delay by simulation: it must find what the oracle knows, and the limit cycle beyond."""

import pytest

from baselines import SkyHook, Zero
from eval.delay_sweep import simulated_critical_delay
from eval.rollout import Stepping
from railenv.stability import critical_delays, sampled_critical_delay
from railenv.vehicle import LateralVehicle, lateral17


@pytest.mark.slow
def test_the_bracket_holds_the_sampled_critical_delay(vehicle: LateralVehicle, loop) -> None:
    exact = sampled_critical_delay(loop, critical_delays(loop, 0.3), 0.01)
    answer = simulated_critical_delay(SkyHook(35e3, 4), vehicle, max_delay=0.24)
    low, high = answer["bracket_s"]
    assert high - low <= 0.0005
    assert low <= exact <= high
    assert answer["mode"] == "upper centre roll"
    # frequency of the sampled loop, read off a 10 s record
    assert answer["frequency_hz"] == pytest.approx(1.323, abs=0.01)
    cycle = answer["limit_cycle"]
    assert cycle["settled"]
    assert cycle["force_amplitude"] == 30e3
    # 4 x 30 kN on 40 t, times the front-to-rear share of roll and yaw
    assert 1.0 < cycle["floor_rear_amplitude"] < 10.0
    assert answer["proved"] is False


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gain", "layout", "longest"), [(60e3, 2, 0.6), (15e3, 4, 0.6), (60e3, 4, 0.6)]
)
def test_simulation_and_oracle_agree_on_every_stable_window(
    gain: float, layout: int, longest: float
) -> None:
    vehicle = lateral17(layout=layout)
    controller = SkyHook(gain, layout)
    loop = controller.to_delay_system(vehicle)
    exact = sampled_critical_delay(loop, critical_delays(loop, longest), 0.01)
    answer = simulated_critical_delay(controller, vehicle, max_delay=longest)
    # one crossing to instability, none back: limit cycles are not taken for stability
    assert [c["direction"] for c in answer["crossings"]] == ["unstable"]
    assert answer["critical_delay_sampled_s"] == pytest.approx(exact, abs=0.0005)


def test_a_controller_that_never_pushes_has_no_critical_delay() -> None:
    answer = simulated_critical_delay(Zero(2), lateral17(layout=2), max_delay=0.05)
    assert answer["critical_delay_sampled_s"] is None
    assert answer["crossings"] == []


def test_noise_of_the_sensors_is_left_out_of_the_question() -> None:
    noisy, vehicle = Stepping(sensor_noise=50.0), lateral17(layout=2)
    # With noise in the readings the motion never tends to zero, whatever the delay.
    answer = simulated_critical_delay(SkyHook(20e3, 2), vehicle, stepping=noisy, max_delay=0.02)
    assert answer["critical_delay_sampled_s"] is None
