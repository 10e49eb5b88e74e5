"""Sampled laws on the command line and in the benchmark: windows, roots, proofs, clear refusals."""

import json
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from benchmark_examples import block, rows_of, suite_of

from baselines import LinearDynamic, save_policy
from baselines.lqg import DelayLqg
from eval import sampled_answers
from eval.benchmark_stability import StabilityWork, stability_answer
from eval.cli import main
from eval.rollout import rollout
from eval.sampled_answers import LONGEST_SCAN, design_delays, sampled_loop
from eval.stability_answers import delay_system, is_sampled_only
from railenv.errors import ArgumentError, ControllerError
from railenv.stability import SampledLoop, sampled_windows
from railenv.track import make_track
from railenv.vehicle import lateral17

VEHICLE = lateral17("paper_fit", 4, 300.0)
PERIOD = 0.01
# A sharp design: stable from its own delay, where the accelerometers begin to see the force that it
# expects, to some 59 ms; unstable elsewhere up to 0.1 s, without delay too.
DESIGNED = 0.05
LAW = DelayLqg(VEHICLE, DESIGNED)
LOOP = LAW.to_sampled_loop(VEHICLE, PERIOD)
WINDOWS = sampled_windows(LOOP, 0.1)


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> str:
    place = tmp_path_factory.mktemp("law") / "law.npz"
    save_policy(LAW, place)
    return str(place)


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = main(list(arguments))
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def answer(capsys: pytest.CaptureFixture[str], command: str, path: str, *arguments: str) -> dict:
    status, out, _ = run(capsys, command, "--controller", path, *arguments, "--json")
    assert status == 0
    return json.loads(out)


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    status, out, err = run(capsys, *arguments)
    assert (status, out) == (2, "")
    assert err.count("\n") == 1
    return err


def test_the_sharp_law_is_what_these_tests_take_it_for() -> None:
    assert len(WINDOWS.stable_windows) == 1
    low, high = WINDOWS.stable_windows[0]
    assert low == DESIGNED
    assert 0.055 < high < 0.06
    assert WINDOWS.unstable_without_delay > 0


def test_the_json_has_the_documented_keys_and_the_windows_numbers(capsys, path: str) -> None:
    found = answer(capsys, "critical-delay", path, "--max-delay", "0.1")
    assert found["critical_delay_s"] is None
    assert found["note"] == "a sampled law has no continuous critical delay"
    assert found["critical_delay_sampled_s"] == WINDOWS.critical_delay == 0.0
    assert found["stable_windows_s"] == [list(window) for window in WINDOWS.stable_windows]
    assert (found["frequency_hz"], found["mode"]) == (None, None)
    assert (found["proved"], found["method"], found["max_delay_s"]) == (False, "sampled", 0.1)
    assert found["control_period_s"] == PERIOD
    assert found["unstable_roots_without_delay"] == WINDOWS.unstable_without_delay
    gained, lost = found["crossings"]
    assert (gained["delay_s"], gained["direction"], gained["jump"]) == (DESIGNED, "stable", True)
    assert (lost["direction"], lost["unstable_roots_after"]) == ("unstable", 2)
    assert lost["frequency_hz"] == WINDOWS.crossings[1].frequency_hz
    assert lost["mode"]


def test_the_first_loss_from_no_delay_is_named_with_its_mode(capsys, tmp_path: Path) -> None:
    detuned = tmp_path / "detuned.npz"
    save_policy(DelayLqg(VEHICLE, DESIGNED, noise=1.0), detuned)
    found = answer(capsys, "critical-delay", str(detuned), "--max-delay", "0.02")
    first = found["crossings"][0]
    assert 0.0 < found["critical_delay_sampled_s"] == first["delay_s"] < PERIOD
    assert (found["frequency_hz"], found["mode"]) == (first["frequency_hz"], first["mode"])
    words = run(capsys, "critical-delay", "--controller", str(detuned), "--max-delay", "0.02")[1]
    assert f"critical delay, sampled               {1000 * first['delay_s']:.3f} ms" in words


def test_the_windows_are_printed_plainly(capsys, path: str) -> None:
    words = run(capsys, "critical-delay", "--controller", path, "--max-delay", "0.1")[1]
    high = 1000 * WINDOWS.stable_windows[0][1]
    assert f"UNSTABLE WITHOUT DELAY: {WINDOWS.unstable_without_delay} unstable roots" in words
    assert f"stable: 50.0 to {high:.1f} ms (searched to 0.1 s)" in words
    assert "delays from 0 to 0.1 s" in words
    assert "(jump)" in words
    assert "proved: no (exact to rounding; windows shorter than 2.5 ms can be missed)" in words


def test_without_a_window_that_is_said(capsys, path: str) -> None:
    words = run(capsys, "critical-delay", "--controller", path, "--max-delay", "0.03")[1]
    assert "stable: at no delay that was looked at (searched to 0.03 s)" in words


def test_unless_typed_the_search_ends_at_the_shorter_default_and_says_so(
    capsys, path: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[float] = []

    def short(loop: SampledLoop, longest: float, **settings: object):
        asked.append(longest)
        return sampled_windows(loop, 0.02)

    monkeypatch.setattr(sampled_answers, "sampled_windows", short)
    words = run(capsys, "critical-delay", "--controller", path)[1]
    run(capsys, "critical-delay", "--controller", path, "--max-delay", "2")
    assert asked == [LONGEST_SCAN, 2.0]
    assert "delays from 0 to 0.6 s" in words
    assert "sampled laws 0.6" in run(capsys, "critical-delay", "--help")[1]


@pytest.mark.slow
def test_the_proofs_are_one_in_every_window_and_gap(capsys, path: str) -> None:
    found = answer(capsys, "critical-delay", path, "--max-delay", "0.07", "--prove-sampled")
    ends = [0.0, *WINDOWS.stable_windows[0], 0.07]
    proofs = found["sampled_proofs"]
    assert [proof["delay_s"] for proof in proofs] == pytest.approx(
        [(a + b) / 2 for a, b in pairwise(ends)]
    )
    assert [proof["verdict"] for proof in proofs] == ["UNSTABLE", "STABLE", "UNSTABLE"]
    assert found["proved"] is False


def test_roots_are_growth_rates_of_the_lifted_map(capsys, path: str) -> None:
    found = answer(capsys, "roots", path, "--delay", "0.05", "--count", "3")
    assert (found["method"], found["proved"], found["right_of"]) == ("sampled", False, None)
    assert len(found["roots"]) == 3
    # Two eigenvalue routines, with and without vectors: rounding.
    assert found["roots"][0]["re"] == pytest.approx(LOOP.growth_rate(0.05), rel=1e-6)
    assert found["roots"][0]["re"] < 0.0
    words = run(capsys, "roots", "--controller", path, "--delay", "0.07")[1]
    assert "UNSTABLE at this delay (sampled every 10 ms, growth rates ln(z) / T" in words


def test_roots_take_one_delay_per_channel(capsys, path: str) -> None:
    found = answer(capsys, "roots", path, "--delay", "0.05,0.05,0.05,0.051", "--count", "1")
    wanted = LOOP.growth_rate((0.05, 0.05, 0.05, 0.051))
    assert found["roots"][0]["re"] == pytest.approx(wanted, rel=1e-6)


@pytest.mark.parametrize(
    ("delay", "status", "verdict"), [("0.05", 0, "STABLE"), ("0", 3, "UNSTABLE")]
)
@pytest.mark.slow
def test_a_verdict_is_proved_with_the_hold(
    capsys, path: str, delay: str, status: int, verdict: str
) -> None:
    arguments = ("--controller", path, "--delay", delay, "--control-period", "0.01", "--json")
    found, out, _ = run(capsys, "certify", *arguments)
    assert found == status
    assert json.loads(out)["verdict"] == verdict


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("certify", "--delay", "0.05"), "--control-period 0.01"),
        (("certify", "--delay", "0.05", "--vary", "speed_kmh=200:300"), "drop --vary"),
        (("certify", "--delay", "0.05", "--control-period", "0.02"), "use the same for both"),
        (("critical-delay", "--method", "pade:4"), "sampled law"),
        (("critical-delay", "--max-delay", "9"), "max_delay = 9 s is"),
        (("critical-delay", "--control-period", "0.02"), "use the same for both"),
        (("critical-delay", "--model", "full50"), "use --method simulation"),
        (("roots", "--delay", "0.05", "--method", "pade:4"), "sampled law"),
    ],
)
def test_what_cannot_be_asked_of_a_sampled_law_is_refused_with_the_way_out(
    capsys, path: str, arguments: tuple[str, ...], message: str
) -> None:
    assert message in refusal(capsys, arguments[0], "--controller", path, *arguments[1:])


def test_a_chart_of_a_sampled_law_is_refused(capsys, path: str) -> None:
    axes = ("--x", "speed_kmh=200:300:2", "--y", "conicity=0.1:0.2:2")
    status, _, err = run(capsys, "chart", "--controller", path, *axes)
    assert status in (1, 2)
    assert "is a sampled law and has no continuous loop" in err


def test_the_continuous_oracle_is_not_asked_about_a_sampled_law() -> None:
    with pytest.raises(ArgumentError, match="certify with --control-period"):
        delay_system(LAW, VEHICLE)


class OnlySampled:
    """A law of a user's own that knows neither actuators nor a continuous loop."""

    def __init__(self, result: object = LOOP) -> None:
        self.result = result

    def reset(self, num_lanes: int, seed: int) -> None: ...

    def act(self, observations: np.ndarray) -> np.ndarray:
        return np.zeros((len(observations), 4))

    def to_sampled_loop(self, vehicle: object, period: float) -> object:
        return self.result


def test_a_law_with_only_a_sampled_loop_is_a_sampled_law() -> None:
    assert is_sampled_only(OnlySampled())
    assert is_sampled_only(LAW)
    plain = LinearDynamic(([[0.0]], [[0.0] * 4], [[0.0]] * 4, np.eye(4)), LAW.sensors[:4], 4)
    assert not is_sampled_only(plain)
    assert not is_sampled_only(object())


def test_a_users_own_sampled_law_is_answered_and_checked() -> None:
    assert sampled_loop(OnlySampled(), VEHICLE, PERIOD) is LOOP
    with pytest.raises(ControllerError, match="must return a SampledLoop"):
        sampled_loop(OnlySampled(3), VEHICLE, PERIOD)
    with pytest.raises(ArgumentError, match="no to_sampled_loop"):
        sampled_loop(object(), VEHICLE, PERIOD)


def test_the_delay_a_law_is_designed_for_is_looked_at_if_it_is_searched() -> None:
    assert design_delays(LAW, 0.1) == (DESIGNED,)
    assert design_delays(LAW, 0.04) == ()
    assert design_delays(OnlySampled(), 1.0) == ()


def test_inside_its_window_the_law_holds_the_vehicle_and_beside_it_the_motion_grows() -> None:
    track = make_track("german_low", 2000.0, 0)
    delays = np.repeat([[0.05], [0.058], [0.062]], 4, axis=1)
    trajectory = rollout(
        LAW, VEHICLE, delays, 8.0, tracks=[track], track_of_lane=np.zeros(3, dtype=int)
    )
    floor = trajectory.signal("floor_front_lateral_acceleration")
    late = np.abs(np.nan_to_num(floor[:, -200:], nan=np.inf)).max(axis=1)
    # A held floor stays within some 0.2 m/s^2 on this track; beyond the window the motion grows
    # until the actuators' force limit bounds it, at some 5 m/s^2.
    assert late[0] < 0.5
    assert late[1] < 0.5
    assert late[2] > 3.0


def test_the_benchmark_knows_where_a_sampled_law_holds_the_vehicle(path: str) -> None:
    rows = rows_of(suite_of(block(delays_ms=(0.0, 50.0, 60.0))), path).values()
    unstable = {row["delay_s"]: row["unstable"] for row in rows}
    assert unstable == {0.0: True, 0.05: False, 0.06: True}


@pytest.mark.slow  # a scan of 0.6 s of delays
def test_the_benchmarks_critical_delay_of_a_sampled_law_is_an_end_of_its_windows(
    path: str,
) -> None:
    answer = stability_answer(StabilityWork(path, "4"))
    assert (answer["method"], answer["critical_delay_s"]) == ("sampled", 0.0)
    # Bracketed to half a millisecond, the middle of it is given.
    assert [low for low, _ in answer["windows_s"]] == pytest.approx([DESIGNED], abs=5e-4)
