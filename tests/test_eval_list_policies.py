"""`railenv list controllers`: shipped policies have a section of their own."""

from pathlib import Path

import pytest
from policy_examples import linear

from baselines.policies import save_trained
from eval.cli import main

SECTION = "shipped policies:"


def listed(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch, folder: Path
) -> list[str]:
    monkeypatch.setattr("baselines.policies.shipped.shipped_folder", lambda: folder)
    assert main(["list", "controllers"]) == 0
    return capsys.readouterr().out.splitlines()


def test_every_shipped_policy_has_one_line_in_a_section_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    save_trained(linear(), tmp_path / "one", {"description": "the first"})
    save_trained(linear(1), tmp_path / "another", {"description": "on two\nlines"})
    lines = listed(capsys, monkeypatch, tmp_path)
    assert len([line for line in lines if line.split()[0] == "another"]) == 1
    assert lines[lines.index(SECTION) :] == [
        SECTION,
        "  another  on two lines",
        "  one      the first",
    ]


def test_there_is_no_such_section_while_nothing_is_shipped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    lines = listed(capsys, monkeypatch, tmp_path)
    assert lines[0] == "controllers:"
    assert SECTION not in lines
