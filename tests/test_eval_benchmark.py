"""The benchmark: suites, records, failures kept to their own cells, same rows on any jobs."""

import json
from pathlib import Path

import numpy as np
import pytest

from eval.benchmark import run_benchmark
from eval.records import read_records
from eval.scenarios import Suite, load_suite
from railenv.config import config_names, from_mapping, to_dict
from railenv.errors import ArgumentError, InputFileError, OutputError

SMOKE = load_suite("smoke")


def changed(**entries: object) -> Suite:
    return from_mapping(Suite, {**to_dict(SMOKE), **entries}, "test")


@pytest.mark.parametrize("name", config_names("benchmark"))
def test_every_shipped_suite_loads_and_names_its_cells_once(name: str) -> None:
    suite = load_suite(name)
    assert suite.version.startswith(name)
    assert len(set(suite.groups())) == len(list(suite.groups()))


def test_the_quick_suite_is_what_the_readme_says() -> None:
    suite = load_suite("quick")
    gains = [c for c in suite.controllers if c.startswith("skyhook")]
    assert suite.layouts == ("2", "4")
    assert (gains[0], gains[-1]) == ("skyhook:gain=7.5e3", "skyhook:gain=60e3")
    assert (suite.delays[0], suite.delays[-1]) == (0.0, 0.3)
    assert suite.tracks == ("tb3352", "german_low")


@pytest.fixture(scope="module")
def records(tmp_path_factory: pytest.TempPathFactory) -> dict:
    folder = tmp_path_factory.mktemp("smoke")
    run_benchmark(SMOKE, folder, "railenv benchmark --suite smoke")
    return read_records(folder)


def test_records_hold_a_row_for_every_cell(records: dict) -> None:
    keys = [cell["key"] for cell in records["cells"]]
    assert len(keys) == len(set(keys)) == 2 * 3


def test_records_hold_the_oracles_answer(records: dict) -> None:
    answer = next(s for s in records["stability"] if s["controller"].startswith("skyhook"))
    assert answer["critical_delay_s"] == pytest.approx(0.20203, abs=1e-5)
    assert answer["critical_delay_sampled_s"] == pytest.approx(0.19705, abs=1e-5)
    names = [mode["name"] for mode in answer["root_locus"]["modes"]]
    assert {"upper centre roll", "lower centre roll", "carbody yaw"} <= set(names)


def test_the_locus_crosses_where_the_crossing_is(records: dict) -> None:
    answer = next(s for s in records["stability"] if s["controller"].startswith("skyhook"))
    locus = answer["root_locus"]
    mode = next(m for m in locus["modes"] if m["name"] == "upper centre roll")
    crossing = np.interp(0.0, mode["re"][45:60], locus["delay_s"][45:60])
    # linear between points 4 ms apart
    assert crossing == pytest.approx(answer["critical_delay_s"], abs=1e-4)


def test_the_passive_vehicle_is_the_same_at_every_delay(records: dict) -> None:
    rows = [c for c in records["cells"] if c["controller"] == "passive"]
    assert len({row["ride_index_front"] for row in rows}) == 1


@pytest.mark.slow
def test_two_workers_give_the_same_rows(records: dict, tmp_path: Path) -> None:
    run_benchmark(SMOKE, tmp_path, "test", jobs=2)
    assert read_records(tmp_path)["cells"] == records["cells"]


def test_a_controller_that_fails_costs_its_own_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "failing_law.py").write_text(
        "class Law:\n"
        "    def reset(self, num_lanes, seed): pass\n"
        "    def act(self, observations): raise RuntimeError('gave up')\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    suite = changed(controllers=["py:failing_law:Law", "passive"])
    found = run_benchmark(suite, tmp_path / "out", "test")
    assert "gave up" in found["failures"][0]["error"]
    assert {cell["controller"] for cell in found["cells"]} == {"passive"}


@pytest.mark.slow
def test_a_nonlinear_controller_is_bracketed_by_simulation(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "nonlinear_law.py").write_text(
        "import numpy as np\n"
        "class Law:\n"
        "    def reset(self, num_lanes, seed): pass\n"
        "    def act(self, observations): return -5.0 * np.tanh(2.0 * observations[:, :4])\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    suite = changed(controllers=["py:nonlinear_law:Law"], delays_ms=[0.0, 40.0])
    answer = run_benchmark(suite, tmp_path / "out", "test")["stability"][0]
    assert answer["method"] == "simulation"
    assert answer["critical_delay_sampled_s"] is None


@pytest.mark.parametrize(
    ("entries", "message"),
    [
        ({"vehicle": "paper"}, "paper_fit"),
        ({"layouts": ["3"]}, "choose passive, 2 or 4"),
        ({"delays_ms": [-1.0]}, "delays_ms"),
        ({"speeds_kmh": [0.0]}, "speeds_kmh"),
        ({"tracks": ["tb"]}, "track"),
        ({"controllers": []}, "empty"),
        ({"duration": 7.0}, "longer"),
        ({"time_step": 0.003}, "whole multiple"),
        ({"seeds": [1.5]}, "type int"),
        ({"seed": 1}, "did you mean 'seeds'"),
    ],
)
def test_a_bad_suite_is_refused_by_entry(entries: dict, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        changed(**entries)


def test_a_folder_that_cannot_be_written_is_refused_before_the_work(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(OutputError, match="cannot write"):
        run_benchmark(SMOKE, tmp_path / "file" / "sub", "test")


@pytest.mark.parametrize(
    "content", ["", "[]", '{"schema": 99}', '{"schema": 1}', "\x00\x01", "not json"]
)
def test_records_of_another_form_are_refused(tmp_path: Path, content: str) -> None:
    (tmp_path / "records.json").write_text(content)
    with pytest.raises(InputFileError, match=r"records\.json"):
        read_records(tmp_path)


def test_records_are_plain_json_without_nan(tmp_path: Path, records: dict) -> None:
    json.dumps(records, allow_nan=False)


def test_an_oracle_that_cannot_answer_costs_no_cells(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "neutral_law.py").write_text(
        "import numpy as np\nfrom baselines import LinearFeedback\n"
        "from railenv.envs.observation import sensor_names\n"
        "def make(): return LinearFeedback(np.eye(4) * 100, sensor_names('4')[4:8], 4)\n"
    )
    monkeypatch.syspath_prepend(str(tmp_path))
    found = run_benchmark(changed(controllers=["py:neutral_law:make"]), tmp_path / "out", "test")
    assert len(found["cells"]) == 3
    assert {cell["unstable"] for cell in found["cells"]} == {None}
    assert "neutral" in found["failures"][0]["error"]


def test_cells_carry_the_oracles_word_at_their_delay(records: dict) -> None:
    rows = [c for c in records["cells"] if c["controller"].startswith("skyhook")]
    assert [(row["delay_s"], row["unstable"]) for row in rows] == [
        (0.0, False),
        (0.1, False),
        (0.25, True),
    ]
    assert {c["unstable"] for c in records["cells"] if c["controller"] == "passive"} == {False}
