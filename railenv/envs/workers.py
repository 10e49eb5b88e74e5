"""Threads that help with the steps: they share blocks of lanes with the one that calls.

Between the steps a thread stays awake in compiled code for a while, ready for the next one; then it
sleeps until it is woken (`railenv.envs.whole_step`).
"""

import threading
import weakref
from queue import SimpleQueue
from typing import Any

import numpy as np

from railenv.envs.whole_step import APART, FAILED, OWN, IntArray, lead, serve

Inbox = SimpleQueue[bool]


class Workers:
    """Threads that help; they end with this object, or when it is closed.

    Args:
        bundle: What the steps read and write, for good.
        number: Threads, the caller's among them.
    """

    def __init__(self, bundle: Any, number: int) -> None:
        self._bundle = bundle
        self._tally: IntArray = np.zeros(OWN + 2 * APART * number, dtype=np.int64)
        self._asleep = self._tally[OWN + APART :: 2 * APART][1:]
        self._asleep[:] = 1
        self._errors: list[BaseException] = []
        self._inboxes: list[Inbox] = [SimpleQueue() for _ in range(number - 1)]
        self._threads = [
            threading.Thread(
                target=_work,
                args=(bundle, self._tally, k, inbox, self._errors),
                name=f"railenv-lanes-{k}",
                daemon=True,
            )
            for k, inbox in enumerate(self._inboxes, start=1)
        ]
        for thread in self._threads:
            thread.start()
        # The threads hold the boxes, not this object, so that it can be forgotten.
        self._end = weakref.finalize(self, _tell_all_to_end, self._inboxes)

    def step(self) -> None:
        """Advance all lanes by one control period.

        An error of a thread is raised here; nothing can be said about the lanes then.
        """
        for k, inbox in enumerate(self._inboxes):
            if self._asleep[k]:
                self._asleep[k] = 0
                inbox.put(True)
        lead(self._bundle, self._tally)
        if self._errors:
            self._tally[FAILED] = 0
            raise self._errors.pop()

    def close(self) -> None:
        """Let the threads end, and wait for it."""
        self._end()
        for thread in self._threads:
            thread.join()


def _work(
    bundle: Any, tally: IntArray, thread: int, inbox: Inbox, errors: list[BaseException]
) -> None:
    while inbox.get():
        try:
            serve(bundle, tally, thread)
        except BaseException as error:
            # Whatever it is: the caller of `step` waits, and raises it.
            errors.append(error)
            tally[FAILED] = 1


def _tell_all_to_end(inboxes: list[Inbox]) -> None:
    for inbox in inboxes:
        inbox.put(False)
