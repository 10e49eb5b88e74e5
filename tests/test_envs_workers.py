"""The threads that share the lanes of a step."""

import gc
import threading
import time
from queue import SimpleQueue

import pytest

from railenv.envs.workers import Workers


def named() -> list[threading.Thread]:
    return [t for t in threading.enumerate() if t.name.startswith("railenv-lanes")]


def test_every_part_is_done_once_and_in_threads_of_its_own() -> None:
    workers, seen = Workers(3), []
    workers.run([lambda: seen.append(threading.get_ident())] * 3)
    workers.close()
    assert len(seen) == 3
    assert threading.get_ident() in seen


def test_parts_run_at_the_same_time() -> None:
    workers, meeting = Workers(2), threading.Barrier(2, timeout=5.0)
    # either part would wait in vain for the other if they came one after the other
    workers.run([lambda: meeting.wait() and None] * 2)
    workers.close()


def test_an_error_in_a_part_is_raised_after_all_are_done_and_work_goes_on() -> None:
    workers, seen = Workers(2), []

    def fails() -> None:
        raise ValueError("enough")

    with pytest.raises(ValueError, match="enough"):
        workers.run([lambda: seen.append(1), fails])
    workers.run([lambda: seen.append(2), lambda: seen.append(3)])
    workers.close()
    assert sorted(seen) == [1, 2, 3]


def test_an_answer_that_was_not_waited_for_is_not_taken_for_the_next_jobs() -> None:
    workers, late, order = Workers(2), threading.Event(), []

    def interrupted() -> None:
        raise KeyboardInterrupt

    def slow() -> None:
        late.wait(5.0)
        order.append("old")

    # The caller gives up while the other thread is still at work: as an interruption would have it.
    inbox = workers._inboxes[0]
    inbox.put((slow, SimpleQueue()))
    threading.Timer(0.05, late.set).start()
    workers.run([lambda: None, lambda: order.append("new")])
    assert order == ["old", "new"]
    with pytest.raises(KeyboardInterrupt):
        workers.run([interrupted, lambda: order.append("done all the same")])
    assert order[-1] == "done all the same"
    workers.close()


def test_threads_end_when_closed() -> None:
    before = len(named())
    workers = Workers(3)
    assert len(named()) == before + 2
    workers.close()
    assert len(named()) == before


def test_threads_end_when_their_owner_is_forgotten() -> None:
    before = len(named())
    workers = Workers(2)
    workers.run([lambda: None] * 2)
    del workers
    gc.collect()
    deadline = time.monotonic() + 5.0
    while len(named()) > before and time.monotonic() < deadline:
        time.sleep(0.01)
    assert len(named()) == before
