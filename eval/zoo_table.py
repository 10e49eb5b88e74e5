"""Writes docs/controllers-table.md: every controller at every delay, beside the optimum.

`python -m eval.zoo_table` runs everything (see the file it writes for the time it takes),
`--smoke` a small part of it. One numeric thread per process: OMP_NUM_THREADS=1.
"""

import argparse
import multiprocessing
import sys
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from pathlib import Path
from typing import Any

from tqdm import tqdm

from eval.zoo import (
    SKYHOOK_GAINS,
    Entry,
    Scale,
    best_skyhook,
    evaluate,
    mismatched,
)
from eval.zoo_judge import LONGEST_WINDOW, yardstick
from eval.zoo_return import compared
from railenv.files import replacing

LAWS: tuple[tuple[str, str], ...] = (
    ("passive", "passive"),
    ("sky-hook, 35 kN s/m", "skyhook:gain=35e3"),
    ("sky-hook from accelerometers", "skyhook-acc"),
    ("sky-hook with lead, 20 kN s/m (told)", "skyhook-lead:delay={delay},gain=20e3"),
    ("ground-hook", "groundhook"),
    ("mixed hook", "mixedhook"),
    ("relative damping", "relative"),
    ("PID on sway and yaw", "pid"),
    ("LQR, full state", "lqr"),
    ("LQG", "lqg"),
    ("H-infinity (told)", "hinf:delay={delay}"),
    ("H-infinity loop shaping (told)", "hinf-shaping:delay={delay}"),
    ("Smith predictor (told)", "smith:delay={delay}"),
    ("predictor sky-hook (told)", "predictor:delay={delay}"),
    ("LQG with delay, sharp (told)", "lqg-delay:delay={delay}"),
    ("LQG with delay, detuned (told)", "lqg-delay:delay={delay},noise=1,effort=1e-2"),
    ("the same with preview, sharp (told)", "lqg-delay:delay={delay},preview=1"),
    (
        "the same with preview, detuned (told)",
        "lqg-delay:delay={delay},preview=1,noise=1,effort=1e-2",
    ),
    ("robust by design: abscissa", "robust-abscissa"),
    ("robust by design: delay", "robust-delay"),
    ("semi-active, on-off", "semiactive-onoff"),
    ("semi-active sky-hook", "semiactive-skyhook"),
    ("semi-active, clipped LQG (told)", "clipped-lqg:delay={delay}"),
    ("yardstick: full information (told)", "optimum:delay={delay}"),
    ("yardstick with preview (told)", "optimum:delay={delay},preview=1"),
)
"""Rows of the tables: what they are called, and the SPEC."""

CASES = (("4", 300.0), ("2", 300.0), ("4", 200.0), ("2", 200.0))
FORCES = (100.0, 200.0, 400.0, 800.0, 1600.0)
"""Forces at which the yardstick is told [N]."""

NOMINAL = (0.1, 0.2)
"""Delays for which the mismatch is shown [s]."""

Bounds = list[list[float | None]]
Rows = dict[str, list[dict[str, Any]]]


def main(arguments: Sequence[str] | None = None) -> None:
    """Run and write."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--out", default="docs/controllers-table.md", help="where to write")
    parser.add_argument("--jobs", type=int, default=2, help="worker processes (2)")
    parser.add_argument("--smoke", action="store_true", help="one case, short runs")
    options = parser.parse_args(arguments)
    scale = Scale(tracks=1, duration=20.0, delays=(0.0, 0.1)) if options.smoke else Scale()
    cases = CASES[:1] if options.smoke else CASES
    told = [(label, spec) for label, spec in LAWS if "{delay}" in spec]
    entries = [Entry(label, spec, *case) for case in cases for label, spec in LAWS]
    skyhooks = [
        Entry(f"{gain}", f"skyhook:gain={gain}", *case) for case in cases for gain in SKYHOOK_GAINS
    ]
    nominals = NOMINAL[:1] if options.smoke else NOMINAL
    wrong = [(Entry(label, spec, "4", 300.0), tau) for label, spec in told for tau in nominals]
    returns = [(delay, track) for track in ("tb3352", "german_low") for delay in scale.delays]
    least = [(*case, scale.delays, FORCES, preview) for case in cases for preview in (False, True)]
    context = multiprocessing.get_context("spawn")
    with ProcessPoolExecutor(options.jobs, mp_context=context) as pool:
        number = len(entries) + len(skyhooks) + len(wrong) + len(returns) + len(least)
        with tqdm(total=number, file=sys.stderr) as bar:

            def collect(function: Callable[..., Any], items: Iterable[Any]) -> list[Any]:
                found: list[Any] = []
                for one in pool.map(function, items):
                    found.append(one)
                    bar.update()
                return found

            cells = collect(partial(evaluate, scale=scale), entries)
            candidates = collect(partial(evaluate, scale=scale), skyhooks)
            mismatches = collect(partial(_mismatched, scale=scale), wrong)
            earned = collect(_returns, returns)
            bounds = dict(zip(least, collect(_least, least), strict=True))
    text = [_HEAD]
    for case in cases:
        rows = {
            entry.label: cells[k]
            for k, entry in enumerate(entries)
            if (entry.layout, entry.speed_kmh) == case
        }
        hooks = {
            float(entry.label): candidates[k]
            for k, entry in enumerate(skyhooks)
            if (entry.layout, entry.speed_kmh) == case
        }
        bound = {item[-1]: found for item, found in bounds.items() if item[:2] == case}
        text.append(_case_text(case, rows, hooks, bound, scale.delays))
    text.append(_mismatch_text(wrong, mismatches))
    text.append(_return_text(returns, earned))
    with replacing(Path(options.out)) as stream:
        stream.write("\n".join(text).encode())


def _mismatched(item: tuple[Entry, float], scale: Scale) -> list[dict[str, Any]]:
    return mismatched(*item, scale)


def _least(item: tuple[str, float, Sequence[float], Sequence[float], bool]) -> Bounds:
    return yardstick(*item)


def _returns(item: tuple[float, str]) -> dict[str, tuple[float, float]]:
    found = compared(*item)
    return {
        name: (float(v.mean()), float(v.std(ddof=1) / len(v) ** 0.5)) for name, v in found.items()
    }


_HEAD = """# Every controller at every delay

Written by `OMP_NUM_THREADS=1 python -m eval.zoo_table`; do not edit. What the laws are and why
they fail where they do: [controllers.md](controllers.md).

Vehicle `paper_fit` on German low, 8 tracks of 60 s after 10 s, control period 10 ms, force limit
30 kN. Readings carry white noise of 10 % of the controlled response; the LQR and the yardstick are
told the truth. "(told)": designed anew for the delay of the column. A star: the loop is unstable
there (linear laws: by the eigenvalues of the sampled loop) or reached the force limit, and what is
printed is a limit cycle. The standard error of a ride index is 0.01 or less where nothing diverges.

- **Ride index** Wz (Sperling, GB/T 5599) at the front / rear floor; lower is better.
- **Critical delay** of laws without a told delay: continuous and proved by the oracle, or of a
  sampled law by its eigenvalues ("sampled"); "-" for told laws, whose stable window around the
  delay is in the table of wrong delays, and for laws that are not linear.
- **Force** RMS over the actuators [kN], and **damping**: the least damping ratio of the sampled
  loop's oscillating modes below 5 Hz, those of the law included.
- **Distance**: ride-filtered floor acceleration (RMS, both ends) over that of the H2 optimum with
  full information at the same delay and the same force RMS, trailing wheelsets on the track of the
  leading one and optimum with preview; in brackets every wheelset on a track of its own and optimum
  without preview. No causal linear law can come below 1 there. Linear laws: by covariance, noise
  included; semi-active ones: from the runs, and not linear. The passive vehicle's dampers are laws
  without delay: its distance counts at 0 ms, with the force of its four lateral dampers.
"""


def _case_text(
    case: tuple[str, float],
    rows: Rows,
    hooks: dict[float, Any],
    bounds: dict[bool, Bounds],
    delays: Sequence[float],
) -> str:
    layout, speed = case
    title = f"\n## {layout} actuators, {speed:g} km/h\n"
    columns = [f"{1000 * delay:g} ms" for delay in delays]
    best = [best_skyhook(hooks, k) for k in range(len(delays))]
    named = {
        **dict(list(rows.items())[:1]),
        "sky-hook, best gain at each delay": [_of_many(cell) for _, cell in best],
        **dict(list(rows.items())[1:]),
    }
    gains = ", ".join(f"{gain / 1000:g}" for gain, _ in best)
    ends = [
        "/".join(
            f"{min(cells[k][end] for cells in hooks.values() if not _lost(cells[k])):.2f}"
            for end in ("front", "rear")
        )
        for k in range(len(delays))
    ]
    comfort = _table(["controller", "critical delay", *columns], _comfort_rows(named))
    force = _table(
        ["controller", *columns],
        [[name, *(_force(c) for c in cells)] for name, cells in named.items()],
    )
    apart = _table(
        ["controller", *columns],
        [[name, *(_distance(c) for c in cells)] for name, cells in named.items()],
    )
    parts = [
        title,
        "Ride index, front / rear:\n",
        comfort,
        f"\nBest gains of the sky-hook (mean of both ends): {gains} kN s/m. Best gain for each end "
        f"by itself: {', '.join(ends)}.\n",
        "\nForce [kN], damping [%]:\n",
        force,
        "\nDistance from the optimum, with preview (without, wheelsets apart):\n",
        apart,
    ]
    for preview in (False, True):
        word = "with preview" if preview else "without preview, wheelsets apart"
        cells = [
            [f"{force:g} N", *("-" if v is None else f"{v:.4f}" for v in row)]
            for force, row in zip(FORCES, bounds[preview], strict=True)
        ]
        parts += [
            f"\nThe yardstick {word}: least ride-filtered acceleration [m/s^2] by force:\n",
            _table(["force", *columns], cells),
        ]
    return "\n".join(parts)


def _comfort_rows(named: Rows) -> list[list[str]]:
    return [
        [name, _critical(cells[0]), *(_ends(c) for c in cells)] for name, cells in named.items()
    ]


def _of_many(cell: dict[str, Any]) -> dict[str, Any]:
    """Return a cell of a row in which every column is another law: without a critical delay."""
    return {key: value for key, value in cell.items() if not key.startswith("critical_delay")}


def _lost(cell: dict[str, Any]) -> bool:
    return bool(cell["diverged"] or cell.get("unstable_roots"))


def _ends(cell: dict[str, Any]) -> str:
    star = " *" if _lost(cell) else ""
    return f"{cell['front']:.2f}/{cell['rear']:.2f}{star}"


def _critical(cell: dict[str, Any]) -> str:
    if "critical_delay_s" not in cell:
        return "-"
    value = cell["critical_delay_s"]
    word = "" if cell["critical_delay_proved"] else " (sampled)"
    if value == 0.0:
        return f"unstable without delay{word}"
    if value is None:
        longest = 2.0 if cell["critical_delay_proved"] else LONGEST_WINDOW
        return f"none to {longest:g} s{word}"
    return f"{1000 * value:.1f} ms{word}"


def _force(cell: dict[str, Any]) -> str:
    damping = cell.get("damping")
    word = "-" if damping is None else f"{100 * damping:.1f} %"
    return f"{cell['force_rms'] / 1000:.2f}, {word}"


def _distance(cell: dict[str, Any]) -> str:
    row, apart = cell.get("in_a_row_distance"), cell.get("apart_distance")
    if row is None and apart is None:
        return "-"
    first = "-" if row is None else f"{row:.2f}"
    return first if apart is None else f"{first} ({apart:.2f})"


def _mismatch_text(wrong: list[tuple[Entry, float]], mismatches: list[list[dict[str, Any]]]) -> str:
    parts = [
        "\n## Told the wrong delay: 4 actuators, 300 km/h\n",
        "Ride index of the worse end where the true delay is a share of the one that the law was "
        "designed for. The window is the range of true delays around the design's over which the "
        "sampled loop is stable (eigenvalues, to a millisecond; searched to 0.6 s).\n",
    ]
    for nominal in dict.fromkeys(tau for _, tau in wrong):
        chosen = [k for k, (_, tau) in enumerate(wrong) if tau == nominal]
        shares = [cell["delay_s"] / nominal for cell in mismatches[chosen[0]]]
        rows: list[list[str]] = []
        for k in chosen:
            window = next((c["window_s"] for c in mismatches[k] if "window_s" in c), None)
            word = "-" if window is None else f"{1000 * window[0]:.0f} to {1000 * window[1]:.0f} ms"
            cells = [
                f"{max(c['front'], c['rear']):.2f}{' *' if _lost(c) else ''}" for c in mismatches[k]
            ]
            rows.append([wrong[k][0].label, word, *cells])
        header = ["controller", "stable window", *(f"{1000 * nominal * s:.0f} ms" for s in shares)]
        parts += [f"\nDesigned for {1000 * nominal:g} ms:\n", _table(header, rows)]
    return "\n".join(parts)


def _return_text(
    returns: list[tuple[float, str]], earned: list[dict[str, tuple[float, float]]]
) -> str:
    parts = [
        "\n## The environment's return: 4 actuators, 300 km/h\n",
        "Mean return over 16 episodes of 20 s of `railenv/Lateral17-v0` (sensor noise 0.1, actions "
        "clipped to the box), with its standard error. The optimum is `lqg-delay`, designed on "
        "German low for the delay of the column. Passive: computed from recorded runs on 16 tracks "
        "of the same spectrum.\n",
    ]
    for track in dict.fromkeys(track for _, track in returns):
        chosen = [k for k, (_, name) in enumerate(returns) if name == track]
        header = ["controller", *(f"{1000 * returns[k][0]:g} ms" for k in chosen)]
        rows = [
            [name, *(f"{earned[k][name][0]:,.0f} +- {earned[k][name][1]:.0f}" for k in chosen)]
            for name in earned[chosen[0]]
        ]
        parts += [f"\nTrack {track}:\n", _table(header, rows)]
    return "\n".join([*parts, ""])


def _table(header: list[str], rows: list[list[str]]) -> str:
    lines = ["| " + " | ".join(header) + " |", "| " + " | ".join("---" for _ in header) + " |"]
    lines += ["| " + " | ".join(row) + " |" for row in rows]
    return "\n".join(lines)


if __name__ == "__main__":
    main()
