"""Many tracks side by side for fast sampling: a pool of realisations that episodes start on.

A realised spectrum is kept as one whole period, on which a run may start anywhere and which it
never leaves; a measured file or a track given in person is kept as it is. Every channel is the
cubic spline through its grid, as `railenv.track.Track.sample`, stored as weights of B-splines: half
the memory of heights and derivatives, and sampling is bound by memory.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.interpolate import CubicSpline

from railenv.errors import ArgumentError, check_count
from railenv.track.irregularity import Track, make_track, one_period, parse_spec
from railenv.track.spectra import get_spectrum
from railenv.units import FloatArray, Metre

LATERAL_CHANNELS = ("alignment", "cross_level")
"""What a model of lateral motion reads, in the order of the weights' columns."""

FULL_CHANNELS = (*LATERAL_CHANNELS, "vertical", "gauge")
"""What both rails' places follow from."""

SPACING = 0.25
"""Grid step of a realised track [m], an eighth of the shortest wave: the spline differs from that
on half the step by 2e-5 of the RMS, and a pool of 16 tracks is 4 MB, which stays in the cache."""


class TrackArrays(NamedTuple):
    """What the compiled sampling reads.

    Attributes:
        weights: Weights of the uniform cubic B-splines whose sum is each channel, of all tracks one
            after the other, shape (weights, channels) [m]; interval i of a track has the four from
            its number i on.
        first: Where each track's weights begin, shape (tracks,).
        intervals: Grid intervals of each track, shape (tracks,).
        periodic: Whether its first point comes after the last, shape (tracks,).
        per_metre: Its grid points per metre, shape (tracks,) [1/m].
    """

    weights: FloatArray
    first: NDArray[np.int64]
    intervals: NDArray[np.int64]
    periodic: NDArray[np.bool_]
    per_metre: FloatArray


@dataclass(frozen=True, eq=False)
class PooledTrack:
    """One track of a table.

    Attributes:
        name: Its description.
        spacing: Grid step [m].
        weights: See `TrackArrays`, shape (intervals + 3, channels).
        length: Length of the period, or of the track [m].
        periodic: Whether it goes on with its beginning after its end.
        taper: Distance over which a run's irregularity grows from zero [m]; 0 for a track that has
            its own beginning.
    """

    name: str
    spacing: Metre
    weights: FloatArray
    length: Metre
    periodic: bool
    taper: Metre

    @property
    def intervals(self) -> int:
        """Grid intervals that can be sampled."""
        return len(self.weights) - 3

    def heights(self, distance: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return alignment and cross level at any positions [m].

        Beyond either end a track that is not periodic is straight and level.

        Args:
            distance: Positions [m], shape (k,).
        """
        places = np.mod(distance, self.length) if self.periodic else distance
        inside = (places >= 0.0) & (places <= self.length)
        share = np.where(inside, places, 0.0) / self.spacing
        whole = np.minimum(np.floor(share).astype(np.int64), self.intervals - 1)
        t = share - whole
        s = 1.0 - t
        shape = np.array([s**3, 4.0 - 6.0 * t**2 + 3.0 * t**3, 4.0 - 6.0 * s**2 + 3.0 * s**3, t**3])
        parts = np.array([self.weights[whole + k] for k in range(4)])
        value = np.where(inside[:, None], np.einsum("jk,jkc->kc", shape / 6.0, parts), 0.0)
        return value[:, 0], value[:, 1]


def pool_of_tracks(
    specs: Sequence[str],
    number: int,
    length: float,
    seed: int,
    channels: Sequence[str] = LATERAL_CHANNELS,
) -> tuple[PooledTrack, ...]:
    """Realise a pool of tracks.

    Args:
        specs: Descriptions as `make_track` takes them; track k follows number k modulo their count.
        number: How many; a flat track and a measured file are taken once, whatever the number.
        length: Length of the longest run [m].
        seed: Seed of the pool; track k does not depend on `number`.
        channels: Which channels; each has a stream of its own and does not depend on the others.

    Returns:
        The tracks; realised spectra are periodic, with a period of `length` or more.

    Raises:
        ArgumentError: A description is not understood, or a measured file is too short.
        InputFileError: A measured file cannot be used.
    """
    check_count("number", number)
    if not specs:
        raise ArgumentError("track is empty; give one description or more")
    pool: list[PooledTrack] = []
    known: set[str] = set()
    for k in range(max(number, len(specs))):
        spec = specs[k % len(specs)]
        name, settings = parse_spec(spec)
        if name == "flat" or name.lower().endswith(".csv"):
            if spec not in known:
                pool.append(single_track(make_track(spec, length, 0), channels))
            known.add(spec)
            continue
        spectrum = get_spectrum(name).at_level(settings["level"])
        stream = np.random.SeedSequence(seed, spawn_key=(k,))
        spacing, heights = one_period(spectrum, length, stream, SPACING, channels=tuple(channels))
        closed = {c: np.append(values, values[0]) for c, values in heights.items()}
        weights = _weights(spacing, closed, channels, periodic=True)
        taper, period = settings.get("taper", 100.0), spacing * (len(weights) - 3)
        pool.append(PooledTrack(spec, spacing, weights, period, True, taper))
    return tuple(pool)


def single_track(track: Track, channels: Sequence[str] = LATERAL_CHANNELS) -> PooledTrack:
    """Return a track as it stands, to be run from its beginning."""
    zero = np.zeros(track.points)
    heights = {c: track.channels.get(c, zero) for c in channels}
    weights = _weights(track.spacing, heights, channels, periodic=False)
    # One interval more, of which only the beginning is needed: the last point itself.
    weights = np.concatenate([weights, weights[-1:]])
    return PooledTrack(track.name, track.spacing, weights, track.length, False, 0.0)


def table_of(tracks: Sequence[PooledTrack]) -> TrackArrays:
    """Put tracks side by side for the compiled sampling."""
    number = np.array([len(track.weights) for track in tracks], dtype=np.int64)
    return TrackArrays(
        weights=np.concatenate([track.weights for track in tracks]),
        first=np.concatenate([[0], np.cumsum(number)[:-1]]).astype(np.int64),
        intervals=number - 3,
        periodic=np.array([track.periodic for track in tracks]),
        per_metre=np.array([1.0 / track.spacing for track in tracks]),
    )


def _weights(
    spacing: float, heights: Mapping[str, FloatArray], channels: Sequence[str], periodic: bool
) -> FloatArray:
    """Return the B-spline weights of the cubic splines through heights on a grid.

    At a grid point the three splines that reach it make the height y = (c_- + 4 c + c_+) / 6 and
    its second derivative y'' spacing^2 = c_- - 2 c + c_+; so c = y - y'' spacing^2 / 6.
    """
    columns: list[FloatArray] = []
    for channel in channels:
        y = heights[channel]
        grid = spacing * np.arange(len(y), dtype=np.float64)
        spline = CubicSpline(grid, y, bc_type="periodic" if periodic else "not-a-knot")
        c = y - spline(grid, 2) * (spacing**2 / 6.0)
        before, after = 6.0 * y[0] - 4.0 * c[0] - c[1], 6.0 * y[-1] - 4.0 * c[-1] - c[-2]
        columns.append(np.concatenate([[before], c, [after]]))
    return np.stack(columns, axis=1)
