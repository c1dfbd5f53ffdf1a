"""Make every picture of README.md and docs/ with planview's own commands, and docs/pictures.json: who is in them.

Run: python tools/pictures.py [--data FOLDER]

Pictures of recordings that are not in the repository are made where --data has them, and are left as they are where it
has not; so is the picture of the rerun viewer where no Vulkan driver is installed (Debian: mesa-vulkan-drivers).
"""

from __future__ import annotations

import argparse
import base64
import json
import os
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import cv2
import numpy as np

import planview
from planview.drawing.people import faces_surely, facing_line, snapshot_at
from planview.output.render import MARKS, blank, write_text
from planview.trajectories.table import Trajectories, people_of

ROOT = Path(__file__).resolve().parents[1]
DOCS = ROOT / "docs"
FACTS = DOCS / "pictures.json"
DEMO = ROOT / "data" / "synthetic" / "demo"
TUTORIAL_FRAME = 240
RENDERED_FRAME = 228
"""A frame of the demo clip in which one of four people is hidden in part."""
CHANGED = "joint.visible_min=0.4"
"""The parameter of the replayed frame."""
ROOM_FRAME = 660
SHOWN_MIN = 0.25
"""A frame of the conference room, and the share of a body from which its person is in view."""
EXIT_FRAME = 1040
EXIT_RULES = ROOT / "tools" / "indoor.rules.toml"
"""A frame of the indoor clip, and the line that people cross."""


def main() -> None:
    """Make all pictures in a temporary folder, and write them to docs/."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--data", type=Path, help="folder with the recordings that are not in the repository")
    data = parser.parse_args().data
    data = data and data.resolve()
    facts = json.loads(FACTS.read_text(encoding="utf-8")) if FACTS.exists() else {}
    with TemporaryDirectory() as temporary:
        os.chdir(temporary)
        facts |= demo_pictures()
        viewer_picture()
        facts |= conference_pictures()
        if data is None:
            print("one_camera.jpg stays as it is: --data FOLDER has its recording")
        else:
            facts |= indoor_picture(data / "one-at-a-time" / "onebyone.mp4")
    FACTS.write_text(json.dumps(facts, indent=1, sort_keys=True) + "\n", encoding="utf-8")


def demo_pictures() -> dict[str, Any]:
    """Those of the demo clip: the tutorial's steps, the report, a plot, a frame, and the frame with a change."""
    shutil.copytree(DEMO, "my_recording")
    command("check", "my_recording", "--out", "pictures")
    command("run", "my_recording", "--out", "out", "--rrd")
    command("render", "out", "--frame", TUTORIAL_FRAME, "--out", "still.png")
    command("export", "out", "--to", "pedpy", "--out", "tracks_pedpy.txt")
    command("plot", "out", "--out", "plot.png")
    Path("rules.toml").write_text(blocks("tutorial.md", "toml")[0], encoding="utf-8")
    command("count", "out", "--rules", "rules.toml")
    command("report", "out")
    command("render", "out", "--frame", RENDERED_FRAME, "--out", "rendered.png")
    command("replay", "out", "--frame", RENDERED_FRAME, "--set", CHANGED, "--out", "replayed.png")
    plot_tutorial()
    copy("pictures/rows.png", "tutorial-rows.jpg", 760)
    copy("pictures/floor.png", "tutorial-floor.jpg", 760)
    copy("still.png", "tutorial-frame.jpg", 760)
    copy("diagram.png", "tutorial-diagram.jpg", 760)
    copy("plot.png", "seeing-plot.png", 1000)
    copy("rendered.png", "seeing-render.jpg", 900)
    copy("replayed.png", "seeing-debug.jpg", 900)
    report_picture(Path("out/report.html"))
    return demo_facts(planview.read_tracks("out/tracks.csv"))


def demo_facts(tracks: Trajectories) -> dict[str, Any]:
    """Who is in the pictures of the demo clip, by its tracks."""
    ids = people_of(tracks).tolist()
    return {
        "tutorial-frame.jpg": frame_facts(tracks, TUTORIAL_FRAME),
        "seeing-render.jpg": frame_facts(tracks, RENDERED_FRAME),
        "seeing-plot.png": {"ids": ids},
        "seeing-report.jpg": {"ids": ids},
    }


def frame_facts(tracks: Trajectories, frame: int) -> dict[str, Any]:
    """Ids in a frame, those hidden, and those with an arrow and with a bar."""
    people = snapshot_at(tracks, frame).people
    facing = [person for person in people if facing_line(person) is not None]
    return {
        "frame": frame,
        "ids": [person.track_id for person in people],
        "hidden": [person.track_id for person in people if person.state == "lost"],
        "arrows": [person.track_id for person in facing if faces_surely(person)],
        "bars": [person.track_id for person in facing if not faces_surely(person)],
    }


def conference_pictures() -> dict[str, Any]:
    """A frame of the rendered conference room, and people over time next to the truth."""
    scenes = ROOT / "data" / "synthetic" / "single"
    command("synth", scenes / "conference.toml", "conference", "--jpeg")
    rules = ["--rules", scenes / "conference.rules.toml"]
    words = ["--tracker", "human-model", "--calibration", "conference/camera.toml", *rules]
    command("run", "conference", *words, "--out", "room")
    command("render", "room", "--frame", ROOM_FRAME, "--no-plan", "--no-truth", "--out", "room.png")
    command("plot", "room", "--truth", "conference/truth.csv", "--what", "count", "--out", "count.png")
    copy("room.png", "conference-models.jpg", 640)
    copy("count.png", "conference-room.png", 800)
    tracks = planview.read_tracks("room/tracks.csv")
    truth = planview.read_truth("conference/truth.csv")
    found = frame_facts(tracks, ROOM_FRAME)
    in_view = (truth.frame == ROOM_FRAME) & (truth.visible >= SHOWN_MIN)
    found["true people"] = int(np.count_nonzero(in_view))
    return {"conference-models.jpg": found, "conference-room.png": {"people": len(people_of(tracks))}}


def indoor_picture(video: Path) -> dict[str, Any]:
    """A frame of the indoor clip, with a line that people cross."""
    command("run", video, "--tracker", "ellipse-particle", "--rules", EXIT_RULES, "--out", "indoor")
    command("render", "indoor", "--frame", EXIT_FRAME, "--out", "indoor.png")
    copy("indoor.png", "one_camera.jpg", 768)
    return {"one_camera.jpg": frame_facts(planview.read_tracks("indoor/tracks.csv"), EXIT_FRAME)}


def report_picture(page: Path) -> None:
    """The first pictures of a report: four frames, identities over time, and the true people."""
    found = re.findall(r'src="data:image/(png|jpeg);base64,([^"]+)"', page.read_text(encoding="utf-8"))
    images = [cv2.imdecode(np.frombuffer(base64.b64decode(data), np.uint8), cv2.IMREAD_UNCHANGED) for _, data in found]
    width = 900
    half = [resized(on_white(image), width // 2 - 4) for image in images[:4]]
    gap = blank(half[0].shape[0], 8)
    rows = [np.hstack([half[0], gap, half[1]]), np.hstack([half[2], gap, half[3]])]
    rows += [resized(on_white(image), width) for image in images[4:6]]
    legend = blank(24, width)
    write_text(legend, MARKS, 17, 0.45)
    space = blank(10, width)
    rows.insert(2, legend)
    write(np.vstack([part for row in rows for part in (row, space)]), "seeing-report.jpg")


def viewer_picture() -> None:
    """The rerun viewer at a frame of the demo clip."""
    if not any(Path("/usr/share/vulkan/icd.d").glob("*.json")):
        print("rerun.jpg stays as it is: no Vulkan driver is installed")
        return
    from rerun.experimental import ViewerClient

    port = 9899
    program = Path(sys.executable).with_name("rerun")
    window = ["--headless", "--bind", "127.0.0.1", "--port", str(port), "--window-size", "1280x720"]
    viewer = subprocess.Popen([str(program), *window], stderr=subprocess.DEVNULL, start_new_session=True)
    try:
        time.sleep(8.0)
        client = ViewerClient(f"rerun+http://127.0.0.1:{port}/proxy")
        client.open("out/run.rrd")
        time.sleep(8.0)
        client.set_time("frame", sequence=RENDERED_FRAME, play_state="paused")
        time.sleep(8.0)
        client.save_screenshot("viewer.png")
        copy("viewer.png", "rerun.jpg", 1280)
    finally:
        os.killpg(viewer.pid, signal.SIGTERM)  # the program is a child of a script


def command(*words: object) -> None:
    """Run one command of planview."""
    typed = [str(word) for word in words]
    print("planview", *typed, flush=True)
    subprocess.run([sys.executable, "-m", "planview", *typed], check=True, stdout=subprocess.DEVNULL)


def plot_tutorial() -> None:
    """Run the plotting program of the tutorial."""
    import matplotlib as mpl

    mpl.use("Agg")
    program = blocks("tutorial.md", "python")[0]
    exec(compile(program, "tutorial.md", "exec"), {"__name__": "__main__"})


def blocks(page: str, language: str) -> list[str]:
    """The code blocks of one language in a page of docs/."""
    parts = (DOCS / page).read_text(encoding="utf-8").split("```" + language + "\n")[1:]
    return [part.split("```")[0] for part in parts]


def copy(source: str, name: str, width_px: int) -> None:
    """Write a picture to docs/, at most so wide."""
    image = cv2.imread(source)
    write(resized(image, width_px) if image.shape[1] > width_px else image, name)


def resized(image: Any, width_px: int) -> Any:
    """An image of this width."""
    height_px = round(image.shape[0] * width_px / image.shape[1])
    return cv2.resize(image, (width_px, height_px), interpolation=cv2.INTER_AREA)


def on_white(image: Any) -> Any:
    """An image without its transparency."""
    if image.ndim < 3 or image.shape[2] < 4:
        return image
    alpha = image[..., 3:] / 255.0
    return np.round(image[..., :3] * alpha + 255.0 * (1.0 - alpha)).astype(np.uint8)


def write(image: Any, name: str) -> None:
    """Write a picture to docs/."""
    quality = [cv2.IMWRITE_JPEG_QUALITY, 80] if name.endswith(".jpg") else []
    cv2.imwrite(str(DOCS / name), image, quality)
    print("wrote", name, flush=True)


if __name__ == "__main__":
    main()
