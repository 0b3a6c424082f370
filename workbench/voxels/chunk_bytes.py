"""Voxels of a chunk as bytes: eight a voxel, or twelve with colour."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.voxels.voxel_set import VoxelSet

_SEPARATING, _SIDED = np.uint8(64), np.uint8(128)
_FACES = np.uint8(63)
_STEPS = 511
_PLAIN = [("cell", "u1", (3,)), ("mask", "u1"), ("normal", "<u4")]
_COLORED = [*_PLAIN, ("color", "u1", (4,))]
_FACE_PLAIN = [("normal", "<u4")]
_FACE_COLORED = [*_FACE_PLAIN, ("color", "u1", (4,))]


@dataclass(frozen=True)
class ChunkVoxels:
    """The voxels of one chunk as a file has them.

    Attributes
    ----------
    cells : (n, 3) uint8, coordinates in the chunk.
    faces : (n,) uint8, bits 0…5 for the faces −x, +x, −y, +y, −z, +z that are shown.
    separating : (n,) bool, the 6-separating subset.
    normal : (n, 3) float32 unit normals in steps of 1/511; zero where both sides cancel.
    color : (n, 3) uint8 sRGB, or None.
    side : (n,) int32, row of the two arrays below for voxels whose faces differ, else −1.
    face_normal, face_color : (k, 6, 3) of each face that is shown; ``face_color`` or None.
    """

    cells: NDArray[np.uint8]
    faces: NDArray[np.uint8]
    separating: NDArray[np.bool_]
    normal: NDArray[np.float32]
    color: NDArray[np.uint8] | None
    side: NDArray[np.int32]
    face_normal: NDArray[np.float32]
    face_color: NDArray[np.uint8] | None


def packed_normals(normal: NDArray[np.float32]) -> NDArray[np.uint32]:
    """Unit normals (…, 3) in 10 bits an axis, x lowest: 512 plus the component times 511."""
    steps = (np.rint(normal.astype(np.float64) * _STEPS) + 512).astype(np.uint32)
    packed = steps[..., 0] | steps[..., 1] << np.uint32(10) | steps[..., 2] << np.uint32(20)
    return np.asarray(packed, np.uint32)


def unpacked_normals(packed: NDArray[np.uint32]) -> NDArray[np.float32]:
    """Unit normals (…, 3) of `packed_normals`; zero stays zero."""
    steps = np.stack([packed >> np.uint32(shift) & np.uint32(1023) for shift in (0, 10, 20)], -1)
    normal = steps.astype(np.float64) - 512
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    return (normal / np.where(length > 0, length, 1)).astype(np.float32)


def chunk_bytes(voxels: VoxelSet, chunk_level: int) -> bytes:
    """The voxels of one chunk, as in the table of ``workbench.voxels.lod_file``."""
    colored = voxels.color is not None
    sided = voxels.sided
    table = np.zeros(len(voxels), _COLORED if colored else _PLAIN)
    table["cell"] = voxels.cells & ((1 << chunk_level) - 1)
    table["mask"] = voxels.faces | np.where(voxels.separating, _SEPARATING, np.uint8(0))
    table["mask"][sided.index] |= _SIDED
    table["normal"] = packed_normals(voxels.normal)
    shown = _shown(voxels.faces[sided.index])
    faces = np.zeros(int(shown.sum()), _FACE_COLORED if colored else _FACE_PLAIN)
    faces["normal"] = packed_normals(sided.normal[shown])
    if voxels.color is not None and sided.color is not None:
        table["color"][:, :3] = voxels.color
        faces["color"][:, :3] = sided.color[shown]
    return table.tobytes() + _starts(shown).astype("<u4").tobytes() + faces.tobytes()


def _shown(faces: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """(k, 6) which faces masks have."""
    shown: NDArray[np.bool_] = (faces[:, None] >> np.arange(6, dtype=np.uint8) & 1).astype(bool)
    return shown


def _starts(shown: NDArray[np.bool_]) -> NDArray[np.uint32]:
    """Where the faces of each sided voxel start in the buffer; none without sided voxels."""
    faces = shown.sum(axis=1)
    return np.asarray(np.cumsum(faces) - faces, np.uint32)


def chunk_of_bytes(data: bytes, count: int, sided: int, colored: bool) -> ChunkVoxels:
    """The voxels of `chunk_bytes`.

    Parameters
    ----------
    data
        All bytes of the chunk, uncompressed.
    count, sided
        Number of voxels, and of those whose faces differ, from the index of the file.
    colored
        Whether the file has colour.

    Raises
    ------
    InputError
        The bytes do not hold what the index says.
    """
    kind = np.dtype(_COLORED if colored else _PLAIN)
    face_kind = np.dtype(_FACE_COLORED if colored else _FACE_PLAIN)
    fixed = count * kind.itemsize + 4 * sided
    if len(data) < fixed:
        raise _broken(f"{len(data)} bytes for {count} voxels")
    table = np.frombuffer(data, kind, count)
    starts = np.frombuffer(data, "<u4", sided, count * kind.itemsize)
    mask = table["mask"]
    has_sides = (mask & _SIDED) != 0
    faces = mask & _FACES
    shown = _shown(faces[has_sides])
    total = int(shown.sum())
    if len(shown) != sided or len(data) != fixed + total * face_kind.itemsize:
        raise _broken(f"{len(shown)} voxels with {total} faces in {len(data)} bytes")
    if (starts != _starts(shown)).any():
        raise _broken("faces that start elsewhere")
    records = np.frombuffer(data, face_kind, total, fixed)
    normal = unpacked_normals(table["normal"])
    side = np.full(count, -1, np.int32)
    side[has_sides] = np.arange(sided)
    face_normal = _by_face(normal[has_sides], shown, unpacked_normals(records["normal"]))
    color = face_color = None
    if colored:
        color = table["color"][:, :3].copy()
        face_color = _by_face(color[has_sides], shown, records["color"][:, :3])
    return ChunkVoxels(
        table["cell"].copy(), faces, (mask & _SEPARATING) != 0, normal, color,
        side, face_normal, face_color,
    )  # fmt: skip


def _by_face(own: NDArray[Any], shown: NDArray[np.bool_], values: NDArray[Any]) -> NDArray[Any]:
    """(k, 6, 3) the voxel's value, replaced where the face has one."""
    every = np.repeat(own[:, None], 6, axis=1)
    every[shown] = values
    return every


def _broken(found: str) -> InputError:
    return InputError(
        "A chunk of the voxel file does not hold what its index says.",
        found=found,
        fix="Copy or export the file again.",
    )
