"""Arguments of `railenv benchmark`. Loads nothing, so that the command line's help is quick."""

from typing import Any

from eval.loop_arguments import Default


def add_benchmark_arguments(commands: Any) -> None:
    """Add the command: what is run, with which limits, and where the records go.

    Args:
        commands: What `add_subparsers` returned.
    """
    parser = commands.add_parser("benchmark", help="score controllers; table, records and page")
    parser.add_argument(
        "--suite", default=Default("quick"), help="quick, standard, full or a .toml (quick)"
    )
    parser.add_argument(
        "--controller",
        action="append",
        metavar="SPEC",
        help="a controller, beside passive and reference; repeat; {delay} in it stands for a "
        "design per delay (those of the suite)",
    )
    parser.add_argument(
        "--jobs",
        help="worker processes (as many as processor cores); beside --ray the most packages that "
        "are on the cluster at once (twice its cores: one that runs, one that waits)",
    )
    parser.add_argument(
        "--ray",
        metavar="ADDRESS",
        help="run on the Ray cluster at HOST:PORT (from one of its nodes), ray://HOST:PORT or "
        "auto. Needs railenv[cluster]; on every node the same versions of Python, Ray, railenv, "
        "numpy, scipy and numba, which is checked; and controllers of your own, modules as well "
        "as files, under the same path as here: nothing is sent there",
    )
    parser.add_argument("--out", help="folder for records and page (runs/<suite>)")
    parser.add_argument(
        "--resume", action="store_true", help="run what is missing in the folder, nothing else"
    )
    parser.add_argument(
        "--seconds", default=Default("300"), help="longest time of a package of cells (300)"
    )
    parser.add_argument(
        "--memory", default=Default("4"), help="largest memory of a worker [GiB] (4)"
    )
    parser.add_argument(
        "--private-salt",
        metavar="SALT",
        help="tracks of an organiser's own; the records hold its SHA-256 only; @FILE reads it "
        "from the only line of a file, since what is typed is seen in lists of processes",
    )
    parser.add_argument("--cell", metavar="KEY", help="run the package of this cell alone, show it")
    parser.add_argument(
        "--check", metavar="SPEC", help="say what is wrong with a controller; run nothing else"
    )
    parser.add_argument(
        "--template", metavar="FILE", help="write a controller to start from; run nothing else"
    )
    parser.add_argument("--export", metavar="FILE", help="write all cells as .csv or .parquet too")
    parser.add_argument(
        "--json", action="store_true", help="print one JSON object and nothing else"
    )
