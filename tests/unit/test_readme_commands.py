"""What the README says can be typed: its commands and options are there, and it stays short."""

import re
from pathlib import Path

import pytest

from planview import cli

README = (Path(__file__).resolve().parents[2] / "README.md").read_text(encoding="utf-8")
LINES = sorted({found.split("#")[0].strip() for found in re.findall(r"^planview .*", README, re.MULTILINE)})


@pytest.mark.parametrize("line", LINES)
def test_a_command_of_the_readme_has_the_options_that_are_shown(line: str, capsys: pytest.CaptureFixture[str]) -> None:
    words = line.split()[1:]
    command = words[: 2 if words[0] == "calibrate" else 1]
    with pytest.raises(SystemExit, match="0"):
        cli.main([*command, "--help"])
    helped = capsys.readouterr().out
    assert all(word in helped for word in words if word.startswith("--"))


def test_the_readme_can_be_read_in_four_minutes() -> None:
    assert len(README.splitlines()) <= 120
    assert (
        README.index("git clone") < README.index("make demo") < README.index("activate") < README.index("planview run")
    )
