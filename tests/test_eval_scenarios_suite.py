"""Suites: products of lists, refused where a list makes no sense, and those that ship."""

import hashlib
import pickle
from functools import cache

import pytest

from eval.scenarios import CHANNELS, MODELS, VEHICLES, Suite, load_suite
from railenv.config import config_names, from_mapping
from railenv.errors import ArgumentError

BLOCK = {
    "name": "delay",
    "models": ["lateral17"],
    "vehicles": ["nominal"],
    "layouts": ["4"],
    "speeds_kmh": [300],
    "tracks": ["german_low"],
    "channels": ["constant", "jitter"],
    "delays_ms": [0, 100],
    "seeds": 2,
}
SUITE = {"name": "mine", "version": "v0", "controllers": [], "seconds": 10, "blocks": [BLOCK]}


def suite_of(changes: dict | None = None, **blocks: object) -> Suite:
    """A small suite with some entries changed, those of its block by keyword."""
    block = {**BLOCK, **blocks}
    return from_mapping(Suite, {**SUITE, "blocks": [block], **(changes or {})}, "suite 'mine'")


def test_a_block_is_the_product_of_its_lists() -> None:
    suite = suite_of(tracks=["german_low", "tb3352"], speeds_kmh=[250, 300])
    assert len(suite.scenarios) == 2 * 2 * 2 * 2 * 2
    assert len({s.key for s in suite.scenarios}) == len(suite.scenarios)


def test_a_suite_is_sent_to_workers_without_its_scenarios_and_has_them_there() -> None:
    suite = load_suite("standard")
    sent = pickle.dumps(suite)
    assert len(sent) < 10_000
    assert pickle.loads(sent) == suite
    assert pickle.loads(sent).scenarios == suite.scenarios


def test_a_scenario_of_two_blocks_is_run_once() -> None:
    other = {**BLOCK, "name": "speed", "speeds_kmh": [250, 300]}
    suite = suite_of({"blocks": [BLOCK, other]})
    assert len(suite.scenarios) == 8 + 8


@pytest.mark.parametrize(
    ("changes", "blocks", "words"),
    [
        ({"blocks": []}, {}, "no \\[\\[blocks\\]\\]"),
        ({"seconds": 4.9}, {}, "seconds = 4.9 s is too short"),
        ({"full_seconds": 1}, {}, "full_seconds = 1 s is too short"),
        ({"seconds": "20"}, {}, "seconds = '20' must be of type float"),
        ({"skip": -1}, {}, "skip = -1"),
        ({"time_step": 0.003}, {}, "control_period"),
        ({"skip": 0.013}, {}, "skip"),
        ({"seconds": 7.503}, {}, "seconds"),
        ({"full_seconds": 1e9}, {}, "full_seconds"),
        ({"name": ".."}, {}, "name"),
        ({}, {"delays_ms": [0, 300.5]}, "delays_ms"),
        ({}, {"delays_ms": [0, 1e300]}, "delays_ms"),
        ({}, {"speeds_kmh": [1e-6]}, "speeds_kmh"),
        ({}, {"speeds_kmh": [1001]}, "speeds_kmh"),
        ({}, {"seeds": 100_000_000_000}, "scenarios"),
        ({"force_limit": 0}, {}, "force_limit = 0"),
        ({"sensor_noise": -1}, {}, "sensor_noise = -1"),
        ({"name": "a/b"}, {}, "name = 'a/b'"),
        ({"version": ""}, {}, "version = ''"),
        ({"salt": "x"}, {}, "unknown key 'salt'"),
        ({"blocks": [{"name": "delay"}]}, {}, "missing models, vehicles"),
        ({}, {"speed": [300]}, "unknown key 'speed'; did you mean .*'speeds_kmh'"),
        ({}, {"speeds_kmh": []}, "block 'delay': speeds_kmh is empty"),
        ({}, {"seeds": 0}, "block 'delay': seeds = 0"),
        ({}, {"seeds": -3}, "block 'delay': seeds = -3"),
        ({}, {"seeds": True}, "must be of type int"),
        ({}, {"delays_ms": [0, 100, 100.0]}, "delays_ms has an entry twice"),
        ({}, {"layouts": [4]}, "must be of type str"),
        ({}, {"channels": ["wobble"]}, "unknown channel 'wobble'"),
        ({}, {"vehicles": ["new"]}, "unknown vehicle"),
        ({}, {"models": ["full50"], "vehicles": ["worn"]}, "takes from profiles"),
    ],
)
def test_a_suite_with_a_bad_entry_is_refused_by_name(
    changes: dict, blocks: dict, words: str
) -> None:
    with pytest.raises(ArgumentError, match=words):
        suite_of(changes, **blocks)


def test_a_condition_whose_tracks_have_different_delays_is_refused() -> None:
    # Track 2 would be scored by 200 ms alone and tracks 0 and 1 by three delays.
    more = {**BLOCK, "name": "more", "delays_ms": [200], "seeds": 3}
    with pytest.raises(ArgumentError, match="other delays on some tracks"):
        suite_of({"blocks": [BLOCK, more]})
    same = {**more, "seeds": 2}
    assert len(suite_of({"blocks": [BLOCK, same]}).scenarios) == 12


def test_the_longest_delay_and_its_jitter_have_room_in_the_loop() -> None:
    stepping = suite_of(delays_ms=[0, 300]).stepping()
    assert stepping.max_delay == pytest.approx(0.32, rel=1e-15)
    assert stepping.control_period == 0.01
    assert suite_of().stepping(0.05).control_period == 0.05


def test_the_nonlinear_vehicle_is_run_for_its_own_time() -> None:
    suite = suite_of({"full_seconds": 5, "skip": 6})
    assert suite.duration("lateral17") == 16.0
    assert suite.duration("full50") == 11.0


def test_a_suites_file_that_is_no_toml_or_not_there_is_an_error_of_its_file(tmp_path) -> None:
    path = tmp_path / "mine.toml"
    with pytest.raises(ValueError, match="cannot read"):
        load_suite(str(path))
    path.write_text("name = ")
    with pytest.raises(ValueError, match="not valid TOML"):
        load_suite(str(path))
    with pytest.raises(ArgumentError, match="did you mean 'quick'"):
        load_suite("quik")


# The suites that ship. What the issue asks of them; sizes are counted.

shipped = cache(load_suite)


@pytest.mark.parametrize("name", config_names("benchmark"))
def test_every_shipped_suite_loads_under_its_own_name(name: str) -> None:
    suite = shipped(name)
    assert suite.name == name
    assert suite.version == "v0"


# SHA-256 of the sorted keys, shortened. A suite of a version never changes: scores are compared by
# suite and version. What is changed here is a new version.
@pytest.mark.parametrize(
    ("name", "number", "digest"),
    [
        ("smoke", 12, "16524d7330156085"),
        ("quick", 204, "2d0f6ca73b1b66bb"),
        ("standard", 3_214, "bb38ad01263adb4a"),
        ("full", 55_808, "d23413b67cc2d5d8"),
    ],
)
def test_the_cells_of_a_shipped_suite_are_those_of_its_version(
    name: str, number: int, digest: str
) -> None:
    keys = sorted(s.key for s in shipped(name).scenarios)
    assert len(keys) == number
    assert hashlib.sha256("\n".join(keys).encode()).hexdigest()[:16] == digest


def test_smoke_asks_the_nonlinear_vehicle_nothing() -> None:
    assert {s.model for s in shipped("smoke").scenarios} == {"lateral17"}


@pytest.mark.parametrize("name", ["standard", "full"])
def test_standard_and_full_have_everything_that_there_is(name: str) -> None:
    found = shipped(name).scenarios
    assert len(found) >= 3000
    assert {s.model for s in found} == {*MODELS}
    assert {s.vehicle for s in found} == {*VEHICLES}
    assert {s.layout for s in found} == {"2", "4"}
    assert {s.channel.kind for s in found} == {*CHANNELS}
    assert {s.channel.delay_ms for s in found} == {0.0, 50.0, 100.0, 150.0, 200.0, 250.0, 300.0}
    assert {s.track for s in found} == {"tb3352", "german_low", "fra6"}
    speeds = {s.speed_kmh for s in found}
    assert {min(speeds), max(speeds)} == {200.0, 350.0}


def test_full_holds_all_of_standard_and_standard_all_places_of_quick() -> None:
    suites = {name: shipped(name) for name in ("quick", "standard", "full")}
    keys = {name: {s.key for s in suite.scenarios} for name, suite in suites.items()}
    assert keys["standard"] < keys["full"]
    families = {name: {s.family for s in suite.scenarios} for name, suite in suites.items()}
    assert families["quick"] <= families["standard"]


@pytest.mark.parametrize("name", ["quick", "standard", "full"])
def test_a_suite_that_ranks_has_two_tracks_or_more_in_every_condition(name: str) -> None:
    # One track has no spread, and the board no interval then.
    seeds: dict[str, set[int]] = {}
    for scenario in shipped(name).scenarios:
        seeds.setdefault(scenario.family, set()).add(scenario.seed)
    assert min(len(found) for found in seeds.values()) >= 2


@pytest.mark.parametrize("name", ["quick", "standard", "full"])
def test_every_condition_of_a_suite_that_ranks_goes_from_no_delay_to_300_ms(name: str) -> None:
    delays: dict[tuple, set[float]] = {}
    for s in shipped(name).scenarios:
        condition = (*s.place, s.track, s.channel.kind)
        delays.setdefault(condition, set()).add(s.channel.delay_ms)
    # The nonlinear vehicle takes longest, and has three in the quick suite.
    assert all({0.0, 100.0, 300.0} <= found for found in delays.values())


def test_a_cell_is_the_same_in_all_suites_of_a_version() -> None:
    # Its key says nothing of these, so that they must not differ under one version.
    found = {
        (s.seconds, s.full_seconds, s.skip, s.sensor_noise, s.time_step)
        for s in map(shipped, config_names("benchmark"))
    }
    assert found == {(20.0, 10.0, 10.0, 0.1, 0.005)}
    assert {shipped(name).force_limit for name in config_names("benchmark")} == {30e3}
