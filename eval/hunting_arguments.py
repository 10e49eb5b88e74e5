"""Arguments of `railenv hunting`; loads nothing, so that the command line's help is quick."""

import argparse


def add_hunting_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the vehicle, its wheels on rails, and the speeds of the ramps."""
    for option, default, text in (
        ("--wheel", "s1002cn", "wheel profile: s1002cn, lma, lmb10, cone:angle=0.17 (s1002cn)"),
        ("--rail", "cn60", "rail profile: cn60, 60e1, arc:radius=0.3 (cn60)"),
        ("--layout", "passive", "passive, 2 or 4; actuators stay without force (passive)"),
        ("--vehicle", "paper_fit", "name of a vehicle (paper_fit)"),
        ("--friction", "0.3", "between wheel and rail (0.3)"),
        ("--creep-law", "fastsim-table", "fastsim, polach, shen-hedrick-elkins or linear"),
        ("--from-kmh", "100", "lowest speed of the ramps [km/h] (100)"),
        ("--to-kmh", "600", "highest speed [km/h] (600)"),
        ("--step-kmh", "20", "distance of the speeds [km/h] (20)"),
        ("--start-mm", "6", "shift of the wheelsets from which the way down begins [mm] (6)"),
        ("--rest-mm", "0.1", "largest amplitude that counts as rest [mm] (0.1)"),
        ("--threads", "2", "threads that share the work (2)"),
    ):  # fmt: skip
        parser.add_argument(option, default=default, help=text)
    parser.add_argument("--plot", help="draw the diagram into this .png, .svg or .pdf file")
