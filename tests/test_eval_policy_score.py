"""Scores of policies: runs on the scoring tracks, references, the oracle's numbers."""

from dataclasses import replace

import numpy as np
import pytest

from baselines import make_controller
from baselines.policies import History, LinearPolicy
from baselines.policies.policy import HistoryPolicy
from baselines.training.dev_drive import DEV_POOL
from eval.policy_score import Depth, comparison, families, run_policy, score, stability
from eval.policy_score_oracle import FINEST, growth, growth_rates, stable_windows
from eval.policy_score_references import (
    DESIGNED,
    PASSIVE,
    SINGLE,
    SKYHOOK,
    YARDSTICK,
    References,
    passive_and_skyhook,
    with_designs,
)
from eval.policy_score_runs import SCORING_SEEDS, Trial, comfort_of
from eval.policy_score_text import screen
from eval.policy_score_transfer import Case, cases, transfer_text, transferred
from eval.told_designs import ToldDesigns
from eval.zoo import SKYHOOK_GAINS
from railenv.errors import ArgumentError
from railenv.stability import sampled_windows
from railenv.stability.lifted_roots import just_before
from railenv.track.seed_domains import TRAINING_SEEDS
from railenv.vehicle import get_vehicle, lateral17

TRIAL = Trial(tracks=2, seconds=5.0, skip=2.0, delays=(0.0, 0.1))
VEHICLE = lateral17("paper_fit", "4", 300.0)
ACCELEROMETERS = ("floor_front_lateral_acceleration", "floor_rear_lateral_acceleration")
SENSORS = tuple(f"carbody_lateral_velocity_{k}" for k in (1, 2, 3, 4))


def hook(*gains: float, knots: tuple[float, ...] = ()) -> HistoryPolicy:
    """Return the sky-hook as a policy, with a gain per knot of the told delay."""
    history = History("4", SENSORS, (1.0,) * 4, action="each", told_knots=knots, action_scale=30e3)
    weights = np.stack([-gain / 30e3 * np.eye(4) for gain in gains])
    return LinearPolicy(history, weights)


@pytest.fixture(scope="module")
def references() -> References:
    return with_designs(passive_and_skyhook(TRIAL), TRIAL)


@pytest.fixture
def few_gains(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("eval.policy_score_references.SKYHOOK_GAINS", (10e3, 45e3))


def test_scoring_tracks_are_far_from_those_of_training() -> None:
    assert SCORING_SEEDS > 100 * TRAINING_SEEDS > 100 * DEV_POOL


@pytest.mark.slow
def test_a_policy_that_is_the_sky_hook_scores_like_it() -> None:
    own = comfort_of(hook(15e3), TRIAL)
    law = comfort_of(make_controller("skyhook:gain=15e3"), TRIAL)
    # The policy works in units of its action, so that products round otherwise.
    np.testing.assert_allclose(own.front, law.front, rtol=1e-9)
    np.testing.assert_allclose(own.rear, law.rear, rtol=1e-9)
    np.testing.assert_allclose(own.force, law.force, rtol=1e-9)


@pytest.mark.slow
def test_a_told_error_moves_the_gain_and_nothing_else() -> None:
    told = hook(5e3, 25e3, knots=(0.0, 0.2))
    own = comfort_of(told, replace(TRIAL, delays=(0.1,)), told_error=-0.05)
    law = comfort_of(make_controller("skyhook:gain=10e3"), replace(TRIAL, delays=(0.1,)))
    np.testing.assert_allclose(own.front, law.front, rtol=1e-9)  # rounding, as above


@pytest.mark.slow
def test_laws_side_by_side_run_as_each_by_itself() -> None:
    laws = [make_controller(f"skyhook:gain={gain}") for gain in (10e3, 20e3)]
    both = comfort_of(ToldDesigns(dict(zip(TRIAL.delays, laws, strict=True)).__getitem__), TRIAL)
    for k, law in enumerate(laws):
        alone = comfort_of(law, TRIAL)
        assert np.array_equal(both.front[k], alone.front[k])
        assert np.array_equal(both.force[k], alone.force[k])


@pytest.mark.slow
def test_noise_pairs_lane_for_lane_and_a_track_does_not_depend_on_their_number() -> None:
    law = make_controller("skyhook:gain=10e3")
    one, two = comfort_of(law, replace(TRIAL, delays=(0.0,))), comfort_of(law, TRIAL)
    assert np.array_equal(one.front[0], two.front[0])


@pytest.mark.slow
def test_the_passive_vehicle_is_the_same_at_every_delay(references: References) -> None:
    passive = references.rows[PASSIVE]
    assert np.array_equal(passive.front[0], passive.front[1])


@pytest.mark.slow
def test_no_gain_of_the_grid_beats_the_best_sky_hook(references: References) -> None:
    best = references.rows[SKYHOOK]
    for gain in (3e3, 10e3, 60e3):
        law = comfort_of(make_controller(f"skyhook:gain={gain}"), TRIAL)
        stable = ~law.lost & np.array([gain < 60e3 or d == 0.0 for d in TRIAL.delays])
        assert np.all(best.worse[stable] <= law.worse[stable])
    assert set(references.gains) <= set(SKYHOOK_GAINS)


def test_the_best_single_gain_is_one_law_at_all_delays(references: References) -> None:
    assert references.single_gain is not None
    law = comfort_of(make_controller(f"skyhook:gain={references.single_gain}"), TRIAL)
    assert np.array_equal(references.rows[SINGLE].front, law.front)


def test_full_information_beats_what_has_to_measure(references: References) -> None:
    best = references.rows[YARDSTICK].worse
    for name in DESIGNED:
        # Alike to the noise of two tracks of 5 s where forces are alike.
        assert np.all(references.rows[name].worse > best - 0.05), name


@pytest.mark.slow
def test_an_lqg_for_the_wrong_delay_is_worse_than_for_the_right_one() -> None:
    nothing = References({}, np.full(1, np.nan), None)
    rows = with_designs(nothing, replace(TRIAL, delays=(0.1,)), errors=(0.02,)).rows
    wrong, right = rows["LQG, told 20 ms too much"], rows["LQG, told the delay"]
    assert np.all(wrong.worse > right.worse + 0.1)


def test_a_gain_that_grows_is_no_best_gain(monkeypatch: pytest.MonkeyPatch) -> None:
    # 0.18 s is just beyond the critical delay of 45 kN s/m: 7 s do not show that it grows.
    trial = replace(TRIAL, tracks=1, delays=(0.18,))
    assert not comfort_of(make_controller("skyhook:gain=45e3"), trial).lost[0]
    monkeypatch.setattr("eval.policy_score_references.SKYHOOK_GAINS", (45e3,))
    found = passive_and_skyhook(trial)
    assert np.isnan(found.gains[0])
    assert found.single_gain is None
    assert found.rows[SKYHOOK].lost[0]


def test_rows_and_margins_fit_together(references: References) -> None:
    scored = run_policy("own", hook(10e3), TRIAL)
    rows, beside = comparison([scored], references, TRIAL)
    row = rows["own"]["delay hidden"]
    for k in range(2):
        assert row["worse"][k] == pytest.approx(max(row["front"][k], row["rear"][k]))
        margin = row["margins"][PASSIVE]["value"][k]
        assert margin == pytest.approx(beside[PASSIVE]["worse"][k] - row["worse"][k])


@pytest.mark.slow
def test_policies_of_one_recipe_are_a_family() -> None:
    trial = replace(TRIAL, tracks=1, delays=(0.0,))
    scored = [
        run_policy(name, hook(gain), trial, recipe)
        for name, gain, recipe in (("a", 8e3, "r"), ("b", 9e3, "r"), ("c", 9e3, "s"))
    ]
    ((name, members),) = families(scored)
    assert name == "a and 1 more seeds"
    assert [m.name for m in members] == ["a", "b"]


def test_growth_of_a_policy_is_that_of_the_law_it_is() -> None:
    law = make_controller("skyhook:gain=35e3")
    for delay in (0.0, 0.103, 0.21):
        own = growth(hook(35e3), VEHICLE, delay, 0.0)
        assert own == pytest.approx(growth(law, VEHICLE, delay, 0.0), abs=1e-9)  # rounding


def test_the_oracle_hears_the_told_delay() -> None:
    told = hook(5e3, 25e3, knots=(0.0, 0.2))
    expected = growth(hook(10e3), VEHICLE, 0.1, 0.0)
    found = growth_rates(told, VEHICLE, (0.1,), told_error=-0.05)
    assert found == pytest.approx([expected], abs=1e-9)  # rounding


def test_growth_at_a_jump_is_that_of_its_worse_side() -> None:
    for gain, worse in ((-2.0, 0), (6.0, 1)):
        history = History("4", ACCELEROMETERS, (1.0,) * 2, action_scale=1e3)
        law = LinearPolicy(history, gain * np.eye(2)[None])
        loop = law.to_sampled_loop(VEHICLE, 0.01)
        sides = loop.growth_rate(0.1), loop.growth_rate(just_before(0.1, 0.01))
        assert np.argmax(sides) == worse
        assert abs(sides[0] - sides[1]) > 1e-3
        assert growth(law, VEHICLE, 0.1, 0.1) == max(sides)


@pytest.mark.slow
def test_stable_windows_end_where_the_sampled_crossing_is() -> None:
    found = stable_windows(hook(35e3), VEHICLE, longest=0.3)
    law = make_controller("skyhook:gain=35e3")
    loop = law.to_sampled_loop(VEHICLE, 0.01)  # type: ignore[attr-defined]
    crossing = sampled_windows(loop, 0.3).critical_delay
    assert crossing is not None
    assert found["critical_delay_s"] == pytest.approx(crossing, abs=FINEST)
    assert found["windows_s"] == [(0.0, found["critical_delay_s"])]
    assert found["proved"] is False


def test_a_loop_that_is_unstable_without_delay_has_critical_delay_zero() -> None:
    found = stable_windows(hook(-10e3), VEHICLE, longest=0.01)
    assert (found["critical_delay_s"], found["windows_s"]) == (0.0, [])


def test_a_loop_that_stays_stable_has_no_critical_delay() -> None:
    found = stable_windows(hook(5e3), VEHICLE, longest=0.1)
    assert (found["critical_delay_s"], found["windows_s"]) == (None, [(0.0, 0.1)])


def test_a_controller_without_oracle_is_judged_by_its_runs_alone() -> None:
    law = make_controller("semiactive-onoff")
    depth = Depth(trial=TRIAL, growth_delays=(0.0,), simulated=())
    assert stability(law, depth) == {"simulated": {}}


@pytest.mark.slow
@pytest.mark.usefixtures("few_gains")
def test_a_score_says_on_the_screen_what_it_is_and_what_comes_next() -> None:
    trial = replace(TRIAL, tracks=1, delays=(0.0,))
    depth = Depth(trial, growth_delays=(0.0,), windows=False, simulated=())
    answer = score([("own", hook(10e3), None)], depth)
    text = screen(answer, "railenv certify")
    for word in ("seeds from 1000000000", "own, delay hidden", "best sky-hook", "not proved"):
        assert word in text
    assert text.endswith("next: railenv certify")
    assert max(map(len, text.splitlines())) <= 120


def test_a_case_changes_one_thing_of_the_trial() -> None:
    titles = {case.title: case.trial for case in cases(TRIAL, TRIAL)}
    changed = titles["300 km/h, laden (carbody 1.25 times as heavy)"].parameters
    base = get_vehicle("paper_fit").parameters
    assert not isinstance(changed, str)
    assert changed.carbody_mass == 1.25 * base.carbody_mass
    assert changed.bogie_mass == base.bogie_mass
    assert titles["300 km/h, track TB/T 3352"] == replace(TRIAL, track="tb3352")
    assert titles["200 km/h"] == replace(TRIAL, speed_kmh=200.0)


def test_a_vehicle_that_hunts_by_itself_is_said_to() -> None:
    worn = get_vehicle("paper_fit").parameters.replace(conicity=0.6)
    trial = replace(TRIAL, tracks=1, delays=(0.1,), parameters=worn, speed_kmh=400.0)
    assert Case("sharp wheels", trial).hunts
    assert not Case("as it is", TRIAL).hunts


def test_what_fails_elsewhere_is_said_in_words() -> None:
    answer = {
        "title": "somewhere",
        "hunts": True,
        "tracks": 2,
        "delays_s": [0.1, 0.2],
        "gains": [None, 5e3],
        "rows": {"own": {"worse": [None, 3.0], "force_rms": [None, 20e3], "diverged": [True] * 2}},
    }
    text = transfer_text(answer)
    for word in ("| own | diverges | 3.00 * (20.00) |", "by itself (hunting)", "none, 5 kN s/m"):
        assert word in text


@pytest.mark.slow
@pytest.mark.usefixtures("few_gains")
def test_a_case_runs_policies_beside_references() -> None:
    case = Case("here", replace(TRIAL, tracks=1, delays=(0.1,)))
    answer = transferred(case, [("own", hook(10e3))])
    assert list(answer["rows"]) == [PASSIVE, SKYHOOK, "own"]
    own = comfort_of(hook(10e3), case.trial)
    assert answer["rows"]["own"]["worse"] == own.worse.tolist()


@pytest.mark.parametrize(
    ("field", "value", "words"),
    [
        ("tracks", 0, "tracks = 0"),
        ("tracks", 101, "tracks = 101 is too large"),
        ("seconds", 4.0, "seconds = 4 is less than one segment"),
        ("delays", (), "delays is empty"),
        ("delays", (-0.1,), "delays = -0.1"),
        ("model", "full51", "model = 'full51'"),
    ],
)
def test_a_trial_that_cannot_be_run_is_refused(field: str, value: object, words: str) -> None:
    with pytest.raises(ArgumentError, match=words):
        replace(TRIAL, **{field: value})
