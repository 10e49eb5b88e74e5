"""Derailment quotient, wheel unloading, shift and guiding force in info, and endings."""

from typing import Any

import numpy as np
import pytest

from railenv.envs.full_env import Full50Env
from railenv.envs.full_kernels import DERAILMENT, SafetyArrays, judge
from railenv.envs.full_settings import FullSettings
from railenv.envs.kernels import DIVERGENCE, GAUGE, NOT_ENDED
from railenv.envs.reward import RECORDED, reward_arrays, rewards_of_record
from railenv.errors import ArgumentError
from railenv.simulation.full_run import FullSimulation
from railenv.simulation.full_stepping import DERAILED, DIVERGED, RUNNING
from railenv.track import make_track
from railenv.units import STANDARD_GRAVITY
from railenv.vehicle.nonlinear.rates import WHEEL_COLUMNS

FLAT: dict[str, Any] = {"track": "flat", "episode_seconds": 10.0}
TOO_TIGHT: dict[str, Any] = {
    **FLAT,
    "curve": (300.0, 0.0),
    "curve_start": 0.0,
    "curve_transition": 20.0,
}


def run(env: Full50Env, steps: int, sky_hook: float = 0.0) -> list[dict[str, Any]]:
    """Infos of some steps, until the episode ends; gain of a sky-hook [N s/m]."""
    gain = sky_hook * env.observation_scales[:4] / env.settings.action_scale
    observation, _ = env.reset(seed=0)
    infos: list[dict[str, Any]] = []
    for _ in range(steps):
        observation, _, terminated, _, info = env.step(-gain * observation[:4])
        infos.append(info)
        if terminated:
            break
    return infos


def judged(wheels: np.ndarray, static_load: float = 60e3) -> dict[str, float]:
    """Safety of one lane with these wheels, shape (8, 5)."""
    return after_judging(wheels, RUNNING, NOT_ENDED, static_load)[0]


def after_judging(
    wheels: np.ndarray, vehicle_ended: int, ended: int, static_load: float = 60e3
) -> tuple[dict[str, float], int, float]:
    """Safety, ending and reward of one lane whose period had cost one before."""
    settings = FullSettings(**FLAT)
    terms = reward_arrays(settings, 1)
    terms.ended[0] = ended
    terms.comfort[0] = -1.0
    if ended != NOT_ENDED:
        terms.divergence[0] = -500.0
    reward = terms.comfort + terms.divergence
    safety = SafetyArrays(*(np.full(1, np.nan) for _ in SafetyArrays._fields))
    judge(
        wheels[None],
        np.array([vehicle_ended]),
        np.zeros(1, dtype=np.int64),
        np.array([static_load]),
        500.0,
        np.ones(1, dtype=bool),
        0,
        1,
        safety,
        terms,
        reward,
    )
    found = {name: float(values[0]) for name, values in safety._asdict().items()}
    return found, int(terms.ended[0]), float(reward[0])


def wheels_with(**columns: list[float]) -> np.ndarray:
    """Eight wheels of 60 kN; columns by name."""
    wheels = np.zeros((8, len(WHEEL_COLUMNS)))
    wheels[:, WHEEL_COLUMNS.index("vertical")] = 60e3
    for name, values in columns.items():
        wheels[:, WHEEL_COLUMNS.index(name)] = values
    return wheels


def test_steady_rolling_is_safe() -> None:
    info = Full50Env(**FLAT).reset(seed=0)[1]
    # A centred wheel on its tread, which slopes by a fortieth, with the creep of its spin.
    assert abs(info["derailment_quotient"]) < 0.05
    # The bogies' pitch shifts some parts per million of the load.
    assert abs(info["wheel_unloading"]) < 1e-5
    assert abs(info["wheelset_shift"]) < 1e-9
    assert abs(info["guiding_force"]) < 1e-3


def test_the_largest_quotient_counts_and_a_lifted_wheel_has_none() -> None:
    wheels = wheels_with(lateral=[1e3, -30e3, 6e3, 0.0, 0.0, 0.0, 0.0, 0.0])
    assert judged(wheels)["derailment_quotient"] == 0.1
    wheels[3] = (0.0, 5.0, 0.0, 0.0, 0.0)
    assert judged(wheels)["derailment_quotient"] == 0.1
    assert judged(np.zeros((8, 5)))["derailment_quotient"] == 0.0


def test_unloading_is_that_of_the_lightest_wheel() -> None:
    load = [60e3, 66e3, 54e3, 60e3, 45e3, 75e3, 60e3, 60e3]
    assert judged(wheels_with(vertical=load))["wheel_unloading"] == pytest.approx(0.25)
    load[1] = 0.0
    assert judged(wheels_with(vertical=load))["wheel_unloading"] == 1.0


def test_the_sum_of_guiding_forces_is_that_of_one_wheelset() -> None:
    # Outwards: -4 kN on the left and 5 kN on the right rail are 9 kN to the right together.
    lateral = [0.0, 0.0, -4e3, 5e3, 8e3, 8e3, 0.0, 0.0]
    assert judged(wheels_with(lateral=lateral))["guiding_force"] == 9e3


def test_the_shift_is_the_largest_in_either_direction() -> None:
    shift = [0.001, -0.001, 0.0, 0.0, -0.003, 0.0031, 0.0, 0.0]
    assert judged(wheels_with(shift=shift))["wheelset_shift"] == 0.0031


def test_a_curve_asks_for_the_guiding_force_of_newtons_law() -> None:
    # 100 m after the transition of a curve of 7000 m without cant: V^2 / R on every wheelset's
    # share of the mass, and more on the leading one of a bogie, which steers the other.
    env = Full50Env(**FLAT, curve=(7000.0, 0.0), curve_start=0.0, curve_transition=200.0)
    infos = run(env, 360, sky_hook=20e3)
    car = env.vehicle
    share = car.parameters.lateral.axle_load / STANDARD_GRAVITY
    asked = share * car.speed**2 / 7000.0
    found = np.mean([info["guiding_force"] for info in infos[-60:]])
    assert asked < found < 2.0 * asked
    # That force's moment about the rails, over the spacing of the wheels, as of a rigid vehicle;
    # this one leans outwards on its springs and adds a quarter.
    p = car.parameters
    bodies = (
        (p.lateral.carbody_mass, p.carbody_height),
        (2.0 * p.lateral.bogie_mass, p.bogie_height),
        (4.0 * p.lateral.wheelset_mass, p.lateral.wheel_radius),
    )
    height = sum(m * h for m, h in bodies) / sum(m for m, _ in bodies)
    rigid = height * car.speed**2 / (7000.0 * STANDARD_GRAVITY * p.lateral.half_contact_spacing)
    unloading = np.mean([info["wheel_unloading"] for info in infos[-60:]])
    assert rigid < unloading < 1.5 * rigid


def test_cant_that_balances_the_curve_takes_the_unloading_away() -> None:
    speed = 300.0 / 3.6
    spacing = 2.0 * Full50Env(**FLAT).vehicle.parameters.lateral.half_contact_spacing
    balance = spacing * speed**2 / (7000.0 * STANDARD_GRAVITY)
    unloading: list[float] = []
    for cant in (0.0, balance):
        line = {"curve_start": 0.0, "curve_transition": 200.0, "curve": (7000.0, cant)}
        infos = run(Full50Env(**FLAT, **line), 300, sky_hook=20e3)
        unloading.append(float(np.mean([info["wheel_unloading"] for info in infos[-50:]])))
    # what is left after 0.6 s of curve is sway, and the wheelsets' steering against each other
    assert unloading[0] > 0.25
    assert unloading[1] < 0.25 * unloading[0]


def test_a_left_hand_curve_is_the_mirror_image_of_a_right_hand_one() -> None:
    curve = {**FLAT, "curve_start": 0.0, "curve_transition": 100.0, "action_history": 0}
    right, left = Full50Env(**curve, curve=(3000.0, 0.1)), Full50Env(**curve, curve=(-3000.0, 0.1))
    for env in (right, left):
        env.reset(seed=0)
    for _ in range(150):
        seen, _, _, _, one = right.step(np.zeros(4))
        mirrored, _, _, _, other = left.step(np.zeros(4))
    # All sixteen sensors are lateral, roll or yaw. Rounding: sums run in another order.
    np.testing.assert_allclose(mirrored, -seen, atol=1e-5)
    for name in SafetyArrays._fields:
        assert one[name] == pytest.approx(other[name], rel=1e-6), name


def test_a_curve_that_is_far_too_tight_derails_with_its_reason_and_penalty() -> None:
    env = Full50Env(**TOO_TIGHT)
    infos = run(env, 100)
    last = infos[-1]
    assert len(infos) < 100
    assert last["ended_by"] == "derailment"
    assert last["reward_divergence"] == -env.settings.penalty()
    # the flange is climbing or over the rail by then: more than its angle's share of friction
    assert max(info["derailment_quotient"] for info in infos) > 0.8
    assert max(info["wheel_unloading"] for info in infos) == 1.0


def test_a_derailed_vehicle_has_to_be_reset() -> None:
    env = Full50Env(**TOO_TIGHT)
    run(env, 100)
    with pytest.raises(ArgumentError, match="derailed"):
        env.step(np.zeros(4))
    env.reset()
    assert not env.step(np.zeros(4))[2]


@pytest.mark.parametrize(
    ("vehicle_ended", "before", "after"),
    [
        (RUNNING, NOT_ENDED, NOT_ENDED),
        (RUNNING, GAUGE, GAUGE),
        (DERAILED, NOT_ENDED, DERAILMENT),
        (DERAILED, GAUGE, DERAILMENT),
        (DERAILED, DIVERGENCE, DERAILMENT),
        (DIVERGED, NOT_ENDED, DIVERGENCE),
        (DIVERGED, GAUGE, DIVERGENCE),
    ],
)
def test_an_ending_costs_the_penalty_once_and_the_vehicles_own_is_named(
    vehicle_ended: int, before: int, after: int
) -> None:
    _, ended, reward = after_judging(wheels_with(), vehicle_ended, before)
    assert ended == after
    assert reward == (-1.0 if after == NOT_ENDED else -501.0)


@pytest.mark.parametrize(
    ("limits", "reason"),
    [({"gauge_limit": 1e-5}, "gauge"), ({"acceleration_limit": 1e-3}, "divergence")],
)
def test_other_endings_keep_their_names(limits: dict, reason: str) -> None:
    env = Full50Env(**FLAT, **limits)
    env.reset(seed=0)
    ended = [env.step(np.ones(4))[4]["ended_by"] for _ in range(8)]
    assert reason in ended


def test_the_reward_is_that_of_the_record() -> None:
    # The environment against a simulation that is none, on one track with one row of actions.
    settings = FullSettings(track_pool=1, episode_seconds=1.0, delay=0.013)
    env = Full50Env(track_pool=1, episode_seconds=1.0, delay=0.013)
    env.reset(seed=0, options={"track_seed": 5})
    rng = np.random.default_rng(0)
    actions = rng.uniform(-1.0, 1.0, (80, 4)).astype(np.float32)
    earned = [env.step(action)[1] for action in actions]
    simulation = FullSimulation(env.vehicle, RECORDED)
    track = make_track("tb3352", env.vehicle.speed * 1.0, 5)
    simulation.reset(np.full((1, 4), 0.013), [track])
    commands = settings.action_scale * actions.astype(np.float64)
    records = [simulation.advance(command[None]) for command in commands]
    recorded = np.concatenate(records, axis=1)
    wanted = rewards_of_record(settings, recorded, actions.astype(np.float64)[None])
    np.testing.assert_array_equal(earned, wanted[0])
