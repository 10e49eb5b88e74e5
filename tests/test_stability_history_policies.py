"""Policies around a vehicle as loops of finite history: the same loop, proved over ranges."""

import json

import numpy as np
import pytest

from baselines.policies import History, LinearPolicy, NetworkPolicy, save_trained
from baselines.policies.history_loop import has_history_loop, to_history_loop
from baselines.registry import make_controller
from eval.cli import main
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError
from railenv.stability import certify
from railenv.stability.verifier import verify_certificate
from railenv.vehicle import lateral17

PERIOD = 0.01
VELOCITIES = tuple(f"carbody_lateral_velocity_{k}" for k in (1, 2, 3, 4))


@pytest.fixture(scope="module")
def vehicle():
    return lateral17("paper_fit", 4, 300.0)


def damping_policy(gains=(0.0,), knots=(), base=None, seed=None, **fields):
    """Each bogie's mean velocity times a gain [N s/m per actuator], one per knot."""
    history = History.of(4, VELOCITIES, told_knots=knots, **fields)
    weights = np.zeros((history.num_knots, 2, history.num_features))
    for knot, gain in enumerate(gains):
        for column, scale in enumerate(history.scales):
            weights[knot, column // 2, column] = -gain / 2 * scale / history.action_scale
    if seed is not None:
        weights += 0.002 * np.random.default_rng(seed).normal(size=weights.shape)
    return LinearPolicy(history, weights, base)


@pytest.mark.parametrize("with_base", [False, True])
def test_the_loop_is_that_of_the_policy_s_own_law(vehicle, with_base):
    # Sky-hook reads velocities; the history reads three of them and a stroke.
    base = make_controller("skyhook", layout=4) if with_base else None
    sensors = (*VELOCITIES[:3], "suspension_stroke_1")
    history = History.of(
        4, sensors, sensor_lags=(0, 2), action_lags=(1, 3), told_knots=(0.0, 0.05, 0.2)
    )
    weights = 0.05 * np.random.default_rng(3).normal(size=(3, 2, history.num_features))
    policy = LinearPolicy(history, weights, base)
    for actuator in (None, ActuatorSpec(lag=0.02)):
        system = to_history_loop(policy, vehicle, PERIOD, actuator)
        for delay, told in ((0.0, 0.0), (0.034, 0.02), (0.2, 0.21)):
            other = policy.law_at(told).to_sampled_loop(vehicle, PERIOD, actuator)
            # Two realisations of one loop: eigenvalues to rounding.
            assert system.growth_rate(delay, told) == pytest.approx(
                other.growth_rate(delay), abs=1e-6
            )


def test_only_linear_policies_of_finite_history_have_such_a_loop(vehicle):
    policy = damping_policy((5e3,))
    assert has_history_loop(policy)
    assert not has_history_loop(make_controller("skyhook", layout=4))
    network = NetworkPolicy(
        policy.history, policy.weights, [(np.zeros((2, policy.history.num_features)), np.zeros(2))]
    )
    dynamic = damping_policy((5e3,), base=make_controller("lqg", layout=4))
    for other in (network, dynamic):
        assert not has_history_loop(other)
        with pytest.raises(ArgumentError, match="finite history"):
            to_history_loop(other, vehicle, PERIOD)
    with pytest.raises(ArgumentError, match="control_period"):
        to_history_loop(policy, vehicle, 0.02)
    with pytest.raises(ArgumentError, match="layout"):
        to_history_loop(policy, lateral17("paper_fit", 2, 300.0), PERIOD)


@pytest.mark.slow
def test_a_policy_is_certified_over_delays_and_told_delays_on_the_command_line(capsys, tmp_path):
    policy = damping_policy((10e3, 5e3), knots=(0.0, 0.05))
    save_trained(policy, tmp_path / "policy", {})
    question = ["certify", "--controller", str(tmp_path / "policy"), "--control-period", "0.01"]
    status = main([*question, "--delay", "0:0.014", "--told-error", "0.02", "--json"])
    plain = json.loads(capsys.readouterr().out)
    assert (status, plain["verdict"], plain["claim"]["kind"]) == (0, "STABLE", "sampled history")


@pytest.mark.slow
def test_a_saved_certificate_of_a_policy_is_proved_anew_and_is_about_that_policy(capsys, tmp_path):
    for name, gain in (("one", -3e4), ("other", -2e4)):
        save_trained(damping_policy((gain,)), tmp_path / name, {})
    saved = str(tmp_path / "c.json")

    def question(name):
        return ["--controller", str(tmp_path / name), "--control-period", "0.01"]

    assert main(["certify", *question("one"), "--delay", "0.004:0.005", "--save", saved]) == 3
    assert main(["certify", "--verify", saved, *question("one")]) == 0
    assert "accepted" in capsys.readouterr().out
    assert main(["certify", "--verify", saved, *question("other")]) == 1


@pytest.mark.slow
def test_the_answer_names_range_period_and_error(capsys, tmp_path):
    policy = damping_policy((-3e4, -3e4), knots=(0.0, 0.1))
    save_trained(policy, tmp_path / "policy", {})
    question = ["certify", "--controller", str(tmp_path / "policy"), "--control-period", "0.01"]
    assert main([*question, "--delay", "0:0.01", "--told-error", "0.02"]) == 3
    said = capsys.readouterr().out
    assert "at some constant delay from 0 to 10 ms, sampled every 10 ms, told with an error" in said
    assert "eigenvalues outside the unit circle at delay" in said


@pytest.mark.slow
@pytest.mark.parametrize("lag", [0.0, 0.02])
def test_sky_hook_as_a_policy_has_the_verdicts_of_the_other_proof(vehicle, lag):
    base = make_controller("skyhook", layout=4)
    policy = damping_policy(base=base)
    actuator = ActuatorSpec(lag=lag) if lag else None
    system = to_history_loop(policy, vehicle, PERIOD, actuator)
    other = policy.law_at().to_sampled_loop(vehicle, PERIOD, actuator)
    low, high = 0.05, 0.4
    while high - low > 1e-5:
        middle = (low + high) / 2
        low, high = (middle, high) if system.growth_rate(middle) < 0.0 else (low, middle)
    for shift in (-5e-4, 5e-4):
        delay = low + shift
        assert certify(system, delay).verdict == certify(other, delay).verdict
    assert certify(system, (0.0, low - 5e-4)).verdict == "STABLE"
    assert certify(system, (0.0, low + 5e-4)).verdict == "UNSTABLE"


@pytest.mark.slow
def test_a_long_history_with_a_schedule_is_proved_over_the_whole_range(vehicle):
    # As large as a trained policy: ten ages of readings, thirty of actions, eight knots. A little
    # noise in every gain, so that none of them is idle.
    policy = damping_policy(
        (20e3, 20e3, 15e3, 10e3, 8e3, 8e3, 6e3, 6e3),
        knots=(0.0, 0.02, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3),
        seed=1,
        sensor_lags=(0, 1, 2, 3, 5, 8, 12, 16, 21, 26),
        action_lags=tuple(range(1, 31)),
    )
    system = to_history_loop(policy, vehicle, PERIOD)
    worst = max(
        system.growth_rate(delay, max(delay + e, 0.0))
        for delay in np.linspace(0.0, 0.3, 16)
        for e in (-0.02, 0.0, 0.02)
    )
    assert worst < 0.0
    assert certify(system, (0.0, 0.3), told_error=0.02).verdict == "STABLE"


@pytest.mark.slow
def test_a_proof_for_a_vehicle_is_found_again_by_the_verifier(vehicle, tmp_path):
    system = to_history_loop(damping_policy((10e3, 5e3), knots=(0.0, 0.05)), vehicle, PERIOD)
    certificate = certify(system, (0.0, 0.014), told_error=0.02)
    assert certificate.verdict == "STABLE"
    certificate.save(tmp_path / "c.json")
    result = verify_certificate(tmp_path / "c.json", system)
    assert result.accepted, result.reasons
