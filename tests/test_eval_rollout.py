"""Rollouts: what a broken controller costs, an unstable vehicle does, comfort near the limit."""

import numpy as np
import pytest

from baselines import Passive, SkyHook
from baselines.linear_dynamic import LinearDynamic
from eval.measures import measure
from eval.rollout import Stepping, rollout
from railenv.actuation import SemiActiveDamper
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError, ControllerError
from railenv.simulation import required_length, wheelset_inputs
from railenv.track import make_track
from railenv.vehicle import LateralVehicle, lateral17


class Broken:
    """A controller that answers whatever it is told to."""

    def __init__(self, answer: object) -> None:
        self.answer = answer

    def reset(self, num_lanes: int, seed: int) -> None:
        pass

    def act(self, observations: np.ndarray) -> object:
        if isinstance(self.answer, Exception):
            raise self.answer
        return self.answer


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.zeros((1, 3)), r"shape \(1, 3\)"),
        (np.full((1, 4), np.nan), "not finite"),
        (ValueError("no luck"), "ValueError: no luck"),
    ],
)
def test_a_controller_that_breaks_the_protocol_is_named(
    vehicle: LateralVehicle, answer: object, message: str
) -> None:
    with pytest.raises(ControllerError, match=message):
        rollout(Broken(answer), vehicle, np.zeros((1, 4)), 0.1)  # type: ignore[arg-type]


def test_an_unstable_vehicle_stops_with_nan_and_not_with_overflow() -> None:
    fast = lateral17(layout="passive", speed_kmh=900.0)
    duration = 20.0
    track = make_track("german_high", required_length(fast, duration), 1)
    inputs = wheelset_inputs(fast, track, 0.005, 4000)[None]
    values = rollout(Passive(), fast, np.zeros((1, 0)), duration, track_inputs=inputs).values
    assert np.all(np.isfinite(values[0, 0]))
    assert np.all(np.isnan(values[0, -1]))


def comfort(gain: float, layout: int, delays: tuple[float, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Worse floor's ride index and divergence after 35 s on TB/T 3352, per delay."""
    vehicle = lateral17(layout=layout)
    track = make_track("tb3352", required_length(vehicle, 45.0), 1)
    inputs = wheelset_inputs(vehicle, track, 0.005, 9000)[None]
    lanes = np.repeat(np.array(delays)[:, None], layout, axis=1)
    measures = measure(
        rollout(SkyHook(gain, layout), vehicle, lanes, 45.0, track_inputs=inputs), 10.0, 30e3
    )
    worse = np.maximum(measures.ride_index_front, measures.ride_index_rear)
    return worse, measures.diverged


@pytest.mark.parametrize(("gain", "critical"), [(35e3, 0.197), (60e3, 0.137)])
def test_the_ride_index_is_flat_far_below_the_critical_delay_and_jumps_beyond(
    gain: float, critical: float
) -> None:
    worse, diverged = comfort(gain, 4, (0.0, 0.5 * critical, 1.2 * critical))
    # sky-hook's index wanders by 0.2 with the phase of the delayed force; the jump is ten times
    assert worse[1] < worse[0] + 0.3
    assert worse[2] > worse[0] + 2.0
    assert diverged.tolist() == [False, False, True]


def test_two_actuators_stand_300_ms_where_four_do_not() -> None:
    _, two = comfort(35e3, 2, (0.3,))
    _, four = comfort(35e3, 4, (0.3,))
    assert (two[0], four[0]) == (False, True)


@pytest.mark.parametrize(
    ("answer", "message"),
    [
        (np.zeros((1, 4), dtype=complex), "no real numbers"),
        ([["1"] * 4], "no real numbers"),
        (np.zeros((1, 4), dtype=object), "no real numbers"),
        (SystemExit(3), "SystemExit"),
    ],
)
def test_what_is_no_number_is_no_action(
    vehicle: LateralVehicle, answer: object, message: str
) -> None:
    controller = Broken(answer)
    if isinstance(answer, SystemExit):
        controller.act = lambda _: (_ for _ in ()).throw(answer)  # type: ignore[method-assign]
    with pytest.raises(ControllerError, match=message):
        rollout(controller, vehicle, np.zeros((1, 4)), 0.1)  # type: ignore[arg-type]


def test_what_a_controller_prints_does_not_mix_with_results(
    vehicle: LateralVehicle, capsys: pytest.CaptureFixture[str]
) -> None:
    class Loud:
        def reset(self, num_lanes: int, seed: int) -> None:
            print("reset")

        def act(self, observations: np.ndarray) -> np.ndarray:
            print("act")
            return np.zeros((1, 4))

    rollout(Loud(), vehicle, np.zeros((1, 4)), 0.02)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert captured.err == "reset\nact\nact\n"


def test_a_controller_made_for_another_control_period_is_not_run(vehicle: LateralVehicle) -> None:
    law = SkyHook(35e3, 4).gain
    made = LinearDynamic(
        (np.zeros((0, 0)), np.zeros((0, 4)), np.zeros((4, 0)), law[:, :4]),
        sensor_names("4")[:4],
        4,
        control_period=0.02,
    )
    assert made.control_period == 0.02
    with pytest.raises(ArgumentError, match=r"= 0\.01 s, .* control_period = 0\.02 s; run it"):
        rollout(made, vehicle, np.zeros((1, 4)), 0.1)
    # three tenths of a tenth are not 0.03 to the last bit
    made.control_period = 0.1 * 0.1 * 3.0
    rollout(made, vehicle, np.zeros((1, 4)), 0.3, stepping=Stepping(control_period=0.03))


@pytest.mark.parametrize(("damper", "unit"), [(None, "in N$"), (SemiActiveDamper(), "in N s/m$")])
def test_the_scale_of_an_action_is_a_force_or_a_coefficient(
    vehicle: LateralVehicle, damper: SemiActiveDamper | None, unit: str
) -> None:
    controller = SkyHook(35e3, 4)
    controller.action_scale = -1.0
    controller.damper = damper  # type: ignore[attr-defined]
    with pytest.raises(ControllerError, match=unit):
        rollout(controller, vehicle, np.zeros((1, 4)), 0.1)
