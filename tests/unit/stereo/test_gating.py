"""Windows of a pair that are matched."""

import cv2
import numpy as np
import pytest
from reference import windows as reference

from stereo._kernels import split
from stereo.gating import TILE, Gate, MatchingParams, Window

SIZE = (320, 240)
SAMPLES = (120, 160)
NOTHING = np.zeros(SAMPLES, np.uint8)


def gate(refresh_s: float = 600.0) -> Gate:
    return Gate(SIZE, 1, MatchingParams(refresh_s=refresh_s), lambda window: 64)


def changed_at(*places: tuple[int, int]) -> np.ndarray:
    changed = NOTHING.copy()
    for x, y in places:
        changed[y // 2, x // 2] = 255
    return changed


@pytest.mark.parametrize("seed", range(6))
def test_windows_agree_with_the_plain_twin(seed: int) -> None:
    rng = np.random.default_rng(seed)
    tiles = (cv2.GaussianBlur(rng.random((30, 40)), (0, 0), 1.5) > 0.56).astype(np.uint8)
    work = np.full((30, 30), 80.0) + np.arange(30)
    settings = work, TILE, 36.0, 16.0, 20_000.0
    out = np.empty((200, 4), np.int64)
    n, _ = split(cv2.integral(tiles), *settings, out)
    found = {tuple(int(edge) for edge in box) for box in out[:n]}
    assert found == {tuple(int(edge) for edge in box) for box in reference.split(tiles, *settings)}


def test_nothing_is_matched_where_nothing_changed() -> None:
    assert gate().windows(NOTHING, [], 0.0) == []


def test_a_window_holds_a_change_and_what_is_near_it() -> None:
    assert gate().windows(changed_at((100, 60)), [], 0.0) == [Window(96, 56, 112, 72)]


def test_far_changes_have_windows_of_their_own() -> None:
    windows = gate().windows(changed_at((20, 20), (300, 220)), [], 0.0)
    assert sorted(windows) == [Window(16, 16, 32, 32), Window(296, 216, 312, 232)]


def test_people_are_matched_without_a_change() -> None:
    assert gate().windows(NOTHING, [(100.0, 60.0, 30.0, 80.0)], 0.0) == [Window(96, 56, 136, 144)]


def test_a_box_that_begins_outside_is_cut_off_at_the_edge() -> None:
    assert gate().windows(NOTHING, [(-0.5, -0.5, 10.0, 10.0)], 0.0) == [Window(0, 0, 16, 16)]


def test_the_whole_image_is_matched_when_most_of_it_changed() -> None:
    assert gate().windows(np.full(SAMPLES, 255, np.uint8), [], 0.0) == [Window(0, 0, *SIZE)]


def test_the_refresh_visits_every_pixel_in_its_time() -> None:
    chosen, visited = gate(refresh_s=2.0), np.zeros(SIZE[::-1], bool)
    for frame in range(31):
        windows = chosen.windows(NOTHING, [], frame / 15)
        assert sum((w.right - w.left) * (w.bottom - w.top) for w in windows) < 0.1 * visited.size
        for window in windows:
            visited[window.slices] = True
    assert visited.all()


def test_the_refresh_does_not_hurry_after_a_gap_in_time() -> None:
    chosen = gate(refresh_s=2.0)
    chosen.windows(NOTHING, [], 0.0)
    chosen.windows(NOTHING, [], 3600.0)
    assert chosen.windows(NOTHING, [], 3600.0) == []


def test_whole_image_is_cut_into_bands_where_far_rows_need_fewer_disparities() -> None:
    def searched(window: Window) -> int:
        return 16 if window.bottom <= 240 else 80

    whole = Gate((640, 480), 2, MatchingParams(), searched).whole
    assert len(whole) > 1
    assert [(w.left, w.right) for w in whole] == [(0, 640)] * len(whole)
    assert [w.top for w in whole] == [0, *(w.bottom for w in whole[:-1])]
    assert whole[-1].bottom == 480


def test_whole_image_is_one_window_where_all_rows_need_the_same() -> None:
    assert gate().whole == [Window(0, 0, *SIZE)]
