"""Sky-hook by semi-active dampers: what the laws command, and how they are run and judged."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.controller import Controller
from baselines.semi_active import (
    SEMIACTIVE_ONOFF,
    SEMIACTIVE_SKYHOOK,
    OnOffSkyHook,
    SemiActiveLaw,
    SemiActiveSkyHook,
)
from eval.delay_probe import Probe
from eval.delay_sweep import simulated_critical_delay
from eval.rollout import ControlledBatch, Stepping, rollout
from eval.simulations import SemiActiveRuns, simulation_of
from railenv.actuation import ActuatorSpec, SemiActiveDamper
from railenv.errors import ArgumentError
from railenv.simulation import required_length
from railenv.track import make_track
from railenv.vehicle import LateralVehicle, lateral17, state_space
from railenv.vehicle.nonlinear import full50

Array = NDArray[np.float64]

DAMPER = SemiActiveDamper(5e3, 30e3, 0.01)


def observed(law: SemiActiveLaw, velocity: list[float], rate: list[float]) -> Array:
    """Observation of one lane with some velocities and measured stroke rates at the places."""
    columns = np.zeros((1, len(law.measures) + 3))
    columns[0, law.columns("carbody_lateral_velocity")] = velocity
    columns[0, law.columns("suspension_stroke_rate")] = rate
    return columns


def german_low(controller: Controller, delay: float, duration: float = 5.0) -> Array:
    """Accelerations, forces, stroke rates and coefficients of two lanes, (2, steps, 16)."""
    vehicle = lateral17("paper_fit", 4, 300.0)
    length = required_length(vehicle, duration + 1.0)
    tracks = tuple(make_track("german_low", length, seed) for seed in (0, 1))
    parts = ("actuator_force", "suspension_stroke_rate", "damping_coefficient")
    floors = ("floor_front_lateral_acceleration", "floor_rear_lateral_acceleration")
    names = tuple(f"{part}_{k}" for part in parts for k in (1, 2, 3, 4))
    return rollout(
        controller,
        vehicle,
        np.full((2, 4), delay),
        duration,
        tracks=tracks,
        track_of_lane=np.array([0, 1]),
        record=(*floors, *names),
    ).values


def test_the_on_off_law_is_stiff_where_it_resists_the_carbody_only() -> None:
    law = OnOffSkyHook(DAMPER, 4, "measured")
    law.reset(1, 0)
    actions = law.act(observed(law, [0.1, 0.1, -0.1, -0.1], [1.0, -1.0, 1.0, -1.0]))
    np.testing.assert_array_equal(law.action_scale * actions, [[30e3, 5e3, 5e3, 30e3]])


def test_the_continuous_law_gives_the_force_of_the_skyhook_within_the_range() -> None:
    law = SemiActiveSkyHook(20e3, DAMPER, 4, "measured")
    law.reset(1, 0)
    velocity, rate = [0.05, -0.05, 0.05, 0.05], [0.1, -0.2, 0.01, -0.1]
    coefficients = law.action_scale * law.act(observed(law, velocity, rate))
    # 20 kN s/m times 0.05 m/s over 0.1, then 0.2 m/s: 10 kN s/m, and 5; beyond the range; pushing.
    # rounding of a quotient and of the scale
    np.testing.assert_allclose(coefficients, [[10e3, 5e3, 30e3, 5e3]], rtol=1e-15)


def test_a_carbody_at_rest_meets_the_softest_damper() -> None:
    for law in (OnOffSkyHook(DAMPER, 2, "measured"), SemiActiveSkyHook(3e4, DAMPER, 2, "measured")):
        law.reset(1, 0)
        still = law.action_scale * law.act(observed(law, [0.0, 0.1], [0.3, 0.0]))
        np.testing.assert_array_equal(still, [[5e3, 5e3]])


def test_the_rate_of_a_stroke_is_its_filtered_difference() -> None:
    law = OnOffSkyHook(DAMPER, 4, "stroke", difference_time=0.02)
    law.reset(1, 0)
    columns = np.zeros((1, len(law.measures)))
    found = []
    for k in range(20):
        columns[0, law.columns("suspension_stroke")] = 0.3 * 0.01 * k
        found.append(law.stroke_rates(columns)[0])
    time = 0.01 * np.arange(20)[:, None]
    # a ramp that begins at the first sample, through T r' + r = s'; twenty roundings
    expected = np.broadcast_to(0.3 * (1.0 - np.exp(-time / 0.02)), (20, 4))
    np.testing.assert_allclose(found, expected, rtol=1e-13, atol=1e-15)


def test_a_law_on_strokes_needs_the_standard_sensors_only() -> None:
    assert not any("stroke_rate" in name for name in OnOffSkyHook(DAMPER, 4).measures)
    assert "suspension_stroke_rate_3" in OnOffSkyHook(DAMPER, 4, "measured").measures


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"layout": "passive"}, "no place for a semi-active damper"),
        ({"rate": "guessed"}, "unknown rate 'guessed'"),
        ({"difference_time": 0.0}, "difference_time = 0 must be above zero"),
        ({"gain": -1.0}, "gain = -1 must not be negative"),
    ],
)
def test_a_law_that_cannot_be_is_refused(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ArgumentError, match=message):
        SemiActiveSkyHook(**{"gain": 35e3, "damper": DAMPER, **settings})


def test_a_law_that_was_not_reset_says_so() -> None:
    with pytest.raises(ArgumentError, match="call reset"):
        OnOffSkyHook(DAMPER).act(np.zeros((3, 30)))


def test_a_closed_loop_takes_energy_out_at_every_sample_in_every_lane() -> None:
    for law in (OnOffSkyHook(DAMPER), SemiActiveSkyHook(35e3, DAMPER)):
        values = german_low(law, 0.0371)
        force, rate, coefficient = values[:, :, 2:6], values[:, :, 6:10], values[:, :, 10:]
        assert np.all(force * rate <= 0.0)
        assert np.array_equal(force, -coefficient * rate)
        # the law is at work: its coefficients reach the lower and come near the upper end
        assert coefficient.min() < 5.1e3
        assert coefficient.max() > 25e3


def test_dampers_without_a_range_make_every_law_the_same_passive_vehicle() -> None:
    fixed = SemiActiveDamper(12e3, 12e3, 0.01)
    runs = [
        german_low(law, delay)
        for law, delay in (
            (OnOffSkyHook(fixed), 0.0),
            (SemiActiveSkyHook(35e3, fixed), 0.0371),
            (SemiActiveSkyHook(0.0, fixed, 4, "measured"), 0.3),
        )
    ]
    assert np.all(runs[0][:, :, 10:] == 12e3)
    assert np.array_equal(runs[0], runs[1])
    assert np.array_equal(runs[0], runs[2])


def test_a_lane_of_a_closed_loop_does_not_depend_on_its_neighbours(
    vehicle: LateralVehicle,
) -> None:
    track = make_track("german_low", required_length(vehicle, 3.0), 0)
    delays = np.repeat(np.array([[0.0], [0.013], [0.05]]), 4, axis=1)
    law = SemiActiveSkyHook(35e3, DAMPER)
    together = rollout(law, vehicle, delays, 2.0, tracks=(track,)).values
    alone = rollout(law, vehicle, delays[1:2], 2.0, tracks=(track,)).values
    assert np.array_equal(alone[0], together[1])


def test_entries_build_their_laws_for_the_layout_of_the_run(vehicle: LateralVehicle) -> None:
    for entry in (SEMIACTIVE_ONOFF, SEMIACTIVE_SKYHOOK):
        values = {key: default for key, (default, _) in entry.settings.items()}
        values |= {"lowest": 1e3, "highest": 20e3, "response_time": 0.005}
        law: Any = entry.build(lateral17("paper_fit", 2, 300.0), **values)
        assert law.damper == SemiActiveDamper(1e3, 20e3, 0.005)
        assert law.layout == "2"
        assert not hasattr(law, "to_delay_system")
        law = entry.build(vehicle, **{**values, "rate": "measured"})
        assert (law.layout, law.rate) == ("4", "measured")


def test_a_controller_with_a_damper_is_run_on_dampers(vehicle: LateralVehicle) -> None:
    batch = ControlledBatch(OnOffSkyHook(DAMPER), vehicle, ("carbody_lateral",), Stepping())
    assert isinstance(batch.simulation, SemiActiveRuns)
    assert batch.simulation.damper == DAMPER


STEP: dict[str, Any] = {"actuator": ActuatorSpec(), "control_period": 0.01, "time_step": 0.005}


def test_dampers_are_for_the_linear_vehicle_only() -> None:
    with pytest.raises(ArgumentError, match="only the linear vehicle has"):
        simulation_of(full50(layout=4, speed_kmh=300.0), (), damper=DAMPER, **STEP)


def test_dampers_have_no_lag_and_no_limit_on_their_rate(vehicle: LateralVehicle) -> None:
    for actuator in (ActuatorSpec(lag=0.02), ActuatorSpec(rate_limit=1e5)):
        with pytest.raises(ArgumentError, match="response_time"):
            simulation_of(vehicle, (), damper=DAMPER, **{**STEP, "actuator": actuator})


def test_what_is_no_damper_is_named(vehicle: LateralVehicle) -> None:
    law: Any = OnOffSkyHook(DAMPER)
    law.damper = 15e3
    with pytest.raises(ArgumentError, match=r"damper = 15000\.0 is no SemiActiveDamper"):
        ControlledBatch(law, vehicle, (), Stepping())


def test_a_semi_active_loop_is_not_called_unstable_for_its_large_commands(
    vehicle: LateralVehicle,
) -> None:
    # Commands of 60 kN s/m are far above the force limit of 30 kN, as numbers.
    law = OnOffSkyHook(SemiActiveDamper(5e3, 60e3))
    answer = simulated_critical_delay(law, vehicle, max_delay=0.04)
    assert answer["critical_delay_sampled_s"] is None
    assert answer["crossings"] == []


@pytest.mark.parametrize(("coefficient", "stable"), [(15e3, False), (30e3, True)])
@pytest.mark.slow
def test_the_probe_tells_dampers_that_hold_the_hunting_from_those_that_do_not(
    coefficient: float, stable: bool
) -> None:
    # At 400 km/h the abscissa with dashpots is +0.07 1/s at 15 kN s/m, -0.23 1/s at 30 kN s/m.
    fast = lateral17("paper_fit", 4, 400.0)
    system = state_space(fast)
    rows, _ = system.output_rows(tuple(f"suspension_stroke_rate_{k}" for k in (1, 2, 3, 4)))
    A = system.A - coefficient * system.actuator_input @ rows
    assert (np.linalg.eigvals(A).real.max() < 0.0) == stable
    law = OnOffSkyHook(SemiActiveDamper(coefficient, coefficient))
    probe = Probe(law, fast, Stepping(), "tb3352", 0)
    assert probe.stable(np.array([0.0])).tolist() == [stable]
