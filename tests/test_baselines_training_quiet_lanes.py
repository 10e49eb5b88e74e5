"""Quiet lanes: amplitudes as drawn, and that they are what a smoother track would give."""

from typing import Any

import numpy as np
import pytest

from baselines.training.quiet_lanes import QuietLanes
from railenv.errors import ArgumentError

torch = pytest.importorskip("torch")

from baselines.training.apg import AnalyticPolicyGradient  # noqa: E402
from baselines.training.settings import settings_from  # noqa: E402


def method(policy: dict[str, Any], **hyper: Any) -> AnalyticPolicyGradient:
    small = {"lanes": 6, "window": 30, "windows_per_episode": 1, **hyper}
    run = settings_from(
        {
            "description": "test",
            "seed": 1,
            "steps": 1000,
            "environment": {
                "track": "german_low",
                "track_pool": 2,
                "sensor_noise": 0.1,
                "start": "controlled",
                "delay": [0.0, 0.3],
            },
            "policy": {"sensor_lags": [0, 2], "action_lags": [1, 4], "told_knots": [], **policy},
            "method": {"name": "apg", **small},
        },
        "test",
    )
    made = AnalyticPolicyGradient(run, 1, torch.float64)
    generator = torch.Generator().manual_seed(3)
    with torch.no_grad():
        for weight in made._module.parameters():
            weight.normal_(std=0.1, generator=generator)
    return made


def test_amplitudes_are_drawn_as_told() -> None:
    amplitude = QuietLanes(0.25, 0.01).draw(4000, np.random.default_rng(0))
    quiet = amplitude[amplitude < 1.0]
    assert len(quiet) == 1000
    assert quiet.min() >= 0.01
    # Evenly in the logarithm: a mean of -1 decade, of standard deviation 2 / sqrt(12 * 1000).
    assert np.log10(quiet).mean() == pytest.approx(-1.0, abs=4 * 2 / np.sqrt(12e3))
    assert np.all(QuietLanes(0.0, 0.01).draw(50, np.random.default_rng(0)) == 1.0)


def test_a_linear_policy_does_not_see_the_amplitude() -> None:
    loud, quiet = method({"class": "linear"}), method({"class": "linear"}, quiet_share=1.0)
    for each in (loud, quiet):
        with torch.no_grad():
            each._module.weights.mul_(0.1)  # within the box, where alone it is linear
        each.start_episode()
    assert float(quiet._amplitude.max()) < 1.0
    found, expected = quiet.window_loss(), loud.window_loss()
    for own, other in zip(found, expected, strict=True):
        np.testing.assert_allclose(own.detach().numpy(), other.detach().numpy(), rtol=1e-9)


def test_a_quiet_lane_is_a_lane_of_a_quieter_track() -> None:
    quiet = method({"class": "network", "hidden": [4]}, quiet_share=1.0)
    quiet.start_episode()
    amplitude = quiet._amplitude[:, 0].numpy().copy()
    _, power, _ = quiet.window_loss()
    # The same drive with track, start and noise made smaller, and all readings as they then are.
    # The vehicle being linear, its power is the loud one's times the amplitude squared.
    same = method({"class": "network", "hidden": [4]})
    same.start_episode()
    scale = torch.tensor(amplitude)[:, None]
    twin, past, told = same._twin, same._past, same._told
    reading, total = same._reading * scale, torch.zeros_like(power)
    twin._state = twin._state * scale
    twin._track.window_of = twin._track.window
    twin._track.window = lambda periods: twin._track.window_of(periods) * amplitude[:, None, None]
    noise = twin._lanes.noise
    taken = noise.take
    noise.take = lambda: taken() * amplitude[:, None]
    hidden = same._module.initial_hidden(6, told)
    for _ in range(30):
        action, hidden = same._module(past.observe(reading), told, hidden)
        action = action.clamp(-1.0, 1.0)
        past.remember(action)
        reading, ends = twin.advance(action)
        total = total + ends / 30
    np.testing.assert_allclose(
        (total / scale.square()).detach().numpy(), power.detach().numpy(), rtol=1e-6
    )


def test_senseless_values_are_refused() -> None:
    with pytest.raises(ArgumentError, match=r"quiet_share = .* is a share"):
        QuietLanes(1.5, 0.1)
    with pytest.raises(ArgumentError, match="quietest = 1 must be an amplitude"):
        QuietLanes(0.5, 1.0)
