"""Inside the critical delay by simulation: verdicts, excitation, the search, the limit cycle."""

import numpy as np
import pytest

from baselines import Passive, SkyHook
from eval import delay_sweep
from eval.delay_probe import Probe as _Probe
from eval.delay_probe import tends_to_zero as _tends_to_zero
from eval.delay_sweep import simulated_critical_delay
from eval.rollout import ACCELERATIONS, Stepping
from railenv.actuation import ActuatorSpec
from railenv.simulation import wheelset_inputs
from railenv.stability import sampled_growth_rate
from railenv.vehicle import LateralVehicle, lateral17

TIME = 5.0 * np.arange(24)
"""Starts of the windows of one free run [s]."""

LIMIT = 30e3
LAST_SECOND = 100
"""Control periods in the last second of the excitation."""


@pytest.mark.parametrize(
    ("motion", "amplitudes", "verdict"),
    [
        ("decays quickly", np.exp(-0.1 * TIME), True),
        ("grows", np.exp(0.01 * TIME), False),
        ("is a limit cycle", np.ones(24), False),
        # the slowest decay that counts is 1e-4 per second
        ("decays just fast enough", np.exp(-1.2e-4 * TIME), True),
        ("decays too slowly", np.exp(-0.8e-4 * TIME), False),
        ("decayed and rises in the noise", np.r_[1.0, np.geomspace(1e-12, 9e-10, 23)], True),
        ("has not quite decayed and is flat", np.r_[1.0, np.full(23, 2e-9)], False),
        ("rests", np.zeros(24), True),
        ("falls to a limit cycle", np.r_[np.geomspace(1.0, 0.5, 12), np.full(12, 0.5)], False),
        ("grows and then falls a little", np.r_[1.0, np.geomspace(2.5, 2.1, 23)], False),
        ("rises by beating and falls", np.r_[1.0, np.geomspace(2.3, 1.9, 23)], True),
        ("blows up", np.r_[np.ones(23), np.nan], False),
        ("blew up in between", np.r_[1.0, np.nan, np.zeros(22)], False),
        ("overflows", np.r_[1.0, np.inf, np.geomspace(1.0, 1e-3, 22)], False),
    ],
)  # fmt: skip
def test_only_what_tends_to_zero_is_stable(
    motion: str, amplitudes: np.ndarray, verdict: bool
) -> None:
    assert _tends_to_zero(amplitudes) is verdict, motion


class Recorded(SkyHook):
    """Sky-hook that keeps its forces, run by run."""

    runs: list[list[np.ndarray]]

    def reset(self, num_lanes: int, seed: int) -> None:
        self.runs = [*getattr(self, "runs", []), []]

    def act(self, observations: np.ndarray) -> np.ndarray:
        actions = super().act(observations)
        self.runs[-1].append(self.action_scale * actions)
        return actions

    def last_commands(self, run: int) -> np.ndarray:
        """Largest command of each lane in the last second of an excitation [N]."""
        return np.abs(self.runs[run][-LAST_SECOND:]).max(axis=(0, 2))


def probe(controller: SkyHook | Passive, vehicle: LateralVehicle, **changed: object) -> _Probe:
    return _Probe(controller, vehicle, Stepping(**changed), "tb3352", 0)  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def excited(vehicle: LateralVehicle) -> tuple[Recorded, _Probe]:
    """A stable loop and a strongly unstable one, after their excitation."""
    controller = Recorded(60e3, 4)
    made = probe(controller, vehicle)
    made._excite(np.array([0.0, 0.3]))
    return controller, made


def test_the_unstable_loop_saturates_without_a_smaller_track(excited) -> None:
    assert excited[0].last_commands(0)[1] > LIMIT


def test_commands_at_the_end_of_the_excitation_are_a_fifth_of_the_limit_at_most(excited) -> None:
    controller, _ = excited
    assert np.all(controller.last_commands(-1) <= 0.2 * LIMIT)


def test_a_smaller_track_still_excites(excited) -> None:
    controller, _ = excited
    # one step goes down by fifty at most, from a fifth of the limit or more: 0.2 / 50 = 0.004
    assert controller.last_commands(-1)[1] > 0.001 * LIMIT


def test_a_lane_is_scaled_by_its_own_commands(excited) -> None:
    controller, _ = excited
    # the stable lane fits from the first run on: its commands are the same in all
    assert controller.last_commands(-1)[0] == controller.last_commands(0)[0]


def test_without_a_limit_the_track_is_never_scaled(vehicle: LateralVehicle) -> None:
    controller = Recorded(60e3, 4)
    probe(controller, vehicle, actuator=ActuatorSpec(force_limit=None))._excite(np.array([0.2]))
    assert len(controller.runs) == 1


def seen(vehicle: LateralVehicle) -> np.ndarray:
    """What the wheelsets see in the excitation, at steps of 5 ms."""
    made = probe(Passive(), vehicle)
    return wheelset_inputs(vehicle, made._track, 0.005, 2 * made._excited)


@pytest.mark.parametrize("speed", [100.0, 300.0])
def test_the_irregularity_has_faded_out_under_every_wheelset_when_the_track_ends(
    speed: float,
) -> None:
    inputs = seen(lateral17(layout="passive", speed_kmh=speed))
    # a hundred grid points behind the end, and the spline's ripple falls fourfold at each: 4^-100
    assert np.abs(inputs[-1]).max() < 1e-15 * np.abs(inputs).max()


def test_the_irregularity_is_whole_until_it_fades() -> None:
    inputs = seen(lateral17(layout="passive"))
    # The taper of 50 m ends at 10 s; at 300 km/h it begins 0.6 s before.
    late, early = inputs[1400:1800, :4], inputs[1000:1400, :4]
    # two seconds of one stationary track: 1.2 measured, and a track that is gone gives zero
    assert np.std(late) > np.std(early) / 3


def test_the_passive_vehicle_decays_to_nothing_when_the_track_has_ended() -> None:
    made = probe(Passive(), lateral17(layout="passive"))
    made._excite(np.zeros(1))
    amplitudes, _ = made._watch(12)
    # the slowest mode decays by 0.55 per second: exp(-0.55 * 55) = 1e-13
    assert amplitudes[0, -1] < 1e-9 * amplitudes[0, 0]


def test_reaching_the_limit_is_noted_in_its_own_lane(excited) -> None:
    _, made = excited
    # the unstable lane grows from a fifth of the limit within seconds
    assert made._watch(6)[1].tolist() == [False, True]


def test_a_motion_that_has_saturated_is_unstable_even_if_it_falls(
    vehicle: LateralVehicle, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = probe(SkyHook(), vehicle)
    falling = np.tile(np.exp(-0.1 * TIME), (2, 1))
    monkeypatch.setattr(made, "_excite", lambda delays: None)
    monkeypatch.setattr(made, "_watch", lambda windows: (falling, np.array([False, True])))
    assert made.stable(np.zeros(2)).tolist() == [True, False]


def cycle(
    vehicle: LateralVehicle, monkeypatch: pytest.MonkeyPatch, amplitudes: list[float]
) -> dict:
    """The limit cycle that is read off made-up windows and a made-up last one."""
    made = probe(SkyHook(), vehicle)
    outputs = np.zeros((1, 2, len(made._record)))
    peaks = {ACCELERATIONS[0]: 1.5, ACCELERATIONS[1]: -2.5, ACCELERATIONS[2]: 99.0}
    peaks |= {"actuator_force_1": 4e3, made._record[7]: -29e3, made._record[8]: 1e6}
    for name, value in peaks.items():
        if name in made._record:
            outputs[0, 1, made._record.index(name)] = value
    windows = np.array([amplitudes])
    monkeypatch.setattr(made, "_excite", lambda delays: None)
    monkeypatch.setattr(made, "_watch", lambda number: (windows, np.array([True])))
    monkeypatch.setattr(made._batch, "advance", lambda: outputs)
    return made.limit_cycle(0.3)


@pytest.mark.parametrize(
    ("amplitudes", "settled"),
    [
        ([0.5, 1.0, 1.0, 1.0, 1.0], True),
        # the last window is compared with the third before it, to 2 %
        ([0.5, 1.0, 1.01, 1.01, 1.019], True),
        ([0.5, 1.0, 1.01, 1.02, 1.03], False),
        ([0.5, 1.0, 0.99, 0.98, 0.97], False),
        ([1.0, 1.0, 1.0, 1.0, np.nan], False),
    ],
)
def test_a_limit_cycle_has_settled_if_its_last_windows_agree(
    vehicle: LateralVehicle, monkeypatch, amplitudes: list[float], settled: bool
) -> None:
    assert cycle(vehicle, monkeypatch, amplitudes)["settled"] is settled


def test_a_limit_cycle_has_the_peaks_of_its_last_window(
    vehicle: LateralVehicle, monkeypatch
) -> None:
    found = cycle(vehicle, monkeypatch, [1.0] * 5)
    del found["settled"]
    assert found == {
        "delay_s": 0.3,
        "floor_front_amplitude": 1.5,
        "floor_rear_amplitude": 2.5,
        "force_amplitude": 29e3,
    }


class Island:
    """Stands for the probe: stable but for the delays between two edges."""

    low, high = 0.0533, 0.1117
    asked: list[float]
    scanned: list[np.ndarray]
    cycles: list[float]

    def __init__(self, *_: object) -> None:
        type(self).asked, type(self).scanned, type(self).cycles = [], [], []

    def stable(self, delays: np.ndarray) -> np.ndarray:
        self.scanned.append(delays)
        return (delays < self.low) | (delays > self.high)

    def oscillation(self, delay: float) -> tuple[float, str]:
        self.asked.append(delay)
        return (1.0, "first") if len(self.asked) == 1 else (2.0, "second")

    def limit_cycle(self, delay: float) -> dict:
        self.cycles.append(delay)
        return {"delay_s": delay}


def searched(monkeypatch: pytest.MonkeyPatch, low: float, **settings: float) -> dict:
    monkeypatch.setattr(Island, "low", low)
    monkeypatch.setattr(delay_sweep, "Probe", Island)
    return simulated_critical_delay(
        SkyHook(), lateral17(layout=4), **{"max_delay": 0.19, **settings}
    )


def test_a_loop_that_becomes_stable_again_has_both_changes(monkeypatch) -> None:
    crossings = searched(monkeypatch, 0.0533)["crossings"]
    assert [c["direction"] for c in crossings] == ["unstable", "stable"]
    for crossing, edge in zip(crossings, (0.0533, 0.1117), strict=True):
        assert crossing["bracket_s"][0] <= edge <= crossing["bracket_s"][1]


@pytest.mark.parametrize("resolution", [0.0005, 1e-5])
def test_every_bracket_is_as_narrow_as_asked(monkeypatch, resolution: float) -> None:
    answer = searched(monkeypatch, 0.0533, resolution=resolution)
    widths = [c["bracket_s"][1] - c["bracket_s"][0] for c in answer["crossings"]]
    assert max(widths) <= resolution


def test_the_oscillation_is_read_on_the_unstable_side_of_each_bracket(monkeypatch) -> None:
    first, second = (c["bracket_s"] for c in searched(monkeypatch, 0.0533)["crossings"])
    assert Island.asked == [first[1], second[0]]


def test_the_critical_delay_is_the_middle_of_the_first_bracket(monkeypatch) -> None:
    answer = searched(monkeypatch, 0.0533)
    assert answer["critical_delay_sampled_s"] == sum(answer["bracket_s"]) / 2
    assert answer["bracket_s"] == answer["crossings"][0]["bracket_s"]


def test_frequency_and_mode_are_those_of_the_first_change(monkeypatch) -> None:
    answer = searched(monkeypatch, 0.0533)
    assert (answer["frequency_hz"], answer["mode"]) == (1.0, "first")


def test_the_limit_cycle_is_that_of_the_first_unstable_delay_of_the_scan(monkeypatch) -> None:
    searched(monkeypatch, 0.0533)
    assert Island.cycles == [next(d for d in Island.scanned[0] if d >= 0.0533)]


def test_the_scan_goes_from_zero_to_the_longest_delay_in_steps_of_20_ms(monkeypatch) -> None:
    searched(monkeypatch, 0.0533)
    scan = Island.scanned[0]
    assert (scan[0], scan[-1]) == (0.0, 0.19)
    # beyond 20 ms only by the rounding of evenly spread delays
    assert np.diff(scan).max() <= 0.02 + 1e-12


def test_a_loop_that_is_unstable_at_once_has_no_first_change(monkeypatch) -> None:
    answer = searched(monkeypatch, 0.0)
    assert answer["critical_delay_sampled_s"] == 0.0
    assert [c["direction"] for c in answer["crossings"]] == ["stable"]
    assert answer["bracket_s"] is None


@pytest.mark.slow
def test_a_real_loop_that_becomes_stable_again_is_bracketed_twice(monkeypatch) -> None:
    vehicle, controller, period = lateral17(layout=2), SkyHook(25e3, 2), 0.02
    # a scan of four delays, and no limit cycle: what is asked here is the two changes
    monkeypatch.setattr(delay_sweep, "COARSE_STEP", 0.5)
    monkeypatch.setattr(_Probe, "limit_cycle", lambda self, delay: {})
    answer = simulated_critical_delay(
        controller, vehicle, stepping=Stepping(period, 0.01), max_delay=1.5, resolution=0.01
    )
    loop = controller.to_delay_system(vehicle)
    signs = [
        [sampled_growth_rate(loop, delay, period) > 0.0 for delay in c["bracket_s"]]
        for c in answer["crossings"]
    ]
    assert signs == [[False, True], [True, False]]
