"""Trained policies as files: bit for bit, and nothing from a stranger's file is executed."""

import base64
import hashlib
import io
import json
import pickle
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from policy_examples import MAKERS, linear, network

from baselines import SkyHook, make_controller
from baselines.linear_dynamic import LinearDynamic
from baselines.policies import HistoryPolicy, load_trained, save_trained
from baselines.policies.folder import load_card
from baselines.policies.tensor_file import LARGEST_HEADER, parse_tensors, tensor_bytes
from railenv.errors import ArgumentError, InputFileError

ABOUT = {
    "description": "a policy of random numbers",
    "training": {"command": "railenv train x.toml", "seed": 3, "steps": 1000, "config": {"a": 1}},
    "score": {"worse_end": [1.5, 2.5]},
    "limits": ["not to be driven with"],
}


class Exploit:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return (open, (str(self.path), "w"))


def actions_of(policy: HistoryPolicy) -> np.ndarray:
    rng = np.random.default_rng(3)
    policy.reset(3, 0)
    policy.tell(np.array([0.0, 0.04, 0.2]))
    return np.array([policy.act(0.01 * rng.normal(size=(3, 16))) for _ in range(20)])


def continuous_law() -> LinearDynamic:
    rng = np.random.default_rng(1)
    matrices = (-np.diag([3.0, 20.0]), rng.normal(size=(2, 1)))
    outputs = 1e3 * rng.normal(size=(4, 2)), 1e3 * rng.normal(size=(4, 1))
    return LinearDynamic((*matrices, *outputs), ("carbody_roll_rate",), 4)


@pytest.mark.slow
@pytest.mark.parametrize("make", MAKERS)
@pytest.mark.parametrize("base", [None, SkyHook(10e3, 4), continuous_law()], ids=type)
def test_what_is_read_back_acts_bit_for_bit(make: Any, base: Any, tmp_path: Path) -> None:
    policy = make(base=base)
    save_trained(policy, tmp_path / "it", ABOUT)
    for place in (tmp_path / "it", tmp_path / "it" / "policy.safetensors"):
        again = load_trained(place)
        assert again.history == policy.history
        np.testing.assert_array_equal(actions_of(again), actions_of(policy))
    card = load_card(tmp_path / "it")
    assert {key: card[key] for key in ABOUT} == ABOUT


def test_a_sampled_base_comes_back_sampled(tmp_path: Path) -> None:
    base = make_controller("lqg")
    assert isinstance(base, LinearDynamic)
    policy = linear(base=base)
    save_trained(policy, tmp_path / "it")
    again = load_trained(tmp_path / "it")
    assert again.base.sampled == base.sampled
    np.testing.assert_array_equal(actions_of(again), actions_of(policy))


def test_one_policy_gives_the_same_bytes_again(tmp_path: Path) -> None:
    for name in "ab":
        save_trained(linear(), tmp_path / name, ABOUT)
    for file in ("policy.safetensors", "card.json"):
        assert (tmp_path / "a" / file).read_bytes() == (tmp_path / "b" / file).read_bytes()


def test_a_card_that_was_loaded_can_be_written_with_another_score(tmp_path: Path) -> None:
    save_trained(linear(), tmp_path / "it", ABOUT)
    card = load_card(tmp_path / "it")
    save_trained(load_trained(tmp_path / "it"), tmp_path / "it", {**card, "score": {"b": 2}})
    assert load_card(tmp_path / "it")["score"] == {"b": 2}
    np.testing.assert_array_equal(load_trained(tmp_path / "it").weights, linear().weights)


def test_the_format_is_that_of_the_safetensors_package(tmp_path: Path) -> None:
    package = pytest.importorskip("safetensors.numpy")
    policy = network()
    save_trained(policy, tmp_path / "it", ABOUT)
    content = (tmp_path / "it" / "policy.safetensors").read_bytes()
    theirs = package.load(content)
    np.testing.assert_array_equal(theirs["weights"], policy.weights)
    ours, texts = parse_tensors(tmp_path, package.save(theirs, {"card": "{}"}))
    assert texts == {"card": "{}"}
    assert set(ours) == set(theirs)
    for name, values in ours.items():
        np.testing.assert_array_equal(values, theirs[name])


def test_the_card_says_the_digest_of_the_file(tmp_path: Path) -> None:
    save_trained(linear(), tmp_path, ABOUT)
    card = json.loads((tmp_path / "card.json").read_text())
    content = (tmp_path / "policy.safetensors").read_bytes()
    assert card["sha256"] == hashlib.sha256(content).hexdigest()
    for changed in ({"score": {"worse_end": [1.0]}}, {"sha256": "0" * 64}):
        (tmp_path / "card.json").write_text(json.dumps({**card, **changed}))
        with pytest.raises(InputFileError, match=r"card\.json.*(differs|sha256)"):
            load_trained(tmp_path)
    load_trained(tmp_path / "policy.safetensors")


def test_a_pickle_in_any_place_is_refused_and_not_executed(tmp_path: Path) -> None:
    made = tmp_path / "made"
    attack = pickle.dumps(Exploit(made))
    pickle.loads(attack).close()
    assert made.exists()  # the crafted pickle works where it is unpickled
    made.unlink()
    save_trained(linear(), tmp_path / "it", ABOUT)
    content = (tmp_path / "it" / "policy.safetensors").read_bytes()
    length = int.from_bytes(content[:8], "little")
    text = base64.b64encode(attack).decode()
    buffer = io.BytesIO()
    torch.save(Exploit(made), buffer)
    for number, hostile in enumerate(
        (
            attack,
            buffer.getvalue(),
            len(attack).to_bytes(8, "little") + attack,
            content[: 8 + length] + attack,
            tensor_bytes({}, {"card": text}),
            tensor_bytes({}, {"card": json.dumps({":serialized:": text})}),
        )
    ):
        file = tmp_path / f"{number}.safetensors"
        file.write_bytes(hostile)
        with pytest.raises(InputFileError, match=file.name):
            load_trained(file)
    for hostile in (attack, json.dumps({"class": {":serialized:": text}}).encode()):
        (tmp_path / "it" / "card.json").write_bytes(hostile)
        with pytest.raises(InputFileError, match=r"card\.json"):
            make_controller(str(tmp_path / "it"))
    assert not made.exists()


def header_of(content: bytes) -> tuple[dict[str, Any], bytes]:
    length = int.from_bytes(content[:8], "little")
    return json.loads(content[8 : 8 + length]), content[8 + length :]


def with_header(header: dict[str, Any], data: bytes) -> bytes:
    text = json.dumps(header).encode()
    return len(text).to_bytes(8, "little") + text + data


def damaged_entry(content: bytes, **changes: Any) -> bytes:
    header, data = header_of(content)
    header["weights"] |= changes
    return with_header(header, data)


def damaged_card(content: bytes, place: tuple[str, ...], value: Any) -> bytes:
    header, data = header_of(content)
    card = json.loads(header["__metadata__"]["card"])
    inner = card
    for key in place[:-1]:
        inner = inner[key]
    inner[place[-1]] = value
    header["__metadata__"]["card"] = json.dumps(card)
    return with_header(header, data)


def with_weights(content: bytes, values: np.ndarray) -> bytes:
    header, _ = header_of(content)
    return tensor_bytes({"weights": values}, header["__metadata__"])


DAMAGES: list[tuple[str, Any, str]] = [
    ("empty", lambda c: b"", "no .safetensors file"),
    ("truncated header", lambda c: c[:40], "header would have"),
    ("truncated data", lambda c: c[:-8], "damaged"),
    ("bytes after the end", lambda c: c + b"12345678", "belong to no array"),
    ("oversize header", lambda c: (2**60).to_bytes(8, "little") + c[8:], "header would have"),
    (
        "header beyond the limit",
        lambda c: with_header({"__metadata__": {"a": "b" * LARGEST_HEADER}}, b""),
        "header would have",
    ),
    ("wrong dtype", lambda c: damaged_entry(c, dtype="F32"), "save it as F64"),
    ("unknown dtype", lambda c: damaged_entry(c, dtype={"a": 1}), "save it as F64"),
    ("huge shape", lambda c: damaged_entry(c, shape=[2**40, 2**40]), "not its size"),
    ("shape that wraps around", lambda c: damaged_entry(c, shape=[2**61, 1, 8]), "not its size"),
    ("negative shape", lambda c: damaged_entry(c, shape=[-1]), "whole numbers"),
    ("true as a number", lambda c: damaged_entry(c, shape=[True]), "whole numbers"),
    ("backward offsets", lambda c: damaged_entry(c, data_offsets=[8, 0]), "not its size"),
    ("a gap", lambda c: damaged_entry(c, shape=[1], data_offsets=[8, 16]), "damaged"),
    ("another key", lambda c: damaged_entry(c, code="x"), "nothing else"),
    ("deep JSON", lambda c: (10**5).to_bytes(8, "little") + b"[" * 10**5, "no usable JSON"),
    (
        "a key twice",
        lambda c: with_header({}, b"")[:8].replace(b"\x02", b"\x15") + b'{"a":{"b":1},"a":{}} ',
        "stands twice",
    ),
    ("no card", lambda c: with_header({}, b""), "no card"),
    ("metadata of numbers", lambda c: with_header({"__metadata__": {"a": 1}}, b""), "texts alone"),
    ("card of another format", lambda c: damaged_card(c, ("format",), "x"), "no trained policy"),
    ("card of another version", lambda c: damaged_card(c, ("version",), 2), "reads version 1"),
    ("card of another class", lambda c: damaged_card(c, ("class",), "tree"), "known: linear"),
    ("class that is no text", lambda c: damaged_card(c, ("class",), ["linear"]), "has class"),
    ("unknown key", lambda c: damaged_card(c, ("scores",), {}), "did you mean 'score'"),
    ("unknown key of training", lambda c: damaged_card(c, ("training", "sed"), 1), "'seed'"),
    ("score that is none", lambda c: damaged_card(c, ("score",), 3), "does not belong"),
    ("NaN in the card", lambda c: damaged_card(c, ("score", "a"), float("nan")), "NaN is no"),
    ("infinity in the card", lambda c: c.replace(b"2.5", b"1e999"), "no usable JSON|no .safet"),
    ("no history", lambda c: damaged_card(c, ("history",), []), "history must have"),
    ("unknown sensor", lambda c: damaged_card(c, ("history", "sensors"), ["x"] * 16), "sensor"),
    ("sensors of numbers", lambda c: damaged_card(c, ("history", "sensors"), [1]), "names"),
    (
        "lag without end",
        lambda c: damaged_card(c, ("history", "sensor_lags"), [0, 10**12]),
        "10000 are the most",
    ),
    ("another length", lambda c: damaged_card(c, ("history", "action_lags"), [1]), "weights has"),
    ("base of another kind", lambda c: damaged_card(c, ("base",), {"kind": "x"}), "base has kind"),
    ("no weights", lambda c: tensor_bytes({}, header_of(c)[0]["__metadata__"]), "no array"),
    ("NaN", lambda c: with_weights(c, linear().weights * np.nan), "not finite"),
    ("too large", lambda c: with_weights(c, linear().weights * 1e30), "beyond what"),
    (
        "an array of no use",
        lambda c: tensor_bytes(
            {"weights": linear().weights, "more": np.zeros(2)}, header_of(c)[0]["__metadata__"]
        ),
        "have no use",
    ),
]


@pytest.mark.parametrize(("damage", "match"), [d[1:] for d in DAMAGES], ids=[d[0] for d in DAMAGES])
def test_a_damaged_file_is_refused_by_name(damage: Any, match: str, tmp_path: Path) -> None:
    save_trained(linear(), tmp_path, ABOUT)
    content = (tmp_path / "policy.safetensors").read_bytes()
    file = tmp_path / "damaged.safetensors"
    file.write_bytes(damage(content))
    with pytest.raises(InputFileError, match=match) as caught:
        load_trained(file)
    assert "damaged.safetensors" in str(caught.value)


@pytest.mark.slow
def test_every_flipped_byte_is_refused_or_read_as_numbers(tmp_path: Path) -> None:
    save_trained(linear(sensor_lags=(0,), told_knots=()), tmp_path, ABOUT)
    content = (tmp_path / "policy.safetensors").read_bytes()
    rng = np.random.default_rng(0)
    file = tmp_path / "flipped.safetensors"
    for place in rng.integers(0, len(content), 200).tolist():
        flipped = bytearray(content)
        flipped[place] ^= int(rng.integers(1, 256))
        file.write_bytes(bytes(flipped))
        try:
            load_trained(file)
        except InputFileError:
            continue
    # Beside its card the same file is refused wherever it was changed.
    for place in (0, 9, len(content) // 2, len(content) - 1):
        flipped = bytearray(content)
        flipped[place] ^= 1
        (tmp_path / "policy.safetensors").write_bytes(bytes(flipped))
        with pytest.raises(InputFileError):
            load_trained(tmp_path)


def test_a_card_that_cannot_be_is_refused_before_anything_is_written(tmp_path: Path) -> None:
    for about, match in (
        ({"scores": {}}, "did you mean 'score'"),
        ({"score": 3}, "does not belong"),
        ({"score": {"a": float("inf")}}, "card"),
        ({"score": {"a": np.zeros(2)}}, "card"),
        ({"training": {"sed": 1}}, "did you mean 'seed'"),
        ({"score": {"a": "b" * 10**6}}, "bytes"),
    ):
        with pytest.raises(ArgumentError, match=match):
            save_trained(linear(), tmp_path / "it", about)
    assert list(tmp_path.iterdir()) == []


def test_what_is_no_policy_is_said_to_be_none(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "absent", tmp_path / "absent.safetensors"):
        with pytest.raises(InputFileError, match=path.name):
            load_trained(path)
    with pytest.raises(InputFileError, match="no FOLDER of a trained policy"):
        make_controller(str(tmp_path))
    with pytest.raises(ArgumentError, match="FOLDER of a trained policy"):
        make_controller(str(tmp_path / "absent"))
