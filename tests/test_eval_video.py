"""Films of any controller by `railenv simulate --video`, of the environment by Gymnasium."""

import sys
from pathlib import Path

import gymnasium as gym
import numpy as np
import pytest

import railenv  # noqa: F401  (registers the ids)
from baselines import SkyHook
from baselines.semi_active import OnOffSkyHook
from eval.cli import main
from eval.rollout import ACCELERATIONS, ControlledBatch, Stepping, force_names, rollout
from eval.video import FRAMES_PER_SECOND, Film
from railenv.actuation import SemiActiveDamper
from railenv.errors import ArgumentError
from railenv.rendering import View
from railenv.simulation import required_length, wheelset_inputs
from railenv.track import make_track
from railenv.vehicle import lateral17

pytestmark = pytest.mark.slow

encoder = pytest.importorskip("imageio_ffmpeg")
pytest.importorskip("pygame")

RUN = ["simulate", "--controller", "skyhook:gain=35e3", "--delay", "0.05", "--seconds", "5"]


@pytest.fixture(scope="module")
def film(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("film") / "run.mp4"
    assert main([*RUN, "--video", str(path)]) == 0
    return path


def test_a_film_has_the_length_of_the_run_and_25_frames_a_second(film: Path) -> None:
    frames, seconds = encoder.count_frames_and_secs(str(film))
    # a frame more or less at either end
    assert frames == pytest.approx(5 * FRAMES_PER_SECOND, abs=1)
    assert seconds == pytest.approx(5.0, abs=0.08)


def test_a_film_is_640_by_480_and_moves(film: Path) -> None:
    reader = encoder.read_frames(str(film))
    size = next(reader)["size"]
    frames = [np.frombuffer(next(reader), dtype=np.uint8).astype(int) for _ in range(30)]
    reader.close()
    assert size == (640, 480)
    # beyond what the encoder's loss does to a still picture
    assert np.abs(frames[0] - frames[-1]).max() > 100


def test_the_film_changes_nothing_of_what_is_measured(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(RUN) == 0
    plain = capsys.readouterr().out
    assert main([*RUN, "--video", str(tmp_path / "a.mp4")]) == 0
    assert capsys.readouterr().out == plain


def test_a_run_that_fails_leaves_the_old_film_as_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    old = tmp_path / "old.mp4"
    old.write_bytes(b"old")
    (tmp_path / "fails.py").write_text(
        "class Fails:\n"
        "    def reset(self, num_lanes, seed):\n        self.left = 40\n"
        "    def act(self, observations):\n"
        "        self.left -= 1\n"
        "        if self.left == 0:\n            raise ValueError('enough')\n"
        "        return 0 * observations[:, :4]\n"
    )
    monkeypatch.chdir(tmp_path)
    arguments = ["simulate", "--controller", "py:fails:Fails", "--seconds", "5"]
    assert main([*arguments, "--video", str(old)]) == 1
    assert old.read_bytes() == b"old"
    assert sorted(p.name for p in tmp_path.iterdir() if p.suffix == ".mp4") == ["old.mp4"]


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["--controller", "skyhook", "--video", "film.gif"], ".mp4"),
        (["--controller", "passive", "--video", "film.mp4"], "layout 2 or 4"),
    ],
)
def test_what_cannot_be_filmed_is_refused(
    arguments: list[str],
    word: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["simulate", "--seconds", "5", *arguments]) == 2
    assert word in capsys.readouterr().err
    assert not list(tmp_path.glob("*.mp4"))


def test_a_missing_encoder_is_said_with_the_way_out(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    assert main([*RUN, "--video", str(tmp_path / "a.mp4")]) == 2
    assert "railenv[render]" in capsys.readouterr().err


def test_the_ride_index_in_the_last_frame_is_that_of_the_filter_over_the_whole_run() -> None:
    from scipy.signal import sosfilt

    from railenv.metrics.ride_filter import ride_filter, ride_index_from_mean_square

    vehicle, delays = lateral17(), np.full(4, 0.05)
    track = make_track("tb3352", required_length(vehicle, 2.0), 0)
    shown: list[np.ndarray] = []
    film = Film(vehicle, track, delays, Stepping(), lambda frame: None)
    view = film._view

    def spy(batch: object, time: float) -> object:
        made = view(batch, time)
        shown.append(made.ride_index)
        return made

    film._view = spy  # type: ignore[method-assign]
    run = rollout(
        SkyHook(35e3, 4),
        vehicle,
        delays[None],
        2.0,
        track_inputs=wheelset_inputs(vehicle, track, 0.005, 400)[None],
        watch=film.watch,
    )
    floor = run.values[0, :, :2].T
    square = np.square(sosfilt(ride_filter(200.0), floor, axis=-1)).mean(axis=1)
    np.testing.assert_allclose(shown[-1], ride_index_from_mean_square(square), rtol=1e-9)


def test_coefficients_of_dampers_are_drawn_as_the_forces_they_would_give() -> None:
    vehicle, delays = lateral17(), np.full(4, 0.02)
    track = make_track("tb3352", required_length(vehicle, 2.0), 0)
    film = Film(vehicle, track, delays, Stepping(), lambda frame: None)
    shown: list[View] = []
    view = film._view

    def spy(batch: ControlledBatch, time: float) -> View:
        shown.append(view(batch, time))
        return shown[-1]

    film._view = spy  # type: ignore[method-assign]
    rates = tuple(f"suspension_stroke_rate_{k}" for k in (1, 2, 3, 4))
    run = rollout(
        OnOffSkyHook(SemiActiveDamper(5e3, 15e3, 0.0)),
        vehicle,
        delays[None],
        2.0,
        tracks=(track,),
        record=(*ACCELERATIONS, *force_names(vehicle), *rates),
        watch=film.watch,
    )
    # Pictures after the first and every fourth period of two records each.
    rate = run.values[0, 2 * np.array([1, *range(4, 201, 4)]) - 1, 8:]
    newest = np.array([picture.command for picture in shown])
    pipe = np.array([picture.pipe_command for picture in shown])
    force = np.array([picture.force for picture in shown])
    assert len(newest) == len(rate)
    soft, stiff = np.isclose(newest, -5e3 * rate), np.isclose(newest, -15e3 * rate)
    assert np.all(soft | stiff)
    assert soft.any()
    assert stiff.any()
    # The delay is two periods: the third newest command acts at the end of a period.
    np.testing.assert_allclose(pipe[1:, 2], force[1:], rtol=1e-9)


def test_a_vehicle_without_actuators_makes_no_film() -> None:
    vehicle = lateral17(layout="passive")
    track = make_track("flat", 100.0, 0)
    with pytest.raises(ArgumentError, match="layout 2 or 4"):
        Film(vehicle, track, np.zeros(0), Stepping(), lambda frame: None)


def test_gymnasiums_record_video_films_the_environment(tmp_path: Path) -> None:
    pytest.importorskip("moviepy")
    env = gym.make("railenv/Lateral17-v0", render_mode="rgb_array", episode_seconds=0.2)
    folder = tmp_path / "films"
    recorded = gym.wrappers.RecordVideo(env, str(folder), episode_trigger=lambda _: True)
    recorded.reset(seed=0)
    for _ in range(20):
        recorded.step(np.zeros(4, dtype=np.float32))
    recorded.close()
    (film,) = folder.glob("*.mp4")
    # the picture after the reset and after each of 20 steps
    assert encoder.count_frames_and_secs(str(film))[0] == pytest.approx(21, abs=1)
