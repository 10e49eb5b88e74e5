"""The judge of checkpoints: growth rates first, comfort on development tracks second.

A checkpoint is chosen by the oracle. A policy whose linearised loop grows at any judged delay, or
at any judged error of the told delay, loses to every one whose loops all decay; among those the
lower cost wins, the mean over the delays of the logarithm of the worse end's weighted power. A
reward would not do: growth at 0.2 1/s is invisible within seconds and ends in a limit cycle.

Growth rates are computed from the policy linearised at rest and prove nothing; for a network they
are local besides. The gates of a gated policy at rest are not those in motion, so that its law at
rest says little of motion; it is judged by the laws of the gates that it has at each delay on a
drive (`baselines.training.gates_in_motion`), as if they stood still, and by the law at rest: the
larger growth rate counts, and a judgement says so.

For the reader the judge has references: the best sky-hook gain of every delay
(of a grid) and the sharp LQG designed for it, without preview.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from baselines.linear_dynamic import LinearDynamic
from baselines.lqg import DESIGN_TRACK, DelayLqg
from baselines.policies.gated import GatedPolicy
from baselines.policies.policy import HistoryPolicy
from baselines.skyhook import SkyHook
from baselines.training.dev_drive import DevDrive
from baselines.training.gates_in_motion import GateDrive
from baselines.training.judge_settings import CheckpointSettings
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError
from railenv.metrics.ride_filter import ride_index_from_mean_square
from railenv.stability.lifted_roots import at_multiple, just_before
from railenv.units import FloatArray
from railenv.vehicle import lateral17

SKYHOOK_GAINS = (3e3, 5e3, 7.5e3, 10e3, 15e3, 20e3, 25e3, 30e3, 35e3, 45e3, 60e3)
"""Grid of sky-hook gains [N s/m] from which the best of every delay is taken."""

_NOTHING = 1e-12
"""Weighted power of a vehicle that stands still [(m/s^2)^2]; the logarithm wants more than zero."""


@dataclass(frozen=True)
class Judgement:
    """What the judge says of one policy.

    Attributes:
        delays: Delays judged [s].
        told_errors: Errors of the told delay [s].
        growth: Growth rate by told error and delay [1/s]: the largest of all looks that are nearest
            to that delay; not proved.
        ride_index: Estimated ride index at the worse floor end, by delay, told the true delay.
        diverged: Delays at which a drive left the gauge or diverged.
        cost: Mean over the delays of the logarithm of the worse end's weighted power in (m/s^2)^2.
        gates_of_drive: Whether `growth` is of a gated policy, the larger one with the gates of a
            drive and with those at rest; otherwise it is of the law at rest.
    """

    delays: tuple[float, ...]
    told_errors: tuple[float, ...]
    growth: tuple[tuple[float, ...], ...]
    ride_index: tuple[float, ...]
    diverged: tuple[bool, ...]
    cost: float
    gates_of_drive: bool = False

    @property
    def worst_growth(self) -> float:
        """Largest growth rate [1/s]."""
        return max(max(row) for row in self.growth)

    @property
    def stable(self) -> bool:
        """Whether every linearised loop decays and no drive diverged."""
        return self.worst_growth < 0.0 and not any(self.diverged)

    @property
    def rank(self) -> tuple[int, float]:
        """The smaller, the better: stable ones by cost, then the others by growth."""
        if self.stable:
            return 0, self.cost
        return (1, self.cost) if self.worst_growth < 0.0 else (2, self.worst_growth)

    def line(self) -> str:
        """Return the judgement in a line for people."""
        indices = ", ".join(
            f"{index:.2f}{'*' if gone else ''}"
            for index, gone in zip(self.ride_index, self.diverged, strict=True)
        )
        span = f"{1e3 * self.delays[0]:g} to {1e3 * self.delays[-1]:g} ms"
        verdict = "stable" if self.stable else "NOT STABLE"
        law = " with the gates of the drive or at rest" if self.gates_of_drive else ""
        return (
            f"{verdict}: worst growth {self.worst_growth:.3g} 1/s{law}; "
            f"ride index at {span}: {indices}"
        )

    def to_plain(self) -> dict[str, Any]:
        """Return the judgement for JSON."""
        return {
            "delays": list(self.delays),
            "told_errors": list(self.told_errors),
            "growth": [list(row) for row in self.growth],
            "ride_index": list(self.ride_index),
            "diverged": list(self.diverged),
            "cost": self.cost,
            "gates_of_drive": self.gates_of_drive,
        }

    @staticmethod
    def of_plain(plain: dict[str, Any]) -> "Judgement":
        """Return the judgement that `to_plain` wrote."""
        return Judgement(
            tuple(plain["delays"]),
            tuple(plain["told_errors"]),
            tuple(tuple(row) for row in plain["growth"]),
            tuple(plain["ride_index"]),
            tuple(plain["diverged"]),
            float(plain["cost"]),
            bool(plain.get("gates_of_drive", False)),
        )


class Judge:
    """Judges policies of one training run.

    Args:
        environment: Settings of the training environment.
        chosen: Delays, errors and tracks.
    """

    def __init__(self, environment: EnvSettings, chosen: CheckpointSettings) -> None:
        self._environment = environment
        self._chosen = chosen
        self._vehicle = lateral17(environment.vehicle, environment.layout, environment.speed_kmh)
        self._drive = DevDrive(environment, chosen)
        self._looks = _looks(chosen)
        self._gate_drive: GateDrive | None = None

    def judge(self, policy: HistoryPolicy) -> Judgement:
        """Return growth rates and cost of a policy."""
        errors = self._chosen.told_errors if policy.history.is_told else (0.0,)
        power, diverged = self._drive.powers(policy)
        growth: list[tuple[float, ...]] = []
        for error in errors:
            laws, gone = self._laws(policy, error)
            rates = self._rates(laws)
            if isinstance(policy, GatedPolicy):
                rates = np.maximum(rates, self._rates(self._at_rest(policy, error)))
            growth.append(tuple(float(rates[near].max()) for near in self._nearest()))
            diverged |= np.array([gone[near].any() for near in self._nearest()])
        return Judgement(
            delays=self._chosen.delays,
            told_errors=errors,
            growth=tuple(growth),
            ride_index=_indices(power),
            diverged=tuple(bool(gone) for gone in diverged),
            cost=float(np.log(np.maximum(power, _NOTHING)).mean()),
            gates_of_drive=isinstance(policy, GatedPolicy),
        )

    def references(self, tell: Callable[[str], None] = lambda _: None) -> dict[str, Any]:
        """Return what classical laws reach on the same drives, ready for JSON.

        Args:
            tell: Called with the name of every law that has been driven.

        Returns:
            By name, "ride_index" by delay, and "gain" by delay for the sky-hook [N s/m].
        """
        layout = self._environment.layout
        powers: list[FloatArray] = []
        for gain in SKYHOOK_GAINS:
            powers.append(self._drive.powers(SkyHook(gain, layout))[0])
            tell(f"sky-hook {gain:g}")
        best = np.argmin(powers, axis=0)
        lqg: list[float] = []
        for place, delay in enumerate(self._chosen.delays):
            law = self._lqg(delay)
            lqg.append(float(self._drive.powers(law)[0][place]))
            tell(f"lqg-delay {delay:g}")
        return {
            "delays": list(self._chosen.delays),
            "best sky-hook": {
                "ride_index": list(_indices(np.min(powers, axis=0))),
                "gain": [SKYHOOK_GAINS[int(place)] for place in best],
            },
            "lqg-delay": {"ride_index": list(_indices(np.array(lqg)))},
        }

    def _laws(
        self, policy: HistoryPolicy, error: float
    ) -> tuple[list[LinearDynamic], NDArray[np.bool_]]:
        """The law at every look, told with an error, and at which looks a drive diverged.

        A told delay is never negative.
        """
        if not isinstance(policy, GatedPolicy):
            return self._at_rest(policy, error), np.zeros(len(self._looks), dtype=bool)
        told = self._told(error)
        if self._gate_drive is None:
            self._gate_drive = GateDrive(self._environment, self._chosen, self._looks)
        gates, gone = self._gate_drive.gates(policy, error)
        pairs = zip(gates, told, strict=True)
        return [policy.law_with(row, delay) for row, delay in pairs], gone

    def _at_rest(self, policy: HistoryPolicy, error: float) -> list[LinearDynamic]:
        if not policy.history.is_told:
            return [policy.law_at(0.0)] * len(self._looks)
        return [policy.law_at(delay) for delay in self._told(error)]

    def _told(self, error: float) -> list[float]:
        return [max(float(look) + error, 0.0) for look in self._looks]

    def _nearest(self) -> list[NDArray[np.bool_]]:
        """Which looks are nearest to each judged delay."""
        delays = np.array(self._chosen.delays)
        nearest = np.abs(self._looks[:, None] - delays).argmin(axis=1)
        return [nearest == place for place in range(len(delays))]

    def _rates(self, laws: list[LinearDynamic]) -> FloatArray:
        """Growth rates of the linearised loop at every look [1/s]."""
        pairs = zip(laws, self._looks, strict=True)
        return np.array([self._growth(law, float(look)) for law, look in pairs])

    def _growth(self, law: LinearDynamic, delay: float) -> float:
        """Growth rate of the linearised loop on both sides of a delay [1/s]."""
        period = self._environment.control_period
        loop = law.to_sampled_loop(self._vehicle, period, self._environment.actuator())
        place = at_multiple(delay, period)
        rate = loop.growth_rate(place)
        if place > 0.0 and place == at_multiple(round(place / period) * period, period):
            rate = max(rate, loop.growth_rate(just_before(place, period)))
        return rate

    def _lqg(self, delay: float) -> DelayLqg:
        """The sharp design for a delay, for the run's track if its spectrum is rational."""
        period, track = self._environment.control_period, self._environment.tracks()[0]
        try:
            return DelayLqg(self._vehicle, delay, track=track, control_period=period)
        except ArgumentError:
            return DelayLqg(self._vehicle, delay, track=DESIGN_TRACK, control_period=period)


def better(new: Judgement, old: Judgement | None) -> bool:
    """Return whether a judgement beats another; the first of equals stays."""
    return old is None or new.rank < old.rank


def _looks(chosen: CheckpointSettings) -> FloatArray:
    """Return the delays at which growth rates are looked at, rising [s]: the judged ones too."""
    delays = np.array(chosen.delays)
    number = round((delays[-1] - delays[0]) / chosen.growth_step)
    between = np.linspace(delays[0], delays[-1], number + 1)
    # The same delay twice but for rounding would be driven twice.
    apart = np.abs(between[:, None] - delays).min(axis=1) > 1e-9
    return np.sort(np.concatenate([between[apart], delays]))


def _indices(power: FloatArray) -> tuple[float, ...]:
    return tuple(float(value) for value in np.atleast_1d(ride_index_from_mean_square(power)))
