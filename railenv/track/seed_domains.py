"""Whose tracks have which seeds: training, judging, scoring. One home, so that they cannot meet.

Seeds from 0 count, in this order:

- below `TRAINING_POOLS`: tracks and episodes of training;
- from there below `TRAINING_SEEDS`: tracks by which checkpoints of a training are judged;
- from `FIRST_TEST_SEED` up: tracks of scores and benchmarks. No environment is made with such a
  seed and none is reset to such a track, so that nobody trains on one by accident.

Between the last two lies nobody's land. Whoever means to train on test tracks can do so in other
ways; against that a benchmark has private salts (`eval.scenarios.seeds`).
"""

from railenv.errors import ArgumentError, check_count

TRAINING_POOLS = 900_000
"""Pools of tracks for training have seeds below; the judge takes its own from there up."""

TRAINING_SEEDS = 1_000_000
"""Tracks and episodes of training and its judge have seeds below."""

FIRST_TEST_SEED = 1_000_000_000
"""Tracks of scores and benchmarks have seeds from here up."""


def check_no_test_seed(name: str, seed: object) -> int:
    """Return a seed that an environment may have, or raise `ArgumentError`.

    Args:
        name: What the seed is, for messages.
        seed: Whole number from 0.

    Raises:
        ArgumentError: It is no such number, or it is one of the tracks of scores and benchmarks.
    """
    number = check_count(name, seed, minimum=0)
    if number >= FIRST_TEST_SEED:
        raise ArgumentError(
            f"{name} = {number} is among the seeds of the tracks that score and benchmark run on; "
            f"environments take seeds below {FIRST_TEST_SEED}"
        )
    return number
