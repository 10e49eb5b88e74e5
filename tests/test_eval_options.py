"""Options of the command line: each one reaches the answer it is for, and what is printed."""

import json
from argparse import Namespace
from typing import Any

import numpy as np
import pytest

from baselines import SkyHook
from eval import command_simulate, command_stability
from eval.arguments import parse_stepping
from eval.cli import main
from eval.measures import measure
from eval.rollout import Stepping, rollout
from eval.stability_answers import delay_system
from railenv.actuation import ActuatorSpec
from railenv.simulation import required_length, wheelset_inputs
from railenv.stability import critical_delays, rightmost_roots, sampled_critical_delay
from railenv.track import make_track
from railenv.vehicle import lateral17

pytestmark = pytest.mark.slow

GAIN = ("--controller", "skyhook:gain=25e3")
LOOP = {
    "--layout": "2",
    "--vehicle": "published_typical",
    "--speed-kmh": "250",
    "--control-period": "0.02",
    "--actuator-lag": "0.03",
}
RUN = LOOP | {"--track": "german_low", "--seed": "3", "--seconds": "8", "--skip": "2"}
RUN |= {"--delay": "0.07,0.11"}


def flat(options: dict[str, str]) -> list[str]:
    return [word for pair in options.items() for word in pair]


def answer(capsys: pytest.CaptureFixture[str], command: str, options: dict[str, str]) -> Any:
    assert main([command, *GAIN, *flat(options), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def printed(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(list(arguments)) == 0
    return capsys.readouterr().out


def test_simulate_does_the_run_that_every_option_says(capsys) -> None:
    vehicle = lateral17("published_typical", 2, 250.0)
    track = make_track("german_low", required_length(vehicle, 8.0), 3)
    trajectory = rollout(
        SkyHook(25e3, 2),
        vehicle,
        np.array([[0.07, 0.11]]),
        8.0,
        track_inputs=wheelset_inputs(vehicle, track, 0.005, 1600)[None],
        stepping=Stepping(0.02, 0.005, ActuatorSpec(lag=0.03)),
    )
    assert answer(capsys, "simulate", RUN)["measures"] == measure(trajectory, 2.0, 30e3).lane(0)


def test_simulate_says_what_was_run(capsys) -> None:
    assert answer(capsys, "simulate", RUN)["settings"] == {
        "controller": "skyhook:gain=25e3",
        "layout": "2",
        "vehicle": "published_typical",
        "model": "lateral17",
        "speed_kmh": 250.0,
        "track": "german_low",
        "seed": 3,
        "delay_s": [0.07, 0.11],
        "seconds": 8.0,
        "skip_s": 2.0,
        "control_period_s": 0.02,
        "time_step_s": 0.005,
        "physics_step_s": 0.005,
        "actuator_lag_s": 0.03,
        "force_limit_n": 30e3,
        "sensor_noise": 0.0,
    }


@pytest.mark.parametrize(
    ("option", "other"),
    [
        ("--layout", "4"),
        ("--vehicle", "paper_fit"),
        ("--speed-kmh", "240"),
        ("--control-period", "0.01"),
        ("--actuator-lag", "0"),
        ("--track", "tb3352"),
        ("--seed", "4"),
        ("--seconds", "7"),
        ("--skip", "1"),
        ("--delay", "0.07"),
        ("--sensor-noise", "0.1"),
    ],
)
def test_every_option_of_simulate_changes_its_measures(capsys, option: str, other: str) -> None:
    changed = RUN | {option: other}
    if option == "--layout":
        changed["--delay"] = "0.07"
    first = answer(capsys, "simulate", RUN)["measures"]
    second = answer(capsys, "simulate", changed)["measures"]
    assert first["floor_rms_rear"] != second["floor_rms_rear"]


def test_the_controller_is_given_the_seed_too(capsys, monkeypatch: pytest.MonkeyPatch) -> None:
    seeds = []
    monkeypatch.setattr(SkyHook, "reset", lambda self, lanes, seed: seeds.append(seed))
    answer(capsys, "simulate", RUN)
    assert seeds == [3]


@pytest.mark.parametrize(("seconds", "skip"), [("10", 5.0), ("9", 0.0)])
def test_five_seconds_are_skipped_if_as_many_are_left(capsys, seconds: str, skip: float) -> None:
    settings = answer(capsys, "simulate", {"--seconds": seconds})["settings"]
    assert settings["skip_s"] == skip


@pytest.mark.parametrize(("front", "rear"), [(2.25, 2.6), (2.6, 2.25)])
def test_the_worse_floor_that_is_printed_is_the_worse_one(
    capsys, monkeypatch: pytest.MonkeyPatch, front: float, rear: float
) -> None:
    class Made:
        def lane(self, index: int) -> dict[str, Any]:
            return {"ride_index_front": front, "ride_index_rear": rear, "diverged": False}

    monkeypatch.setattr(command_simulate, "measure", lambda *_: Made())
    out = printed(capsys, "simulate", *GAIN, "--seconds", "5")
    assert "worse floor end: Wz 2.600 (good)" in out


def stepping(period: str) -> Stepping:
    return parse_stepping(Namespace(control_period=period, actuator_lag="0"))


@pytest.mark.parametrize(
    ("period", "step"),
    [
        ("0.001", 0.001),
        ("0.005", 0.005),
        ("0.006", 0.003),
        ("0.01", 0.005),
        ("0.012", 0.004),
        ("0.015", 0.005),
        ("0.05", 0.005),
        ("0.1", 0.005),
    ],
)
def test_the_physics_step_is_the_largest_whole_part_up_to_5_ms(period: str, step: float) -> None:
    # one division: rounding
    assert stepping(period).time_step == pytest.approx(step, rel=1e-12)


def test_the_control_period_is_what_was_given() -> None:
    assert stepping("0.012").control_period == 0.012


def loop(lag: float = 0.03) -> Any:
    vehicle = lateral17("published_typical", 2, 250.0)
    return delay_system(SkyHook(25e3, 2), vehicle, ActuatorSpec(lag=lag))


def test_critical_delay_answers_for_the_loop_that_every_option_says(capsys) -> None:
    found = answer(capsys, "critical-delay", LOOP | {"--max-delay": "1.5"})
    assert [c["delay_s"] for c in found["crossings"]] == [
        c.delay for c in critical_delays(loop(), 1.5).crossings
    ]


def test_the_sampled_critical_delay_has_the_control_period_that_was_given(capsys) -> None:
    found = answer(capsys, "critical-delay", LOOP | {"--max-delay": "1"})
    assert found["control_period_s"] == 0.02
    assert found["critical_delay_sampled_s"] == sampled_critical_delay(
        loop(), critical_delays(loop(), 1.0), 0.02
    )


@pytest.mark.parametrize(
    ("option", "other"),
    [
        ("--layout", "4"),
        ("--vehicle", "paper_fit"),
        ("--speed-kmh", "200"),
        ("--actuator-lag", "0"),
    ],
)
def test_every_option_of_the_loop_changes_its_critical_delay(
    capsys, option: str, other: str
) -> None:
    first = answer(capsys, "critical-delay", LOOP | {"--max-delay": "1"})
    second = answer(capsys, "critical-delay", LOOP | {"--max-delay": "1", option: other})
    assert first["critical_delay_s"] != second["critical_delay_s"]


def test_the_longest_delay_bounds_the_crossings(capsys) -> None:
    longer = answer(capsys, "critical-delay", {"--max-delay": "1"})["crossings"]
    longest = (longer[1]["delay_s"] + longer[2]["delay_s"]) / 2
    shorter = answer(capsys, "critical-delay", {"--max-delay": str(longest)})
    assert shorter["max_delay_s"] == longest
    assert [c["delay_s"] for c in shorter["crossings"]] == [c["delay_s"] for c in longer[:2]]


def test_the_search_by_simulation_has_the_stepping_and_longest_delay_that_were_given(
    capsys, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: dict[str, Any] = {}
    monkeypatch.setattr(
        command_stability, "simulated_critical_delay", lambda *_, **settings: asked.update(settings)
    )
    options = flat(LOOP | {"--max-delay": "0.7", "--method": "simulation"})
    main(["critical-delay", *GAIN, *options, "--json"])
    assert asked["max_delay"] == 0.7
    assert asked["stepping"] == Stepping(0.02, 0.005, ActuatorSpec(lag=0.03))


def test_continuous_and_sampled_delay_are_printed_on_their_own_lines(capsys) -> None:
    options = {"--max-delay": "0.5", "--layout": "4"}
    found = answer(capsys, "critical-delay", options)
    words = " ".join(printed(capsys, "critical-delay", *GAIN, *flat(options)).split())
    continuous, sampled = (1000 * found[f"critical_delay_{k}s"] for k in ("", "sampled_"))
    assert f"continuous {continuous:.3f} ms" in words
    assert f"sampled every 10 ms {sampled:.3f} ms" in words


def test_roots_are_those_of_the_loop_that_every_option_says(capsys) -> None:
    options = LOOP | {"--delay": "0.1,0.3", "--count": "4"}
    found = [complex(r["re"], r["im"]) for r in answer(capsys, "roots", options)["roots"]]
    estimates = [mode.root for mode in rightmost_roots(loop(), (0.1, 0.3), 4)]
    assert found == pytest.approx(estimates, rel=1e-10)  # the estimates' own rounding
