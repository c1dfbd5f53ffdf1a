"""Ablation: what variants change, what is left of maps with one statistic, and intervals over recordings."""

import json

import numpy as np
import pytest
from rich.console import Console

from benchmarks.ablation import (
    CONFIGURED,
    LADDER,
    TABLE_WIDTH,
    AblationOptions,
    AblationRow,
    Interval,
    ablation,
    bootstrap,
    chosen_variants,
    print_ablation,
)
from benchmarks.one_statistic import NOMINAL_HEIGHT_M, reduced
from calib.errors import InputError
from planview.engine.config import Config, load_config
from planview.maps.builder import CameraViewpoint, FloorPoints, PlanViewMaps
from planview.maps.grid import Grid


@pytest.fixture
def maps():
    """Two cells of 0.1 m: two points of 1 m and 1.6 m in the first, none in the second."""
    grid = Grid.covering(0.0, 0.0, 0.2, 0.1, 0.1)
    height = np.zeros(grid.shape, np.float32)
    occupancy = np.zeros(grid.shape, np.float32)
    height[0, 0], occupancy[0, 0] = 1.6, 0.003
    points = FloorPoints(
        np.array([[0.05, 0.05, 1.0], [0.06, 0.05, 1.6]], np.float32),
        np.array([0.001, 0.002], np.float32),
        np.array([7, 8], np.int32),
        np.array([1, 2], np.uint8),
    )
    view = CameraViewpoint(np.array([0.0, 0.0, 2.0]), 0.01, np.eye(3, 4), (160, 120))
    return PlanViewMaps(grid, height, occupancy, height, occupancy, 0.0, points, view)


@pytest.mark.parametrize("variant", LADDER, ids=lambda v: v.name)
def test_variant_changes_the_configuration_by_known_parameters(variant):
    changed = load_config(None, variant.settings) != Config()
    assert changed or variant.way != "online" or variant.harville


def test_variants_of_foreground_and_feedback_run_in_full_and_others_from_recorded_points():
    full = {v.name for v in LADDER if not v.tracker_only}
    assert full == {"feedback off", "colour only foreground"}


def test_maps_without_occupancy_count_cells_and_keep_their_highest_point(maps):
    left = reduced(maps, "height")
    assert left.height[0, 0] == pytest.approx(1.6)
    assert left.occupancy[0, 0] == pytest.approx(0.01)
    assert left.occupancy[0, 1] == 0
    assert left.points.pixels.tolist() == [8]
    assert left.points.colours.tolist() == [2]
    assert left.points.area.tolist() == pytest.approx([0.01])


def test_maps_without_height_are_equally_high_and_keep_occupancy(maps):
    left = reduced(maps, "occupancy")
    assert left.height[0].tolist() == pytest.approx([NOMINAL_HEIGHT_M, 0.0])
    assert left.points.xyz[:, 2].tolist() == pytest.approx([NOMINAL_HEIGHT_M] * 2)
    assert left.occupancy[0, 0] == pytest.approx(0.003)
    assert maps.points.xyz[0, 2] == 1.0


def test_interval_spans_the_resampled_recordings():
    samples = np.array([[0, 0], [0, 1], [1, 0], [1, 1]])
    value, low, high = bootstrap(np.array([0.0, 4.0]), np.array([1.0, 1.0]), samples)
    assert value == 2.0
    assert low == pytest.approx(0.15)
    assert high == pytest.approx(3.85)


def test_interval_of_equal_recordings_is_their_figure():
    assert bootstrap(np.array([3.0, 3.0]), np.array([2.0, 2.0]), np.array([[0, 1], [1, 1]])) == (1.5, 1.5, 1.5)


def test_unknown_variant_is_refused_with_the_known_ones():
    with pytest.raises(InputError, match="height only"):
        chosen_variants(["joint"])


def test_command_compares_variants_with_the_engine_as_configured(recording, tmp_path, capsys):
    cache, folder, _ = recording
    variants = ["without colours", "harville", "naive engine"]
    out = tmp_path / "ablation.json"
    ablation(options=AblationOptions(recording=[folder], variant=variants, cache=cache, out=out))
    assert "naive engine" in capsys.readouterr().out
    result = json.loads(out.read_text())
    assert result["recordings"] == [folder.name]
    names = [row["variant"] for row in result["variants"]]
    assert names == [CONFIGURED.name, *variants]
    assert result["variants"][0]["change_per_10_min"] == [0.0, 0.0, 0.0]
    # One person alone: colours hardly decide where.
    as_configured, without_colours = (row["position_error_m"][0] for row in result["variants"][:2])
    assert without_colours == pytest.approx(as_configured, abs=0.02)


def test_command_refuses_a_recording_without_truth(tmp_path):
    with pytest.raises(InputError, match=r"truth\.csv"):
        ablation(options=AblationOptions(recording=[tmp_path], cache=tmp_path))


def test_table_has_every_figure_with_its_interval_and_the_papers_count(capsys):
    some = Interval(0.104, 0.087, 0.116)
    errors = {"total": 9, "lost": 5, "missed": 0, "swapped": 4, "false_track": 0}
    rows = [AblationRow(v, errors, *[some] * 6) for v in (CONFIGURED, LADDER[1])]
    print_ablation(rows, Console(width=TABLE_WIDTH))
    text = capsys.readouterr().out
    assert "5, 0, 4, 0" in text
    assert "[8.7, 11.6]" in text
    assert "17" in text
    assert "height only: the paper's tracker without occupancy" in text
    assert "…" not in text
