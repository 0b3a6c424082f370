"""One bounce: light that the flash sends to a surface by way of another."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import vertex_normals
from workbench.kernels.bounced_light import bounced_light, neighbour_means
from workbench.kernels.flash_shading import reflected_light
from workbench.synthetic.flash import Flash
from workbench.synthetic.subject import Subject

_RAYS_PER_BATCH = 2_000_000
_CLEARANCE_M = 5e-4
_SMOOTHING_PASSES = 2


@dataclass(frozen=True)
class Exchange:
    """Which surfaces see which: geometry alone, shared by all photographs.

    Attributes
    ----------
    subject : the surfaces.
    normals : (n, 3) float32 unit vertex normals.
    seen : (n, rays) int32 triangle that each cosine-distributed ray from a vertex meets, −1
        for none.
    """

    subject: Subject
    normals: NDArray[np.float32]
    seen: NDArray[np.int32]

    @classmethod
    def of(cls, subject: Subject, rays: int, seed: int) -> Exchange:
        """Cast ``rays`` rays from every vertex; the same seed casts the same rays."""
        normals = vertex_normals(subject.mesh)
        n = len(normals)
        seen = np.full((n, rays), -1, np.int32)
        rng = np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(40,)))
        place = np.arange(rays)
        golden = 0.5 * (5.0**0.5 - 1.0)
        step = max(1, _RAYS_PER_BATCH // rays)
        for first in range(0, n, step):
            rows = slice(first, min(first + step, n))
            shift = rng.random((rows.stop - first, 2))
            # An even spiral over the disc, lifted to the hemisphere: cosine-distributed.
            r2 = (place + shift[:, :1]) / rays
            turn = 2 * np.pi * (golden * place + shift[:, 1:])
            up = normals[rows]
            helper = np.where(np.abs(up[:, :1]) > 0.7, [[0.0, 1.0, 0.0]], [[1.0, 0.0, 0.0]])
            a = np.cross(helper, up)
            a /= np.maximum(np.linalg.norm(a, axis=1, keepdims=True), 1e-12)
            b = np.cross(up, a)
            flat = np.sqrt(r2)
            way = (
                (flat * np.cos(turn))[..., None] * a[:, None]
                + (flat * np.sin(turn))[..., None] * b[:, None]
                + np.sqrt(1.0 - r2)[..., None] * up[:, None]
            )
            start = subject.mesh.vertices[rows] - subject.middle + _CLEARANCE_M * up
            origin = np.broadcast_to(start[:, None], way.shape)
            hits = subject.seen(
                np.concatenate([origin, way], axis=-1).reshape(-1, 6).astype(np.float32)
            )
            seen[rows].reshape(-1)[hits.rays] = hits.triangle
        return cls(subject, normals.astype(np.float32), seen)

    def vertex_light(self, flash: Flash, exposure: float) -> NDArray[np.float32]:
        """Level (n, 3) of a white diffuser at every vertex under the bounced light alone.

        The light that vertices get from the middle of the flash, times their albedo, is
        what the rays of others meet. Averaging over neighbours takes the noise of the few
        rays below that of the sensor.
        """
        subject = self.subject
        start = subject.mesh.vertices + _CLEARANCE_M * self.normals
        way = (flash.middle - start).astype(np.float32)
        origins = (start - subject.middle).astype(np.float32)
        hidden = subject.blocked(np.concatenate([origins, way], axis=1))
        n = len(start)
        none = np.zeros(n, np.float32)
        direct = reflected_light(
            self.normals,
            -self.normals,
            way,
            none,
            none,
            flash.axis,
            flash.falloff,
            np.array([1.0, 0.0]),
        )[:, 0]
        level = np.where(hidden, 0.0, exposure * direct).astype(np.float32)
        radiosity = subject.vertex_paint.albedo * level[:, None]
        light = bounced_light(self.seen, subject.mesh.triangles, radiosity)
        for _ in range(_SMOOTHING_PASSES):
            light = neighbour_means(subject.mesh.triangles, light)
        smooth: NDArray[np.float32] = light
        return smooth
