"""Other environments in `railenv bench-speed`: what is stepped and counted, and what is missing."""

import sys
import types
import warnings
from typing import Any

import numpy as np
import pytest

from eval import bench, bench_peers
from eval.bench import Stepper


@pytest.fixture(autouse=True)
def _quick(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(bench, "WINDOW", 0.005)


def test_a_single_environment_is_reset_at_its_end() -> None:
    steps: list[str] = []

    class Short:
        def reset(self, seed: int | None = None) -> None:
            steps.append("reset")

        def step(self, action: int) -> tuple[None, float, bool, bool, dict[str, Any]]:
            steps.append(f"step {action}")
            return None, 0.0, len(steps) % 3 == 0, False, {}

        def close(self) -> None:
            steps.append("close")

    stepper = bench_peers.single_stepper(Short(), list(range(bench_peers.POOL)))
    assert [stepper.step(call) for call in range(3)] == [1, 1, 1]
    stepper.close()
    assert steps == ["reset", "step 0", "step 1", "reset", "step 2", "close"]


def fake_envpool(record: list[Any]) -> types.ModuleType:
    class Pool:
        def __init__(self, num_envs: int, batch_size: int, num_threads: int) -> None:
            record.append((num_envs, batch_size, num_threads))
            self.batch = batch_size

        def reset(self) -> None: ...

        def async_reset(self) -> None: ...

        def step(self, actions: Any) -> None:
            assert len(actions) == self.batch

        def recv(self) -> tuple[Any, ...]:
            return 0, 0, 0, 0, {"env_id": np.arange(self.batch)}

        def send(self, actions: Any, env_id: Any) -> None:
            assert len(actions) == len(env_id) == self.batch

        def close(self) -> None: ...

    module = types.ModuleType("envpool")
    module.make_gymnasium = lambda _, **given: Pool(**given)  # type: ignore[attr-defined]
    return module


def test_envpool_counts_what_it_waits_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "envpool", fake_envpool([]))
    assert bench_peers.envpool_stepper(8, 8, 1).step(0) == 8
    assert bench_peers.envpool_stepper(8, 4, 1).step(0) == 4


def test_envpool_is_measured_where_it_is_fastest(monkeypatch: pytest.MonkeyPatch) -> None:
    record: list[Any] = []
    monkeypatch.setitem(sys.modules, "envpool", fake_envpool(record))
    found = iter([[float(rate)] for rate in (3, 1, 4, 1, 5, 9, 2, 6)])
    monkeypatch.setattr(bench_peers, "rates", lambda *_: next(found, [7.0]))
    row = bench_peers.envpool_best("others", 3, 2)
    assert record[-1] == (1024, 512, 2)
    assert len(record) == 9
    assert (row["lanes"], row["threads"], row["median_per_s"]) == (1024, 2, 7.0)
    assert "512 of them" in row["note"]


def test_a_package_that_cannot_be_imported_is_no_error(monkeypatch: pytest.MonkeyPatch) -> None:
    def broken(_: str) -> Any:
        raise ImportError("numpy is too new for it")

    monkeypatch.setattr(bench_peers.importlib, "import_module", broken)
    row = bench_peers.peer_row("others", bench_peers.single_peers()[2], 1)
    assert row["missing"] == "cannot be imported: numpy is too new for it"


def test_warnings_of_others_go_no_further(monkeypatch: pytest.MonkeyPatch) -> None:
    def warn() -> Stepper:
        warnings.warn("loud", stacklevel=1)
        return Stepper(lambda _: 1)

    before = list(warnings.filters)
    row = bench_peers.peer_row("others", bench_peers.Peer("m", 1, 1, "gymnasium", warn), 1)
    assert row["lanes"] == 1
    assert warnings.filters == before


def test_training_is_measured_by_the_adapters_own_rate(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[tuple[int, float]] = []

    def rate(lanes: int, seconds: float) -> float:
        asked.append((lanes, seconds))
        return 1000.0 * len(asked)

    ppo = types.ModuleType("eval.bench_ppo")
    ppo.ppo_rate = rate  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "eval.bench_ppo", ppo)
    monkeypatch.setitem(sys.modules, "stable_baselines3", types.ModuleType("stable_baselines3"))
    row = bench_peers.ppo_row("training", 64, 3)
    assert asked == [(64, 4 * bench.WINDOW)] * 3
    assert row["median_per_s"] == 2000.0
