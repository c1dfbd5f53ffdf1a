"""Brings the committed scenes and the demo clip into a wheel; everything else is in pyproject.toml."""

import shutil
from pathlib import Path

from setuptools import setup
from setuptools.command.build_py import build_py

SCENES = Path("data") / "synthetic"


class BuildWithScenes(build_py):
    """In a checkout they lie in data/synthetic, in a wheel next to planview/synthetic/assets.py."""

    def run(self) -> None:
        super().run()
        if not self.editable_mode:
            place = Path(self.build_lib) / "planview" / "synthetic" / "scenes"
            shutil.copytree(SCENES, place, dirs_exist_ok=True)


setup(cmdclass={"build_py": BuildWithScenes})
