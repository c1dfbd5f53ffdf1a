"""Plain numpy twins of ``planview/engine/_gate_kernels.py``."""

import numpy as np

from calib.types import U8


def forgive_known(image: U8, background: U8, step: int, levels: int, changed: U8) -> None:
    apart = np.abs(image[::step, ::step].astype(int) - background).max(axis=2)
    changed[apart <= levels] = 0


def remember_known(image: U8, measured: U8, foreground: U8, step: int, background: U8) -> None:
    known = (measured[::step, ::step] > 0) & (foreground[::step, ::step] == 0)
    background[known] = image[::step, ::step][known]
