"""A connection to a Ray cluster that exists: within bounds of time, and quietly.

Ray itself waits for minutes where nobody answers, and may end the whole process; so the address is
tried first from a process of its own. No cluster is ever started here.
"""

import json
import logging
import signal
import socket
import subprocess
import sys
import threading
from collections.abc import Generator
from contextlib import contextmanager
from typing import Any

from eval.workers.outcome import one_line
from railenv.errors import ArgumentError, RailenvError

KNOCK_SECONDS = 5.0
"""Longest wait for a port to open [s]."""

ANSWER_SECONDS = 60.0
"""Longest wait for the cluster's answer where a port is open [s]."""

_CLIENT = "ray://"

_TRIAL = """
import json, sys
import ray
try:
    ray.init(address=sys.argv[1], log_to_driver=False, configure_logging=False)
    answer = ""
except Exception as error:
    answer = type(error).__name__ + ": " + str(error)
print(json.dumps({"railenv": answer}), flush=True)
"""


def connect(address: str) -> Any:
    """Connect this process to a cluster.

    Args:
        address: HOST:PORT of its head (from a machine that is a node of it), ray://HOST:PORT of its
            client server (from anywhere), or auto (the one that runs on this machine).

    Returns:
        The package `ray`; `shutdown` of it disconnects.

    Raises:
        ArgumentError: The address is none, or Ray is not installed.
        RailenvError: No cluster answers there, or it has another version of Ray or Python.
    """
    _check_address(address)
    try:
        import ray
    except ImportError:
        raise ArgumentError(
            '--ray needs the package ray, which is not installed; pip install "railenv[cluster]"'
        ) from None
    if ray.is_initialized():
        raise ArgumentError("this process is connected to a Ray cluster already; disconnect first")
    _knock(address)
    _try(address)
    with _own_signals():
        try:
            ray.init(
                address=address,
                log_to_driver=False,
                logging_level=logging.CRITICAL,
                namespace="railenv",
            )
        except Exception as error:  # whatever Ray raises of a cluster that has just gone
            raise _no_answer(address, str(error)) from None
    return ray


def _check_address(address: str) -> None:
    """Raise `ArgumentError` unless an address is of a form that means an existing cluster."""
    if address == "auto":
        return
    host, _, port = address.removeprefix(_CLIENT).rpartition(":")
    named = bool(host) and not set(host) & set("/ \t\n@?#")
    if not named or not port.isascii() or not port.isdigit() or not 0 < int(port) < 2**16:
        raise ArgumentError(
            f"ray = {address[:100]!r} is no address of a cluster; give HOST:PORT, "
            "ray://HOST:PORT or auto"
        )


def _knock(address: str) -> None:
    """Raise `RailenvError` if nobody listens at a port."""
    if address == "auto":
        return
    host, _, port = address.removeprefix(_CLIENT).rpartition(":")
    try:
        with socket.create_connection((host.strip("[]"), int(port)), KNOCK_SECONDS):
            pass
    except (OSError, UnicodeError) as error:
        raise _no_answer(address, str(error)) from None


def _try(address: str) -> None:
    """Connect in a process of its own and see what comes of it."""
    command = [sys.executable, "-c", _TRIAL, address]
    try:
        trial = subprocess.run(  # noqa: S603 - an address that has been checked
            command,
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            check=False,
            timeout=ANSWER_SECONDS,
        )
    except subprocess.TimeoutExpired:
        raise _no_answer(address, f"no answer in {ANSWER_SECONDS:g} s") from None
    lines = trial.stdout.splitlines()
    answers = [line for line in lines if line.startswith('{"railenv": ')]
    if not answers:
        raise _no_answer(address, (trial.stderr.splitlines() or ["Ray ended the process"])[-1])
    said = json.loads(answers[-1])["railenv"]
    if said:
        raise _no_answer(address, said)


def _no_answer(address: str, said: str) -> RailenvError:
    return RailenvError(
        f"no connection to a Ray cluster at {address}: {one_line(said)[:300]}; start one with "
        "`ray start --head`, or look at the address, the network and Ray's version there"
    )


@contextmanager
def _own_signals() -> Generator[None, None, None]:
    """Keep this process's way to end at SIGTERM, which Ray replaces by its own."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.getsignal(signal.SIGTERM)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)
