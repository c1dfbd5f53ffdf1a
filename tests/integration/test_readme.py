"""The Python examples of the README run as they stand, on the committed clip cut to a few dozen frames."""

import re

import pytest
from short_clip import KEPT, ROOT


def examples() -> list[str]:
    readme = ROOT / "README.md"
    return re.findall(r"^```python\n(.*?)^```", readme.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


def test_the_readme_has_an_example():
    assert examples()


@pytest.mark.parametrize("example", examples())
def test_the_example_prints_people(example, short_clip, monkeypatch, capsys):
    monkeypatch.chdir(short_clip)
    exec(compile(example, "README.md", "exec"), {"__name__": "__main__"})
    rows = [[float(word) for word in line.split()] for line in capsys.readouterr().out.splitlines()]
    assert len(rows) > 5
    assert all(12 <= frame < len(KEPT) and person >= 1 and 0 < y < 9 for frame, person, _, y in rows)
