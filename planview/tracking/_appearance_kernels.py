"""Compiled kernel of appearances; ``tests/reference/appearance.py`` defines it in plain numpy."""

from numba import njit

from calib.types import F32, F64, U8
from planview.tracking._near_kernels import cell_of, near_people


@njit(cache=True, nogil=True)
def colour_histograms(  # type: ignore[no-untyped-def]
    xyz: F32, area: F32, colours: U8, people: F64, radius_m: float, bounds: F64, histograms: F32
):
    """Add the visible surface of each point to the colour histogram of the nearest person's part at its height.

    ``people`` (K, 3): x, y, height of the top [m]; ``bounds`` (P,): lower bounds of the parts as shares of that height;
    ``histograms`` (K, P, CODES) arrives zeroed.
    """
    near = near_people(people, radius_m)
    for i in range(len(xyz)):
        nearest, who = radius_m * radius_m, -1
        cell = cell_of(near, float(xyz[i, 0]), float(xyz[i, 1]))
        if cell < 0:
            continue
        for k in near.people[near.starts[cell] : near.starts[cell + 1]]:
            squared = (xyz[i, 0] - people[k, 0]) ** 2 + (xyz[i, 1] - people[k, 1]) ** 2
            if squared < nearest:
                nearest, who = squared, k
        if who < 0:
            continue
        share = xyz[i, 2] / people[who, 2]
        part = -1
        for p in range(len(bounds)):
            if share >= bounds[p]:
                part = p
        if part >= 0 and share <= 1.1:
            histograms[who, part, colours[i]] += area[i]
