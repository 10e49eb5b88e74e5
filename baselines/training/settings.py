"""Settings of a training run: one TOML file, one typed dataclass.

The file has a description, the seed and the budget at its top, and the tables [environment] (fields
of `railenv.envs.settings.EnvSettings`), [policy], [method] (its name, and hyper-parameters of its
own), [checkpoints] and, for a search of hyper-parameters, [search].
"""

from __future__ import annotations

import dataclasses
import typing
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from baselines.policies.history import History
from baselines.training.judge_settings import CheckpointSettings
from baselines.training.method import METHODS, method_class
from baselines.training.search_settings import SearchSettings
from railenv.config import from_mapping, load_toml, to_dict
from railenv.envs.observation import DEFAULT_ACTION_SCALE
from railenv.envs.settings import EnvSettings
from railenv.errors import ArgumentError, check_count, check_not_negative, unknown_name
from railenv.track.seed_domains import TRAINING_POOLS
from railenv.units import Newton, Second

POLICY_CLASSES = ("linear", "network", "recurrent", "gated")
"""Classes of policies that can be trained."""


@dataclass(frozen=True)
class PolicySettings:
    """What the policy sees and what it is made of; the table [policy].

    Attributes:
        kind: "linear", "network", "recurrent" or "gated"; the key in the file is `class`.
        layout: 4 or 2 actuators.
        action: "each" (one action per actuator) or "bogies" (one per bogie).
        sensors: Sensors that it reads; none given means all standard sensors of the layout.
        sensor_lags: Ages of the readings, rising from 0 [control periods].
        action_lags: Ages of its own actions that it sees, rising from 1 [control periods].
        told_knots: Delays with weights of their own, rising from 0 [s]; none: the delay is hidden.
        control_period: Time between actions [s].
        action_scale: Force of an action of one [N].
        hidden: Sizes of the hidden layers of a network; of the recurrent unit for "recurrent" and
            "gated".
        experts: Delays that the sets of gains of a "gated" policy belong to, rising from 0 [s].
        rest_expert: Whether a "gated" policy has one more set of gains, for rest and quiet tracks.
        base: SPEC of a linear law whose action is added, e.g. "skyhook:gain=4e3"; "" for none.
    """

    kind: str
    layout: int = 4
    action: str = "bogies"
    sensors: tuple[str, ...] = ()
    sensor_lags: tuple[int, ...] = (0, 1, 2, 3, 5, 8, 12, 16, 21, 26)
    action_lags: tuple[int, ...] = (1, 2, 3, 6, 9, 12, 15, 18, 21, 24, 27, 30)
    told_knots: tuple[Second, ...] = (0.0, 0.05, 0.1, 0.15, 0.2, 0.25, 0.3)
    control_period: Second = 0.01
    action_scale: Newton = DEFAULT_ACTION_SCALE
    hidden: tuple[int, ...] = ()
    experts: tuple[Second, ...] = ()
    rest_expert: bool = False
    base: str = ""

    def __post_init__(self) -> None:
        if self.kind not in POLICY_CLASSES:
            raise unknown_name("class of policy", self.kind, POLICY_CLASSES)
        if (self.kind == "linear") != (not self.hidden):
            raise ArgumentError(
                f"hidden = {list(self.hidden)} does not fit class = {self.kind!r}; give the sizes "
                "of the layers to a network or a recurrent policy, and none to a linear one"
            )
        if self.kind in ("recurrent", "gated") and len(self.hidden) != 1:
            raise ArgumentError(
                f"hidden = {list(self.hidden)} has {len(self.hidden)} entries; a {self.kind} "
                "policy has one recurrent unit, give its size alone"
            )
        for size in self.hidden:
            check_count("hidden", size)
        self._check_experts()

    def _check_experts(self) -> None:
        if (self.kind == "gated") != bool(self.experts):
            raise ArgumentError(
                f"experts = {list(self.experts)} does not fit class = {self.kind!r}; give the "
                "delays that the sets of gains belong to to a gated policy, and none to another"
            )
        if self.rest_expert and self.kind != "gated":
            raise ArgumentError(
                f"rest_expert = true does not fit class = {self.kind!r}; it is for gated policies"
            )
        delays = [check_not_negative("experts", delay, "seconds") for delay in self.experts]
        if delays and (delays[0] != 0.0 or delays != sorted(set(delays))):
            raise ArgumentError(f"experts = {delays} must rise from 0")

    def history(self) -> History:
        """Return what the policy sees.

        Raises:
            ArgumentError: A sensor does not exist, or lags or knots do not rise.
        """
        history: History = History.of(
            self.layout,
            self.sensors or None,
            sensor_lags=self.sensor_lags,
            action_lags=self.action_lags,
            action=self.action,
            control_period=self.control_period,
            action_scale=self.action_scale,
            told_knots=self.told_knots,
        )
        return history


@dataclass(frozen=True)
class TrainingSettings:
    """Everything that decides what a training run gives.

    Attributes:
        method: Name of the method, see `baselines.training.method.METHODS`.
        description: What the run is for, in a sentence.
        steps: Budget: lane-steps, i.e. control periods summed over the lanes.
        seed: Seed of weights, episodes and updates; the judge has seeds of its own.
        environment: The training environment, with what the policy's history needs filled in.
        policy: What the policy sees and is made of.
        hyper: The method's own settings, a dataclass of its class.
        checkpoints: When checkpoints are written and by what they are judged.
        search: Ranges for `railenv search`; None without a table [search].
    """

    method: str
    description: str
    steps: int
    seed: int
    environment: EnvSettings
    policy: PolicySettings
    hyper: Any
    checkpoints: CheckpointSettings = field(default_factory=CheckpointSettings)
    search: SearchSettings | None = None

    def __post_init__(self) -> None:
        check_count("steps", self.steps)
        check_count("seed", self.seed, minimum=0)
        if self.environment.pool_seed >= TRAINING_POOLS:
            raise ArgumentError(
                f"pool_seed = {self.environment.pool_seed} is among the seeds of the tracks that "
                f"judge and score; training takes its own from seeds below {TRAINING_POOLS}"
            )
        if self.policy.kind == "gated" and self.method != "apg":
            raise ArgumentError(
                f"method {self.method!r} does not train class = 'gated'; choose 'apg'"
            )

    def environment_fields(self) -> dict[str, Any]:
        """Return the environment's settings as keyword arguments, of twin and environment alike."""
        chosen = self.environment
        return {entry.name: getattr(chosen, entry.name) for entry in dataclasses.fields(chosen)}

    def history(self) -> History:
        """Return what the policy sees."""
        return self.policy.history()

    def replace(self, **changes: Any) -> TrainingSettings:
        """Return the same settings with some changed, checked again."""
        return dataclasses.replace(self, **changes)

    def to_plain(self) -> dict[str, Any]:
        """Return the settings as `settings_from` reads them, nothing left to defaults."""
        plain = to_dict(self)
        decided = self.history().environment()
        return {
            "description": self.description,
            "seed": self.seed,
            "steps": self.steps,
            "environment": {
                key: value
                for key, value in plain["environment"].items()
                if key not in decided and value is not None
            },
            "policy": {"class": plain["policy"].pop("kind"), **plain["policy"]},
            "method": {"name": self.method, **to_dict(self.hyper)},
            "checkpoints": plain["checkpoints"],
            **({} if self.search is None else {"search": self.search.to_plain()}),
        }


_TOP = ("description", "seed", "steps")
_TABLES = ("environment", "policy", "method", "checkpoints", "search")


def load_settings(path: Path) -> TrainingSettings:
    """Read the settings of a training run.

    Raises:
        ArgumentError: A key is unknown, missing or of the wrong type, or a value out of its range.
        InputFileError: The file cannot be read or is not TOML.
    """
    return settings_from(load_toml(path), str(path))


def settings_from(values: Mapping[str, Any], where: str) -> TrainingSettings:
    """Build the settings from tables, as TOML or `TrainingSettings.to_plain` has them.

    Args:
        values: The top keys and tables.
        where: Names the origin in messages, e.g. the file.

    Raises:
        ArgumentError: A key is unknown, missing or of the wrong type, or a value out of its range.
    """
    for key in values:
        if key not in (*_TOP, *_TABLES):
            raise ArgumentError(f"{where}: {unknown_name('key', key, (*_TOP, *_TABLES))}")
    missing = [key for key in (*_TOP, *_TABLES[:3]) if key not in values]
    if missing:
        raise ArgumentError(f"{where}: missing {', '.join(missing)}; every one must be given")
    tables = {name: _table(values, name, where) for name in _TABLES}
    policy_table = dict(tables["policy"])
    if "kind" in policy_table or "class" not in policy_table:
        raise ArgumentError(
            f"{where}: [policy] must say class = one of {', '.join(POLICY_CLASSES)}"
        )
    policy_table["kind"] = policy_table.pop("class")
    policy = from_mapping(PolicySettings, policy_table, f"{where}: [policy]")
    decided = policy.history().environment()
    for key in tables["environment"]:
        if key in decided:
            raise ArgumentError(
                f"{where}: [environment] {key} follows from what the policy sees; leave it out and "
                "set layout, action, action_scale, control_period, lags and told_knots in [policy]"
            )
    environment = from_mapping(
        EnvSettings, {**tables["environment"], **decided}, f"{where}: [environment]"
    )
    method_table = dict(tables["method"])
    name = method_table.pop("name", None)
    if not isinstance(name, str):
        raise ArgumentError(f"{where}: [method] must say name = one of {', '.join(METHODS)}")
    hyper = method_class(name).hyper_parameters(name)
    top = from_mapping(_Top, {key: values[key] for key in _TOP}, where)
    return TrainingSettings(
        method=name,
        description=top.description,
        steps=top.steps,
        seed=top.seed,
        environment=environment,
        policy=policy,
        hyper=from_mapping(hyper, method_table, f"{where}: [method]"),
        checkpoints=from_mapping(
            CheckpointSettings, tables["checkpoints"], f"{where}: [checkpoints]"
        ),
        search=SearchSettings.of(tables["search"], where) if "search" in values else None,
    )


@dataclass(frozen=True)
class _Top:
    """The keys above the tables."""

    description: str
    seed: int
    steps: int


def _table(values: Mapping[str, Any], name: str, where: str) -> Mapping[str, Any]:
    table = values.get(name, {})
    if not isinstance(table, Mapping):
        raise ArgumentError(f"{where}: {name} = {table!r} must be a table [{name}]")
    return typing.cast("Mapping[str, Any]", table)
