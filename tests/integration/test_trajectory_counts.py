"""Exact counts of real pedestrians whose heads were measured, also with noise and dropped frames."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planview.counting.rules import RulePlane, parse_rules
from planview.counting.totals import count_tracks
from planview.trajectories.formats import load_tracks
from planview.trajectories.table import Trajectories

RULES = {"tripwire": [{"name": "y = 0", "from_m": [-10, 0], "to_m": [10, 0]}]}
EXACT = [("uo-050-180-180.txt", 61, 0), ("boa-300-frei.txt", 25, 25)]
"""File, crossings towards -y (left to right along +x), crossings towards +y."""


def counted(tracks: Trajectories) -> tuple[int, int]:
    wire = count_tracks(tracks, parse_rules(RULES, RulePlane(), "rules")).to_json()["rules"]["y = 0"]
    return wire["left_to_right"], wire["right_to_left"]


def read(shared_data: Path, name: str) -> Trajectories:
    path = shared_data / "trajectories" / name
    if not path.is_file():
        pytest.skip(f"{path} is not here")
    return load_tracks(path)


@pytest.mark.parametrize(("name", "down", "up"), EXACT)
def test_counts_of_measured_heads_are_exact(shared_data, name, down, up):
    assert counted(read(shared_data, name)) == (down, up)


@pytest.mark.parametrize("seed", [1, 2, 3])
@pytest.mark.parametrize(("name", "down", "up"), EXACT)
def test_counts_stay_exact_with_noise_and_dropped_frames(shared_data, name, down, up, seed):
    tracks = read(shared_data, name)
    rng = np.random.default_rng(seed)
    noise = rng.normal(0.0, 0.10, (len(tracks), 2))
    noisy = replace(tracks, x_m=tracks.x_m + noise[:, 0], y_m=tracks.y_m + noise[:, 1])
    dropped = rng.random(int(tracks.frame.max()) + 1) < 0.3
    assert counted(noisy.where(~dropped[noisy.frame])) == (down, up)
