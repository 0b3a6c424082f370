"""Voxels of one level added up to those of the next, and faces handed on to neighbours."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from workbench.kernels.morton import gathered_bits, spread_bits
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.kernels.voxel_sums import (
    AREA,
    COLOR,
    LEAST_WEIGHT,
    NORMAL,
    SEPARATING,
    WEIGHT,
    add_to_face,
)

_BUCKET_BITS = 12
# A face that is set counts this much at least, however steeply the surface passes it.
_LEAST_TOWARD = 0.05


@njit(cache=True, nogil=True)
def add_voxels(
    run: NDArray[np.int64], area: NDArray[np.float64], normal: NDArray[np.float32],
    color: NDArray[np.uint8], faces: NDArray[np.uint8], separating: NDArray[np.bool_],
    side: NDArray[np.int32], face_normal: NDArray[np.float32], face_color: NDArray[np.uint8],
    sums: NDArray[np.float64], flags: NDArray[np.uint8],
) -> None:  # fmt: skip
    """Add voxels to the sums of the coarser voxels they lie in, in order.

    Parameters
    ----------
    run : (n,) row of the sums for each voxel.
    area, normal, color, faces, separating : (n, …) as in a voxel set; ``color`` (0, 3)
        without colour.
    side : (n,) row of ``face_normal`` and ``face_color`` (k, 6, 3), or −1.
    sums, flags : (m, row_length) and (m,), zero; the sums of ``workbench.kernels.voxel_sums``.
    """
    colored = len(color) > 0
    one_normal, one_color = np.empty(3), np.zeros(3)
    for i in range(len(run)):
        row = sums[run[i]]
        weight = max(area[i], LEAST_WEIGHT)
        row[AREA] += area[i]
        row[WEIGHT] += weight
        flags[run[i]] |= faces[i] | (SEPARATING if separating[i] else 0)
        present = 0
        for face in range(6):
            present += faces[i] >> face & 1
        for k in range(3):
            one_normal[k] = normal[i, k]
            if colored:
                one_color[k] = LINEAR_OF_BYTE[color[i, k]]
                row[COLOR + k] += weight * one_color[k]
            if side[i] < 0:
                row[NORMAL + k] += weight * one_normal[k]
        for face in range(6):
            if not faces[i] & (1 << face):
                continue
            if side[i] >= 0:
                # Where faces differ the mean of their normals tells whether they cancel.
                for k in range(3):
                    one_normal[k] = face_normal[side[i], face, k]
                    row[NORMAL + k] += weight * one_normal[k] / present
                    if colored:
                        one_color[k] = LINEAR_OF_BYTE[face_color[side[i], face, k]]
            toward = one_normal[face // 2] * (1.0 if face % 2 else -1.0)
            face_weight = weight * max(toward, _LEAST_TOWARD)
            add_to_face(sums, run[i], face, face_weight, one_normal, one_color, colored)


@njit(cache=True, nogil=True)
def _bucket_starts(codes: NDArray[np.uint64], level: int) -> NDArray[np.int64]:
    """Where runs of codes with the same upper bits start, so that searches are short."""
    shift = np.uint64(max(3 * level - _BUCKET_BITS, 0))
    mask = np.uint64((1 << _BUCKET_BITS) - 1)
    starts = np.zeros((1 << _BUCKET_BITS) + 1, np.int64)
    for code in codes:
        starts[int((code >> shift) & mask) + 1] += 1
    return np.cumsum(starts)


@njit(cache=True, nogil=True)
def _neighbour(
    codes: NDArray[np.uint64], starts: NDArray[np.int64], code: np.uint64, face: int, level: int
) -> int:
    """Row of the voxel beyond a face, −1 when it is not there, −2 outside the chunk."""
    axis = face // 2
    at = int(gathered_bits(code >> np.uint64(axis)))
    beyond = at + 1 if face % 2 else at - 1
    if at >> level != beyond >> level:
        return -2
    others = code & ~(np.uint64(0x1249249249249249) << np.uint64(axis))
    wanted = others | (spread_bits(beyond) << np.uint64(axis))
    shift = np.uint64(max(3 * level - _BUCKET_BITS, 0))
    bucket = int((wanted >> shift) & np.uint64((1 << _BUCKET_BITS) - 1))
    low, high = starts[bucket], starts[bucket + 1]
    while low < high:
        middle = (low + high) // 2
        if codes[middle] < wanted:
            low = middle + 1
        else:
            high = middle
    return low if low < starts[bucket + 1] and codes[low] == wanted else -1


@njit(cache=True, nogil=True)
def _on_border(code: np.uint64, level: int) -> bool:
    """Whether a voxel has a face on the border of its chunk."""
    last = np.uint64((1 << level) - 1)
    for axis in range(3):
        at = gathered_bits(code >> np.uint64(axis)) & last
        if at == np.uint64(0) or at == last:
            return True
    return False


@njit(cache=True, nogil=True)
def _main_axis(normal: NDArray[np.float32]) -> int:
    axis = 0
    for k in range(1, 3):
        if abs(normal[k]) > abs(normal[axis]):
            axis = k
    return axis


@njit(cache=True, nogil=True)
def thin_subset(
    codes: NDArray[np.uint64], faces: NDArray[np.uint8], normal: NDArray[np.float32],
    separating: NDArray[np.bool_], level: int,
) -> NDArray[np.bool_]:  # fmt: skip
    """Which voxels (n,) of a chunk to keep: the separating ones and what they leave out.

    Needles and specks that pass between the middles of voxels must not vanish: a voxel whose
    surface looks both ways along its main axis stays, and so does one that has no separating
    voxel before or behind it.

    Parameters
    ----------
    codes, faces, normal, separating : (n, …) as in a voxel set, of one chunk.
    level : chunks are cubes of 2**level voxels a side.
    """
    keep = separating.copy()
    for i in range(len(codes)):
        axis = _main_axis(normal[i])
        both = faces[i] & faces[i] >> 1 & 0b010101
        # Where both sides cancel there is no main axis.
        keep[i] |= (both & 1 << 2 * axis if normal[i, axis] != 0 else both) != 0
    alone = np.zeros(len(codes), np.bool_)
    starts = _bucket_starts(codes, level)
    for i in range(len(codes)):
        if not keep[i]:
            axis = _main_axis(normal[i])
            before = _neighbour(codes, starts, codes[i], 2 * axis, level)
            behind = _neighbour(codes, starts, codes[i], 2 * axis + 1, level)
            alone[i] = not (before >= 0 and keep[before]) and not (behind >= 0 and keep[behind])
    return keep | alone


@njit(cache=True, nogil=True)
def faces_of_kept(
    codes: NDArray[np.uint64], faces: NDArray[np.uint8], keep: NDArray[np.bool_], level: int
) -> NDArray[np.uint8]:
    """Masks (n,) with the faces of kept voxels that come to light where others are dropped.

    A dropped voxel is open to the outside where one of its outward faces has nothing beyond
    it, and through dropped neighbours that are open; what lies beyond the chunk may be open.
    Voxels that are kept show the faces towards open ones. The outside sees faces that are
    set and no others, if that was so with all voxels there.

    Parameters
    ----------
    codes : (n,) ascending Morton codes, of one chunk.
    faces, keep : (n,) outward faces and which voxels are kept.
    level : chunks are cubes of 2**level voxels a side.
    """
    shown = faces.copy()
    starts = _bucket_starts(codes, level)
    is_open = np.zeros(len(codes), np.bool_)
    stack = np.empty(len(codes), np.int64)
    count = 0
    for i in range(len(codes)):
        if keep[i]:
            continue
        is_open[i] = _on_border(codes[i], level)
        for face in range(6):
            if not is_open[i] and faces[i] & (1 << face):
                is_open[i] = _neighbour(codes, starts, codes[i], face, level) < 0
        if is_open[i]:
            stack[count] = i
            count += 1
    while count > 0:
        count -= 1
        i = stack[count]
        for face in range(6):
            beyond = _neighbour(codes, starts, codes[i], face, level)
            if beyond < 0:
                continue
            if keep[beyond]:
                shown[beyond] |= 1 << (face ^ 1)
            elif not is_open[beyond]:
                is_open[beyond] = True
                stack[count] = beyond
                count += 1
    return shown
