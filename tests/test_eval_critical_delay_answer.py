"""The oracle's words in JSON: crossings, windows, roots and the locus."""

from typing import Any

import pytest

from baselines import SkyHook
from eval import stability_answers
from eval.stability_answers import critical_delay_answer, delay_system, root_answers, root_locus
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError
from railenv.stability import count_unstable, critical_delays, rightmost_roots
from railenv.vehicle import LateralVehicle, lateral17

LONGEST, PERIOD = 1.0, 0.02


@pytest.fixture(scope="module")
def found(loop, vehicle: LateralVehicle) -> dict[str, Any]:
    """Three crossings to instability, one back, and two more."""
    return critical_delay_answer(loop, vehicle, PERIOD, LONGEST)


def test_the_loop_asked_about_has_crossings_in_both_directions(found) -> None:
    directions = [c["direction"] for c in found["crossings"]]
    assert directions == ["unstable"] * 3 + ["stable"] + ["unstable"] * 2


@pytest.mark.parametrize("index", range(6))
def test_unstable_roots_after_a_crossing_are_those_just_beyond_it(found, loop, index: int) -> None:
    crossing = found["crossings"][index]
    # half a millisecond beyond; the next crossing is 11 ms away
    assert crossing["unstable_roots_after"] == count_unstable(loop, crossing["delay_s"] + 5e-4)


@pytest.mark.parametrize("index", range(6))
@pytest.mark.slow
def test_a_direction_says_where_the_roots_go(found, loop, index: int) -> None:
    crossing = found["crossings"][index]
    delay = crossing["delay_s"]
    # half a millisecond on either side; the next crossing is 11 ms away
    more = count_unstable(loop, delay + 5e-4) > count_unstable(loop, delay - 5e-4)
    assert crossing["direction"] == ("unstable" if more else "stable")


def test_a_loop_unstable_without_delay_counts_from_there() -> None:
    fast = lateral17(layout=2, speed_kmh=900.0)
    system = SkyHook(35e3, 2).to_delay_system(fast)
    answered = critical_delay_answer(system, fast, PERIOD, 1.0)
    roots = answered["unstable_roots_without_delay"]
    assert (roots, answered["critical_delay_s"]) == (count_unstable(system), 0.0)
    crossing = answered["crossings"][0]
    # half a millisecond beyond; no other crossing is as near
    assert crossing["unstable_roots_after"] == count_unstable(system, crossing["delay_s"] + 5e-4)


def test_the_first_crossing_gives_frequency_and_mode(found) -> None:
    first = found["crossings"][0]
    keys = ("frequency_hz", "mode")
    assert [found[key] for key in keys] == [first[key] for key in keys]


def test_the_continuous_delay_is_the_first_crossing_and_the_sampled_one_is_before_it(found) -> None:
    assert found["critical_delay_s"] == found["crossings"][0]["delay_s"]
    # half a period, to second order in it
    assert found["critical_delay_s"] - found["critical_delay_sampled_s"] == pytest.approx(
        PERIOD / 2, abs=5e-4
    )


def test_a_loop_stable_in_two_windows_has_both() -> None:
    vehicle = lateral17(layout=2)
    windows = critical_delay_answer(SkyHook(25e3, 2).to_delay_system(vehicle), vehicle, 0.05, 1.5)[
        "stable_windows_s"
    ]
    first, second = critical_delays(SkyHook(25e3, 2).to_delay_system(vehicle), 1.5).crossings
    assert windows == [[0.0, first.delay], [second.delay, 1.5]]


def test_the_pade_model_answers_for_the_continuous_loop_alone(found, loop, vehicle) -> None:
    pade = critical_delay_answer(loop, vehicle, PERIOD, LONGEST, pade_order=4)
    assert pade["critical_delay_s"] != found["critical_delay_s"]
    assert pade["critical_delay_sampled_s"] == found["critical_delay_sampled_s"]


def test_an_actuators_lag_is_part_of_the_loop(vehicle: LateralVehicle) -> None:
    lagged = delay_system(SkyHook(35e3, 4), vehicle, ActuatorSpec(lag=0.02))
    assert lagged.num_states == delay_system(SkyHook(35e3, 4), vehicle).num_states + 4


def test_a_controller_that_is_not_linear_is_sent_to_the_simulation(vehicle) -> None:
    with pytest.raises(ArgumentError, match=r"object is not linear.*--method simulation"):
        delay_system(object(), vehicle)  # type: ignore[arg-type]


def test_roots_are_written_with_their_own_parts(loop, vehicle: LateralVehicle) -> None:
    (mode,) = rightmost_roots(loop, 0.25, 1)
    (written,) = root_answers([mode], vehicle)
    assert complex(written["re"], written["im"]) == mode.root
    assert written["damping_ratio"] == mode.damping_ratio < 0.0


@pytest.mark.parametrize("depth", [-12.0, -3.0])
def test_a_locus_leaves_out_branches_that_stay_deep(
    loop, vehicle: LateralVehicle, monkeypatch: pytest.MonkeyPatch, depth: float
) -> None:
    monkeypatch.setattr(stability_answers, "LOCUS_DELAYS_MS", (0, 10))
    monkeypatch.setattr(stability_answers, "LOCUS_DEPTH", -1e9)
    every = [max(r for r in m["re"] if r is not None) for m in root_locus(loop, vehicle)["modes"]]
    monkeypatch.setattr(stability_answers, "LOCUS_DEPTH", depth)
    kept = [max(r for r in m["re"] if r is not None) for m in root_locus(loop, vehicle)["modes"]]
    assert kept == [r for r in every if r > depth] != every


def test_the_locus_is_cut_at_12_per_second() -> None:
    assert stability_answers.LOCUS_DEPTH == -12.0
