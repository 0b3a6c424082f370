"""What the triangles in a block of voxels add up to, voxel by voxel, and its averages."""

from __future__ import annotations

import math

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.morton import spread_bits
from workbench.kernels.srgb_bytes import srgb_byte
from workbench.kernels.voxel_clipping import (
    MOST_CORNERS,
    projected_centroid,
    separates,
    slab_polygon,
    touched_range,
)
from workbench.kernels.voxel_texture import texture_mean

# One row of sums: area, weight, weighted normal and, with colour, weighted colour; then weight,
# normal and colour again for each of the six faces. Clearing rows takes time: none is longer
# than need be.
AREA, WEIGHT, NORMAL, COLOR = 0, 1, 2, 5
# Bit 6 of a voxel's flags; bits 0…5 are its outward faces.
SEPARATING = 64
# Weight of a touch without area: it decides attributes only where there is nothing else.
LEAST_WEIGHT = 1e-12
# Voxels from the plane of a triangle to the tips of the cross, beyond what rounding moves.
_PLANE_SLACK = 1e-6
# Cells whose marks are looked through at once when a block is emptied.
GROUP = 64
# A face with less of the voxel's weight does not make a voxel two-sided.
_LEAST_SHARE = 0.01


@njit(cache=True, nogil=True)
def _face_sums(face: int, colored: bool) -> int:
    """Where the sums of a face start in a row: weight, then normal, then colour."""
    return 8 + 7 * face if colored else 5 + 4 * face


def row_length(colored: bool) -> int:
    """Sums per voxel."""
    return int(_face_sums(6, colored))


@njit(cache=True, nogil=True)
def _add_sides(
    sums: NDArray[np.float64], at: int, weight: float, normal: NDArray[np.float64],
    color: NDArray[np.float64], colored: bool,
) -> int:  # fmt: skip
    """Add one piece of surface to a row, whole and by the faces it looks to; those faces."""
    mask = 0
    sums[at, WEIGHT] += weight
    for k in range(3):
        sums[at, NORMAL + k] += weight * normal[k]
        if colored:
            sums[at, COLOR + k] += weight * color[k]
        toward = normal[k]
        if toward != 0.0:
            face = 2 * k + (1 if toward > 0.0 else 0)
            mask |= 1 << face
            add_to_face(sums, at, face, weight * abs(toward), normal, color, colored)
    return mask


@njit(cache=True, nogil=True)
def add_to_face(
    sums: NDArray[np.float64], at: int, face: int, weight: float, normal: NDArray[np.float64],
    color: NDArray[np.float64], colored: bool,
) -> None:  # fmt: skip
    """Add one piece of surface to the sums of a face of row ``at``."""
    base = _face_sums(face, colored)
    sums[at, base] += weight
    for k in range(3):
        sums[at, base + 1 + k] += weight * normal[k]
        if colored:
            sums[at, base + 4 + k] += weight * color[k]


@njit(cache=True, nogil=True)
def add_triangles(
    points: NDArray[np.float64], colors: NDArray[np.float64], triangles: NDArray[np.int32],
    chosen: NDArray[np.int32], corner: NDArray[np.int64], side: int, slot: NDArray[np.int32],
    marked: NDArray[np.bool_], sums: NDArray[np.float64], flags: NDArray[np.uint8],
    page_of: NDArray[np.int32], pages: NDArray[np.int64], texels: NDArray[np.uint8],
) -> int:  # fmt: skip
    """Cut triangles by the voxels of one block and add their pieces up.

    Parameters
    ----------
    points : (n, 3) in voxels, zero in the middle of the grid.
    colors : (n, 3) linear light 0…1, or (0, 3); of a textured surface column and row in its
        picture, in texels, and 0.
    triangles, chosen : (m, 3) indices of points, and which of the rows to take, in order.
    corner, side : (3,) lowest corner of the block, in voxels from the middle, and its side.
    slot : (side³,) −1 everywhere; receives rows of the sums, in Morton order of the cells.
    marked : (⌈side³ / GROUP⌉,) false everywhere; receives which groups of cells are in use.
    sums, flags : (side³, row_length) and (side³,); rows are cleared as they come into use.
    page_of, pages, texels : (m,) picture of each triangle, and (p, 4) pictures and (t, 3) texels
        as `workbench.kernels.voxel_texture` has them; no pictures without texture.

    Returns
    -------
    Number of voxels touched.
    """
    colored = len(colors) > 0
    whole = np.empty((3, 3))
    slab = np.empty((MOST_CORNERS, 3))
    row = np.empty((MOST_CORNERS, 3))
    cell = np.empty((MOST_CORNERS, 3))
    normal, color = np.empty(3), np.zeros(3)
    along_u, along_v, base = np.zeros(3), np.zeros(3), np.zeros(3)
    least, most = np.zeros(3), np.zeros(3)
    used = 0
    for t in chosen:
        for k in range(3):
            whole[k] = points[triangles[t, k]]
        length = triangle_normal(whole, normal)
        if not length > 0.0:
            continue
        w = 0
        for k in range(1, 3):
            if abs(normal[k]) > abs(normal[w]):
                w = k
        u, v = (w + 1) % 3, (w + 2) % 3
        reach = 0.5 * abs(normal[w]) + _PLANE_SLACK
        if colored:
            _color_plane(whole, colors, triangles[t], u, v, base, along_u, along_v, least, most)
        # A triangle in a plane of the grid lies in the voxels of both sides, half in each.
        scale = 1.0 / abs(normal[w])
        for axis in range(3):
            flat = whole[0, axis] == whole[1, axis] == whole[2, axis]
            if flat and whole[0, axis] == math.floor(whole[0, axis]):
                scale *= 0.5
        z0, z1 = touched_range(whole, 3, 2)
        for z in range(max(z0, corner[2]), min(z1, corner[2] + side - 1) + 1):
            in_slab, source_slab = 3, whole
            if z0 != z1:
                in_slab, source_slab = slab_polygon(whole, 3, 2, z, z + 1, slab), slab
                if in_slab == 0:
                    continue
            y0, y1 = touched_range(source_slab, in_slab, 1)
            for y in range(max(y0, corner[1]), min(y1, corner[1] + side - 1) + 1):
                in_row, source_row = in_slab, source_slab
                if y0 != y1:
                    in_row, source_row = slab_polygon(source_slab, in_slab, 1, y, y + 1, row), row
                    if in_row == 0:
                        continue
                x0, x1 = touched_range(source_row, in_row, 0)
                yz = (spread_bits(y - corner[1]) << np.uint64(1)) | (
                    spread_bits(z - corner[2]) << np.uint64(2)
                )
                for x in range(max(x0, corner[0]), min(x1, corner[0] + side - 1) + 1):
                    in_cell, source_cell = in_row, source_row
                    if x0 != x1:
                        in_cell = slab_polygon(source_row, in_row, 0, x, x + 1, cell)
                        source_cell = cell
                        if in_cell == 0:
                            continue
                    place = spread_bits(x - corner[0]) | yz
                    at = slot[place]
                    if at < 0:
                        at = used
                        used += 1
                        slot[place] = at
                        marked[place // np.uint64(GROUP)] = True
                        sums[at] = 0.0
                        flags[at] = 0
                    signed, middle_u, middle_v = projected_centroid(source_cell, in_cell, u, v)
                    area = abs(signed) * scale
                    if len(pages):
                        texture_mean(
                            source_cell, in_cell, u, v, base, along_u, along_v, least, most,
                            pages[page_of[t]], texels, color,
                        )  # fmt: skip
                    elif colored:
                        for k in range(3):
                            plane = base[k] + along_u[k] * middle_u + along_v[k] * middle_v
                            color[k] = min(max(plane, least[k]), most[k])
                    sums[at, AREA] += area
                    weight = max(area, LEAST_WEIGHT)
                    mask = _add_sides(sums, at, weight, normal, color, colored)
                    if not flags[at] & SEPARATING:
                        # Most voxels off the cross are so by far: their plane passes it by.
                        offset = (
                            normal[0] * (x + 0.5 - whole[0, 0])
                            + normal[1] * (y + 0.5 - whole[0, 1])
                            + normal[2] * (z + 0.5 - whole[0, 2])
                        )
                        if abs(offset) <= reach and separates(whole, x + 0.5, y + 0.5, z + 0.5):
                            mask |= SEPARATING
                    flags[at] |= mask
    return used


@njit(cache=True, nogil=True)
def triangle_normal(corners: NDArray[np.float64], normal: NDArray[np.float64]) -> float:
    """Twice the area of a triangle (3, 3); its unit normal goes to ``normal`` (3,)."""
    ax, ay, az = corners[0]
    bx, by, bz = corners[1, 0] - ax, corners[1, 1] - ay, corners[1, 2] - az
    cx, cy, cz = corners[2, 0] - ax, corners[2, 1] - ay, corners[2, 2] - az
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    # The mirrored triangle has the same three squares: their sum is the same to the last bit.
    length = math.sqrt(nx * nx + ny * ny + nz * nz)
    if length > 0.0:
        normal[0], normal[1], normal[2] = nx / length, ny / length, nz / length
    return length


@njit(cache=True, nogil=True)
def _color_plane(
    corners: NDArray[np.float64], colors: NDArray[np.float64], triangle: NDArray[np.int32],
    u: int, v: int, base: NDArray[np.float64], along_u: NDArray[np.float64],
    along_v: NDArray[np.float64], least: NDArray[np.float64], most: NDArray[np.float64],
) -> None:  # fmt: skip
    """Colour as a linear function of (u, v) over a triangle, and its bounds."""
    u0, v0 = corners[0, u], corners[0, v]
    bu, bv = corners[1, u] - u0, corners[1, v] - v0
    cu, cv = corners[2, u] - u0, corners[2, v] - v0
    det = bu * cv - bv * cu
    for k in range(3):
        a, b, c = colors[triangle[0], k], colors[triangle[1], k], colors[triangle[2], k]
        along_u[k] = ((b - a) * cv - (c - a) * bv) / det
        along_v[k] = ((c - a) * bu - (b - a) * cu) / det
        base[k] = a - along_u[k] * u0 - along_v[k] * v0
        least[k], most[k] = min(a, b, c), max(a, b, c)


@njit(cache=True, nogil=True)
def cells_in_order(
    slot: NDArray[np.int32], marked: NDArray[np.bool_], used: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Morton numbers (used,) of a block's cells and their rows; slots and marks are cleared."""
    places, rows = np.empty(used, np.int64), np.empty(used, np.int64)
    count = 0
    for group in range(len(marked)):
        if not marked[group]:
            continue
        marked[group] = False
        for place in range(group * GROUP, min((group + 1) * GROUP, len(slot))):
            if slot[place] >= 0:
                places[count], rows[count] = place, slot[place]
                slot[place] = -1
                count += 1
    return places, rows


@njit(cache=True, nogil=True)
def averages(
    sums: NDArray[np.float64], flags: NDArray[np.uint8], rows: NDArray[np.int64], color_step: int,
    least_coherence: float, normal: NDArray[np.float32], color: NDArray[np.uint8],
    sided: NDArray[np.bool_],
) -> None:  # fmt: skip
    """Mean attributes of voxels, and which of them look different face by face.

    Parameters
    ----------
    sums, flags, rows : as `add_triangles` and `cells_in_order` left them.
    color_step : difference of sRGB bytes between two faces from which they are kept apart.
    least_coherence : length of the mean of unit normals below which faces are kept apart.
    normal, color : (n, 3) output; ``color`` (0, 3) without colour.
    sided : (n,) output.
    """
    colored = len(color) > 0
    for i in range(len(rows)):
        row = sums[rows[i]]
        length = _unit(row, NORMAL, normal[i])
        sided[i] = length < least_coherence * row[WEIGHT]
        if not length > 1e-9 * row[WEIGHT]:
            normal[i] = 0.0
        if colored:
            for k in range(3):
                color[i, k] = srgb_byte(row[COLOR + k] / row[WEIGHT])
                if not sided[i] and _spread(row, flags[rows[i]], k) > color_step:
                    sided[i] = True


@njit(cache=True, nogil=True)
def _unit(row: NDArray[np.float64], start: int, out: NDArray[np.float32]) -> float:
    x, y, z = row[start], row[start + 1], row[start + 2]
    length = math.sqrt(x * x + y * y + z * z)
    if length > 0.0:
        out[0], out[1], out[2] = x / length, y / length, z / length
    else:
        out[0] = out[1] = out[2] = 0.0
    return length


@njit(cache=True, nogil=True)
def _spread(row: NDArray[np.float64], mask: int, channel: int) -> int:
    """Largest difference of sRGB bytes between faces of a voxel in one channel."""
    low, high = np.inf, -np.inf
    for face in range(6):
        base = _face_sums(face, True)
        if mask & (1 << face) and row[base] > _LEAST_SHARE * row[WEIGHT]:
            value = row[base + 4 + channel] / row[base]
            low, high = min(low, value), max(high, value)
    # Most voxels have one colour; the encoding need not be asked about those.
    return srgb_byte(high) - srgb_byte(low) if high > low else 0


@njit(cache=True, nogil=True)
def face_averages(
    sums: NDArray[np.float64], flags: NDArray[np.uint8], rows: NDArray[np.int64],
    normal: NDArray[np.float32], color: NDArray[np.uint8], face_normal: NDArray[np.float32],
    face_color: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Mean attributes (n, 6, 3) of single faces; faces that are not set get the voxel's."""
    colored = len(color) > 0
    for i in range(len(rows)):
        row, mask = sums[rows[i]], flags[rows[i]]
        for face in range(6):
            face_normal[i, face] = normal[i]
            if colored:
                face_color[i, face] = color[i]
            base = _face_sums(face, colored)
            if not mask & (1 << face) or not row[base] > 0.0:
                continue
            _unit(row, base + 1, face_normal[i, face])
            if colored:
                for k in range(3):
                    face_color[i, face, k] = srgb_byte(row[base + 4 + k] / row[base])
