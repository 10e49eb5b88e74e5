"""Clipped LQG: what it predicts, what it commands, and what it is worth."""

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from baselines.clipped_lqg import CLIPPED_LQG, EFFORT, ClippedLqg
from baselines.controller import Controller
from baselines.design.model import DESIGN_NOISE, sensor_noise
from baselines.design.optimum import estimator, regulator
from baselines.semi_active import OnOffSkyHook, SemiActiveSkyHook
from eval.measures import measure
from eval.rollout import ACCELERATIONS, ControlledBatch, Stepping, force_names, rollout
from railenv.actuation import ActuatorSpec, SemiActiveDamper
from railenv.envs.observation import sensor_names
from railenv.errors import ArgumentError
from railenv.simulation import required_length
from railenv.track import make_track
from railenv.vehicle import LateralVehicle, lateral17, state_space
from railenv.vehicle.coordinates import actuator_positions

Array = NDArray[np.float64]

DAMPER = SemiActiveDamper(5e3, 30e3, 0.01)
FINE = 0.0005
NO_LIMIT = Stepping(actuator=ActuatorSpec(force_limit=None), time_step=FINE)
PERIOD = 0.01


def names(vehicle: LateralVehicle, *quantities: str) -> tuple[str, ...]:
    """Names of some quantities at the vehicle's damper places."""
    return tuple(f"{q}_{k}" for q in quantities for k in actuator_positions(vehicle.layout))


def kicked(vehicle: LateralVehicle) -> Array:
    """Bogies and carbody in random motion, so fast that what is not known of it is nothing."""
    state = np.zeros(len(state_space(vehicle).A))
    state[17 + 8 : 34] = 1e3 * np.random.default_rng(0).standard_normal(9)
    return state


def loop(law: ClippedLqg, vehicle: LateralVehicle, delay: float) -> ControlledBatch:
    """A law that knows the state at the start, on level track."""
    record = names(vehicle, "suspension_stroke", "damping_coefficient")
    batch = ControlledBatch(law, vehicle, record, NO_LIMIT)
    start = kicked(vehicle)
    batch.reset(np.full((1, vehicle.num_actuators), delay), initial_state=start)
    law.state[: len(start), 0] = start
    return batch


def german_low(
    law: Controller,
    vehicle: LateralVehicle,
    delays: list[float],
    duration: float,
    *,
    seeds: int = 1,
    seed: int = 0,
) -> Any:
    """Run with noisy sensors; lanes are tracks of one delay, then those of the next."""
    length = required_length(vehicle, duration + 1.0)
    tracks = tuple(make_track("german_low", length, number) for number in range(seeds))
    parts = ("suspension_stroke_rate", "damping_coefficient")
    return rollout(
        law,
        vehicle,
        np.repeat(delays, seeds)[:, None] * np.ones(vehicle.num_actuators),
        duration,
        tracks=tracks,
        track_of_lane=np.tile(np.arange(seeds), len(delays)),
        record=(*ACCELERATIONS, *force_names(vehicle), *names(vehicle, *parts)),
        stepping=Stepping(sensor_noise=0.1),
        seed=seed,
    )


# 3.7 and 8.5 ms are parts of a control period.
@pytest.mark.parametrize("layout", [2, 4])
@pytest.mark.parametrize("delay", [0.0, 0.01, 0.1037, 0.1085, 0.3])
def test_the_force_on_arrival_is_the_one_that_was_wanted(layout: int, delay: float) -> None:
    vehicle = lateral17("paper_fit", layout, 300.0)
    law = ClippedLqg(vehicle, SemiActiveDamper(5e3, 30e3, 0.0), delay)
    batch = loop(law, vehicle, delay)
    m, wanted = vehicle.num_actuators, []
    outputs = [batch.simulation.measure()[0, -2 * m :]]
    for _ in range(120):
        outputs.extend(batch.advance()[0])
        wanted.append(law.wanted[:, 0])
    stroke, coefficient = np.split(np.array(outputs), 2, axis=1)
    impulse = -coefficient[1:] * np.diff(stroke, axis=0)
    first, steps = round(delay / FINE), round(PERIOD / FINE)
    periods = (len(impulse) - first) // steps
    arriving = slice(first, first + periods * steps)
    force = impulse[arriving].reshape(periods, steps, m).sum(axis=1) / PERIOD
    held = coefficient[1:][arriving].reshape(periods, steps, m)[:, steps // 2]
    # Only where the range lets the damper do it: a fifth to a third of all.
    within = (held > 5.01e3) & (held < 29.9e3)
    assert np.mean(within) > 0.15
    aimed = np.array(wanted)[:periods][within]
    # 0.1 %, and 0.3 % with parts of a period, where a mean takes the place of two forces
    error = np.linalg.norm(force[within] - aimed) / np.linalg.norm(aimed)
    assert error < 0.006


@pytest.mark.parametrize("response_time", [0.0, 0.01])
@pytest.mark.parametrize("delay", [0.0, 0.02, 0.0237])
def test_a_prediction_of_one_period_is_that_of_the_simulation(
    vehicle: LateralVehicle, delay: float, response_time: float
) -> None:
    law = ClippedLqg(vehicle, SemiActiveDamper(5e3, 30e3, response_time), delay)
    batch = loop(law, vehicle, delay)
    soft = ClippedLqg(vehicle, SemiActiveDamper(5e3, 5e3), delay)
    n = len(batch.simulation.state[0])
    errors, effects = [], []
    for _ in range(60):
        law.state[:n, 0] = now = batch.simulation.state[0]
        batch.advance()
        truth = batch.simulation.state[0]
        errors.append((law.state[:n, 0] - truth)[25:34])
        effects.append((soft.model.A[:n, :n] @ now - truth)[25:34])
    # Velocities of bogies and carbody, beside what more than the lowest coefficient does to them:
    # the neglected product of changes in coefficient and rate is about a tenth of that at most.
    assert np.linalg.norm(errors) < 0.1 * np.linalg.norm(effects)


@pytest.mark.parametrize("delay", [0.0, 0.0237, 0.1])
def test_the_law_knows_the_coefficients_of_its_dampers(
    vehicle: LateralVehicle, delay: float
) -> None:
    law = ClippedLqg(vehicle, SemiActiveDamper(5e3, 30e3, 0.013), delay)
    batch = loop(law, vehicle, delay)
    for _ in range(40):
        recorded = batch.advance()
        # twenty records in a period and four quotients each: rounding
        np.testing.assert_allclose(law.coefficient[0], recorded[0, -1, 4:], rtol=1e-12)
    assert np.ptp(law.coefficient) > 1e3


def test_the_force_wanted_moves_with_the_delay_without_a_jump(vehicle: LateralVehicle) -> None:
    # Just below a whole number of periods, the force before acts through all but a microsecond.
    found = []
    for delay in (0.049999, 0.05):
        law = ClippedLqg(vehicle, SemiActiveDamper(5e3, 30e3, 0.0), delay)
        batch, wanted = loop(law, vehicle, delay), []
        for _ in range(60):
            batch.advance()
            wanted.append(law.wanted[:, 0])
        found.append(np.array(wanted))
    difference = np.linalg.norm(found[0] - found[1])
    # 3 %: the force before is taken as it is at the start of its period; 9 % without its gain.
    assert difference < 0.06 * np.linalg.norm(found[1])


def test_what_is_not_foreseen_is_as_large_as_the_law_takes_it_for(vehicle: LateralVehicle) -> None:
    fixed = SemiActiveDamper(10e3, 10e3)
    law = ClippedLqg(vehicle, fixed, 0.05)
    model, lanes, rng = law.model, 4000, np.random.default_rng(0)
    knowledge = estimator(model, sensor_names("4"), DESIGN_NOISE)
    gain, n = regulator(model, EFFORT).gain, len(model.A) - 4
    places = tuple(f"suspension_stroke_{k}" for k in (1, 2, 3, 4))
    stroke = model.measurement(places)
    mean = stroke @ (model.A - np.eye(n + 4)) / PERIOD
    sizes, vectors = np.linalg.eigh(knowledge.error + knowledge.innovation)
    spread = vectors * np.sqrt(np.maximum(sizes, 0.0))
    X = np.zeros((n + 4, lanes))
    law.reset(lanes, 0)
    law.state += (spread @ rng.standard_normal((n + 4, lanes)))[:n]
    deviation = sensor_noise(knowledge.sensors, DESIGN_NOISE)[:, None]
    columns = (len(law.measures), lanes)
    law.act((knowledge.M @ X + deviation * rng.standard_normal(columns)).T)
    # The law is one period ahead of what it has measured, and there are five on the way.
    foreseen = np.linalg.matrix_power(model.A[:n, :n], 4) @ law.state
    for _ in range(5):
        X = model.A @ X + model.G @ rng.standard_normal((model.G.shape[1], lanes))
    error = X[:n] - foreseen
    rate = mean[:, :n] @ error
    force = -gain[:, :n] @ error - 10e3 * rate
    # 4000 draws: 2 % of a variance, and of a covariance about the product of both deviations
    np.testing.assert_allclose(law.variance[:, 0], np.var(rate, axis=1), rtol=0.1)
    size = np.std(rate, axis=1) * np.std(force, axis=1)
    product = np.mean(rate * force, axis=1)
    np.testing.assert_allclose(law.covariance[:, 0] / size, product / size, atol=0.1)


def test_it_takes_energy_out_at_every_sample_in_every_lane(vehicle: LateralVehicle) -> None:
    for preview in (False, True):
        law = ClippedLqg(vehicle, DAMPER, 0.05, preview=preview)
        values = german_low(law, vehicle, [0.0, 0.05, 0.1371], 5.0).values
        force, rate, coefficient = values[:, :, 4:8], values[:, :, 8:12], values[:, :, 12:]
        assert np.all(force * rate <= 0.0)
        assert np.array_equal(force, -coefficient * rate)
        # the law is at work: its coefficients come near both ends
        assert coefficient.min() < 5.1e3
        assert coefficient.max() > 25e3


def test_dampers_without_a_range_are_dashpots(vehicle: LateralVehicle) -> None:
    fixed = SemiActiveDamper(12e3, 12e3, 0.01)
    clipped = german_low(ClippedLqg(vehicle, fixed, 0.1), vehicle, [0.0371], 3.0).values
    dashpots = german_low(OnOffSkyHook(fixed), vehicle, [0.0], 3.0).values
    assert np.all(clipped[:, :, 12:] == 12e3)
    assert np.array_equal(clipped, dashpots)


def test_a_lane_does_not_depend_on_its_neighbours(vehicle: LateralVehicle) -> None:
    law = ClippedLqg(vehicle, DAMPER, 0.05)
    track = make_track("german_low", required_length(vehicle, 3.0), 0)
    delays = np.repeat(np.array([[0.0], [0.013], [0.05]]), 4, axis=1)
    together = rollout(law, vehicle, delays, 2.0, tracks=(track,)).values
    alone = rollout(law, vehicle, delays[1:2], 2.0, tracks=(track,)).values
    assert np.array_equal(alone[0], together[1])


def test_a_run_can_be_repeated(vehicle: LateralVehicle) -> None:
    law = ClippedLqg(vehicle, DAMPER, 0.05)
    runs = [german_low(law, vehicle, [0.05], 2.0, seed=seed).values for seed in (3, 3, 4)]
    assert np.array_equal(runs[0], runs[1])
    assert not np.array_equal(runs[0], runs[2])


def test_a_vehicle_at_rest_gets_a_constant_coefficient(vehicle: LateralVehicle) -> None:
    law = ClippedLqg(vehicle, DAMPER, 0.1)
    law.reset(2, 0)
    actions = [law.act(np.zeros((2, len(law.measures) + 7))) for _ in range(15)]
    # With nothing measured the estimate stays at rest, whatever is on its way.
    assert all(np.array_equal(action, actions[0]) for action in actions)
    assert np.all(actions[0] >= DAMPER.lowest / DAMPER.highest)
    assert np.all(actions[0] <= 1.0)


def test_the_entry_builds_the_law_for_the_vehicle_of_the_run() -> None:
    values: dict[str, Any] = {key: default for key, (default, _) in CLIPPED_LQG.settings.items()}
    values |= {"lowest": 1e3, "highest": 20e3, "response_time": 0.005, "delay": 0.0237}
    law: Any = CLIPPED_LQG.build(lateral17("paper_fit", 2, 200.0), **values)
    assert isinstance(law, ClippedLqg)
    assert law.damper == SemiActiveDamper(1e3, 20e3, 0.005)
    assert (law.layout, law.delay, law.action_scale) == ("2", 0.0237, 20e3)
    assert law.model.vehicle.speed == pytest.approx(200.0 / 3.6)
    assert not hasattr(law, "to_delay_system")
    fast: Any = CLIPPED_LQG.build(law.model.vehicle, **{**values, "design_kmh": 250.0})
    assert fast.model.vehicle.speed == pytest.approx(250.0 / 3.6)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"delay": -0.1}, "delay = -0.1 must not be negative"),
        ({"effort": 0.0}, "effort = 0 must be above zero"),
        ({"noise": 0.0}, "noise = 0 must be above zero"),
        ({"vehicle": lateral17("paper_fit", "passive", 300.0)}, "choose 2 or 4"),
    ],
)
def test_a_law_that_cannot_be_is_refused(
    settings: dict[str, Any], message: str, vehicle: LateralVehicle
) -> None:
    with pytest.raises(ArgumentError, match=message):
        ClippedLqg(**{"vehicle": vehicle, "damper": DAMPER, **settings})


def test_a_law_that_was_not_reset_says_so(vehicle: LateralVehicle) -> None:
    with pytest.raises(ArgumentError, match="call reset"):
        ClippedLqg(vehicle, DAMPER).act(np.zeros((3, 30)))


def ride(law: Controller, vehicle: LateralVehicle, delay: float) -> Array:
    """Mean ride index front and rear over four tracks of 40 s."""
    found = measure(german_low(law, vehicle, [delay], 40.0, seeds=4), 10.0, 30e3)
    assert not found.diverged.any()
    return np.array([found.ride_index_front.mean(), found.ride_index_rear.mean()])


@pytest.mark.slow
@pytest.mark.parametrize("delay", [0.1, 0.3])
def test_a_delay_that_is_known_costs_less_than_one_that_is_ignored(
    vehicle: LateralVehicle, delay: float
) -> None:
    known = ride(ClippedLqg(vehicle, DAMPER, delay), vehicle, delay)
    ignored = ride(ClippedLqg(vehicle, DAMPER, 0.0), vehicle, delay)
    # A difference of 0.02 is more than four tracks scatter by between two laws on the same track.
    assert np.all(known < ignored - 0.02)


@pytest.mark.slow
def test_it_is_better_than_skyhook_laws_and_constant_dampers(vehicle: LateralVehicle) -> None:
    for delay in (0.0, 0.1, 0.3):
        clipped = ride(ClippedLqg(vehicle, DAMPER, delay), vehicle, delay).mean()
        others: list[Controller] = [
            OnOffSkyHook(SemiActiveDamper(c, c)) for c in (5e3, 7.5e3, 10e3)
        ]
        others += [OnOffSkyHook(SemiActiveDamper(5e3, 15e3)), SemiActiveSkyHook(35e3, DAMPER)]
        assert clipped < min(ride(law, vehicle, delay).mean() for law in others)
