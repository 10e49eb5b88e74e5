"""Analytic policy gradient: true gradients, runs that repeat, and a policy worth having."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from railenv.errors import ArgumentError

torch = pytest.importorskip("torch")

from baselines.training import apg, imitation  # noqa: E402
from baselines.training.apg import AnalyticPolicyGradient, ApgSettings  # noqa: E402
from baselines.training.settings import TrainingSettings, load_settings, settings_from  # noqa: E402

SMALL = {"lanes": 4, "window": 12, "windows_per_episode": 2}
KNOTS = [0.0, 0.1, 0.2, 0.3]


def settings(
    method: dict[str, Any] | None = None,
    policy: dict[str, Any] | None = None,
    environment: dict[str, Any] | None = None,
    steps: int = 1000,
) -> TrainingSettings:
    """Return settings of a small run."""
    return settings_from(
        {
            "description": "test",
            "seed": 1,
            "steps": steps,
            "environment": {
                "track": "german_low",
                "track_pool": 2,
                "delay": [0.0, 0.3],
                "sensor_noise": 0.1,
                "start": "controlled",
                **(environment or {}),
            },
            "policy": {
                "class": "linear",
                "sensor_lags": [0, 2],
                "action_lags": [1, 4],
                "told_knots": KNOTS,
                **(policy or {}),
            },
            "method": {"name": "apg", **SMALL, **(method or {})},
        },
        "test",
    )


def weights_of(method: AnalyticPolicyGradient) -> list[Any]:
    return list(method._module.parameters())


def same(one: AnalyticPolicyGradient, other: AnalyticPolicyGradient) -> bool:
    first, second = one.state(), other.state()
    return first[1] == second[1] and all(
        np.array_equal(first[0][name], second[0][name]) for name in first[0]
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    "policy",
    [
        {},
        {"class": "network", "hidden": [3]},
        {"class": "recurrent", "hidden": [3], "told_knots": []},
        {"base": "skyhook:gain=4e3"},
        {"class": "gated", "hidden": [3], "told_knots": [], "experts": [0.0, 0.1, 0.3]},
    ],
    ids=["linear", "network", "recurrent", "residual", "gated"],
)
def test_gradient_of_a_window_is_that_of_finite_differences(policy: dict[str, Any]) -> None:
    gates = {"gate_weight": 0.7} if policy.get("class") == "gated" else {}
    run = settings({"worse_end_weight": 0.5, "effort_weight": 0.1, **gates}, policy)
    method = AnalyticPolicyGradient(run, 1, torch.float64)
    generator = np.random.default_rng(0)
    parameters = weights_of(method)
    with torch.no_grad():
        for weight in parameters:
            weight += torch.from_numpy(0.02 * generator.standard_normal(tuple(weight.shape)))

    def loss() -> Any:
        method.start_episode()
        return method.window_loss()[0]

    gradients = torch.autograd.grad(loss(), parameters)
    step = 1e-5
    directions = [torch.from_numpy(generator.standard_normal(tuple(w.shape))) for w in parameters]
    expected = sum(float((g * d).sum()) for g, d in zip(gradients, directions, strict=True))
    values = []
    for sign in (1.0, -1.0):
        with torch.no_grad():
            for weight, direction in zip(parameters, directions, strict=True):
                weight += sign * step * direction
            values.append(float(loss().detach()))
            for weight, direction in zip(parameters, directions, strict=True):
                weight -= sign * step * direction
    slope = (values[0] - values[1]) / (2 * step)
    # Central differences: an error of order step^2 and rounding of 1e-16 / step.
    assert slope == pytest.approx(expected, rel=1e-5)
    assert abs(expected) > 1e-3


@pytest.mark.slow
def test_restored_method_goes_on_bit_for_bit() -> None:
    undisturbed = AnalyticPolicyGradient(settings({"averaging": 0.5}), 1)
    undisturbed.update()
    arrays, plain = undisturbed.state()
    undisturbed.update()
    resumed = AnalyticPolicyGradient(settings({"averaging": 0.5}), 1)
    resumed.restore(arrays, plain)
    resumed.update()
    assert same(resumed, undisturbed)


@pytest.mark.slow
def test_state_before_the_first_update_is_one_to_go_on_from() -> None:
    first, second = (AnalyticPolicyGradient(settings(), 1) for _ in range(2))
    second.restore(*first.state())
    first.update()
    second.update()
    assert same(first, second)


@pytest.mark.slow
def test_seed_decides_everything() -> None:
    one, other, different = (AnalyticPolicyGradient(settings(), seed) for seed in (1, 1, 2))
    for method in (one, other, different):
        method.update()
    assert same(one, other)
    assert not same(one, different)


@pytest.mark.slow
def test_update_counts_its_lane_steps_and_reports_finite_numbers() -> None:
    method = AnalyticPolicyGradient(settings(), 1)
    numbers = method.update()
    assert method.steps == 4 * 12 * 2
    assert all(np.isfinite(value) for value in numbers.values())
    assert numbers["skipped"] == 0.0


def test_learning_rate_falls_from_first_to_last() -> None:
    hyper = ApgSettings(learning_rate=1e-2, final_learning_rate=1e-4)
    assert hyper.rate(0.0) == pytest.approx(1e-2)
    assert hyper.rate(0.5) == pytest.approx(0.5 * (1e-2 + 1e-4))
    assert hyper.rate(1.0) == pytest.approx(1e-4)
    assert hyper.rate(1.5) == pytest.approx(1e-4)


@pytest.mark.slow
def test_worse_end_counts_alone_with_all_the_weight() -> None:
    method = AnalyticPolicyGradient(settings({"worse_end_weight": 1.0}), 1, torch.float64)
    method.start_episode()
    loss, power, effort = (part.detach() for part in method.window_loss())
    hyper = method._hyper
    worse = torch.log(power.amax(dim=1) + hyper.soft**2).mean()
    assert float(loss) == pytest.approx(float(worse + hyper.effort_weight * effort), rel=1e-12)
    assert float(power[:, 0].sub(power[:, 1]).abs().min()) > 0.0


def test_result_is_the_running_mean_of_the_weights() -> None:
    method = AnalyticPolicyGradient(settings({"averaging": 0.75, "windows_per_episode": 1}), 1)
    start = weights_of(method)[0].detach().clone()
    method.update()
    moved = weights_of(method)[0].detach() - start
    mean = next(method.module().parameters()).detach() - start
    # Single precision.
    assert torch.allclose(mean, 0.25 * moved, rtol=1e-5, atol=1e-9)
    assert float(moved.abs().max()) > 0.0


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("averaging", 1.0),
        ("worse_end_weight", 1.5),
        ("lanes", 0),
        ("soft", 0.0),
        ("exact_share", 2.0),
    ],
)
def test_setting_out_of_range_is_refused_by_name(name: str, value: float) -> None:
    with pytest.raises(ArgumentError, match=name):
        ApgSettings(**{name: value})


@pytest.mark.slow
def test_update_lowers_the_loss_of_the_episode_that_it_was_made_on() -> None:
    run = settings({"window": 60, "windows_per_episode": 1, "learning_rate": 1e-4})
    method = AnalyticPolicyGradient(run, 1)
    losses = []
    for _ in range(2):
        method.steps = 0
        losses.append(method.update()["loss"])
    assert losses[1] < losses[0]


@pytest.mark.slow
def test_imitation_gives_the_first_weights_of_the_linear_path(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    def short(run: TrainingSettings, effort: float) -> TrainingSettings:
        chosen = imitation.linear_part(run, effort)
        few = {"lanes": 2, "periods": 60, "run_in": 5, "preview": False}
        return chosen.replace(hyper=replace(chosen.hyper, **few))

    monkeypatch.setattr(apg, "linear_part", short)
    policy = {"class": "network", "hidden": [3]}
    method = AnalyticPolicyGradient(settings({"imitation_rounds": 1}, policy), 1)
    before = {name: array.copy() for name, array in method.state()[0].items()}
    method._imitate()
    after = method.state()[0]
    assert method.steps == 2 * 60
    assert np.abs(after["weights.weights"]).max() > 0.0
    assert np.array_equal(after["weights.weights"], after["average.weights"])
    # The network beside it is left as it was, and its last layer is zero.
    assert np.array_equal(after["weights.layers.0.weight"], before["weights.layers.0.weight"])


def test_imitation_below_a_base_is_refused() -> None:
    with pytest.raises(ArgumentError, match="imitation_rounds"):
        AnalyticPolicyGradient(settings({"imitation_rounds": 1}, {"base": "skyhook:gain=4e3"}), 1)


@pytest.mark.learning
def test_twenty_seconds_reach_half_the_power_of_the_best_sky_hook() -> None:
    # Best sky-hook gains of the trial without delay and at 150 and 300 ms, N s/m.
    gains = {0.0: 60e3, 0.15: 15e3, 0.3: 7.5e3}
    seconds = {"lanes": 64, "window": 300, "windows_per_episode": 5}
    lags = {"sensor_lags": [0, 1, 3, 8, 16, 26], "action_lags": [1, 4, 8, 16, 28]}
    run = settings(
        seconds,
        {**lags, "told_knots": [0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3]},
        {"track_pool": 8, "pool_seed": 3, "told_error": 0.02},
        steps=8 * 64 * 1500,
    )
    learner = AnalyticPolicyGradient(run, 1)
    while learner.steps < run.steps:
        learner.update()
    learned = learner.module().eval()
    for delay, gain in gains.items():
        powers = {}
        for name, base in (("learned", ""), ("sky-hook", f"skyhook:gain={gain:g}")):
            # Other tracks than those of training.
            judged = settings(
                {"lanes": 16, "window": 1000, "windows_per_episode": 1},
                {**lags, "told_knots": run.policy.told_knots, "base": base},
                {"track_pool": 8, "pool_seed": 77, "delay": delay},
            )
            judge = AnalyticPolicyGradient(judged, 9)
            if not base:
                judge._module.load_state_dict(learned.state_dict())
            judge.start_episode()
            with torch.no_grad():
                powers[name] = float(judge.window_loss()[1].mean())
        assert powers["learned"] < 0.5 * powers["sky-hook"], (delay, powers)


@pytest.mark.parametrize(
    "name",
    [
        "apg-hidden",
        "apg-imitation",
        "apg-linear",
        "apg-network",
        "apg-residual",
        "imitation-linear",
    ],
)
def test_shipped_configuration_says_what_it_trains(name: str) -> None:
    run = load_settings(Path(__file__).parents[1] / "configs" / "train" / f"{name}.toml")
    assert run.method == name.partition("-")[0]
    assert run.history().is_told == (name != "apg-hidden")
