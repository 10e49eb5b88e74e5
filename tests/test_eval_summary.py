"""What is said about a benchmark: the summary of its records and the oracle's words in JSON."""

from typing import Any

import pytest

from baselines import SkyHook
from eval import stability_answers
from eval.stability_answers import critical_delay_answer, delay_system, root_answers, root_locus
from eval.summary import (
    Point,
    first_diverged,
    gain_of,
    groups_of,
    summary_table,
    table_delays,
    tables_of,
)
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError
from railenv.stability import count_unstable, critical_delays, rightmost_roots
from railenv.vehicle import LateralVehicle, lateral17

WHERE = {"controller": "skyhook:gain=20e3", "layout": "2", "speed_kmh": 250.0}


def cell(delay: float, seed: int = 1, diverged: bool = False, **numbers: float | None) -> dict:
    """A cell whose every number tells what it is."""
    own = {
        "ride_index_front": 2.0 + delay,
        "ride_index_rear": 3.0 + delay,
        "bogie_rms": 0.25 + delay,
    }
    place = {"track": "tb3352", "seed": seed, "delay_s": delay, "diverged": diverged}
    return {**WHERE, **place, **own, **numbers}


def answer(**entries: Any) -> dict[str, Any]:
    return {
        **WHERE,
        "critical_delay_s": 0.5,
        "critical_delay_sampled_s": 0.25,
        "frequency_hz": 1.75,
        "mode": "carbody yaw",
        "method": "exact",
        "unstable_roots_without_delay": 0,
        **entries,
    }


def records(cells: list[dict], **entries: Any) -> dict[str, Any]:
    return {"cells": cells, "stability": [answer(**entries)], "failures": []}


def points(*cells: dict) -> list[Point]:
    (group,) = groups_of(records(list(cells)))
    return group.tracks["tb3352"]


@pytest.mark.parametrize(("field", "mean"), [("front", 2.5), ("rear", 3.5), ("bogie", 0.5)])
def test_a_point_holds_the_mean_over_the_seeds_of_its_own_measure(field: str, mean: float) -> None:
    second = {"ride_index_front": 3.0, "ride_index_rear": 4.0, "bogie_rms": 0.75}
    (point,) = points(cell(0.0), cell(0.0, seed=2, **second))
    assert getattr(point, field) == mean


@pytest.mark.parametrize(("front", "rear"), [(2.0, 3.0), (3.0, 2.0)])
def test_the_worse_end_is_the_one_with_the_larger_index(front: float, rear: float) -> None:
    (point,) = points(cell(0.0, ride_index_front=front, ride_index_rear=rear))
    assert point.worse == 3.0


def test_a_point_has_no_number_if_one_seed_blew_up() -> None:
    (point,) = points(cell(0.0), cell(0.0, seed=2, ride_index_front=None))
    assert (point.front, point.rear, point.worse) == (None, 3.0, None)


def test_points_come_by_rising_delay_in_milliseconds() -> None:
    assert [p.delay_ms for p in points(cell(0.29), cell(0.0), cell(0.1))] == [0.0, 100.0, 290.0]


def test_the_first_diverged_delay_is_the_shortest_one() -> None:
    found = points(cell(0.3, diverged=True), cell(0.1), cell(0.2, diverged=True), cell(0.0))
    assert first_diverged(found) == 200.0


def test_one_diverged_seed_makes_a_delay_diverged() -> None:
    assert first_diverged(points(cell(0.0), cell(0.1), cell(0.1, seed=2, diverged=True))) == 100.0


def test_where_nothing_diverged_there_is_no_first_delay() -> None:
    assert first_diverged(points(cell(0.0), cell(0.1))) is None


def test_tables_show_the_existing_delays_nearest_to_round_ones() -> None:
    delays = (0.0, 0.04, 0.09, 0.17, 0.21, 0.28, 0.5)
    found = groups_of(records([cell(d) for d in delays]))
    assert table_delays(found) == [0.0, 90.0, 210.0, 280.0]


def row(number: int, *cells: dict, **entries: Any) -> dict[str, str]:
    """The only row of one of the tables, by its heads."""
    _, heads, rows = tables_of(groups_of(records(list(cells), **entries)))[number]
    return dict(zip(heads, rows[0], strict=True))


@pytest.mark.parametrize(
    ("head", "text"),
    [
        ("controller", "skyhook:gain=20e3"),
        ("layout", "2"),
        ("km/h", "250"),
        ("critical [ms]", "500.0"),
        ("sampled [ms]", "250.0"),
        ("f [Hz]", "1.750"),
        ("mode", "carbody yaw"),
    ],
)
def test_the_stability_table_has_every_number_under_its_head(head: str, text: str) -> None:
    assert row(0, cell(0.0))[head] == text


def test_a_simulated_critical_delay_is_marked_as_an_estimate() -> None:
    found = row(0, cell(0.0), method="simulation", critical_delay_s=None)
    assert (found["critical [ms]"], found["sampled [ms]"]) == ("-", "~250.0")


@pytest.mark.parametrize(
    ("head", "text"),
    [
        ("0 ms", "3.00"),
        ("100 ms", "3.10"),
        ("200 ms", "3.20*"),
        ("300 ms", "3.30*"),
        ("diverges", "200"),
        ("bogie 0", "0.25"),
        ("bogie 300", "0.55"),
    ],
)
def test_the_comfort_table_has_every_number_under_its_head(head: str, text: str) -> None:
    cells = [cell(d, diverged=d > 0.15) for d in (0.0, 0.1, 0.2, 0.3)]
    assert row(1, *cells)[head] == text


def test_the_printed_table_holds_critical_before_sampled() -> None:
    line = next(x for x in summary_table(records([])).splitlines() if "carbody yaw" in x)
    assert line.split()[3:5] == ["500.0", "250.0"]


@pytest.mark.parametrize(
    ("entries", "stands"),
    [
        ({}, 500.0),
        ({"critical_delay_s": None}, 250.0),
        ({"critical_delay_s": None, "critical_delay_sampled_s": None}, None),
        ({"unstable_roots_without_delay": 2}, 0.0),
        ({"critical_delay_sampled_s": 0.0}, 0.0),
    ],
)
def test_a_loop_stands_its_continuous_delay_if_that_is_known(
    entries: dict, stands: float | None
) -> None:
    (group,) = groups_of(records([], **entries))
    assert group.stands_ms == stands


@pytest.mark.parametrize(
    ("spec", "gain"),
    [("skyhook", 35e3), ("skyhook:gain=7.5e3", 7.5e3), ("passive", None), ("py:gain=3:f", None)],
)
def test_a_gain_is_read_off_a_skyhook_alone(spec: str, gain: float | None) -> None:
    assert gain_of(spec) == gain


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
