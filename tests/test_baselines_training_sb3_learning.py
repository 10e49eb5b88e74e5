"""PPO of the shipped settings learns, and with credit that ends before the force it does not."""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytestmark = pytest.mark.learning

CONFIG = Path(__file__).parent.parent / "configs" / "train" / "ppo-linear.toml"
STEPS = 600_000


def rewards(trace: float) -> list[float]:
    """Mean reward of a control period in every update, exploration included."""
    from baselines.training.method import method_class
    from baselines.training.one_thread import one_thread
    from baselines.training.settings import load_settings

    settings = load_settings(CONFIG)
    settings = settings.replace(hyper=dataclasses.replace(settings.hyper, trace=trace))
    with one_thread():
        method: Any = method_class("ppo")(settings, 0)
        method.begin()
        found: list[float] = []
        while method.steps < STEPS:
            found.append(method.update()["reward"])
    return found


def test_ppo_learns_with_credit_over_a_second_and_gets_worse_with_a_tenth(
    record_property: Callable[[str, object], None],
) -> None:
    pytest.importorskip("stable_baselines3")
    right, wrong = rewards(0.98), rewards(0.5)
    start = float(np.mean(right[:3]))
    learnt, lost = (float(np.mean(each[-5:])) for each in (right, wrong))
    record_property(
        "printed",
        f"PPO, {STEPS / 1e6:g} M steps: reward {start:.2f}, with trace 0.98 {learnt:.2f}, with "
        f"trace 0.5 {lost:.2f}",
    )
    # Five updates scatter by 0.05; another seed moves either by 0.1.
    assert learnt > start + 0.15
    assert lost < start
    assert learnt > lost + 0.5
