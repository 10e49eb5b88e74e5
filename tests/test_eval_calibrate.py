"""The calibration that stays in the repository gives the frozen values."""

import pytest

from eval.calibrate import first_crossing, fit
from railenv.vehicle import get_vehicle


@pytest.mark.slow
def test_the_frozen_fit_is_what_the_calibration_finds() -> None:
    frozen = get_vehicle("paper_fit").parameters
    found = fit(frozen)
    # frozen to three digits
    assert found.antiroll_stiffness == pytest.approx(frozen.antiroll_stiffness, rel=2e-3)
    assert found.secondary_vertical_damping == pytest.approx(
        frozen.secondary_vertical_damping, rel=2e-3
    )
    crossing = first_crossing(found)
    assert (crossing.delay, crossing.frequency_hz) == pytest.approx((0.202, 1.323), rel=1e-6)
