"""What an episode draws: vehicle, track, level, place, delays, and the pools behind them."""

from typing import Any

import numpy as np
import pytest
from scipy.stats import kstest

from railenv.actuation import DelaySpec
from railenv.envs.rail_env import Lateral17Env
from railenv.envs.rail_vector_env import Lateral17VectorEnv
from railenv.envs.start import APART, GAIN, MOMENTS, RUN_IN
from railenv.errors import ArgumentError
from railenv.simulation import LateralSimulation, required_length, wheelset_inputs
from railenv.track import make_track
from railenv.vehicle import state_space
from railenv.vehicle.randomisation import NAMED_RANGES, VehicleRanges

LANES = 2000
SHORT: dict[str, Any] = {"episode_seconds": 1.0, "track_pool": 2}


def many(**settings: Any) -> tuple[Lateral17VectorEnv, dict[str, Any]]:
    """Many episodes at once."""
    env = Lateral17VectorEnv(LANES, **{**SHORT, "action_history": 0, **settings})
    return env, env.reset(seed=0)[1]


def assert_uniform(values: np.ndarray, low: float, high: float) -> None:
    assert values.min() >= low
    assert values.max() <= high
    # fixed seeds: a right draw fails this for one seed in a million
    assert kstest(values, "uniform", args=(low, high - low)).pvalue > 1e-6


def test_a_delay_range_is_drawn_uniformly_and_the_same_for_all_channels() -> None:
    info = many(delay=(0.05, 0.25))[1]
    assert np.all(np.ptp(info["delay"], axis=1) == 0.0)
    assert_uniform(info["delay"][:, 0], 0.05, 0.25)


def test_a_delay_range_per_channel_is_drawn_for_each_by_itself() -> None:
    info = many(delay=(0.05, 0.25), delay_per_channel=True)[1]
    for channel in range(4):
        assert_uniform(info["delay"][:, channel], 0.05, 0.25)
    # six correlations of 2000 independent pairs: standard deviation 0.022
    assert np.abs(np.corrcoef(info["delay"].T) - np.eye(4)).max() < 0.11


def test_a_sensor_delay_range_is_drawn_by_itself_and_added() -> None:
    info = many(delay=(0.0, 0.1), sensor_delay=(0.02, 0.07))[1]
    assert_uniform(info["sensor_delay"], 0.02, 0.07)
    rest = info["delay"][:, 0] - info["sensor_delay"]
    assert_uniform(np.round(rest, 15), 0.0, 0.1)
    assert abs(np.corrcoef(rest, info["sensor_delay"])[0, 1]) < 0.11


def test_a_delay_spec_is_the_delay_of_its_channels() -> None:
    info = Lateral17Env(**SHORT, delay=DelaySpec((0.1, 0.2, 0.0, 0.05))).reset(seed=0)[1]
    assert info["delay"].tolist() == [0.1, 0.2, 0.0, 0.05]


def test_every_part_of_the_delay_may_reach_the_longest_delay_together() -> None:
    # 0.1 + 0.2 is a rounding above 0.3
    for settings in ({"sensor_delay": 0.1}, {"jitter": 0.1}):
        Lateral17Env(**SHORT, delay=0.2, max_delay=0.3, **settings).reset(seed=0)


def test_the_told_delay_is_wrong_by_less_than_its_error_and_never_negative() -> None:
    _, info = many(delay=(0.01, 0.2), told_error=0.03, delay_observed=True)
    error = info["told_delay"] - info["delay"]
    assert np.all(np.ptp(error, axis=1) < 1e-15)  # one error for all channels
    assert info["told_delay"].min() >= 0.0
    long = info["delay"][:, 0] >= 0.03
    assert_uniform(np.round(error[long, 0], 15), -0.03, 0.03)
    short = info["delay"][:, 0] < 0.03
    assert_uniform(info["told_delay"][short, 0] / (info["delay"][short, 0] + 0.03), 0.0, 1.0)


@pytest.mark.parametrize(("scale", "unit"), [("controlled", 0.3), ("si", 1.0)])
def test_the_told_delay_is_the_last_column(scale: str, unit: float) -> None:
    env = Lateral17Env(**SHORT, delay=0.12, delay_observed=True, observation_scale=scale)
    observation, info = env.reset(seed=0)
    assert env.observation_names[-1] == "told_delay"
    assert env.observation_scales[-1] == pytest.approx(unit)
    # float32
    assert observation[-1] * unit == pytest.approx(0.12, rel=2e-7)
    assert info["told_delay"].tolist() == info["delay"].tolist() == [0.12] * 4


def test_channels_that_differ_are_told_one_by_one() -> None:
    delays = (0.1, 0.2, 0.0, 0.05)
    env = Lateral17Env(**SHORT, delay=DelaySpec(delays), delay_observed=True)
    observation, _ = env.reset(seed=0)
    assert env.observation_names[-4:] == tuple(f"told_delay_{c}" for c in (1, 2, 3, 4))
    np.testing.assert_allclose(observation[-4:] * 0.3, delays, rtol=2e-7)
    assert env.step(np.zeros(4))[0][-4:].tolist() == observation[-4:].tolist()


def test_a_hidden_delay_is_in_no_column() -> None:
    env = Lateral17Env(**SHORT, delay=(0.0, 0.3), action_history=0)
    options = ({"delay": 0.0}, {"delay": 0.3})
    first, second = (env.reset(seed=3, options=given)[0] for given in options)
    np.testing.assert_array_equal(first, second)
    assert "told_delay" not in env.reset(seed=3)[1]


def test_delays_per_channel_that_one_told_column_cannot_tell_are_refused() -> None:
    env = Lateral17Env(**SHORT, delay=0.1, delay_observed=True)
    with pytest.raises(ArgumentError, match="told"):
        env.reset(options={"delay": [0.05, 0.2, 0.1, 0.1]})


@pytest.mark.parametrize("name", ["vehicle", "track", "place", "level", "moment"])
def test_episodes_choose_evenly(name: str) -> None:
    settings = {"vehicle_ranges": "narrow", "vehicle_pool": 5, "track_level": (0.5, 2.0)}
    start = "controlled" if name == "moment" else "rest"
    env, info = many(**settings, start=start)
    episodes = env._lanes.episodes
    places = episodes.places
    if name == "level":
        # of the power spectral density, as the setting says
        assert_uniform(places.amplitude**2, 0.5, 2.0)
        return
    if name == "place":
        assert_uniform(places.start / episodes.tracks[0].length, 0.0, 1.0)
        return
    chosen = np.unique(places.start) if name == "moment" else info[name]
    if name == "moment":
        # 2000 episodes miss none of the states of 5 vehicles on 2 tracks
        assert len(chosen) == 5 * 2 * MOMENTS
        return
    number = {"vehicle": 5, "track": 2}[name]
    counts = np.bincount(info[name], minlength=number)
    # five standard deviations of a binomial count
    assert np.all(np.abs(counts - LANES / number) < 5 * np.sqrt(LANES / number))


def test_draws_of_an_episode_are_independent_of_each_other() -> None:
    env, info = many(
        vehicle_ranges="narrow",
        vehicle_pool=64,
        track_level=(0.5, 2.0),
        delay=(0.0, 0.1),
        delay_per_channel=True,
        sensor_delay=(0.0, 0.1),
        told_error=0.001,
        delay_observed=True,
    )
    places = env._lanes.episodes.places
    drawn = np.column_stack(
        [
            info["vehicle"],
            info["track"],
            places.start,
            places.amplitude,
            info["delay"] - info["sensor_delay"][:, None],
            info["sensor_delay"],
            (info["told_delay"] - info["delay"])[:, :1],
        ]
    )
    # 2000 pairs: standard deviation 0.022
    assert np.abs(np.corrcoef(drawn.T) - np.eye(drawn.shape[1])).max() < 0.12


def test_fixing_something_does_not_change_what_else_is_drawn() -> None:
    env = Lateral17Env(
        **SHORT, vehicle_ranges="narrow", vehicle_pool=4, delay=(0.0, 0.2), track_level=(0.5, 2.0)
    )

    def drawn(options: dict[str, Any] | None) -> dict[str, Any]:
        info = env.reset(seed=12, options=options)[1]
        places = env._lanes.episodes.places
        kept = {name: info[name] for name in ("vehicle", "track")}
        return {
            **kept,
            "delay": info["delay"].tolist(),
            "start": places.start.tolist(),
            "level": places.amplitude.tolist(),
        }

    free = drawn(None)
    other = (free["vehicle"] + 1) % 4
    assert drawn({"vehicle": other}) == {**free, "vehicle": other}
    assert drawn({"delay": 0.123}) == {**free, "delay": [0.123] * 4}


def test_the_pools_depend_on_their_seed_and_not_on_the_lanes() -> None:
    settings = {**SHORT, "vehicle_ranges": "wide", "vehicle_pool": 3, "start": "controlled"}

    def pools(lanes: int, **more: Any) -> list[np.ndarray]:
        episodes = Lateral17VectorEnv(lanes, **settings, **more)._lanes.episodes
        assert episodes.start_pool is not None
        arrays = episodes.table.arrays
        return [arrays.pairs, episodes.track_table.weights, episodes.start_pool.states]

    one, five, other = pools(1), pools(5), pools(1, pool_seed=1)
    for a, b, c in zip(one, five, other, strict=True):
        np.testing.assert_array_equal(a, b)
        assert not np.array_equal(a, c)


def test_a_larger_pool_holds_the_smaller_one() -> None:
    few, more = (
        Lateral17Env(
            episode_seconds=1.0, vehicle_ranges="wide", vehicle_pool=number, track_pool=number
        )
        for number in (2, 5)
    )
    for mine, theirs in zip(few.vehicles, more.vehicles, strict=False):
        assert (mine.parameters, mine.speed) == (theirs.parameters, theirs.speed)
    weights = few._lanes.episodes.track_table.weights
    same = more._lanes.episodes.track_table.weights[: len(weights)]
    np.testing.assert_array_equal(same, weights)


@pytest.mark.parametrize("name", ["narrow", "wide"])
def test_vehicles_lie_in_their_named_ranges(name: str) -> None:
    env = Lateral17Env(**SHORT, vehicle_ranges=name, vehicle_pool=16)
    ranges = NAMED_RANGES[name]
    assert len(env.vehicles) == 16
    assert ranges.conicity is not None
    conicities = [vehicle.parameters.conicity for vehicle in env.vehicles]
    assert ranges.conicity[0] <= min(conicities) < max(conicities) <= ranges.conicity[1]
    speeds = {round(3.6 * vehicle.speed, 9) for vehicle in env.vehicles}
    assert speeds == {300.0} if ranges.speed_kmh is None else 200.0 <= min(speeds) < max(speeds)


def test_info_says_which_vehicle_at_which_speed_is_running() -> None:
    ranges = VehicleRanges(speed_kmh=(200.0, 250.0))
    env = Lateral17Env(**SHORT, vehicle_ranges=ranges, vehicle_pool=4)
    seen = set()
    for seed in range(12):
        info = env.reset(seed=seed)[1]
        assert env.vehicle is env.vehicles[info["vehicle"]]
        assert info["speed"] == env.vehicle.speed
        seen.add(info["vehicle"])
    assert seen == {0, 1, 2, 3}


def test_a_fixed_track_seed_is_the_track_of_that_seed_from_its_beginning() -> None:
    env = Lateral17Env(track="german_low", episode_seconds=2.0, track_pool=1)
    env.reset(seed=0, options={"track_seed": 7})
    track = make_track("german_low", required_length(env.vehicle, 2.0), 7)
    expected = wheelset_inputs(env.vehicle, track, 0.005, 400)
    seen = []
    for _ in range(200):
        env.step(np.zeros(4))
        seen.append(env._lanes._batch.track[0, 1:].copy())
    # the same spline, evaluated in another form, of heights of some mm
    np.testing.assert_allclose(np.concatenate(seen), expected[1:], atol=1e-15)


def sky_hook_run(env: Lateral17Env, vehicle: int, moment: int) -> tuple[np.ndarray, np.ndarray]:
    """Run a vehicle of the pool by hand as the pool of states says; its last state and inputs."""
    episodes = env._lanes.episodes
    pool = episodes.start_pool
    assert pool is not None
    car = env.vehicles[vehicle]
    # every run of the vehicle was stopped at the same moments
    seconds = RUN_IN + (moment % MOMENTS + 1) * APART
    steps = round(seconds / 0.005)
    travelled = car.speed * 0.005 * np.arange(steps + 1)
    start = pool.place[vehicle, moment] - travelled[-1]
    track = episodes.tracks[pool.track[vehicle, moment]]
    inputs = np.zeros((steps + 1, 8))
    for w, setback in enumerate(car.wheelset_setback):
        rolled = travelled - setback
        weight = np.where(
            rolled < 0, 0.0, 0.5 - 0.5 * np.cos(np.pi * np.clip(rolled / track.taper, 0, 1))
        )
        alignment, cross_level = track.heights(start + rolled)
        inputs[:, w] = weight * alignment
        inputs[:, 4 + w] = weight * cross_level / (2 * car.parameters.half_contact_spacing)
    names = tuple(f"carbody_lateral_velocity_{k}" for k in (1, 2, 3, 4))
    simulation = LateralSimulation(car, names)
    simulation.reset(np.zeros((1, 4)), inputs[None])
    measured = simulation.measure()
    for _ in range(steps // 2):
        measured = simulation.advance(-GAIN * measured)[:, -1]
    return simulation.state[0], inputs[-1]


def test_a_controlled_start_is_a_moment_of_a_run_under_a_sky_hook() -> None:
    settings = {"start": "controlled", "vehicle_ranges": "wide", "vehicle_pool": 2}
    env = Lateral17Env(**SHORT, **settings, track_level=(0.49, 0.49))
    pool = env._lanes.episodes.start_pool
    assert pool is not None
    env.reset(seed=4, options={"vehicle": 1})
    place = env._lanes.episodes.places.start[0]
    moment = int(np.argmin(np.abs(pool.place[1] - place)))
    state, inputs = sky_hook_run(env, 1, moment)
    # a level of 0.49 is an amplitude of 0.7; 1600 or more steps of another rounding
    np.testing.assert_allclose(env._lanes.state(0), 0.7 * state, atol=1e-12)
    # wheelsets behind the first one are on the irregularity, too
    np.testing.assert_allclose(env._lanes._batch.track[0, -1], 0.7 * inputs, atol=1e-14)
    assert np.all(inputs != 0.0)


def test_controlled_starts_of_one_vehicle_lie_on_every_track_of_the_pool() -> None:
    info = many(start="controlled", track_pool=6)[1]
    assert set(info["track"]) == set(range(6))


def test_a_controlled_start_reads_as_a_controlled_vehicle() -> None:
    env, _ = many(start="controlled", vehicle_ranges="narrow", vehicle_pool=64)
    observations = env.reset(seed=1)[0]
    squares = np.sqrt((observations[:, :4] ** 2).mean())
    # in units of the controlled response: of the order of one, not of the uncontrolled resonance
    assert 0.2 < squares < 3.0


def test_a_start_at_rest_is_at_rest() -> None:
    env = Lateral17Env(**SHORT)
    env.reset(seed=0)
    assert not np.any(env._lanes.state(0))


def test_the_state_of_the_environment_has_the_states_of_the_vehicle() -> None:
    env = Lateral17Env(**SHORT, actuator_lag=0.02)
    env.reset(seed=0)
    assert env._lanes.state(0).shape == (len(state_space(env.vehicle).states) + 4,)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"vehicle": 1}, "vehicle = 1 .* pool has 1"),
        ({"vehicle": -1}, "vehicle"),
        ({"vehicle": 0.5}, "vehicle"),
        ({"track_seed": -1}, "track_seed"),
        ({"track_seed": 1.5}, "track_seed"),
        ({"delay": DelaySpec(0.1, jitter=0.1)}, "jitter"),
        ({"delay": -0.1}, "delay"),
        ({"delay": None}, "delay"),
        ({"seed": 3}, "reset option"),
        ({5: 3}, "reset option"),
    ],
)
def test_a_bad_option_is_refused_by_name(options: dict, message: str) -> None:
    for env in (Lateral17Env(**SHORT), Lateral17VectorEnv(2, **SHORT)):
        with pytest.raises(ArgumentError, match=message):
            env.reset(seed=0, options=options)


@pytest.mark.parametrize("settings", [{"track": ("tb3352", "flat")}, {"start": "controlled"}])
def test_a_track_seed_that_cannot_mean_one_track_is_refused(settings: dict) -> None:
    env = Lateral17Env(**SHORT, **settings)
    with pytest.raises(ArgumentError, match="track_seed"):
        env.reset(seed=0, options={"track_seed": 3})
