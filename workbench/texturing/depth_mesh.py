"""The mesh that a depth map is, and where it ends because the scene does.

Source: Arikan et al., sections 4 and 5.2.2; Evans et al. 2001 for fewer triangles where it is flat.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh
from workbench.kernels.depth_cells import LOWER, OTHER_DIAGONAL, UPPER
from workbench.kernels.flat_squares import merged_squares
from workbench.texturing.depth_map import DepthMap

# About a hole in the data the surface recedes towards it as often as not; at the scene's own edge
# it turns away, by pixels' widths per pixel.
_RECEDING_PX = 1.0
# Merged squares have sides of at most 2³ pixels: what hides a part of one is seen at its corners.
_MERGED_LEVELS = 3


@dataclass(frozen=True)
class DepthMesh:
    """A depth map's triangles.

    Attributes
    ----------
    mesh : one vertex for each pixel that has a triangle, rows first; counter-clockwise as the
        camera sees it.
    pixels : (n,) int64 the vertices' pixels, numbered row by row.
    spacing : (m,) float32 how far apart neighbouring pixels lie on each triangle, in the direction
        in which they lie furthest apart of its edges', metres.
    outer : (m,) whether a triangle has an edge where the mesh ends at a step in depth, at a
        silhouette or at the picture's edge, and not at a hole in the data.
    """

    mesh: TriangleMesh
    pixels: NDArray[np.int64]
    spacing: NDArray[np.float32]
    outer: NDArray[np.bool_]


def depth_mesh(depth_map: DepthMap) -> DepthMesh:
    """Two triangles to each square of four pixels, none across a step in depth.

    Where the depth map allows for it, and away from where the mesh ends, larger triangles take the
    place of those of flat squares.
    """
    cells = depth_map.cells
    merged = np.empty((0, 3), np.int64)
    if depth_map.flatness_px > 0.0:
        most = depth_map.flatness_px / depth_map.camera.params[0]
        free = _free(depth_map)
        whole, merged = merged_squares(depth_map.nearness, free, _MERGED_LEVELS, most)
        cells = np.where(whole, cells, 0).astype(np.uint8)
    width = depth_map.camera.width
    row, column, lower = _triangle_cells(cells)
    other = (cells[row, column] & OTHER_DIAGONAL) > 0
    ul = row * width + column
    ur, ll, lr = ul + 1, ul + width, ul + width + 1
    corners = np.where(
        other[:, None],
        np.where(lower[:, None], np.stack([ll, lr, ur], 1), np.stack([ul, ll, ur], 1)),
        np.where(lower[:, None], np.stack([ul, ll, lr], 1), np.stack([ul, lr, ur], 1)),
    )
    outer = np.concatenate([_outer(depth_map, row, column, lower), np.zeros(len(merged), bool)])
    corners = np.concatenate([corners.reshape(-1, 3), merged])
    pixels = np.unique(corners)
    number = np.full(depth_map.depth.size, -1, np.int32)
    number[pixels] = np.arange(len(pixels), dtype=np.int32)
    mesh = TriangleMesh(depth_map.places(pixels, depth_map.fitted), number[corners])
    return DepthMesh(mesh, pixels, _spacing(mesh, pixels, width), outer)


def _spacing(mesh: TriangleMesh, pixels: NDArray[np.int64], width: int) -> NDArray[np.float32]:
    places = np.column_stack(np.divmod(pixels, width)).astype(np.float64)
    widest = np.zeros(len(mesh.triangles))
    for k in range(3):
        one, other = mesh.triangles[:, k], mesh.triangles[:, (k + 1) % 3]
        apart = np.linalg.norm(mesh.vertices[one] - mesh.vertices[other], axis=1)
        apart /= np.linalg.norm(places[one] - places[other], axis=1)
        np.maximum(widest, apart, out=widest)
    return widest.astype(np.float32)


def _free(depth_map: DepthMap) -> NDArray[np.bool_]:
    """(h − 1, w − 1) squares whose triangles tell nothing of where the mesh or its use ends."""
    both = np.uint8(UPPER | LOWER)
    full = (depth_map.cells & both) == both
    used = np.lib.stride_tricks.sliding_window_view(depth_map.usable, (2, 2))
    full &= used.all(axis=(2, 3)) | ~used.any(axis=(2, 3))
    cross = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
    inner = cv2.erode(
        full.astype(np.uint8), cross, borderType=cv2.BORDER_CONSTANT, borderValue=(0,)
    )
    return np.asarray(inner > 0)


def _triangle_cells(
    cells: NDArray[np.uint8],
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.bool_]]:
    """Row, column and whether it is the lower one, of every triangle in order."""
    there = np.stack([(cells & UPPER) > 0, (cells & LOWER) > 0], axis=-1)
    row, column, which = np.nonzero(there)
    return row, column, which > 0


def _outer(
    depth_map: DepthMap, row: NDArray[np.int64], column: NDArray[np.int64], lower: NDArray[np.bool_]
) -> NDArray[np.bool_]:
    cells = np.pad(depth_map.cells, 1)
    other = (cells & OTHER_DIAGONAL) > 0
    upper_there, lower_there = (cells & UPPER) > 0, (cells & LOWER) > 0
    full = upper_there & lower_there
    outer_gap = _outer_gaps(depth_map, full)
    # By which of its triangles a square reaches each of its sides.
    reaches = {
        "top": upper_there,
        "bottom": lower_there,
        "left": np.where(other, upper_there, lower_there),
        "right": np.where(other, lower_there, upper_there),
    }
    j, i = row + 1, column + 1
    rising = other[j, i]
    outer = outer_gap[j, i]
    for legs, down, right, opposite in (
        (~lower, -1, 0, "bottom"),
        (lower, 1, 0, "top"),
        (lower ^ rising, 0, -1, "right"),
        (~(lower ^ rising), 0, 1, "left"),
    ):
        beside = (j + down, i + right)
        outer |= legs & ~reaches[opposite][beside] & outer_gap[beside]
    return outer


def _outer_gaps(depth_map: DepthMap, full: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """(h + 1, w + 1) squares, a ring around them added, in gaps that are no holes of the data."""
    if depth_map.closed:
        return ~full
    count, found = cv2.connectedComponents((~full).astype(np.uint8), connectivity=4)
    gaps = np.asarray(found, np.int32)
    outer = np.zeros(count, bool)
    outer[gaps[0, 0]] = True
    seen = depth_map.nearness > 0.0
    right, down = depth_map.joints
    # A pixel's square is the one to its lower right; the ring makes that (row + 1, column + 1).
    for steps in (
        np.argwhere(seen[:, :-1] & seen[:, 1:] & ~right),
        np.argwhere(seen[:-1] & seen[1:] & ~down),
    ):
        outer[gaps[steps[:, 0] + 1, steps[:, 1] + 1]] = True
    receding = _receding(depth_map.nearness, gaps, count) * depth_map.camera.params[0]
    outer |= receding > _RECEDING_PX
    outer[0] = False
    return np.asarray(outer[gaps])


def _receding(
    nearness: NDArray[np.float64], gaps: NDArray[np.int32], count: int
) -> NDArray[np.float64]:
    """(count,) how the surface recedes towards each gap, mean of shares of its depth per pixel."""
    total, pairs = np.zeros(count), np.zeros(count)
    gap_of_pixel = gaps[1:, 1:]
    for turned in range(4):
        near = np.rot90(nearness, turned)
        gap = np.rot90(gap_of_pixel, turned)
        inner, rim, hole = near[:, :-2], near[:, 1:-1], near[:, 2:]
        here = (inner > 0.0) & (rim > 0.0) & (hole <= 0.0)
        which = gap[:, 2:][here]
        total += np.bincount(which, (inner[here] - rim[here]) / rim[here], count)
        pairs += np.bincount(which, minlength=count)
    return total / np.maximum(pairs, 1.0)
