"""The committed clip cut to a few dozen frames of half size, for examples that must run in seconds."""

import shutil
from pathlib import Path

import cv2

ROOT = Path(__file__).resolve().parents[2]
CLIP = ROOT / "data" / "synthetic" / "demo"
KEPT = (*range(12), *range(88, 124))
"""An empty room, then the first visitor on the way in."""
FPS = 15
WORLD = """[world_SE3_left]
rotation = [[1.0, 0.0, 0.0], [0.0, -0.5, 0.8660254037844386], [0.0, -0.8660254037844386, -0.5]]
translation_m = [0.0, 0.0, 2.75]
"""
"""The floor of the scene (data/synthetic/demo.toml): finding it would take most of the time."""


def write_short_clip(place: Path) -> Path:
    """Write data/synthetic/demo into a folder (the calibration scales with the images), and truth for its frames."""
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
    header, *rows = (CLIP / "truth.csv").read_text(encoding="utf-8").splitlines()
    cells = [row.split(",") for row in rows]
    kept = [",".join([str(KEPT.index(int(c[0]))), *c[1:]]) for c in cells if int(c[0]) in KEPT]
    (folder / "truth.csv").write_text("\n".join([header, *kept]) + "\n")
    (folder / "world.toml").write_text(WORLD)
    shutil.copy(CLIP / "rig.toml", folder)
    return place
