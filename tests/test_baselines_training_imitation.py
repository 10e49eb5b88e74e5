"""Imitation of the undelayed expert: the expert, the rounds, and how near they come."""

from typing import Any

import numpy as np
import pytest

from railenv.errors import ArgumentError

torch = pytest.importorskip("torch")

from baselines.design.cost import loop_cost  # noqa: E402
from baselines.design.model import design_model  # noqa: E402
from baselines.lqg import DelayLqg  # noqa: E402
from baselines.optimum import FullInformation, everything, exact_optimum  # noqa: E402
from baselines.policies.torch_modules import policy_of  # noqa: E402
from baselines.training.expert import UndelayedExpert  # noqa: E402
from baselines.training.imitation import Imitation  # noqa: E402
from baselines.training.imitation_settings import ImitationSettings  # noqa: E402
from baselines.training.replay import Replay  # noqa: E402
from baselines.training.settings import TrainingSettings, settings_from  # noqa: E402
from baselines.training.training_twin import TrainingTwin  # noqa: E402

SMALL = {"lanes": 4, "periods": 60, "run_in": 5, "preview": False, "batches": 2, "batch": 8}


def settings(
    method: dict[str, Any] | None = None,
    policy: dict[str, Any] | None = None,
    environment: dict[str, Any] | None = None,
) -> TrainingSettings:
    """Return settings of a small run."""
    return settings_from(
        {
            "description": "test",
            "seed": 1,
            "steps": 1000,
            "environment": {
                "track": "german_low",
                "track_pool": 4,
                "delay": [0.0, 0.1],
                "sensor_noise": 0.1,
                "start": "controlled",
                **(environment or {}),
            },
            "policy": {
                "class": "linear",
                "sensor_lags": [0, 2],
                "action_lags": [1, 4],
                "told_knots": [0.0, 0.05, 0.1],
                **(policy or {}),
            },
            "method": {"name": "imitation", **SMALL, **(method or {})},
        },
        "test",
    )


def same(one: Imitation, other: Imitation) -> bool:
    first, second = one.state(), other.state()
    return first[1] == second[1] and all(
        np.array_equal(first[0][name], second[0][name]) for name in first[0]
    )


def test_known_is_what_a_law_with_full_information_reads() -> None:
    run = settings()
    twin = TrainingTwin(2, run.environment, torch.float64)
    twin.start(0, np.array([0.0, 0.05]))
    names = everything(twin.vehicle)
    known = twin.known()
    assert known.shape == (2, len(names))
    before = dict(zip(names, known[0], strict=True))
    for _ in range(2):
        twin.advance(torch.zeros((2, 2), dtype=torch.float64))
    after = dict(zip(names, twin.known()[0], strict=True))
    # Over 20 ms the carbody moves by its mean velocity, to the curvature of its path.
    moved = after["carbody_lateral"] - before["carbody_lateral"]
    mean = (after["carbody_lateral_velocity"] + before["carbody_lateral_velocity"]) / 2
    assert moved == pytest.approx(0.02 * mean, rel=0.02)
    # Four wheelsets on one track stand on different heights of it.
    assert len({after[f"alignment_{w}"] for w in range(1, 5)}) == 4


@pytest.mark.slow
def test_expert_predicts_what_the_commands_on_their_way_do() -> None:
    # Next to no track: what moves the vehicle are the commands.
    run = settings({}, {}, {"track_level": [1e-8, 1e-8], "start": "rest", "sensor_noise": 0.0})
    twin = TrainingTwin(3, run.environment, torch.float64)
    delay = np.array([0.0, 0.03, 0.1])
    expert = UndelayedExpert(twin.vehicle, run.environment, run.history(), 1e-2, preview=False)
    twin.start(0, delay)
    expert.start(np.array([0, 3, 10]))
    generator = np.random.default_rng(0)
    states = len(everything(twin.vehicle)) - 8
    for _ in range(60):
        expert.see(twin.known())
        action = generator.uniform(-0.5, 0.5, (3, 2))
        expert.go_on(action)
        twin.advance(torch.from_numpy(action))
    ahead, known = expert._before[:, :states], twin.known()[:, :states]
    # The track that is left is 1e-4 of German low, a thousandth of what the commands do.
    assert np.allclose(ahead, known, atol=1e-3 * np.abs(known).max())


@pytest.mark.slow
@pytest.mark.parametrize("preview", [False, True])
def test_causal_expert_costs_what_the_optimum_costs(preview: bool) -> None:
    run = settings({}, {}, {"delay": 0.1, "sensor_noise": 0.0, "episode_seconds": 12.0})
    twin = TrainingTwin(12, run.environment, torch.float64)
    expert = UndelayedExpert(twin.vehicle, run.environment, run.history(), 1e-2, preview)
    twin.start(0, np.full(12, 0.1))
    expert.start(np.full(12, 10))
    power = 0.0
    for k in range(1200):
        expert.see(twin.known())
        action = expert.command()
        expert.go_on(action)
        _, ends = twin.advance(torch.from_numpy(action))
        power += float(ends.mean()) / 1000 if k >= 200 else 0.0
    assert float(np.abs(action).max()) < 1.0
    in_a_row = design_model(twin.vehicle, 0.1, preview=True)
    if preview:
        expected = exact_optimum(in_a_row, 1e-2).weighted_acceleration
    else:
        law = FullInformation(twin.vehicle, 0.1, 1e-2)
        expected = loop_cost(in_a_row, law).weighted_acceleration
    # 120 s of random track, whose long waves are cut: a few per cent.
    assert np.sqrt(power) == pytest.approx(expected, rel=0.08)


@pytest.mark.slow
@pytest.mark.parametrize(
    "policy", [{}, {"class": "network", "hidden": [4]}], ids=["linear", "network"]
)
def test_restored_method_goes_on_bit_for_bit(policy: dict[str, Any]) -> None:
    undisturbed = Imitation(settings({}, policy), 1)
    undisturbed.update()
    arrays, plain = undisturbed.state()
    undisturbed.update()
    resumed = Imitation(settings({}, policy), 1)
    resumed.restore(arrays, plain)
    resumed.update()
    assert same(resumed, undisturbed)


@pytest.mark.slow
def test_round_counts_its_lane_steps_and_reports_finite_numbers() -> None:
    method = Imitation(settings(), 1)
    numbers = [method.update() for _ in range(2)]
    assert method.steps == 2 * 4 * 60
    assert set(numbers[0]) == set(numbers[1])
    assert all(np.isfinite(value) for row in numbers for value in row.values())
    # At first the expert drives every lane.
    assert numbers[0]["expert_share"] == 1.0


@pytest.mark.slow
def test_network_learns_what_the_linear_path_leaves() -> None:
    method = Imitation(
        settings({"batches": 300, "batch": 64}, {"class": "network", "hidden": [8]}), 1
    )
    method.update()
    generator = np.random.default_rng(0)
    with torch.no_grad():
        x, told, label = method._replay.batch(200, generator)
        whole = float((method._module(x, told)[0] - label).square().mean())
        linear = float((method._module._linear(x, told) - label).square().mean())
    assert whole < linear


def test_replay_keeps_old_and_new_samples_in_equal_parts() -> None:
    replay = Replay(10, 1, 1)
    generator = np.random.default_rng(0)
    for value in (1.0, 2.0):
        replay.offer(np.full((40, 1), value), value, np.full((40, 1), value))
        replay.settle(generator)
    kept = replay.arrays()["replay.told"]
    assert sorted(kept.tolist()) == [1.0] * 5 + [2.0] * 5
    assert np.array_equal(kept, replay.arrays()["replay.labels"][:, 0])


@pytest.mark.parametrize(
    ("policy", "match"),
    [
        ({"class": "recurrent", "hidden": [4]}, "recurrent"),
        ({"base": "skyhook:gain=4e3"}, "base"),
    ],
)
def test_policy_that_cannot_be_fitted_is_refused(policy: dict[str, Any], match: str) -> None:
    with pytest.raises(ArgumentError, match=match):
        Imitation(settings({}, policy), 1)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("fields", "match"),
    [
        ({"actuator_lag": 0.02}, "actuator_lag"),
        ({"force_limit": 1000.0}, "force_limit"),
        ({"vehicle_ranges": "narrow", "vehicle_pool": 2}, "vehicle_ranges"),
        ({"track": "tb3352"}, "rational"),
    ],
)
def test_what_the_expert_does_not_know_is_refused(fields: dict[str, Any], match: str) -> None:
    with pytest.raises(ArgumentError, match=match):
        Imitation(settings({}, {}, fields), 1)


@pytest.mark.parametrize(
    ("name", "value"), [("expert_share", 1.5), ("ridge", 0.0), ("lanes", 0), ("exploration", -1.0)]
)
def test_setting_out_of_range_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ArgumentError, match=name):
        ImitationSettings(**{name: value})


@pytest.mark.learning
def test_rounds_come_near_the_delay_aware_lqg() -> None:
    lags = {
        "sensor_lags": [0, 1, 2, 3, 5, 8, 12, 16, 21, 26],
        "action_lags": list(range(1, 11)),
        "told_knots": [],
    }
    run = settings(
        {"lanes": 32, "periods": 1200, "run_in": 100, "preview": True},
        lags,
        {"delay": 0.1, "track_pool": 16},
    )
    method = Imitation(run, 1)
    for _ in range(4):
        method.update()
    vehicle = method._twin.vehicle
    in_a_row = design_model(vehicle, 0.1, preview=True)
    learned = loop_cost(in_a_row, policy_of(method.module()).law_at(), 0.1)
    without, sharp = (
        loop_cost(in_a_row, DelayLqg(vehicle, 0.1, 1e-2, preview=preview), 0.1)
        for preview in (False, True)
    )
    # What the history holds of the track in front is preview: better than the law without it, and
    # within 10 % of the law that knows all; the history has an end.
    assert learned.weighted_acceleration < without.weighted_acceleration
    assert learned.weighted_acceleration < 1.1 * sharp.weighted_acceleration
