"""Controllers with one thing wrong, named `py:broken_controllers:...`, for the tests."""

import os
import time
from typing import Any

import numpy as np


class Law:
    """Sky-hook of 10 kN s/m with four actuators, as a user would write it."""

    def reset(self, num_lanes: int, seed: int) -> None:
        self.lanes = num_lanes

    def act(self, observations: np.ndarray) -> np.ndarray:
        return -10e3 / 3e3 * observations[:, :4]


class Raises(Law):
    def act(self, observations: np.ndarray) -> np.ndarray:
        raise RuntimeError("gave up")


class RaisesInReset(Law):
    def reset(self, num_lanes: int, seed: int) -> None:
        raise RuntimeError("not today")


class RaisesLate(Law):
    """Fails after three seconds of a run."""

    def reset(self, num_lanes: int, seed: int) -> None:
        self.steps = 0

    def act(self, observations: np.ndarray) -> np.ndarray:
        self.steps += 1
        if self.steps > 300:
            raise ZeroDivisionError("late")
        return super().act(observations)


class Nan(Law):
    def act(self, observations: np.ndarray) -> np.ndarray:
        return np.full((len(observations), 4), np.nan)


class WrongShape(Law):
    def act(self, observations: np.ndarray) -> np.ndarray:
        return super().act(observations)[0]


class Complex(Law):
    def act(self, observations: np.ndarray) -> Any:
        return super().act(observations) + 0j


class BeyondColumns(Law):
    def act(self, observations: np.ndarray) -> np.ndarray:
        return -observations[:, 200:204]


class Newtons(Law):
    """Returns forces [N] where actions of 3 kN are meant."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        return -10e3 * observations[:, :4]


class WrongSign(Law):
    def act(self, observations: np.ndarray) -> np.ndarray:
        return -super().act(observations)


class Faint(Law):
    def act(self, observations: np.ndarray) -> np.ndarray:
        return 1e-6 * super().act(observations)


class Forgetful(Law):
    """Has a filter that `reset` leaves as it is."""

    def __init__(self) -> None:
        self.mean = 0.0

    def act(self, observations: np.ndarray) -> np.ndarray:
        self.mean = 0.9 * self.mean + 0.1 * float(observations[0, 0])
        return super().act(observations) - self.mean


class Unseeded(Law):
    def act(self, observations: np.ndarray) -> np.ndarray:
        noise = np.random.default_rng().normal(size=(len(observations), 4))
        return super().act(observations) + 0.01 * noise


class Shared(Law):
    """Feeds back the mean of all lanes."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        mean = observations.mean(axis=0, keepdims=True)
        return super().act(np.repeat(mean, len(observations), axis=0))


class OddPeriod(Law):
    """Decides every 35 ms, and no run is a whole number of those."""

    control_period = 0.035


class Hangs(Law):
    def act(self, observations: np.ndarray) -> np.ndarray:
        while True:
            time.sleep(0.01)


class EatsMemory(Law):
    def act(self, observations: np.ndarray) -> np.ndarray:
        self.kept = getattr(self, "kept", [])
        while True:
            self.kept.append(np.ones(2**22))  # written to, so that it is resident


class Exits(Law):
    def act(self, observations: np.ndarray) -> np.ndarray:
        os._exit(3)


class OnlyTwo(Law):
    """Acts on two channels, whatever it is asked for."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        return -observations[:, :2]


class Told(Law):
    """Notes what it is told."""

    def tell(self, delays: np.ndarray) -> None:
        self.told = delays.copy()

    def act(self, observations: np.ndarray) -> np.ndarray:
        # The mean delay decides the gain, so that a wrong one shows.
        return -(1.0 - 2.0 * self.told[:, None]) * observations[:, :4]


class ToldTheFirst(Told):
    """Takes the first lane's delay for that of all."""

    def tell(self, delays: np.ndarray) -> None:
        super().tell(np.full(len(delays), delays[0]))


class SizedOnce(Law):
    """Has a filter for as many lanes as the first run had."""

    def reset(self, num_lanes: int, seed: int) -> None:
        if not hasattr(self, "mean"):
            self.mean = np.zeros((num_lanes, 4))
        self.mean[:] = 0.0

    def act(self, observations: np.ndarray) -> np.ndarray:
        self.mean += 0.1 * (observations[:, :4] - self.mean)
        return -self.mean


class NanAtTheEnd(Law):
    """Fails after four and a half seconds of a run."""

    def reset(self, num_lanes: int, seed: int) -> None:
        self.steps = 0

    def act(self, observations: np.ndarray) -> np.ndarray:
        self.steps += 1
        return super().act(observations) * (np.nan if self.steps > 450 else 1.0)


class OfTheClass(Law):
    """Counts steps in the class, for all of its objects and runs."""

    steps = 0

    def act(self, observations: np.ndarray) -> np.ndarray:
        OfTheClass.steps += 1
        return super().act(observations) * (1.0 + 1e-4 * OfTheClass.steps)


class Overwrites(Told):
    """Writes to what it is given."""

    def tell(self, delays: np.ndarray) -> None:
        super().tell(delays)
        delays += 1.0

    def act(self, observations: np.ndarray) -> np.ndarray:
        actions = super().act(observations)
        observations[:] = 0.0
        return actions


class RaisesWarnings(Law):
    """Makes numpy raise where it would warn, for the whole program."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        np.seterr(all="raise")
        return super().act(observations)


class SinglePrecision(Law):
    def act(self, observations: np.ndarray) -> Any:
        return super().act(observations.astype(np.float32)).astype(np.float32)


class View(Law):
    """Returns a part of what it is given."""

    action_scale = 1e3

    def act(self, observations: np.ndarray) -> np.ndarray:
        return observations[:, :4]


class Loops(Law):
    """Takes its lanes one by one, and its time."""

    def act(self, observations: np.ndarray) -> np.ndarray:
        time.sleep(1e-4 * len(observations))
        return super().act(observations)


def nothing() -> None:
    """Return no controller."""


def not_made() -> Law:
    raise RuntimeError("no licence")


def exits_when_made() -> Law:
    os._exit(4)
