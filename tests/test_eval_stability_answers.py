"""The root locus: every crossing has its branch, and following does not jump."""

import numpy as np
import pytest

from baselines import SkyHook
from eval.stability_answers import root_locus
from railenv.stability import Mode, critical_delays, follow
from railenv.vehicle import lateral17


@pytest.mark.slow
@pytest.mark.parametrize(
    ("gain", "layout"),
    [(60e3, 4), *(pytest.param(*case, marks=pytest.mark.slow) for case in ((35e3, 4), (60e3, 2)))],
)
def test_every_crossing_lies_on_a_branch(gain: float, layout: int) -> None:
    vehicle = lateral17(layout=layout)
    loop = SkyHook(gain, layout).to_delay_system(vehicle)
    locus = root_locus(loop, vehicle)
    found = []
    for mode in locus["modes"]:
        re = np.array([np.nan if value is None else value for value in mode["re"]])
        for k in np.flatnonzero((re[:-1] < 0.0) & (re[1:] >= 0.0)):
            share = re[k] / (re[k] - re[k + 1])
            found.append(locus["delay_s"][k] + share * 0.004)
    expected = [c.delay for c in critical_delays(loop, 0.3).crossings]
    # linear between points 4 ms apart
    assert sorted(found) == pytest.approx(expected, abs=1e-4)


@pytest.mark.slow
def test_a_branch_moves_in_small_steps() -> None:
    vehicle = lateral17(layout=4)
    locus = root_locus(SkyHook(60e3, 4).to_delay_system(vehicle), vehicle)
    for mode in locus["modes"]:
        s = np.array(
            [
                np.nan if a is None else complex(a, b)
                for a, b in zip(mode["re"], mode["im"], strict=True)
            ]
        )
        step = np.abs(np.diff(s)) / np.abs(s[1:])
        # the newest branches move fastest, some 20 % in 4 ms; a jump to a neighbour is 40 % or more
        assert np.nanmax(step, initial=0.0) < 0.35


def test_following_prefers_the_shape_where_roots_come_close() -> None:
    weight = np.ones(2)
    first, second = np.array([1.0 + 0j, 0.0]), np.array([0.0j, 1.0])
    before = [Mode(-1 + 10j, first), Mode(-1 + 10.1j, second)]
    after = [Mode(-1 + 10.1j, first), Mode(-1 + 10j, second)]
    assert follow(before, after, weight) == after


def test_a_step_beyond_the_limit_ends_the_branch() -> None:
    shape = np.array([1.0 + 0j])
    here, there = [Mode(-1 + 10j, shape)], [Mode(-1 + 30j, shape)]
    assert follow(here, there, np.ones(1), limit=0.5) == [None]
    assert follow(here, [], np.ones(1)) == [None]
