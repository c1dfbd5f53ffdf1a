"""OpenCV FileStorage: ``intrinsics.yml`` with M1 D1 M2 D2 and ``extrinsics.yml`` with R T."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np

from calib.camera import Camera, LensModel
from calib.errors import InputError
from calib.pose import SE3
from calib.rig import StereoRig
from calib.types import F64


def load_rig(intrinsics: Path, extrinsics: Path, size: tuple[int, int]) -> StereoRig:
    """Read a pair of OpenCV files.

    Args:
        size: (width, height) [px]: these files do not hold it.
    Raises:
        InputError: unreadable, matrices missing, or values that cannot be a rig.
    """
    try:
        inner, outer = _matrices(intrinsics, ("M1", "D1", "M2", "D2")), _matrices(extrinsics, ("R", "T"))
        rig = StereoRig(
            _camera(inner["M1"], inner["D1"], size),
            _camera(inner["M2"], inner["D2"], size),
            SE3(outer["R"], outer["T"].reshape(-1)),
            intrinsics.name,
        )
    except ValueError as error:
        raise InputError(f"{intrinsics}: expected an OpenCV stereo calibration, found {error}") from error
    return rig.check(str(extrinsics))


def _matrices(path: Path, names: tuple[str, ...]) -> dict[str, F64]:
    try:
        storage = cv2.FileStorage(path.read_text(encoding="utf-8"), cv2.FILE_STORAGE_READ | cv2.FILE_STORAGE_MEMORY)
        matrices = {name: storage.getNode(name).mat() for name in names}
        storage.release()
    except (OSError, UnicodeDecodeError, SystemError, cv2.error) as error:
        raise InputError(f"{path}: expected an OpenCV FileStorage file, found {error}") from error
    for name, matrix in matrices.items():
        if matrix is None:
            raise InputError(f"{path}: expected the matrix {name}, found none")
    return {name: np.asarray(matrix, dtype=np.float64) for name, matrix in matrices.items()}


def _camera(matrix: F64, distortion: F64, size: tuple[int, int]) -> Camera:
    if matrix.shape != (3, 3):
        raise ValueError(f"a camera matrix of shape {matrix.shape}")
    coefficients = tuple(distortion.reshape(-1).tolist())
    model: LensModel = "rational" if len(coefficients) > 5 else "brown"
    fx, fy, cx, cy = (float(matrix[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2)))
    return Camera(*size, fx, fy, cx, cy, model, coefficients)
