"""COLMAP's sparse model as binary: ``cameras.bin``, ``images.bin``, ``points3D.bin``.

Source: https://colmap.github.io/format.html. Little-endian. Every count is checked against
the bytes that are left before anything is made room for, so no damage ends the process.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Iterator
from itertools import chain
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.colmap import (
    PARAMETER_COUNTS,
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoint,
    check_cameras_are_there,
    checked_sides,
)
from workbench.formats.whole_file import whole_file
from workbench.geometry import transforms

CAMERAS, IMAGES, POINTS = "cameras.bin", "images.bin", "points3D.bin"
# COLMAP numbers its camera models in this order.
MODELS = tuple(PARAMETER_COUNTS)

_OBSERVATION = np.dtype([("pixel", "<f8", 2), ("point", "<i8")])
_TRACK = np.dtype([("image", "<u4"), ("index", "<u4")])

_Item = TypeVar("_Item")


def write_colmap_binary(folder: Path, model: ColmapModel) -> None:
    """Write the three files; names may hold spaces here.

    Parameters
    ----------
    folder : made where it is missing.
    model : what to write.
    """
    folder.mkdir(parents=True, exist_ok=True)
    _write(folder / CAMERAS, len(model.cameras), map(_camera_bytes, model.cameras.values()))
    _write(folder / IMAGES, len(model.images), map(_image_bytes, model.images.values()))
    _write(folder / POINTS, len(model.points), map(_point_bytes, model.points.values()))


def read_colmap_binary(folder: Path) -> ColmapModel:
    """Read ``cameras.bin``, ``images.bin`` and, where it is there, ``points3D.bin``.

    Raises
    ------
    InputError
        A file is missing, ends too early or too late, a value is not finite, a camera model
        is unknown, an identifier comes twice, or an image names a camera that is not there;
        the file and the offset are named.
    """
    folder = Path(folder)
    cameras = dict(_items(folder / CAMERAS, _camera))
    images = dict(_items(folder / IMAGES, _image))
    check_cameras_are_there(images, cameras, folder / IMAGES)
    points = dict(_items(folder / POINTS, _point)) if (folder / POINTS).exists() else {}
    return ColmapModel(cameras, images, points)


class _Bytes:
    """A file's bytes, taken from the front; asking for more than is left is a ValueError."""

    def __init__(self, data: bytes) -> None:
        self._data = data
        self.offset = 0

    @property
    def left(self) -> int:
        return len(self._data) - self.offset

    def count(self, bytes_each: int) -> int:
        """A number of things that are to follow, each of at least so many bytes."""
        (number,) = self.values("<Q")
        if number * bytes_each > self.left:
            raise ValueError(f"{number} entries do not fit into the {self.left} bytes left")
        return int(number)

    def values(self, layout: str) -> tuple[int | float, ...]:
        size = struct.calcsize(layout)
        if size > self.left:
            raise ValueError(f"{size} bytes expected, {self.left} left")
        found = struct.unpack_from(layout, self._data, self.offset)
        self.offset += size
        return found

    def finite(self, count: int) -> tuple[float, ...]:
        found = self.values(f"<{count}d")
        if not np.isfinite(found).all():
            raise ValueError("a value is not finite")
        return found

    def rows(self, kind: np.dtype[np.void]) -> NDArray[np.void]:
        number = self.count(kind.itemsize)
        found = np.frombuffer(self._data, kind, number, self.offset)
        self.offset += number * kind.itemsize
        return found

    def text(self) -> str:
        end = self._data.find(b"\0", self.offset)
        if end < 0:
            raise ValueError("a name does not end")
        found = self._data[self.offset : end].decode("utf-8")
        self.offset = end + 1
        return found


def _items(path: Path, take: Callable[[_Bytes], tuple[int, _Item]]) -> Iterator[tuple[int, _Item]]:
    """Identifier and item, one after the other, to the last byte of the file."""
    data = _Bytes(whole_file(path))
    start, seen = 0, set()
    try:
        for _ in range(data.count(1)):
            start = data.offset
            identifier, item = take(data)
            if identifier in seen:
                raise ValueError(f"identifier {identifier} comes twice")
            seen.add(identifier)
            yield identifier, item
        start = data.offset
        if data.left:
            raise ValueError(f"{data.left} bytes too many")
    except ValueError as error:
        raise InputError(
            "The COLMAP model is damaged.",
            file=path,
            where=f"byte {start}",
            found=str(error),
            fix="Copy or export it again.",
        ) from None


def _camera(data: _Bytes) -> tuple[int, ColmapCamera]:
    identifier, model, width, height = map(int, data.values("<IiQQ"))
    if not 0 <= model < len(MODELS):
        raise ValueError(f"unknown camera model {model}")
    params = data.finite(PARAMETER_COUNTS[MODELS[model]])
    sides = checked_sides(width, height)
    return identifier, ColmapCamera(identifier, MODELS[model], *sides, params)


def _image(data: _Bytes) -> tuple[int, ColmapImage]:
    (identifier,) = map(int, data.values("<I"))
    w, x, y, z, *shift = data.finite(7)
    if not 1e-12 < w * w + x * x + y * y + z * z < 1e12:
        raise ValueError("the quaternion has no length")
    (camera,) = map(int, data.values("<I"))
    name = data.text()
    seen = data.rows(_OBSERVATION)
    if not np.isfinite(seen["pixel"]).all():
        raise ValueError("an observation is not finite")
    return identifier, ColmapImage(
        image_id=identifier,
        camera_from_world=transforms.from_quaternion_xyzw([x, y, z, w], shift),
        camera_id=camera,
        name=name,
        points2d=seen["pixel"].astype(np.float64),
        point3d_ids=seen["point"].astype(np.int64),
    )


def _point(data: _Bytes) -> tuple[int, ColmapPoint]:
    (identifier,) = map(int, data.values("<Q"))
    xyz = np.array(data.finite(3))
    rgb = np.array(data.values("<3B"), np.uint8)
    # The error of a point that was never adjusted is −1, or not a number.
    (error,) = data.values("<d")
    track = data.rows(_TRACK)
    pairs = np.column_stack([track["image"], track["index"]]).astype(np.int64)
    return identifier, ColmapPoint(identifier, xyz, rgb, float(error), pairs)


def _camera_bytes(camera: ColmapCamera) -> bytes:
    head = (camera.camera_id, MODELS.index(camera.model), camera.width, camera.height)
    return struct.pack(f"<IiQQ{len(camera.params)}d", *head, *camera.params)


def _image_bytes(image: ColmapImage) -> bytes:
    x, y, z, w = Rotation.from_matrix(image.camera_from_world[:3, :3]).as_quat()
    pose = (w, x, y, z, *image.camera_from_world[:3, 3])
    seen = np.zeros(len(image.points2d), _OBSERVATION)
    seen["pixel"], seen["point"] = image.points2d, image.point3d_ids
    return b"".join(
        (
            struct.pack("<I7dI", image.image_id, *pose, image.camera_id),
            image.name.encode("utf-8") + b"\0",
            struct.pack("<Q", len(seen)),
            seen.tobytes(),
        )
    )


def _point_bytes(point: ColmapPoint) -> bytes:
    track = np.zeros(len(point.track), _TRACK)
    track["image"], track["index"] = point.track[:, 0], point.track[:, 1]
    color = (int(value) for value in point.rgb)
    head = struct.pack("<Q3d3Bd", point.point3d_id, *point.xyz, *color, point.error)
    return head + struct.pack("<Q", len(track)) + track.tobytes()


def _write(path: Path, count: int, items: Iterable[bytes]) -> None:
    with replacing(path) as partial, partial.open("wb") as file:
        file.writelines(chain([struct.pack("<Q", count)], items))
