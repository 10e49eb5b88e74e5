"""Pictures of the nonlinear vehicle: the linear one's, with the wheelsets' own roll and height."""

from typing import Any

import numpy as np
import pytest

from railenv.envs.full_env import Full50Env, Full50VectorEnv
from railenv.envs.picture import Pictures
from railenv.errors import ArgumentError
from railenv.rendering import View, build_scene
from railenv.rendering.shapes import Polygon
from railenv.vehicle.coordinates import COORDINATES
from railenv.vehicle.nonlinear.coordinates import coordinate_index

SMALL: dict[str, Any] = {"track_pool": 1, "episode_seconds": 2.0}
TOO_TIGHT: dict[str, Any] = {
    "track": "flat",
    "curve": (300.0, 0.0),
    "curve_start": 0.0,
    "curve_transition": 20.0,
}


def view_after(steps: int, **settings: Any) -> tuple[Full50Env, View]:
    """What there is to see after some steps, or at the end of the episode."""
    env = Full50Env(**{**SMALL, **settings})
    pictures = Pictures(env._lanes)
    env.reset(seed=0)
    for _ in range(steps):
        if env.step(np.full(4, 0.3))[2]:
            break
    return env, pictures.view(0)


def low_points(view: View) -> list[float]:
    """Lowest points of both wheels' flanges on the picture [pixels, down]."""
    shapes = {s.name: s for s in build_scene(view).shapes if isinstance(s, Polygon)}
    return [max(y for _, y in shapes[f"wheel_{side}"].points) for side in ("left", "right")]


def test_the_coordinates_shown_are_those_of_the_same_names() -> None:
    env, view = view_after(40)
    state = env._lanes.state(0)
    for name in COORDINATES:
        assert view.coordinate(name) == state[coordinate_index(name)]


def test_wheelsets_stay_on_the_rails_and_roll_with_them() -> None:
    _, view = view_after(100)
    assert view.wheelset_roll is not None
    assert view.wheelset_lift is not None
    # The wheels press themselves some tenths of a millimetre into each other and the rails.
    assert np.all(np.abs(view.wheelset_lift) < 5e-4)
    assert np.all(np.abs(view.wheelset_roll) > 0.0)


def test_a_lifted_and_rolled_wheelset_is_drawn_so() -> None:
    _, view = view_after(1, track="flat")
    fields = {name: getattr(view, name) for name in View.__dataclass_fields__}
    none = np.zeros(4)
    still = low_points(View(**{**fields, "wheelset_roll": none, "wheelset_lift": none}))
    lifted = low_points(View(**{**fields, "wheelset_roll": none, "wheelset_lift": none + 0.002}))
    rolled = low_points(View(**{**fields, "wheelset_roll": none + 1e-3, "wheelset_lift": none}))
    assert lifted[0] < still[0] - 1.0
    assert lifted[1] < still[1] - 1.0
    # positive roll puts the right side down
    assert rolled[0] < still[0] - 1.0
    assert rolled[1] > still[1] + 1.0


@pytest.mark.parametrize("name", ["wheelset_roll", "wheelset_lift"])
def test_wheelsets_of_a_wrong_number_or_beyond_all_bounds_are_refused(name: str) -> None:
    _, view = view_after(1, track="flat")
    fields = {each: getattr(view, each) for each in View.__dataclass_fields__}
    for values in (np.zeros(3), np.full(4, np.nan)):
        with pytest.raises(ArgumentError, match=name):
            View(**{**fields, name: values})


def test_a_derailed_vehicle_is_shown_with_its_reason() -> None:
    _, view = view_after(100, **TOO_TIGHT)
    assert view.ended_by == "derailment"
    texts = [shape.text for shape in build_scene(view).shapes if shape.name == "banner"]  # type: ignore[union-attr]
    assert texts == ["DERAILED: episode over"]


def test_a_picture_of_every_lane_is_drawn() -> None:
    pytest.importorskip("pygame")
    env = Full50VectorEnv(2, render_mode="rgb_array", **SMALL)
    env.reset(seed=0)
    env.step(np.zeros((2, 4)))
    frames = env.render()
    assert frames is not None
    assert [frame.shape for frame in frames] == [(480, 640, 3)] * 2
    assert not np.array_equal(*frames)
    env.close()


def test_the_text_picture_says_what_the_vehicle_does() -> None:
    env = Full50Env(render_mode="ansi", **SMALL)
    env.reset(seed=0)
    assert "300 km/h" in env.render()
