"""Pools of tracks and their compiled sampling, against the tracks themselves."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from railenv.errors import ArgumentError
from railenv.simulation import wheelset_inputs
from railenv.simulation.excitation import Places, excite, excite_start, wheels_of
from railenv.track import Track, make_track
from railenv.track.table import PooledTrack, pool_of_tracks, single_track, table_of
from railenv.vehicle import LateralVehicle, lateral17

# A hundred million times below the height of a track of some mm.
EXACT = 1e-12
STEP, PER_PERIOD = 0.005, 2
CAR = lateral17("paper_fit", 4, 250.0)


def periodic(taper: float = 100.0) -> PooledTrack:
    return pool_of_tracks([f"tb3352:taper={taper:g}"], 1, 1000.0, 3)[0]


def seen(
    tracks: list[PooledTrack],
    steps: int,
    number: int = 0,
    start: float = 0.0,
    taper: float = 0.0,
    amplitude: float = 1.0,
    running: bool = False,
    vehicle: LateralVehicle = CAR,
) -> NDArray[np.float64]:
    """What the wheelsets of a run see at its start and after every step, shape (steps + 1, 8)."""
    places = Places(
        track=np.array([number]),
        start=np.array([start]),
        taper=np.array([taper]),
        running=np.array([running]),
        amplitude=np.array([amplitude]),
    )
    table, wheels, only = table_of(tracks), wheels_of([vehicle]), np.array([0])
    inputs: NDArray[np.float64] = np.zeros((1, PER_PERIOD + 1, 8))
    excite_start(table, places, wheels, only, only, inputs)
    out = [inputs[0, -1:].copy()]
    active = np.ones(1, dtype=bool)
    for first in range(0, steps, PER_PERIOD):
        excite(table, places, wheels, only, np.array([first]), STEP, active, 0, 1, inputs)
        # the period begins with what the last one ended with
        np.testing.assert_array_equal(inputs[0, 0], out[-1][-1])
        out.append(inputs[0, 1:].copy())
    return np.concatenate(out)


def grid_heights(pooled: PooledTrack) -> NDArray[np.float64]:
    """Alignment at the grid points of one period [m]."""
    points = round(pooled.length / pooled.spacing)
    return pooled.heights(pooled.spacing * np.arange(points))[0]


def rolled(steps: int) -> NDArray[np.float64]:
    """How far each wheelset is from the start at every step [m], shape (steps + 1, 4)."""
    return CAR.speed * STEP * np.arange(steps + 1)[:, None] - CAR.wheelset_setback


def test_a_track_given_in_person_reads_as_the_track_itself() -> None:
    track = make_track("german_low", 400.0, 5)
    pooled = single_track(track)
    distance = np.random.default_rng(0).uniform(0.0, track.length, 5000)
    alignment, cross_level = pooled.heights(distance)
    np.testing.assert_allclose(alignment, track.sample("alignment", distance), atol=EXACT)
    np.testing.assert_allclose(cross_level, track.sample("cross_level", distance), atol=EXACT)


def test_a_run_on_a_track_given_in_person_sees_its_wheelset_inputs() -> None:
    track = make_track("tb3352", 400.0, 5)
    expected = wheelset_inputs(CAR, track, STEP, 1000)
    np.testing.assert_allclose(seen([single_track(track)], 1000), expected, atol=EXACT)


def test_the_last_point_of_a_track_given_in_person_can_be_reached() -> None:
    grid = np.arange(51) * 2.0
    track = Track("ramp", 2.0, {"alignment": 1e-3 * grid, "cross_level": -2e-3 * grid})
    alignment, cross_level = single_track(track).heights(np.array([100.0]))
    # rounding of a sum of weights
    np.testing.assert_allclose([alignment[0], cross_level[0]], [0.1, -0.2], atol=1e-15)


def test_before_its_beginning_and_behind_its_end_such_a_track_is_straight() -> None:
    track = Track("step", 1.0, {"alignment": np.ones(20)})
    heights = single_track(track).heights(np.array([-0.001, 0.0, 19.0, 19.001]))[0]
    # rounding of a sum of weights
    np.testing.assert_allclose(heights, [0.0, 1.0, 1.0, 0.0], atol=1e-15)


def test_a_channel_that_a_track_lacks_is_zero() -> None:
    track = Track("one", 1.0, {"alignment": np.ones(20)})
    assert not np.any(single_track(track).heights(np.linspace(0, 19, 50))[1])


def test_a_periodic_track_goes_on_smoothly_with_its_beginning() -> None:
    pooled = periodic()
    near = 1e-4 * np.arange(-5, 6)
    around = pooled.heights(pooled.length + near)[0]
    np.testing.assert_allclose(around, pooled.heights(near)[0], atol=EXACT)
    # Second differences of a smooth curve are its curvature times a hundred millionth, of the
    # order of 1e-11; a kink of the shortest wave's slope would leave 1e-7.
    assert np.abs(np.diff(around, 2)).max() < 1e-9


def test_a_periodic_track_is_the_middle_of_its_period_set_three_times_in_a_row() -> None:
    pooled = periodic()
    grid = np.tile(grid_heights(pooled), 3)
    row = CubicSpline(pooled.spacing * np.arange(len(grid)), grid)
    near = np.linspace(-1.0, 1.0, 101)
    # what the row's own ends do fades by a factor of four per point
    np.testing.assert_allclose(pooled.heights(near)[0], row(2.0 * pooled.length + near), atol=EXACT)


def test_a_run_over_the_end_of_a_period_sees_the_periodic_track() -> None:
    pooled = periodic()
    start = pooled.length - 20.0
    inputs = seen([pooled], 400, start=start)
    places = rolled(400)
    for w in range(4):
        on_track = places[:, w] >= 0.0
        expected = pooled.heights(start + places[:, w])[0]
        np.testing.assert_allclose(inputs[on_track, w], expected[on_track], atol=EXACT)
        assert not np.any(inputs[~on_track, w])
    # the run does get past the end
    assert places[-1].min() > 20.0 + 50.0


def test_a_run_that_is_already_going_has_all_its_wheelsets_on_the_irregularity() -> None:
    pooled = periodic()
    # the last wheelset is behind the beginning of the period, on its end
    inputs = seen([pooled], 100, start=5.0, running=True)
    for w in range(4):
        expected = pooled.heights(5.0 + rolled(100)[:, w])[0]
        np.testing.assert_allclose(inputs[:, w], expected, atol=EXACT)


def test_the_irregularity_grows_over_the_taper_as_half_a_cosine() -> None:
    pooled = periodic()
    full, tapered = seen([pooled], 600), seen([pooled], 600, taper=100.0)
    share = np.clip(rolled(600) / 100.0, 0.0, 1.0)
    weight = 0.5 - 0.5 * np.cos(np.pi * share)
    np.testing.assert_allclose(tapered, full * np.hstack([weight, weight]), atol=EXACT)


def test_the_taper_is_that_of_a_track_that_begins() -> None:
    pooled = periodic()
    grid = grid_heights(pooled)
    begun = Track("whole", pooled.spacing, {"alignment": grid}).begun(pooled.taper)
    inputs = seen([pooled], 600, taper=pooled.taper)
    expected = begun.sample("alignment", rolled(600)[:, 0])
    # Weighting the spline is not the spline of weighted points: off by fourth derivatives.
    np.testing.assert_allclose(inputs[:, 0], expected, atol=1e-4 * np.abs(grid).max())


def test_the_taper_of_a_description_is_kept() -> None:
    assert (periodic().taper, periodic(30.0).taper) == (100.0, 30.0)


def test_the_amplitude_scales_every_input() -> None:
    pooled = periodic()
    np.testing.assert_allclose(
        seen([pooled], 100, start=50.0, amplitude=3.0),
        3.0 * seen([pooled], 100, start=50.0),
        rtol=1e-15,
    )


def test_the_level_of_a_description_scales_the_spectral_density() -> None:
    one = pool_of_tracks(["tb3352"], 1, 500.0, 0)[0]
    four = pool_of_tracks(["tb3352:level=4"], 1, 500.0, 0)[0]
    np.testing.assert_allclose(grid_heights(four), 2.0 * grid_heights(one), atol=EXACT)


def test_cross_level_becomes_roll_over_the_spacing_of_the_rolling_circles() -> None:
    pooled = periodic()
    inputs = seen([pooled], 200, start=300.0, running=True)
    cross_level = pooled.heights(300.0 + rolled(200)[:, 0])[1]
    width = 2.0 * CAR.parameters.half_contact_spacing
    np.testing.assert_allclose(inputs[:, 4], cross_level / width, atol=EXACT)


def test_every_lane_runs_on_its_own_track() -> None:
    pool = list(pool_of_tracks(["tb3352", "german_low"], 4, 500.0, 0))
    together = [seen(pool, 50, number=k, start=10.0) for k in range(4)]
    alone = [seen([track], 50, start=10.0) for track in pool]
    np.testing.assert_array_equal(together, alone)


def test_the_pool_takes_descriptions_in_turn_and_a_flat_track_once() -> None:
    names = [t.name for t in pool_of_tracks(["tb3352", "flat"], 6, 500.0, 0)]
    assert names == ["tb3352", "flat", "tb3352", "tb3352"]


def test_tracks_of_a_pool_differ_and_do_not_depend_on_its_size() -> None:
    few, many = (pool_of_tracks(["tb3352"], number, 500.0, 7) for number in (2, 4))
    for a, b in zip(few, many, strict=False):
        np.testing.assert_array_equal(grid_heights(a), grid_heights(b))
    for k in range(3):
        # of two independent tracks of equal variance, the correlation is small
        pair = np.corrcoef(grid_heights(many[k]), grid_heights(many[k + 1]))
        assert abs(pair[0, 1]) < 0.5


def test_a_pooled_track_has_the_variance_of_a_realised_one() -> None:
    length = 3000.0
    track = make_track("tb3352:taper=0", length, 0)
    pooled = pool_of_tracks(["tb3352"], 1, length, 0)[0]
    expected = float(np.std(track.channels["alignment"]))
    # by construction every draw has the band's variance over its period; a part of one varies
    assert np.std(grid_heights(pooled)) == pytest.approx(expected, rel=0.1)


def test_a_period_is_as_long_as_the_longest_run() -> None:
    assert pool_of_tracks(["tb3352"], 1, 5000.0, 0)[0].length >= 5000.0


@pytest.mark.parametrize(
    ("specs", "number", "message"),
    [([], 1, "track is empty"), (["tb3352"], 0, "number"), (["tb3353"], 1, "tb3352")],
)
def test_a_pool_that_cannot_be_is_refused(specs: Any, number: int, message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        pool_of_tracks(specs, number, 500.0, 0)
