"""Rigid transforms, named ``dst_SE3_src``: ``p_dst = dst_SE3_src @ p_src``."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, overload

import cv2
import numpy as np
from numpy.typing import ArrayLike

from calib.types import F64


@dataclass(frozen=True, eq=False)
class SE3:
    """A rotation and a translation. Raises ValueError: wrong shapes, values that are not finite, or a matrix that is
    not a rotation.

    Attributes:
        rotation: (3, 3) float64, orthonormal, determinant +1.
        translation: (3,) float64 [m].
    """

    rotation: F64
    translation: F64

    def __post_init__(self) -> None:
        r = np.array(self.rotation, dtype=np.float64)
        t = np.array(self.translation, dtype=np.float64).reshape(-1)
        if r.shape != (3, 3) or t.shape != (3,):
            raise ValueError(f"expected a (3, 3) rotation and a (3,) translation, got {r.shape} and {t.shape}")
        if not (np.isfinite(r).all() and np.isfinite(t).all()):
            raise ValueError("expected a finite rotation and translation, got NaN or infinity")
        if not np.allclose(r @ r.T, np.eye(3), atol=1e-4) or np.linalg.det(r) < 0:
            raise ValueError("expected a rotation matrix (orthonormal, determinant +1)")
        r.flags.writeable = t.flags.writeable = False
        object.__setattr__(self, "rotation", r)
        object.__setattr__(self, "translation", t)

    @staticmethod
    def identity() -> SE3:
        return SE3(np.eye(3), np.zeros(3))

    @staticmethod
    def from_matrix(matrix: ArrayLike) -> SE3:
        """From a (4, 4) or (3, 4) homogeneous matrix."""
        m = np.asarray(matrix, dtype=np.float64)
        if m.shape not in {(4, 4), (3, 4)}:
            raise ValueError(f"expected a (4, 4) or (3, 4) matrix, got {m.shape}")
        return SE3(m[:3, :3], m[:3, 3])

    @staticmethod
    def from_rotvec(rotvec: ArrayLike, translation: ArrayLike = (0.0, 0.0, 0.0)) -> SE3:
        """From a (3,) rotation vector [rad] and a translation [m]."""
        rotation, _ = cv2.Rodrigues(np.asarray(rotvec, dtype=np.float64).reshape(3, 1))
        return SE3(np.asarray(rotation), np.asarray(translation))

    @staticmethod
    def from_table(table: Mapping[str, Any]) -> SE3:
        """From the keys ``rotation`` and ``translation_m`` of a file."""
        return SE3(np.array(table["rotation"]), np.array(table["translation_m"]))

    def toml(self, digits: int | None = None) -> list[str]:
        """Lines of a file that ``from_table`` reads; floats keep all their digits unless fewer decimals are given."""
        rotation = self.rotation.tolist()
        translation = self.translation.tolist()
        if digits is not None:
            rotation, translation = (np.round(v, digits).tolist() for v in (rotation, translation))
        return [f"rotation = {rotation!r}", f"translation_m = {translation!r}"]

    @property
    def rotvec(self) -> F64:
        """(3,) rotation vector [rad]."""
        # OpenCV's inverse takes turns of less than about 1e-5 for none.
        from scipy.spatial.transform import Rotation

        return np.asarray(Rotation.from_matrix(self.rotation).as_rotvec())

    @property
    def angle_rad(self) -> float:
        """Angle of the rotation, 0 to pi: the Frobenius norm of R - I is 2 sqrt(2) sin(angle / 2)."""
        return 2.0 * math.asin(min(1.0, float(np.linalg.norm(self.rotation - np.eye(3))) / math.sqrt(8.0)))

    @property
    def matrix(self) -> F64:
        """(4, 4) homogeneous matrix."""
        m = np.eye(4)
        m[:3, :3] = self.rotation
        m[:3, 3] = self.translation
        return m

    def inverse(self) -> SE3:
        return SE3(self.rotation.T, -self.rotation.T @ self.translation)

    @overload
    def __matmul__(self, other: SE3) -> SE3: ...
    @overload
    def __matmul__(self, other: ArrayLike) -> F64: ...
    def __matmul__(self, other: SE3 | ArrayLike) -> SE3 | F64:
        """Compose with another transform, or map points (..., 3)."""
        if isinstance(other, SE3):
            return SE3(self.rotation @ other.rotation, self.rotation @ other.translation + self.translation)
        points = np.asarray(other, dtype=np.float64)
        return np.asarray(points @ self.rotation.T + self.translation)
