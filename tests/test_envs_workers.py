"""The threads that help with the steps."""

import gc
import threading
import time

import numpy as np
import pytest

from railenv.envs import workers as module
from railenv.envs.lanes import Lanes
from railenv.envs.settings import EnvSettings
from railenv.envs.workers import Workers

NUMBER = 200


def named() -> list[threading.Thread]:
    return [t for t in threading.enumerate() if t.name.startswith("railenv-lanes")]


def lanes() -> Lanes:
    made = Lanes(EnvSettings(delay=(0.0, 0.3), track_pool=2), NUMBER)
    made.generators = [np.random.Generator(np.random.PCG64(k)) for k in range(NUMBER)]
    made.reset(np.arange(NUMBER))
    return made


def asleep(workers: Workers) -> bool:
    """Wait until all of them sleep; at first they may have to be compiled."""
    deadline = time.monotonic() + 120.0
    while not workers._asleep.all() and time.monotonic() < deadline:
        time.sleep(0.001)
    return bool(workers._asleep.all())


def step_until_it_fails(workers: Workers) -> None:
    for _ in range(1000):
        workers.step()
        time.sleep(0.001)


def test_a_thread_that_was_left_alone_for_a_while_sleeps_and_is_woken_by_the_next_step() -> None:
    made = lanes()
    workers = Workers(made._bound(), 2)
    for period in range(1, 6):
        workers.step()
        assert np.all(made.here.periods == period)
        assert asleep(workers)
    workers.close()


def test_a_thread_stays_awake_between_steps_that_follow_each_other(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    served = []

    def counted(*arguments: object) -> None:
        served.append(1)
        serve(*arguments)

    serve = module.serve
    monkeypatch.setattr(module, "serve", counted)
    workers = Workers(lanes()._bound(), 2)
    for _ in range(500):
        workers.step()
    workers.close()
    # Woken for every step it would be 500 times; on a busy machine it may fall asleep now and then.
    assert 1 <= len(served) < 250


def test_an_error_of_a_thread_is_raised_and_work_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise ValueError("enough")

    made = lanes()
    monkeypatch.setattr(module, "serve", fails)
    workers = Workers(made._bound(), 2)
    with pytest.raises(ValueError, match="enough"):
        step_until_it_fails(workers)
    monkeypatch.undo()
    before = made.here.periods.copy()
    workers.step()
    workers.close()
    np.testing.assert_array_equal(made.here.periods, before + 1)


def test_threads_end_when_closed() -> None:
    before = len(named())
    workers = Workers(lanes()._bound(), 3)
    workers.step()
    assert len(named()) == before + 2
    workers.close()
    assert len(named()) == before


def test_threads_end_when_their_owner_is_forgotten() -> None:
    before = len(named())
    workers = Workers(lanes()._bound(), 2)
    workers.step()
    del workers
    gc.collect()
    deadline = time.monotonic() + 5.0
    while len(named()) > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert len(named()) == before
