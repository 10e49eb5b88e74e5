"""What a node of a Ray cluster does with one task: it runs it in a worker process of its own.

A Ray worker keeps a `LocalPool` of one process, so that limits, owners and what a task may do wrong
are those of a run without Ray. The Ray worker itself only hands bytes on: what users' code is made
of is read in the process that may fail.

Loads nothing of Ray.
"""

import hashlib
import os
import pickle
import platform
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from functools import cache, partial
from importlib import metadata
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from eval.workers.outcome import Limits, Reply, last_line
from eval.workers.pool import LocalPool
from railenv.errors import RailenvError

_PACKAGES = ("railenv", "numpy", "scipy", "numba")
_ROOMS = ("railenv", "baselines", "eval")


@dataclass(frozen=True)
class Order:
    """A task as it goes to a node.

    Attributes:
        build: Of whoever orders, see `build`.
        folder: Current folder of whoever orders.
        limits: What the task may use.
        function: The function, pickled.
        task: The task, pickled.
        owner: Whose own code it runs, pickled; see `LocalPool`.
    """

    build: tuple[tuple[str, str], ...]
    folder: str
    limits: Limits
    function: bytes
    task: bytes
    owner: bytes


@cache
def build() -> tuple[tuple[str, str], ...]:
    """Return names and versions of what the bits of a result depend on, railenv's code included."""
    code = hashlib.sha256()
    for room in _ROOMS:
        found = find_spec(room)
        for folder in (found.submodule_search_locations or ()) if found is not None else ():
            for path in sorted(Path(folder).rglob("*.py")):
                name = path.relative_to(folder).as_posix()
                code.update(f"{room}/{name}\n".encode() + path.read_bytes())
    return (
        ("Python", ".".join(platform.python_version_tuple()[:2])),
        *((name, metadata.version(name)) for name in _PACKAGES),
        ("railenv's code", code.hexdigest()[:12]),
    )


def fill(order: Order) -> Reply:
    """Run a task on this node.

    Returns:
        What became of it; the value is a pickled `Reply`, to be read by whoever ordered.

    Raises:
        RailenvError: This node has other versions, or no worker process can be started.
        ArgumentError: The function cannot be imported here, or the memory limit is too small.
    """
    check_build(order.build, platform.node())
    function = _Sealed(order.function, order.folder)
    (outcome,) = _pool(order.limits).run(function, [(order.owner, order.task)])
    return Reply(outcome.status, outcome.value, outcome.message, outcome.seconds)


def check_build(wanted: tuple[tuple[str, str], ...], node: str) -> None:
    """Raise `RailenvError` if a node's versions are not those of whoever orders.

    Args:
        wanted: What `build` returned there.
        node: The node's name, for the message.
    """
    own = dict(build())
    other = [(name, own.get(name), there) for name, there in wanted if own.get(name) != there]
    if other:
        words = ", ".join(f"{name} {here} and not {there}" for name, here, there in other)
        raise RailenvError(
            f"node {node} of the cluster has {words}; rows would not be the same bit for bit: "
            "install the same on all nodes"
        )


_pools: dict[Limits, LocalPool] = {}
"""The pool that this Ray worker keeps; its process ends with the Ray worker."""


def _pool(limits: Limits) -> LocalPool:
    if limits not in _pools:
        for other in list(_pools):
            _pools.pop(other).close()
        # An owner is compared as bytes: nothing of the user's is read here.
        _pools[limits] = LocalPool(1, limits, owner=_owner)
    return _pools[limits]


def _owner(task: tuple[bytes, bytes]) -> bytes | None:
    return task[0] or None


class _Sealed:
    """A function on its way to a worker process, which is not imported before it is there."""

    def __init__(self, function: bytes, folder: str) -> None:
        self._content = function, folder

    def __call__(self, task: tuple[bytes, bytes]) -> bytes:
        return _unsealed(*self._content)(task)

    def __reduce__(self) -> tuple[Any, ...]:
        return _unsealed, self._content


def _unsealed(function: bytes, folder: str) -> Callable[[tuple[bytes, bytes]], bytes]:
    """Return, in a worker process, what answers a task with its pickled value."""
    # On nodes that share their files, names of files mean what they mean at the command line.
    with suppress(OSError):
        os.chdir(folder)
    return partial(_answer, pickle.loads(function))  # noqa: S301 - written by `RayPool`


def _answer(function: Callable[[Any], Any], sealed: tuple[bytes, bytes]) -> bytes:
    try:
        task = pickle.loads(sealed[1])  # noqa: S301 - written by `RayPool`
    except Exception as error:  # importing users' modules may raise anything
        raise RailenvError(f"cannot be read by a worker: {last_line(error)}") from None
    value = function(task)
    try:
        return pickle.dumps(Reply("done", value))
    except Exception as error:  # pickling calls users' code
        raise RailenvError(f"the value cannot be sent back: {last_line(error)}") from None
