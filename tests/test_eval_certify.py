"""`railenv certify`: verdicts, exit status, families, saved certificates, bad input."""

import json
from argparse import Namespace
from pathlib import Path

import numpy as np
import pytest

from baselines import LinearDynamic, save_policy
from eval.cli import main
from eval.families import parse_family
from railenv.stability import DelaySystem, SampledLoop, certify

SKYHOOK = ["--controller", "skyhook:gain=35e3", "--layout", "4"]


def answer(capsys, *arguments: str) -> tuple[int, dict]:
    status = main(["certify", *arguments, "--json"])
    return status, json.loads(capsys.readouterr().out)


@pytest.fixture
def scalar_file(tmp_path: Path) -> str:
    """x' = -x(t - tau): critical at pi / 2."""
    path = tmp_path / "scalar.npz"
    np.savez(path, A=np.zeros((1, 1)), B=np.ones((1, 1)), K=np.ones((1, 1)))
    return str(path)


@pytest.mark.parametrize(
    ("delay", "status", "verdict", "roots"),
    [
        ("1.5", 0, "STABLE", 0),
        ("1.6", 3, "UNSTABLE", 2),
        ("0:1.57", 0, "STABLE", 0),
        ("1.5:1.6", 3, "UNSTABLE", 2),
    ],
)
def test_the_exit_status_is_the_verdict(
    capsys, scalar_file: str, delay: str, status: int, verdict: str, roots: int
) -> None:
    found, plain = answer(capsys, "--system", scalar_file, "--delay", delay)
    assert (found, plain["verdict"], plain["unstable_roots"]) == (status, verdict, roots)
    assert plain["seconds"] > 0.0


def test_what_is_undecided_has_status_four_and_a_reason(capsys, tmp_path: Path) -> None:
    path = tmp_path / "free.npz"
    np.savez(path, A=np.array([[0.0, 1.0], [0.0, 0.0]]), B=[[0.0], [1.0]], K=[[0.0, 1.0]])
    found, plain = answer(capsys, "--system", str(path), "--delay", "0.5")
    assert (found, plain["verdict"]) == (4, "UNDECIDED")
    assert "s = 0" in plain["reason"]


@pytest.mark.slow
def test_the_vehicle_is_certified_up_to_its_critical_delay(capsys) -> None:
    assert answer(capsys, *SKYHOOK, "--delay", "0:0.2019")[0] == 0
    found, plain = answer(capsys, *SKYHOOK, "--delay", "0.203")
    assert (found, plain["unstable_roots"]) == (3, 2)


def test_a_sampled_loop_is_certified_on_the_command_line(capsys) -> None:
    arguments = [*SKYHOOK, "--control-period", "0.01"]
    assert answer(capsys, *arguments, "--delay", "0.19")[0] == 0
    found, plain = answer(capsys, *arguments, "--delay", "0.198")
    assert (found, plain["claim"]["kind"], plain["unstable_roots"]) == (3, "sampled", 2)


def test_decay_rate_and_damping_are_those_of_the_library(capsys, scalar_file: str) -> None:
    # x' = -x(t - 0.2): rightmost root -0.2592 (Lambert W)
    arguments = ["--system", scalar_file, "--delay", "0.2"]
    rightmost = -1.2958555090953687  # real W(-0.2) / 0.2
    assert answer(capsys, *arguments, "--decay-rate", str(-rightmost - 1e-6))[0] == 0
    assert answer(capsys, *arguments, "--decay-rate", str(-rightmost + 1e-6))[0] == 3
    loose = ["--delay", "1.4", "--damping-ratio", "0.01", "--max-frequency-hz", "1"]
    tight = ["--delay", "1.4", "--damping-ratio", "0.5", "--max-frequency-hz", "1"]
    assert answer(capsys, "--system", scalar_file, *loose)[0] == 0
    assert answer(capsys, "--system", scalar_file, *tight)[0] == 3


def test_jitter_is_certified_on_the_command_line(capsys, scalar_file: str) -> None:
    # |T| = omega / |j omega + exp(-j omega tau)| peaks near 1 at tau = 0: J just below 1
    arguments = ["--system", scalar_file, "--delay", "0"]
    found, plain = answer(capsys, *arguments, "--jitter", "0.9")
    assert (found, plain["claim"]["kind"], plain["claim"]["jitter"]) == (0, "jitter", 0.9)
    assert answer(capsys, *arguments, "--jitter", "1.7")[0] == 3  # a constant 1.7 is unstable
    assert answer(capsys, *arguments, "--jitter", "1.2")[0] == 4


def test_a_saved_certificate_is_accepted_and_an_altered_one_is_not(
    capsys, scalar_file: str, tmp_path: Path
) -> None:
    path = tmp_path / "certificate.json"
    assert main(["certify", "--system", scalar_file, "--delay", "0:1.5", "--save", str(path)]) == 0
    assert "STABLE: every constant delay from 0 to 1500 ms" in capsys.readouterr().out
    assert main(["certify", "--verify", str(path)]) == 0
    assert main(["certify", "--verify", str(path), "--system", scalar_file]) == 0
    capsys.readouterr()
    assert main(["certify", "--verify", str(path), *SKYHOOK]) == 1  # about another loop
    path.write_text(path.read_text().replace('"high": [1.5]', '"high": [1.6]'))
    assert main(["certify", "--verify", str(path)]) == 1
    assert "rejected" in capsys.readouterr().err


@pytest.mark.parametrize("option", ["--delay", "--save", "--jitter", "--decay-rate"])
def test_verify_takes_no_question_of_its_own(
    capsys, scalar_file: str, tmp_path: Path, option: str
) -> None:
    path = str(tmp_path / "certificate.json")
    main(["certify", "--system", scalar_file, "--delay", "1", "--save", path])
    assert main(["certify", "--verify", path, option, "1"]) == 2
    assert option in capsys.readouterr().err


def test_an_unstable_interval_is_said_to_be_so_at_some_delay(capsys, scalar_file: str) -> None:
    main(["certify", "--system", scalar_file, "--delay", "0:2"])
    assert "UNSTABLE: at some constant delay from 0 to 2000 ms" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("A", "K", "word"),
    [
        ([[0.0]], [[0.0]], "neither stable nor unstable"),
        ([[0.0, 1.0], [-1.0, 0.0]], [[0.0, 0.0]], "neither stable nor unstable"),
        ([[-1.0]], [[0.0]], "stable at this delay"),
        ([[1.0]], [[0.0]], "UNSTABLE"),
    ],
)
def test_roots_on_the_axis_are_not_called_stable(
    capsys, tmp_path: Path, A: list, K: list, word: str
) -> None:
    path = tmp_path / "loop.npz"
    np.savez(path, A=np.array(A), B=np.ones((len(A), 1)), K=np.array(K))
    assert main(["roots", "--system", str(path), "--delay", "0.1", "--count", "1"]) == 0
    assert word in capsys.readouterr().out.splitlines()[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ([*SKYHOOK], "--delay is missing"),
        (["--delay", "0.1"], "give the loop"),
        ([*SKYHOOK, "--delay", "0.2:0.1"], "reversed"),
        ([*SKYHOOK, "--delay", "0:0.1:0.2"], "more than two ends"),
        ([*SKYHOOK, "--delay", "0.1,0.2"], "one per channel"),
        ([*SKYHOOK, "--delay", "0.1", "--save", "c.txt"], ".json"),
        ([*SKYHOOK, "--delay", "0.1", "--damping-ratio", "0.05"], "max_frequency_hz"),
        ([*SKYHOOK, "--delay", "0:0.1", "--jitter", "0.01"], "one delay per channel"),
        ([*SKYHOOK, "--delay", "0.1", "--told-error", "0.01"], "told_error"),
        ([*SKYHOOK, "--delay", "0.1", "--vary", "conicity"], "NAME=LOW:HIGH"),
        ([*SKYHOOK, "--delay", "0.1", "--vary", "half_wheelbase=1.2:1.3"], "length"),
        (["--verify", "nowhere.json"], "nowhere.json"),
    ],
)
def test_bad_input_gives_one_clear_line_and_status_two(
    capsys, monkeypatch: pytest.MonkeyPatch, tmp_path: Path, arguments: list[str], words: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["certify", *arguments]) == 2
    error = capsys.readouterr().err.strip()
    assert words in error
    assert "\n" not in error
    assert list(tmp_path.iterdir()) == []


def family_options(*vary: str) -> Namespace:
    return Namespace(
        controller="skyhook:gain=35e3",
        layout="4",
        vehicle="paper_fit",
        speed_kmh="300",
        actuator_lag="0",
        vary=list(vary),
    )


@pytest.mark.parametrize(
    ("name", "low", "high", "position"),
    [
        ("speed_kmh", 250.0, 330.0, lambda v: 1.0 / v),
        ("conicity", 0.15, 0.2, lambda c: c),
        ("yaw_damper_damping*", 0.8, 1.2, lambda c: 1.0 / c),
        ("secondary_lateral_stiffness*", 0.8, 1.2, lambda k: k),
        ("lateral_damper_damping*", 0.8, 1.2, lambda k: k),
    ],
)
def test_a_family_holds_every_vehicle_between_its_corners(
    name: str, low: float, high: float, position
) -> None:
    family = parse_family(family_options(f"{name}={low}:{high}"))
    from eval.chart_axes import parse_axis, varied_loop

    options = family_options()
    build = varied_loop(options, (parse_axis(f"{name}={low}:{high}:2", options),))
    ends = np.array([position(low), position(high)])
    for value in np.linspace(low, high, 7):
        # the parameter that the entries are affine in, from -1 to 1
        p = 2.0 * (position(value) - ends[0]) / (ends[1] - ends[0]) - 1.0
        loop = build(value)
        for index, matrix in enumerate("ABK"):
            nominal = getattr(family.nominal, matrix)
            radius = getattr(family, f"{matrix}_radius")
            middle = nominal + sum(p * d[index] for d in family.directions)
            off = np.abs(getattr(loop, matrix) - middle) - radius
            # rounding of this very comparison
            assert np.all(off <= 1e-13 * np.abs(nominal)), (name, value, matrix)


def test_a_family_may_bend_in_one_mass() -> None:
    options = family_options("carbody_mass*=0.9:1.1", "speed_kmh=290:310")
    family = parse_family(options)
    from eval.chart_axes import parse_axis, varied_loop

    axes = tuple(parse_axis(f"{text}:2", options) for text in options.vary)
    build = varied_loop(options, axes)
    generator = np.random.default_rng(5)
    for _ in range(20):
        loop = build(generator.uniform(0.9, 1.1), generator.uniform(290.0, 310.0))
        for index, matrix in enumerate("ABK"):
            nominal = getattr(family.nominal, matrix)
            reach = getattr(family, f"{matrix}_radius") + sum(
                np.abs(d[index]) for d in family.directions
            )
            off = np.abs(getattr(loop, matrix) - nominal) - reach
            assert np.all(off <= 1e-13 * np.abs(nominal))


def test_two_masses_are_refused_by_name() -> None:
    from railenv.errors import ArgumentError

    with pytest.raises(ArgumentError, match=r"carbody_mass.*bogie_mass"):
        parse_family(family_options("carbody_mass*=0.9:1.1", "bogie_mass*=0.9:1.1"))


def test_the_python_call_is_the_one_of_the_interface() -> None:
    system = DelaySystem([[0.0]], [[1.0]], [[1.0]])
    assert certify(system, delay=(0.0, 1.5)).verdict == "STABLE"


@pytest.fixture
def scheduled_file(tmp_path: Path) -> str:
    """An oscillator; a law of two positions and the last command, scheduled on the told delay."""
    told = np.array([0.0, 0.05, 0.1])
    measured = np.stack([[[[6.0 + 20.0 * t]], [[-6.0 - 18.0 * t]]] for t in told])
    commanded = np.stack([[[[0.1 + t]]] for t in told])
    plant = ([[0.0, 1.0], [-4.0, -0.2]], [[0.0], [1.0]], [[1.0, 0.0]], [[0.0]])
    loop = SampledLoop.from_feedback(*plant, 0.05, measured, commanded, told)
    path = tmp_path / "scheduled.npz"
    np.savez(path, **{name: getattr(loop, name) for name in SampledLoop.__dataclass_fields__})
    return str(path)


def test_a_scheduled_law_is_certified_with_the_error_of_what_it_is_told(
    capsys, scheduled_file: str, tmp_path: Path
) -> None:
    path = tmp_path / "certificate.json"
    question = ["--delay", "0:0.1", "--told-error", "0.005"]
    found, plain = answer(
        capsys, "--system", scheduled_file, *question, "--save", str(path), "--max-tests", "400"
    )
    assert (found, plain["verdict"]) == (0, "STABLE")
    assert (plain["claim"]["kind"], plain["claim"]["told_error"]) == ("sampled", 0.005)
    assert main(["certify", "--verify", str(path), "--system", scheduled_file]) == 0
    assert "told with an error of up to 5 ms" in capsys.readouterr().out
    other = dict(np.load(scheduled_file))
    other["Dc"] = other["Dc"] * 1.01
    np.savez(tmp_path / "other.npz", **other)
    assert main(["certify", "--verify", str(path), "--system", str(tmp_path / "other.npz")]) == 1
    assert "Dc" in capsys.readouterr().err


LAW = """
from baselines import SkyHook


class Law(SkyHook):
    def to_sampled_loop(self, vehicle, {arguments}):
        {body}
"""


def own_law(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: str, body: str) -> str:
    """A controller of the user's own; returns its name for the command line."""
    name = f"law_{abs(hash((arguments, body)))}"
    (tmp_path / f"{name}.py").write_text(LAW.format(arguments=arguments, body=body))
    monkeypatch.syspath_prepend(tmp_path)
    return f"py:{name}:Law"


@pytest.mark.parametrize("arguments", ["period", "period, actuator"])
def test_a_law_of_the_users_own_may_know_the_actuator_or_not(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, arguments: str
) -> None:
    body = f"return SkyHook(35e3, 4).to_sampled_loop(vehicle, {arguments})"
    law = own_law(tmp_path, monkeypatch, arguments, body)
    question = ["--controller", law, "--control-period", "0.01", "--delay", "0.05"]
    assert answer(capsys, *question)[0] == 0
    lagged = main(["certify", *question, "--actuator-lag", "0.02"])
    error = capsys.readouterr().err
    if arguments == "period":
        assert lagged == 2
        assert "actuator_lag = 0.02 s is not known" in error
    else:
        assert lagged == 0


@pytest.mark.parametrize(
    ("body", "status", "words"),
    [
        ("return None", 1, "returned NoneType; it must return a SampledLoop"),
        ("raise KeyError(1)", 1, "to_sampled_loop raised KeyError"),
        ("return super().to_sampled_loop(vehicle, -period)", 2, "period = -0.01"),
    ],
)
def test_what_a_law_of_the_users_own_does_wrong_is_one_line(
    capsys, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, body: str, status: int, words: str
) -> None:
    law = own_law(tmp_path, monkeypatch, "period", body)
    question = ["--controller", law, "--control-period", "0.01", "--delay", "0.05"]
    assert main(["certify", *question]) == status
    error = capsys.readouterr().err.strip()
    assert words in error
    assert "\n" not in error


def test_the_actuator_is_part_of_the_sampled_loop(capsys) -> None:
    arguments = [*SKYHOOK, "--control-period", "0.01", "--delay", "0.19"]
    assert answer(capsys, *arguments)[0] == 0
    # a lag of 20 ms takes about as much from the 197 ms
    assert answer(capsys, *arguments, "--actuator-lag", "0.02")[0] == 3


def test_a_dynamic_law_is_certified_at_its_own_period_only(capsys, tmp_path: Path) -> None:
    eye = np.eye(4)
    sensors = tuple(f"carbody_lateral_velocity_{k}" for k in range(1, 5))
    law = LinearDynamic((-50 * eye, 50 * eye, 30e3 * eye, 5e3 * eye), sensors, 4)
    save_policy(law, tmp_path / "law.npz")
    question = ["--controller", str(tmp_path / "law.npz"), "--delay", "0.1"]
    found, plain = answer(capsys, *question, "--control-period", "0.01")
    assert (found, plain["claim"]["kind"]) == (0, "sampled")
    assert main(["certify", *question, "--control-period", "0.02"]) == 2
    assert "control_period = 0.01 s; use the same for both" in capsys.readouterr().err
