"""Compiled kernel of the feedback mask; ``tests/reference/feedback.py`` defines it in plain numpy."""

from numba import njit

from calib.types import F32, F64, I32, U8
from planview.tracking._near_kernels import cell_of, near_people


@njit(cache=True, nogil=True)
def paint(  # type: ignore[no-untyped-def]
    xyz: F32, pixels: I32, people: F64, body_m: float, ground_m: float, persons: U8, ground: U8
):
    """Set pixels of points near walkers in ``persons``, and those of low points far from every person in ``ground``.

    ``people`` (K, 3) is x [m], y [m] and 1 for a confirmed track that has walked; ``persons`` and ``ground`` are flat
    images.
    """
    near = near_people(people, body_m)
    for i in range(len(xyz)):
        near_any = False
        cell = cell_of(near, float(xyz[i, 0]), float(xyz[i, 1]))
        within = near.people[near.starts[cell] : near.starts[cell + 1]] if cell >= 0 else near.people[:0]
        for k in within:
            dx = float(xyz[i, 0]) - people[k, 0]
            dy = float(xyz[i, 1]) - people[k, 1]
            if dx * dx + dy * dy < body_m * body_m:
                near_any = True
                if people[k, 2] > 0.0:
                    persons[pixels[i]] = 1
        if not near_any and xyz[i, 2] < ground_m:
            ground[pixels[i]] = 1
