"""Addresses of Ray clusters: what is none, and where nobody answers."""

import signal
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from eval.workers import ray_connection, ray_node
from eval.workers.ray_connection import connect
from railenv.errors import ArgumentError, RailenvError

NONE = "local, nonsense, host, host:, :6379, host:port, host:0, host:65536, http://host:80, a b:1"


@pytest.mark.parametrize("address", ["", "ray://host", *NONE.split(", ")])
def test_what_is_no_address_of_an_existing_cluster_is_refused(address: str) -> None:
    # "local", or nothing, would start a cluster.
    with pytest.raises(ArgumentError, match="is no address of a cluster"):
        connect(address)


def test_without_ray_the_extra_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(ArgumentError, match=r"railenv\[cluster\]"):
        connect("localhost:6379")


def test_ray_is_not_loaded_with_the_workers() -> None:
    # Its import takes half a second, and it is an extra.
    code = "import eval.workers, sys; sys.exit('ray' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


@pytest.fixture
def silent() -> Iterator[int]:
    """A port that takes connections and never answers."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        yield server.getsockname()[1]


@pytest.mark.parametrize("scheme", ["", "ray://"])
def test_a_closed_port_is_told_at_once(scheme: str) -> None:
    pytest.importorskip("ray")
    started = time.monotonic()
    with socket.create_server(("127.0.0.1", 0)) as server:
        port = server.getsockname()[1]
    with pytest.raises(RailenvError, match="no connection to a Ray cluster") as found:
        connect(f"{scheme}127.0.0.1:{port}")
    assert "\n" not in str(found.value)
    assert time.monotonic() - started < ray_connection.KNOCK_SECONDS + 1.0


@pytest.mark.slow
def test_a_port_that_never_answers_is_left_after_a_while(
    silent: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    pytest.importorskip("ray")
    monkeypatch.setattr(ray_connection, "ANSWER_SECONDS", 2.0)
    started = time.monotonic()
    with pytest.raises(RailenvError, match="no answer in 2 s"):
        connect(f"127.0.0.1:{silent}")
    # Ray by itself waits for minutes here. The rest is the end of the process that tried.
    assert time.monotonic() - started < 2.0 + 3.0


def test_what_ray_says_of_a_cluster_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    said = "Version mismatch: The cluster was started with:\n    Ray: 2.9.0\n    Python: 3.9.1"
    trial = f"import json; print('noise'); print(json.dumps({{'railenv': {said!r}}}))"
    monkeypatch.setattr(ray_connection, "_TRIAL", trial)
    with pytest.raises(RailenvError, match=r"started with: Ray: 2\.9\.0 Python: 3\.9\.1; start"):
        connect("auto")


def test_a_trial_that_ends_its_process_is_no_connection(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("ray")
    monkeypatch.setattr(ray_connection, "_TRIAL", "import os; os._exit(1)")
    with pytest.raises(RailenvError, match="Ray ended the process"):
        connect("auto")


def test_the_programs_own_way_to_end_is_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    def taking(**_: object) -> None:
        signal.signal(signal.SIGTERM, signal.SIG_IGN)

    monkeypatch.setitem(
        sys.modules, "ray", SimpleNamespace(init=taking, is_initialized=lambda: False)
    )
    monkeypatch.setattr(ray_connection, "_try", lambda _: None)
    before = signal.getsignal(signal.SIGTERM)
    connect("auto")
    assert signal.getsignal(signal.SIGTERM) is before


def test_a_node_with_other_versions_is_named_with_both() -> None:
    ours = dict(ray_node.build())
    assert set(ours) == {"Python", "railenv", "numpy", "scipy", "numba", "railenv's code"}
    ray_node.check_build(ray_node.build(), "here")
    other = tuple({**ours, "numpy": "1.26.0", "Python": "3.9"}.items())
    words = rf"node far .* Python {ours['Python']} and not 3\.9, numpy {ours['numpy']} and not 1"
    with pytest.raises(RailenvError, match=words):
        ray_node.check_build(other, "far")
