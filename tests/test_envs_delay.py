"""When a command takes force: read from the physics, and compared with what info says."""

from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from scipy.optimize import brentq

from railenv.actuation import DelaySpec, held_input
from railenv.envs.rail_env import Lateral17Env
from railenv.vehicle import state_space

PERIOD = 0.01
ARRIVAL = 1e-9
"""The issue's own tolerance for an instant [s]."""


def make(**settings: Any) -> Lateral17Env:
    """A vehicle at rest on a flat track, seen once per physics step."""
    return Lateral17Env(track="flat", time_step=PERIOD, control_period=PERIOD, **settings)


def physics(env: Lateral17Env) -> tuple[np.ndarray, np.ndarray, int]:
    """The plant without any of the stepping's matrices, and where the carbody's velocity is."""
    system = state_space(env.vehicle)
    return system.A, system.actuator_input, system.states.index("carbody_lateral_velocity")


def state(env: Lateral17Env) -> np.ndarray:
    return env._lanes.state(0)


def time_since_switch(env: Lateral17Env, channel: int, force: float) -> float:
    """How long a force has acted on the vehicle, which was at rest: its response is inverted."""
    A, B, row = physics(env)
    reached = state(env)

    def response(duration: float) -> np.ndarray:
        return force * held_input(A, B[:, channel : channel + 1], duration)[1][:, 0]

    def missing(duration: float) -> float:
        return response(duration)[row] - reached[row]

    # xtol and rtol at their smallest: the root is as exact as the state
    since = float(brentq(missing, 0.0, PERIOD * (1 + 1e-9), xtol=1e-15, rtol=1e-14))
    effect = response(since)
    # Not only the velocity: all of the state is that of this force for this time. Where it has only
    # just arrived, what remains is the rounding of a whole period's response.
    rounding = 1e-14 * np.abs(response(PERIOD)).max()
    np.testing.assert_allclose(reached, effect, atol=1e-9 * np.abs(effect).max() + rounding)
    return since


def arrival(env: Lateral17Env, channel: int, start: int, **reset: Any) -> tuple[float, float]:
    """Step channel's action up at a period; when it acts in the physics, and by info [s]."""
    _, info = env.reset(**reset)
    sent: list[float] = []
    for k in range(start + 80):
        action = np.zeros(env.action_space.shape)
        action[channel] = 0.2 if k >= start else 0.0
        begun = info["time"]
        *_, info = env.step(action)
        if k >= start:
            sent.append(begun + info["delay"][channel])
        if np.any(state(env)):
            seen = info["time"] - time_since_switch(env, channel, info["command"][channel])
            return seen, min(sent)
    raise AssertionError("no force ever arrived")


def test_in_200_episodes_the_force_arrives_when_info_says() -> None:
    rng = np.random.default_rng(0)
    env = make()
    delays = rng.uniform(0.0, 0.3, (200, 4))
    # whole periods and half ones are the places where an off-by-one would hide
    delays[:6] = np.array([0.0, 0.01, 0.005, 0.29, 0.295, 0.3])[:, None]
    worst = 0.0
    for number, given in enumerate(delays):
        channel, start = number % 4, int(rng.integers(0, 5))
        options = {"delay": given.tolist()}
        seen, said = arrival(env, channel, start, seed=number, options=options)
        assert said == pytest.approx(start * PERIOD + given[channel], abs=1e-15)
        worst = max(worst, abs(seen - said))
    assert worst < ARRIVAL


def test_a_delay_drawn_per_channel_and_a_sensor_delay_add_up_in_the_physics() -> None:
    env = make(delay=(0.0, 0.2), delay_per_channel=True, sensor_delay=(0.01, 0.1))
    for number in range(12):
        seen, said = arrival(env, number % 4, 2, seed=number)
        assert abs(seen - said) < ARRIVAL


def test_the_sensors_share_is_part_of_the_delay_in_info() -> None:
    env = make(delay=DelaySpec((0.02, 0.05, 0.0, 0.1), sensor_delay=0.033))
    info = env.reset(seed=0)[1]
    assert info["sensor_delay"] == 0.033
    # sums of two
    np.testing.assert_allclose(info["delay"], [0.053, 0.083, 0.033, 0.133], atol=1e-15)
    seen, said = arrival(env, 3, 1, seed=0)
    assert abs(seen - said) < ARRIVAL
    # the observation before the first action is that of time zero
    assert said == pytest.approx(PERIOD + 0.133, abs=1e-15)


def test_jitter_moves_every_arrival_and_info_says_where_to() -> None:
    env = make(delay=(0.0, 0.1), jitter=0.05, dropout=0.3)
    found = [arrival(env, k % 4, 3, seed=k) for k in range(40)]
    assert max(abs(seen - said) for seen, said in found) < ARRIVAL


def test_a_lagged_actuator_is_reached_when_info_says() -> None:
    env = make(delay=(0.0, 0.2), actuator_lag=0.03)
    lag, force = 0.03, 600.0
    for number in range(8):
        _, info = env.reset(seed=number)
        delay = info["delay"][1]
        while info["force"][1] == 0.0:
            *_, info = env.step(np.array([0.0, 0.2, 0.0, 0.0]))
        # F = force (1 - exp(-t / lag)), solved for t
        since = -lag * np.log1p(-info["force"][1] / force)
        assert abs(info["time"] - since - delay) < ARRIVAL


def newest_arrived(sent: list[tuple[float, np.ndarray, np.ndarray]], now: float) -> np.ndarray:
    """Force of each channel at an instant, from the times in info alone."""
    force = np.zeros(4)
    for begun, delay, command in sent:
        arrived = begun + delay <= now
        force[arrived] = command[arrived]
    return force


@pytest.mark.parametrize(
    "settings",
    [
        {"jitter": 0.15, "dropout": 0.25},
        {"jitter": 0.004},
        {"jitter": 0.1, "common_jitter": True},
        {"dropout": 0.5},
    ],
)
def test_the_motion_is_that_of_the_newest_command_that_has_arrived(settings: dict) -> None:
    env = make(delay=(0.0, 0.1), delay_per_channel=True, **settings)
    rng = np.random.default_rng(1)
    _, info = env.reset(seed=2)
    sent: list[tuple[float, np.ndarray, np.ndarray]] = []
    for _ in range(40):
        begun = info["time"]
        *_, info = env.step(rng.uniform(-0.5, 0.5, 4))
        sent.append((begun, info["delay"], info["command"]))
    end = info["time"]
    A, B, _ = physics(env)
    instants = np.concatenate([begun + delay for begun, delay, _ in sent])
    edges = np.unique([0.0, *instants[instants < end], end])
    x = np.zeros(len(A))
    for left, right in pairwise(edges):
        transition, effect = held_input(A, B, right - left)
        x = transition @ x + effect @ newest_arrived(sent, 0.5 * (left + right))
    # some hundred products of matrices of norm one to ten
    np.testing.assert_allclose(state(env), x, atol=1e-11 * np.abs(x).max())
    np.testing.assert_array_equal(info["force"], newest_arrived(sent, end))


def test_a_lost_command_has_an_infinite_delay_and_leaves_the_force() -> None:
    env = make(dropout=0.4)
    _, info = env.reset(seed=0)
    force = np.zeros(4)
    lost = 0
    for k in range(100):
        *_, info = env.step(np.full(4, 0.001 * k))
        gone = np.isinf(info["delay"])
        force = np.where(gone, force, info["command"])
        np.testing.assert_array_equal(info["force"], force)
        lost += gone.sum()
    # 400 draws of probability 0.4, five standard deviations of 10
    assert abs(lost - 160) < 50


def drawn(periods: int, **settings: Any) -> np.ndarray:
    """Delays of all commands, shape (periods, channels)."""
    env = make(episode_seconds=periods * PERIOD, **settings)
    env.reset(seed=1)
    return np.array([env.step(np.zeros(4))[4]["delay"] for _ in range(periods)])


def test_jitter_is_uniform_between_zero_and_its_bound() -> None:
    later = drawn(1000, delay=0.1, jitter=0.06) - 0.1
    assert later.min() >= 0.0
    assert later.max() <= 0.06
    # 4000 draws: a quarter of them in each quarter, five standard deviations of 27
    counts = np.histogram(later, bins=4, range=(0.0, 0.06))[0]
    assert np.all(np.abs(counts - 1000) < 140)


def test_what_gets_lost_does_not_depend_on_how_late_it_is() -> None:
    later = drawn(1000, jitter=0.06, dropout=0.5)
    arrived = later[np.isfinite(later)]
    # some 2000 draws: a quarter of them in each quarter, five standard deviations of 20
    counts = np.histogram(arrived, bins=4, range=(0.0, 0.06))[0]
    assert np.all(np.abs(counts - len(arrived) / 4) < 100)


def test_channels_jitter_apart_unless_jitter_is_common() -> None:
    assert np.all(np.ptp(drawn(100, jitter=0.06), axis=1) > 0.0)
    assert np.all(np.ptp(drawn(100, jitter=0.06, common_jitter=True), axis=1) == 0.0)


def test_successive_draws_of_jitter_are_independent() -> None:
    later = drawn(1000, jitter=0.06)[:, 0]
    # a correlation of 1000 independent pairs has a standard deviation of 0.03
    for lag in (1, 2, 64):
        assert abs(np.corrcoef(later[:-lag], later[lag:])[0, 1]) < 0.16


def test_a_lost_measurement_leaves_the_last_one_in_the_observation() -> None:
    env = Lateral17Env(sensor_dropout=0.3, action_history=0)
    observation, _ = env.reset(seed=0)
    kept, moved = 0, []
    for _ in range(300):
        before = observation
        observation, *_ = env.step(np.zeros(4))
        same = observation == before
        assert same.all() or not same.any()
        kept += same.all()
        moved.append(observation)
    # 300 draws of probability 0.3, five standard deviations of 8
    assert abs(kept - 90) < 40
    # What arrives is the present, not something that was waiting: the run without losses.
    perfect = Lateral17Env(action_history=0)
    perfect.reset(seed=0)
    for seen in moved:
        now = perfect.step(np.zeros(4))[0]
        if not np.array_equal(seen, before):
            before = seen
            np.testing.assert_array_equal(seen, now)


@pytest.mark.parametrize("delay", [0.295, 0.29, 0.2925])
def test_an_actuator_far_faster_than_the_step_acts_after_the_delay_too(delay: float) -> None:
    env = Lateral17Env(track="flat", actuator_lag=1e-5, delay=delay)
    env.reset(seed=0)
    A, B, row = physics(env)
    for _ in range(30):
        env.step(np.array([0.2, 0.0, 0.0, 0.0]))
    expected = 600.0 * held_input(A, B, 0.3 - delay)[1][row, 0]
    # the lag of 10 microseconds passes by as a share of at least 5 ms: below 1 %
    assert state(env)[row] == pytest.approx(expected, rel=0.01)


def test_the_root_finder_sees_a_nanosecond() -> None:
    """The measure itself: a response moved by a nanosecond is told from one that is not."""
    env = make()
    A, B, row = physics(env)
    env.reset(options={"delay": 0.0035})
    env.step(np.array([0.2, 0.0, 0.0, 0.0]))
    late = 600.0 * held_input(A, B[:, :1], 0.0065 - 1e-9)[1][row, 0]
    # a nanosecond of 6.5 ms is 1.5e-7 of the response, far above its rounding
    assert abs(state(env)[row] - late) > 1e6 * np.finfo(float).eps * abs(late)
