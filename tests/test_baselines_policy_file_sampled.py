"""Sampled laws in files: read back as they act, told apart from continuous ones, data only."""

import io
import json
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest

from baselines import LinearDynamic, load_policy, make_controller, save_policy
from railenv.envs.observation import sensor_names
from railenv.errors import InputFileError
from railenv.vehicle import lateral17

SENSORS = sensor_names("4")
COLUMNS = len(SENSORS)


def law(sampled: bool = True) -> LinearDynamic:
    """Thirty states, with entries of every size."""
    random = np.random.default_rng(2)
    A = random.normal(size=(30, 30)) / 12.0
    B = random.normal(size=(30, COLUMNS)) * 10.0 ** random.uniform(-8, 3, (30, COLUMNS))
    C, D = random.normal(size=(4, 30)), random.normal(size=(4, COLUMNS))
    return LinearDynamic((A, B, C, D), SENSORS, 4, 2500.0, 0.02, sampled=sampled)


@pytest.fixture
def path(tmp_path: Path) -> Path:
    place = tmp_path / "law.npz"
    save_policy(law(), place)
    return place


def actions(controller: LinearDynamic, readings: np.ndarray) -> np.ndarray:
    controller.reset(readings.shape[1], 0)
    return np.array([controller.act(reading) for reading in readings])


def test_a_sampled_law_acts_bit_for_bit_like_what_was_saved(path: Path) -> None:
    again = load_policy(path)
    assert isinstance(again, LinearDynamic)
    assert again.sampled
    readings = np.random.default_rng(1).normal(size=(9, 3, COLUMNS))
    np.testing.assert_array_equal(actions(again, readings), actions(law(), readings))
    assert (again.layout, again.sensors) == ("4", SENSORS)
    assert (again.action_scale, again.control_period) == (2500.0, 0.02)


def test_a_sampled_law_read_back_has_the_same_loop(path: Path) -> None:
    vehicle = lateral17("paper_fit", 4, 300.0)
    again, own = (c.to_sampled_loop(vehicle, 0.02) for c in (load_policy(path), law()))
    assert again.to_plain() == own.to_plain()


def test_the_same_matrices_in_continuous_time_stay_another_law(tmp_path: Path) -> None:
    place = tmp_path / "continuous.npz"
    save_policy(law(sampled=False), place)
    again = load_policy(place)
    assert isinstance(again, LinearDynamic)
    assert not again.sampled
    with np.load(place) as archive:
        # The form of files written before sampled laws existed.
        assert json.loads(str(archive["metadata"])) == {
            "format": "railenv policy",
            "version": 1,
            "kind": "linear_dynamic",
            "layout": "4",
            "sensors": list(SENSORS),
            "action_scale": 2500.0,
            "control_period": 0.02,
        }


def test_a_kind_of_its_own_keeps_a_reader_that_does_not_know_it_from_misreading(
    path: Path,
) -> None:
    with np.load(path) as archive:
        assert json.loads(str(archive["metadata"]))["kind"] == "sampled_linear_dynamic"
        assert sorted(archive) == ["A", "B", "C", "D", "metadata"]


def test_a_path_is_a_spec(path: Path) -> None:
    controller = make_controller(str(path), 2)
    assert isinstance(controller, LinearDynamic)
    assert (controller.sampled, controller.layout) == (True, "4")


def test_a_law_without_states_is_saved_too(tmp_path: Path) -> None:
    empty = np.zeros((0, 0)), np.zeros((0, 4)), np.zeros((4, 0)), np.eye(4)
    save_policy(LinearDynamic(empty, SENSORS[:4], 4, sampled=True), tmp_path / "law.npz")
    again = load_policy(tmp_path / "law.npz")
    assert isinstance(again, LinearDynamic)
    np.testing.assert_array_equal(again.law.D, np.eye(4))
    assert again.sampled


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"kind": "linear_feedback"}, "metadata of a linear_feedback are"),
        ({"kind": "sampled_linear_feedback"}, "kind 'sampled_linear_feedback'; known"),
        ({"sampled": False}, "metadata of a sampled_linear_dynamic are"),
        ({"sampled": True}, "metadata of a sampled_linear_dynamic are"),
        ({"control_period": 0.0}, "control_period = 0"),
        ({"control_period": None}, "control_period = None"),
        ({"control_period": [0.01]}, "control_period"),
        ({"action_scale": -1.0}, "action_scale = -1"),
        ({"layout": "2"}, r"law has shape \(4, 16\)|unknown sensor"),
        ({"sensors": list(SENSORS)[:3]}, r"it must be \(4, 3\)"),
        ({"A": np.zeros((30, 29))}, "A has shape"),
        ({"A": np.full((30, 30), np.inf)}, "not finite"),
        ({"B": np.zeros((29, COLUMNS))}, "B has shape"),
        ({"C": np.zeros(30)}, "dimensions"),
        ({"D": np.zeros((4, COLUMNS), complex)}, "complex128 values"),
        ({"D": np.array(["a"])}, "holds text"),
        ({"gain": np.ones((4, COLUMNS))}, "arrays of a sampled_linear_dynamic are A, B, C, D"),
    ],
)
def test_a_changed_file_is_refused_by_name(path: Path, change: dict, message: str) -> None:
    with np.load(path) as archive:
        contents = dict(archive)
    metadata = json.loads(str(contents["metadata"]))
    for key, value in change.items():
        (contents if isinstance(value, np.ndarray) else metadata)[key] = value
    contents["metadata"] = np.array(json.dumps(metadata))
    np.savez(path, **contents)
    with pytest.raises(InputFileError, match=message) as caught:
        load_policy(path)
    assert "law.npz" in str(caught.value)


@pytest.mark.parametrize("missing", ["A", "D", "metadata"])
def test_a_file_that_lacks_an_array_is_refused(path: Path, missing: str) -> None:
    with np.load(path) as archive:
        contents = {name: archive[name] for name in archive if name != missing}
    np.savez(path, **contents)
    with pytest.raises(InputFileError, match=r"are A, B, C, D|no text 'metadata'"):
        load_policy(path)


def test_a_pickled_matrix_is_never_opened(path: Path, tmp_path: Path) -> None:
    class Trap:
        def __reduce__(self):
            return os.mkdir, (str(tmp_path / "sprung"),)

    with np.load(path) as archive:
        contents = dict(archive)
    stream = io.BytesIO()
    np.save(stream, np.array([[Trap()]], dtype=object), allow_pickle=True)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("A.npy", stream.getvalue())
        for name in ("B", "C", "D", "metadata"):
            part = io.BytesIO()
            np.save(part, contents[name])
            archive.writestr(f"{name}.npy", part.getvalue())
    with pytest.raises(InputFileError, match="object values"):
        load_policy(path)
    assert not (tmp_path / "sprung").exists()


def test_half_a_file_is_refused(path: Path) -> None:
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputFileError, match=r"law\.npz"):
        load_policy(path)
