"""What training on the model rests upon: the twin with given delays, the past, the draws."""

from typing import Any

import numpy as np
import pytest

from baselines.policies.history import History
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError

torch = pytest.importorskip("torch")

from baselines.training.past import Past  # noqa: E402
from baselines.training.told_draws import DelayLaw  # noqa: E402
from baselines.training.training_twin import TrainingTwin  # noqa: E402
from baselines.twin import DifferentiableTwin  # noqa: E402


def environment(**fields: Any) -> EnvSettings:
    return EnvSettings(
        track="german_low",
        track_pool=2,
        action="bogies",
        start="controlled",
        delay=(0.0, 0.3),
        sensor_noise=0.1,
        episode_seconds=0.6,
        **fields,
    )


@pytest.mark.slow
def test_training_twin_moves_as_the_twin_does() -> None:
    delay = np.array([0.0, 0.013, 0.1, 0.27])
    ours = TrainingTwin(4, environment(), torch.float64)
    reading = ours.start(5, delay)
    twin = DifferentiableTwin(
        4,
        **{name: getattr(ours.settings, name) for name in EnvSettings.__dataclass_fields__},
    )
    # The plain twin draws delays of its own: it is given those of ours, by the same hook.
    episodes = twin._lanes.episodes
    set_delays = twin._set_delays

    def given(vehicle: Any, drawn: Any) -> None:
        drawn[:] = delay[:, None]
        set_delays(vehicle, episodes.delay)

    twin._set_delays = given  # type: ignore[method-assign]
    expected = twin.reset(5)
    assert torch.equal(reading, expected[:, : reading.shape[1]])
    generator = np.random.default_rng(1)
    for _ in range(60):
        action = torch.from_numpy(generator.uniform(-0.3, 0.3, (4, 2)))
        reading, power = ours.advance(action)
        expected, _, info = twin.step(action)
        both = power.mean(dim=1).sqrt()
        # One product is summed in another order: rounding of double precision.
        assert torch.allclose(reading, expected, rtol=1e-9, atol=1e-11)
        assert torch.allclose(both, info["weighted_acceleration"], rtol=1e-9, atol=1e-12)


def test_lane_that_has_ended_stands_still_and_costs_nothing() -> None:
    twin = TrainingTwin(2, environment(gauge_limit=0.03), torch.float64)
    reading = twin.start(5, np.zeros(2))
    push = torch.tensor([[1.0, 1.0], [0.0, 0.0]], dtype=torch.float64)
    for _ in range(60):
        last, (reading, power) = reading, twin.advance(push)
    assert twin.ended.tolist() == [True, False]
    assert torch.equal(reading[0], last[0])
    assert float(power[0].sum()) == 0.0
    assert float(power[1].sum()) > 0.0


def test_delays_beyond_the_longest_are_refused() -> None:
    twin = TrainingTwin(2, environment(), torch.float64)
    with pytest.raises(ArgumentError, match="max_delay"):
        twin.start(0, np.array([0.1, 0.31]))


def test_past_gives_the_features_of_the_history() -> None:
    history = History.of(4, sensor_lags=(0, 1, 3), action_lags=(1, 2, 5), told_knots=(0.0, 0.3))
    twin = DifferentiableTwin(
        3, **history.environment(), delay=0.05, track="german_low", track_pool=2
    )
    columns = torch.from_numpy(history.columns(twin.observation_names))
    measured = len(twin._lanes.episodes.measured)
    past = Past(history, twin.observation_names[:measured], 3, torch.float64)
    observation = twin.reset(3)
    generator = np.random.default_rng(2)
    for _ in range(20):
        features = past.observe(observation[:, :measured])
        assert torch.equal(features, observation[:, columns])
        action = torch.from_numpy(generator.uniform(-0.2, 0.2, (3, 2)))
        past.remember(action)
        observation, _, _ = twin.step(action)


def test_delays_share_the_range_evenly_and_have_their_shares_at_the_ends() -> None:
    law = DelayLaw(0.0, 0.3, 0.02, exact_share=0.25, shortest_share=0.1, longest_share=0.2)
    delay, told = law.draw(1000, np.random.default_rng(0))
    # Stratified draws: the counts are right to one lane.
    assert abs(np.sum(delay == 0.0) - 100) <= 1
    assert abs(np.sum(delay == 0.3) - 200) <= 1
    assert abs(np.sum(told == delay) - 250) <= 1
    inside = np.sort(delay[(delay > 0.0) & (delay < 0.3)])
    assert np.max(np.diff(inside)) < 2.01 * 0.3 / 700
    assert np.all(np.abs(told - delay) <= 0.02)
    assert np.all(told >= 0.0)


def test_delays_of_whole_periods_are_equally_likely() -> None:
    law = DelayLaw(0.0, 0.03, 0.0)
    delay, told = law.draw(400, np.random.default_rng(0), 0.01)
    assert np.array_equal(delay, told)
    values, counts = np.unique(delay, return_counts=True)
    assert np.allclose(values, [0.0, 0.01, 0.02, 0.03])
    assert np.all(np.abs(counts - 100) <= 1)


def test_range_that_does_not_end_at_a_period_is_refused_for_whole_periods() -> None:
    with pytest.raises(ArgumentError, match="whole number of control periods"):
        DelayLaw(0.0, 0.025, 0.0).draw(4, np.random.default_rng(0), 0.01)


def test_delay_per_channel_is_refused() -> None:
    with pytest.raises(ArgumentError, match="delay_per_channel"):
        DelayLaw.of(environment(delay_per_channel=True))


def test_lanes_at_the_edges_stand_beside_whole_periods_and_are_told_extremes() -> None:
    law = DelayLaw(0.0, 0.3, 0.02, exact_share=0.25, edge_share=1.0)
    delay, told = law.draw(4000, np.random.default_rng(1))
    off = delay - np.round(delay / 0.01) * 0.01
    inside = (delay > 0.0) & (delay < 0.3)
    np.testing.assert_allclose(np.abs(off[inside]), 1e-6, atol=1e-12)
    assert {-1.0, 1.0} == set(np.sign(off[inside]))
    error = (told - delay)[told > 0.0]
    assert {round(1e3 * e) for e in error if delay.min() >= 0.0} >= {-20, 0, 20}
    assert set(np.round(error[delay[told > 0.0] > 0.03], 6)) == {-0.02, 0.0, 0.02}


def test_no_lanes_at_the_edges_leave_the_other_draws_as_they_are() -> None:
    plain = DelayLaw(0.0, 0.3, 0.02, exact_share=0.25)
    some = DelayLaw(0.0, 0.3, 0.02, exact_share=0.25, edge_share=0.25)
    first, both = (law.draw(400, np.random.default_rng(1)) for law in (plain, some))
    same = first[0] == both[0]
    assert 0.7 < same.mean() < 0.8
