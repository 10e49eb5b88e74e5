"""Ride metrics: a signal goes in, a number comes out.

Every function takes accelerations [m/s^2] with time on the last axis and any batch before it, and
the sample rate [Hz] where that matters. `ride_index` is Sperling's index, `en12299` the weighted
comfort values of the European standard, `acceleration` holds plain measures. Nothing here knows of
vehicles, tracks or simulations.
"""

from railenv.metrics.acceleration import peak, percentile_abs, rms
from railenv.metrics.en12299 import (
    COMFORT_BLOCK,
    MEAN_COMFORT_BLOCKS,
    WEIGHTING_NAMES,
    continuous_comfort,
    frequency_weighting,
    mean_comfort,
    weighted,
    weighting_filter,
)
from railenv.metrics.ride_index import (
    SPERLING_BAND,
    SPERLING_SEGMENT,
    grade,
    sperling,
    sperling_filter,
    sperling_original,
    sperling_segments,
    weighting,
)
from railenv.metrics.sampling import WINDOW_NAMES

__all__ = [
    "COMFORT_BLOCK",
    "MEAN_COMFORT_BLOCKS",
    "SPERLING_BAND",
    "SPERLING_SEGMENT",
    "WEIGHTING_NAMES",
    "WINDOW_NAMES",
    "continuous_comfort",
    "frequency_weighting",
    "grade",
    "mean_comfort",
    "peak",
    "percentile_abs",
    "rms",
    "sperling",
    "sperling_filter",
    "sperling_original",
    "sperling_segments",
    "weighted",
    "weighting",
    "weighting_filter",
]
