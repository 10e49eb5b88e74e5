"""`railenv export` and `railenv convert-sb3`: policies on their way out and in."""

import argparse
import shlex
from pathlib import Path

from baselines import make_controller
from baselines.policies import HistoryPolicy, save_trained
from eval.arguments import parse_output, print_json
from railenv.errors import ArgumentError


def command_export(options: argparse.Namespace) -> None:
    """Write a policy as an ONNX model and say how far the two are apart."""
    from baselines.policies.onnx_export import LARGEST_DIFFERENCE, export_onnx

    path = parse_output(options.onnx, (".onnx",))
    assert path is not None  # the option is required
    policy = make_controller(options.policy)
    if not isinstance(policy, HistoryPolicy):
        raise ArgumentError(
            f"policy = {options.policy!r} is a {type(policy).__name__}; give a trained policy: its "
            "folder, its .safetensors or a shipped name"
        )
    difference = export_onnx(policy, path)
    if options.json:
        print_json({"file": str(path), "largest_difference": difference})
        return
    print(
        f"{path}: actions as the policy's to {difference:.1e} over 100 random steps "
        f"(at most {LARGEST_DIFFERENCE:g} is let through)"
    )


def command_convert_sb3(options: argparse.Namespace) -> None:
    """Write the actor of a stable-baselines3 zip as a policy, and say what was not run."""
    from baselines.policies.convert_sb3 import convert_sb3

    try:
        found = convert_sb3(options.file, options.config)
    except ImportError:
        raise ArgumentError(
            'torch is not installed; pip install "railenv[train]", which brings it'
        ) from None
    words = ["railenv", options.command, options.file]
    command = shlex.join([*words, "--config", options.config, "--out", options.out])
    card = {
        "description": f"converted from {Path(options.file).name} of stable-baselines3",
        "training": {"command": command},
        "limits": ["The action at rest was taken off; what VecNormalize knew is not in the file."],
    }
    save_trained(found.policy, options.out, card)
    rest = [float(value) for value in found.at_rest]
    if options.json:
        print_json(
            {
                "folder": options.out,
                "executed": [],
                "not_executed": list(found.never_run),
                "action_at_rest_taken_off": rest,
            }
        )
        return
    print(f"{options.out}: {len(found.policy.layers)} layers from {options.file}")
    print("  executed: nothing; policy.pth was read as tensors only")
    print(f"  pickled and left alone: {', '.join(found.never_run) or 'nothing'}")
    shown = ", ".join(format(value, ".3g") for value in rest)
    print(f"  action at rest, taken off: {shown} of {found.policy.action_scale:g} N")
    print("  a file of VecNormalize, if there was one, is not part of it: train without")
    out = shlex.quote(options.out)
    print(f"  next: railenv simulate --controller {out} --track german_low --delay 0.1")
