"""Moving a reconstructed surface onto the samples it was made from.

Poisson's octree smooths detail finer than its cells, and one more level takes four times as
long. Moving the vertices onto the implicit surface that the nearest samples' tangent planes
define takes a second, buys about as much, and leaves the triangles as they are, so what was
closed stays closed. (Shen et al. 2004 and Kolluri 2005: implicit moving
least squares.)
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.geometry.neighbours import k_nearest, tree_of
from workbench.geometry.samples import Samples

_NEIGHBOURS = 8
# Width of the Gaussian in sample distances: wide enough to average noise, no wider.
_WIDTH = 0.5
_NARROWEST = 1e-140
_CHUNK = 1 << 18


def moved_onto_samples(mesh: TriangleMesh, samples: Samples, rounds: int) -> TriangleMesh:
    """The mesh with its vertices on the moving-least-squares surface of the samples.

    Vertices further than its reach from their closest sample stay; between half of it and
    all of it the motion fades out, so no step appears at the rim of infilled parts.

    Parameters
    ----------
    mesh : near the samples, oriented like them.
    samples : with outward normals.
    rounds : projections; two suffice where the surface is within a sample distance.

    Returns
    -------
    The same triangles over moved vertices; no vertex moves further than its closest
    sample's reach in a round.

    Raises
    ------
    InputError
        Samples with a place, normal, reach or confidence that is not finite.
    """
    for name, values in samples.arrays().items():
        if not np.isfinite(values).all():
            raise InputError(
                f"a surface cannot be moved onto samples without {name}",
                found=f"{int((~np.isfinite(values)).sum())} numbers that are not finite",
                fix="leave such samples out",
            )
    tree = tree_of(samples.points)
    k = min(_NEIGHBOURS, len(samples))
    for _ in range(rounds):
        normals = vertex_normals(mesh)
        vertices = np.concatenate(
            [
                _projected(
                    mesh.vertices[at : at + _CHUNK], normals[at : at + _CHUNK], samples, tree, k
                )
                for at in range(0, len(mesh.vertices), _CHUNK)
            ]
        )
        mesh = TriangleMesh(vertices, mesh.triangles, mesh.vertex_attributes)
    return mesh


def _projected(
    vertices: NDArray[np.float64],
    normals: NDArray[np.float64],
    samples: Samples,
    tree: cKDTree,
    k: int,
) -> NDArray[np.float64]:
    distance, index = k_nearest(tree, vertices, k)
    reach = samples.radius_m[index]
    width = _WIDTH * np.median(reach, axis=1, keepdims=True)
    facing = np.clip(np.einsum("vi,vki->vk", normals, samples.normals[index]), 0.0, 1.0)
    # Relative to the closest sample, so that the weights do not all underflow far away.
    farther = distance**2 - distance[:, :1] ** 2
    # Samples that reach nowhere move nothing; only widths are needed that can be divided by.
    with np.errstate(over="ignore"):
        decay = np.exp(-farther / np.maximum(width, _NARROWEST) ** 2)
    weight = decay * facing**2 * samples.confidence[index]
    total = weight.sum(axis=1)
    held = total > 0.0
    offset = np.einsum(
        "vki,vki->vk", vertices[:, None] - samples.points[index], samples.normals[index]
    )
    signed = (weight * offset).sum(axis=1) / np.where(held, total, 1.0)
    direction = np.einsum("vk,vki->vi", weight, samples.normals[index])
    length = np.linalg.norm(direction, axis=1)
    direction /= np.where(length > 0.0, length, 1.0)[:, None]
    fade = np.clip(2.0 - 2.0 * distance[:, 0] / np.maximum(reach[:, 0], _NARROWEST), 0.0, 1.0)
    fade *= reach[:, 0] > 0.0
    motion = np.clip(signed, -reach[:, 0], reach[:, 0]) * fade * held
    moved: NDArray[np.float64] = vertices - motion[:, None] * direction
    return moved
