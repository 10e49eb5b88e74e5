"""The benchmark's records: what is written is what is read, and what does not fit is refused."""

import dataclasses
import struct
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from store_examples import CELLS, SETTINGS, SPEC, cell, package

from eval.measures import RunMeasures
from eval.records import provenance
from eval.store.packages import write_package
from eval.store.reader import Reader
from eval.store.schema import COLUMNS, LOST, MEASURES, PLACES
from eval.store.store import Store
from railenv.errors import ArgumentError


@pytest.fixture
def store(tmp_path: Path):
    with Store.create(tmp_path / "run", SETTINGS) as made:
        made.begin_session("railenv benchmark")
        made.add_controller(SPEC, "untold")
        yield made


def bits(value: float) -> bytes:
    return struct.pack("<d", value)


def test_every_measure_of_a_run_but_diverged_has_its_column() -> None:
    measured = [field.name for field in dataclasses.fields(RunMeasures) if field.name != "diverged"]
    assert list(MEASURES) == [*measured, "stroke_peak", "derailment_quotient", "wheel_unloading"]


def test_a_cell_comes_back_as_it_was_written(store: Store) -> None:
    (written,) = package(3, 1)
    store.add_package(SPEC, "p3", [written], 1.25)
    (row,) = store.rows()
    places = {name: getattr(written, name) for name in PLACES if hasattr(written, name)}
    expected = {"controller": SPEC, "package": "p3", "unstable": False, **places}
    assert row == {**expected, **written.measures}
    assert list(row) == list(COLUMNS)
    assert store.packages() == [
        {"controller": SPEC, "package": "p3", "status": "done", "seconds": 1.25, "session": 1}
    ]


FLOATS = st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=1, max_size=30)


def test_every_finite_number_comes_back_bit_for_bit(store: Store) -> None:
    count = 0  # one store for all examples: a file each would take long

    @given(FLOATS)
    def check(values: list[float]) -> None:
        nonlocal count
        cells = [cell(count + i, measures={"force_rms": v}) for i, v in enumerate(values)]
        store.add_package(SPEC, f"p{count}", cells, 0.0)
        rows = {row["key"]: row["force_rms"] for row in store.rows(package=f"p{count}")}
        count += len(values)
        for written, value in zip(cells, values, strict=True):
            # the one exception: SQLite has no minus zero
            assert bits(rows[written.key]) == bits(0.0 if value == 0.0 else value)

    check()


@pytest.mark.parametrize("value", [5e-324, 1.7976931348623157e308, 2.0**53 + 2, 1e15, 1.0, 0.1])
def test_a_speed_and_a_delay_come_back_bit_for_bit(store: Store, value: float) -> None:
    store.add_package(SPEC, "p", [cell(speed_kmh=value, delay_s=value)], 0.0)
    (row,) = store.rows()
    assert (bits(row["speed_kmh"]), bits(row["delay_s"])) == (bits(value), bits(value))


def test_minus_zero_becomes_zero(store: Store) -> None:
    store.add_package(SPEC, "p", [cell(delay_s=-0.0, measures={"force_rms": -0.0})], 0.0)
    (row,) = store.rows()
    assert bits(row["force_rms"]) == bits(row["delay_s"]) == bits(0.0)


def test_what_was_not_measured_is_none_and_nan_in_an_array(store: Store) -> None:
    measures = {"force_rms": np.float64("nan"), "force_peak": None, "bogie_rms": np.float64(2.0)}
    store.add_package(SPEC, "p", [cell(measures=measures, unstable=None)], 0.0)
    (row,) = store.rows()
    names = ("force_rms", "force_peak", "stroke_peak", "unstable")
    assert [row[name] for name in names] == [None] * 4
    arrays = store.arrays(*names, "bogie_rms")
    assert all(np.isnan(arrays[name]).all() for name in names)
    assert arrays["bogie_rms"].tolist() == [2.0]


@pytest.mark.parametrize("value", [np.inf, -np.inf, "2.0", True])
def test_a_measure_that_is_no_finite_number_is_refused_by_name(store: Store, value) -> None:
    cells = [cell(0), cell(1, measures={"wheel_unloading": value})]
    with pytest.raises(ArgumentError, match=rf"german_low.*/1 of {SPEC}: wheel_unloading = "):
        store.add_package(SPEC, "p", cells, 0.0)
    assert (list(store.rows()), store.done()) == ([], set())


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"status": "okay"}, "unknown status.*'okay'; did you mean 'ok'"),
        ({"measures": {"force_rsm": 1.0}}, "unknown measure.*'force_rms'"),
        ({"measures": {"diverged": 1.0}}, "unknown measure"),
        ({"key": ""}, "key = '' is no usable name"),
        ({"vehicle": "a\0b"}, "vehicle = 'a.x00b' is no usable name"),
        ({"track": "\udcff"}, "track = .* is no usable name; give a text in UTF-8"),
        ({"layout": 4}, "layout = 4 is no usable name"),
        ({"seed": 2**63}, "seed = 9223372036854775808 is above"),
        ({"seed": -1}, "seed = -1 is too small"),
        ({"speed_kmh": 0.0}, "speed_kmh = 0 must be above zero"),
        ({"delay_s": -0.1}, "delay_s = -0.1 must not be negative"),
        ({"unstable": "yes"}, "unstable = 'yes'; give True, False or None"),
        ({"status": "timeout"}, "status = 'timeout' comes with measures"),
    ],
)
def test_a_cell_that_does_not_fit_is_refused_and_nothing_of_it_stays(
    store: Store, changes: dict, words: str
) -> None:
    with pytest.raises(ArgumentError, match=words):
        store.add_package(SPEC, "p", [cell(0), dataclasses.replace(cell(1), **changes)], 0.0)
    assert (list(store.rows()), store.done()) == ([], set())


def test_the_largest_seed_is_kept(store: Store) -> None:
    store.add_package(SPEC, "p", [cell(2**63 - 1)], 0.0)
    assert store.arrays("seed")["seed"].tolist() == [2**63 - 1]


def test_a_message_may_hold_anything_that_a_controller_says(store: Store) -> None:
    said = 'ValueError: "a,b"\n\0 \u00fc \udcff'
    store.add_package(SPEC, "p", [cell(status="failed", measures={}, message=said)], 0.0, True)
    (row,) = store.rows()
    assert row["message"] == said.replace("\udcff", "\\udcff")


def test_done_names_every_package_and_leaves_failed_ones_out_on_request(store: Store) -> None:
    store.add_package(SPEC, "a", [cell(0)], 1.0)
    lost = [cell(1, status="timeout", measures={})]
    store.add_package(SPEC, "b", lost, 120.0, failed=True)
    assert store.done() == {(SPEC, "a"), (SPEC, "b")}
    assert store.done(with_failed=False) == {(SPEC, "a")}


def test_a_failed_package_is_replaced_when_it_is_tried_again(store: Store) -> None:
    lost = [cell(i, status="memory", measures={}) for i in range(2)]
    store.add_package(SPEC, "p", lost, 9.0, failed=True)
    store.add_package(SPEC, "p", [cell(i) for i in range(2)], 1.0)
    assert [row["status"] for row in store.rows()] == ["ok", "ok"]
    assert [(p["status"], p["seconds"]) for p in store.packages()] == [("done", 1.0)]


def test_a_package_that_is_done_is_not_written_twice(store: Store) -> None:
    store.add_package(SPEC, "p", [cell(0)], 1.0)
    with pytest.raises(ArgumentError, match=r"package p of .* is done already"):
        store.add_package(SPEC, "p", [cell(1)], 1.0)
    assert len(list(store.rows())) == 1


@pytest.mark.parametrize("name", ["p", "q"])
def test_a_cell_belongs_to_one_package_once(store: Store, name: str) -> None:
    cells = [cell(0)]
    if name == "q":
        store.add_package(SPEC, "p", cells, 1.0)
    with pytest.raises(ArgumentError, match=r"/0 of .* is in package p already"):
        store.add_package(SPEC, name, [cell(1), *cells, *cells], 1.0)
    assert store.done() == ({(SPEC, "p")} if name == "q" else set())


def test_the_same_cell_of_two_controllers_is_two_cells(store: Store) -> None:
    store.add_controller("passive", "untold")
    for spec in (SPEC, "passive"):
        store.add_package(spec, "p", [cell(0)], 1.0)
    assert [row["controller"] for row in store.rows()] == ["passive", SPEC]
    assert [row["controller"] for row in store.rows(controller=SPEC)] == [SPEC]


def test_rows_are_those_that_were_asked_for(store: Store) -> None:
    store.add_package(SPEC, "p", [cell(0), cell(1, unstable=None), cell(2, speed_kmh=200.0)], 1.0)
    assert [row["seed"] for row in store.rows(unstable=None)] == [1]
    assert [row["seed"] for row in store.rows(speed_kmh=300, unstable=False)] == [0]
    assert store.arrays("seed", speed_kmh=200.0)["seed"].tolist() == [2]
    assert store.arrays("seed", "track", status="failed")["track"].shape == (0,)


def test_an_unknown_column_is_refused_where_it_is_asked_for(store: Store) -> None:
    with pytest.raises(ArgumentError, match=r"unknown column.*'ride_index'"):
        store.rows(ride_index=2.0)
    with pytest.raises(ArgumentError, match="unknown column"):
        store.arrays("key; DROP TABLE cells")


def test_a_package_needs_a_session_a_controller_of_the_run_and_cells(tmp_path: Path) -> None:
    with Store.create(tmp_path, SETTINGS) as store:
        store.add_controller(SPEC, "told", "0f" * 32)
        with pytest.raises(ArgumentError, match="no session has begun"):
            store.add_package(SPEC, "p", [cell()], 1.0)
        store.begin_session("x")
        with pytest.raises(ArgumentError, match="has no cells"):
            store.add_package(SPEC, "p", [], 1.0)
        with pytest.raises(ArgumentError, match="unknown controller of this run 'skyhook'"):
            store.add_package("skyhook", "p", [cell()], 1.0)
        with pytest.raises(ArgumentError, match="unknown controller of this run"):
            store.add_stability("skyhook", "4", "nominal", 300.0, {})


def test_a_controllers_file_must_be_the_one_that_the_run_was_begun_with(store: Store) -> None:
    store.add_controller("policy", "told", "0f" * 32)
    store.add_controller("policy", "told", "0f" * 32)
    with pytest.raises(ArgumentError, match=r"sha256 was 0f.* and is 1f"):
        store.add_controller("policy", "told", "1f" * 32)
    with pytest.raises(ArgumentError, match="division was told and is untold"):
        store.add_controller("policy", "untold", "0f" * 32)
    with pytest.raises(ArgumentError, match="unknown division"):
        store.add_controller("other", "known")
    with pytest.raises(ArgumentError, match="is no SHA-256"):
        store.add_controller("other", "told", "0F" * 32)
    assert [row["spec"] for row in store.controllers()] == ["policy", SPEC]


def test_an_answer_on_stability_comes_back_and_a_later_one_replaces_it(store: Store) -> None:
    answer = {"critical_delay_s": 0.1 + 0.2, "crossings": [{"delay_s": 1 / 3}], "proved": True}
    store.add_stability(SPEC, "4", "nominal", 300.0, {"critical_delay_s": None})
    store.add_stability(SPEC, "4", "nominal", 300.0, answer)
    store.add_stability(SPEC, "4", "worn", 300.0, {})
    where = {"controller": SPEC, "layout": "4", "vehicle": "nominal", "speed_kmh": 300.0}
    assert store.stability()[0] == {**where, "answer": answer}
    assert len(store.stability()) == 2
    with pytest.raises(ArgumentError, match="cannot be kept as JSON"):
        store.add_stability(SPEC, "4", "nominal", 300.0, {"critical_delay_s": float("inf")})


def test_a_session_says_what_provenance_says_and_when_it_ended(tmp_path: Path) -> None:
    known = provenance("railenv benchmark", 0.0)
    with Store.create(tmp_path, SETTINGS) as store:
        assert store.begin_session("railenv benchmark") == 1
        with pytest.raises(ArgumentError, match="session 1 has not ended"):
            store.begin_session("again")
        assert store.sessions()[0]["ended"] is None
        store.end_session()
        assert store.begin_session("railenv benchmark --resume") == 2
    with Reader.open(tmp_path) as records:
        first, second = records.sessions()
    assert first["versions"] == {"python": known["python"], **known["packages"]}
    assert [first[name] for name in ("command", "revision", "cores")] == [
        known[name] for name in ("command", "revision", "cores")
    ]
    assert known["platform"] in first["machine"]
    assert known["created"] <= first["started"] <= first["ended"] <= second["ended"]


def test_a_session_ends_with_an_error_too(tmp_path: Path) -> None:
    def interrupted(store: Store) -> None:
        with store:
            store.begin_session("x")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted(Store.create(tmp_path, SETTINGS))
    with Reader.open(tmp_path) as records:
        assert records.sessions()[0]["ended"] is not None


def test_an_interruption_in_the_middle_of_a_package_leaves_nothing_of_it(
    store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupted(*arguments: object) -> None:
        write_package(*arguments)  # the mark and all rows have been handed to SQLite
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr("eval.store.store.write_package", interrupted)
        with pytest.raises(KeyboardInterrupt):
            store.add_package(SPEC, "p", package(0), 1.0)
    assert (list(store.rows()), store.done()) == ([], set())
    store.add_package(SPEC, "p", package(0), 1.0)
    assert len(list(store.rows())) == CELLS


def test_no_status_without_numbers_has_any(store: Store) -> None:
    for seed, status in enumerate(LOST):
        store.add_package(SPEC, status, [cell(seed, status=status, measures={})], 1.0, failed=True)
    for row in store.rows():
        assert {row[name] for name in MEASURES} == {None}
