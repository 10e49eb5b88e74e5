"""Puts the top-level `configs` folder into the wheel as data of `railenv`.

Everything else is declared in pyproject.toml. A declarative mapping of `configs` into the package
would make setuptools fall back to import hooks in editable installs, which type checkers cannot
follow; copying at build time leaves editable installs alone (they read the folder itself).
"""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py


class BuildWithConfigs(build_py):
    """The usual build, then the configurations as package data."""

    def run(self) -> None:
        """Build the packages and copy `configs` beside them, except in editable mode."""
        super().run()
        if not self.editable_mode:
            target = Path(self.build_lib) / "railenv" / "_configs"
            shutil.rmtree(target, ignore_errors=True)
            shutil.copytree(Path(__file__).parent / "configs", target)


setup(cmdclass={"build_py": BuildWithConfigs})
