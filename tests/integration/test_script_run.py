"""``planview.run`` and ``planview.evaluate`` in a program."""

from pathlib import Path

import numpy as np
import pytest
from toy_run import EMPTY, FRAMES

import planview
from calib.errors import InputError


def test_run_without_a_folder_gives_what_a_folder_would_hold(engine: planview.Engine, tmp_path: Path) -> None:
    frames = EMPTY + 6
    kept = planview.run(engine, tmp_path / "out", frames=frames)
    tracks = planview.run(engine, frames=frames)
    assert len(tracks) > 0
    assert np.array_equal(tracks.x_m, kept.x_m)
    assert (tmp_path / "out" / "report.html").is_file()


def test_run_refuses_a_folder_with_results(engine: planview.Engine, tmp_path: Path) -> None:
    planview.run(engine, tmp_path, frames=2)
    with pytest.raises(InputError, match="overwrite"):
        planview.run(engine, tmp_path, frames=2)


def test_evaluation_takes_tables_and_paths(engine: planview.Engine, tmp_path: Path) -> None:
    tracks = planview.run(engine, tmp_path / "out", frames=FRAMES)
    confirmed = tracks.where(tracks.state == "confirmed")
    assert planview.evaluate(tmp_path / "out", confirmed).to_json()["mota"] == 1.0


def test_dataframe_has_the_columns_of_the_file(engine: planview.Engine, tmp_path: Path) -> None:
    pytest.importorskip("pandas", reason="the extra table is not installed")
    frame = planview.run(engine, tmp_path / "out", frames=EMPTY + 6).to_dataframe()
    header = (tmp_path / "out" / "tracks.csv").read_text().splitlines()[0]
    assert ",".join(frame.columns) == header
    assert frame.state.iloc[-1] in ("tentative", "confirmed")


def test_tracker_of_one_camera_is_refused_for_a_stereo_recording(copy: Path) -> None:
    with pytest.raises(InputError, match="expected a tracker of stereo recordings and plan-view maps"):
        planview.run(copy, tracker="ellipse-particle")


def test_matcher_for_a_recording_without_a_pair_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="expected a recording of one stereo pair"):
        planview.run(tmp_path, tracker="ellipse-particle", matcher=lambda left, right: np.zeros(left.shape, np.float32))
