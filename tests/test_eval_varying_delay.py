"""Runs whose commands are late or get lost: the draws, and what they do to the loop."""

from typing import Any

import numpy as np
import pytest

from baselines import Passive, SkyHook
from eval.rollout import ControlledBatch, Stepping, rollout
from eval.simulations import Vehicle
from eval.varying_delay import ChannelDraws, VaryingDelay
from railenv.actuation import DelaySpec, SemiActiveDamper
from railenv.envs.full_env import Full50VectorEnv
from railenv.envs.observation import DEFAULT_ACTION_SCALE, sensor_names
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.errors import ArgumentError
from railenv.simulation import required_length
from railenv.track import Track, make_track
from railenv.units import FloatArray
from railenv.vehicle import LateralVehicle, lateral17
from railenv.vehicle.nonlinear import full50

FORCES = tuple(f"actuator_force_{k}" for k in (1, 2, 3, 4))
SENSORS = sensor_names("4")
SIGMAS = 5.0
"""Statistics may be off by so many of their own standard deviations; all seeds are fixed."""


@pytest.fixture(scope="module")
def track(vehicle: LateralVehicle) -> Track:
    return make_track("german_low", required_length(vehicle, 6.0), 1)


class Player:
    """Plays actions from a table and notes what it is shown."""

    def __init__(self, actions: FloatArray) -> None:
        self.actions = actions
        self.seen: list[FloatArray] = []

    def reset(self, num_lanes: int, seed: int) -> None:
        self.seen.clear()

    def act(self, observations: FloatArray) -> FloatArray:
        self.seen.append(observations.copy())
        return self.actions[len(self.seen) - 1]


def drawn(channel: VaryingDelay, periods: int) -> tuple[FloatArray, np.ndarray, np.ndarray]:
    """Lateness and losses of commands, (periods, lanes, 4), and losses of measurements."""
    draws = ChannelDraws(channel, channel.num_lanes, 4)
    readings = np.zeros((channel.num_lanes, 1))
    draws.seen(readings)
    late, lost, same = [], [], []
    for k in range(1, periods + 1):
        draws.renew()
        late.append(draws.later)
        lost.append(draws.lost)
        same.append(draws.seen(readings + k)[:, 0] != k)
    return np.array(late), np.array(lost), np.array(same)


def controlled(
    vehicle: Vehicle,
    track: Track,
    channel: VaryingDelay | None,
    lanes: np.ndarray,
    noise: float = 0.0,
    seconds: float = 3.0,
) -> FloatArray:
    """Accelerations and forces under sky-hook, each lane with delays of its own."""
    delays = np.random.default_rng(3).uniform(0.0, 0.08, (8, 4))[lanes]
    run = rollout(
        SkyHook(35e3, 4),
        vehicle,
        delays,
        seconds,
        tracks=[track],
        stepping=Stepping(sensor_noise=noise),
        channel=channel,
    )
    return run.values


def test_lateness_is_uniform_from_zero_to_the_jitter_of_its_lane() -> None:
    jitter = np.array([0.0, 0.01, 0.06, 0.2])
    late, _, _ = drawn(VaryingDelay([1, 2, 3, 4], jitter), 1000)
    assert not late[:, 0].any()
    share = late[:, 1:] / jitter[1:, None]
    assert share.min() >= 0.0
    assert share.max() <= 1.0
    # 4000 draws a lane: mean 1/2 within sqrt(1/12 / 4000), mean square 1/3 within sqrt(4/45 / 4000)
    assert np.abs(share.mean(axis=(0, 2)) - 0.5).max() < SIGMAS * np.sqrt(1 / 12 / 4000)
    assert np.abs((share**2).mean(axis=(0, 2)) - 1 / 3).max() < SIGMAS * np.sqrt(4 / 45 / 4000)


def test_commands_and_measurements_are_lost_with_the_probabilities_of_their_lane() -> None:
    dropout, sensor = np.array([0.0, 0.1, 0.6]), np.array([0.5, 0.0, 0.2])
    _, lost, same = drawn(VaryingDelay([1, 2, 3], 0.02, dropout, sensor), 4000)
    # a share of n draws has a standard deviation of sqrt(p (1 - p) / n); zero is exact
    for found, p, n in (
        (lost.mean(axis=(0, 2)), dropout, 16000),
        (same.mean(axis=0), sensor, 4000),
    ):
        assert np.all(np.abs(found - p) <= SIGMAS * np.sqrt(p * (1 - p) / n))


def test_draws_of_channels_periods_and_lanes_and_of_lateness_and_loss_are_independent() -> None:
    # neighbouring seeds, as somebody who counts lanes gives them
    late, lost, same = drawn(VaryingDelay([0, 1, 2], 0.02, 0.5, 0.5), 2000)
    columns = np.concatenate([late, lost, same[:, :, None]], axis=2).reshape(2000, -1)
    columns = np.concatenate([columns[:-64], columns[1:-63], columns[64:]], axis=1)
    found = np.asarray(np.corrcoef(columns, rowvar=False))
    # 3240 correlations of 1936 draws, standard deviation 1 / 44 each
    assert np.abs(found - np.eye(len(found))).max() < SIGMAS / np.sqrt(1936)


def test_channels_are_late_together_only_if_jitter_is_common() -> None:
    apart, _, _ = drawn(VaryingDelay([7], 0.02), 100)
    together, lost, _ = drawn(VaryingDelay([7], 0.02, 0.5, common_jitter=True), 100)
    assert np.all(np.ptp(apart, axis=2) > 0.0)
    assert not np.ptp(together, axis=2).any()
    # losses stay each channel's own: four of probability a half agree in one period of eight
    assert np.ptp(lost.astype(int), axis=2).mean() == pytest.approx(7 / 8, abs=0.17)


def test_equal_seeds_are_equal_draws_and_other_seeds_are_others() -> None:
    late, _, _ = drawn(VaryingDelay([5, 6, 5], 0.02), 130)
    np.testing.assert_array_equal(late[:, 0], late[:, 2])
    assert not np.any(late[:, 0] == late[:, 1])


@pytest.mark.parametrize(
    ("model", "env_class"), [(lateral17, Lateral17VectorEnv), (full50, Full50VectorEnv)]
)
def test_a_run_is_that_of_the_vector_environment_with_the_same_draws(
    model: Any, env_class: Any
) -> None:
    lanes, periods, seconds = 3, 130, 1.3
    spec: dict[str, Any] = {"jitter": 0.05, "dropout": 0.2, "sensor_dropout": 0.3}
    delays = np.array([[0.0] * 4, [0.0123] * 4, [0.05, 0.04, 0.0301, 0.02]])
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (periods, lanes, 4)).astype(np.float32)
    env = env_class(
        num_envs=lanes,
        autoreset_mode="disabled",
        layout=4,
        speed_kmh=300.0,
        track="german_low",
        episode_seconds=seconds,
        observation_scale="si",
        **spec,
    )
    first, _ = env.reset(seed=4, options={"track_seed": 5, "delay": delays})
    states = [generator.bit_generator.state for generator in env.np_random]
    steps = [env.step(action) for action in actions]

    vehicle = model("paper_fit", 4, 300.0)
    player = Player(actions.astype(float))
    batch = ControlledBatch(player, vehicle, FORCES, Stepping())
    lateral = lateral17("paper_fit", 4, 300.0)
    tracks = [make_track("german_low", required_length(lateral, seconds), 5)]
    channel = VaryingDelay.of(DelaySpec(**spec), [0, 0, 0])
    batch.reset(delays, tracks, channel=channel)
    # The environment's own streams, in the place where its episode begins.
    for stream, state in zip(batch._draws._streams, states, strict=True):
        stream.bit_generator.state = state
    forces = [batch.advance()[:, -1] for _ in range(periods)]

    # the same commands by the same arithmetic
    np.testing.assert_array_equal(forces, [step[4]["force"] for step in steps])
    shown = np.array([first, *(step[0] for step in steps[:-1])])
    seen = np.array(player.seen)
    assert shown.shape == seen.shape
    size = np.abs(seen).max(axis=(0, 1))
    # Observations are float32, spaced by 1.2e-7 of themselves; before that sums of another order.
    assert np.all(np.abs(shown - seen) <= 2e-7 * np.abs(seen) + 1e-12 * size)
    repeated = np.all(seen[1:, :, : len(SENSORS)] == seen[:-1, :, : len(SENSORS)], axis=2)
    assert 0.1 < repeated.mean() < 0.5  # 390 of probability 0.3


@pytest.mark.parametrize(
    ("jitter", "dropout"), [(0.0, 0.3), (0.0, 0.6), (0.2, 0.0), (0.004, 0.0), (0.1, 0.2)]
)
def test_the_command_that_acts_is_as_old_as_chance_makes_it(
    vehicle: LateralVehicle, jitter: float, dropout: float
) -> None:
    lanes, periods = 16, 400
    ramp = np.broadcast_to(1e-3 * np.arange(float(periods))[:, None, None], (periods, lanes, 4))
    run = rollout(
        Player(ramp),
        vehicle,
        np.zeros((lanes, 4)),
        0.01 * periods,
        record=FORCES,
        channel=VaryingDelay(range(lanes), jitter, dropout),
    )
    newest = DEFAULT_ACTION_SCALE * ramp.transpose(1, 0, 2)
    age = (newest - run.values[:, 1::2]) / (1e-3 * DEFAULT_ACTION_SCALE)
    # At the end of a period the command of i - 1 periods ago has been on its way for i periods: it
    # has arrived with probability (1 - p) min(i T / J, 1). The age is j or more if none of the j
    # newest has.
    chance = (1 - dropout) * np.minimum(0.01 * np.arange(1, 60) / max(jitter, 1e-9), 1.0)
    expected = np.cumprod(1.0 - chance).sum()
    # 64 independent channels, whose spread gives the mean's; 0.6^50 of the start is left
    means = age[:, 50:].mean(axis=1).ravel()
    assert abs(means.mean() - expected) <= SIGMAS * means.std(ddof=1) / np.sqrt(64)


@pytest.mark.parametrize("noise", [0.0, 0.1])
def test_no_jitter_and_no_losses_change_no_bit(
    vehicle: LateralVehicle, track: Track, noise: float
) -> None:
    lanes = np.arange(4)
    plain = controlled(vehicle, track, None, lanes, noise)
    found = controlled(vehicle, track, VaryingDelay([1, 2, 3, 4]), lanes, noise)
    np.testing.assert_array_equal(found, plain)


@pytest.mark.parametrize("model", [lateral17, full50])
def test_a_lane_does_not_depend_on_the_others_or_their_number(model: Any, track: Track) -> None:
    car = model("paper_fit", 4, 300.0)
    seconds = 3.0 if model is lateral17 else 0.8
    values: dict[str, Any] = {
        "jitter": np.array([0.01, 0.05, 0.0, 0.03]),
        "dropout": np.array([0.0, 0.2, 0.5, 0.1]),
        "sensor_dropout": np.array([0.3, 0.0, 0.1, 0.2]),
        "seeds": np.array([3, 1, 4, 1]),
    }

    def found(lanes: list[int]) -> FloatArray:
        channel = VaryingDelay(**{name: each[lanes] for name, each in values.items()})
        return controlled(car, track, channel, np.array(lanes), seconds=seconds)

    together = found([0, 1, 2, 3])
    for lane in range(4):
        np.testing.assert_array_equal(found([lane])[0], together[lane])
    np.testing.assert_array_equal(found([2, 0]), together[[2, 0]])


def test_semi_active_dampers_take_what_varies_too(vehicle: LateralVehicle, track: Track) -> None:
    def found(channel: VaryingDelay | None) -> FloatArray:
        law = SkyHook(35e3, 4)
        law.damper = SemiActiveDamper(0.0, 100e3, 0.01)  # type: ignore[attr-defined]
        delays = np.full((2, 4), 0.02)
        return rollout(law, vehicle, delays, 0.5, tracks=[track], channel=channel).values

    plain = found(None)
    np.testing.assert_array_equal(found(VaryingDelay([1, 2])), plain)
    varied = found(VaryingDelay([1, 1], np.array([0.0, 0.05])))
    np.testing.assert_array_equal(varied[0], plain[0])
    assert not np.array_equal(varied[1], plain[1])


def test_a_passive_vehicle_runs_on_a_channel_that_has_nothing_to_carry(track: Track) -> None:
    car, none = lateral17("paper_fit", "passive", 300.0), np.zeros((1, 0))
    channel = VaryingDelay([1], 0.1, 0.5, 0.5)
    found = rollout(Passive(), car, none, 1.0, tracks=[track], channel=channel)
    plain = rollout(Passive(), car, none, 1.0, tracks=[track])
    np.testing.assert_array_equal(found.values, plain.values)


def test_a_second_run_of_a_batch_begins_its_streams_anew(
    vehicle: LateralVehicle, track: Track
) -> None:
    batch = ControlledBatch(SkyHook(35e3, 4), vehicle, FORCES, Stepping())

    def found(channel: VaryingDelay | None) -> FloatArray:
        batch.reset(np.zeros((1, 4)), [track], channel=channel)
        return np.concatenate([batch.advance() for _ in range(100)], axis=1)

    channel = VaryingDelay([3], 0.05, 0.3, 0.3)
    varied, plain = found(channel), found(None)
    assert not np.array_equal(varied, plain)
    np.testing.assert_array_equal(found(channel), varied)
    np.testing.assert_array_equal(found(None), plain)


def test_a_lost_measurement_shows_the_last_one_with_its_noise(vehicle: LateralVehicle) -> None:
    player = Player(np.zeros((300, 1, 4)))
    rollout(
        player,
        vehicle,
        np.zeros((1, 4)),
        3.0,
        stepping=Stepping(max_delay=0.0, sensor_noise=0.1),
        channel=VaryingDelay([1], sensor_dropout=0.4),
    )
    seen = np.array(player.seen)[:, 0]
    same = seen[1:] == seen[:-1]
    assert np.array_equal(same.all(axis=1), same.any(axis=1))
    # 299 of probability 0.4
    assert abs(same.all(axis=1).mean() - 0.4) < SIGMAS * np.sqrt(0.24 / 299)
    # What arrives is the present: the same noise as without losses.
    perfect = Player(np.zeros((300, 1, 4)))
    stepping = Stepping(max_delay=0.0, sensor_noise=0.1)
    rollout(perfect, vehicle, np.zeros((1, 4)), 3.0, stepping=stepping)
    arrived = np.array([True, *~same.all(axis=1)])
    np.testing.assert_array_equal(seen[arrived], np.array(perfect.seen)[arrived, 0])


def test_a_controller_is_told_the_delay_without_jitter(vehicle: LateralVehicle) -> None:
    told: list[FloatArray] = []
    law = SkyHook(35e3, 4)
    law.tell = told.append  # type: ignore[attr-defined]
    delays = np.full((2, 4), 0.05)
    rollout(law, vehicle, delays, 0.05, channel=VaryingDelay([1, 2], 0.1))
    np.testing.assert_array_equal(told, [[0.05, 0.05]])


def test_a_delay_spec_gives_what_varies_to_every_lane() -> None:
    spec = DelaySpec(0.1, 0.02, 0.03, True, 0.2, 0.4)
    channel = VaryingDelay.of(spec, np.array([4, 9]))
    assert channel.num_lanes == 2
    assert channel.longest_jitter == 0.03
    for values, each in ((channel.jitter, 0.03), (channel.dropout, 0.2)):
        assert np.asarray(values).tolist() == [each, each]
    assert np.asarray(channel.sensor_dropout).tolist() == [0.4, 0.4]
    assert channel.common_jitter is True
    assert VaryingDelay([1]).common_jitter is DelaySpec().common_jitter is False


def test_an_array_that_changes_later_changes_no_channel() -> None:
    jitter = np.array([0.01, 0.02])
    channel = VaryingDelay([1, 2], jitter)
    jitter[:] = 9.0
    assert channel.longest_jitter == 0.02
    with pytest.raises(ValueError, match="read-only"):
        np.asarray(channel.jitter)[0] = 1.0


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"seeds": []}, r"seeds = \[\] must hold one whole number per lane"),
        ({"seeds": 3}, "seeds = 3 must hold one"),
        ({"seeds": [1, -2]}, "seeds = -2 is too small"),
        ({"seeds": [0.5, 1]}, "seeds = 0.5 is not a whole number"),
        ({"jitter": -0.01}, "jitter = -0.01 must not be negative"),
        ({"jitter": np.array([0.0, np.nan])}, "jitter = nan must be finite"),
        ({"jitter": np.zeros(3)}, r"jitter of shape \(3,\) .* must be one number, or 2"),
        ({"jitter": "0.1"}, "jitter of shape .* must be one number"),
        ({"dropout": np.array([0.0, 1.0])}, "dropout = 1 must be below 1"),
        ({"dropout": -0.1}, "dropout = -0.1 must not be negative"),
        ({"sensor_dropout": 1.5}, r"sensor_dropout = 1\.5 must be below 1"),
    ],
)
def test_what_cannot_vary_is_refused_by_name(values: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        VaryingDelay(**{"seeds": [1, 2], **values})


def test_a_channel_of_another_number_of_lanes_is_refused(vehicle: LateralVehicle) -> None:
    with pytest.raises(ArgumentError, match="channel is for 2 lanes and there are 3"):
        rollout(SkyHook(35e3, 4), vehicle, np.zeros((3, 4)), 0.1, channel=VaryingDelay([1, 2]))
