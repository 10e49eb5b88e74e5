"""Random vehicles: what a draw depends on, that every one runs straight, what ranges do."""

import dataclasses
import itertools
import math
from collections.abc import Callable

import numpy as np
import pytest
from scipy.stats import kstest

from railenv.errors import ArgumentError
from railenv.vehicle import LateralVehicle, VehicleParameters, get_vehicle, lateral17, state_space
from railenv.vehicle.randomisation import (
    LEAST_DAMPING,
    NAMED_RANGES,
    VehicleRanges,
    draw_vehicles,
    get_ranges,
)

PAPER = get_vehicle("paper_fit").parameters
BASES = [PAPER, get_vehicle("published_typical").parameters]
FIELDS = [field.name for field in dataclasses.fields(VehicleRanges)]
FACTORS = [name for name in FIELDS if name not in ("conicity", "speed_kmh")]


def draw(ranges: VehicleRanges, number: int = 8, seed: int = 3, **other: object):
    settings = {"base": PAPER, "layout": 4, "speed_kmh": 300.0} | other
    return draw_vehicles(ranges=ranges, number=number, seed=seed, **settings)


def fixed(base: VehicleParameters = PAPER, speed_kmh: float = 300.0, **values: float):
    """The passive vehicle at one point of the ranges."""
    ranges = VehicleRanges(**{name: (value, value) for name, value in values.items()})
    (vehicle,) = draw(ranges, layout="passive", base=base, speed_kmh=speed_kmh)
    return vehicle


def roots_of(vehicle: LateralVehicle) -> np.ndarray:
    """Roots of the passive form."""
    passive = LateralVehicle(vehicle.parameters, "passive", vehicle.speed)
    return np.linalg.eigvals(state_space(passive).A)


def least_damping(roots: np.ndarray) -> float:
    return float(np.min(-roots.real / np.abs(roots)))


def slow_modes(vehicle: LateralVehicle, number: int) -> np.ndarray:
    """The slowest oscillating roots, upper half plane, by rising magnitude."""
    roots = roots_of(vehicle)
    oscillating = roots[roots.imag > 1e-6 * np.abs(roots)]
    return oscillating[np.argsort(np.abs(oscillating))][:number]


def same(first: LateralVehicle, second: LateralVehicle) -> bool:
    return first.parameters == second.parameters and first.speed == second.speed


# What a draw depends on.


def test_first_vehicles_of_a_larger_draw_are_those_of_a_smaller_one():
    ranges = get_ranges("wide")
    few, many = draw(ranges, 16), draw(ranges, 64)
    assert len(few) == 16
    assert len(many) == 64
    assert all(same(a, b) for a, b in zip(few, many, strict=False))


def test_same_seed_draws_the_same_and_another_seed_all_others():
    ranges = get_ranges("wide")
    first, again, other = draw(ranges), draw(ranges), draw(ranges, seed=4)
    assert all(same(a, b) for a, b in zip(first, again, strict=True))
    assert not any(same(a, b) for a in first for b in other)


def test_changing_one_range_does_not_change_what_others_draw():
    wide = get_ranges("wide")
    narrowed = dataclasses.replace(wide, load=(1.0, 1.0), conicity=None)
    for a, b in zip(draw(wide), draw(narrowed), strict=True):
        assert a.parameters.creep_lateral == b.parameters.creep_lateral
        assert a.parameters.primary_lateral_stiffness == b.parameters.primary_lateral_stiffness
        assert a.speed == b.speed
        assert b.parameters.carbody_mass == PAPER.carbody_mass
        assert b.parameters.conicity == PAPER.conicity


@pytest.mark.parametrize("layout", ["passive", 2, 4])
def test_layout_changes_nothing_but_the_layout(layout):
    for a, b in zip(draw(get_ranges("wide"), layout=layout), draw(get_ranges("wide")), strict=True):
        assert a.layout == str(layout)
        assert same(a, b)


def test_draws_are_uniform_and_independent():
    ranges = VehicleRanges(load=(1.0, 1.2), conicity=(0.1, 0.2), speed_kmh=(200.0, 300.0))
    vehicles = draw(ranges, 400)
    shares = np.array(
        [
            (
                (v.parameters.carbody_mass / PAPER.carbody_mass - 1.0) / 0.2,
                (v.parameters.conicity - 0.1) / 0.1,
                (3.6 * v.speed - 200.0) / 100.0,
            )
            for v in vehicles
        ]
    )
    for column in shares.T:
        # fixed seed; a right sampler would fail by chance once in a hundred seeds
        assert kstest(column, "uniform").pvalue > 0.01
    # three standard deviations of a correlation of 400 independent pairs, 1 / 20 each
    assert np.abs(np.corrcoef(shares.T) - np.eye(3)).max() < 0.15


def test_ranges_without_width_give_one_vehicle_whatever_the_number():
    (vehicle,) = draw(get_ranges("none"), number=64)
    assert vehicle.parameters == PAPER
    assert vehicle.speed == lateral17().speed
    (heavy,) = draw(VehicleRanges(load=(1.1, 1.1), speed_kmh=(250.0, 250.0)), number=64)
    assert heavy.parameters.carbody_mass == 1.1 * PAPER.carbody_mass
    assert heavy.speed == 250.0 / 3.6


# What a range does.


@pytest.mark.parametrize(
    ("factor", "prefix", "members"),
    [
        ("load", "carbody_", {"mass", "yaw_inertia", "roll_inertia"}),
        ("primary_damping", "primary_", {"lateral_damping", "vertical_damping"}),
        ("secondary_damping", "secondary_", {"lateral_damping", "vertical_damping"}),
        ("yaw_damper", "yaw_damper_", {"stiffness", "damping"}),
        ("lateral_damper", "lateral_damper_", {"stiffness", "damping"}),
        ("creep", "creep_", {"longitudinal", "lateral", "lateral_spin", "spin"}),
        (
            "primary_stiffness",
            "primary_",
            {"longitudinal_stiffness", "lateral_stiffness", "vertical_stiffness"},
        ),
        (
            "secondary_stiffness",
            "secondary_",
            {"longitudinal_stiffness", "lateral_stiffness", "vertical_stiffness"},
        ),
    ],
)
def test_factor_multiplies_its_own_parameters_and_no_other(factor, prefix, members):
    # A base without zeros, which no factor would show on.
    base = PAPER.replace(primary_lateral_damping=1e3, secondary_lateral_damping=2e3)
    changed = fixed(base, **{factor: 1.1}).parameters
    expected = {prefix + member for member in members}
    expected |= {"antiroll_stiffness"} if factor == "secondary_stiffness" else set()
    for field in dataclasses.fields(base):
        ratio = getattr(changed, field.name) / getattr(base, field.name)
        assert ratio == pytest.approx(1.1 if field.name in expected else 1.0, rel=1e-15)


def test_load_slows_the_carbody_by_its_square_root():
    # Sway, yaw and upper roll: carbody on springs that stay as they are. The ratio is not exact,
    # since the bogies' masses and the gravitational stiffness do not follow: below 1 % here.
    empty, full = slow_modes(fixed(), 3), slow_modes(fixed(load=1.25), 3)
    ratio = np.abs(full) / np.abs(empty)
    np.testing.assert_allclose(ratio, 1.0 / math.sqrt(1.25), rtol=0.01)


def test_load_presses_on_all_axles_alike():
    more = fixed(load=1.2).parameters.axle_load - PAPER.axle_load
    assert more == pytest.approx(0.2 * PAPER.carbody_mass * 9.80665 / 4, rel=1e-9)  # rounding


@pytest.mark.parametrize("conicity", [0.1, 0.17, 0.25])
def test_bogie_hunts_at_the_klingel_wavelength_of_its_conicity(conicity):
    vehicle = fixed(conicity=conicity, speed_kmh=5.0)
    roots = slow_modes(vehicle, 2)  # both bogies; the bodies are above 0.5 Hz
    wavelength = 2.0 * np.pi * vehicle.speed / roots.imag
    p = vehicle.parameters
    # Klingel's wavelength, lengthened by the wheelbase of a rigid bogie (Heumann).
    single = 2.0 * np.pi * math.sqrt(p.wheel_radius * p.half_contact_spacing / conicity)
    rigid = single * math.hypot(1.0, p.half_wheelbase / p.half_contact_spacing)
    # Measured 1.3 to 2.6 % short: the primary springs give, more at a higher conicity (0.6 to
    # 1.6 %, nothing with rigid ones), and the springs to the carbody hold the bogie (1 %).
    np.testing.assert_allclose(wavelength, rigid, rtol=0.03)


def test_stiffer_primary_springs_raise_the_fastest_oscillation_by_their_square_root():
    # Wheelset yaw on the longitudinal primary springs, some 110 Hz; inertia is the wheelset's and,
    # hardly, the frame's. 1 %: creep damping shifts the frequency by the square of its ratio.
    frequency = [roots_of(fixed(primary_stiffness=f)).imag.max() for f in (0.9, 1.1)]
    assert frequency[1] / frequency[0] == pytest.approx(math.sqrt(1.1 / 0.9), rel=0.01)


def test_worn_dampers_damp_the_carbody_less():
    # Upper roll is what the lateral dampers see most of; the series spring is far stiffer.
    ratios = [
        -s.real / abs(s) for s in (slow_modes(fixed(lateral_damper=f), 3)[2] for f in (0.7, 1.3))
    ]
    assert ratios[0] < 0.9 * ratios[1]


# That every draw runs straight.


def check_all(vehicles: list[LateralVehicle]) -> tuple[float, float]:
    """Rightmost root and least damping ratio over vehicles."""
    roots = np.array([roots_of(vehicle) for vehicle in vehicles])
    return float(roots.real.max()), least_damping(roots)


@pytest.mark.slow
@pytest.mark.parametrize("base", BASES)
def test_two_hundred_wide_draws_are_sound(base):
    rightmost, least = check_all(draw(get_ranges("wide"), 200, seed=11, base=base))
    assert rightmost < -0.1
    assert least > 0.025  # what the corners of the box have; the rule asks for 0.005


@pytest.mark.slow
@pytest.mark.parametrize("base", BASES)
def test_two_thousand_wide_draws_are_sound(base, record_property: Callable[[str, object], None]):
    rightmost, least = check_all(draw(get_ranges("wide"), 2000, seed=12, base=base))
    record_property("printed", f"rightmost {rightmost:.3f} 1/s, least damping ratio {least:.4f}")
    assert rightmost < -0.1
    assert least > 0.025


def corners(name: str, base: VehicleParameters, speed_kmh: float, keep: set[str]):
    """Vehicles at the corners of named ranges; ranges not kept stand at their middle."""
    ranges = get_ranges(name)
    given = [f for f in FIELDS if getattr(ranges, f) is not None and f in keep]
    for ends in itertools.product((0, 1), repeat=len(given)):
        point = {
            f: (sum(r) / 2,) * 2
            for f in FIELDS
            if (r := getattr(ranges, f)) is not None and f not in given
        }
        for f, end in zip(given, ends, strict=True):
            point[f] = (getattr(ranges, f)[end],) * 2
        yield draw(VehicleRanges(**point), base=base, speed_kmh=speed_kmh)[0]


HUNTING = {"creep", "conicity", "yaw_damper", "primary_stiffness", "speed_kmh"}


@pytest.mark.parametrize(
    ("name", "speed", "ratio"), [("wide", 300.0, 0.03), ("narrow", 350.0, 0.015)]
)
def test_corners_of_what_decides_on_hunting_are_sound(name, speed, ratio):
    rightmost, least = check_all(list(corners(name, PAPER, speed, HUNTING)))
    assert rightmost < -0.1
    assert least > ratio  # measured 0.033 and 0.016


@pytest.mark.slow
@pytest.mark.parametrize("base", BASES)
@pytest.mark.parametrize(("name", "ratio"), [("wide", 0.025), ("narrow", 0.052)])
def test_all_corners_of_the_box_are_sound(
    base, name, ratio, record_property: Callable[[str, object], None]
):
    rightmost, least = check_all(list(corners(name, base, 300.0, set(FIELDS))))
    record_property("printed", f"rightmost {rightmost:.3f} 1/s, least damping ratio {least:.4f}")
    assert rightmost < -0.1
    assert least > ratio  # measured 0.0251 (hunting) and 0.0526 (wheelset yaw, 111 Hz)


def test_narrow_lies_inside_wide_and_none_inside_narrow():
    narrow, wide = get_ranges("narrow"), get_ranges("wide")
    for name in [*FACTORS, "conicity"]:
        inner, outer = getattr(narrow, name), getattr(wide, name)
        assert outer[0] <= inner[0] <= inner[1] <= outer[1]
        middle = PAPER.conicity if name == "conicity" else 1.0
        assert inner[0] <= middle <= inner[1]
    assert narrow.speed_kmh is None


# What is refused.


def test_vehicle_that_hunts_is_refused_with_its_point_the_rule_and_the_way_out():
    # The linear critical speed is 340 km/h at conicity 0.3.
    with pytest.raises(ArgumentError) as caught:
        draw(VehicleRanges(load=(1.01, 1.09), conicity=(0.3, 0.309)), speed_kmh=360.0)
    message = str(caught.value)
    assert message.startswith("vehicle 0 of the draw (load 1.0")
    for part in ("creep 1,", "conicity 0.30", "speed_kmh 360", "above 0.005", "narrow"):
        assert part in message


def test_refused_vehicle_is_one_whose_passive_form_hunts_though_the_layout_is_another():
    unstable = PAPER.replace(creep_lateral=0.6 * PAPER.creep_lateral)
    assert least_damping(roots_of(lateral17(unstable, 4, 300.0))) < 0.0
    with pytest.raises(ArgumentError, match=r"root at \d.* \+\d.*i 1/s"):
        draw(VehicleRanges(), base=unstable)
    assert draw(VehicleRanges(), base=unstable, speed_kmh=200.0)


def test_margin_refuses_a_vehicle_just_below_its_critical_speed():
    # About 400 km/h at conicity 0.17; the base is still stable at 399 km/h.
    roots = roots_of(lateral17(PAPER, "passive", 399.0))
    assert 0.0 < least_damping(roots) < LEAST_DAMPING
    with pytest.raises(ArgumentError, match=r"root at -0\.0"):
        draw(VehicleRanges(), speed_kmh=399.0)


def test_vehicle_that_drifts_for_want_of_conicity_is_refused():
    with pytest.raises(ArgumentError, match="drifts"):
        draw(VehicleRanges(), base=PAPER.replace(conicity=0.0))


@pytest.mark.parametrize("speed_kmh", [1.0, 10.0, 50.0, 150.0, 350.0])
@pytest.mark.parametrize("base", BASES)
def test_base_vehicles_are_sound_from_walking_pace_on(base, speed_kmh):
    assert len(draw(VehicleRanges(), base=base, speed_kmh=speed_kmh)) == 1


@pytest.mark.parametrize("name", FIELDS)
@pytest.mark.parametrize(
    "bad",
    [(1.1, 1.0), (0.0, 1.0), (-1.0, 1.0), (1.0, math.inf), (math.nan, 1.0), (1.0,), 1.0, "ab"],
)
def test_range_that_is_none_is_refused_by_name(name, bad):
    with pytest.raises(ArgumentError, match=f"^{name}"):
        VehicleRanges(**{name: bad})


@pytest.mark.parametrize("name", FACTORS)
def test_factor_may_not_be_none(name):
    with pytest.raises(ArgumentError, match=f"^{name} = None"):
        VehicleRanges(**{name: None})


def test_list_of_two_is_taken_as_a_range():
    assert VehicleRanges(load=[1, 1.2]).load == (1.0, 1.2)  # as a configuration file has it


@pytest.mark.parametrize(
    ("name", "bad"),
    [("number", 0), ("number", 2.5), ("seed", -1), ("speed_kmh", 0.0), ("layout", 3)],
)
def test_bad_argument_is_refused_by_name(name, bad):
    with pytest.raises(ArgumentError, match=name):
        draw(get_ranges("wide"), **{name: bad})


def test_unknown_ranges_are_refused_with_the_nearest():
    with pytest.raises(ArgumentError, match="did you mean 'narrow'"):
        get_ranges("narow")
    assert set(NAMED_RANGES) == {"none", "narrow", "wide"}
