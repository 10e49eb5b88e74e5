"""Policies out of zips of stable-baselines3: the same numbers, and nothing in them is executed."""

import base64
import io
import json
import pickle
import zipfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

from baselines.policies.convert_sb3 import convert_sb3
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.errors import ArgumentError, InputFileError


class Exploit:
    """Makes a file when it is unpickled."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def __reduce__(self) -> Any:
        return (open, (str(self.path), "w"))


def sb3_zip(path: Path, weights: Any, data: dict[str, Any]) -> Path:
    buffer = io.BytesIO()
    torch.save(weights, buffer)
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("data", json.dumps(data))
        archive.writestr("policy.pth", buffer.getvalue())
        archive.writestr("policy.optimizer.pth", b"not read")
    return path


def actor_weights(inputs: int) -> dict[str, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    shapes = {
        "mlp_extractor.policy_net.0": (8, inputs),
        "mlp_extractor.policy_net.2": (6, 8),
        "mlp_extractor.value_net.0": (8, inputs),
        "action_net": (2, 6),
        "value_net": (1, 6),
    }
    found = {"log_std": torch.zeros(2)}
    for name, (rows, columns) in shapes.items():
        found[f"{name}.weight"] = 0.3 * torch.randn((rows, columns), generator=generator)
        found[f"{name}.bias"] = 0.3 * torch.randn(rows, generator=generator)
    return found


CONFIG = """
[environment]
action = "bogies"
delay = [0.0, 0.2]
max_delay = 0.2
delay_observed = true
observation_history = 1
action_history = 2
"""


@pytest.mark.slow
def test_a_zip_with_a_pickle_in_data_is_converted_without_running_it(tmp_path: Path) -> None:
    made = tmp_path / "made"
    text = base64.b64encode(pickle.dumps(Exploit(made))).decode()
    data = {"policy_class": {":type:": "x", ":serialized:": text}, "gamma": 0.99}
    config = tmp_path / "env.toml"
    config.write_text(CONFIG)
    weights = actor_weights(2 * 16 + 2 * 2 + 1)
    file = sb3_zip(tmp_path / "ppo.zip", weights, data)
    found = convert_sb3(file, config)
    assert not made.exists()
    assert found.never_run == ("data: policy_class", "policy.optimizer.pth")
    # What the network says of the environment's own observation, by torch in single precision.
    env = Lateral17VectorEnv(2, **_environment())
    observation, info = env.reset(seed=1)
    for _ in range(30):
        observation, *_ = env.step(np.full((2, 2), 0.1, dtype=np.float32))
    told = np.array(info["told_delay"], dtype=float).reshape(2, -1)[:, 0]

    def said(values: np.ndarray) -> np.ndarray:
        hidden = torch.tensor(values, dtype=torch.float32)
        for name in ("mlp_extractor.policy_net.0", "mlp_extractor.policy_net.2"):
            hidden = torch.tanh(hidden @ weights[f"{name}.weight"].T + weights[f"{name}.bias"])
        return (hidden @ weights["action_net.weight"].T + weights["action_net.bias"]).numpy()

    rest = observation.copy()
    rest[:, :-1] = 0.0
    columns = found.policy.history.columns(env.observation_names)
    own = found.policy._decide(observation[:, columns].astype(float), told)
    np.testing.assert_allclose(own, said(observation) - said(rest), atol=1e-6)
    none = np.zeros((1, observation.shape[1]))
    np.testing.assert_allclose(found.at_rest, said(none)[0], atol=1e-6)


def _environment() -> dict[str, Any]:
    fields = {"delay": (0.0, 0.2), "max_delay": 0.2, "delay_observed": True}
    return {**fields, "action": "bogies", "observation_history": 1, "action_history": 2}


def test_a_zip_whose_weights_are_a_pickle_is_refused_and_not_executed(tmp_path: Path) -> None:
    made = tmp_path / "made"
    config = tmp_path / "env.toml"
    config.write_text(CONFIG)
    file = sb3_zip(tmp_path / "ppo.zip", {"action_net.weight": Exploit(made)}, {})
    with pytest.raises(InputFileError, match="more than weights"):
        convert_sb3(file, config)
    assert not made.exists()


def test_a_zip_that_is_of_another_kind_is_refused_by_name(tmp_path: Path) -> None:
    config = tmp_path / "env.toml"
    config.write_text(CONFIG)
    actor = {"actor.mu.weight": torch.zeros((2, 37)), "actor.mu.bias": torch.zeros(2)}
    for weights, match in (
        (actor, "has no action_net"),
        (actor_weights(20), "is given 37 inputs"),
        ([1, 2], "no set of weights"),
    ):
        with pytest.raises(InputFileError, match=match):
            convert_sb3(sb3_zip(tmp_path / "ppo.zip", weights, {}), config)
    (tmp_path / "bad.zip").write_bytes(b"PK\x03\x04rubbish")
    for name in ("bad.zip", "absent.zip"):
        with pytest.raises(InputFileError, match=name):
            convert_sb3(tmp_path / name, config)
    config.write_text("")
    with pytest.raises(ArgumentError, match=r"no table \[environment\]"):
        convert_sb3(tmp_path / "ppo.zip", config)


@pytest.mark.parametrize(
    "said",
    [
        {"policy_kwargs": {"activation_fn": "<class 'torch.nn.modules.activation.ReLU'>"}},
        {"policy_kwargs": {"squash_output": True}},
        {"policy_kwargs": {"features_extractor_class": "<class 'mine.Extractor'>"}},
        {"use_sde": True},
    ],
)
def test_an_actor_that_says_it_is_another_kind_is_refused(
    said: dict[str, Any], tmp_path: Path
) -> None:
    config = tmp_path / "config.toml"
    config.write_text(CONFIG)
    env = Lateral17VectorEnv(1, **_settings(config))
    inputs = env.single_observation_space.shape[0]
    env.close()
    path = sb3_zip(tmp_path / "a.zip", actor_weights(inputs), said)
    with pytest.raises(InputFileError, match=r"policy_kwargs|use_sde"):
        convert_sb3(path, config)
    harmless = {"policy_kwargs": {"activation_fn": "<class 'torch.nn.modules.activation.Tanh'>"}}
    convert_sb3(sb3_zip(tmp_path / "b.zip", actor_weights(inputs), harmless), config)


def _settings(config: Path) -> dict[str, Any]:
    import tomllib

    return tomllib.loads(config.read_text())["environment"]
