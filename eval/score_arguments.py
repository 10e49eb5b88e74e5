"""Arguments of `railenv score`. Loads nothing, so that the command line's help is quick."""

from typing import Any

from eval.loop_arguments import Default


def add_score_arguments(commands: Any) -> None:
    """Add the command: what is scored, how thoroughly, and where the result goes.

    Args:
        commands: What `add_subparsers` returned.
    """
    parser = commands.add_parser("score", help="a policy's card: comfort, stability, comparison")
    parser.add_argument(
        "policy",
        nargs="+",
        metavar="POLICY",
        help="shipped name, folder, .safetensors or any controller SPEC; several: one table",
    )
    parser.add_argument(
        "--layout",
        default=Default("4"),
        help="2 or 4: of laws that take either; a trained policy has its own (4)",
    )
    parser.add_argument("--quick", action="store_true", help="4 tracks of 30 s, no windows")
    parser.add_argument("--tracks", help="number of scoring tracks (20; quick 4)")
    parser.add_argument("--full50", action="store_true", help="critical delay on full50 too (slow)")
    parser.add_argument(
        "--check", action="store_true", help="only run what the card's score says and compare"
    )
    parser.add_argument(
        "--save", action="store_true", help="write the score into the card of the policy's folder"
    )
    parser.add_argument(
        "--learning-curve", metavar="FILE", help="POLICY is a run: draw its learning (.png, .svg)"
    )
    parser.add_argument("--out", metavar="DIR", help="folder for score.json and score.md")
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object and nothing else"
    )
