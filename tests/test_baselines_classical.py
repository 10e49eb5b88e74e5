"""Static classical laws, ground-hook, mixed hook, relative damping; and every entry's manners."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from baselines import LinearDynamic, LinearFeedback, SkyHook, Zero, load_policy, save_policy
from baselines.groundhook import GROUNDHOOK, GroundHook
from baselines.lead import SKYHOOK_LEAD
from baselines.mixedhook import MIXEDHOOK, MixedHook
from baselines.pid import PID
from baselines.registered import Registered
from baselines.relative import RELATIVE, FilteredRelativeDamping, RelativeDamping
from baselines.skyhook import SKYHOOK, SKYHOOK_ACCELEROMETER
from railenv.errors import ArgumentError
from railenv.stability import critical_delays, rightmost_roots
from railenv.vehicle import LateralVehicle, lateral17, state_space
from railenv.vehicle.coordinates import (
    NUM_COORDINATES,
    actuator_positions,
    bogie_of_position,
    end_sign,
    lateral_of_point,
)

ENTRIES = (SKYHOOK, SKYHOOK_ACCELEROMETER, SKYHOOK_LEAD, GROUNDHOOK, MIXEDHOOK, RELATIVE, PID)

CROSSES_NOWHERE = {("groundhook", 2), ("groundhook", 4), ("relative", 2)}
"""What two seconds of delay do not make unstable: its small gain, or the dampers that stay."""


def built(entry: Registered, vehicle: LateralVehicle, **settings: float) -> Any:
    """The entry's controller with its default settings, apart from those given."""
    values = {key: default for key, (default, _) in entry.settings.items()}
    return entry.build(vehicle, **(values | settings))


def motion(vehicle: LateralVehicle, lanes: int = 50) -> np.ndarray:
    """Random states of the vehicle, shape (lanes, states)."""
    states = len(state_space(vehicle).states)
    return np.random.default_rng(3).normal(size=(lanes, states))


def forces(controller: LinearFeedback, vehicle: LateralVehicle, states: np.ndarray) -> np.ndarray:
    """Forces on the carbody that a static law asks for in these states, shape (lanes, channels)."""
    C, _ = state_space(vehicle).output_rows(controller.measures)
    return controller.action_scale * controller.act(states @ C.T)


def bogie_velocities(vehicle: LateralVehicle, states: np.ndarray) -> np.ndarray:
    """Lateral velocities of the frames where the actuators hold them, shape (lanes, channels)."""
    p = vehicle.parameters
    rows = [
        lateral_of_point(
            f"bogie{bogie_of_position(k)}", end_sign(k) * p.damper_offset, p.bogie_to_damper_height
        )
        for k in actuator_positions(vehicle.layout)
    ]
    return states[:, NUM_COORDINATES : 2 * NUM_COORDINATES] @ np.array(rows).T


def with_dampers(vehicle: LateralVehicle, damping: float, stiffness: float) -> LateralVehicle:
    """The passive vehicle with other lateral dampers."""
    changed = replace(
        vehicle.parameters, lateral_damper_damping=damping, lateral_damper_stiffness=stiffness
    )
    return LateralVehicle(changed, "passive", vehicle.speed)


def sorted_roots(matrix: np.ndarray, count: int) -> np.ndarray:
    """The rightmost eigenvalues with no negative imaginary part."""
    roots = np.linalg.eigvals(matrix)
    roots = roots[roots.imag >= 0.0]
    return roots[np.argsort(-roots.real)][:count]


@pytest.mark.parametrize("layout", [2, 4])
def test_ground_hook_resists_the_frames_velocity_at_each_actuator(layout: int) -> None:
    vehicle = lateral17(layout=layout)
    states = motion(vehicle)
    # the frame feels the force with the opposite sign; a difference of velocities loses some digits
    on_frame = -forces(GroundHook(7e3, layout), vehicle, states)
    np.testing.assert_allclose(on_frame, -7e3 * bogie_velocities(vehicle, states), atol=1e-9)


def test_ground_hook_damps_the_hunting_of_the_frames(vehicle: LateralVehicle) -> None:
    def hunting(controller) -> list[float]:
        roots = rightmost_roots(controller.to_delay_system(vehicle), 0.0, 12)
        found = [m.root for m in roots if 3.4 < m.root.imag / (2 * np.pi) < 4.0]
        return sorted(-s.real / abs(s) for s in found)

    without, held = hunting(Zero(4)), hunting(GroundHook(5e3, 4))
    assert len(without) == len(held) == 2  # front and rear bogie
    assert min(held) > max(without)


@pytest.mark.parametrize(("speed", "limit"), [(150.0, 2.87e3), (200.0, 4.55e3), (300.0, 6.14e3)])
def test_ground_hook_alone_makes_the_carbody_unstable_beyond_the_stated_gain(
    speed: float, limit: float
) -> None:
    vehicle = lateral17("paper_fit", 4, speed)
    rates = [
        np.linalg.eigvals(GroundHook(c, 4).to_delay_system(vehicle).undelayed).real.max()
        for c in (0.99 * limit, 1.01 * limit)
    ]
    assert rates[0] < 0.0 < rates[1]


def test_the_mixed_hook_with_one_coefficient_is_the_law_of_that_name() -> None:
    vehicle = lateral17(layout=2)
    states = motion(vehicle)
    for mixed, alone in (
        (MixedHook(20e3, 0.0, 0.0, 2), SkyHook(20e3, 2)),
        (MixedHook(0.0, 8e3, 0.0, 2), GroundHook(8e3, 2)),
        (MixedHook(0.0, 0.0, 15e3, 2), RelativeDamping(15e3, 2)),
    ):
        expected = forces(alone, vehicle, states)
        np.testing.assert_allclose(forces(mixed, vehicle, states), expected, atol=1e-9)


def test_equal_hooks_to_sky_and_ground_are_a_damper_between(vehicle: LateralVehicle) -> None:
    states = motion(vehicle)
    np.testing.assert_allclose(
        forces(MixedHook(11e3, 11e3, 4e3, 4), vehicle, states),
        forces(RelativeDamping(15e3, 4), vehicle, states),
        atol=1e-9,
    )


def test_the_mixed_hook_weighs_the_velocities_of_both_bodies(vehicle: LateralVehicle) -> None:
    states = motion(vehicle)
    C, _ = state_space(vehicle).output_rows(
        tuple(f"carbody_lateral_velocity_{k + 1}" for k in range(4))
    )
    carbody, bogie = states @ C.T, bogie_velocities(vehicle, states)
    expected = -30e3 * carbody + 9e3 * bogie - 2e3 * (carbody - bogie)
    law = MixedHook(30e3, 9e3, 2e3, 4)
    np.testing.assert_allclose(forces(law, vehicle, states), expected, atol=1e-9)


def test_relative_damping_takes_energy_out_of_every_motion(vehicle: LateralVehicle) -> None:
    states = motion(vehicle)
    C, _ = state_space(vehicle).output_rows(
        tuple(f"suspension_stroke_rate_{k + 1}" for k in range(4))
    )
    # the actuator works by its force on its stroke rate
    power = forces(RelativeDamping(15e3, 4), vehicle, states) * (states @ C.T)
    assert np.all(power < 0.0)


@pytest.mark.parametrize("layout", [2, 4])
def test_relative_damping_without_delay_is_the_dashpot_that_was_taken_out(layout: int) -> None:
    vehicle = lateral17(layout=layout)
    stiff = 1e12
    dampers = with_dampers(vehicle, 15e3, stiff)
    kept = LateralVehicle(dampers.parameters, vehicle.layout, vehicle.speed)
    closed = RelativeDamping(15e3, layout).to_delay_system(kept).undelayed
    # what a series stiffness k changes is of the order of c |s| / k: 1e-6 at the fastest of these
    np.testing.assert_allclose(
        sorted_roots(closed, 12), sorted_roots(state_space(dampers).A, 12), rtol=1e-5
    )


@pytest.mark.parametrize("layout", [2, 4])
def test_a_filtered_derivative_of_the_stroke_is_a_maxwell_damper(layout: int) -> None:
    hz, c = 12.0, 15e3
    dampers = with_dampers(lateral17(layout=layout), c, c * 2 * np.pi * hz)
    kept = LateralVehicle(dampers.parameters, lateral17(layout=layout).layout, dampers.speed)
    loop = FilteredRelativeDamping(c, hz, layout).to_delay_system(kept)
    assert not loop.neutral
    # the law's states are the nodes of the dampers that were taken out, behind all others
    nodes = [f"lateral_damper_{k}_node" for k in actuator_positions(kept.layout)]
    own, of_dampers = state_space(kept), state_space(dampers)
    order = [of_dampers.states.index(name) for name in (*own.states, *nodes)]
    expected = of_dampers.A[np.ix_(order, order)]
    size = np.abs(expected).max(axis=1, keepdims=True)
    np.testing.assert_allclose(loop.undelayed / size, expected / size, atol=1e-14)


def test_a_filter_of_zero_hertz_is_the_ideal_rate(vehicle: LateralVehicle) -> None:
    ideal, filtered = built(RELATIVE, vehicle), built(RELATIVE, vehicle, filter_hz=20.0)
    assert isinstance(ideal, RelativeDamping)
    assert isinstance(filtered, FilteredRelativeDamping)


@pytest.mark.parametrize("entry", ENTRIES, ids=lambda e: e.name)
class TestEntry:
    @pytest.mark.parametrize("layout", [2, 4])
    def test_the_oracle_proves_its_crossings_and_the_roots_agree(
        self, entry: Registered, layout: int
    ) -> None:
        vehicle = lateral17(layout=layout)
        loop = built(entry, vehicle).to_delay_system(vehicle)
        found = critical_delays(loop)
        assert found.proved
        assert found.unstable_without_delay == 0
        assert (found.critical_delay is None) == ((entry.name, layout) in CROSSES_NOWHERE)
        if found.critical_delay is not None:
            s = rightmost_roots(loop, found.critical_delay, 1)[0].root
            # a root of collocation is right to some 1e-8 of its size
            assert abs(s.real) < 1e-6 * abs(s)

    def test_its_file_acts_like_it(
        self, entry: Registered, tmp_path: Path, vehicle: LateralVehicle
    ) -> None:
        law = built(entry, vehicle)
        save_policy(law, tmp_path / "law.npz")
        again = load_policy(tmp_path / "law.npz")
        readings = np.random.default_rng(1).normal(size=(5, 3, 150))
        for controller in (law, again):
            controller.reset(3, 0)
        for now in readings:
            np.testing.assert_array_equal(again.act(now), law.act(now))

    def test_the_passive_layout_is_refused(self, entry: Registered) -> None:
        with pytest.raises(ArgumentError, match=r"'passive' has no actuator.*2 or 4"):
            built(entry, lateral17(layout="passive"))

    def test_it_is_linear_and_takes_the_layout_of_the_run(self, entry: Registered) -> None:
        law = built(entry, lateral17(layout=2))
        assert isinstance(law, LinearFeedback | LinearDynamic)
        assert law.layout == "2"

    def test_every_setting_out_of_range_is_refused_by_its_name(
        self, entry: Registered, vehicle: LateralVehicle
    ) -> None:
        for key in entry.settings:
            with pytest.raises(ArgumentError, match=rf"{key} = -1 must"):
                built(entry, vehicle, **{key: -1.0})
            with pytest.raises(ArgumentError, match=rf"{key} = nan"):
                built(entry, vehicle, **{key: float("nan")})
