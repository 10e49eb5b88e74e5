"""Arguments of `railenv conicity`; loads nothing, so that the command line's help is quick."""

import argparse


def add_conicity_arguments(parser: argparse.ArgumentParser) -> None:
    """Add a wheel, a rail, how they are placed and what is asked of them."""
    parser.add_argument("wheel", help="s1002, s1002cn, lma, lmb10, cone:angle=0.17, or a file")
    parser.add_argument("rail", help="60e1, cn60, arc:radius=0.3, or a file of lines y, z")
    for option, default, text in (
        ("--gauge-mm", "1435", "distance of the rails' inner faces [mm] (1435)"),
        ("--gauge-depth-mm", "16", "depth at which it is measured; Europe 14 [mm] (16)"),
        ("--back-to-back-mm", "1353", "distance of the wheels' backs; Europe 1360 [mm] (1353)"),
        ("--cant", "40", "inclination of the rails, 40 for 1:40, 0 for upright (40)"),
        ("--radius-mm", "460", "radius of the tape circle [mm] (460)"),
        ("--amplitudes", "1,2,3,4,5,6,7", "amplitudes of the motion [mm] (1,2,3,4,5,6,7)"),
        ("--unit", "mm", "unit of a file's numbers, mm or m (mm)"),
        ("--tolerance-um", "3", "how far files are smoothed, root mean square [um] (3)"),
    ):
        parser.add_argument(option, default=default, help=text)
    parser.add_argument("--plot", help="draw the contact into this .png, .svg or .pdf file")
