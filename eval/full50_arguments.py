"""Arguments that choose the vehicle's model, and the wheels and rails of the nonlinear one.

Loads nothing, so that the command line's help is quick.
"""

import argparse


def add_model_arguments(parser: argparse.ArgumentParser) -> None:
    """Add --model, --wheel, --rail, --friction and --creep-law."""
    help_text = "lateral17 or full50 (lateral17)"
    parser.add_argument("--model", default="lateral17", help=help_text)
    for option, text in (
        ("--wheel", "wheel profile of full50: s1002cn, lma, cone:angle=0.17 (s1002cn)"),
        ("--rail", "rail profile of full50: cn60, 60e1, arc:radius=0.3 (cn60)"),
        ("--friction", "friction between wheel and rail of full50 (0.3)"),
        ("--creep-law", "fastsim-table, fastsim, polach, shen-hedrick-elkins, linear or given"),
    ):
        parser.add_argument(option, help=text)
