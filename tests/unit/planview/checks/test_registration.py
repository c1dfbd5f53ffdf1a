"""Depth against its own colour image: mirrored, shifted, of another size, late."""

import re
from collections.abc import Callable
from dataclasses import replace

import cv2
import numpy as np
import pytest

from calib.types import F32
from planview.checks.registration import registration_checks
from stereo.recording import RgbdFrame

W, H = 320, 240


def frame(index: int) -> RgbdFrame:
    """A room of boxes, and somebody who walks there and back."""
    rng = np.random.default_rng(1)
    image, depth = np.full((H, W), 90, np.uint8), np.full((H, W), 5.0, np.float32)
    boxes = [(*rng.integers(0, (W - 40, H - 40)), *rng.integers(20, 60, 2), rng.integers(0, 255), 2 + 2 * rng.random())
             for _ in range(9)]  # fmt: skip
    walker = (round(140 + 110 * np.sin(index / 9) + 20 * np.sin(index / 2.3)), 90, 30, 90, 230, 1.6)
    for x, y, width, height, level, z in (*boxes, walker):
        image[y : y + height, x : x + width], depth[y : y + height, x : x + width] = level, z
    noise = np.random.default_rng(index).normal(0, 3, (H, W))
    return RgbdFrame(index, index / 15, np.clip(image + noise, 0, 255).astype(np.uint8), depth)


FRAMES = [frame(index) for index in range(60)]


def failing(change: Callable[[F32], F32] = lambda depth: depth, late: int = 0) -> dict[str, str]:
    """Name and note of the checks that fail when depth is changed, or late by some frames."""
    pairs = zip(FRAMES[late:], FRAMES[: len(FRAMES) - late], strict=True)
    frames = [replace(now, depth_m=np.ascontiguousarray(change(then.depth_m))) for now, then in pairs]
    return {check.name: check.note for check in registration_checks(frames[::5], frames) if not check.ok}


def scaled(depth: F32) -> F32:
    to = np.array([[0.92, 0.0, 0.04 * W], [0.0, 0.92, 0.04 * H]])
    return np.asarray(cv2.warpAffine(depth, to, (W, H), flags=cv2.INTER_NEAREST, borderValue=float("nan")), np.float32)


def test_depth_of_its_image_passes() -> None:
    assert failing() == {}


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda depth: depth[:, ::-1], "depth is mirrored against its image"),
        (lambda depth: np.roll(depth, -12, axis=1), r"\+2[2-6] px to the right, [+-][0-2] down"),
        (lambda depth: np.roll(depth, 10, axis=0), r"[+-][0-2] px to the right, -(18|20|22) down"),
        (scaled, r"1\.09 of its size fits better"),
    ],
    ids=["mirrored", "to the left", "down", "another lens"],
)
def test_depth_that_is_not_of_its_image_is_named_with_its_figure(change: Callable[[F32], F32], named: str) -> None:
    assert re.search(named, failing(change)["depth on its image"])


@pytest.mark.parametrize("late", [1, 3])
def test_depth_that_is_late_is_named_with_its_delay(late: int) -> None:
    note = failing(late=late)["depth delay"]
    assert note.startswith("depth ") and note.endswith("late of its image, by movement")
    assert float(note.split()[1]) == pytest.approx(late, abs=0.3)


def test_images_without_edges_are_not_judged() -> None:
    flat = [replace(one, image=np.full((H, W), 90, np.uint8)) for one in FRAMES]
    assert all(check.ok for check in registration_checks(flat[::5], flat))
