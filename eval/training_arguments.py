"""Arguments of `railenv train` and `railenv search`."""

import argparse
from typing import Any


def add_training_arguments(commands: Any) -> None:
    """Add both commands.

    Args:
        commands: What `add_subparsers` returned.
    """
    train = commands.add_parser("train", help="train a policy by a configuration file")
    _run(train, "of the file")
    train.add_argument("--steps", metavar="N", help="budget in lane-steps (of the file)")
    search = commands.add_parser("search", help="search for hyper-parameters of a training")
    _run(search, "of the file")
    search.add_argument("--trials", metavar="N", help="how many settings are tried (of the file)")


def _run(parser: argparse.ArgumentParser, origin: str) -> None:
    parser.add_argument("config", metavar="CONFIG", help="configs/train/NAME.toml, or NAME")
    parser.add_argument("--seed", metavar="N", help=f"seed ({origin})")
    parser.add_argument("--out", metavar="DIR", help="folder of the run (runs/NAME-seedN)")
    parser.add_argument(
        "--resume", action="store_true", help="go on with the run in the folder after a kill"
    )
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object and nothing else"
    )
