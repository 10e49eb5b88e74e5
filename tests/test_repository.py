"""The repository itself: imports, package data, units, README and the wheel."""

import dataclasses
import re
import subprocess
import sys
import typing
import zipfile
from pathlib import Path

import pytest

import railenv
from baselines.policies.shipped import shipped_folder
from eval.measures import RunMeasures
from eval.scenarios import Suite
from railenv.actuation import ActuatorSpec
from railenv.config import config_names, configs_root
from railenv.envs.settings import EnvSettings
from railenv.vehicle import VehicleParameters

ROOT = Path(__file__).resolve().parent.parent


def python(code: str) -> str:
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True, cwd=ROOT
    )
    return done.stdout


def test_importing_railenv_loads_nothing_heavy() -> None:
    loaded = python("import sys, railenv; print(*sorted(sys.modules))").split()
    heavy = {"torch", "matplotlib", "numba", "scipy", "jinja2", "stable_baselines3", "ray"}
    assert heavy.isdisjoint(loaded)


def test_importing_railenv_is_quick() -> None:
    # the bound of half a second; the best of three, since the machine may be busy
    code = "import time; t = time.perf_counter(); import railenv; print(time.perf_counter() - t)"
    assert min(float(python(code)) for _ in range(3)) < 0.5


def test_the_command_line_shows_its_help_without_the_numerical_packages() -> None:
    code = (
        "import sys\nfrom eval.cli import main\nmain(['--help'])\n"
        "print('loaded', 'numpy' in sys.modules)"
    )
    assert python(code).endswith("loaded False\n")


def test_the_version_is_the_one_that_is_installed() -> None:
    text = (ROOT / "pyproject.toml").read_text()
    assert f'version = "{railenv.__version__}"' in text
    assert f"## [{railenv.__version__}]" in (ROOT / "CHANGELOG.md").read_text()


@pytest.mark.parametrize("cls", [VehicleParameters, ActuatorSpec, EnvSettings, Suite])
def test_every_number_in_a_dataclass_has_a_unit(cls: type) -> None:
    hints = typing.get_type_hints(cls, include_extras=True)
    bare = [f.name for f in dataclasses.fields(cls) if hints[f.name] in (float, float | None)]
    assert bare == []


@pytest.mark.parametrize("cls", [ActuatorSpec, EnvSettings, Suite, RunMeasures])
def test_every_field_of_a_settings_dataclass_has_its_sentence(cls: type) -> None:
    missing = [f.name for f in dataclasses.fields(cls) if f"{f.name}:" not in (cls.__doc__ or "")]
    assert missing == []


def test_configurations_are_found_in_the_checkout() -> None:
    assert configs_root() == ROOT / "configs"
    assert "quick" in config_names("benchmark")


def readme_blocks(language: str) -> list[str]:
    return re.findall(rf"```{language}\n(.*?)```", (ROOT / "README.md").read_text(), re.DOTALL)


@pytest.mark.parametrize("block", readme_blocks("python"))
def test_the_readmes_code_runs(block: str, tmp_path: Path, monkeypatch) -> None:
    monkeypatch.chdir(tmp_path)
    if "stable_baselines3" in block:
        pytest.importorskip("stable_baselines3")
    # Training itself is tests/test_baselines_sb3_learning.py.
    block = block.replace("learn(1_000_000)", "learn(1)")
    exec(compile(block, "README.md", "exec"), {"__name__": "__main__"})


def test_the_readmes_commands_exist() -> None:
    from eval.cli import _COMMANDS

    for block in readme_blocks("sh"):
        for line in block.splitlines():
            if line.startswith("railenv "):
                assert line.split()[1] in _COMMANDS


def test_no_file_names_a_path_of_one_machine() -> None:
    listed = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        capture_output=True,
        text=True,
        check=True,
        cwd=ROOT,
    ).stdout.split("\n")
    pattern = re.compile(r"(?<![A-Za-z0-9_.])/(work|home|root)/|\.\./shared")
    found = [
        name
        for name in listed
        if name.endswith((".py", ".md", ".toml", ".j2", "Makefile", "run"))
        and name != "tests/test_repository.py"
        and (ROOT / name).is_file()
        and pattern.search((ROOT / name).read_text())
    ]
    assert found == []


@pytest.mark.slow
def test_the_wheel_holds_three_names_and_the_configurations(tmp_path: Path) -> None:
    subprocess.run(
        [sys.executable, "-m", "build", "--wheel", "--outdir", str(tmp_path), str(ROOT)],
        check=True,
        capture_output=True,
    )
    (wheel,) = tmp_path.glob("*.whl")
    with zipfile.ZipFile(wheel) as archive:
        names = archive.namelist()
        top = {name.split("/")[0] for name in names}
        assert {t for t in top if not t.endswith(".dist-info")} == {"railenv", "baselines", "eval"}
        assert "railenv/_configs/benchmark/quick.toml" in names
        assert "eval/templates/report.html.j2" in names
        assert "railenv/py.typed" in names
        shipped = {
            f"baselines/shipped/{p.parent.name}/{p.name}" for p in shipped_folder().glob("*/*")
        }
        assert shipped <= set(names)
        archive.extractall(tmp_path / "site")
    # Outside a checkout the configurations come from the package.
    code = (
        f"import sys; sys.path.insert(0, {str(tmp_path / 'site')!r})\n"
        "from eval.scenarios import load_suite\nimport railenv\n"
        "print(railenv.__file__, load_suite('quick').version)"
    )
    done = subprocess.run(
        [sys.executable, "-I", "-c", code], capture_output=True, text=True, check=True, cwd=tmp_path
    )
    assert done.stdout.split() == [str(tmp_path / "site/railenv/__init__.py"), "v0"]


def test_the_documents_hold_no_blanks_to_be_filled_in() -> None:
    for path in [*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")]:
        blanks = re.findall(r"\b(?:CI|BENCH)_[A-Z]+\b|\bTODO\b|\bTBD\b", path.read_text())
        assert blanks == [], path.name
