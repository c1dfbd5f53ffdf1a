"""``import planview``: every public name is there, and none is loaded before it is used."""

import subprocess
import sys

import pytest

import planview


@pytest.mark.parametrize("name", planview.__all__)
def test_every_public_name_is_what_it_says(name: str) -> None:
    value = getattr(planview, name)
    assert value is planview.ABLATIONS if name == "ABLATIONS" else value.__name__ == name


def test_a_name_that_is_not_public_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="telepathy"):
        _ = planview.telepathy


def test_importing_the_package_and_its_command_line_imports_nothing_heavy() -> None:
    program = (
        "import sys, planview, planview.cli\n"
        "print([m for m in ('numpy', 'cv2', 'numba', 'scipy', 'pydantic', 'open3d', 'rerun') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip() == "[]"
