"""`railenv benchmark` called from a test: its answer, its refusal, and work without processes."""

import json
from typing import Any

import pytest

from eval.cli import main
from eval.workers import InlinePool, Limits


class Inline(InlinePool):
    """Takes the place of worker processes, and notes how many there would be."""

    made: list[tuple[int, Limits]]

    def __init__(self, jobs: int, limits: Limits, owner: object = None) -> None:
        type(self).made.append((jobs, limits))


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict[str, Any]:
    assert main(["benchmark", *arguments, "--json"]) == 0
    out = capsys.readouterr().out
    assert out.count("\n") == 1
    return json.loads(out)


def refusal(capsys: pytest.CaptureFixture[str], *arguments: str, status: int = 2) -> str:
    assert main(["benchmark", *arguments]) == status
    out, err = capsys.readouterr()
    assert out == ""
    assert err.count("\n") == 1
    assert err.startswith("railenv benchmark: ")
    return err
