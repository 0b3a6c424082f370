"""Points spread evenly over triangle surfaces."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas


def sample_surface(
    mesh: TriangleMesh, n: int, seed: int
) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.float64]]:
    """Points spread evenly over a surface, the same for the same seed.

    One point falls in each of ``n`` equal steps of the running sum of triangle areas, so
    that every part of the surface has its share to within one point.

    Parameters
    ----------
    mesh
        with some area.
    n
        number of points.
    seed
        of the random generator.

    Returns
    -------
    points : (n, 3) float64.
    triangles : (n,) int32, the triangle of each point.
    barycentric : (n, 3) float64, its place there.

    Raises
    ------
    InputError
        If the mesh has no area.
    """
    _, area = face_normals_and_areas(mesh)
    running = np.cumsum(area)
    if not len(running) or not 0.0 < running[-1] < np.inf:
        raise InputError(
            "a surface without area cannot be sampled",
            expected="a finite area above zero",
            found=f"{running[-1] if len(running) else 0.0}",
        )
    random = np.random.default_rng(seed)
    at = (np.arange(n) + random.random(n)) * (running[-1] / n)
    triangle = np.minimum(np.searchsorted(running, at, side="right"), len(running) - 1)
    # Uniform over a triangle: Turk 1990, Graphics Gems, "Generating random points in triangles".
    root, second = np.sqrt(random.random(n)), random.random(n)
    barycentric = np.stack([1 - root, root * (1 - second), root * second], axis=1)
    points = at_barycentric(mesh, triangle, barycentric)
    return points, triangle.astype(np.int32), barycentric


def at_barycentric(
    mesh: TriangleMesh, triangle: NDArray[np.intp], barycentric: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Points (n, 3) of a surface by triangle (n,) and weights of its corners (n, 3)."""
    # Relative to the first corner: far from the origin, sums of products would lose digits.
    corners = mesh.vertices[mesh.triangles[triangle]]
    first = corners[:, 0]
    return np.asarray(first + np.einsum("ij,ijk->ik", barycentric, corners - first[:, None]))
