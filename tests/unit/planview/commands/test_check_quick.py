import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_rgbd import write_toy_rgbd
from toy_stereo import toy_rig

from calib.rig import save_rig
from planview.cli import main
from planview.commands.recordings import check
from stereo.readers import open_any, rgbd


def recording(folder: Path) -> Path:
    for side in ("left", "right"):
        (folder / side).mkdir(parents=True)
        for i in range(4):
            if (side, i) != ("right", 2):
                cv2.imwrite(str(folder / side / f"{i}.png"), np.zeros((24, 32), np.uint8))
    (folder / "timestamps.csv").write_text("frame,timestamp_s\n0,0\n1,0.1\n2,0.2\n3,0.3\n")
    return folder


def inspected(path: Path, capsys: pytest.CaptureFixture[str]) -> dict[str, object]:
    check(path, quick=True, json_output=True)
    found: dict[str, object] = json.loads(capsys.readouterr().out)
    return found


def test_inspect_tells_sizes_rates_calibration_and_unpaired_frames(tmp_path, capsys):
    save_rig(toy_rig((32, 24), focal_px=16.0), recording(tmp_path) / "rig.toml")
    found = inspected(tmp_path, capsys)
    assert (found["reader"], found["kind"], found["frames"], found["unpaired"]) == ("folders", "stereo", 4, 1)
    assert found["fps"] == pytest.approx(10.0) and found["size"] == [32, 24] and found["missing"] == []
    calibration = found["calibration"]
    assert isinstance(calibration, dict)
    assert calibration["baseline_m"] == pytest.approx(0.12) and calibration["fov_deg"][0] == pytest.approx(90.0)


def test_inspect_names_the_option_that_supplies_what_is_missing(tmp_path, capsys):
    found = inspected(recording(tmp_path), capsys)
    assert found["calibration"] is None and "--calibration FILE" in str(found["missing"])


def test_the_rate_of_images_without_times_is_the_one_that_a_run_takes(tmp_path, capsys, monkeypatch):
    folder = write_toy_rgbd(tmp_path / "rgbd")
    (folder / "timestamps.csv").unlink(missing_ok=True)
    monkeypatch.setattr(rgbd, "rate_by_movement", lambda *_: 6.7)
    found = inspected(folder, capsys)
    assert found["fps"] == open_any(folder).fps == 6.7
    notes = [note for note in found["notes"] if "frames per second are assumed" in note]  # type: ignore[attr-defined]
    assert len(notes) == 1 and "no timestamps: 6.7" in notes[0]


@pytest.mark.parametrize("words", [["check", "--quick"], ["check"], ["run", "--out", "out"]])
def test_a_video_of_one_camera_names_its_trackers(tmp_path, words, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    writer = cv2.VideoWriter("street.avi", cv2.VideoWriter.fourcc(*"MJPG"), 10.0, (64, 48))
    for _ in range(4):
        writer.write(np.zeros((48, 64, 3), np.uint8))
    writer.release()
    with pytest.raises(SystemExit):
        main([words[0], "street.avi", *words[1:]])
    told = " ".join(capsys.readouterr().err.split())
    assert "--tracker ellipse-particle, or --tracker human-model --calibration camera.toml" in told


def test_inspect_shows_a_table_for_people(tmp_path, capsys):
    check(recording(tmp_path), quick=True)
    shown = capsys.readouterr().out
    assert "32x24" in shown and "1 without a mate" in shown
