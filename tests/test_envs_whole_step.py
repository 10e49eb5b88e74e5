"""The one compiled pass: blocks of lanes, shared among threads, and recompiled with their parts."""

import subprocess
import sys

import numpy as np
import pytest

from railenv.envs import whole_step as module
from railenv.envs.lanes import Lanes
from railenv.envs.settings import EnvSettings

FUNCTIONS = ("step", "take_blocks", "lead", "serve", "begin_lanes")


def lanes(number: int, threads: int = 1) -> Lanes:
    made = Lanes(EnvSettings(delay=(0.0, 0.3), track_pool=2), number, threads)
    made.generators = [np.random.Generator(np.random.PCG64(k)) for k in range(number)]
    made.reset(np.arange(number))
    return made


def test_lanes_beyond_one_block_are_the_same_as_in_one_block() -> None:
    # more lanes than are taken at once, against the last of them alone
    number = module.AT_ONCE + 3
    many, one = lanes(number), lanes(number)
    rng = np.random.default_rng(0)
    one.here.active[:-1] = False
    for _ in range(30):
        many.here.actions[:] = one.here.actions[:] = rng.uniform(-1.0, 1.0, (number, 4))
        many.step()
        one.step()
        np.testing.assert_array_equal(many.here.observation[-1], one.here.observation[-1])
        assert many.here.reward[-1] == one.here.reward[-1]


@pytest.mark.parametrize("number", [5, 2 * module.AT_ONCE, 5 * module.AT_ONCE - 1])
def test_every_lane_is_stepped_once_whatever_the_number_of_threads(number: int) -> None:
    alone, shared = lanes(number), lanes(number, threads=3)
    rng = np.random.default_rng(1)
    for period in range(1, 31):
        alone.here.actions[:] = shared.here.actions[:] = rng.uniform(-1.0, 1.0, (number, 4))
        alone.step()
        shared.step()
        assert np.all(shared.here.periods == period)
        np.testing.assert_array_equal(alone.here.observation, shared.here.observation)
        np.testing.assert_array_equal(alone.here.reward, shared.here.reward)
    shared.close()


def test_lanes_that_take_no_part_earn_nothing_and_are_not_over() -> None:
    made = lanes(3)
    made.here.periods[:] = made.settings.num_periods() - 1
    made.here.active[1] = False
    before = made.here.observation[1].copy()
    made.step()
    assert made.here.truncated.tolist() == [True, False, True]
    assert made.here.reward[1] == 0.0
    np.testing.assert_array_equal(made.here.observation[1], before)


def test_the_compilers_cache_looks_at_the_source_of_every_part() -> None:
    digest = module._digest()  # type: ignore[attr-defined]
    files = {part.__name__ for part in module._PARTS}  # type: ignore[attr-defined]
    for name in FUNCTIONS:
        cells = [c.cell_contents for c in getattr(module, name).py_func.__closure__]
        # nothing else: a compiled function there is another one in every process
        assert cells == [digest]
    called = {
        value.py_func.__module__
        for value in vars(module).values()
        if hasattr(value, "py_func") and value.py_func.__module__ != module.__name__
    }
    assert called <= files


@pytest.mark.slow
def test_a_second_process_compiles_nothing() -> None:
    code = (
        "import numpy as np\n"
        "from railenv.envs import whole_step as module\n"
        "from railenv.envs.lanes import Lanes\n"
        "from railenv.envs.settings import EnvSettings\n"
        "made = Lanes(EnvSettings(delay=(0.0, 0.3), track_pool=2), 5)\n"
        "made.reset(np.arange(5))\n"
        "made.step()\n"
        "print(*(sum(f.stats.cache_misses.values()) for f in (module.step, module.begin_lanes)))\n"
    )
    lanes(5).step()
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, timeout=300
    )
    assert done.stdout.split() == ["0", "0"]
