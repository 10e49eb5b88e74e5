"""Seeds of the test tracks: for good, apart from those of training, and private with a salt."""

import hashlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from baselines.training.dev_drive import DEV_POOL
from baselines.training.method import episode_seed
from eval.policy_score_runs import SCORING_SEEDS
from eval.scenarios import TestTracks, commitment
from railenv.envs.rail_env import Lateral17Env
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError
from railenv.track import make_track
from railenv.track.seed_domains import FIRST_TEST_SEED, TRAINING_POOLS, TRAINING_SEEDS

SALT = "a salt of 16 characters"


def test_the_test_tracks_of_v0_are_these() -> None:
    # SHA-256 of "railenv benchmark track/v0//<number>", worked out apart with `sha256sum`:
    # its first 16 digits modulo 2^62, plus 10^9. They must never change under the name v0.
    tracks = TestTracks("v0")
    assert [tracks.seed(k) for k in range(6)] == [
        4349986728146009480,
        4052395079090753853,
        1155902391780708493,
        4047496936921948041,
        2638261996723320446,
        2292237652108598992,
    ]
    assert tracks.stream("german_low/constant:100/3") == 3084425923726308538


@given(st.text(max_size=8), st.text(min_size=16, max_size=24), st.integers(0, 10**6))
def test_test_tracks_and_training_and_judging_cannot_meet(
    version: str, salt: str, number: int
) -> None:
    test = TestTracks(version, salt).seed(number)
    training = episode_seed(number, version, number)
    assert training < TRAINING_POOLS <= DEV_POOL < TRAINING_SEEDS <= FIRST_TEST_SEED <= test
    # Lanes of training have the seeds after that one, 100 000 of them at most.
    assert training + 100_000 < TRAINING_SEEDS


def test_scores_of_policies_are_on_test_seeds_too_and_not_on_those_of_v0() -> None:
    assert SCORING_SEEDS >= FIRST_TEST_SEED
    scoring = range(SCORING_SEEDS, SCORING_SEEDS + 100)
    assert not {TestTracks("v0").seed(k) for k in range(1000)} & {*scoring}


@pytest.mark.parametrize("seed", [FIRST_TEST_SEED, TestTracks("v0").seed(0), 2**63])
def test_no_environment_is_made_with_the_seed_of_a_test_track(seed: int) -> None:
    with pytest.raises(ArgumentError, match=f"pool_seed = {seed} is among the seeds of the tracks"):
        EnvSettings(pool_seed=seed)
    assert EnvSettings(pool_seed=FIRST_TEST_SEED - 1).pool_seed == FIRST_TEST_SEED - 1


def test_no_environment_is_reset_to_a_test_track() -> None:
    env = Lateral17Env(episode_seconds=1.0, track_pool=1)
    try:
        with pytest.raises(ArgumentError, match=r"track_seed = \d+ is among the seeds"):
            env.reset(seed=0, options={"track_seed": TestTracks("v0").seed(0)})
        env.reset(seed=0, options={"track_seed": FIRST_TEST_SEED - 1})
    finally:
        env.close()


def test_the_reset_seed_of_an_environment_makes_no_track() -> None:
    # Any reset seed is allowed, a test track's too: it draws from the pool and realises nothing.
    env = Lateral17Env(episode_seconds=1.0, track_pool=1)
    try:
        tracks = [env.reset(seed=seed)[1]["track"] for seed in (1, TestTracks("v0").seed(0))]
    finally:
        env.close()
    assert tracks[0] == tracks[1]


def test_a_salt_changes_every_track_and_every_draw() -> None:
    public, private = TestTracks("v0"), TestTracks("v0", SALT)
    assert not {public.seed(k) for k in range(1000)} & {private.seed(k) for k in range(1000)}
    assert public.stream("x") != private.stream("x")
    assert TestTracks("v1").seed(0) != public.seed(0)


def test_test_tracks_are_a_thousand_different_ones() -> None:
    assert len({TestTracks("v0").seed(k) for k in range(1000)}) == 1000


def test_a_stream_of_draws_is_no_tracks_seed() -> None:
    tracks = TestTracks("v0", SALT)
    assert not {tracks.seed(k) for k in range(100)} & {tracks.stream(str(k)) for k in range(100)}


def test_two_test_seeds_make_two_tracks() -> None:
    a, b = (make_track("german_low", 500.0, TestTracks("v0").seed(k)) for k in range(2))
    heights = [t.sample("alignment", np.linspace(0.0, 500.0, 1001)) for t in (a, b)]
    # Independent draws: of 500 m with waves up to 200 m a handful of independent values.
    norms = [np.sqrt(np.sum(values**2)) for values in heights]
    assert abs(np.sum(heights[0] * heights[1])) < 0.9 * norms[0] * norms[1]


def test_the_commitment_is_the_sha256_of_the_salt_and_of_none_it_is_empty() -> None:
    # `printf %s "abcdefghijklmnop" | sha256sum`.
    expected = "f39dac6cbaba535e2c207cd0cd8f154974223c848f727f98b3564cea569b41cf"
    assert commitment("abcdefghijklmnop") == expected
    assert commitment(SALT) == hashlib.sha256(SALT.encode()).hexdigest()
    assert commitment("") == ""


@pytest.mark.parametrize("salt", ["x", "2026", "a" * 15])
def test_a_salt_that_could_be_guessed_from_its_commitment_is_refused(salt: str) -> None:
    for made in (commitment, lambda salt: TestTracks("v0", salt)):
        with pytest.raises(ArgumentError, match="could be guessed"):
            made(salt)


def test_a_negative_track_number_is_refused() -> None:
    with pytest.raises(ArgumentError, match="index = -1"):
        TestTracks("v0").seed(-1)
