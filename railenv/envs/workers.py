"""Threads that share the lanes of a step: they wait for work, do it, and say so.

A pool of the standard library does the same, but takes longer to hand a part over than a thousand
lanes take to be stepped.
"""

import threading
import weakref
from collections.abc import Callable
from queue import SimpleQueue

Part = Callable[[], None]
Outbox = SimpleQueue[BaseException | None]
Inbox = SimpleQueue[tuple[Part, Outbox] | None]


class Workers:
    """Threads that each do one part of a job; they end with this object, or when it is closed.

    Args:
        number: Parts of a job; the caller does the first of them itself.
    """

    def __init__(self, number: int) -> None:
        self._inboxes: list[Inbox] = [SimpleQueue() for _ in range(number - 1)]
        self._threads = [
            threading.Thread(target=_work, args=(inbox,), name=f"railenv-lanes-{k}", daemon=True)
            for k, inbox in enumerate(self._inboxes, start=1)
        ]
        for thread in self._threads:
            thread.start()
        # The threads hold the boxes, not this object, so that it can be forgotten.
        self._end = weakref.finalize(self, _tell_all_to_end, self._inboxes)

    def run(self, parts: list[Part]) -> None:
        """Do all parts, one in each thread, and come back when the last is done.

        An error in a part is raised here, after all are done.
        """
        # A box of its own for every job: after an interruption here, the answers still to come
        # must not be taken for those of the next job.
        done: Outbox = SimpleQueue()
        for inbox, part in zip(self._inboxes, parts[1:], strict=True):
            inbox.put((part, done))
        try:
            parts[0]()
        finally:
            errors = [done.get() for _ in self._inboxes]
        for error in errors:
            if error is not None:
                raise error

    def close(self) -> None:
        """Let the threads end, and wait for it."""
        self._end()
        for thread in self._threads:
            thread.join()


def _work(inbox: Inbox) -> None:
    while (job := inbox.get()) is not None:
        part, done = job
        try:
            part()
        except BaseException as error:
            # Whatever it is: the caller of `run` waits for an answer, and raises it.
            done.put(error)
        else:
            done.put(None)


def _tell_all_to_end(inboxes: list[Inbox]) -> None:
    for inbox in inboxes:
        inbox.put(None)
