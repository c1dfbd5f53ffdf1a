"""The Python examples of the README run as they stand, on the committed clip cut to a few dozen frames."""

import re
import shutil
from pathlib import Path

import cv2
import pytest

ROOT = Path(__file__).resolve().parents[2]
CLIP = ROOT / "data" / "synthetic" / "demo"
KEPT = (*range(12), *range(88, 124))
"""An empty room, then the first visitor on her way in."""
FPS = 15


def examples() -> list[str]:
    readme = ROOT / "README.md"
    return re.findall(r"^```python\n(.*?)^```", readme.read_text(encoding="utf-8"), re.DOTALL | re.MULTILINE)


@pytest.fixture(scope="module")
def short_clip(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which data/synthetic/demo is the short clip, at half size (its calibration scales with it)."""
    place = tmp_path_factory.mktemp("readme")
    folder = place / "data" / "synthetic" / "demo"
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        capture = cv2.VideoCapture(str(CLIP / f"{side}.mp4"))
        for index in range(KEPT[-1] + 1):
            found, image = capture.read()
            assert found
            if index in KEPT:
                half = cv2.resize(image, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
                cv2.imwrite(str(folder / side / f"{KEPT.index(index):06d}.png"), half)
        capture.release()
    times = "".join(f"{index},{index / FPS:.4f}\n" for index in range(len(KEPT)))
    (folder / "timestamps.csv").write_text("frame,timestamp_s\n" + times)
    shutil.copy(CLIP / "rig.toml", folder)
    return place


def test_the_readme_has_an_example() -> None:
    assert examples()


@pytest.mark.parametrize("example", examples())
def test_the_example_prints_people(
    example: str, short_clip: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(short_clip)
    exec(compile(example, "README.md", "exec"), {"__name__": "__main__"})
    rows = [[float(word) for word in line.split()] for line in capsys.readouterr().out.splitlines()]
    assert len(rows) > 5
    assert all(12 <= frame < len(KEPT) and person >= 1 and 0 < y < 9 for frame, person, _, y in rows)
