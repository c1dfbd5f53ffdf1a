"""The engine, its floor and its checks on exact images with depth."""

import csv
import json
import shutil
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest
from toy_rgbd import EMPTY, HEIGHT_M, TILT_DEG, walker_m, write_toy_rgbd

from calib.errors import InputError, WorkError
from planview.checks.examine import examine
from planview.engine.config import Config
from planview.engine.engine import Engine
from planview.engine.open import open_engine
from stereo.doctor.diagnose import diagnose
from stereo.readers.open import open_any

FEW = Config.model_validate({"analysis": {"setup_frames": 6}})


@pytest.fixture(scope="module")
def recording(tmp_path_factory) -> Path:
    return write_toy_rgbd(tmp_path_factory.mktemp("rgbd") / "recording")


@pytest.fixture(scope="module")
def engine(recording) -> Engine:
    return open_engine(recording, config=FEW)


def test_floor_of_depth_is_where_it_was_put(engine):
    floor = engine.stereo.floor
    assert floor.height_m == pytest.approx(HEIGHT_M, abs=0.02)
    assert np.degrees(floor.tilt_rad) == pytest.approx(TILT_DEG, abs=0.3)


@pytest.mark.parametrize("rows", [113, 117, 119])
def test_camera_stands_still_where_its_image_has_no_whole_number_of_samples(recording, tmp_path, rows):
    cut = shutil.copytree(recording, tmp_path / "cut")
    for file in (*(cut / "rgb").iterdir(), *(cut / "depth").iterdir()):
        cv2.imwrite(str(file), cv2.imread(str(file), cv2.IMREAD_UNCHANGED)[:rows])
    calibration = json.loads((cut / "camera.json").read_text()) | {"height": rows}
    (cut / "camera.json").write_text(json.dumps(calibration))
    engine = open_engine(cut, config={"analysis": {"setup_frames": 6, "width_px": 80}})
    assert [result.frame for result in islice(engine, 3)] == [0, 1, 2]
    assert all(check.ok for check in engine.checks if check.name == "camera moved")


@pytest.mark.parametrize(("factor", "unit"), [(10, 10_000), (5, 5000), (0.256, 256)])
def test_unit_of_depth_that_gives_a_floor_is_named(recording, tmp_path, factor, unit):
    shutil.copytree(recording, tmp_path / "other")
    for file in (tmp_path / "other" / "depth").iterdir():
        stored = cv2.imread(str(file), cv2.IMREAD_UNCHANGED) * factor
        cv2.imwrite(str(file), np.where(stored < 65535, stored, 0).astype(np.uint16))
    with pytest.raises(WorkError, match=rf"counts {unit} values"):
        open_engine(tmp_path / "other", config=FEW)


def test_unit_of_depth_is_kept_when_the_search_for_another_one_fails(recording, monkeypatch):
    opened = open_any(recording)

    def fail(*_):
        raise InputError("a file is gone")

    monkeypatch.setattr(opened, "decode", fail)
    with pytest.raises(InputError, match="a file is gone"):
        diagnose(opened)
    assert opened.sensor.depth_units.units_per_m == 1000


def test_floor_of_depth_is_calibrated_as_a_run_finds_it(recording, json_of):
    assert json_of("calibrate", "floor", recording)["height_m"] == pytest.approx(HEIGHT_M, abs=0.02)


def test_person_is_tracked_from_depth_alone(engine):
    iterated = [(result.frame, result.tracks) for result in engine]
    sure = [(walker_m(frame), track) for frame, tracks in iterated for track in tracks if track.state == "confirmed"]
    off = [np.hypot(track.x_m - x, track.y_m - y) for (x, y), track in sure]
    assert len(off) >= 15
    assert np.median(off) < 0.1
    engine.reset()
    assert [engine.step(frame).tracks for frame in engine.recording] == [tracks for _, tracks in iterated]


def test_run_names_the_depth_sensor(recording, tmp_path, succeed):
    succeed("run", recording, "--out", tmp_path / "out", "--frames", EMPTY + 8, "--rrd")
    text = (tmp_path / "out" / "run.json").read_text()
    assert '"depth_sensor": "structured-light"' in text
    assert '"baseline_m": null' in text
    with (tmp_path / "out" / "tracks.csv").open() as file:
        assert any(row["state"] == "confirmed" for row in csv.DictReader(file))
    assert (tmp_path / "out" / "run.rrd").stat().st_size > 0


def test_check_passes_depth_that_is_of_its_image(recording):
    diagnosis = examine(recording, frames=10, person_height_m=1.75)
    assert not [check for check in diagnosis.checks if check.failed]
    assert {"depth on its image", "depth delay"} <= {check.name for check in diagnosis.checks}


def test_wrong_scale_is_refused_with_its_likely_cause(recording, tmp_path, cli):
    copy = tmp_path / "scaled"
    shutil.copytree(recording, copy)
    calibration = copy / "camera.json"
    calibration.write_text(calibration.read_text().replace("{", '{"depth_scale": 10, ', 1))
    status, text = cli("run", copy, "--out", tmp_path / "out")
    assert status == 1
    assert "depth counts 1000 values per metre, the floor is 2.5" in text
