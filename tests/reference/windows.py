"""Plain twin of stereo/_window_kernels.py; it defines what the compiled choice of windows computes."""

from calib.types import F64, U8

Box = tuple[int, int, int, int]


def tight(tiles: U8, box: Box) -> Box | None:
    top, left, bottom, right = box
    rows, columns = tiles[top:bottom, left:right].nonzero()
    if not len(rows):
        return None
    return top + rows.min(), left + columns.min(), top + rows.max() + 1, left + columns.max() + 1


def cost(box: Box | None, per_pixel: F64, tile: int, rows: float, columns: float, fixed: float) -> float:
    if box is None:
        return 0.0
    top, left, bottom, right = box
    area = ((bottom - top) * tile + rows) * ((right - left) * tile + columns)
    return float(area * per_pixel[top, bottom - 1] + fixed)


def split(tiles: U8, per_pixel: F64, tile: int, rows: float, columns: float, fixed: float) -> set[Box]:
    def of(box: Box | None) -> float:
        return cost(box, per_pixel, tile, rows, columns, fixed)

    def parts(box: Box) -> tuple[float, set[Box]]:
        top, left, bottom, right = box
        if tiles[top:bottom, left:right].all():
            return of(box), {box}
        halves = [((top, left, cut, right), (cut, left, bottom, right)) for cut in range(top + 1, bottom)]
        halves += [((top, left, bottom, cut), (top, cut, bottom, right)) for cut in range(left + 1, right)]
        cuts = [(tight(tiles, a), tight(tiles, b)) for a, b in halves]
        (one, found), (other, more) = (parts(half) for half in min(cuts, key=lambda pair: of(pair[0]) + of(pair[1])))
        return (one + other, found | more) if one + other < of(box) else (of(box), {box})

    whole = tight(tiles, (0, 0, *tiles.shape))
    return set() if whole is None else parts(whole)[1]
