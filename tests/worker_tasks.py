"""Tasks for worker processes, most of them bad, and whether a process is alive."""

import ctypes
import os
import pickle
import signal
import struct
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
import psutil

from eval.workers import Limits, Outcome
from eval.workers.outcome import Reply
from eval.workers.worker import NUMBER_BYTES
from railenv.errors import ControllerError

MIB = 2**20
LIMITS = Limits(seconds=0.8)


def work(task: tuple[str, Any]) -> Any:
    """Do what the task says; most of it is bad."""
    kind, content = task
    return _KINDS[kind](content)


def mean_of_noise(seed: int) -> tuple[float, bytes]:
    noise = np.random.default_rng(seed).standard_normal((40, 40))
    return float(np.linalg.svd(noise @ noise.T)[1].mean()), noise.tobytes()


def _refuse(text: str) -> None:
    raise ControllerError(text)


def _raise(error: Exception) -> None:
    raise error


def _loop(_: object) -> None:
    while True:
        pass


def _hold_the_lock(seconds: int) -> None:
    ctypes.PyDLL(None).sleep(seconds)  # PyDLL keeps the interpreter's lock


def _eat(mib: int) -> None:
    held = [np.ones(10 * MIB // 8) for _ in range(mib // 10)]
    time.sleep(30.0)
    assert held


def _keep(mib: int) -> int:
    _kept.append(np.ones(mib * MIB // 8))
    return os.getpid()


_kept: list[Any] = []


def _once(folder: str) -> str:
    mark = Path(folder) / "begun"
    if mark.exists():
        return "second attempt"
    mark.touch()
    os.kill(os.getpid(), signal.SIGKILL)
    return "never"


def _fork(_: object) -> int:
    child = os.fork()
    if child == 0:
        time.sleep(60.0)
        os._exit(0)
    return child


def _fork_and_die(_: object) -> None:
    _fork(None)
    os._exit(4)


def _fork_and_return(seconds: float) -> str:
    """Return twice: the child so long after the parent, or before it where that is negative."""
    if os.fork() == 0:
        time.sleep(max(0.0, seconds))
        return "child"
    time.sleep(max(0.0, -seconds))
    return "parent"


def _escape(folder: str) -> int:
    """Leave a process that is in no group of the worker's, and its number in a folder."""
    child = os.fork()
    if child == 0:
        os.setsid()
        time.sleep(100.0)
        os._exit(0)
    # Not before it has left the group, in which it would be killed with the worker.
    while os.getpgid(child) != child:
        time.sleep(0.001)
    if folder:
        (Path(folder) / str(child)).touch()
    return child


def _escape_and_die(folder: str) -> None:
    _escape(folder)
    os._exit(3)


def _escape_and_hang(folder: str) -> None:
    _escape(folder)
    _loop(None)


def _half_and_escape(folder: str) -> None:
    _escape(folder)
    threading.Timer(0.3, os._exit, (3,)).start()
    _half_and_hang(None)


def _close_and_hang(_: object) -> None:
    os.closerange(3, 64)
    time.sleep(60.0)


def _answer_twice(times: int) -> str:
    """Send answers of its own making before that of the worker."""
    connection, number = _line("connection"), _line("number")
    message = number.to_bytes(NUMBER_BYTES, "big") + pickle.dumps(Reply("done", "forged"))
    for _ in range(times):
        connection.send_bytes(message)
    return "own"


def _leave_a_thread(_: object) -> int:
    threading.Thread(target=time.sleep, args=(60.0,), daemon=True).start()
    return os.getpid()


def _threads(_: object) -> tuple[int, int, str]:
    import numba
    import torch

    return torch.get_num_threads(), numba.get_num_threads(), os.environ["OMP_NUM_THREADS"]


def _half_and_hang(_: object) -> None:
    """Write what announces a long answer and its first bytes, and go on for ever."""
    os.write(_line("connection").fileno(), struct.pack("!i", MIB) + b"half")
    time.sleep(60.0)


def _line(name: str) -> Any:
    """Return a variable of the worker's own function that answers messages."""
    frame = sys._getframe().f_back
    while frame is not None and frame.f_code.co_name != "serve":
        frame = frame.f_back
    assert frame is not None
    return frame.f_locals[name]


def _half_an_answer(_: object) -> None:
    # The pool is in the middle of the answer by then; where it is not, the end is the same.
    threading.Timer(0.3, os.kill, (os.getpid(), signal.SIGSEGV)).start()
    _half_and_hang(None)


def _kill_the_parent(folder: str) -> str:
    """End the process that started this one: at the first attempt or, without a folder, always."""
    mark = Path(folder) / "begun"
    if folder and mark.exists():
        return "second attempt"
    if folder:
        mark.touch()
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(60.0)
    return "never"


def _note_and_hang(folder: str) -> None:
    (Path(folder) / str(os.getpid())).touch()
    _hold_the_lock(1000)


def held(task: tuple[Path, Callable[[Any], Any], Any]) -> Any:
    """Run a function on a task; on the doomed node, which a file names, never end the second one.

    The other nodes wait until it is at that.
    """
    folder, function, content = task
    node = psutil.Process().parent().parent().pid  # type: ignore[union-attr]
    if (folder / "doomed").read_text() == str(node):
        if (folder / "first").exists():
            (folder / "held").touch()
            time.sleep(600.0)
        (folder / "first").touch()
    else:
        while not (folder / "held").exists():
            time.sleep(0.02)
    return function(content)


def _spoil(owner: str) -> int:
    np.seterr(divide="raise")
    return os.getpid()


def _division(owner: str) -> tuple[int, str]:
    return os.getpid(), np.geterr()["divide"]


class NotReadable:
    def __reduce__(self) -> tuple[Any, ...]:
        return _refuse_to_load, ()


class NotImportable(NotReadable):
    def __call__(self, task: object) -> None: ...


def _refuse_to_load() -> None:
    raise FileNotFoundError("settings of the controller")


_KINDS = {
    "value": lambda value: value,
    "zeros": bytes,
    "noise": mean_of_noise,
    "refuse": _refuse,
    "raise": _raise,
    "exit": sys.exit,
    "loop": _loop,
    "hold": _hold_the_lock,
    "eat": _eat,
    "keep": _keep,
    "_exit": os._exit,
    "null": lambda _: ctypes.string_at(0),
    "kill": lambda _: os.kill(os.getpid(), signal.SIGKILL),
    "once": _once,
    "unsendable": lambda _: lambda: 0,
    "unreadable": lambda _: NotReadable(),
    "pid": lambda _: os.getpid(),
    "sleep": time.sleep,
    "fork": _fork,
    "fork and die": _fork_and_die,
    "fork and return": _fork_and_return,
    "escape": _escape,
    "escape and die": _escape_and_die,
    "escape and hang": _escape_and_hang,
    "half and escape": _half_and_escape,
    "close and hang": _close_and_hang,
    "answer twice": _answer_twice,
    "thread": _leave_a_thread,
    "threads": _threads,
    "print": lambda text: print(text, flush=True),
    "close": lambda _: os.closerange(3, 64),
    "half": _half_an_answer,
    "half and hang": _half_and_hang,
    "note and hang": _note_and_hang,
    "kill the parent": _kill_the_parent,
    "spoil": _spoil,
    "division": _division,
}


def only(outcomes: Iterator[Outcome[Any]]) -> Outcome[Any]:
    (outcome,) = outcomes
    return outcome


def alive(pid: int) -> bool:
    try:
        return psutil.Process(pid).status() != psutil.STATUS_ZOMBIE
    except psutil.NoSuchProcess:
        return False


def gone(pid: int, within: float = 5.0) -> bool:
    until = time.monotonic() + within
    while alive(pid):
        if time.monotonic() > until:
            return False
        time.sleep(0.02)
    return True
