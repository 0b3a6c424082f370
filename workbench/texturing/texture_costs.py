"""A mesh, its photographs and their pictures as a labelling problem.

Source: Arikan et al., eq. 1–5.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.geometry.photo_camera import PhotoCamera
from workbench.kernels.edge_colors import labels_of_edges, read_edges
from workbench.texturing.candidates import Candidates
from workbench.texturing.cost_options import CostOptions
from workbench.texturing.labelling import LabellingProblem, by_photo


def texture_problem(
    mesh: TriangleMesh,
    cameras: Mapping[int, PhotoCamera],
    candidates: Candidates,
    pictures: Callable[[int], NDArray[np.uint8]],
    options: CostOptions,
) -> LabellingProblem:
    """The costs of all choices; each photograph's picture is asked for once.

    Parameters
    ----------
    cameras : of the photographs by their numbers, of the size of their pictures.
    candidates : as `candidates_of` found them, or fewer.
    pictures : from a photograph's number to its texture picture, (h, w, 4) uint8: sRGB-encoded
        colour, and alpha 255 where it may be used.
    """
    _, areas = face_normals_and_areas(mesh)
    edges, ends = side_by_side(mesh.triangles)
    edge_starts, edge_labels = labels_of_edges(edges, candidates.starts, candidates.labels)
    colors = np.zeros((len(edge_labels), options.edge_samples, 3), np.uint16)
    edge_of_row = np.repeat(np.arange(len(edges)), np.diff(edge_starts))
    for photo, rows in by_photo(edge_labels).items():
        ends_of_rows = ends[edge_of_row[rows]]
        used = np.zeros(len(mesh.vertices), bool)
        used[ends_of_rows] = True
        number = np.cumsum(used) - 1
        pixels, depths = cameras[photo].project(mesh.vertices[used])
        read_edges(rows, number[ends_of_rows], pixels, depths, pictures(photo), colors)
    lengths = np.linalg.norm(mesh.vertices[ends[:, 1]] - mesh.vertices[ends[:, 0]], axis=1)
    owner = np.repeat(np.arange(len(areas)), np.diff(candidates.starts))
    return LabellingProblem(
        candidates.starts, candidates.labels, candidates.penalties * areas[owner], edges, lengths,
        edge_starts, edge_labels, colors, options.smoothness_in_world,
    )  # fmt: skip


def side_by_side(
    triangles: NDArray[np.int32],
) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
    """Triangles (e, 2) that share an edge, and the edge's vertices (e, 2), in a fixed order.

    Where more than two meet at an edge, each is beside the next.
    """
    m = len(triangles)
    corners = np.concatenate([triangles[:, [k, (k + 1) % 3]] for k in range(3)]).astype(np.int64)
    corners.sort(axis=1)
    owner = np.tile(np.arange(m, dtype=np.int32), 3)
    order = np.lexsort((owner, corners[:, 1], corners[:, 0]))
    corners, owner = corners[order], owner[order]
    same = (corners[1:] == corners[:-1]).all(axis=1) & (owner[1:] != owner[:-1])
    pairs = np.stack([owner[:-1], owner[1:]], axis=1)[same]
    ends = corners[1:][same].astype(np.int32)
    # By triangle: what is near in the mesh is near in memory.
    by_triangle = np.lexsort((pairs[:, 1], pairs[:, 0]))
    return pairs[by_triangle], ends[by_triangle]
