"""A run whose recording is there."""

from pathlib import Path

import numpy as np
import pytest

from calib.images import write_image
from planview.engine.config import Config
from planview.engine.info import CameraInfo, FloorInfo
from planview.output.folder import RunInfo, write_run_info

FRAMES = 30


@pytest.fixture
def street(tmp_path) -> Path:
    """A run over 30 grey images of one camera, with a truth in which person 1 is lost for 1.5 s."""
    video, out = tmp_path / "street", tmp_path / "out"
    video.mkdir()
    out.mkdir()
    for n in range(FRAMES):
        write_image(video / f"{n:03d}.png", np.full((120, 160), 100 + n, np.uint8))
    truth = "".join(f"{n},1,0.0,6.0,1.7\n" for n in range(FRAMES))
    (video / "truth.csv").write_text("frame,id,x_m,y_m,height_m\n" + truth)
    tracks = [f"{n},{n / 10:.4f},4,0.0,6.0,1.7,confirmed" for n in range(FRAMES) if not 10 <= n < 25]
    tracks += [f"{n},{n / 10:.4f},5,9.0,9.0,1.7,confirmed" for n in range(3, 6)]
    rows = sorted(tracks, key=lambda row: (int(row.split(",")[0]), int(row.split(",")[2])))
    (out / "tracks.csv").write_text("frame,timestamp_s,id,x_m,y_m,height_m,state\n" + "\n".join(rows) + "\n")
    floor = FloorInfo(height_m=3.0, tilt_deg=60.0, roll_deg=0.0)
    rig = CameraInfo(width=160, height=120, focal_px=120.0, lens="pinhole")
    config = Config().model_dump(mode="json")
    write_run_info(RunInfo(input=str(video), finished=True, config=config, rig=rig, floor=floor), out / "run.json")
    return out
