"""Plain numpy twins of the human-model tracker's kernels; they define what the compiled loops compute."""

import numpy as np

from calib.types import F32, F64, I32, I64, U8, Bool
from planview.foreground.masks import BACKGROUND, PERSON
from planview.tracking.human_model.model_map import HumanModelMap


def _entry(model_map: HumanModelMap, u: float, v: float) -> int:
    """Entry of the node nearest to a foot pixel, of two equally near ones the later; -1 where no person is possible."""
    col, row = (
        int(np.floor((p - o) / model_map.params.step_px + 0.5))
        for p, o in zip((u, v), model_map.origin_px, strict=True)
    )
    inside = 0 <= row < model_map.index.shape[0] and 0 <= col < model_map.index.shape[1]
    return int(model_map.index[row, col]) if inside else -1


def image_size(model_map: HumanModelMap, entry: int, scale: float) -> float:
    """Size in the image over the average person's: head and foot are apart by s / (1 - s h cos(tilt) / Z).

    In proportion where heads are mostly nearer than feet by less than half of the feet's distance.
    """
    camera, away_m = model_map.camera, model_map.floor_m[:, 1].astype(np.float64)
    depth = away_m * np.sin(camera.tilt_rad) + camera.height_m * np.cos(camera.tilt_rad)
    nearer = model_map.model.height_m * np.cos(camera.tilt_rad) / depth
    if np.median(nearer) < 0.5:
        return scale
    near = float(nearer[entry])
    return float(scale * (1.0 - near) / max(1.0 - scale * near, 0.25 * (1.0 - near)))


def model_mask(model_map: HumanModelMap, u: float, v: float, scale: float) -> Bool:
    """(H, W) pixels of the model with its foot at (u, v): per row, the columns between the polygon's borders."""
    width, height = model_map.camera.size
    mask = np.zeros((height, width), dtype=np.bool_)
    entry = _entry(model_map, u, v)
    if entry < 0:
        return mask
    scale = image_size(model_map, entry, scale)
    # In the order of the kernel, since rows are rounded.
    moved = np.array([u, v]) - scale * model_map.foot_px[entry].astype(np.float64)
    polygon = scale * model_map.hull_px[entry].astype(np.float64) + moved
    after = np.roll(polygon, -1, axis=0)
    for y in range(height):
        crosses = (np.minimum(polygon[:, 1], after[:, 1]) <= y) & (y <= np.maximum(polygon[:, 1], after[:, 1]))
        if crosses.any():
            p, q = polygon[crosses], after[crosses]
            dy = q[:, 1] - p[:, 1]
            flat = dy == 0
            t = np.where(flat, 0.0, (y - p[:, 1]) / np.where(flat, 1.0, dy))
            x = p[:, 0] + t * (q[:, 0] - p[:, 0])
            mask[y, max(0, int(np.ceil(x.min()))) : max(0, int(np.floor(x.max())) + 1)] = True
    return mask


def model_rows(model_map: HumanModelMap, u: float, v: float, scale: float) -> int:
    """Rows of the image that the model's polygon reaches, inside or to the left or right of the image."""
    entry = _entry(model_map, u, v)
    if entry < 0:
        return 0
    scale = image_size(model_map, entry, scale)
    moved = v - scale * float(model_map.foot_px[entry, 1])
    y = scale * model_map.hull_px[entry, :, 1].astype(np.float64) + moved
    return max(0, min(model_map.camera.height, int(np.floor(y.max())) + 1) - max(0, int(np.ceil(y.min()))))


def first_row_of_legs(model_map: HumanModelMap, u: float, v: float, scale: float) -> int:
    """First row of the lower half of a model that is upright in the image; below the image for any other."""
    entry = _entry(model_map, u, v)
    head_up = model_map.foot_px[:, 1] - model_map.head_px[:, 1]
    if entry < 0 or head_up[entry] < 0.5 * model_map.boxes()[entry, 2:].max():
        return model_map.camera.height
    scale = image_size(model_map, entry, scale)
    # In the order of the kernel, since rows are rounded.
    y = model_map.hull_px[entry, :, 1]
    waist = float(y.max()) - 0.5 * float(y.max() - y.min())
    return int(np.ceil(scale * waist + (v - scale * float(model_map.foot_px[entry, 1]))))


def with_ring(mask: Bool, n_rows: int, ring: float) -> Bool:
    """A model's pixels and, on both sides of each row, ``ring`` times its mean width."""
    margin = int(ring * mask.sum() / max(1, n_rows) + 0.5)
    wide = np.zeros_like(mask)
    for y in np.flatnonzero(mask.any(axis=1)):
        x = np.flatnonzero(mask[y])
        wide[y, max(0, x[0] - margin) : x[-1] + 1 + margin] = True
    return wide


def counts(
    mask: Bool, n_rows: int, legs_from: int, evidence: U8, cover: U8, hiding: U8, ring: float
) -> tuple[int, ...]:
    """Area, free evidence, taken pixels, free evidence in the ring, free pixels hidden by the scene, and twice the
    background from a row on."""
    free = np.where(cover > 0, 0, evidence).astype(np.int64)
    outside = with_ring(mask, n_rows, ring) & ~mask
    hidden = mask & (cover == 0) & (evidence == 0) & (hiding > 0)
    sums = int(mask.sum()), int(free[mask].sum()), int((cover[mask] > 0).sum()), int(free[outside].sum())
    legs = mask & (np.arange(len(mask))[:, None] >= legs_from) & (cover == 0) & ~hidden
    return (*sums, int(hidden.sum()), 2 * int(legs.sum()) - int(free[legs].sum()))


def measured(mask: Bool, evidence: U8, motion: U8, cover: U8, hiding: U8) -> tuple[int, ...]:
    """Area, evidence, evidence of this model alone, shared, hidden and moving pixels, as ``measure_models``."""
    return (
        int(mask.sum()),
        int(evidence[mask].sum()),
        int(evidence[mask & (cover == 1)].sum()),
        int((mask & (cover > 1)).sum()),
        int((mask & (cover == 1) & (evidence == 0) & (hiding > 0)).sum()),
        int((mask & (motion > 0)).sum()),
    )


def breadth(mask: Bool, n_rows: int, evidence: U8, cover: U8, ring: float) -> tuple[float, int]:
    """Squared distances from the rows' middles of foreground of a model and its ring, and the number of pixels."""
    own = (evidence > 1) & ((cover == 0) | (mask & (cover == 1))) & with_ring(mask, n_rows, ring)
    rows, x = np.nonzero(own)
    ends = [np.flatnonzero(mask[y])[[0, -1]] for y in rows]
    return float(sum((u - 0.5 * (a + b)) ** 2 for u, (a, b) in zip(x, ends, strict=True))), len(x)


def still_times(evidence: U8, motion: U8, claimed: U8, labels: I32, dt_s: float, still_s: F32) -> F32:
    """Times for which pixels have been foreground without motion, away from all blobs that are claimed in part."""
    apart = ~np.isin(labels, labels[claimed > 0])
    still = (evidence > 1) & (motion == 0) & (claimed == 0) & apart
    return np.where(still, still_s + np.float32(dt_s), np.float32(0.0))


def hiding_times(mask: Bool, evidence: U8, cover: U8, dt_s: float, expected_s: F32, shown_s: F32) -> tuple[F32, F32]:
    """Times for which one model alone covered pixels, and for which they then were foreground; nothing is forgotten."""
    alone = mask & (cover == 1)
    added = np.float32(dt_s) * alone
    return expected_s + added, shown_s + added * (evidence > 0)


def open_distances(mask: Bool, evidence: U8, cover: U8, away_m: float, open_m: F32) -> F32:
    """Greatest distance of a person whom only this model covers, where it shows foreground."""
    return np.where(mask & (cover == 1) & (evidence > 0), np.maximum(open_m, np.float32(away_m)), open_m)


def unclaimed_times(
    evidence: U8, motion: U8, labels: I32, dt_s: float, now_s: float, limits: tuple[float, float, float], stay_s: F32,
    moved_s: F32,
) -> tuple[F32, F32, I64, I64]:  # fmt: skip
    """For how long pixels have been evidence, when they last moved, and each blob's pixels of foreground, and of those
    that moved lately."""
    there, step, n = evidence > 0, np.float32(dt_s), int(labels.max()) + 1
    stay = np.where(
        there,
        np.minimum(np.float32(limits[0]), stay_s + step),
        np.maximum(np.float32(0), np.minimum(stay_s, np.float32(limits[1])) - step),
    )
    moved = np.where(there & (motion > 0), np.float32(now_s), moved_s)
    salient = evidence > 1
    recent = salient & (moved >= np.float32(now_s - limits[2]))
    return stay, moved, np.bincount(labels[salient], minlength=n), np.bincount(labels[recent], minlength=n)


def known(still_s: F32, limit_s: float, labels: I32, lively: Bool, claimed: U8, evidence: U8, people: bool) -> U8:
    """What is known of pixels: people where foreground proper is claimed, else background where it is long still."""
    out = np.where((still_s >= limit_s) & ~lively[labels], np.uint8(BACKGROUND), np.uint8(0))
    return np.where(people & (claimed > 0) & (evidence == 2), np.uint8(PERSON), out)


def histogram(mask: Bool, image: U8, evidence: U8, cover: U8, level: U8, n_levels: int, parts: int) -> F32:
    """(parts, n_levels^3) colours of the evidence that only this model covers."""
    out = np.zeros((parts, n_levels**3), np.float32)
    rows = np.flatnonzero(mask.any(axis=1))
    y, x = np.nonzero(mask & (evidence > 0) & (cover == 1))
    part = np.minimum(parts - 1, (y - rows[0]) * parts // (rows[-1] + 1 - rows[0]))
    b, g, r = (level[image[y, x, c]].astype(np.int64) for c in range(3))
    np.add.at(out, (part, (b * n_levels + g) * n_levels + r), 1.0)
    total = out.sum(axis=1, keepdims=True)
    return np.where(total > 0, out / np.where(total > 0, total, 1), 0).astype(np.float32)


def along_axis(evidence: U8, cover: U8, foot: F64, axis: F64, half_width: float, n: int) -> I64:
    """(n,) evidence near the body's axis, by position along it from -0.4 to 1.4."""
    y, x = np.nonzero((evidence > 0) & (cover <= 1))
    d = np.stack([x, y], axis=1) - foot
    near = np.abs(d[:, 0] * axis[1] - d[:, 1] * axis[0]) <= half_width * np.hypot(*axis)
    k = np.floor((d @ axis / (axis @ axis) + 0.4) / 1.8 * n).astype(np.int64)
    keep = near & (k >= 0) & (k < n)
    bins = np.zeros(n, np.int64)
    np.add.at(bins, k[keep], evidence[y[keep], x[keep]])
    return bins


def boxes_over(boxes: F32, inside: F32, blob: F64, area_px: float, shares: tuple[float, float], side_px: float) -> Bool:
    """(N,) models whose box has at least the first share of its inside over the blob's box, of which the blob has at
    least the second share in pixels, and whose longest side is long enough."""
    low = np.maximum(boxes[:, :2], blob[:2])
    high = np.minimum(boxes[:, :2] + boxes[:, 2:], blob[:2] + blob[2:])
    common = np.maximum(0.0, high - low).prod(axis=1)
    enough = (common >= shares[0] * inside) & (area_px >= shares[1] * inside)
    return np.asarray(enough & (boxes[:, 2:].max(axis=1) >= side_px))
