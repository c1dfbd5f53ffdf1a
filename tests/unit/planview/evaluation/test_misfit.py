"""Which change of a truth is named as what would make it fit the tracks."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib.types import F64
from planview.evaluation.evaluate import evaluate_tracks
from planview.evaluation.misfit import misfit
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


def named_by(truth: Trajectories, tracks: Trajectories, on_floor: bool = True) -> str:
    cause = misfit(truth, tracks, on_floor)
    return cause.names if cause else ""


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda t: replace(t, x_m=-t.x_m), "the truth's x axis is mirrored"),
        (lambda t: replace(t, x_m=t.y_m, y_m=t.x_m), "the truth's axes x and y are exchanged"),
        (lambda t: replace(t, x_m=t.x_m / 0.3048, y_m=t.y_m / 0.3048), "the truth's unit is feet"),
        (lambda t: replace(t, x_m=t.x_m + 1.0), "the truth is +1.00, +0.00 m from the tracks"),
        (lambda t: replace(t, frame=t.frame - 60), "the truth's frames are numbered 60 lower"),
        (
            lambda t: replace(u := t.where(t.frame % 3 == 0), frame=u.frame // 3),
            "1/3 times the frame rate",
        ),
        (
            lambda t: replace(u := t.where(t.frame % 5 == 2), frame=u.frame // 5),
            "1/5 times the frame rate",
        ),
        (lambda t: replace(t, frame=t.track_id, track_id=t.frame), "columns of frames and ids are exchanged"),
        (
            lambda t: replace(t, x_m=-t.x_m, frame=t.frame + 40),
            "is mirrored and the truth's frames are numbered 40 hi",
        ),
        (lambda t: laid(t, np.exp(0.5j)), "the truth is turned by 29 degrees"),
        (lambda t: laid(t, -1.2), "180 degrees and has places 1.2 times as far apart"),
        (lambda t: replace(t, frame=2 * t.frame), "the truth has 2 times the frame rate"),
        (lambda t: replace(t, frame=5 * t.frame // 3), "the truth has 5/3 times the frame rate"),
    ],
)
def test_a_change_of_the_truth_is_named(change, named):
    assert named in named_by(change(TRUTH), TRUTH)


@pytest.mark.parametrize("degrees", [90, -90, 40, -40, 100])
def test_a_turn_is_named_with_its_own_sign(degrees):
    assert named_by(laid(TRUTH, np.exp(1j * np.radians(degrees))), TRUTH) == f"the truth is turned by {degrees} degrees"


def with_boxes(first: Callable[[F64, F64], F64], size: Callable[[F64, F64], F64]) -> Trajectories:
    """The walkers with other first and last two numbers of their boxes, made of their left, top and size."""
    corner = TRUTH.box_px[:, :2]
    extent = TRUTH.box_px[:, 2:]
    return replace(TRUTH, box_px=np.column_stack([first(corner, extent), size(corner, extent)]))


@pytest.mark.parametrize(
    ("changed", "form"),
    [
        (with_boxes(lambda a, s: a + s / 2, lambda a, s: s), "given by their middle"),
        (with_boxes(lambda a, s: a + s * [0.5, 1.0], lambda a, s: s), "given by the middle of their lower edge"),
        (with_boxes(lambda a, s: a / 2, lambda a, s: s / 2), "of images half as large"),
    ],
    ids=["middle", "foot", "half"],
)
def test_a_form_of_boxes_is_named_in_either_table(changed, form):
    assert named_by(changed, TRUTH, on_floor=False) == f"the truth's boxes are {form}"
    assert named_by(TRUTH, changed, on_floor=False) == f"the tracks' boxes are {form}"


def test_nothing_is_named_where_the_score_is_good_or_the_truth_is_of_other_people():
    order = np.random.default_rng(0).permutation(len(TRUTH))
    others = replace(TRUTH, x_m=TRUTH.x_m[order], y_m=TRUTH.y_m[order[::-1]])
    assert misfit(TRUTH, TRUTH, on_floor=True) is misfit(others, TRUTH, on_floor=True) is None


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda t: replace(t, x_m=-t.x_m), "x axis is mirrored"),
        (lambda t: replace(t, frame=2 * t.frame), "2 times the frame rate"),
        (lambda t: replace(t, height_m=t.height_m / 2), "0.5 times those of the tracks"),
    ],
)
def test_an_evaluation_says_what_would_explain_it(change, said):
    assert said in evaluate_tracks(TRUTH, change(TRUTH), frames=(0, FRAMES - 1)).doubts


def test_an_evaluation_says_that_all_rows_are_hidden():
    scores = evaluate_tracks(TRUTH, replace(TRUTH, visible=np.zeros(len(TRUTH))))
    assert f"0 of {len(TRUTH)} positions judged" in scores.headline
