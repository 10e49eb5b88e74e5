"""Shared set-up: one numeric thread (before numpy is loaded), and the paper's loop."""

import os
from typing import Any

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"

import pytest
from hypothesis import settings

from baselines import SkyHook
from railenv.stability import DelaySystem
from railenv.vehicle import LateralVehicle, lateral17

# The same examples in every run, and no deadline: the first call of a compiled function compiles.
settings.register_profile("railenv", derandomize=True, deadline=None)
settings.load_profile("railenv")

_skipped: list[str] = []


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """Note what was skipped for another reason than a missing accelerator or browser."""
    if report.skipped and not {"gpu", "browser"} & set(report.keywords):
        _skipped.append(report.nodeid)


def pytest_terminal_summary(terminalreporter: Any) -> None:
    """Print what tests have measured, also where they ran in worker processes."""
    for report in terminalreporter.getreports("passed"):
        for name, value in report.user_properties:
            if name == "printed":
                terminalreporter.write_line(f"{report.nodeid.partition('::')[2]}: {value}")


def pytest_sessionfinish(session: pytest.Session) -> None:
    """In CI a skipped test is a failed one: what pip can install is there."""
    if _skipped and os.environ.get("CI"):
        print("\nskipped in CI:", *_skipped, sep="\n  ")
        session.exitstatus = pytest.ExitCode.TESTS_FAILED


@pytest.fixture(scope="session")
def vehicle() -> LateralVehicle:
    """The paper's vehicle with four actuators at 300 km/h."""
    return lateral17("paper_fit", 4, 300.0)


@pytest.fixture(scope="session")
def loop(vehicle: LateralVehicle) -> DelaySystem:
    """The paper's loop: four actuators, sky-hook 35 kN s/m."""
    return SkyHook(35e3, 4).to_delay_system(vehicle)
