"""Long fast runs of drawn vehicles: nothing but numbers comes out, and derailment is told."""

import numpy as np
import pytest

from eval.full50_endurance import Endurance, drawn_vehicles, main, run
from railenv.simulation.full_stepping import DERAILED, DERAILMENT_SHIFT, RUNNING
from railenv.vehicle.nonlinear import ContactSettings


def check(found: Endurance, seconds: float) -> None:
    """Nothing is lost: a run is finite, and one that ends early or leaves the rails says so."""
    assert found.finite.all()
    assert np.all((found.end_time == seconds) | (found.ended != RUNNING))
    assert np.all((found.shift <= DERAILMENT_SHIFT) | (found.ended == DERAILED))


def test_drawn_vehicles_run_fast_and_whatever_happens_is_told() -> None:
    vehicles = drawn_vehicles(3, 350.0, 1, ContactSettings())
    assert len({v.parameters.lateral.carbody_mass for v in vehicles}) == 3
    check(run(vehicles, "fra6", 3.0, threads=2), 3.0)


def test_the_number_of_threads_changes_nothing() -> None:
    vehicles = drawn_vehicles(3, 350.0, 2, ContactSettings())
    one, two = (run(vehicles, "tb3352", 1.0, threads=n) for n in (1, 2))
    np.testing.assert_array_equal(one.quotient, two.quotient)
    np.testing.assert_array_equal(one.shift, two.shift)


def test_a_derailing_run_ends_with_its_time_and_stays_finite() -> None:
    vehicles = drawn_vehicles(2, 350.0, 1, ContactSettings(friction=0.6))
    found = run(vehicles, "fra6:level=10", 2.0, threads=1)
    check(found, 2.0)
    derailed = found.ended == DERAILED
    assert derailed.any()
    assert np.all(found.end_time[derailed] < 2.0)
    assert np.all(found.shift[derailed] > 0.006)


@pytest.mark.slow
@pytest.mark.parametrize("track", ["tb3352", "fra6"])
def test_a_hundred_drawn_vehicles_run_a_minute_at_350_kmh(track: str) -> None:
    # Two and a half minutes of one core; what becomes of the runs is in docs/full50.md.
    check(run(drawn_vehicles(100, 350.0, 1, ContactSettings()), track, 60.0), 60.0)


@pytest.mark.slow
@pytest.mark.parametrize("friction", [0.05, 0.6])
def test_slippery_and_sticky_rails_give_numbers_too(friction: float) -> None:
    vehicles = drawn_vehicles(4, 350.0, 3, ContactSettings(friction=friction))
    check(run(vehicles, "fra6", 20.0), 20.0)


@pytest.mark.slow
def test_command_prints_what_became_of_the_runs(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--vehicles", "2", "--seconds", "2", "--track", "tb3352"]) == 0
    assert "| tb3352 | 2 | 2 | 0 | 0 | 0 |" in capsys.readouterr().out
