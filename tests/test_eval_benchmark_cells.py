"""A cell of the benchmark: its run alone, what is drawn for it, what the oracle says of it."""

from typing import Any

import numpy as np
import pytest
from benchmark_examples import BROKEN, block, rows_of, suite_of

from baselines import SkyHook, make_controller
from baselines.lqg import DelayLqg
from eval import cells
from eval.cells import CellWork, controller_for, grows, is_linear, run_package
from eval.full50_safety import SafetyWatch
from eval.measures import measure
from eval.packages import packages_of
from eval.rollout import ACCELERATIONS, ControlledBatch, Stepping, force_names, rollout
from eval.scenarios import Scenario, Suite, TestTracks, vehicle_parameters
from eval.scenarios.scenario import lateral_of, vehicle_of
from eval.varying_delay import ChannelDraws, VaryingDelay
from railenv.actuation import ActuatorSpec
from railenv.simulation import required_length
from railenv.stability import count_unstable, critical_delays
from railenv.track import make_track
from railenv.vehicle import lateral17, state_space

SALT = "sixteen characters or more"
CHANNELS = ("constant", "spread", "jitter", "dropout")
# No value is a default, so that none can be ignored.
OWN: dict[str, Any] = {
    "skip": 2.0,
    "time_step": 0.0025,
    "force_limit": 300.0,
    "sensor_noise": 0.2,
}
MANY = suite_of(
    block(channels=CHANNELS, delays_ms=(0.0, 130.0), seeds=2, layouts=("2",)),
    block(tracks=("tb3352",), layouts=("2",), delays_ms=(130.0,)),
    **OWN,
)


def alone(suite: Suite, spec: str, scenario: Scenario, salt: str = "") -> dict[str, Any]:
    """The measures of one scenario, run by itself from its parts."""
    test = TestTracks(suite.version, salt)
    linear = lateral17(vehicle_parameters(scenario.vehicle), scenario.layout, scenario.speed_kmh)
    if spec == "passive":
        linear = lateral17(vehicle_parameters(scenario.vehicle), "passive", scenario.speed_kmh)
    own, channel = suite.skip + suite.seconds, scenario.channel
    number = linear.num_actuators
    first = 0.5 if channel.kind == "spread" else 1.0
    delays = channel.delay * np.linspace(first, 1.0, number)[None]
    draws = test.stream(f"{scenario.track}/{channel.key}/{scenario.seed}")
    varying = VaryingDelay(
        (draws,),
        jitter=0.02 if channel.kind == "jitter" else 0.0,
        dropout=0.1 if channel.kind == "dropout" else 0.0,
    )
    law = make_controller(spec, scenario.layout, "paper_fit", scenario.speed_kmh)
    period = getattr(law, "control_period", None) or 0.01
    trajectory = rollout(
        law,
        linear,
        delays,
        own,
        tracks=[make_track(scenario.track, required_length(linear, own), test.seed(scenario.seed))],
        stepping=Stepping(
            period,
            suite.time_step,
            ActuatorSpec(force_limit=suite.force_limit),
            sensor_noise=suite.sensor_noise,
            max_delay=0.32,
        ),
        record=(*ACCELERATIONS, *force_names(linear)),
        channel=varying if number else None,
        noise_seeds=[draws],
    )
    return measure(trajectory, suite.skip, suite.force_limit).lane(0)


@pytest.fixture(scope="module")
def many() -> dict[str, dict[str, Any]]:
    return rows_of(MANY, "skyhook:gain=15e3")


@pytest.mark.parametrize("scenario", MANY.scenarios, ids=lambda s: s.key)
def test_a_cell_is_its_own_run(many: dict[str, Any], scenario: Scenario) -> None:
    expected = alone(MANY, "skyhook:gain=15e3", scenario)
    row = many[scenario.key]
    assert (row["status"] == "diverged") == (expected.pop("diverged") or row["unstable"] is True)
    # The lanes are the same bit by bit; a Fourier transform of many rounds its last bit otherwise.
    assert {name: row[name] for name in expected} == pytest.approx(expected, rel=1e-12)


def test_no_two_cells_of_a_delay_have_the_same_numbers(many: dict[str, Any]) -> None:
    late = [row["floor_rms_rear"] for row in many.values() if row["delay_s"]]
    assert len(set(late)) == len(late) == 9


def test_without_delay_a_spread_is_a_constant_delay(many: dict[str, Any]) -> None:
    head = "v0/lateral17/nominal/2/300/german_low"
    # Their noise has streams of its own, so they are near and not the same.
    first, second = (many[f"{head}/{kind}:0/0"]["ride_index_rear"] for kind in CHANNELS[:2])
    assert first == pytest.approx(second, rel=0.05)


def test_a_compiled_policy_runs_the_same_in_company() -> None:
    suite = suite_of(block(delays_ms=(0.0, 100.0), seeds=2))
    rows = rows_of(suite, "apg-linear")
    for scenario in suite.scenarios:
        expected = alone(suite, "apg-linear", scenario)
        expected.pop("diverged")
        own = {name: rows[scenario.key][name] for name in expected}
        # A policy sums its products in an order that depends on no other lane.
        assert own == pytest.approx(expected, rel=1e-12)


def test_a_private_salt_gives_other_tracks_and_noise() -> None:
    suite = suite_of(block(delays_ms=(0.0,)))
    (public,), (private,) = (rows_of(suite, "skyhook", salt).values() for salt in ("", SALT))
    assert public["ride_index_rear"] != private["ride_index_rear"]
    expected = alone(suite, "skyhook", suite.scenarios[0], SALT)
    assert private["ride_index_rear"] == pytest.approx(expected["ride_index_rear"], rel=1e-12)


def test_a_packages_mates_do_not_change_a_cell(many: dict[str, Any]) -> None:
    fewer = rows_of(
        suite_of(block(channels=("jitter",), delays_ms=(130.0,), layouts=("2",)), **OWN),
        "skyhook:gain=15e3",
    )
    ((key, row),) = fewer.items()
    assert {name: row[name] for name in row if isinstance(row[name], float)} == pytest.approx(
        {name: many[key][name] for name in row if isinstance(row[name], float)}, rel=1e-12
    )


class Listener:
    """Commands nothing, and keeps what it reads."""

    def reset(self, num_lanes: int, seed: int) -> None:
        self.seen: list[np.ndarray] = []

    def act(self, observations: np.ndarray) -> np.ndarray:
        self.seen.append(observations[:, :16].copy())
        return np.zeros((len(observations), 4))


def drawn(monkeypatch: pytest.MonkeyPatch, spec: str, suite: Suite) -> list[np.ndarray]:
    """What is late, what is lost in the first periods of a package, and its seeds."""
    found: list[np.ndarray] = []

    class Noted(ChannelDraws):
        def renew(self) -> None:
            super().renew()
            if len(found) < 40:
                found.extend([np.array(self.later), np.array(self.lost)])

    monkeypatch.setattr("eval.rollout.ChannelDraws", Noted)
    (package,) = packages_of(suite, spec)
    run_package(CellWork(suite, "", package))
    return found


@pytest.mark.parametrize(
    "changes", [{}, {"vehicles": ("laden",)}, {"speeds_kmh": (250.0,)}], ids=str
)
def test_every_controller_and_vehicle_meets_the_same_lateness_and_losses(
    monkeypatch: pytest.MonkeyPatch, changes: dict[str, Any]
) -> None:
    fields: dict[str, Any] = {"channels": ("jitter", "dropout"), "seeds": 2}
    first = drawn(monkeypatch, "zero", suite_of(block(**fields)))
    second = drawn(monkeypatch, "skyhook", suite_of(block(**fields, **changes)))
    np.testing.assert_array_equal(first, second)
    late, lost = np.array(first[::2]), np.array(first[1::2])
    # Two lanes of either kind, in the order of the channels.
    assert 0.0 < late[:, :2].min() <= late[:, :2].max() < 0.02
    assert not np.any(late[:, 2:])
    assert np.any(lost[:, 2:])
    assert not np.any(lost[:, :2])
    assert not np.array_equal(late[:, 0], late[:, 1])


def test_every_vehicle_and_speed_has_the_same_noise(monkeypatch: pytest.MonkeyPatch) -> None:
    def noise(**changes: Any) -> np.ndarray:
        law, still = Listener(), Listener()
        for own, share in ((law, 0.1), (still, 0.0)):
            monkeypatch.setattr(cells, "controller_for", lambda *_, own=own: own)
            suite = suite_of(block(seeds=2, **changes), sensor_noise=share)
            (package,) = packages_of(suite, "zero")
            run_package(CellWork(suite, "", package))
        return np.array(law.seen) - np.array(still.seen)

    first, second = noise(), noise(vehicles=("laden",), speeds_kmh=(250.0,))
    assert np.abs(first).min() > 0.0
    # Differences of numbers of up to some 10 m/s^2, rounded.
    np.testing.assert_allclose(first, second, atol=1e-13)
    assert np.abs(first[:, 0] - first[:, 1]).max() > 1e-3


def test_the_nonlinear_vehicles_safety_is_that_of_each_lane_alone() -> None:
    suite = suite_of(block(models=("full50",), delays_ms=(0.0, 200.0)), sensor_noise=0.0)
    rows = rows_of(suite, "skyhook:gain=15e3")
    vehicle: Any = vehicle_of(suite.scenarios[0].place)
    twin = lateral_of(suite.scenarios[0].place)
    track = make_track("german_low", required_length(twin, 6.0), TestTracks("v0").seed(0))
    law = make_controller("skyhook:gain=15e3", 4)
    for scenario in suite.scenarios:
        watch = SafetyWatch(vehicle)
        rollout(
            law,
            vehicle,
            np.full((1, 4), scenario.channel.delay),
            6.0,
            tracks=[track],
            stepping=Stepping(max_delay=0.32),
            channel=VaryingDelay((0,)),
            watch=watch.watch,
        )
        row = rows[scenario.key]
        assert row["derailment_quotient"] == watch.derailment_quotient > 0.0
        assert row["wheel_unloading"] == watch.wheel_unloading > 0.0
        assert row["unstable"] is None


def test_of_the_linear_vehicle_no_safety_is_told(many: dict[str, Any]) -> None:
    assert {row["derailment_quotient"] for row in many.values()} == {None}
    assert {row["wheel_unloading"] for row in many.values()} == {None}


def test_the_passive_vehicle_is_run_once_per_track_without_delay() -> None:
    suite = suite_of(block(channels=CHANNELS, delays_ms=(0.0, 100.0), seeds=2, layouts=("2", "4")))
    rows = rows_of(suite, "passive")
    assert list(rows) == [
        f"v0/lateral17/nominal/{layout}/300/german_low/constant:0/{seed}"
        for layout in "24"
        for seed in (0, 1)
    ]
    expected = alone(suite, "passive", suite.scenarios[0])
    expected.pop("diverged")
    row = next(iter(rows.values()))
    # The same run, rounded as above; whatever the layout, it has no actuators.
    assert {name: row[name] for name in expected} == pytest.approx(expected, rel=1e-12)
    assert row["force_rms"] == 0.0
    two, four = (rows[f"v0/lateral17/nominal/{n}/300/german_low/constant:0/0"] for n in "24")
    assert two["ride_index_rear"] == four["ride_index_rear"]


def test_a_spread_channel_is_longest_at_the_last_actuator(monkeypatch: pytest.MonkeyPatch) -> None:
    given: list[np.ndarray] = []
    begin = ControlledBatch.reset
    monkeypatch.setattr(
        ControlledBatch,
        "reset",
        lambda self, d, *a, **k: given.append(d) or begin(self, d, *a, **k),
    )
    rows_of(suite_of(block(channels=("spread",), layouts=("2", "4"))), "zero")
    np.testing.assert_allclose(given[0], [[0.05, 0.1]], rtol=1e-12)
    np.testing.assert_allclose(given[1], [[0.05, 0.2 / 3, 0.25 / 3, 0.1]], rtol=1e-12)


def test_a_controller_is_told_the_mean_delay_of_its_lane(monkeypatch: pytest.MonkeyPatch) -> None:
    told: list[np.ndarray] = []
    law = controller_for(f"{BROKEN}Told", ("lateral17", "nominal", "4", 300.0))
    monkeypatch.setattr(cells, "controller_for", lambda *_: law)
    tell = law.tell  # type: ignore[attr-defined]
    law.tell = lambda d: told.append(d) or tell(d)  # type: ignore[attr-defined]
    rows_of(suite_of(block(channels=CHANNELS, delays_ms=(0.0, 200.0))), "zero")
    # A jitter is not told: its mean is not in it.
    np.testing.assert_allclose(told, [[0.0, 0.2, 0.0, 0.15, 0.0, 0.2, 0.0, 0.2]], rtol=1e-12)


def test_a_design_per_delay_runs_every_lane_by_its_own_design() -> None:
    suite = suite_of(block(delays_ms=(0.0, 100.0)))
    rows = rows_of(suite, "lqg-delay:delay={delay}")
    for scenario, spec in zip(
        suite.scenarios, ("lqg-delay:delay=0", "lqg-delay:delay=0.1"), strict=True
    ):
        expected = alone(suite, spec, scenario)
        expected.pop("diverged")
        own = {name: rows[scenario.key][name] for name in expected}
        # The observer's sums over lanes are of another length, hence rounded otherwise.
        assert own == pytest.approx(expected, rel=1e-9)


def test_a_law_with_a_model_in_it_knows_the_speed_and_not_the_state_of_the_vehicle() -> None:
    place = ("lateral17", "worn", "2", 250.0)
    law: Any = controller_for("lqg:effort=0.1", place)
    nominal: Any = make_controller("lqg:effort=0.1", 2, "paper_fit", 250.0)
    np.testing.assert_array_equal(law.optimum.regulator.gain, nominal.optimum.regulator.gain)


def test_the_reference_knows_its_vehicle() -> None:
    place = ("full50", "laden", "4", 250.0)
    reference: Any = controller_for("reference", place)
    gain = reference.optimum.regulator.gain
    own = DelayLqg(lateral17(vehicle_parameters("laden"), 4, 250.0), 0.0)
    np.testing.assert_array_equal(gain, own.optimum.regulator.gain)
    other = DelayLqg(lateral17("paper_fit", 4, 250.0), 0.0)
    assert not np.allclose(gain, other.optimum.regulator.gain)


def test_the_oracles_word_on_a_sky_hook_is_that_of_its_crossings() -> None:
    # The continuous critical delay is some 202 ms; sampling takes half a period of 10 ms away.
    critical = (
        critical_delays(SkyHook(35e3, 4).to_delay_system(lateral17()), 1.0).crossings[0].delay
    )
    suite = suite_of(block(delays_ms=(0.0, 190.0, 210.0), channels=("constant", "jitter")))
    rows = rows_of(suite, "skyhook:gain=35e3")
    for row in rows.values():
        constant = row["channel"] == "constant"
        assert row["unstable"] is ((row["delay_s"] > critical) if constant else None)


def test_a_run_whose_loop_grows_has_diverged_however_slowly() -> None:
    # Growth at 210 ms, 8 ms beyond the critical delay, does not show within six seconds.
    suite = suite_of(block(delays_ms=(210.0,)))
    (row,) = rows_of(suite, "skyhook:gain=35e3").values()
    assert (row["unstable"], row["status"]) == (True, "diverged")
    assert alone(suite, "skyhook:gain=35e3", suite.scenarios[0])["diverged"] is False
    assert row["ride_index_rear"] is not None


@pytest.mark.parametrize("spec", ["apg-linear", "ppo-linear"])
def test_a_told_linear_policy_is_asked_at_the_delay_that_it_is_told(spec: str) -> None:
    suite = suite_of(block(delays_ms=(0.0, 300.0)))
    policy: Any = make_controller(spec)
    vehicle = lateral17("paper_fit", 4, 300.0)
    for row in rows_of(suite, spec).values():
        loop = policy.law_at(row["delay_s"]).to_sampled_loop(vehicle, policy.control_period)
        assert row["unstable"] == (loop.growth_rate(row["delay_s"]) > 0.0)


def test_the_oracle_asks_about_the_cells_own_vehicle() -> None:
    suite = suite_of(block(vehicles=("worn", "laden"), delays_ms=(0.0, 250.0)))
    rows = rows_of(suite, "skyhook:gain=35e3")
    for scenario in suite.scenarios:
        vehicle = lateral17(vehicle_parameters(scenario.vehicle), 4, 300.0)
        loop = SkyHook(35e3, 4).to_sampled_loop(vehicle, 0.01)
        expected = loop.growth_rate(scenario.channel.delay) > 0.0
        assert rows[scenario.key]["unstable"] == expected, scenario.key


def test_the_passive_vehicles_stability_is_that_of_its_eigenvalues() -> None:
    suite = suite_of(block(vehicles=("nominal", "worn"), speeds_kmh=(300.0, 900.0)))
    rows = rows_of(suite, "passive")
    found = {}
    for row in rows.values():
        vehicle = lateral17(vehicle_parameters(row["vehicle"]), "passive", row["speed_kmh"])
        found[row["key"]] = count_unstable_alone(vehicle) > 0
        assert row["unstable"] is found[row["key"]]
    assert set(found.values()) == {True, False}


def count_unstable_alone(vehicle: Any) -> int:
    return int(np.sum(np.linalg.eigvals(state_space(vehicle).A).real > 0.0))


def test_a_law_that_is_not_linear_has_no_word_of_the_oracle() -> None:
    place = ("lateral17", "nominal", "4", 300.0)
    for spec in ("semiactive-onoff", "apg-network", f"{BROKEN}Law"):
        assert not is_linear(controller_for(spec, place))
    for spec in ("skyhook", "apg-linear", "lqg-delay:delay={delay}", "reference"):
        assert is_linear(controller_for(spec, place))


def test_growth_is_asked_at_the_very_delay_and_not_beside_it() -> None:
    place = ("lateral17", "nominal", "4", 300.0)
    designs = controller_for("lqg-delay:delay={delay}", place)
    vehicle = lateral_of(place)
    # 0.29 s is a hair below 29 periods as a double, and the run counts 29.
    assert not grows(designs, vehicle, 0.29)
    law: Any = designs.law_at(0.29)  # type: ignore[attr-defined]
    assert law.to_sampled_loop(vehicle, 0.01).growth_rate(0.2899) > 0.0


def test_a_crossing_is_a_crossing_for_both_oracles() -> None:
    system = SkyHook(35e3, 4).to_delay_system(lateral17())
    assert count_unstable(system, 0.21) > count_unstable(system, 0.19) == 0


def test_a_lane_that_ends_is_reported_and_disturbs_no_other() -> None:
    suite = suite_of(block(delays_ms=(0.0, 300.0)))
    rows = rows_of(suite, "skyhook:gain=1e6")
    calm, wild = rows.values()
    assert wild["status"] == "diverged"
    assert wild["saturated_share"] > 0.5
    expected = alone(suite, "skyhook:gain=1e6", suite.scenarios[0])
    assert calm["floor_rms_rear"] == pytest.approx(expected["floor_rms_rear"], rel=1e-12)
