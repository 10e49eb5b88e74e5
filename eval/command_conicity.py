"""`railenv conicity`: equivalent conicity of a wheel profile on a rail profile."""

import argparse
from pathlib import Path
from typing import Any

import numpy as np

from eval.arguments import parse_number, parse_output, print_json
from eval.chart_plot import check_drawing
from eval.conicity_plot import plot_conicity
from railenv.contact.conicity import Conicity, conicity
from railenv.contact.geometry import WheelRail, rolling_radius_difference
from railenv.contact.profile_file import read_profile
from railenv.contact.profiles import Profile, get_profile, profile_names
from railenv.errors import ArgumentError, check_not_negative, check_positive, unknown_name
from railenv.units import FloatArray

_FEWEST_CANT = 5.0
_PRINTED_STEP = 1e-4


def command_conicity(options: argparse.Namespace) -> None:
    """Compute the equivalent conicity, print it and draw it."""
    amplitudes = [1e-3 * _positive("amplitudes", text) for text in options.amplitudes.split(",")]
    plot = parse_output(options.plot, (".png", ".svg", ".pdf"))
    if plot is not None:
        check_drawing()
    pair = WheelRail(
        _profile(options, "wheel"),
        _profile(options, "rail"),
        wheel_radius=1e-3 * _positive("radius_mm", options.radius_mm),
        back_to_back=1e-3 * _positive("back_to_back_mm", options.back_to_back_mm),
        gauge=1e-3 * _positive("gauge_mm", options.gauge_mm),
        gauge_depth=1e-3 * _positive("gauge_depth_mm", options.gauge_depth_mm),
        cant=_cant(options.cant),
    )
    found = conicity(pair, amplitudes)
    if plot is not None:
        plot_conicity(pair, found, plot, _title(options))
    if options.json:
        print_json(_record(options, pair, found))
    else:
        _print(options, pair, found)
        if plot is not None:
            print(f"  written: {plot}")


def _positive(name: str, text: str) -> float:
    return check_positive(name, parse_number(name, text))


def _cant(text: str) -> float:
    """Return the tangent of the rails' inclination from 40 or 1:40; 0 stands for upright."""
    number = check_not_negative("cant", parse_number("cant", text.removeprefix("1:")))
    if 0.0 < number < _FEWEST_CANT:
        raise ArgumentError(
            f"cant = {text!r} is steeper than 1:{_FEWEST_CANT:g}; give 40 for 1:40, 0 for upright"
        )
    return 1.0 / number if number else 0.0


def _profile(options: argparse.Namespace, kind: str) -> Profile:
    """Return a profile of the catalogue or of a file; a catalogue's name wins over a file's."""
    text: str = getattr(options, kind)
    families = ("cone:", "arc:")
    if text in profile_names("wheel") + profile_names("rail") or text.startswith(families):
        return get_profile(text)
    try:
        is_file = bool(Path(text).suffix) or Path(text).exists()
    except (OSError, ValueError):  # too long for a path, or a null character in it
        is_file = False
    if not is_file:
        known = unknown_name(kind, text[:60], profile_names(kind))
        raise ArgumentError(f"{known}; or give the path of a file of points")
    tolerance = check_not_negative(
        "tolerance_um", parse_number("tolerance_um", options.tolerance_um)
    )
    return read_profile(text, kind, unit=options.unit, tolerance=1e-6 * tolerance)


def _title(options: argparse.Namespace) -> str:
    cant = options.cant.removeprefix("1:")
    inclination = "rails upright" if float(cant) == 0.0 else f"cant 1:{cant}"
    return (
        f"{_name(options.wheel)} on {_name(options.rail)}, gauge {options.gauge_mm} mm "
        f"({options.gauge_depth_mm} mm below the crown), "
        f"back to back {options.back_to_back_mm} mm, {inclination}, radius {options.radius_mm} mm"
    )


def _name(text: str) -> str:
    return Path(text).name


def _record(options: argparse.Namespace, pair: WheelRail, found: Conicity) -> dict[str, Any]:
    """Return the result in plain values; null where no periodic motion exists."""
    keep = slice(None, None, round(_PRINTED_STEP / float(found.shift[1] - found.shift[0])))
    half = len(found.shift) // 2
    return {
        "wheel": options.wheel,
        "rail": options.rail,
        "gauge_m": pair.gauge,
        "gauge_depth_m": pair.gauge_depth,
        "back_to_back_m": pair.back_to_back,
        "cant": pair.cant,
        "wheel_radius_m": pair.wheel_radius,
        "wheel_smoothing_m": pair.wheel.smoothing,
        "rail_smoothing_m": pair.rail.smoothing,
        "amplitude_m": found.amplitude.tolist(),
        "conicity": _nullable(found.conicity),
        "wavelength_m": _nullable(found.wavelength),
        "shift_m": found.shift[half:][keep].tolist(),
        "rolling_radius_difference_m": found.difference[half:][keep].tolist(),
    }


def _nullable(values: FloatArray) -> list[float | None]:
    return [value if np.isfinite(value) else None for value in values.tolist()]


def _print(options: argparse.Namespace, pair: WheelRail, found: Conicity) -> None:
    difference = rolling_radius_difference(pair, found.amplitude)
    print(_title(options))
    for label, values, digits in (
        ("amplitude, shift [mm]", 1e3 * found.amplitude, "g"),
        ("equivalent conicity", found.conicity, ".3f"),
        ("wavelength [m]", found.wavelength, ".2f"),
        ("radius difference [mm]", 1e3 * difference, ".3f"),
    ):
        cells = [f"{value:{digits}}" if np.isfinite(value) else "-" for value in values]
        print(f"  {label:<24}" + "".join(f"{cell:>8}" for cell in cells))
    if not bool(np.isfinite(found.conicity).all()):
        print("  -: no periodic motion of this amplitude exists")
    for profile in (pair.wheel, pair.rail):
        if profile.smoothing > 0.0:
            print(
                f"  {profile.name}: smoothed, points at most {1e6 * profile.smoothing:.1f} "
                "micrometres off"
            )
