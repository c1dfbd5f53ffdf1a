from dataclasses import replace

import numpy as np
import pytest

from benchmarks.claims import compared, confidence_table, deviation_table, everybody, facing_table, speeds, stopped_s
from benchmarks.random_scenes.generator import scene_of_table
from calib.io import load_toml
from planview.synthetic.assets import SCENES
from planview.trajectories.table import Trajectories, table_of


def walk(speed_mps: float, rows: int = 40, until: int = 20, **columns: float) -> Trajectories:
    """Somebody who walks along x at 10 frames per second, until a frame from which on they stand."""
    x_m = speed_mps * 0.1 * np.minimum(np.arange(rows), until)
    values = {"frame": np.arange(rows), "timestamp_s": 0.1 * np.arange(rows), "id": 1, "x_m": x_m, "y_m": 3.0}
    return table_of({**{name: np.broadcast_to(v, rows) for name, v in values.items()}, **columns}, "here")


def test_time_since_somebody_stopped_is_counted_from_the_last_step():
    truth = walk(1.0)
    speed = np.where(truth.frame < 20, 1.0, 0.0)
    assert stopped_s(truth, speed, 0.1)[[0, 19, 20, 39]] == pytest.approx([0.0, 0.0, 0.1, 2.0])


def test_facing_counts_who_is_back_to_front():
    truth = walk(1.0, until=40, facing_deg=0.0)
    tracks = walk(1.0, until=40, facing_deg=170.0, facing_confidence=0.95)
    (walking, every) = facing_table(compared(tracks, truth, 0.1).assign(scene=1))
    assert walking["facing"] == "walking" and every["rows"] == 40
    assert (every["right"][0], every["claimed"], every["axis deg"]) == pytest.approx((0.0, 0.95, 10.0))


def test_confidence_counts_rows_next_to_which_somebody_is():
    tracks = walk(1.0, confidence=0.95)
    truth = walk(1.0, rows=20)
    (row,) = confidence_table(compared(tracks, truth, 0.1).assign(scene=1))
    assert (row["rows"], row["right"][0], row["claimed"]) == pytest.approx((40, 0.5, 0.95))


def test_people_beyond_the_image_are_there_but_do_not_show():
    table = load_toml(SCENES / "claims" / "stopping.toml", "a challenge") | {"fps": 5}
    scene = scene_of_table("suite", table, 1, "stopping").scene
    whole = everybody(scene, walk(0.0, rows=0))
    assert len(whole) > 50 and set(whole.visible) == {0.0}
    shown = whole.where(np.arange(3))
    assert list(everybody(scene, replace(shown, visible=np.full(3, 0.5))).visible[:4]) == [0.5, 0.5, 0.5, 0.0]


def test_errors_of_places_are_of_each_axis():
    truth = walk(0.0)
    rows = compared(table_of(truth.to_dataframe().assign(x_m=0.1, y_m=3.1, std_m=0.05), "here"), truth, 0.1)
    assert {row["place"]: row["error / std"] for row in deviation_table(rows)}["all"] == pytest.approx(2.0)


def test_runners_have_their_speeds_side_by_side():
    truth = walk(3.0, until=40)
    tracks = table_of(truth.to_dataframe().assign(vx_mps=2.9, vy_mps=0.0), "here")
    (row,) = speeds(compared(tracks, truth, 0.1), {"recording": "here"})
    assert (row["true m/s"], row["reported m/s"], row["ids"]) == pytest.approx((3.0, 2.9, 1))
