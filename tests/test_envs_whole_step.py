"""The one compiled pass: equal to its parts one after the other, and recompiled with them."""

import numpy as np

from railenv.envs import whole_step as module
from railenv.envs.lanes import Lanes
from railenv.envs.settings import EnvSettings


def lanes(number: int) -> Lanes:
    made = Lanes(EnvSettings(delay=(0.0, 0.3), track_pool=2), number)
    made.generators = [np.random.Generator(np.random.PCG64(k)) for k in range(number)]
    made.reset(np.arange(number), np.zeros((number, len(made.bounds)), dtype=np.float32))
    return made


def test_lanes_beyond_one_group_are_the_same_as_in_one_group() -> None:
    # more lanes than are taken at once, against the last of them alone
    number = module.AT_ONCE + 3
    many, one = lanes(number), lanes(number)
    rng = np.random.default_rng(0)
    only_last = np.zeros(number, dtype=bool)
    only_last[-1] = True
    for _ in range(30):
        actions = rng.uniform(-1.0, 1.0, (number, 4))
        seen = [np.zeros((number, len(many.bounds)), dtype=np.float32) for _ in range(2)]
        earned = [np.zeros(number) for _ in range(2)]
        many.step(actions, np.ones(number, dtype=bool), earned[0], seen[0])
        one.step(actions, only_last, earned[1], seen[1])
        np.testing.assert_array_equal(seen[0][-1], seen[1][-1])
        assert earned[0][-1] == earned[1][-1]


def test_the_compilers_cache_looks_at_the_source_of_every_part() -> None:
    digest = module._digest()  # type: ignore[attr-defined]
    cells = [c.cell_contents for c in module.whole_step.py_func.__closure__]
    assert digest in cells
    files = {part.__name__ for part in module._PARTS}  # type: ignore[attr-defined]
    called = {
        getattr(module, name).py_func.__module__
        for name in ("command", "excite", "issue", "advance", "assess", "observe")
    }
    assert called == files
