"""A controller's own layout beside a typed one, and what is not told the delay beside its error."""

from pathlib import Path

import numpy as np
import pytest
from policy_examples import gated, linear

from baselines import make_controller
from baselines.policies import HistoryPolicy, save_trained
from eval.cli import main
from eval.policy_score_references import (
    LQG,
    SKYHOOK,
    layout_beside,
    passive_and_skyhook,
    with_designs,
)
from eval.policy_score_runs import Trial, comfort_of
from eval.told_designs import ToldDesigns
from railenv.errors import ArgumentError

COMMANDS = {
    "critical-delay": ("--max-delay", "0.02"),
    "simulate": ("--seconds", "6"),
    "roots": ("--delay", "0.1"),
    "certify": ("--delay", "0.01", "--control-period", "0.01"),
}
TRIAL = Trial(tracks=1, seconds=5.0, skip=2.0, delays=(0.1,))


def saved(folder: Path, policy: HistoryPolicy) -> str:
    save_trained(policy, folder)
    return str(folder)


@pytest.mark.parametrize("command", COMMANDS)
@pytest.mark.parametrize(("own", "typed"), [(2, "4"), (4, "2"), (4, "passive")])
def test_a_typed_layout_that_is_not_the_policys_own_is_refused(
    command: str, own: int, typed: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = saved(tmp_path / "p", linear(layout=own, size=0.003))
    arguments = [command, "--controller", spec, *COMMANDS[command]]
    assert main([*arguments, "--layout", typed]) == 2
    line = capsys.readouterr().err
    for words in (f"layout = '{typed}'", spec, f"acts on layout '{own}'", "drop --layout"):
        assert words in line


@pytest.mark.parametrize("arguments", [(), ("--layout", "2")])
def test_the_policys_own_layout_is_run_where_no_other_is_typed(
    arguments: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = saved(tmp_path / "p", linear(layout=2, size=0.003))
    assert main(["roots", "--controller", spec, "--delay", "0.1", *arguments]) == 0
    assert f"{spec}, layout 2," in capsys.readouterr().out


def test_the_nonlinear_vehicle_refuses_another_layout_too(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = saved(tmp_path / "p", linear(layout=2, size=0.003))
    question = ["simulate", "--controller", spec, "--seconds", "6", "--model", "full50"]
    assert main([*question, "--layout", "4"]) == 2
    assert "acts on layout '2'" in capsys.readouterr().err


def test_passive_goes_beside_any_layout(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["roots", "--controller", "passive", "--delay", "0", "--layout", "4"]) == 0
    assert "layout passive" in capsys.readouterr().out


def test_score_refuses_another_layout(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    spec = saved(tmp_path / "p", linear(layout=2, size=0.003))
    for extra in ((), ("--check",)):
        assert main(["score", spec, "--layout", "4", "--quick", *extra]) == 2
        assert "acts on layout '2'" in capsys.readouterr().err


def test_policies_of_two_layouts_have_no_references_together() -> None:
    two, four = linear(layout=2), linear()
    with pytest.raises(ArgumentError, match=r"'a' on layout '2'.*'b' on layout '4'.*one by one"):
        layout_beside([("a", two), ("b", four)])
    passive = make_controller("passive", "passive")
    assert layout_beside([("p", passive), ("a", two)]) == "2"
    assert layout_beside([("p", passive)]) == "4"


def test_references_act_on_the_layout_of_the_policies(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eval.policy_score_references.SKYHOOK_GAINS", (10e3,))
    monkeypatch.setattr("eval.policy_score_references.DESIGNED", {LQG: "lqg-delay:delay={delay}"})
    found = with_designs(passive_and_skyhook(TRIAL, layout="2"), TRIAL)
    hook = comfort_of(make_controller("skyhook:gain=10e3", "2"), TRIAL)
    np.testing.assert_array_equal(found.rows[SKYHOOK].front, hook.front)
    law = comfort_of(make_controller("lqg-delay:delay=0.1", "2"), TRIAL)
    np.testing.assert_array_equal(found.rows[LQG].front, law.front)
    # The damping of twice as many actuators is another, so that the layouts can be told apart.
    four = comfort_of(make_controller("skyhook:gain=10e3", "4"), TRIAL)
    assert np.abs(four.front - hook.front).min() > 1e-3


def test_laws_side_by_side_have_the_layout_of_each() -> None:
    designs = ToldDesigns(lambda _: make_controller("skyhook", "2"))
    assert getattr(designs, "layout", None) == "2"


@pytest.mark.parametrize("kind", ["gated", "linear", "skyhook"])
def test_certify_refuses_a_told_error_of_what_is_told_nothing(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    spec = kind
    if kind != "skyhook":
        make = {"gated": gated, "linear": linear}[kind]
        spec = saved(tmp_path / kind, make(told_knots=()))
    question = ["certify", "--controller", spec, "--delay", "0.1", "--control-period", "0.01"]
    assert main([*question, "--told-error", "0.02"]) == 2
    line = capsys.readouterr().err
    for words in ("told_error = 0.02 s", spec, "not told the delay", "leave it out"):
        assert words in line


def test_certify_refuses_a_told_error_of_a_sampled_file_without_a_schedule(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    # x' = -x + u, u = -y / 2 every 0.1 s; the file has no place for a schedule.
    one = np.ones((1, 1))
    path = tmp_path / "loop.npz"
    np.savez(path, A=-one, B=one, C=one, Dc=-0.5 * one, period=0.1)
    question = ["certify", "--system", str(path), "--delay", "0.1"]
    assert main(question) == 0
    assert main([*question, "--told-error", "0.02"]) == 2
    assert "is not told the delay; leave it out" in capsys.readouterr().err
