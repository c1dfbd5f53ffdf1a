"""Ray casting against meshes with open3d, and what a hit tells."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib.libraries import import_open3d
from calib.types import F32, I32, Bool
from planview.synthetic.shapes import Mesh

EPSILON_M = 2e-3
"""Shadow rays start this far off their surface."""


@dataclass(frozen=True, eq=False)
class Hits:
    """First hits of rays; entries without a hit have infinite depth and zeros elsewhere.

    Attributes:
        depth: (N,) float32, ray parameter (metres of depth for rays with unit camera z).
        triangle: (N,) int32, -1 without a hit.
        u, v: (N,) float32 barycentric weights of the second and third vertex.
    """

    depth: F32
    triangle: I32
    u: F32
    v: F32

    @property
    def found(self) -> Bool:
        return self.triangle >= 0

    def interpolate(self, mesh: Mesh, values: F32, chosen: np.ndarray[Any, Any]) -> F32:
        """Vertex values (V, C) at the chosen hits."""
        corners = mesh.triangles[self.triangle[chosen]]
        u, v = self.u[chosen, None], self.v[chosen, None]
        a, b, c = values[corners[:, 0]], values[corners[:, 1]], values[corners[:, 2]]
        return np.asarray(a * (1 - u - v) + b * u + c * v, np.float32)


class Tracer:
    """A mesh that rays can be cast against."""

    def __init__(self, mesh: Mesh | None) -> None:
        o3d = import_open3d("rendering")

        self.mesh = mesh
        self._tensor = o3d.core.Tensor.from_numpy
        self._scene = None
        if mesh is not None:
            self._scene = o3d.t.geometry.RaycastingScene(nthreads=1)
            self._scene.add_triangles(
                self._tensor(np.ascontiguousarray(mesh.vertices)),
                self._tensor(np.ascontiguousarray(mesh.triangles.astype(np.uint32))),
            )

    def cast(self, rays: F32) -> Hits:
        """First hits of rays (N, 6)."""
        if self._scene is None or len(rays) == 0:
            n, zero = len(rays), np.zeros(len(rays), np.float32)
            return Hits(np.full(n, np.inf, np.float32), np.full(n, -1, np.int32), zero, zero)
        answer = self._scene.cast_rays(self._tensor(np.ascontiguousarray(rays)), nthreads=1)
        depth = answer["t_hit"].numpy()
        uv = answer["primitive_uvs"].numpy()
        triangle = np.where(np.isfinite(depth), answer["primitive_ids"].numpy().astype(np.int64), -1)
        return Hits(depth, triangle.astype(np.int32), uv[:, 0], uv[:, 1])

    def blocked(self, origins: F32, to: F32) -> Bool:
        """Whether something lies between origins (N, 3) and the ends of vectors ``to`` (N, 3)."""
        if self._scene is None or len(origins) == 0:
            return np.zeros(len(origins), np.bool_)
        rays = np.concatenate([origins, to], axis=1).astype(np.float32)
        hit = self._scene.test_occlusions(self._tensor(rays), tnear=0.0, tfar=0.999, nthreads=1)
        return np.asarray(hit.numpy(), np.bool_)
