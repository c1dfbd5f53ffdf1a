"""Plain numpy twin of planview/engine/_feedback_kernels.py; it defines what the compiled loop computes."""

from calib.types import F32, F64, I32, U8


def paint(xyz: F32, pixels: I32, people: F64, body_m: float, ground_m: float, persons: U8, ground: U8) -> None:
    squared = ((xyz[:, None, :2].astype(float) - people[None, :, :2]) ** 2).sum(axis=2)
    near = squared < body_m**2
    persons[pixels[(near & (people[None, :, 2] > 0)).any(axis=1)]] = 1
    ground[pixels[~near.any(axis=1) & (xyz[:, 2] < ground_m)]] = 1
