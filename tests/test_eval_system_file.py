"""`--system FILE.npz`: a loop of the user's own, and every file that is none."""

import io
import json
import os
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest

from eval.cli import main
from eval.system_file import load_system
from railenv.errors import InputFileError
from railenv.stability import DelaySystem, SampledLoop

A = np.array([[0.0, 1.0], [-4.0, -0.2]])
B = np.array([[0.0], [1.0]])
K = np.array([[0.0, 1.0]])


@pytest.fixture
def path(tmp_path: Path) -> Path:
    place = tmp_path / "loop.npz"
    np.savez(place, A=A, B=B, K=K)
    return place


def run(capsys: pytest.CaptureFixture[str], *arguments: str) -> tuple[int, str, str]:
    status = main(list(arguments))
    captured = capsys.readouterr()
    return status, captured.out, captured.err


def answer(capsys: pytest.CaptureFixture[str], *arguments: str) -> dict:
    status, out, _ = run(capsys, *arguments, "--json")
    assert status == 0
    return json.loads(out)


def test_a_file_is_the_loop_it_holds(path: Path) -> None:
    system = load_system(path)
    assert isinstance(system, DelaySystem)
    for name, matrix in (("A", A), ("B", B), ("K", K)):
        np.testing.assert_array_equal(getattr(system, name), matrix)
    assert not system.neutral


def test_a_feedthrough_is_read_too(path: Path) -> None:
    np.savez(path, A=A, B=B, K=K, feedthrough=[[0.5]])
    system = load_system(path)
    assert isinstance(system, DelaySystem)
    assert system.neutral


@pytest.mark.parametrize("dtype", [np.int8, np.float32, np.longdouble, ">f8"])
def test_numbers_of_any_exact_type_are_taken(path: Path, dtype) -> None:
    np.savez_compressed(path, A=np.asfortranarray([[0, 1], [-4, -2]], dtype), B=B, K=K)
    np.testing.assert_array_equal(load_system(path).A, [[0, 1], [-4, -2]])


def test_the_critical_delay_is_that_of_the_closed_form(capsys, tmp_path: Path) -> None:
    place = str(tmp_path / "scalar.npz")
    np.savez(place, A=[[0.0]], B=[[1.0]], K=[[2.0]])
    found = answer(capsys, "critical-delay", "--system", place)
    # x' = -k x(t - tau) loses stability at k tau = pi / 2, at k rad/s
    assert found["critical_delay_s"] == pytest.approx(np.pi / 4, rel=1e-12)
    assert found["frequency_hz"] == pytest.approx(1 / np.pi, rel=1e-12)
    assert found["mode"] is None
    assert found["crossings"][0]["mode"] is None
    assert found["critical_delay_sampled_s"] is None
    assert found["control_period_s"] is None


def test_the_sampled_answer_is_given_for_a_period_that_is_named(capsys, path: Path) -> None:
    found = answer(capsys, "critical-delay", "--system", str(path), "--control-period", "0.02")
    # the hold is half a period of delay
    assert found["critical_delay_s"] - found["critical_delay_sampled_s"] == pytest.approx(
        0.01, rel=0.05
    )


@pytest.mark.parametrize("method", ["exact", "pade:6"])
def test_roots_have_no_mode_names(capsys, path: Path, method: str) -> None:
    found = answer(capsys, "roots", "--system", str(path), "--delay", "0.1", "--method", method)
    assert {root["mode"] for root in found["roots"]} == {None}
    assert found["roots"][0]["re"] == pytest.approx(-0.658172, abs=1e-5)


@pytest.mark.parametrize("command", [("critical-delay",), ("roots", "--delay", "0.1")])
def test_text_output_names_the_file_and_no_vehicle(capsys, path: Path, command: tuple) -> None:
    status, out, _ = run(capsys, *command, "--system", str(path))
    assert status == 0
    assert "loop.npz" in out
    assert "km/h" not in out
    assert "sampled" not in out
    assert [line for line in out.split("\n") if line.endswith("  -")]


@pytest.mark.parametrize(
    "extra",
    [
        ("--layout", "4"),
        ("--speed-kmh", "300"),
        ("--vehicle", "paper_fit"),
        ("--actuator-lag", "0"),
    ],
)
def test_an_option_for_vehicles_beside_a_system_is_refused(capsys, path: Path, extra) -> None:
    status, out, err = run(capsys, "roots", "--system", str(path), "--delay", "0.1", *extra)
    assert (status, out) == (2, "")
    assert extra[0] in err
    assert err.count("\n") == 1


@pytest.mark.parametrize(
    ("extra", "word"),
    [
        (("--method", "simulation"), "--controller"),
        (("--controller", "passive"), "not allowed with"),
        (("--control-period", "0"), "control_period"),
    ],
)
def test_what_does_not_go_with_a_system_is_one_line(capsys, path: Path, extra, word) -> None:
    status, out, err = run(capsys, "critical-delay", "--system", str(path), *extra)
    assert (status, out) == (2, "")
    assert word in err
    assert err.count("\n") == 1


def test_one_of_the_two_must_be_given(capsys) -> None:
    status, _, err = run(capsys, "critical-delay")
    assert status == 2
    assert "--controller --system" in err


def test_a_neutral_loop_is_one_line_with_the_way_out(capsys, path: Path) -> None:
    np.savez(path, A=A, B=B, K=K, feedthrough=[[0.5]])
    for command in (("critical-delay",), ("roots", "--delay", "0.1")):
        status, out, err = run(capsys, *command, "--system", str(path))
        assert (status, out) == (2, "")
        assert "neutral" in err
        assert "low-pass" in err
        assert err.count("\n") == 1


def npy(header: bytes, data: bytes = b"") -> bytes:
    return b"\x93NUMPY\x01\x00" + struct.pack("<H", len(header)) + header + data


def zipped(**members: bytes) -> bytes:
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w") as archive:
        for name, content in members.items():
            archive.writestr(f"{name}.npy", content)
    return stream.getvalue()


def saved(**arrays) -> bytes:
    stream = io.BytesIO()
    np.savez(stream, **arrays)
    return stream.getvalue()


def damaged() -> bytes:
    content = bytearray(saved(A=A, B=B, K=K))
    content[100:140] = b"\xff" * 40
    return bytes(content)


def bomb() -> bytes:
    """A few kilobytes that unpack to half a gigabyte."""
    stream = io.BytesIO()
    with zipfile.ZipFile(stream, "w", zipfile.ZIP_DEFLATED) as archive:
        header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (8000, 8000)}"
        with archive.open("A.npy", "w", force_zip64=True) as member:
            member.write(npy(header))
            for _ in range(512):
                member.write(bytes(1_000_000))
    return stream.getvalue()


def single() -> bytes:
    stream = io.BytesIO()
    np.save(stream, A)
    return stream.getvalue()


def sampled(**changes) -> bytes:
    """A sampled loop without feedthrough and controller states, changed; None leaves out."""
    arrays = {"A": A, "B": B, "C": K, "Dc": [[-1.0]], "period": 0.1} | changes
    return saved(**{name: array for name, array in arrays.items() if array is not None})


def empty(*shape: int) -> bytes:
    return npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d, %d)}\n" % shape)


HOSTILE_SAMPLED = {
    "no direct part": (sampled(Dc=None), r"has no Dc \(it holds A, B, C, period\).*sampled loop"),
    "no period": (sampled(period=None), "has no K .*a sampled loop needs period too"),
    "continuous": (saved(A=A, B=B, K=K, period=0.1), "has no C and no Dc .*period holds a sampled"),
    "both": (sampled(K=K), "unknown array 'K'.*sampled loop"),
    "delay": (sampled(delay=0.1), "unknown array 'delay'"),
    "two periods": (sampled(period=[0.1, 0.2]), r"period has shape \(2,\); give one number"),
    "period zero": (sampled(period=0.0), "period = 0"),
    "period infinite": (sampled(period=np.inf), "period = inf"),
    "period as text": (sampled(period="0.1"), "'period' holds text"),
    "period rounded": (sampled(period=np.longdouble(1) / 3), "double precision"),
    "states in part": (sampled(Ac=[[0.5]]), "Ac without Bc, Cc"),
    "states that do not fit": (
        sampled(Ac=[[0.5]], Bc=[[1.0, 1.0]], Cc=[[1.0]]),
        r"Bc has shape \(1, 2\); it must be \(1, 1\)",
    ),
    "knots that fall": (sampled(told=[0.1, 0.0], Dc=np.ones((2, 1, 1))), "told is not a list"),
    "no knots": (sampled(told=[], Dc=np.ones((0, 1, 1))), "Dc has shape"),
    "one knot too many": (sampled(told=[0.0, 0.1]), r"Dc has shape \(1, 1\); .* \(2, 1, 1\)"),
    "flat plant": (sampled(A=A[0]), "A has 1 dimensions"),
    "flat measurements": (sampled(C=K[0]), "C has 1 dimensions"),
    "measurements of another plant": (sampled(C=np.ones((1, 3))), r"C has shape \(1, 3\)"),
    "feedthrough that does not fit": (sampled(D=[1.0]), r"D has shape \(1,\)"),
    "not a number": (sampled(Dc=[[np.nan]]), "Dc holds a value that is not finite"),
    "objects": (sampled(Dc=np.array([[None]])), "object values"),
    "complex": (sampled(Dc=np.array([[1j]])), "complex128"),
    # Arrays without entries cost nothing and may declare any size.
    "long and empty": (
        zipped(
            A=empty(0, 0), B=empty(0, 2**40), C=empty(2**40, 0), Dc=empty(0, 1), period=empty(1, 0)
        ),
        "period has shape",
    ),
    "long and thin": (
        sampled(A=[[1.0]], B=np.ones((1, 10**5)), C=np.ones((10**5, 1))),
        "Dc has shape .* must have 100000 rows",
    ),
    "sides beyond any array": (
        zipped(
            A=empty(0, 0),
            B=empty(0, 0),
            C=empty(2**62, 0),
            Dc=empty(0, 1),
            period=npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': ()}\n", b"\x3f" * 8),
        ),
        "loop.npz",
    ),
}

HOSTILE = {
    "empty": (b"", "no .npz file"),
    "text": (b"A = 1\n", "no .npz file"),
    "pickle": (b"\x80\x04K\x01.", "no .npz file"),
    "single array": (single(), "no .npz file"),
    "truncated": (saved(A=A, B=B, K=K)[:-30], "no .npz file"),
    "cut short": (saved(A=A, B=B, K=K)[:200], "no .npz file"),
    "damaged": (damaged(), "loop.npz"),
    "nothing inside": (zipped(), "has no A and no B and no K"),
    "one missing": (saved(A=A, B=B), r"has no K \(it holds A, B\)"),
    "lower case": (saved(a=A, B=B, K=K), "has no A"),
    "one too many": (saved(A=A, B=B, K=K, D=A), "unknown array 'D'"),
    "delays": (saved(A=A, B=B, K=K, delay=[0.1]), "unknown array 'delay'"),
    "objects": (saved(A=np.array([None, {}], dtype=object), B=B, K=K), "object values"),
    "complex": (saved(A=A + 0j, B=B, K=K), "'A' holds complex128 values"),
    "truth values": (saved(A=A > 0, B=B, K=K), "'A' holds bool values"),
    "text inside": (saved(A=np.array([["1"]]), B=B, K=K), "'A' holds text"),
    "records": (saved(A=np.zeros(2, "f8,i4"), B=B, K=K), "values; give real numbers"),
    "dates": (saved(A=np.zeros(2, "M8[s]"), B=B, K=K), "datetime64"),
    "not a number": (saved(A=A * np.nan, B=B, K=K), "A holds a value that is not finite"),
    "infinite": (saved(A=A, B=[[np.inf], [1]], K=K), "B holds a value that is not finite"),
    "rounded": (saved(A=np.array([[2**53 + 1]]), B=[[1.0]], K=[[1.0]]), "double precision"),
    "long double": (saved(A=np.array([[1]]) / np.longdouble(3), B=[[1]], K=[[1]]), "double"),
    "wrong shape": (saved(A=A, B=B.T, K=K), r"B has shape \(1, 2\)"),
    "not square": (saved(A=A[:1], B=B, K=K), r"A has shape \(1, 2\)"),
    "flat": (saved(A=A, B=B, K=K[0]), "K has 1 dimensions"),
    "huge": (
        zipped(A=npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (999999999, 999999999)}")),
        "declares shape",
    ),
    "overflowing": (
        zipped(A=npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (%d,)}" % 2**70)),
        "loop.npz",
    ),
    "negative": (
        zipped(A=npy(b"{'descr': '<f8', 'fortran_order': False, 'shape': (-1, 2)}")),
        "loop.npz",
    ),
    "no header": (zipped(A=b"\x93NUMPY"), "cannot be read"),
    "no array": (zipped(A=b"hello"), "cannot be read"),
    "code as header": (zipped(A=npy(b"__import__('os').abort()")), "cannot be read"),
    "deep header": (zipped(A=npy(b"(" * 9000)), "cannot be read"),
    "strange type": (
        zipped(A=npy(b"{'descr': 'abc', 'fortran_order': False, 'shape': (1,)}")),
        "cannot be read",
    ),
    "unknown version": (zipped(A=b"\x93NUMPY\x09\x00\x00\x00"), "cannot be read"),
    "bomb": (bomb(), "declares shape"),
    **{f"sampled, {name}": content for name, content in HOSTILE_SAMPLED.items()},
    "many": (zipped(**{f"a{k}": b"" for k in range(200)}), "holds 200 arrays"),
}


@pytest.mark.parametrize("kind", HOSTILE)
def test_no_file_gives_a_traceback(capsys, tmp_path: Path, kind: str) -> None:
    content, message = HOSTILE[kind]
    place = tmp_path / "loop.npz"
    place.write_bytes(content)
    with pytest.raises(InputFileError, match=message):
        load_system(place)
    status, out, err = run(capsys, "roots", "--system", str(place), "--delay", "0.1")
    assert (status, out) == (2, "")
    assert "loop.npz" in err
    assert err.count("\n") == 1


@pytest.mark.parametrize("cut", range(0, 800, 37))
def test_no_part_of_a_file_gives_a_traceback(tmp_path: Path, cut: int) -> None:
    content = saved(A=A, B=B, K=K)
    place = tmp_path / "loop.npz"
    place.write_bytes(content[:cut])
    with pytest.raises(InputFileError):
        load_system(place)


def test_a_byte_changed_anywhere_is_the_same_loop_or_refused(tmp_path: Path) -> None:
    content = saved(A=A, B=B, K=K)
    place = tmp_path / "loop.npz"
    for index in range(0, len(content), 3):
        changed = bytearray(content)
        changed[index] ^= 0x5A
        place.write_bytes(changed)
        try:
            system = load_system(place)
        except InputFileError:
            continue
        assert isinstance(system, DelaySystem)
        np.testing.assert_array_equal(system.A, A)
        np.testing.assert_array_equal(system.K, K)


def test_the_same_array_twice_is_refused(tmp_path: Path) -> None:
    place = tmp_path / "loop.npz"
    stream = io.BytesIO()
    np.save(stream, A)
    with zipfile.ZipFile(place, "w") as archive:
        archive.writestr("A.npy", stream.getvalue())
        with pytest.warns(UserWarning, match="Duplicate"):
            archive.writestr("A.npy", stream.getvalue())
    with pytest.raises(InputFileError, match="'A' twice"):
        load_system(place)


def test_what_is_no_file_is_refused_without_waiting(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe.npz")
    for name, word in (
        ("missing.npz", "does not exist"),
        ("pipe.npz", "is no file"),
        ("", "no file"),
    ):
        with pytest.raises(InputFileError, match=word):
            load_system(tmp_path / name)
    for name in ("a\0b.npz", "x" * 5000 + ".npz"):
        with pytest.raises(InputFileError):
            load_system(name)


FIELDS = ("A", "B", "C", "D", "Ac", "Bc", "Cc", "Dc")


def test_a_file_with_a_period_is_the_sampled_loop_it_holds(path: Path) -> None:
    path.write_bytes(sampled())
    loop = load_system(path)
    assert isinstance(loop, SampledLoop)
    assert (loop.period, loop.told) == (0.1, None)
    expected = SampledLoop.from_delay_system(DelaySystem(A, B, K), 0.1)
    for name in FIELDS:
        np.testing.assert_array_equal(getattr(loop, name), getattr(expected, name))


@pytest.mark.parametrize("knots", [None, [0.0, 0.1]])
def test_a_sampled_loop_is_read_as_it_was(path: Path, knots: list[float] | None) -> None:
    measured, commanded = np.array([[[3.0]], [[-2.0]]]), np.array([[[0.1]]])
    if knots is not None:
        measured, commanded = (np.stack([part, 2.0 * part]) for part in (measured, commanded))
    loop = SampledLoop.from_feedback(A, B, K, [[0.25]], 0.1, measured, commanded, knots)
    arrays = {name: getattr(loop, name) for name in FIELDS} | {"period": loop.period}
    path.write_bytes(saved(**arrays, **({} if knots is None else {"told": knots})))
    found = load_system(path)
    assert isinstance(found, SampledLoop)
    assert found.to_plain() == loop.to_plain()


def test_the_sampled_critical_delay_is_a_proved_bracket(capsys, path: Path) -> None:
    # x_(k+1) = x_k - g T x_(k-7) loses stability at g T = 2 sin(pi / 30)
    gain = 2.0 * np.sin(np.pi / 30.0) / 0.1
    path.write_bytes(sampled(A=[[0.0]], B=[[1.0]], C=[[1.0]], Dc=[[-gain]]))
    found = answer(capsys, "critical-delay", "--system", str(path), "--max-delay", "1")
    low, high = found["critical_delay_sampled_bracket_s"]
    assert low < 0.7 < high
    assert high - low < 2e-3
    assert found["critical_delay_sampled_s"] == pytest.approx((low + high) / 2)
    assert (found["critical_delay_s"], found["crossings"]) == (None, [])
    assert (found["method"], found["proved"], found["sampled_proved"]) == ("sampled", True, True)
    assert (found["reason"], found["max_delay_s"], found["control_period_s"]) == ("", 1.0, 0.1)
    status, out, _ = run(capsys, "critical-delay", "--system", str(path), "--max-delay", "1")
    assert status == 0
    assert f"STABLE for every delay from 0 to {low!r} s" in out
    assert f"UNSTABLE at {high!r} s" in out
    assert "proved: yes" in out


@pytest.mark.parametrize(
    ("gain", "bracket", "words"),
    [(-2.0, [0.5, None], "none up to 0.5 s"), (2.0, [None, 0.0], "UNSTABLE WITHOUT DELAY")],
)
def test_a_sampled_loop_without_a_critical_delay_says_so(
    capsys, path: Path, gain: float, bracket: list, words: str
) -> None:
    path.write_bytes(sampled(A=[[0.0]], B=[[1.0]], C=[[1.0]], Dc=[[gain]]))
    arguments = ("critical-delay", "--system", str(path), "--max-delay", "0.5")
    found = answer(capsys, *arguments)
    assert found["critical_delay_sampled_bracket_s"] == bracket
    assert found["critical_delay_sampled_s"] is None
    assert words in run(capsys, *arguments)[1]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("roots", "--delay", "0.1"), "use certify or critical-delay"),
        (("critical-delay", "--method", "pade:3"), "drop --method"),
        (("critical-delay", "--control-period", "0.1"), "drop --control-period"),
        (("certify", "--delay", "0.1", "--control-period", "0.1"), "drop --control-period"),
        (("certify", "--delay", "0.1", "--decay-rate", "0.1"), "decay_rate"),
        (("certify", "--delay", "0.1", "--layout", "4"), "--layout"),
    ],
)
def test_what_does_not_go_with_a_sampled_loop_is_one_line(
    capsys, path: Path, arguments: tuple[str, ...], words: str
) -> None:
    path.write_bytes(sampled())
    status, out, err = run(capsys, *arguments, "--system", str(path))
    assert (status, out) == (2, "")
    assert words in err
    assert err.count("\n") == 1
