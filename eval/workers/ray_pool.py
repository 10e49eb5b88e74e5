"""A pool on an existing Ray cluster, with the limits and the outcomes of the local one.

Every task is a Ray task of one processor core; what a node does with it is in
`eval.workers.ray_node`. A task whose node or Ray worker is lost is begun again elsewhere. Nodes may
join and leave: as many tasks are under way as the cluster has cores for, and some more, so that no
core waits.

What the nodes need is installed there beforehand: the same versions of Python, Ray, railenv, numpy,
scipy and numba, which is checked; and modules and files of the user's own, which are not sent
either. They are found where the nodes share this process's current folder under the same path, and
modules also where they are installed. What a task prints stays in the logs of its node.

Not known here: progress, records, what a task means.
"""

import sys
import time
from collections import deque
from collections.abc import Callable, Hashable, Iterable, Iterator
from contextlib import ExitStack, redirect_stdout, suppress
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

from eval.workers.outcome import Limits, Outcome, Reply, Task, one_line
from eval.workers.process import Job, opened, packed
from eval.workers.ray_connection import connect
from eval.workers.ray_node import Order, build, fill
from railenv.errors import ArgumentError, RailenvError, check_count

AHEAD = 2
"""Tasks under way per core of the cluster: one that runs, one on its way."""

ATTEMPTS = 4
"""How often a task is begun whose node or Ray worker is lost."""

WITHOUT_CORES = 300.0
"""Longest time that the cluster may have no core at all [s]; a new node may be on its way."""

END_SECONDS = 5.0
"""Longest wait for what is cancelled [s]."""

_LOOK = 1.0
"""Time between two looks at the cluster's cores [s]."""


class RayPool:
    """Runs a function over tasks on a Ray cluster.

    Use it as a context manager; it is connected from the start, and disconnected at the end. In
    between, what this process prints goes to standard error.

    Args:
        address: See `eval.workers.ray_connection.connect`.
        limits: What one task may use.
        jobs: Most tasks at once; None for as many as the cluster has cores.
        owner: Says of a task whose own code it runs; see `LocalPool`.

    Raises:
        ArgumentError: The address is none, or Ray is not installed.
        RailenvError: No cluster answers.
    """

    def __init__(
        self,
        address: str,
        limits: Limits | None = None,
        jobs: int | None = None,
        owner: Callable[[Any], Hashable | None] | None = None,
    ) -> None:
        self._limits = limits if limits is not None else Limits()
        self._jobs = None if jobs is None else check_count("jobs", jobs)
        self._owner = owner
        with ExitStack() as opened_so_far:
            # A thread of Ray prints what happens to nodes, and standard output is for results.
            opened_so_far.enter_context(redirect_stdout(sys.stderr))
            self._ray = connect(address)
            # Ray ends what this process still has on the cluster.
            opened_so_far.callback(self._ray.shutdown)
            # No retries by Ray: how often a task was begun is counted here.
            self._fill = self._ray.remote(num_cpus=1, max_retries=0)(fill)
            self._ending = opened_so_far.pop_all()
        self._under_way: dict[Any, Job] = {}
        self._cores, self._looked, self._with_cores = 0.0, -float("inf"), time.monotonic()
        self._running = self._closed = self._proved = False

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def close(self) -> None:
        """Stop what is under way and disconnect."""
        if not self._closed:
            self._closed = True
            with self._ending:
                self._cancel()

    def run(
        self, function: Callable[[Task], Any], tasks: Iterable[Task]
    ) -> Iterator[Outcome[Task]]:
        """Yield the outcome of each task, in order of completion; see `LocalPool.run`.

        A task is "crashed" also where its node or Ray worker was lost `ATTEMPTS` times.

        Raises:
            ArgumentError: Function or task cannot be sent, or not be read by the nodes; the pool
                is at work or closed; the memory limit is below what a worker needs at rest.
            RailenvError: Nodes have other versions, the cluster loses every worker, or it has had
                no core for `WITHOUT_CORES`.
        """
        self._check_open()
        return self._run(function, tasks)

    def _run(
        self, function: Callable[[Task], Any], tasks: Iterable[Task]
    ) -> Iterator[Outcome[Task]]:
        self._check_open()
        if self._running:
            raise ArgumentError("run: the pool is at work; finish or close the other run first")
        self._running = True
        try:
            content = packed("function", function)
            source = iter(tasks)
            again: deque[Job] = deque()
            more = True
            while True:
                places = self._places()
                while len(self._under_way) < places and (again or more):
                    try:
                        job = again.popleft() if again else self._job(next(source))
                    except StopIteration:
                        more = False
                    else:
                        self._begin(content, job)
                if not (self._under_way or again or more):
                    return
                for reference in self._ended():
                    outcome = self._outcome(reference, again)
                    if outcome is not None:
                        yield outcome
                    self._check_open()
        except (self._ray.exceptions.RayError, ConnectionError) as error:
            raise RailenvError(
                f"the connection to the Ray cluster is lost ({one_line(str(error))[:200]}); "
                "what is finished is kept"
            ) from None
        finally:
            self._running = False
            self._cancel()

    def _check_open(self) -> None:
        if self._closed:
            raise ArgumentError("run: the pool is closed; make a new one")

    def _job(self, task: Any) -> Job:
        return Job(task, None if self._owner is None else self._owner(task))

    def _places(self) -> int:
        """Return how many tasks may be under way, by the cores that the cluster has now."""
        now = time.monotonic()
        if now - self._looked >= _LOOK:
            self._looked = now
            self._cores = float(self._ray.cluster_resources().get("CPU", 0.0))
            if self._cores >= 1.0:
                self._with_cores = now
            elif now - self._with_cores > WITHOUT_CORES:
                raise RailenvError(
                    f"the Ray cluster has had no processor core for {WITHOUT_CORES:g} s; "
                    "what is finished is kept"
                )
        places = max(1, int(AHEAD * self._cores))
        return places if self._jobs is None else min(self._jobs, places)

    def _begin(self, function: bytes, job: Job) -> None:
        job.attempts += 1
        order = Order(
            build=build(),
            folder=str(Path.cwd()),
            limits=self._limits,
            function=function,
            task=packed("task", job.task),
            owner=b"" if job.owner is None else packed("owner", job.owner),
        )
        self._under_way[self._fill.remote(order)] = job

    def _ended(self) -> list[Any]:
        """Wait until something has ended, or for another look at the cluster."""
        references = list(self._under_way)
        if not references:
            time.sleep(_LOOK)
            return []
        ready, _ = self._ray.wait(references, num_returns=1, timeout=_LOOK)
        if ready:
            ready, _ = self._ray.wait(references, num_returns=len(references), timeout=0)
        return ready

    def _outcome(self, reference: Any, again: deque[Job]) -> Outcome[Any] | None:
        """Return what became of a task; None if it is begun again."""
        errors = self._ray.exceptions
        job = self._under_way.pop(reference)
        try:
            reply: Reply = self._ray.get(reference)
        except errors.RayTaskError as error:
            raise _of_the_node(error.cause) from None
        except errors.RayError as error:
            if job.attempts < ATTEMPTS:
                again.append(job)
                return None
            words = (
                f"its Ray worker or node was lost in each of {job.attempts} attempts "
                f"({type(error).__name__})"
            )
            if not self._proved:
                raise RailenvError(
                    f"the Ray cluster has finished no task so far: {words}"
                ) from None
            return Outcome(job.task, "crashed", None, words, 0.0)
        self._proved = True
        if reply.status == "done":
            reply = replace(opened(reply.value), seconds=reply.seconds)
        return Outcome(job.task, reply.status, reply.value, reply.message, reply.seconds)

    def _cancel(self) -> None:
        """End what is under way; returns when it has ended, or after `END_SECONDS`."""
        references, self._under_way = list(self._under_way), {}
        with suppress(self._ray.exceptions.RayError, ConnectionError):
            # First an interruption, so that a Ray worker stops its process and what hangs there.
            for reference in references:
                self._ray.cancel(reference, force=False)
            if references:
                _, left = self._ray.wait(
                    references, num_returns=len(references), timeout=END_SECONDS
                )
                for reference in left:
                    self._ray.cancel(reference, force=True)


def _of_the_node(cause: BaseException) -> RailenvError:
    """Return what a node has raised, which is about the run as a whole and no task's fault."""
    if isinstance(cause, ArgumentError):
        return ArgumentError(str(cause))
    if isinstance(cause, RailenvError):
        return RailenvError(str(cause))
    words = one_line(f"{type(cause).__name__}: {cause}")
    return RailenvError(
        f"a node of the Ray cluster cannot take tasks ({words[-300:]}); is railenv installed there?"
    )
