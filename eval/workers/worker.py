"""What runs inside a worker process: one numeric thread, one task at a time, no life of its own.

The worker reads (number, kind, content) from its connection, where kind is "function" or "task",
and answers each with one `Reply` behind that number. It ends when the connection closes or its
parent dies.
"""

import faulthandler
import multiprocessing
import os
import pickle
import signal
import sys
import threading
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from eval.workers.outcome import Reply, attempt, last_line

THREAD_NAMES = (
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
    "NUMEXPR_NUM_THREADS",
    "NUMBA_NUM_THREADS",
)
"""Environment variables that must be 1 before a worker's numeric libraries load."""

START_SECONDS = 120.0
"""Longest start of a worker, with everything its function imports [s]."""

_GRACE = 10.0
"""Time past the limit after which a worker ends itself, in case its parent cannot [s]."""


NUMBER_BYTES = 8
"""Length of the number before an answer [byte]."""

_LONGEST = 1e6
"""Longest time that the watchdog is set to [s]; no system counts further than it can."""


def serve(connection: Connection, seconds: float) -> None:
    """Answer messages until the connection closes.

    Args:
        connection: To the pool.
        seconds: Time limit of a task [s].
    """
    _separate()
    _follow_parent()
    own = os.getpid()
    function: Callable[[Any], Any] | None = None
    # The watchdog of faulthandler needs no interpreter lock: a worker that is stuck inside
    # compiled code ends even when its parent was killed.
    with Path(os.devnull).open("w") as nowhere:
        while True:
            try:
                message = connection.recv_bytes()
            except (EOFError, OSError):
                return
            threads = threading.active_count()
            limit = max(START_SECONDS, seconds) + _GRACE  # reading it may import much
            faulthandler.dump_traceback_later(min(limit, _LONGEST), exit=True, file=nowhere)
            number = int.from_bytes(message[:NUMBER_BYTES], "big")
            try:
                kind, content = pickle.loads(message[NUMBER_BYTES:])  # noqa: S301 - the pool's own
            except Exception as error:  # importing users' modules may raise anything
                reply = Reply("failed", message=f"cannot be read by a worker: {last_line(error)}")
            else:
                if kind == "function":
                    function = content
                    reply = Reply("done")
                else:
                    assert function is not None
                    _one_torch_thread()
                    limit = min(seconds + _GRACE, _LONGEST)
                    faulthandler.dump_traceback_later(limit, exit=True, file=nowhere)
                    reply = attempt(function, content)
            if os.getpid() != own:
                # The task has forked, and this is its child: it must neither answer nor take tasks.
                os._exit(0)
            # An answer may wait for as long as the pool is busy elsewhere.
            faulthandler.cancel_dump_traceback_later()
            # A thread left behind would take time and memory from the tasks to come.
            _send(connection, number, replace(reply, clean=threading.active_count() <= threads))


def _send(connection: Connection, number: int, reply: Reply) -> None:
    try:
        message = pickle.dumps(reply)
    except Exception as error:  # pickling calls users' code
        text = f"the value cannot be sent back: {last_line(error)}"
        message = pickle.dumps(replace(reply, status="failed", value=None, message=text))
    connection.send_bytes(number.to_bytes(NUMBER_BYTES, "big") + message)


def _separate() -> None:
    """Leave the parent's terminal, standard output and core dumps alone."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the parent
    if hasattr(os, "setsid"):
        # A session of its own: whatever the worker starts can be killed with it.
        os.setsid()
    if sys.platform != "win32":
        import resource

        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    # Standard output is for results; what a controller prints goes to standard error.
    with suppress(OSError):  # a service may have closed it
        os.dup2(2, 1)


def _follow_parent() -> None:
    """End at once when the parent dies, also in the middle of a task."""
    parent = multiprocessing.parent_process()
    if parent is not None:

        def follow() -> None:
            parent.join()
            os._exit(1)

        threading.Thread(target=follow, daemon=True).start()


def _one_torch_thread() -> None:
    """Set torch to one thread if it is loaded; an earlier task may have set it otherwise."""
    torch = sys.modules.get("torch")
    if torch is not None:
        torch.set_num_threads(1)
