"""The certificate file and its verifier, attacked: what is accepted is true, whatever it says.

The digest only tells of accidents: whoever forges a certificate computes it anew, and so do these
tests. "Altered" is with the old digest, "forged" with a new one.
"""

import ast
import contextlib
import copy
import itertools
import json
import math
import os
import random
import subprocess
import sys
import textwrap
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import flint
import numpy as np
import pytest
from flint import acb, arb, fmpq

import railenv
from railenv.errors import ArgumentError, InputFileError
from railenv.stability import Certificate, DelaySystem, certify, count_unstable, critical_delays
from railenv.stability.certificate import digest
from railenv.stability.proof import delay_box
from railenv.stability.verifier import Verification, verify_certificate
from railenv.stability.verifier.contour import count_roots
from railenv.stability.verifier.crossings import check_no_crossing
from railenv.stability.verifier.half_plane import one_outweighs, stays_in_half_plane
from railenv.stability.verifier.quasipolynomial import (
    CharacteristicFunction,
    RejectedError,
    System,
)

Plain = dict[str, Any]

PLAIN_REGION = {"decay_rate": 0.0, "damping_ratio": None, "max_frequency_hz": None}


BEYOND = "the contour does not reach beyond all roots"


def oscillator(damping: float = 0.2, gain: tuple[float, float] = (0.1, 0.3)) -> DelaySystem:
    """x'' + damping x' + x = -gain (x, x')(t - tau)."""
    return DelaySystem([[0.0, 1.0], [-1.0, -damping]], [[0.0], [1.0]], [list(gain)])


def pair() -> DelaySystem:
    """Two coupled oscillators with a channel each."""
    A = [[0, 1, 0, 0], [-2, -0.3, 1, 0], [0, 0, 0, 1], [1, 0, -2, -0.3]]
    K = [[0.1, 0.2, 0.0, 0.0], [0.05, 0.0, 0.1, 0.3]]
    return DelaySystem(A, [[0, 0], [1, 0], [0, 0], [0, 1]], K)


def first_order(a: float, k: float, feedthrough: float = 0.0) -> DelaySystem:
    """x' = a x + f, f = -k x(t - tau) - feedthrough f(t - tau)."""
    return DelaySystem([[a]], [[1.0]], [[k]], [[feedthrough]])


def windows() -> DelaySystem:
    """A loop with several stable windows."""
    return oscillator(0.1, (0.0, 0.3))


NEUTRAL = DelaySystem([[-1.0]], [[1.0]], [[0.5]], [[1.5]])


def shifted() -> Certificate:
    """One root stays at zero: those to the right of it are counted past a line further right."""
    return certify(DelaySystem(np.diag([1.0, 0.0, 0.2]), np.zeros((3, 1)), np.zeros((1, 3))), 0.1)


CLAIMS: dict[str, Callable[[], Certificate]] = {
    "point": lambda: certify(oscillator(), 0.3),
    "interval": lambda: certify(oscillator(), (0.0, 1.5)),
    "box": lambda: certify(pair(), [(0.0, 0.2), (0.1, 0.3)]),
    "box and point": lambda: certify(pair(), [(0.0, 0.2), 0.1]),
    "equal delays": lambda: certify(pair(), [0.1, 0.1]),
    "decay rate": lambda: certify(oscillator(), (0.0, 0.2), decay_rate=0.1),
    "wedge": lambda: certify(oscillator(), (0.0, 0.2), damping_ratio=0.05, max_frequency_hz=1.0),
    "unstable": lambda: certify(oscillator(-0.5), 0.3),
    "unstable interval": lambda: certify(windows(), (0.0, 4.0)),
    "unstable wedge": lambda: certify(oscillator(), 0.2, damping_ratio=0.6, max_frequency_hz=2.0),
    "unstable decay": lambda: certify(oscillator(), 0.2, decay_rate=1.0),
    "three": lambda: certify(DelaySystem(-np.eye(3), np.eye(3), 0.1 * np.eye(3)), [(0.0, 0.1)] * 3),
    "neutral": lambda: certify(NEUTRAL, (0.0, 0.1)),
    "neutral pair": lambda: certify(
        DelaySystem(-np.eye(2), np.eye(2), np.eye(2), [[1.5, 0.0], [0.0, 0.2]]), 0.1
    ),
    "weakly neutral": lambda: certify(first_order(-1.0, 0.5, 0.3), (0.0, 0.4)),
    "no channels": lambda: certify(DelaySystem([[-1.0]], np.zeros((1, 0)), np.zeros((0, 1))), 0.0),
}


@pytest.fixture(scope="module")
def made() -> Callable[[str], Plain]:
    """Certificates by name, made once; changed copies are handed out."""
    known: dict[str, Plain] = {}

    def give(name: str) -> Plain:
        if name not in known:
            known[name] = CLAIMS[name]().to_plain()
        return copy.deepcopy(known[name])

    return give


@pytest.fixture(scope="module")
def vehicle_certificate(loop: DelaySystem) -> Plain:
    """The paper's loop, every common delay up to 0.15 s."""
    return certify(loop, (0.0, 0.15)).to_plain()


@pytest.fixture
def check(tmp_path: Path) -> Callable[..., Verification]:
    """Write content to a file, with a digest that fits unless told otherwise, and verify it."""

    def run(content: Plain, sign: bool = True, system: Any = None) -> Verification:
        if sign:
            content = {**content, "digest": digest(content)}
        path = tmp_path / "certificate.json"
        path.write_text(json.dumps(content))
        return verify_certificate(path, system)

    return run


Check = Callable[..., Verification]
Made = Callable[[str], Plain]


def place(content: Any, *keys: Any) -> Any:
    """Return what lies at the end of a path of keys."""
    for key in keys:
        content = content[key]
    return content


def put(content: Any, value: Any, *keys: Any) -> Any:
    """Set what lies at the end of a path of keys; content is returned."""
    place(content, *keys[:-1])[keys[-1]] = value
    return content


@pytest.mark.parametrize("name", CLAIMS)
def test_the_verifier_accepts_every_kind_of_proof(name: str, made: Made, check: Check) -> None:
    content = made(name)
    assert content["verdict"] == (
        "UNSTABLE" if name.split()[0] in ("unstable", "neutral") else "STABLE"
    )
    assert check(content, sign=False) == Verification(True, (), content)


def test_the_verifier_accepts_the_vehicle_and_leaves_the_precision_alone(
    vehicle_certificate: Plain, check: Check, loop: DelaySystem
) -> None:
    before = flint.ctx.prec
    assert check(vehicle_certificate, sign=False, system=loop).accepted
    assert flint.ctx.prec == before


def test_the_verifier_accepts_a_count_to_the_right_of_a_shifted_line_without_a_number(
    check: Check,
) -> None:
    content = shifted().to_plain()
    assert content["evidence"]["region"]["decay_rate"] < 0.0
    # Roots 1, 0.2 and 0: one is counted to the right of 0.5, so no number is known for the axis.
    content["unstable_roots"] = None
    assert check(content).accepted
    assert not check({**content, "unstable_roots": 1}).accepted


def test_the_verifier_accepts_a_proof_by_crossings(
    monkeypatch: pytest.MonkeyPatch, check: Check
) -> None:
    monkeypatch.setattr(delay_box, "_TESTS_BEFORE_CROSSINGS", 3)
    content = certify(windows(), (0.0, 1.65)).to_plain()
    assert content["evidence"]["method"] == "crossings"
    assert check(content, sign=False).accepted


@pytest.mark.parametrize("unit", [3.0, 0.1, 2.0**40, 1e-7])
def test_any_unit_of_time_is_as_good_as_another_where_the_evidence_still_carries(
    unit: float, made: Made, check: Check
) -> None:
    # Pieces are in that unit: they are moved along. Rounding them may not matter in the middle.
    content = made("point")
    old = content["evidence"]["unit"]
    pieces = [[x * unit / old for x in ends] for ends in content["evidence"]["pieces"]]
    pieces[0][-1] *= 1.001
    content["evidence"] |= {"unit": unit, "pieces": pieces}
    assert check(content).accepted


def test_accepted_counts_are_those_of_another_method(made: Made) -> None:
    for name in ("point", "unstable", "unstable interval"):
        content = made(name)
        system = DelaySystem(*(content["system"][key] for key in ("A", "B", "K")))
        number = count_unstable(system, content["evidence"]["delays"])
        assert number == content["unstable_roots"]


# Altered: any one number, the digest left as it was.


def leaves(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Yield the paths of all values that are neither lists nor tables."""
    if isinstance(value, dict):
        for key, inner in value.items():
            yield from leaves(inner, (*path, key))
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            yield from leaves(inner, (*path, i))
    else:
        yield path


PLACES = [
    ("system", "A"),
    ("system", "B"),
    ("system", "K"),
    ("system", "feedthrough"),
    ("claim", "low"),
    ("claim", "high"),
    ("claim", "region"),
    ("claim", "groups"),
    ("evidence", "pieces"),
    ("evidence", "cuts"),
    ("evidence", "bits"),
    ("evidence", "unit"),
    ("evidence", "region"),
    ("evidence", "delays"),
    ("unstable_roots",),
    ("seconds",),
]


@pytest.mark.parametrize("keys", PLACES, ids="-".join)
def test_any_one_number_altered_in_the_vehicles_certificate_is_rejected(
    keys: tuple[str, ...], vehicle_certificate: Plain, check: Check
) -> None:
    chance = random.Random(str(keys))
    paths = [(*keys, *path) for path in leaves(place(vehicle_certificate, *keys))]
    paths = [path for path in paths if place(vehicle_certificate, *path) is not None]
    for path in chance.sample(paths, min(10, len(paths))):
        content = copy.deepcopy(vehicle_certificate)
        value = place(content, *path)
        # The next double, or the next whole number.
        put(content, value + 1 if isinstance(value, int) else math.nextafter(value, 9e9), *path)
        result = check(content, sign=False)
        assert not result.accepted
        assert result.reasons == ("the digest does not fit: the file was changed",)


@pytest.mark.parametrize("value", ["", "0" * 64, None, 0, [], True])
def test_an_altered_digest_is_rejected(value: Any, made: Made, check: Check) -> None:
    assert not check({**made("point"), "digest": value}, sign=False).accepted


# Forged: the digest fits, and the claim is false or the evidence does not carry it.


def deepest(content: Plain) -> list[int]:
    """Return the longest tree of cuts."""
    return max((tree for of_line in content["evidence"]["cuts"] for tree in of_line), key=len)


def beyond_doubles() -> Plain:
    """x' = (2^53 + 1) x - 2^53 x - x / 2, whole in the file; stable if rounded to doubles."""
    limit = 2**53
    system = DelaySystem([[limit]], [[1.0, 1.0]], [[limit], [0.5]])
    return put(certify(system, 0.0).to_plain(), [[limit + 1]], "system", "A")


def held_together(content: Plain) -> None:
    """Let the first two channels share an interval, and not vary by themselves."""
    content["claim"] |= {"groups": [[0, 1], [2]], "low": [0.0, 0.0], "high": [0.1, 0.1]}
    content["evidence"]["delays"] = [0.05, 0.05]
    # Leaves that hold for all: the feedback is weak.
    content["evidence"]["cuts"] = [[[-1] for _ in content["evidence"]["cuts"][0]]]


FORGED: dict[str, tuple[str, Callable[[Plain], Any]]] = {
    "an unstable plant": ("interval", lambda c: put(c, 0.5, "system", "A", 1, 1)),
    "an input ten times as strong": ("interval", lambda c: put(c, 30.0, "system", "B", 1, 0)),
    "a gain of the other sign": ("interval", lambda c: put(c, -1.3, "system", "K", 0, 1)),
    "an unstable pair": ("interval", lambda c: put(c, 1.0, "system", "A", 1, 0)),
    "a strong difference part": (
        "weakly neutral",
        lambda c: put(c, 1.5, "system", "feedthrough", 0, 0),
    ),
    "a longer interval": ("interval", lambda c: put(c, 4.0, "claim", "high", 0)),
    "a wider box": ("box", lambda c: put(c, 6.0, "claim", "high", 1)),
    "delays outside of the box": ("interval", lambda c: put(c, 1.6, "evidence", "delays", 0)),
    "a point beside the evidence": (
        "point",
        lambda c: c["claim"].update(low=[2.9], high=[2.9]),
    ),
    "a reversed interval": (
        "interval",
        lambda c: put(c, math.nextafter(1.5, 2.0), "claim", "low", 0),
    ),
    "a negative delay": ("interval", lambda c: put(c, -5e-324, "claim", "low", 0)),
    "a higher decay rate": ("decay rate", lambda c: put(c, 0.5, "claim", "region", "decay_rate")),
    "a higher decay rate in both": (
        "decay rate",
        lambda c: [put(c, 0.5, part, "region", "decay_rate") for part in ("claim", "evidence")],
    ),
    "a decay rate without evidence": (
        "interval",
        lambda c: put(c, 0.01, "claim", "region", "decay_rate"),
    ),
    "a decay rate without evidence and without a number": (
        "interval",
        lambda c: [put(c, 0.01, "claim", "region", "decay_rate"), put(c, None, "unstable_roots")],
    ),
    "roots to the right of the axis for roots far to the right": (
        "unstable",
        lambda c: [put(c, -1e3, "claim", "region", "decay_rate"), put(c, None, "unstable_roots")],
    ),
    "roots in a half-plane for roots in a wedge": (
        "unstable",
        lambda c: [
            c["claim"]["region"].update(damping_ratio=0.0, max_frequency_hz=0.01),
            put(c, None, "unstable_roots"),
        ],
    ),
    "a higher damping ratio": (
        "wedge",
        lambda c: [put(c, 0.6, part, "region", "damping_ratio") for part in ("claim", "evidence")],
    ),
    "a higher frequency": (
        "wedge",
        lambda c: [
            put(c, 1.001, part, "region", "max_frequency_hz") for part in ("claim", "evidence")
        ],
    ),
    "a wedge with a decay rate besides": (
        "wedge",
        lambda c: [put(c, 9.0, part, "region", "decay_rate") for part in ("claim", "evidence")],
    ),
    "a wedge of a negative ratio": (
        "wedge",
        lambda c: [put(c, -0.5, part, "region", "damping_ratio") for part in ("claim", "evidence")],
    ),
    "a wedge of no height": (
        "wedge",
        lambda c: [
            put(c, -1.0, part, "region", "max_frequency_hz") for part in ("claim", "evidence")
        ],
    ),
    # The roots are at 0.2 Hz: counted under a ray up to 2 Hz, claimed for below 0.01 Hz.
    "instability below the frequency of the roots": (
        "unstable wedge",
        lambda c: [
            put(c, 0.01, part, "region", "max_frequency_hz") for part in ("claim", "evidence")
        ],
    ),
    "jitter in the claim": ("interval", lambda c: put(c, 0.5, "claim", "jitter")),
    "a control period in the claim": ("interval", lambda c: put(c, 0.01, "claim", "period")),
    "a damping ratio's cap alone": (
        "interval",
        lambda c: [
            put(c, 5.0, part, "region", "max_frequency_hz") for part in ("claim", "evidence")
        ],
    ),
    "independent delays from common ones": ("interval", lambda c: put(c, False, "claim", "common")),
    "channels listed twice": ("box", lambda c: put(c, [[0], [0]], "claim", "groups")),
    "a channel left out": ("box", lambda c: put(c, [[0], []], "claim", "groups")),
    "groups swapped": ("box and point", lambda c: put(c, [[1], [0, 0]], "claim", "groups")),
    "a channel that is no number": ("box", lambda c: put(c, [[False], [True]], "claim", "groups")),
    "an interval for two channels of three together": ("three", held_together),
    "a group without channels": (
        "equal delays",
        lambda c: [
            put(c, [[0, 1], []], "claim", "groups"),
            put(c, False, "claim", "common"),
            put(c, [0.1, 0.0], "claim", "low"),
            put(c, [0.1, 0.0], "claim", "high"),
            put(c, [0.1, 0.0], "evidence", "delays"),
        ],
    ),
    "a contour that ends early": ("interval", lambda c: c["evidence"]["pieces"][0].pop()),
    "a contour that begins late": ("point", lambda c: c["evidence"]["pieces"][0].pop(0)),
    "pieces that run back": (
        "interval",
        lambda c: put(c, c["evidence"]["pieces"][0][2], "evidence", "pieces", 0, 1),
    ),
    "one piece for the whole contour": (
        "point",
        lambda c: put(c, [0.0, c["evidence"]["pieces"][0][-1]], "evidence", "pieces", 0),
    ),
    "a contour of no length": ("point", lambda c: put(c, [0.0], "evidence", "pieces", 0)),
    "a wedge without its level line": ("wedge", lambda c: c["evidence"]["pieces"].pop()),
    "a half-plane with a second line": (
        "point",
        lambda c: c["evidence"]["pieces"].append([0.0, 1.0]),
    ),
    "a tree without leaf": ("interval", lambda c: put(c, [], "evidence", "cuts", 0, 0)),
    "a tree with a leaf too many": ("interval", lambda c: c["evidence"]["cuts"][0][0].append(-1)),
    "a tree that ends early": ("interval", lambda c: deepest(c).pop()),
    "one tree too few": ("interval", lambda c: c["evidence"]["cuts"][0].pop()),
    "no trees": ("interval", lambda c: put(c, [], "evidence", "cuts")),
    "a leaf in place of all cuts": (
        "interval",
        lambda c: put(c, [[-1] for _ in c["evidence"]["cuts"][0]], "evidence", "cuts", 0),
    ),
    "a cut of a group that is none": ("interval", lambda c: put(c, 2, "evidence", "cuts", 0, 0, 0)),
    "a truth as a cut": ("interval", lambda c: put(deepest(c), True, deepest(c).index(1))),
    "too many bits": ("point", lambda c: put(c, 10**6, "evidence", "bits")),
    "too few bits": ("point", lambda c: put(c, 2, "evidence", "bits")),
    "bits that are no whole number": ("point", lambda c: put(c, 128.0, "evidence", "bits")),
    "no unit of time": ("point", lambda c: put(c, 0.0, "evidence", "unit")),
    "a negative unit of time": ("point", lambda c: put(c, -1.0, "evidence", "unit")),
    "a huge unit of time": ("point", lambda c: put(c, 1e300, "evidence", "unit")),
    "a tiny unit of time": ("point", lambda c: put(c, 5e-324, "evidence", "unit")),
    "no unstable root": ("unstable", lambda c: put(c, 0, "unstable_roots")),
    "more unstable roots": ("unstable", lambda c: put(c, 4, "unstable_roots")),
    "unstable roots as a double": ("unstable", lambda c: put(c, 2.0, "unstable_roots")),
    "unstable roots as a text": ("unstable", lambda c: put(c, "2", "unstable_roots")),
    "unstable roots unknown": ("unstable", lambda c: put(c, None, "unstable_roots")),
    "stable with roots unknown": ("point", lambda c: put(c, None, "unstable_roots")),
    "stable with false as a number": ("point", lambda c: put(c, False, "unstable_roots")),
    "a verdict turned to unstable": ("point", lambda c: put(c, "UNSTABLE", "verdict")),
    "a verdict turned to stable": ("unstable", lambda c: put(c, "STABLE", "verdict")),
    "unstable, and called stable": (
        "unstable",
        lambda c: c.update(verdict="STABLE", unstable_roots=0),
    ),
    "another kind of verdict": ("point", lambda c: put(c, ["STABLE"], "verdict")),
    "another kind of claim": ("point", lambda c: put(c, "anything", "claim", "kind")),
    "a kind that is a list": ("point", lambda c: put(c, [], "claim", "kind")),
    "a method that is not known": ("point", lambda c: put(c, "trust me", "evidence", "method")),
    "crossings for a decay rate": (
        "decay rate",
        lambda c: put(c, "crossings", "evidence", "method"),
    ),
    "crossings for two delays": ("box", lambda c: put(c, "crossings", "evidence", "method")),
    "crossings past the critical delay": (
        "interval",
        lambda c: [
            put(c, "crossings", "evidence", "method"),
            put(c, 4.0, "claim", "high", 0),
        ],
    ),
    "no evidence": ("point", lambda c: put(c, {}, "evidence")),
    "a list for evidence": ("point", lambda c: put(c, [], "evidence")),
    "a matrix more in the system": ("point", lambda c: put(c, [[1.0]], "system", "E")),
    "another kind of system": ("point", lambda c: put(c, "sampled loop", "system", "kind")),
    "a gain without rows": ("point", lambda c: put(c, [], "system", "K")),
    "a plant without states": (
        "no channels",
        lambda c: c["system"].update(A=[], B=[], K=[], feedthrough=[]),
    ),
    "a feedthrough of a row too many": (
        "point",
        lambda c: c["system"]["feedthrough"].append([9.0]),
    ),
    "a plant of uneven rows": ("point", lambda c: c["system"]["A"][0].pop()),
    "a chain of roots too far to the right": (
        "neutral",
        lambda c: put(c, -1e6, "claim", "region", "decay_rate"),
    ),
    "a chain of roots below its frequency": (
        "neutral",
        lambda c: c["claim"]["region"].update(damping_ratio=0.0, max_frequency_hz=1.0),
    ),
    "a difference part on the circle": (
        "neutral",
        lambda c: put(c, 1.0, "system", "feedthrough", 0, 0),
    ),
    "a chain for two delays": (
        "neutral pair",
        lambda c: c["claim"].update(
            groups=[[0], [1]], low=[0.0, 0.0], high=[0.1, 0.0], common=False
        ),
    ),
    "a chain for a reversed interval": ("neutral", lambda c: put(c, 0.2, "claim", "low", 0)),
    "a chain without delay": (
        "neutral",
        lambda c: c["claim"].update(low=[0.0], high=[0.0]),
    ),
    "a chain with a number of roots": ("neutral", lambda c: put(c, 7, "unstable_roots")),
    "a chain of a stable loop": ("neutral", lambda c: put(c, "STABLE", "verdict")),
    "a chain of a plant that is none": ("neutral", lambda c: put(c, [["x"]], "system", "A")),
    "a chain of other channels": ("neutral", lambda c: put(c, [[7]], "claim", "groups")),
    # Exactly +0.5 is left of a - k; rounded to doubles it would be -0.5.
    "whole numbers beyond doubles": (
        "point",
        lambda c: c.update(beyond_doubles()),
    ),
}


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_certificate_is_rejected(name: str, made: Made, check: Check) -> None:
    base, change = FORGED[name]
    content = made(base)
    change(content)
    result = check(content)
    assert not result.accepted
    assert len(result.reasons) == 1
    assert 0 < len(result.reasons[0]) <= 400


def test_evidence_of_another_system_or_delay_is_rejected(made: Made, check: Check) -> None:
    for name, other in (("point", "unstable"), ("unstable", "point")):
        content, foreign = made(name), made(other)
        assert not check({**content, "system": foreign["system"]}).accepted
    for name, other in (("interval", "decay rate"), ("box", "interval"), ("wedge", "interval")):
        content, foreign = made(name), made(other)
        assert not check({**content, "evidence": foreign["evidence"]}).accepted


def test_another_groups_delays_are_not_proved_by_a_box(check: Check) -> None:
    # The first channel stands little delay, the second much.
    system = DelaySystem([[0.0, 0.0], [0.0, -1.0]], np.eye(2), [[1.0, 0.0], [0.0, 0.5]])
    content = certify(system, [(0.0, 0.2), (0.0, 4.0)]).to_plain()
    assert content["verdict"] == "STABLE"
    assert check(content).accepted
    assert not check(put(content, [[1], [0]], "claim", "groups")).accepted


def test_the_bound_beyond_the_contour_is_needed_and_checked(check: Check) -> None:
    # Damped at low frequencies, and two unstable roots above: a contour that ends too early does
    # not see them, and its count is a whole number all the same.
    system, delay, short = windows(), 2.5, [0.0, 0.05, 0.1, 0.2, 0.3]
    assert count_unstable(system, delay) == 2
    h = CharacteristicFunction(System.read(plain(system)), [[0]], fmpq(1))
    assert count_roots(h, [(acb(0), acb(0, 1), short)], [delay]) == 0
    content = certify(oscillator(), delay).to_plain()
    content["system"] = plain(system)
    content["evidence"] |= {"pieces": [short], "unit": 1.0}
    result = check(content)
    assert result.reasons == (BEYOND,)


def test_the_bound_beyond_the_contour_counts_that_terms_grow_to_the_left(check: Check) -> None:
    # s + 3 + 0.05 exp(-s tau), tau = 5, has roots beyond 4 with Re s > -1: 0.05 e^5 = 7.4.
    system, delay = first_order(-3.0, 0.05), 5.0
    content = certify(system, delay).to_plain()
    region = {**PLAIN_REGION, "decay_rate": 1.0}
    for end in (3.2, 4.0, 6.0):
        ends = list(np.linspace(0.0, end, 200))
        h = CharacteristicFunction(System.read(content["system"]), [[0]], fmpq(1))
        number = count_roots(h, [(acb(-1), acb(0, 1), ends)], [delay])
        content |= {"verdict": "UNSTABLE" if number else "STABLE", "unstable_roots": number}
        content["claim"]["region"] = region
        content["evidence"] |= {"region": region, "unit": 1.0, "pieces": [ends]}
        assert check(content).reasons == (BEYOND,)


def test_a_wedge_closes_to_the_right_of_all_roots(check: Check) -> None:
    # A root at +5: a wedge whose level line ends before it holds none. The second level line is
    # longer than 5, but begins to the left of the axis; the third does not even reach the axis.
    for ratio, length in ((0.0, 1.0), (0.8, 5.5), (0.8, 0.5)):
        base = certify(first_order(-5.0, 0.1), 0.1, damping_ratio=ratio, max_frequency_hz=0.1)
        content = base.to_plain()
        content["system"]["A"] = [[5.0]]
        ray = list(np.linspace(0.0, 0.64 / math.sqrt(1.0 - ratio * ratio), 9))
        content["evidence"] |= {"unit": 1.0, "pieces": [ray, list(np.linspace(0.0, length, 40))]}
        assert check(content).reasons == (BEYOND,)


def test_the_bound_beyond_the_contour_counts_the_longest_delay(check: Check) -> None:
    # The roots of s + 3 + 0.05 exp(-s tau) are within 3.1 for tau = 0.1, but not for tau = 5.
    content = certify(first_order(-3.0, 0.05), (0.1, 0.2), decay_rate=1.0).to_plain()
    ends = list(np.linspace(0.0, 4.0, 200))
    content["evidence"] |= {"unit": 1.0, "pieces": [ends], "cuts": [[[-1]] * 199]}
    content["evidence"]["delays"] = [0.1]
    assert check(content).accepted
    assert check(put(content, 5.0, "claim", "high", 0)).reasons == (BEYOND,)


def test_the_bound_beyond_the_contour_counts_the_difference_part(made: Made, check: Check) -> None:
    content = put(made("weakly neutral"), 1.5, "system", "feedthrough", 0, 0)
    assert check(content).reasons == (BEYOND,)


@pytest.mark.parametrize(
    ("base", "value", "keys", "reason"),
    [
        ("point", -1.0, ("evidence", "unit"), "the unit of time is not above zero"),
        ("point", 0, ("evidence", "unit"), "the unit of time is not above zero"),
        ("point", True, ("evidence", "unit"), "True is not a number"),
        (
            "wedge",
            -0.5,
            ("claim", "region", "damping_ratio"),
            "the damping ratio is not in [0, 1), or its frequency not above zero",
        ),
        (
            "wedge",
            1.0,
            ("claim", "region", "damping_ratio"),
            "the damping ratio is not in [0, 1), or its frequency not above zero",
        ),
    ],
)
def test_what_can_be_no_evidence_is_named(
    base: str, value: Any, keys: tuple[str, ...], reason: str, made: Made, check: Check
) -> None:
    assert check(put(made(base), value, *keys)).reasons == (reason,)


def test_delays_whose_exponentials_leave_the_range_of_doubles_are_told_apart(check: Check) -> None:
    # s + 1.5 + 3e-310 exp(-s tau), roots with Re s > -1 at tau = 713.5 and none at 710.5. Both
    # exp(tau) are above 1e308: compared as doubles they are equal.
    system = first_order(-1.5, 3e-310)
    region = {**PLAIN_REGION, "decay_rate": 1.0}
    before, flint.ctx.prec = flint.ctx.prec, 160
    try:
        h = CharacteristicFunction(System.read(plain(system)), [[0]], fmpq(1))
        ends, size = [0.0], 0.01
        while ends[-1] < 4.0:
            end = min(4.0, ends[-1] + size)
            inside = stays_in_half_plane(
                h, acb(-1), acb(0, 1), (ends[-1], end), [arb(710.5)], [arb(0)]
            )
            size *= 1.3 if inside else 0.5
            ends += [end] * inside
    finally:
        flint.ctx.prec = before
    content = certify(first_order(-1.5, 0.0), 710.5, decay_rate=1.0).to_plain()
    content["system"] = plain(system)
    content["evidence"] = {
        "method": "contour",
        "bits": 128,
        "unit": 1.0,
        "region": region,
        "delays": [710.5],
        "pieces": [ends],
        "cuts": [[[-1]] * (len(ends) - 1)],
    }
    assert check(content).accepted
    assert not check(put(content, 713.5, "claim", "high", 0)).accepted


def plain(system: DelaySystem) -> Plain:
    """Return a system's numbers as a certificate holds them."""
    names = ("A", "B", "K", "feedthrough")
    return {"kind": "delay system", **{name: getattr(system, name).tolist() for name in names}}


def through_zero(chance: np.random.Generator) -> tuple[CharacteristicFunction, complex, float]:
    """Return s^2 + a s + b + (k1 s + k0) exp(-s tau) with a zero, that zero and tau."""
    sigma, omega, tau, a, b = chance.uniform(
        (-1.0, 0.3, 0.1, -1.0, -1.0), (1.0, 3.0, 3.0, 2.0, 4.0)
    )
    s = complex(sigma, omega)
    value = -(s * s + a * s + b) * np.exp(s * tau)
    slope = value.imag / omega
    system = DelaySystem(
        [[0.0, 1.0], [-b, -a]], [[0.0], [1.0]], [[value.real - slope * sigma, slope]]
    )
    return CharacteristicFunction(System.read(plain(system)), [[0]], fmpq(1)), s, tau


def test_no_piece_with_a_zero_on_it_is_ever_accepted() -> None:
    # The zero is known up to rounding and well within the piece and the interval of delays.
    chance = np.random.default_rng(5)
    for k in range(600):
        h, zero, tau = through_zero(chance)
        reach, width = 10.0 ** chance.uniform((-2.0, -3.0), (1.0, 0.5))
        width = min(width, tau)
        before, after = reach * chance.uniform(0.05, 1.0, 2)
        direction = (1j, 1.0, complex(-0.6, 0.8))[k % 3]
        line = acb(zero - before * direction), acb(direction)
        middle = tau + 0.95 * width * chance.uniform(-1.0, 1.0)
        half = width if chance.random() < 0.7 else abs(middle - tau) + 1e-9
        ends = (0.0, before + after)
        assert not stays_in_half_plane(h, *line, ends, [arb(middle)], [arb(half)])
        longest = [arb(middle) + half]
        assert not one_outweighs(h, *line, ends, [arb(middle) - half], longest)


@pytest.mark.parametrize(("middle", "half"), [(50.0, 0.0), (8.0, 30.0)])
def test_a_zero_that_only_the_rest_of_a_series_shows_is_not_overlooked(
    middle: float, half: float
) -> None:
    # s + 100 + k exp(-s tau) vanishes at s = -1 for tau = middle + half. On the piece from -1 to 1
    # its expansion about zero knows nothing of it: k is 1e-15 or less.
    gain = -99.0 * math.exp(-(middle + half))
    h = CharacteristicFunction(System.read(plain(first_order(-100.0, gain))), [[0]], fmpq(1))
    ends = (0.0, 2.0)
    assert not stays_in_half_plane(h, acb(-1), acb(1), ends, [arb(middle)], [arb(half)])
    assert stays_in_half_plane(h, acb(-1), acb(1), ends, [arb(middle / 2)], [arb(half / 20)])


def test_on_accepted_pieces_the_function_is_in_a_half_plane() -> None:
    # Arguments on a grid of the piece and the interval spread over less than pi.
    chance = np.random.default_rng(6)
    accepted = 0
    for _ in range(300):
        h, _, tau = through_zero(chance)
        start = chance.uniform(0.0, 3.0)
        reach, width = 10.0 ** chance.uniform((-2.0, -3.0), (0.5, 0.0))
        shift = chance.uniform(-0.5, 0.5)
        low, high = max(tau - width, 0.0), tau + width
        middle, half = arb(low + high) / 2, arb(high - low) / 2
        line, ends = (acb(shift), acb(0, 1)), (start, start + reach)
        p = {k: np.array([float(c) for c in q.coeffs()][::-1]) for (k,), q in h.exact.items()}
        s = shift + 1j * np.linspace(*ends, 41)[:, None]
        values = np.polyval(p[0], s) + np.polyval(p[1], s) * np.exp(-s * np.linspace(low, high, 21))
        if stays_in_half_plane(h, *line, ends, [middle], [half]):
            accepted += 1
            assert np.ptp(np.angle(values / values[20, 10])) < math.pi
        if one_outweighs(h, *line, ends, [arb(low)], [arb(high)]):
            others = np.abs(np.polyval(p[1], s)) * np.exp(-s.real * np.array([low, high]))
            assert (np.abs(np.polyval(p[0], s)) > others).all()
    assert accepted > 50


def crossing_delays(system: DelaySystem, until: float) -> list[float]:
    """Return all delays at which roots cross the axis, from the oracle's own list."""
    return sorted(c.delay for c in critical_delays(system, until).crossings)


def two_channels() -> DelaySystem:
    """A loop of rank two with several crossings."""
    return DelaySystem(
        [[0, 1, 0, 0], [-1, -0.1, 0.2, 0], [0, 0, 0, 1], [0.2, 0, -3, -0.1]],
        [[0, 0], [1, 0], [0, 0], [0, 1]],
        [[0.0, 0.3, 0.1, 0.0], [0.0, 0.1, 0.0, 0.4]],
    )


@pytest.mark.parametrize("system", [windows(), two_channels()], ids=["one", "two"])
def test_intervals_between_crossings_are_told_from_those_across(system: DelaySystem) -> None:
    delays = crossing_delays(system, 20.0)
    assert len(delays) > 5
    channels = list(range(system.num_channels))
    h = CharacteristicFunction(System.read(plain(system)), [channels], fmpq(1))
    before, flint.ctx.prec = flint.ctx.prec, 192
    try:
        for a, b in itertools.pairwise(delays):
            # Balls separate delays from crossings far nearer than this.
            narrow = 1e-3 * (b - a)
            check_no_crossing(h, [a + narrow], [b - narrow])
            for low, high in ((a - narrow, a + narrow), (a + narrow, b + narrow)):
                with pytest.raises(RejectedError, match="may be on the imaginary axis"):
                    check_no_crossing(h, [low], [high])
    finally:
        flint.ctx.prec = before


def test_a_touch_of_the_axis_is_a_crossing_to_the_verifier() -> None:
    # x' = -x - k x(t - tau) with k = 1 has |k| = |1 + j omega| at omega = 0 only; with the root of
    # x' = -k x(t - pi / (2 k)) the interval ends at the crossing itself.
    h = CharacteristicFunction(System.read(plain(first_order(0.0, 1.0))), [[0]], fmpq(1))
    check_no_crossing(h, [0.0], [1.57])
    with pytest.raises(RejectedError):
        check_no_crossing(h, [0.0], [1.5707963267948968])  # the double above pi / 2


def test_the_verifiers_function_is_the_determinant() -> None:
    chance = np.random.default_rng(3)
    A, B, K, F = (chance.normal(size=shape) for shape in ((4, 4), (4, 3), (3, 4), (3, 3)))
    system = DelaySystem(A, B, K, 0.1 * F)
    h = CharacteristicFunction(System.read(plain(system)), [[2, 0], [1]], fmpq(1, 2))
    s, delays = 0.3 + 0.7j, (0.4, 0.9)
    z = np.exp(-2 * s * np.array([delays[0], delays[1], delays[0]]))
    matrix = np.block(
        [[2 * s * np.eye(4) - A, -B], [z[:, None] * K, np.eye(3) + z[:, None] * 0.1 * F]]
    )
    value = complex(h.at(acb(s), [arb(2 * tau) for tau in delays]))
    # A determinant of order seven in doubles; s is in units of 1/2 s, so h is (1/2)^4 times it.
    assert value == pytest.approx(np.linalg.det(matrix) / 16.0, rel=1e-10)


# Mutation: whatever the file holds, the answer is clean, and nothing false is accepted.

HOSTILE: list[Any] = [
    None,
    True,
    False,
    0,
    1,
    -1,
    2,
    7,
    0.5,
    -0.5,
    1e-300,
    -1e300,
    1e308,
    5e-324,
    10**30,
    10**400,
    "1",
    "",
    "\ud800",
    [],
    [0],
    [[]],
    {},
    {"A": 1},
]


def mutated(content: Plain, chance: random.Random) -> tuple[Any, ...]:
    """Change one value somewhere; its path is returned."""
    paths = [path for path in leaves(content) if path[0] not in ("digest", "format", "schema")]
    path = chance.choice(paths)
    # Whole lists and tables, too.
    path = path[: chance.randint(1, len(path))] if chance.random() < 0.2 else path
    if path[0] in ("digest", "format", "schema"):
        return path
    value = place(content, *path)
    choices: list[Any] = [*HOSTILE]
    if isinstance(value, float) and not isinstance(value, bool):
        choices += [value * 1.5, -value, value * (1 + 1e-9), value + 0.1, int(value)] * 4
    if isinstance(value, list) and value:
        choices += [value[:-1], value[::-1], [*value, value[0]], value[1:]] * 4
    put(content, chance.choice(choices), *path)
    return path


def cleanly(run: Callable[[], Verification]) -> Verification | None:
    """Return the outcome; None if the file was refused in a sentence that names it."""
    try:
        return run()
    except InputFileError as error:
        refused = str(error)
    assert ".json" in refused
    return None


def is_true(content: Plain) -> bool:
    """Whether floating point agrees with an accepted claim about small systems, in its region."""
    system = DelaySystem(*(content["system"][key] for key in ("A", "B", "K")))
    claim, roots = content["claim"], content["unstable_roots"]
    rate = claim["region"]["decay_rate"]
    moved = DelaySystem(system.A + rate * np.eye(system.num_states), system.B, system.K)
    ends = (claim["low"], claim["high"], content["evidence"]["delays"])
    counts = []
    for delays in ends if content["verdict"] == "STABLE" else ends[2:]:
        spread = [0.0] * system.num_channels
        for group, tau in zip(claim["groups"], delays, strict=True):
            for channel in group:
                spread[channel] = tau
        # h(s - rate): feedback grows by exp(rate tau).
        gain = moved.K * np.exp(rate * np.array(spread))[:, None]
        counts.append(count_unstable(DelaySystem(moved.A, moved.B, gain), spread))
    return set(counts) == {roots}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["point", "interval", "box", "unstable", "decay rate"])
def test_mutated_certificates_are_rejected_cleanly_or_true(
    name: str, made: Made, check: Check
) -> None:
    chance = random.Random(name)
    for _ in range(120):
        content = made(name)
        path = mutated(content, chance)
        result = cleanly(lambda content=content: check(content))
        if result is None:
            continue
        if result.accepted and path[0] not in ("reason", "seconds", "made_by"):
            assert is_true(content), path
        assert result.accepted != bool(result.reasons)


@pytest.mark.parametrize("name", ["wedge", "unstable wedge", "neutral", "weakly neutral"])
def test_mutated_wedges_and_neutral_loops_never_raise(name: str, made: Made, check: Check) -> None:
    chance = random.Random(name)
    for _ in range(60):
        content = made(name)
        mutated(content, chance)
        cleanly(lambda content=content: check(content))


# Hostile files.


def whole(made: Made) -> str:
    """Return a good certificate's text."""
    return json.dumps(made("point"))


TEXTS: dict[str, Callable[[str], bytes]] = {
    "empty": lambda text: b"",
    "binary": lambda text: bytes(range(256)) * 9,
    "zeros": lambda text: bytes(1000),
    "truncated": lambda text: text[:-40].encode(),
    "a list": lambda text: f"[{text}]".encode(),
    "a number": lambda text: b"1",
    "a text": lambda text: b'"certificate"',
    "null": lambda text: b"null",
    "an empty table": lambda text: b"{}",
    "another table": lambda text: b'{"format": "something else"}',
    "only the format": lambda text: b'{"format": "railenv stability certificate", "schema": 1}',
    "another schema": lambda text: text.replace('"schema": 1', '"schema": 2').encode(),
    "true as schema": lambda text: text.replace('"schema": 1', '"schema": true').encode(),
    "nested deeply": lambda text: text.replace('"reason": ""', '"reason": ' + "[" * 99999).encode(),
    "closed deeply": lambda text: text.replace(
        '"reason": ""', '"reason": ' + "[" * 5000 + "]" * 5000
    ).encode(),
    "not a number": lambda text: text.replace('"seconds": ', '"seconds": NaN, "x": ').encode(),
    "infinity": lambda text: text.replace('"seconds": ', '"seconds": -Infinity, "x": ').encode(),
    "a number too large": lambda text: text.replace(
        '"seconds": ', '"seconds": 1e400, "x": '
    ).encode(),
    "a whole number too long": lambda text: text.replace(
        '"seconds": ', '"seconds": ' + "9" * 9999 + ', "x": '
    ).encode(),
    "an entry twice": lambda text: ('{"verdict": "UNSTABLE", ' + text[1:]).encode(),
    "an inner entry twice": lambda text: text.replace('"A": ', '"A": [[1.0]], "A": ').encode(),
    "an entry more": lambda text: ('{"note": "proved for all trains", ' + text[1:]).encode(),
    "an entry less": lambda text: text.replace('"made_by"', '"made_for"').encode(),
    "broken letters": lambda text: text.encode().replace(b"STABLE", b"STA\xffBLE"),
}


@pytest.mark.parametrize("name", TEXTS)
def test_a_file_that_is_no_certificate_is_named(name: str, made: Made, tmp_path: Path) -> None:
    path = tmp_path / "hostile.json"
    path.write_bytes(TEXTS[name](whole(made)))
    with pytest.raises(InputFileError, match=r"hostile\.json") as error:
        verify_certificate(path)
    assert len(str(error.value)) < 300 + len(str(path))
    assert "\n" not in str(error.value)


def test_what_is_no_readable_file_is_named(tmp_path: Path) -> None:
    pipe = tmp_path / "pipe.json"
    os.mkfifo(pipe)
    for path in (tmp_path / "missing.json", tmp_path, pipe):
        with pytest.raises(InputFileError, match=path.name):
            verify_certificate(path)


@pytest.mark.slow
def test_nesting_that_can_just_be_read_is_rejected_cleanly(made: Made, tmp_path: Path) -> None:
    path = tmp_path / "deep.json"
    for depth in range(50, 1200, 50):
        for keys in (("evidence", "delays"), ("system", "A"), ("unstable_roots",)):
            text = json.dumps(put(made("point"), "HERE", *keys))
            text = text.replace('"HERE"', "[" * depth + "]" * depth)
            path.write_text(text)
            # Beyond Python's limit this process cannot compute the digest either.
            with contextlib.suppress(RecursionError):
                path.write_text(
                    json.dumps({**json.loads(text), "digest": digest(json.loads(text))})
                )
            result = cleanly(lambda: verify_certificate(path))
            assert result is None or not result.accepted


def test_a_system_too_large_to_be_checked_is_rejected_at_once(made: Made, check: Check) -> None:
    n, m = 40, 14
    system = DelaySystem(-np.eye(n), np.ones((n, m)), np.ones((m, n)))
    content = made("point")
    content["system"] = plain(system)
    delays = [0.01 * k for k in range(m)]
    content["claim"] |= {"groups": [[k] for k in range(m)], "low": delays, "high": delays}
    content["claim"]["common"] = False
    content["evidence"]["delays"] = delays
    assert check(content).reasons == ("the certificate is too large to be checked",)


@pytest.mark.slow
def test_many_channels_are_no_hindrance(check: Check) -> None:
    m = 150
    system = DelaySystem(-np.eye(3), np.ones((3, m)), np.full((m, 3), 1e-3))
    content = certify(system, (0.0, 0.1)).to_plain()
    assert content["verdict"] == "STABLE"
    assert check(content).accepted


# Which system?


def test_a_certificate_of_the_system_that_is_meant_is_accepted(made: Made, check: Check) -> None:
    for name, system in (("interval", oscillator()), ("box", pair()), ("neutral", NEUTRAL)):
        assert check(made(name), system=system).accepted


def test_a_certificate_of_another_system_is_rejected_with_the_first_entry_that_differs(
    made: Made, check: Check
) -> None:
    A = oscillator().A.copy()
    A[1, 1] = np.nextafter(A[1, 1], 0.0)
    other = DelaySystem(A, oscillator().B, oscillator().K)
    (reason,) = check(made("interval"), system=other).reasons
    assert reason == f"A[1][1] is -0.2, and {A[1, 1]!r} in the system that is meant".replace(
        f"{A[1, 1]!r}", repr(float(A[1, 1]))
    )
    other = DelaySystem(oscillator().A, oscillator().B, oscillator().K, [[1e-9]])
    (reason,) = check(made("interval"), system=other).reasons
    assert reason.startswith("feedthrough[0][0] is 0.0, and 1e-09")
    (reason,) = check(made("interval"), system=pair()).reasons
    assert reason.startswith("A has another size")
    assert check(made("interval"), system=oscillator()).accepted


def test_the_system_that_is_meant_must_be_one(made: Made, check: Check) -> None:
    for wrong in (3, "loop.npz", np.eye(2)):
        with pytest.raises(ArgumentError, match="give the DelaySystem"):
            check(made("interval"), system=wrong)


# Other kinds of claims: what is common to them.


def other_kinds() -> dict[str, Certificate]:
    """One proof of each of the other kinds."""
    from railenv.stability.uncertain import UncertainDelaySystem

    family = UncertainDelaySystem(oscillator(), A_radius=[[0.0, 0.0], [0.01, 0.01]])
    return {
        "jitter": certify(oscillator(), 0.1, jitter=0.05),
        "uncertain": certify(family, (0.0, 0.1)),
        "sampled": certify(oscillator(), (0.0, 0.2), control_period=0.1),
    }


@pytest.fixture(scope="module")
def kinds() -> dict[str, Plain]:
    """Contents of those."""
    return {name: certificate.to_plain() for name, certificate in other_kinds().items()}


@pytest.mark.parametrize("name", ["jitter", "uncertain", "sampled"])
def test_other_kinds_are_accepted_and_their_parts_must_agree(
    name: str, kinds: dict[str, Plain], check: Check
) -> None:
    content = kinds[name]
    assert content["verdict"] == "STABLE"
    assert check(content, sign=False).accepted
    for change in (
        lambda c: put(c, "UNSTABLE", "verdict"),
        lambda c: put(c, "UNSTABLE", "claim", "verdict"),
        lambda c: put(c, 1, "unstable_roots"),
        lambda c: put(c, None, "unstable_roots"),
        lambda c: put(c, False, "unstable_roots"),
        lambda c: put(c, 0.5, "claim", "decay"),
        lambda c: put(c, [[1.0]], "system", "E"),
        lambda c: put(c, "delay box", "claim", "kind"),
        lambda c: put(c, {}, "evidence"),
        lambda c: put(c, 0.5, "system", "A", 1, 1),
    ):
        assert not check(change(copy.deepcopy(content))).accepted


def test_a_sampled_claim_names_the_period_of_its_system(
    kinds: dict[str, Plain], check: Check
) -> None:
    assert not check(put(copy.deepcopy(kinds["sampled"]), 0.2, "claim", "period")).accepted


# The file.


def test_a_saved_certificate_reads_back_bit_for_bit(
    vehicle_certificate: Plain, tmp_path: Path, loop: DelaySystem
) -> None:
    certificate = certify(oscillator(0.1 + 0.2, (1 / 3, math.pi / 30)), (0.0, 0.1))
    path = tmp_path / "c.json"
    certificate.save(path)
    content = json.loads(path.read_bytes())
    assert content == certificate.to_plain()
    assert json.dumps(content).encode() == path.read_bytes()
    system = DelaySystem(*(content["system"][key] for key in ("A", "B", "K")))
    assert np.array_equal(system.K, [[1 / 3, math.pi / 30]])
    for name in ("A", "B", "K", "feedthrough"):
        assert np.array_equal(vehicle_certificate["system"][name], getattr(loop, name))


def test_a_failed_save_leaves_the_old_file_alone(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "c.json"
    certificate = certify(oscillator(), 0.1)
    certificate.save(path)
    before = path.read_bytes()
    broken = Certificate("STABLE", 0, "", {}, {}, {"x": math.nan}, 1.0)
    with pytest.raises(ValueError, match="JSON"):
        broken.save(path)
    monkeypatch.setattr(Path, "replace", _no_space)
    with pytest.raises(OSError, match="cannot write"):
        certificate.save(path)
    assert path.read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["c.json"]


def _no_space(*_: Any) -> None:
    raise OSError(28, "No space left on device")


def test_an_undecided_certificate_proves_nothing(tmp_path: Path, check: Check) -> None:
    # A root stays at zero.
    certificate = certify(first_order(0.0, 0.0), 0.1)
    assert certificate.verdict == "UNDECIDED"
    certificate.save(tmp_path / "c.json")
    result = verify_certificate(tmp_path / "c.json")
    assert result.reasons == ("the verdict is UNDECIDED: there is no proof to check",)
    assert not check({**certificate.to_plain(), "verdict": "STABLE", "unstable_roots": 0}).accepted


# Independence of the prover.

VERIFIER = Path(railenv.__file__).parent / "stability" / "verifier"


def test_the_verifier_imports_nothing_of_the_prover() -> None:
    allowed = {"railenv.errors", "flint"}
    for source in VERIFIER.glob("*.py"):
        for node in ast.walk(ast.parse(source.read_text())):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert node.level == 0
                names = [str(node.module)]
            for name in names:
                own = name.startswith("railenv.stability.verifier.")
                standard = name.split(".")[0] in sys.stdlib_module_names
                assert own or standard or name in allowed, f"{source.name} imports {name}"


def test_the_verifier_works_where_there_is_no_prover(
    vehicle_certificate: Plain, kinds: dict[str, Plain], tmp_path: Path
) -> None:
    paths = []
    for name, content in {"vehicle": vehicle_certificate, **kinds}.items():
        paths.append(tmp_path / f"{name}.json")
        paths[-1].write_text(json.dumps(content))
    program = textwrap.dedent(
        f"""
        import sys, types

        # Packages without their own content: whatever else is imported must be asked for by name.
        root = {str(VERIFIER.parent.parent)!r}
        for name, path in (("railenv", root), ("railenv.stability", root + "/stability")):
            sys.modules[name] = types.ModuleType(name)
            sys.modules[name].__path__ = [path]

        class Refuse:
            def find_spec(self, name, path=None, target=None):
                own = ("railenv.errors", "railenv.stability.verifier")
                if name.startswith("railenv.") and not name.startswith(own):
                    raise ImportError(name + " is asked for by the verifier")
                if name.split(".")[0] in ("numpy", "scipy"):
                    raise ImportError(name + " is asked for by the verifier")

        sys.meta_path.insert(0, Refuse())
        from railenv.stability.verifier import verify_certificate

        print([verify_certificate(path).accepted for path in {[str(p) for p in paths]!r}])
        """
    )
    run = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=False
    )
    assert run.stderr == ""
    assert run.stdout.strip() == str([True] * 4)
