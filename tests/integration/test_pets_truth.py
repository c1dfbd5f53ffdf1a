"""The PETS layout and both of its protocols, on the real annotation."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from planview.evaluation.evaluate import EvaluationParams, evaluate_tracks
from planview.trajectories.formats import load_truth
from planview.trajectories.table import Trajectories


@pytest.fixture
def truth(shared_data: Path) -> Trajectories:
    path = shared_data / "pets09-s2l1-view001" / "gt.txt"
    if not path.is_file():
        pytest.skip(f"{path} is not here")
    return load_truth(path)


def test_annotation_has_its_rows_from_frame_zero(truth: Trajectories) -> None:
    assert (len(truth), int(truth.frame[0]), int(truth.frame[-1])) == (2396, 0, 399)


def test_annotation_scores_full_marks_against_itself_in_boxes(truth: Trajectories) -> None:
    result = evaluate_tracks(truth, truth, EvaluationParams(match_on="boxes", fps=7.0)).to_json()
    assert (result["truth_rows"], result["mota"], result["idf1"]) == (2396, 1.0, 1.0)
    assert result["significant_errors"]["total"] == 0


def test_turned_and_shifted_world_is_aligned_on_the_floor(truth: Trajectories) -> None:
    rng = np.random.default_rng(0)
    turned = replace(
        truth,
        x_m=20.0 - truth.y_m + rng.normal(0, 0.2, len(truth)),
        y_m=-5.0 + truth.x_m + rng.normal(0, 0.2, len(truth)),
        box_px=np.full_like(truth.box_px, np.nan),
    )
    result = evaluate_tracks(turned, truth, EvaluationParams(gate_m=1.0, align=True, fps=7.0)).to_json()
    assert result["mota"] > 0.99
    assert result["position_error_mean_m"] == pytest.approx(0.25, abs=0.02)
    assert result["alignment"]["rotation_deg"] == pytest.approx(-90.0, abs=1.0)
