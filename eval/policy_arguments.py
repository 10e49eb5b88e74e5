"""Arguments of `railenv export` and `railenv convert-sb3`."""

from typing import Any


def add_policy_arguments(commands: Any) -> None:
    """Add both commands.

    Args:
        commands: What `add_subparsers` returned.
    """
    export = commands.add_parser("export", help="a trained policy as an ONNX model")
    export.add_argument("policy", metavar="POLICY", help="folder, .safetensors or a shipped name")
    export.add_argument("--onnx", metavar="FILE", required=True, help="write it to this .onnx file")
    convert = commands.add_parser(
        "convert-sb3", help="a zip of stable-baselines3 as a policy; runs nothing that is in it"
    )
    convert.add_argument("file", metavar="FILE.zip", help="what PPO.save or A2C.save wrote")
    convert.add_argument(
        "--config",
        metavar="TOML",
        required=True,
        help="file whose [environment] says what it was trained on",
    )
    convert.add_argument("--out", metavar="FOLDER", required=True, help="write the policy here")
    for parser in (export, convert):
        parser.add_argument(
            "--json", action="store_true", help="print one JSON object and nothing else"
        )
