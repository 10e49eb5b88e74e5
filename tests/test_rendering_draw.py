"""Pixels: shape, independence, determinism, readable texts, the package's import, the window."""

import itertools
import subprocess
import sys

import numpy as np
import pytest

from railenv.errors import ArgumentError
from railenv.rendering import View, Window, build_scene, draw_frame
from railenv.rendering.draw import draw_shapes, drawing_package, text_box
from railenv.rendering.shapes import (
    BLACK,
    PAPER,
    VERMILLION,
    WHITE,
    Arrow,
    Circle,
    Line,
    Text,
    rectangle,
)
from railenv.vehicle.coordinates import COORDINATES

pytest.importorskip("pygame")

SIZES = [(640, 480), (960, 720), (480, 360), (1280, 480), (480, 900)]


def view(layout="4", sway=0.0, roll=0.0, force=0.0, **changes):
    channels = int(layout)
    q = np.zeros(len(COORDINATES))
    q[COORDINATES.index("carbody_lateral")] = sway
    q[COORDINATES.index("carbody_roll")] = roll
    distance = np.linspace(-25.0, 25.0, 101)
    past = np.linspace(-5.0, 0.0, 501)
    fields = {
        "time": 12.3,
        "speed": 83.3,
        "layout": layout,
        "coordinates": q,
        "force": np.full(channels, force),
        "command": np.full(channels, -force),
        "force_limit": 30e3,
        "delay": np.full(channels, 0.1),
        "max_delay": 0.3,
        "pipe_age": 0.01 * np.arange(31),
        "pipe_command": np.full((31, channels), -force),
        "track_distance": distance,
        "track_alignment": 0.002 * np.sin(0.2 * distance),
        "track_cross_level": 0.001 * np.cos(0.3 * distance),
        "history_time": past,
        "history_acceleration": 0.2 * np.sin(past[:, None] + np.array([0.0, 1.0])),
        "ride_index": np.array([2.13, 1.98]),
        "reward": -0.8,
        "ended_by": "",
    }
    return View(**{**fields, **changes})


VIEWS = {
    "rest": view(),
    "running": view("4", 0.005, 0.001, 500.0),
    "two": view("2", -0.005, -0.001, -500.0),
    "diverged": view("4", 0.08, -0.02, 20e3, ended_by="divergence", reward=-505.0),
    "gauge": view(
        "4",
        -0.3,
        0.2,
        -29_999.0,
        ended_by="gauge",
        time=3599.99,
        delay=np.array([0.1234, 0.2, 0.2, 0.2987]),
        reward=-505.01,
        history_acceleration=np.full((501, 2), -123.4),
        ride_index=np.array([12.34, np.nan]),
    ),
}


@pytest.mark.parametrize("size", SIZES)
def test_a_frame_is_height_by_width_of_bytes(size):
    frame = draw_frame(view(), size)
    assert frame.shape == (size[1], size[0], 3)
    assert frame.dtype == np.uint8
    assert frame.flags.c_contiguous
    assert frame.flags.writeable


def test_frames_share_no_memory():
    first = draw_frame(view())
    before = first.copy()
    second = draw_frame(view())
    assert not np.shares_memory(first, second)
    second[:] = 0
    assert np.array_equal(first, before)
    assert np.array_equal(draw_frame(view()), before)


def test_the_same_view_gives_the_same_pixels_whatever_was_drawn_between():
    first = draw_frame(VIEWS["running"])
    draw_frame(VIEWS["gauge"], (960, 720))
    assert np.array_equal(draw_frame(VIEWS["running"]), first)


def test_a_frame_is_not_blank_and_changes_with_the_vehicle():
    rest, sway = draw_frame(view()), draw_frame(view(sway=0.005))
    assert len(np.unique(rest.reshape(-1, 3), axis=0)) > 50
    assert np.count_nonzero(np.any(rest != sway, axis=2)) > 500


def test_pictures_survive_that_somebody_else_quits_the_package():
    first = draw_frame(view())
    drawing_package().quit()
    assert np.array_equal(draw_frame(view()), first)
    changed = view(reward=-0.4321)
    drawing_package().quit()
    drawing_package().init()
    drawing_package().quit()
    assert draw_frame(changed).shape == first.shape


def test_shapes_are_drawn_in_their_colour_at_their_place():
    shapes = [
        rectangle(10.0, 20.0, 40.0, 60.0, VERMILLION),
        Circle((80.0, 40.0), 10.0, BLACK),
        Line(((100.0, 5.0), (100.0, 95.0)), BLACK, 4.0),
        Arrow((120.0, 50.0), (150.0, 50.0), BLACK, 4.0, halo=WHITE),
        Arrow((120.0, 80.0), (120.0, 80.0), BLACK, 4.0),
    ]
    frame = draw_shapes(shapes, (160, 100))
    for (x, y), colour in {
        (25, 40): VERMILLION,
        (80, 40): BLACK,
        (100, 50): BLACK,
        (125, 50): BLACK,
        (120, 80): PAPER,
        (5, 5): PAPER,
    }.items():
        assert tuple(frame[y, x]) == colour
    # The head is broad behind the tip and the halo stands around it.
    dark = np.all(frame[:, :, :] == BLACK, axis=2)
    assert dark[:, 141].sum() > dark[:, 125].sum()
    assert np.any(np.all(frame[:, 115:155] == WHITE, axis=2))


def test_edges_are_smooth():
    frame = draw_shapes([Line(((10.0, 10.0), (90.0, 37.0)), BLACK, 2.0)], (100, 50))
    greys = np.unique(frame[:, :, 0])
    assert len(greys) > 3


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("name", VIEWS)
def test_texts_neither_overlap_nor_leave_the_frame(name, size):
    texts = [s for s in build_scene(VIEWS[name], size).shapes if isinstance(s, Text)]
    boxes = [(text.text, text_box(text)) for text in texts if text.text]
    for text, (left, top, right, bottom) in boxes:
        assert left >= 0, text
        assert top >= 0, text
        assert right <= size[0], text
        assert bottom <= size[1], text
    for (one, a), (other, b) in itertools.combinations(boxes, 2):
        apart = a[2] <= b[0] or b[2] <= a[0] or a[3] <= b[1] or b[3] <= a[1]
        assert apart, f"{one!r} and {other!r} overlap"


def run(code):
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", code],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_the_package_is_loaded_at_the_first_picture_only():
    code = "import railenv.rendering, sys; print('pygame' in sys.modules)"
    assert run(code).strip() == "False"


def test_the_package_is_loaded_without_greeting_and_leaves_the_environment_alone():
    code = (
        "import os; from railenv.rendering.draw import drawing_package\n"
        # gymnasium sets it on its own import.
        "os.environ.pop('PYGAME_HIDE_SUPPORT_PROMPT', None); before = dict(os.environ)\n"
        "drawing_package()\n"
        "changed = dict(os.environ).items() ^ before.items()\n"
        "print([name for name, _ in changed if 'PROMPT' in name])"
    )
    assert run(code).strip() == "[]"


def test_a_missing_package_is_an_error_that_names_the_extra(monkeypatch):
    monkeypatch.setitem(sys.modules, "pygame", None)
    with pytest.raises(ArgumentError, match=r'pip install "railenv\[render\]"'):
        draw_frame(view())


@pytest.fixture
def dummy_display(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "dummy")
    drawing_package().display.quit()
    yield drawing_package()
    drawing_package().display.quit()


def test_a_window_shows_the_frame_as_it_is(dummy_display):
    frame = draw_frame(VIEWS["running"])
    with Window(fps=1000.0) as window:
        window.show(frame)
        shown = dummy_display.surfarray.array3d(dummy_display.display.get_surface())
        assert np.array_equal(shown.swapaxes(0, 1), frame)
        assert window.is_open
    assert not window.is_open
    assert not dummy_display.display.get_init()


def test_a_window_keeps_the_pace(dummy_display):
    frame = draw_frame(view())
    clock = dummy_display.time
    with Window(fps=50.0) as window:
        window.show(frame)
        start = clock.get_ticks()
        for _ in range(10):
            window.show(frame)
        passed = clock.get_ticks() - start
    # Ten frames of 20 ms; the clock counts whole milliseconds, so each frame may be one short.
    assert passed >= 190 - 10


def test_a_window_closed_by_its_reader_stays_closed_without_an_error(dummy_display):
    frame = draw_frame(view())
    window = Window(fps=1000.0)
    window.show(frame)
    dummy_display.event.post(dummy_display.event.Event(dummy_display.QUIT))
    window.show(frame)
    assert not window.is_open
    window.show(frame)
    window.close()
    assert not dummy_display.display.get_init()


def test_a_window_grows_with_its_frames(dummy_display):
    with Window(fps=1000.0) as window:
        for size in ((640, 480), (960, 720)):
            window.show(draw_frame(view(), size))
            assert dummy_display.display.get_surface().get_size() == size


def test_a_window_without_a_display_is_an_error_that_names_the_way_out(monkeypatch):
    monkeypatch.setenv("SDL_VIDEODRIVER", "no_such_driver")
    drawing_package().display.quit()
    with pytest.raises(ArgumentError, match="rgb_array"):
        Window().show(draw_frame(view()))


@pytest.mark.parametrize("fps", [0.0, -1.0, np.nan])
def test_a_window_refuses_a_pace_that_is_none(fps):
    with pytest.raises(ArgumentError, match="fps"):
        Window(fps=fps)
