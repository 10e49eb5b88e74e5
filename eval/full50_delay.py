"""Why the critical delay of the nonlinear vehicle is what it is: each effect switched off in turn.

The paper's loop (sky-hook 35 kN s/m, four actuators, 300 km/h) becomes unstable at 202 ms by
eigenvalues of its linear model and at 197 ms by time integration of its nonlinear one. Here every
variant of the nonlinear vehicle is asked three times: linearised about steady rolling, by the
oracle, with continuous feedback and with the control period's hold; and in the time domain, as
`railenv critical-delay --model full50 --method simulation` does it. Where the linearised answer
with hold and that of the time domain differ, the motion that is left is not small: the vehicle
hunts, as the column `hunting` says. Where steady rolling is unstable by hunting already, the
linearised answers are those of the carbody's mode: the first crossing into instability by delay,
and that less half a control period, marked with ~.

    python -m eval.full50_delay [--only NAME ...]
"""

import argparse
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from baselines import SkyHook
from eval.full50_linear import linear_loop
from eval.full50_probe import FullProbe
from eval.rollout import Stepping
from railenv.actuation import ActuatorSpec
from railenv.errors import ArgumentError, unknown_name
from railenv.stability import critical_delays, sampled_critical_delay
from railenv.vehicle import lateral17
from railenv.vehicle.nonlinear import ContactSettings, FullVehicle, full50

GAIN, SPEED_KMH = 35e3, 300.0
LONGEST = 0.3
COARSE, FINE = 0.002, 0.0005
_REACH = 2

_CONE, _HEAD = 0.17, 0.01
LINEAR_CONTACT: dict[str, Any] = {
    # A cone on a narrow round head touches at the half spacing of the lateral model, 0.7465 m.
    "wheel": f"cone:angle={_CONE}",
    "rail": f"arc:radius={_HEAD}",
    "cant": 0.0,
    "rail_lateral": 0.7465 + _HEAD * float(np.sin(np.arctan(_CONE))),
    "law": "given",
}
_FAR_STOP = ((0.5, 0.0), (1.0, 1.0))


@dataclass(frozen=True)
class Variant:
    """One effect switched off.

    Attributes:
        name: What is done.
        vehicle: Fields of `FullVehicle` that change.
        contact: Fields of `ContactSettings` that change.
        far_stops: Whether the bump stops are out of reach.
        control_period: Time between commands [s].
        force_limit: Of an actuator [N]; None for none.
    """

    name: str
    vehicle: dict[str, Any] = field(default_factory=dict[str, Any])
    contact: dict[str, Any] = field(default_factory=dict[str, Any])
    far_stops: bool = False
    control_period: float = 0.01
    force_limit: float | None = 30e3

    def made(self) -> FullVehicle:
        """Return the vehicle."""
        bare = full50("paper_fit", 4, SPEED_KMH, ContactSettings(**self.contact), **self.vehicle)
        if not self.far_stops:
            return bare
        return bare.replace(parameters=bare.parameters.replace(bump_stop=_FAR_STOP))

    def stepping(self) -> Stepping:
        """Return the steps and limits; records are 5 ms apart, or a shorter control period."""
        limits = ActuatorSpec(force_limit=self.force_limit)
        return Stepping(self.control_period, min(0.005, self.control_period), limits)


_BASE = Variant("everything on")
_LINEAR = replace(
    _BASE,
    contact=LINEAR_CONTACT,
    vehicle={"gravity_coupling": False, "roll_coupling": False, "blow_off": False},
    far_stops=True,
    force_limit=None,
)

VARIANTS: tuple[Variant, ...] = (
    _BASE,
    replace(_BASE, name="control period 1 ms", control_period=0.001),
    replace(_BASE, name="no force limit", force_limit=None),
    replace(_BASE, name="linear contact", contact=LINEAR_CONTACT, vehicle={"roll_coupling": False}),
    replace(_BASE, name="no blow-off", vehicle={"blow_off": False}),
    replace(_BASE, name="bump stops far", far_stops=True),
    replace(_BASE, name="no gravity coupling", vehicle={"gravity_coupling": False}),
    replace(_LINEAR, name="all off, 10 ms"),
    replace(_LINEAR, name="all off, 1 ms", control_period=0.001),
)
"""What is asked: everything on, one effect off at a time, and all off."""


def compared(variant: Variant) -> dict[str, Any]:
    """Return a variant's critical delays.

    Returns:
        `name`; linearised `continuous_s` and `sampled_s`, and whether steady rolling
        `hunts_linearly`; in the time domain `bracket_s`, its ends None where no change is found;
        `frequency_hz` there; `hunting_hz`, 0 for none.
    """
    vehicle, controller = variant.made(), SkyHook(GAIN, 4)
    loop = linear_loop(controller, vehicle)
    exact = critical_delays(loop, LONGEST)
    hunts = exact.unstable_without_delay > 0
    first = next((c.delay for c in exact.crossings if c.direction > 0), None)
    sampled = sampled_critical_delay(loop, exact, variant.control_period)
    if hunts and first is not None:
        # A hold of a period adds half of it to the delay, to 0.03 ms in the 17-coordinate loop.
        sampled = first - variant.control_period / 2.0
    probe = FullProbe(controller, vehicle, variant.stepping(), "tb3352", 0)
    if first is None or sampled is None:
        raise ArgumentError(f"{variant.name}: stable for every delay up to {LONGEST:g} s")
    low, high = _change(probe, sampled + COARSE * np.arange(-_REACH, _REACH + 1.0))
    if low is not None and high is not None:
        low, high = _change(probe, np.linspace(low, high, round(COARSE / FINE) + 1), known=True)
    frequency = None if high is None else probe.oscillation(high)[0]
    return {
        "name": variant.name,
        "continuous_s": first,
        "sampled_s": sampled,
        "hunts_linearly": hunts,
        "bracket_s": (low, high),
        "frequency_hz": frequency,
        "hunting_hz": probe.hunting.frequency,
    }


def _change(
    probe: FullProbe, delays: np.ndarray, known: bool = False
) -> tuple[float | None, float | None]:
    """Return the last stable delay before the first unstable one, and that one.

    Args:
        probe: Judges delays.
        delays: Rising [s].
        known: Whether the first is known to be stable and the last to be unstable.
    """
    stable = (
        np.concatenate([[True], probe.stable(delays[1:-1]), [False]])
        if known
        else probe.stable(delays)
    )
    if np.all(stable):
        return float(delays[-1]), None
    first = int(np.argmin(stable))
    return (float(delays[first - 1]) if first else None), float(delays[first])


def row(answer: dict[str, Any]) -> str:
    """Return a line of the table."""
    low, high = answer["bracket_s"]
    if low is None or high is None:
        word = f"below {1e3 * high:.1f}" if high is not None else f"above {1e3 * (low or 0.0):.1f}"
    else:
        word = f"{500.0 * (low + high):.2f} +- {500.0 * (high - low):.2f}"
    frequency = answer["frequency_hz"]
    shown = "-" if frequency is None else f"{frequency:.3f}"
    mark = "~" if answer["hunts_linearly"] else ""
    hunting = f"{answer['hunting_hz']:.1f} Hz" if answer["hunting_hz"] else "no"
    return (
        f"{answer['name']:<22} {1e3 * answer['continuous_s']:10.2f} "
        f"{mark:>4}{1e3 * answer['sampled_s']:6.2f} {word:>16} {shown:>8} {hunting:>8}"
    )


def heading() -> str:
    """Return what stands above the table: the paper's answers, and the 17-coordinate model's."""
    loop = SkyHook(GAIN, 4).to_delay_system(lateral17("paper_fit", 4, SPEED_KMH))
    exact = critical_delays(loop, LONGEST)
    found = [exact.critical_delay]
    found += [sampled_critical_delay(loop, exact, period) for period in (0.01, 0.001)]
    continuous, held, quick = (f"{1e3 * delay:.2f}" for delay in found if delay is not None)
    return (
        "Critical delay [ms] of sky-hook 35 kN s/m, 4 actuators, 300 km/h\n"
        "the paper: 197 in the time domain, 202 by eigenvalues\n"
        f"17 coordinates: continuous {continuous}, held for 10 ms {held}, for 1 ms {quick}\n\n"
        f"{'50 coordinates':<22} {'linearised':>10} {'and held':>10} {'time domain':>16}"
        f" {'[Hz]':>8} {'hunting':>8}"
    )


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table, a line as soon as it is known."""
    names = [variant.name for variant in VARIANTS]
    parser = argparse.ArgumentParser(prog="python -m eval.full50_delay", description=__doc__)
    parser.add_argument("--only", action="append", metavar="NAME", help="only this line; repeat")
    options = parser.parse_args(arguments)
    for name in options.only or ():
        if name not in names:
            parser.error(str(unknown_name("line", name, names)))
    sys.stdout.write(heading() + "\n")
    for variant in VARIANTS:
        if not options.only or variant.name in options.only:
            sys.stdout.write(row(compared(variant)) + "\n")
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    sys.exit(main())
