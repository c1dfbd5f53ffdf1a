"""Which change of a truth is named as what would make it fit the tracks."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from planview.evaluation.evaluate import evaluate_tracks
from planview.evaluation.explain import explanation, shift_between
from planview.trajectories.table import Trajectories, table_of

FRAMES = 200


def two_walkers() -> Trajectories:
    """One walks along x and turns round, the other along y with stops; 15 frames a second, boxes larger near by."""
    frame = np.arange(FRAMES)
    x = np.concatenate([np.interp(frame, [0, 130, 199], [-3.0, 3.0, 0.5]), np.full(FRAMES, 1.5)])
    y = np.concatenate([4.0 + np.sin(frame / 25), np.interp(frame, [0, 60, 90, 199], [1.0, 3.0, 3.0, 7.0])])
    boxes = {"left_px": 300 + 60 * x, "top_px": 400 - 40 * y, "width_px": 80 - 6 * y, "height_px": 200 - 20 * y}
    return table_of(
        {
            "frame": np.tile(frame, 2),
            "id": np.repeat([1, 2], FRAMES),
            "x_m": x,
            "y_m": y,
            "height_m": 1.7 + 0 * x,
            **boxes,
        },
        "walkers",
    )


TRUTH = two_walkers()


def laid(table: Trajectories, turn: complex) -> Trajectories:
    """Places as complex numbers times another one."""
    places = turn * (table.x_m + 1j * table.y_m)
    return replace(table, x_m=places.real, y_m=places.imag)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda t: replace(t, x_m=-t.x_m), "if its x axis is mirrored"),
        (lambda t: replace(t, x_m=t.y_m, y_m=t.x_m), "if its axes x and y are exchanged"),
        (lambda t: replace(t, x_m=t.x_m / 0.3048, y_m=t.y_m / 0.3048), "if its unit is feet"),
        (lambda t: replace(t, x_m=t.x_m + 1.0), "if it is +1.00, +0.00 m from the tracks (align them)"),
        (lambda t: replace(t, frame=t.frame - 60), "if the tracks are moved by -60 frames"),
        (lambda t: replace(u := t.where(t.frame % 3 == 0), frame=u.frame // 3), "if only 1 of 3 frames of the tracks"),
        (lambda t: replace(t, frame=t.track_id, track_id=t.frame), "if its columns of frames and ids are exchanged"),
        (lambda t: replace(t, x_m=-t.x_m, frame=t.frame + 40), "x axis is mirrored and the tracks are moved by +40"),
        (
            lambda t: replace(t, frame=t.frame + 30, y_m=t.y_m - 3),
            "by +30 frames and it is +0.00, -3.00 m from",
        ),
        (lambda t: laid(t, np.exp(0.5j)), "if it is turned by 29 degrees (align them)"),
        (lambda t: laid(t, -1.2), "if it is turned by 180 degrees and its places are 1.2 times as far apart"),
        (lambda t: replace(t, frame=2 * t.frame), "if it has 2 numbers for each frame of the tracks"),
    ],
)
def test_a_change_of_the_truth_is_named(change: Callable[[Trajectories], Trajectories], named: str) -> None:
    assert named in explanation(change(TRUTH), TRUTH, on_floor=True)


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (
            lambda t: replace(t, box_px=t.box_px + np.column_stack([t.box_px[:, 2:] / 2, 0 * t.box_px[:, 2:]])),
            "if its boxes are given by their middle",
        ),
        (
            lambda t: replace(t, box_px=np.column_stack([t.box_px[:, :2], t.box_px[:, :2] + t.box_px[:, 2:]])),
            "if its boxes are given by two corners",
        ),
    ],
)
def test_a_form_of_boxes_is_named(change: Callable[[Trajectories], Trajectories], named: str) -> None:
    assert named in explanation(change(TRUTH), TRUTH, on_floor=False)


def test_nothing_is_named_where_the_score_is_good_or_the_truth_is_of_other_people() -> None:
    order = np.random.default_rng(0).permutation(len(TRUTH))
    others = replace(TRUTH, x_m=TRUTH.x_m[order], y_m=TRUTH.y_m[order[::-1]])
    assert explanation(TRUTH, TRUTH, on_floor=True) == explanation(others, TRUTH, on_floor=True) == ""


def test_a_shift_is_found_however_long() -> None:
    assert shift_between(TRUTH, replace(TRUTH, frame=TRUTH.frame + 120), on_floor=True) == -120


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: replace(t, x_m=-t.x_m), "x axis is mirrored"),
        (lambda t: replace(t, frame=2 * t.frame), "it has 2 numbers for each frame"),
        (
            lambda t: replace(t, visible=np.where(t.frame < 150, 0.0, 0.9)),
            "300 of 400 rows of the truth are",
        ),
        (lambda t: replace(t, height_m=t.height_m / 2), "heights of the truth are 0.5 times those of the tracks"),
    ],
)
def test_an_evaluation_says_what_would_explain_it(change: Callable[[Trajectories], Trajectories], said: str) -> None:
    assert said in evaluate_tracks(TRUTH, change(TRUTH), frames=(0, FRAMES - 1)).uncovered


def test_no_shift_is_named_of_a_truth_that_a_shift_does_not_explain() -> None:
    assert evaluate_tracks(TRUTH, laid(TRUTH, np.exp(0.5j))).shift == 0


def test_an_evaluation_says_that_all_rows_are_hidden() -> None:
    scores = evaluate_tracks(TRUTH, replace(TRUTH, visible=np.zeros(len(TRUTH))))
    assert f"all {len(TRUTH)} rows hidden" in scores.headline
