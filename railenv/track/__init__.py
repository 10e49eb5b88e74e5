"""The track: spectra of its irregularity, random realisations of them, and measured records."""

from railenv.track.irregularity import Track, flat, make_track, read_csv, realise
from railenv.track.spectra import (
    CHANNELS,
    Spectrum,
    fra,
    german_high,
    german_low,
    get_spectrum,
    percentile_level,
    spectrum_names,
    tb3352_ballastless,
)

__all__ = [
    "CHANNELS",
    "Spectrum",
    "Track",
    "flat",
    "fra",
    "german_high",
    "german_low",
    "get_spectrum",
    "make_track",
    "percentile_level",
    "read_csv",
    "realise",
    "spectrum_names",
    "tb3352_ballastless",
]
