"""Make the pictures of docs/tutorial.md: the commands of the tutorial, run on the demo clip.

Run: python tools/tutorial.py [FOLDER]    (FOLDER keeps the runs; what is there already is not run again)
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path
from tempfile import TemporaryDirectory

import cv2
import matplotlib as mpl

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
WIDTH_PX = 760


def main(folder: Path) -> None:
    """Run the tutorial in a folder and write its pictures to docs/."""
    os.chdir(folder)
    if not Path("my_recording").exists():
        shutil.copytree(ROOT / "data" / "synthetic" / "demo", "my_recording")
    if not Path("pictures/floor.png").exists():
        planview("check", "my_recording", "--out", "pictures")
    if not Path("out/tracks.csv").exists():
        planview("run", "my_recording", "--out", "out")
    planview("render", "out", "--frame", "240", "--out", "still.png")
    planview("export", "out", "--to", "pedpy", "--out", "tracks_pedpy.txt", "--overwrite")
    picture("pictures/rows.png", "tutorial-rows.jpg")
    picture("pictures/floor.png", "tutorial-floor.jpg")
    picture("still.png", "tutorial-frame.jpg")
    plot(blocks("tutorial.md", "python")[0])


def planview(*arguments: str) -> None:
    """Run one command of planview."""
    subprocess.run([sys.executable, "-m", "planview", *arguments], check=True)


def picture(source: str, name: str) -> None:
    """Copy a picture into docs/, at most ``WIDTH_PX`` wide."""
    image = cv2.imread(source)
    scale = min(1.0, WIDTH_PX / image.shape[1])
    small = cv2.resize(image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    cv2.imwrite(str(DOCS / name), small, [cv2.IMWRITE_JPEG_QUALITY, 80])


def plot(program: str) -> None:
    """Run the plotting program of the tutorial."""
    mpl.use("Agg")
    exec(compile(program, "tutorial.md", "exec"), {"__name__": "__main__"})
    picture("diagram.png", "tutorial-diagram.jpg")


def blocks(page: str, language: str) -> list[str]:
    """The code blocks of one language in a page of docs/."""
    parts = (DOCS / page).read_text(encoding="utf-8").split("```" + language + "\n")[1:]
    return [part.split("```")[0] for part in parts]


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with TemporaryDirectory() as temporary:
            main(Path(temporary))
