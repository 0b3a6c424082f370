"""Meshes the surface tests cut, close and refine."""

from __future__ import annotations

import numpy as np

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.samples import Samples


def divided_box(low: float, high: float, n: int, *, inward: bool = False) -> TriangleMesh:
    """A cube with n × n squares on each side, all corners shared."""
    places: dict[tuple[int, ...], int] = {}
    triangles = []
    for axis in range(3):
        u, v = (axis + 1) % 3, (axis + 2) % 3
        for side in (0, n):
            for i, j in np.ndindex(n, n):
                ring = []
                for a, b in ((i, j), (i + 1, j), (i + 1, j + 1), (i, j + 1)):
                    corner = [0, 0, 0]
                    corner[axis], corner[u], corner[v] = side, a, b
                    ring.append(places.setdefault(tuple(corner), len(places)))
                if (side == 0) != inward:
                    ring.reverse()
                triangles += [ring[:3], [ring[0], ring[2], ring[3]]]
    vertices = low + np.array(list(places), float) / n * (high - low)
    return TriangleMesh(vertices, np.array(triangles, np.int32))


def joined(*meshes: TriangleMesh) -> TriangleMesh:
    starts = np.cumsum([0, *(len(m.vertices) for m in meshes)])
    return TriangleMesh(
        np.concatenate([m.vertices for m in meshes]),
        np.concatenate([m.triangles + k for m, k in zip(meshes, starts, strict=False)]).astype(
            np.int32
        ),
    )


def volume(mesh: TriangleMesh) -> float:
    middle = mesh.vertices.mean(axis=0)
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] - middle for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


def sphere_samples(n: int, radius: float = 1.0, noise: float = 0.0, seed: int = 0) -> Samples:
    """n samples spread evenly over a sphere about the origin (golden-angle spiral)."""
    z = 1 - (2 * np.arange(n) + 1) / n
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(n)
    r = np.sqrt(1 - z**2)
    normals = np.stack([r * np.cos(turn), r * np.sin(turn), z], axis=1)
    heights = radius + np.random.default_rng(seed).normal(scale=noise, size=n)
    spacing = radius * np.sqrt(4 * np.pi / n)
    return Samples(
        normals * heights[:, None],
        normals,
        np.full(n, 1.5 * spacing),
        np.ones(n),
        np.zeros(n, np.int32),
    )


def without(samples: Samples, gone: np.ndarray) -> Samples:
    return Samples(**{name: values[~gone] for name, values in samples.arrays().items()})
