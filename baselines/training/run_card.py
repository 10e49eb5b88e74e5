"""The card of a trained policy: where it comes from, what the judge said, where it ends."""

from typing import Any

from baselines.training.judge import Judgement
from baselines.training.settings import TrainingSettings

_WITH_MODEL = {
    "apg": "trained by differentiating the model of the vehicle: not model-free",
    "imitation": "imitates a law designed with the model of the vehicle: not model-free",
}


def training_card(
    settings: TrainingSettings,
    command: str,
    origin: dict[str, Any],
    steps: int,
    judgement: Judgement,
    interruptions: list[int],
) -> dict[str, Any]:
    """Return what a policy's card says of its training.

    Times are not in it, so that a run that was killed and resumed gives the same file; they are in
    run.json and learning.csv.

    Args:
        settings: Of the run.
        command: The command that repeats it.
        origin: Versions and code revision.
        steps: Lane-steps after which the policy was taken.
        judgement: What the judge said.
        interruptions: Lane-steps after which the run was interrupted on demand.
    """
    env = settings.environment
    law = (
        "the law with the mean gates of a drive" if judgement.gates_of_drive else "the law at rest"
    )
    limits = [
        f"trained and judged on {env.vehicle}, {env.speed_kmh:g} km/h, {', '.join(env.tracks())}",
        f"growth rates are computed from {law} and prove nothing",
    ]
    if judgement.gates_of_drive:
        limits.append(
            "not linear: at rest the gates do not know the delay, and small motion may grow until "
            "they do; see the growth rate at rest in the score"
        )
    elif settings.policy.kind != "linear":
        limits.append("not linear: growth rates hold near rest only")
    if settings.method in _WITH_MODEL:
        limits.append(_WITH_MODEL[settings.method])
    if not judgement.stable:
        limits.append("NOT STABLE at every judged delay")
    if interruptions:
        after = ", ".join(map(str, interruptions))
        limits.append(f"interrupted after {after} lane-steps: the command gives another policy")
    return {
        "description": settings.description,
        "training": {
            "command": command,
            "config": settings.to_plain(),
            "seed": settings.seed,
            "steps": steps,
            "versions": origin.get("versions", {}),
            "revision": origin.get("revision"),
        },
        "score": {"judge": judgement.to_plain()},
        "limits": limits,
    }
