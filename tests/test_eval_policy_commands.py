"""Trained policies at the command line: a folder is a SPEC like any other."""

import json
import shlex
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from policy_examples import VEHICLE, linear, network, recurrent
from test_baselines_policies_convert import CONFIG, Exploit, actor_weights, sb3_zip

from baselines import make_controller
from baselines.policies import HistoryPolicy, save_trained
from baselines.policies.shipped import shipped_descriptions, shipped_names
from eval.cli import main

QUICK = ("--seconds", "7", "--skip", "1", "--json")


@pytest.fixture
def told(tmp_path: Path) -> str:
    save_trained(linear(size=0.003), tmp_path / "told", {"description": "told"})
    return str(tmp_path / "told")


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(arguments) == 0
    return json.loads(capsys.readouterr().out)


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str) -> str:
    assert main(arguments) == 2
    return capsys.readouterr().err


@pytest.mark.slow
def test_simulate_says_the_growth_rate_as_it_is_told(
    told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = make_controller(told)
    assert isinstance(policy, HistoryPolicy)
    loop = policy.to_sampled_loop(VEHICLE, 0.01)
    for error in (0.0, -0.02, 0.03):
        found = answer(
            capsys,
            *("simulate", "--controller", told, "--delay", "0.1", "--told-error", str(error)),
            *QUICK,
        )
        assert found["settings"]["told_error_s"] == error
        # The same law in another realisation.
        expected = loop.growth_rate(0.1, 0.1 + error)
        assert found["growth_rate"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.slow
def test_a_policy_is_loaded_without_any_learning_package(told: str) -> None:
    code = (
        "import sys; from baselines import load_trained; "
        f"load_trained({told!r}); "
        "print([m for m in ('torch', 'safetensors', 'onnx', 'stable_baselines3') "
        "if m in sys.modules])"
    )
    found = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert found.stdout.strip() == "[]"


@pytest.mark.slow
def test_what_a_policy_is_told_changes_the_run(
    told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    runs = [
        answer(
            capsys,
            *("simulate", "--controller", told, "--delay", "0.1", "--told-error", error),
            *QUICK,
        )["measures"]["force_rms"]
        for error in ("0", "0.1", "-0.05")
    ]
    assert len(set(runs)) == 3


def test_a_told_error_beside_a_law_that_is_not_told_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trained(linear(told_knots=()), tmp_path)
    for spec in ("skyhook", str(tmp_path)):
        line = refusal(capsys, "simulate", "--controller", spec, "--told-error", "0.02", *QUICK)
        assert "not told the delay" in line
    line = refusal(capsys, "simulate", "--controller", "passive", "--told-error", "x", *QUICK)
    assert "told_error = 'x'" in line


def test_critical_delay_and_roots_take_a_folder_with_the_true_delay_told(
    told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = make_controller(told)
    assert isinstance(policy, HistoryPolicy)
    windows = answer(
        capsys, "critical-delay", "--controller", told, "--max-delay", "0.05", "--json"
    )
    assert windows["method"] == "sampled"
    roots = answer(
        capsys, "roots", "--controller", told + "/policy.safetensors", "--delay", "0.04", "--json"
    )
    own = policy.law_at(0.04).to_sampled_loop(VEHICLE, 0.01).growth_rate(0.04)
    assert roots["roots"][0]["re"] == pytest.approx(own, abs=1e-6)
    stable = any(low <= 0.04 < high for low, high in windows["stable_windows_s"])
    assert stable == (own < 0.0)


@pytest.mark.slow
def test_a_told_network_is_judged_by_simulation(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trained(network(), tmp_path / "network")
    spec = str(tmp_path / "network")
    line = refusal(capsys, "critical-delay", "--controller", spec)
    assert "--method simulation" in line
    found = answer(capsys, "simulate", "--controller", spec, "--delay", "0.1", *QUICK)
    policy = make_controller(spec)
    assert isinstance(policy, HistoryPolicy)
    expected = policy.law_at(0.1).to_sampled_loop(VEHICLE, 0.01).growth_rate(0.1)
    assert found["growth_rate"] == pytest.approx(expected, abs=1e-6)


@pytest.mark.slow  # a scan of 0.6 s of delays
def test_the_benchmark_scores_a_policy(
    told: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = str(tmp_path / "runs")
    given = ("--suite", "smoke", "--controller", told, "--jobs", "1")
    boards = answer(capsys, "benchmark", *given, "--out", out, "--json")["boards"]
    ranked = [s for board in boards for s in board["standings"] if s["controller"] == told]
    assert ranked
    assert {standing["division"] for standing in ranked} == {"told"}


def test_list_and_make_controller_know_the_shipped_policies(
    capsys: pytest.CaptureFixture[str],
) -> None:
    listed = answer(capsys, "list", "controllers", "--json")["controllers"]
    for name, description in shipped_descriptions().items():
        assert listed[name] == description
    for name in shipped_names():
        assert isinstance(make_controller(name), HistoryPolicy)
    assert "FOLDER" in listed


def test_a_shipped_policy_is_made_by_its_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = linear()
    save_trained(policy, tmp_path / "apg-example", {"description": "one line of the card"})
    monkeypatch.setattr("baselines.policies.shipped.shipped_folder", lambda: tmp_path)
    made = make_controller("apg-example")
    assert isinstance(made, HistoryPolicy)
    np.testing.assert_array_equal(made.weights, policy.weights)
    listed = answer(capsys, "list", "controllers", "--json")["controllers"]
    assert listed["apg-example"] == "one line of the card"
    assert "did you mean 'apg-example'" in refusal(
        capsys, "simulate", "--controller", "apg-exampel", *QUICK
    )


def test_a_damaged_folder_is_one_line_and_exit_status_two(
    told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (Path(told) / "policy.safetensors").write_bytes(b"rubbish that is long enough")
    line = refusal(capsys, "simulate", "--controller", told, *QUICK)
    assert line.count("\n") == 1
    assert "policy.safetensors" in line


def test_export_writes_a_model_and_says_how_far_it_is_off(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trained(recurrent(), tmp_path / "policy")
    file = str(tmp_path / "policy.onnx")
    found = answer(capsys, "export", str(tmp_path / "policy"), "--onnx", file, "--json")
    assert found["file"] == file
    assert 0.0 <= found["largest_difference"] < 1e-12
    assert Path(file).stat().st_size > 1000
    assert main(["export", str(tmp_path / "policy"), "--onnx", file]) == 0
    assert "100 random steps" in capsys.readouterr().out
    assert "give a trained policy" in refusal(capsys, "export", "skyhook", "--onnx", file)


def test_convert_sb3_says_that_it_executes_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    import base64
    import pickle

    made, config, out = tmp_path / "made", tmp_path / "env.toml", str(tmp_path / "policy")
    config.write_text(CONFIG)
    text = base64.b64encode(pickle.dumps(Exploit(made))).decode()
    data = {"lr_schedule": {":type:": "function", ":serialized:": text}}
    file = str(sb3_zip(tmp_path / "ppo.zip", actor_weights(37), data))
    arguments = ("convert-sb3", file, "--config", str(config), "--out", out)
    found = answer(capsys, *arguments, "--json")
    assert found["executed"] == []
    assert found["not_executed"] == ["data: lr_schedule", "policy.optimizer.pth"]
    assert main(arguments) == 0
    shown = capsys.readouterr().out
    assert "executed: nothing" in shown
    assert "data: lr_schedule" in shown
    assert not made.exists()
    assert isinstance(make_controller(out), HistoryPolicy)


def test_the_commands_of_a_conversion_can_be_pasted_whatever_the_paths(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "my files"
    folder.mkdir()
    config, out = folder / "the env.toml", str(folder / "it's a policy")
    config.write_text(CONFIG)
    file = str(sb3_zip(folder / "ppo 1.zip", actor_weights(37), {}))
    arguments = ["convert-sb3", file, "--config", str(config), "--out", out]
    assert main(arguments) == 0
    card = json.loads((Path(out) / "card.json").read_text())
    assert shlex.split(card["training"]["command"]) == ["railenv", *arguments]
    shown = capsys.readouterr().out.splitlines()[-1]
    assert shlex.split(shown.partition("next: ")[2])[:4] == [
        *("railenv", "simulate", "--controller"),
        out,
    ]
