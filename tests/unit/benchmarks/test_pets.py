"""The benchmark on PETS, with tracks in place of the sequence."""

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import pets
from benchmarks.pets import nearby_camera, score_pets
from calib.errors import InputError
from calib.ground_camera import GroundCamera
from planview.trajectories.table import Trajectories, read_tracks

ROWS = "frame,timestamp_s,id,x_m,y_m,left_px,top_px,width_px,height_px,state\n"


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """Truth of one person in ten frames; seed n misses the last n of them."""
    (tmp_path / "gt.txt").write_text("".join(f"{i + 1},1,10,10,20,50,1,0,0,0\n" for i in range(10)))
    (tmp_path / "view001.mp4").write_bytes(b"")

    def run(_video, *, config, watch, **_options) -> Trajectories:
        for frame in range(10):
            watch(SimpleNamespace(frame=frame))
        path = tmp_path / f"tracks{config.seed}.csv"
        path.write_text(ROWS + "".join(f"{i},{i / 7:.3f},5,,,9,9,20,50,confirmed\n" for i in range(10 - config.seed)))
        return read_tracks(path)

    monkeypatch.setattr(pets, "run", run)
    return tmp_path


def test_scores_of_one_seed_have_no_spread(folder):
    scores = score_pets("ellipse-particle", folder, None)
    assert scores.spread() is None
    assert scores.boxes.clear.mota == 1.0
    assert scores.errors.total == 0


def test_spread_holds_the_scores_of_every_seed_in_order(folder):
    scores = score_pets("ellipse-particle", folder, None, seeds=3)
    assert scores.mota == 1.0
    spread = scores.spread()
    assert spread is not None
    np.testing.assert_allclose(spread["mota"], [1.0, 0.9, 0.8])
    np.testing.assert_allclose(spread["idf1"], [1.0, 18 / 19, 16 / 18])
    assert spread["mota_range"] == pytest.approx(0.2)
    assert spread["mota_deviation"] == pytest.approx(0.1 * (2 / 3) ** 0.5)


def test_folder_without_the_sequence_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"gt\.txt"):
        score_pets("ellipse-particle", tmp_path, None)


def test_nearby_cameras_are_near_and_differ():
    camera = GroundCamera(480, 360, 740.0, 7.0, 1.28)
    near = [nearby_camera(camera, seed) for seed in (1, 2)]
    assert near[0] != near[1]
    for other in near:
        assert abs(other.tilt_rad - camera.tilt_rad) <= np.radians(0.5)
        assert other.focal_px == pytest.approx(camera.focal_px, rel=0.03)
        assert other.height_m == pytest.approx(camera.height_m, rel=0.03)
