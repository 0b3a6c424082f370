"""What a picture of a model has to hold."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.kernels.mesh_pieces import pieces_of

# What lies within half the width of the middle 96 % beyond them belongs to the object: the arms
# of a statue do, a wall far behind a fountain does not.
_SHARE, _BEYOND = 0.02, 0.5
# Of the largest piece's vertices: another piece with so many is as much the object as that.
_ALSO_LARGE = 0.2


def main_box(points: ArrayLike) -> NDArray[np.float64]:
    """The box (2, 3) of points (n, 3) without the few that lie far from all others.

    It is that of all points where none lies further off than half the width of their middle
    96 %, along each axis.
    """
    given = np.asarray(points, float)
    low, high = np.quantile(given, [_SHARE, 1.0 - _SHARE], axis=0)
    # Of a flat object the thickness does not tell what is far.
    reach = _BEYOND * np.maximum(high - low, 0.1 * (high - low).max())
    return np.stack(
        [np.maximum(low - reach, given.min(axis=0)), np.minimum(high + reach, given.max(axis=0))]
    )


def main_vertices(mesh: TriangleMesh) -> NDArray[np.bool_]:
    """(n,) vertices of the mesh's large pieces, and of all others that lie beside these.

    A piece is large with a fifth of the largest one's vertices; beside are those within half the
    width of the large ones' box.
    """
    piece = pieces_of(mesh.triangles, len(mesh.vertices))
    sizes = np.bincount(piece)
    large = (sizes >= _ALSO_LARGE * sizes.max())[piece]
    low, high = mesh.vertices[large].min(axis=0), mesh.vertices[large].max(axis=0)
    reach = _BEYOND * (high - low)
    inside = (mesh.vertices >= low - reach) & (mesh.vertices <= high + reach)
    return np.asarray(inside.all(axis=1))
