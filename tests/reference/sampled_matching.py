"""Plain numpy twin of stereo/_cost_kernels.py and stereo/_path_kernels.py: what a sampled match is."""

import numpy as np

from calib.types import I16, I64, U8

CAP = 31


def _slopes(image: I64) -> I64:
    """Horizontal Sobel within the cap; the outermost pixels are lost."""
    across = image[:, 2:] - image[:, :-2]
    return np.clip(across[:-2] + 2 * across[1:-1] + across[2:], -CAP, CAP) + CAP


def _ranges(values: I64) -> tuple[I64, I64, I64]:
    """Each value, and the least and largest within half a pixel along the row; the outermost columns are lost."""
    middle = values[:, 1:-1]
    before, after = (values[:, :-2] + middle) // 2, (values[:, 2:] + middle) // 2
    stack = np.stack([before, middle, after])
    return middle, stack.min(axis=0), stack.max(axis=0)


def _unlike(a: tuple[I64, I64, I64], b: tuple[I64, I64, I64]) -> I64:
    """Birchfield and Tomasi 1998."""
    one = np.maximum(np.maximum(a[0] - b[2], b[1] - a[0]), 0)
    other = np.maximum(np.maximum(b[0] - a[2], a[1] - b[0]), 0)
    return np.minimum(one, other)


def costs(left: U8, right: U8, offset: int, first: int, count: int, step: int, block_px: int) -> I64:
    """(rows, columns, count) block costs of the samples; edges are repeated outside of the images."""
    reach = block_px // 2 + 2
    y = np.clip(np.arange(-reach, left.shape[0] + reach), 0, left.shape[0] - 1)
    x = np.arange(-reach, left.shape[1] + reach)
    found = []
    for d in range(first, first + count):
        images = (
            image[y][:, np.clip(x + by, 0, image.shape[1] - 1)].astype(np.int64)
            for image, by in ((left, 0), (right, offset - d))
        )
        (slope, level), (other_slope, other_level) = (
            (_ranges(_slopes(image)), _ranges(image[1:-1, 1:-1])) for image in images
        )
        pixels = (_unlike(slope, other_slope) + _unlike(level, other_level) // 4)[1:-1]
        blocks = np.lib.stride_tricks.sliding_window_view(pixels, (block_px, block_px)).sum(axis=(2, 3))
        found.append(blocks[::step, ::step])
    return np.stack(found, axis=2)


def _path(costs_: I64, p1: int, p2: int) -> I64:
    """Along the first axis (Hirschmueller 2008, eq. 13)."""
    out = np.empty_like(costs_)
    out[0] = costs_[0]
    for k in range(1, len(costs_)):
        last = np.pad(out[k - 1], ((0, 0), (1, 1)), constant_values=10**6)
        lowest = out[k - 1].min(axis=1, keepdims=True)
        near = np.minimum(last[:, :-2], last[:, 2:]) + p1
        out[k] = costs_[k] + np.minimum(np.minimum(near, out[k - 1]), lowest + p2) - lowest
    return out


def disparities(costs_: I64, step: int, p1: int, p2: int, uniqueness_percent: int, left_right: int) -> I16:
    """(rows, columns) sixteenths above the first disparity; -16 where a test fails."""
    across = costs_.transpose(1, 0, 2)
    total = _path(costs_, p1, p2)
    total += _path(across, p1, p2).transpose(1, 0, 2) + _path(across[::-1], p1, p2)[::-1].transpose(1, 0, 2)
    return np.array([_decide(line, step, uniqueness_percent, left_right) for line in total], np.int16)


def _decide(total: I64, step: int, uniqueness_percent: int, left_right: int) -> list[int]:
    count = total.shape[1]
    best = total.argmin(axis=1)
    right: dict[int, tuple[int, int]] = {}
    unique = []
    for i, (line, d) in enumerate(zip(total.tolist(), best.tolist(), strict=True)):
        others = [cost for k, cost in enumerate(line) if abs(k - d) > 1]
        unique.append(all(cost * (100 - uniqueness_percent) >= 100 * line[d] for cost in others))
        place = i + (-d) // step
        if unique[-1] and (place not in right or line[d] < right[place][0]):
            right[place] = line[d], d
    out = []
    for i, (line, d) in enumerate(zip(total.tolist(), best.tolist(), strict=True)):
        d16 = 16 * d
        if 0 < d < count - 1:
            bend = max(line[d - 1] + line[d + 1] - 2 * line[d], 1)
            d16 += ((line[d - 1] - line[d + 1]) * 16 + bend) // (2 * bend)
        places = [i + (-(d16 // 16)) // step, i + (-((d16 + 15) // 16)) // step]
        agrees = any(place not in right or abs(right[place][1] - d) <= left_right for place in places)
        out.append(d16 if unique[i] and agrees else -16)
    return out
