"""Every controller that can be named answers the commands: listed, judged, simulated, saved."""

import json
from typing import Any

import numpy as np
import pytest

from baselines import (
    LinearDynamic,
    LinearFeedback,
    load_policy,
    make_controller,
    registered_controllers,
    save_policy,
)
from eval.cli import _COMMANDS as COMMANDS
from eval.cli import main
from railenv.errors import ArgumentError

NAMES = [entry.name for entry in registered_controllers()]
SEMI_ACTIVE = {"semiactive-onoff", "semiactive-skyhook", "clipped-lqg"}


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    assert main([*arguments, "--json"]) == 0
    return json.loads(capsys.readouterr().out)


def test_the_list_names_every_controller_with_settings_and_source(
    capsys: pytest.CaptureFixture[str],
) -> None:
    listed = answer(capsys, "list", "controllers")["controllers"]
    for entry in registered_controllers():
        spec = next(spec for spec in listed if spec.partition(":")[0] == entry.name)
        for key in entry.settings:
            assert f"{key}=" in spec
        assert entry.description in listed[spec]
        assert entry.source in listed[spec]
        assert "\n" not in listed[spec]


def _quick(names: list[str]) -> list[Any]:
    """Names, those whose design takes seconds marked as slow."""
    slow = pytest.mark.slow
    return [pytest.param(n, marks=slow) if n.startswith("robust-") else n for n in names]


@pytest.mark.parametrize("name", _quick(NAMES))
def test_the_listed_spec_builds_the_controller(name: str) -> None:
    entry = next(entry for entry in registered_controllers() if entry.name == name)
    settings = ",".join(f"{key}={value}" for key, (value, _) in entry.settings.items())
    spec = f"{name}:{settings}" if settings else name
    assert type(make_controller(spec)) is type(make_controller(name))


@pytest.mark.parametrize("name", _quick(sorted(set(NAMES) - SEMI_ACTIVE)))
def test_every_other_law_is_linear_and_survives_a_file(name: str, tmp_path) -> None:
    law = make_controller(name)
    assert isinstance(law, LinearFeedback | LinearDynamic)
    file = tmp_path / "law.npz"
    save_policy(law, file)
    again = load_policy(file)
    readings = np.random.default_rng(1).normal(size=(3, len(law.measures)))
    for one in (law, again):
        one.reset(3, 0)
    for _ in range(3):
        np.testing.assert_array_equal(law.act(readings), again.act(readings))


@pytest.mark.parametrize("name", sorted(SEMI_ACTIVE))
def test_the_oracle_refuses_a_semi_active_law_and_says_what_to_ask(
    name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["critical-delay", "--controller", name]) == 2
    assert "--method simulation" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize("layout", ["2", "4"])
@pytest.mark.parametrize("name", sorted(set(NAMES) - SEMI_ACTIVE))
def test_the_oracle_answers_for_every_linear_law(
    name: str, layout: str, capsys: pytest.CaptureFixture[str]
) -> None:
    found = answer(capsys, "critical-delay", "--controller", name, "--layout", layout)
    assert "stable_windows_s" in found
    law = make_controller(name, layout)
    if getattr(law, "sampled", False):
        delay = getattr(law, "delay")  # noqa: B009
        inside = [low <= delay < high for low, high in found["stable_windows_s"]]
        assert any(inside), "a law that is told a delay is stable there"
    else:
        assert found["proved"]


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_every_law_is_judged_by_simulation(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["critical-delay", "--method", "simulation", "--max-delay", "0.3"]
    found = answer(capsys, *arguments, "--controller", name)
    assert found["method"] == "simulation"
    exact = answer(capsys, "critical-delay", "--controller", name) if name == "skyhook" else None
    if exact is not None:
        # The bracket is half a millisecond wide.
        assert found["critical_delay_sampled_s"] == pytest.approx(
            exact["critical_delay_sampled_s"], abs=5e-4
        )


@pytest.mark.parametrize(
    ("spec", "words"),
    [
        ("skyhook:gain=1e300", "gain holds 1e+300"),
        ("predictor:gain=1e300", "law.A holds"),
        ("lqg-delay:noise=1e-12", "cannot be designed"),
        ("lqr:effort=1e-300", "cannot be designed"),
        ("hinf:force_weight=1e-300", "cannot be designed"),
        ("hinf:delay=5", "delay = 5 s is too long"),
        ("robust-abscissa:delay=1e9", "too long"),
        ("lqg-delay:preview=1,design_kmh=1", "without preview"),
        ("lqg-delay:preview=2", "preview = 2 must be 0 (no) or 1 (yes)"),
        ("lqg-delay:track=tb3352", "no rational density"),
        ("smith:delay=-1", "delay"),
        ("semiactive-onoff:lowest=3e4,highest=1e4", "highest"),
    ],
)
def test_settings_that_cannot_be_are_refused_in_one_line(
    spec: str, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["critical-delay", "--controller", spec, "--max-delay", "0.3"]) == 2
    said = capsys.readouterr()
    assert words in said.err
    assert said.err.count("\n") == 1
    assert said.out == ""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("spec", "words"),
    [("robust-delay:decay=100", "decay = 100"), ("robust-delay:comfort=1e-9", "comfort = 1e-09")],
)
def test_a_goal_that_cannot_be_had_is_said(spec: str, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        make_controller(spec)


def test_a_law_on_the_linear_states_is_refused_on_the_nonlinear_vehicle(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["simulate", "--model", "full50", "--controller", "lqr", "--seconds", "6"]) == 2
    assert "use --model lateral17" in capsys.readouterr().err


@pytest.mark.parametrize("command", sorted(COMMANDS))
def test_every_command_has_a_help_page(command: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main([command, "--help"]) == 0
    assert f"railenv {command}" in capsys.readouterr().out
