"""Boards: found in images, solved for cameras."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from board_views import board_views, calibration_errors, random_rig

from calib.board.detect import (
    Board,
    BoardView,
    Corners,
    Detector,
    complete_charuco,
    dictionaries,
    find_counts,
    larger_counts,
    same_order,
)
from calib.board.fit import fit_rig, select_views, sharpness
from calib.board.solve import LENSES, RejectedView, choose_lens, solve_board
from calib.errors import InputError
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import U8

PX = 30


def board_image(cols: int, rows: int) -> U8:
    """A chessboard from straight ahead: corner (0, 0) at pixel (3 PX - 0.5, 3 PX - 0.5)."""
    y, x = np.mgrid[: (rows + 1) * PX, : (cols + 1) * PX]
    board = (((x // PX + y // PX) % 2) * 200 + 25).astype(np.uint8)
    framed = cv2.copyMakeBorder(board, 2 * PX, 2 * PX, 2 * PX, 2 * PX, cv2.BORDER_CONSTANT, value=225)
    return cv2.GaussianBlur(framed, (0, 0), 0.8)


@pytest.mark.parametrize(("counts", "scale", "most_px"), [((8, 5), 1, 0.01), ((9, 6), 1 / 3, 0.1)])
def test_corners_are_found_to_a_fraction_of_a_pixel(counts, scale, most_px):
    image = cv2.resize(board_image(*counts), None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    corners = Detector(Board(*counts, 0.03))(image)
    expected = (Board(*counts, 0.1).points[:, :2] / 0.1 * PX + 3 * PX) * scale - 0.5
    assert min(np.abs(order - expected).max() for order in (corners.pixels, corners.pixels[::-1])) < most_px


def test_counts_of_a_board_are_found():
    assert find_counts([board_image(8, 5)] * 3) == (8, 5)


@pytest.mark.parametrize(("given", "larger"), [((4, 3), (8, 5)), ((5, 8), None)], ids=["part", "whole"])
def test_counts_of_a_part_are_enlarged_to_the_whole_board(given, larger):
    assert larger_counts([board_image(8, 5)] * 3, given) == larger


def test_no_board_is_found_where_there_is_none():
    noise = np.random.default_rng(0).integers(0, 255, (120, 160)).astype(np.uint8)
    blank = np.full((120, 160), 90, np.uint8)
    assert find_counts([blank, noise]) is None
    assert Detector(Board(7, 5, 0.03))(blank) is None


@pytest.mark.parametrize(("cols", "rows", "quarters"), [(7, 5, 2), (4, 4, 1)])
def test_order_of_a_board_that_looks_alike_when_turned_follows_the_other_camera(cols, rows, quarters):
    board, ids = Board(cols, rows, 0.03), np.arange(cols * rows)
    pixels = board.points[:, :2] * 1000
    turned = np.rot90(pixels.reshape(rows, cols, 2), quarters).reshape(-1, 2) - [20.0, 0.0]
    found = same_order(board, Corners(ids, pixels), Corners(ids, turned))
    np.testing.assert_allclose(found.pixels, pixels - [20.0, 0.0])


def charuco(name: str) -> tuple[Board, U8]:
    board = Board(6, 4, 0.04, name, 0.03)
    made = cv2.aruco.CharucoBoard((7, 5), 0.04, 0.03, cv2.aruco.getPredefinedDictionary(dictionaries()[name]))
    return board, made.generateImage((700, 500), marginSize=20)


def test_charuco_corners_carry_their_ids_when_half_of_the_board_is_hidden():
    board, image = charuco("DICT_5X5_100")
    whole = Detector(board)(image)
    image[:, 400:] = 255
    part = Detector(board)(image)
    assert len(whole.ids) == 24
    assert 8 <= len(part.ids) < 24
    both = dict(zip(whole.ids.tolist(), whole.pixels, strict=True))
    assert max(np.abs(both[int(i)] - p).max() for i, p in zip(part.ids, part.pixels, strict=True)) < 0.5


def test_dictionary_of_a_charuco_board_is_found():
    board, large = charuco("DICT_6X6_250")
    image = cv2.resize(large, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA)
    opened = Board(6, 4, 0.04, "DICT_4X4_50", 0.03)
    found = complete_charuco(opened, [image], any_dictionary=True, any_marker=True)
    # Smaller dictionaries of a family begin with the same markers.
    assert found.dictionary.startswith("DICT_6X6_")
    assert Detector(found)(image) is not None
    assert (found.cols, found.rows) == (board.cols, board.rows)


def test_blur_lowers_sharpness():
    image = board_image(8, 5)
    corners = Detector(Board(8, 5, 0.03))(image)
    blurred = cv2.GaussianBlur(image, (0, 0), 3)
    assert sharpness(blurred, corners) < 0.6 * sharpness(image, corners)


def test_selection_prefers_sharp_views_that_differ():
    rng = np.random.default_rng(0)
    rig = random_rig("plain", rng)
    different = board_views(rig, Board(7, 5, 0.04), 10, 0.0, rng)
    views = [different[0]] * 20 + different[1:]
    sharp = [1.0] * 28 + [0.2]
    taken = select_views(views, Board(7, 5, 0.04).points, sharp, rig.left.size, limit=9)
    assert 28 not in taken
    assert set(range(20, 28)) <= set(taken)


BOARD = Board(7, 5, 0.04)
SIZE = (1280, 800)


def views_of(lens: str = "brown", n: int = 20, noise_px: float = 0.2, seed: int = 0):
    rng = np.random.default_rng(seed)
    rig = random_rig(lens, rng)
    return rig, board_views(rig, BOARD, n, noise_px, rng)


def test_exact_corners_give_the_exact_rig():
    truth, views = views_of(n=8, noise_px=0.0)
    found = solve_board(views, BOARD, SIZE, model="brown")
    assert max(calibration_errors(truth, found.rig)) < 1e-3
    assert found.fit.rms_px < 1e-4


@pytest.mark.parametrize(("lens", "seed"), [("brown", 1), ("brown", 3), ("fisheye", 2)])
def test_noisy_corners_give_the_rig_within_its_deviations(lens, seed):
    truth, views = views_of(lens, 24, seed=seed)
    found = solve_board(views, BOARD, SIZE, model="fisheye" if lens == "fisheye" else "brown")
    focal, baseline, turn_deg = calibration_errors(truth, found.rig)
    assert focal < 0.2
    assert baseline < 0.3
    assert turn_deg < 0.05
    assert abs(found.rig.left.fx - truth.left.fx) < 4 * found.std["left fx"] < 0.008 * truth.left.fx
    assert abs(found.rig.baseline_m - truth.baseline_m) < 4 * found.std["baseline"]


def test_lens_is_chosen_by_views_left_out():
    _, views = views_of("fisheye", 8, seed=4)
    found = solve_board(views, BOARD, SIZE)
    assert choose_lens(found.lenses).lens.model == found.rig.left.model == "fisheye"
    # A lens that fits far worse than the best is not judged on other views, and not listed.
    names = {one.name for one in found.lenses}
    assert "fisheye (k1-k4)" in names
    assert "brown (k1 k2 p1 p2)" not in names


@pytest.mark.parametrize("seed", [1, 2, 3])
def test_rotation_of_a_rig_without_distortion_is_exact_to_three_hundredths_of_a_degree(seed):
    truth, views = views_of("plain", 12, seed=seed)
    assert calibration_errors(truth, solve_board(views, BOARD, SIZE).rig)[2] < 0.03


def test_view_with_wrong_corners_is_left_out():
    truth, views = views_of(n=12)
    views[4] = replace(views[4], right=views[4].right + np.array([6.0, -4.0]))
    found = solve_board(views, BOARD, SIZE, model="brown")
    assert [one.name for one in found.rejected] == ["view 04"]
    assert "times the median" in found.rejected[0].why
    assert calibration_errors(truth, found.rig)[1] < 0.3


def test_too_few_pairs_are_refused():
    _, views = views_of(n=4)
    with pytest.raises(InputError, match="found 4 of 5"):
        solve_board(views, BOARD, SIZE, rejected=[RejectedView("x", "blank")], source="photos")


def one_pose() -> list[BoardView]:
    view, noise = views_of(n=1)[1][0], 0.2 * np.random.default_rng(0).normal(size=(10, 2, len(BOARD.points), 2))
    return [BoardView(str(i), view.ids, view.left + a, view.right + b) for i, (a, b) in enumerate(noise)]


def never_tilted() -> list[BoardView]:
    camera, rng, views = random_rig("brown", np.random.default_rng(0)).left, np.random.default_rng(1), []
    for x, y in [(-0.3, -0.2), (0.1, -0.2), (-0.3, 0.0), (0.1, 0.0), (-0.1, -0.1), (-0.2, 0.02)]:
        sides = (camera.project(BOARD.points + np.array([x + right_m, y, 0.8])) for right_m in (0.0, -0.1))
        noisy = (p + 0.2 * rng.normal(size=p.shape) for p in sides)
        views.append(BoardView(str(len(views)), np.arange(len(BOARD.points)), *noisy))
    return views


def swapped() -> list[BoardView]:
    return [BoardView(view.name, view.ids, view.right, view.left) for view in views_of(n=8)[1]]


def torn() -> list[BoardView]:
    _, views = views_of(n=7)
    return [BoardView(a.name, a.ids, a.left, b.right) for a, b in zip(views, [*views[3:], *views[:3]], strict=True)]


def seen_at_a_square_of_2_cm() -> list[BoardView]:
    rng = np.random.default_rng(0)
    truth = random_rig("brown", rng)
    wide = StereoRig(truth.left, truth.right, SE3(truth.right_SE3_left.rotation, np.array([-0.25, 0.0, 0.0])))
    return board_views(wide, Board(7, 5, 0.02), 8, 0.1, rng)


@pytest.mark.parametrize(
    ("make", "square_m", "message"),
    [
        (one_pose, 0.04, "1 different pose"),
        (never_tilted, 0.04, "focal length"),
        (swapped, 0.04, "swapped"),
        (torn, 0.04, "expected"),
        (seen_at_a_square_of_2_cm, 0.5, "size of a square"),
    ],
)
def test_views_that_give_no_rig_are_refused_with_the_reason(make, square_m, message):
    with pytest.raises(InputError, match=message):
        solve_board(make(), Board(7, 5, square_m), SIZE, model="brown")


def test_errors_per_view_are_those_that_opencv_reports():
    truth, views = views_of("brown", 6)
    fit = fit_rig(views, BOARD.points, (truth.left, truth.right), LENSES[1])
    one = np.float32
    points = [BOARD.points.astype(one)] * 6
    left, right = ([view.image_points(side).astype(one) for view in views] for side in ("left", "right"))
    cameras = (truth.left.matrix, truth.left.coefficients, truth.right.matrix, truth.right.coefficients)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    extended = cv2.stereoCalibrateExtended
    *_, per_view = extended(points, left, right, *cameras, SIZE, None, None, flags=flags)
    found = np.sqrt((np.array(fit.errors) ** 2).sum(axis=3).mean(axis=2))
    np.testing.assert_allclose(found, per_view, rtol=0.01)


def test_fisheye_boards_of_which_parts_are_hidden_give_the_rig():
    # OpenCV's fisheye.stereoCalibrate demands the same number of corners in all views.
    truth, views = views_of("fisheye", 12, seed=2)
    views[3] = BoardView("part", views[3].ids[7:], views[3].left[7:], views[3].right[7:])
    found = solve_board(views, BOARD, SIZE, model="fisheye")
    assert len(found.views[3].ids) == 28
    assert calibration_errors(truth, found.rig)[1] < 0.3
