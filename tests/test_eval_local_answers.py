"""The oracle's answers about policies that are not linear: of the law at rest, and said so."""

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from policy_examples import VEHICLE, gated, linear, network, recurrent

from baselines import make_controller
from baselines.policies import HistoryPolicy, LinearPolicy, save_trained
from eval.cli import main
from eval.stability_answers import words_of_rest

ROOTS = ("roots", "--delay", "0.04", "--count", "2")
HIDDEN: dict[str, Any] = {"told_knots": ()}
NOT_LINEAR = [network, recurrent, gated]


def printed(capsys: pytest.CaptureFixture[str], policy: HistoryPolicy, folder: Path) -> str:
    save_trained(policy, folder)
    assert main([*ROOTS, "--controller", str(folder)]) == 0
    return capsys.readouterr().out.partition("\n")[2]  # below the title, which is the folder


def answer(
    capsys: pytest.CaptureFixture[str], policy: HistoryPolicy, folder: Path
) -> dict[str, Any]:
    save_trained(policy, folder)
    assert main([*ROOTS, "--controller", str(folder), "--json"]) == 0
    return json.loads(capsys.readouterr().out)


@pytest.mark.parametrize("make", NOT_LINEAR)
def test_roots_of_a_policy_that_is_not_linear_are_said_to_be_local(
    make: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = make(**HIDDEN)
    found = answer(capsys, policy, tmp_path)
    assert (found["local"], found["proved"]) == (True, False)
    at_rest = policy.law_at().to_sampled_loop(VEHICLE, 0.01).growth_rate(0.04)
    # The same loop and the same eigenvalues, to rounding.
    assert found["roots"][0]["re"] == pytest.approx(at_rest, abs=1e-9)
    line = f"local: {type(policy).__name__} is not linear; this is its law at rest"
    assert line in printed(capsys, policy, tmp_path)


def test_roots_of_a_gated_policy_are_those_of_the_gains_its_gates_mix_at_rest(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    policy = gated(**HIDDEN)
    policy.reset(1, 0)
    for _ in range(2000):  # until the unit stands still
        policy.act(np.zeros((1, len(policy.measures))))
    mixed = policy.weights + np.einsum("j,jaf->af", policy.gates[0], policy.experts)
    same = answer(capsys, LinearPolicy(policy.history, mixed), tmp_path / "mixed")
    found = answer(capsys, policy, tmp_path / "gated")
    assert (same["local"], found["local"]) == (False, True)
    # Two realisations of one law: their maps' eigenvalues differ by rounding, 1.3e-13 1/s here.
    expected, got = ([(r["re"], r["im"]) for r in each["roots"]] for each in (same, found))
    np.testing.assert_allclose(got, expected, atol=1e-9)


@pytest.mark.parametrize("make", [network, linear])
def test_the_windows_of_a_policy_say_whether_they_are_local(
    make: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trained(make(**HIDDEN), tmp_path)
    scan = ("critical-delay", "--controller", str(tmp_path), "--max-delay", "0.02")
    assert main([*scan, "--json"]) == 0
    found = json.loads(capsys.readouterr().out)
    assert found["local"] == (make is network)
    assert main(scan) == 0
    assert ("local: NetworkPolicy is not linear" in capsys.readouterr().out) == found["local"]


def test_the_gates_at_rest_are_named_for_a_gated_policy_alone(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert "at rest, the gates at rest, and" in printed(capsys, gated(**HIDDEN), tmp_path / "g")
    assert "gates" not in printed(capsys, recurrent(**HIDDEN), tmp_path / "r")


@pytest.mark.parametrize("fields", [{}, HIDDEN])
def test_roots_of_a_linear_policy_are_not_said_to_be_local(
    fields: dict[str, Any], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert answer(capsys, linear(**fields), tmp_path)["local"] is False
    assert "local" not in printed(capsys, linear(**fields), tmp_path)


def test_classical_laws_are_linear_and_need_no_words() -> None:
    for spec in ("passive", "skyhook"):
        assert words_of_rest(make_controller(spec)) is None


@pytest.mark.parametrize("make", NOT_LINEAR)
@pytest.mark.parametrize("command", [("critical-delay",), ("roots", "--delay", "0.04")])
def test_a_told_policy_that_is_not_linear_has_no_one_loop(
    make: Any, command: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trained(make(), tmp_path)
    assert main([*command, "--controller", str(tmp_path)]) == 2
    line = capsys.readouterr().err
    assert line.count("\n") == 1
    assert "another law for every told delay" in line
    for way in ("--method simulation", "railenv score"):
        assert way in line


@pytest.mark.slow
def test_the_way_out_by_simulation_is_open(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trained(network(), tmp_path)
    arguments = ("--method", "simulation", "--max-delay", "0.02", "--json")
    assert main(["critical-delay", "--controller", str(tmp_path), *arguments]) == 0
    assert json.loads(capsys.readouterr().out)["method"] == "simulation"
