"""Bundler's ``bundle.out`` v0.3 (also written by VisualSFM, OpenSfM and others).

Source: Bundler v0.4 user's manual, "Output format and scene representation". Bundler's camera
looks along −z with y up, its image frame has the origin in the picture's middle and y up:
``pixel = f · (1 + k1 r² + k2 r⁴) · (−x/z, −y/z)``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, ColmapPoint
from workbench.formats.whole_file import whole_file
from workbench.geometry.transforms import is_rigid, nearest_rigid, rigid

_HEADER = "# Bundle file v0.3"
_EXPORT_AGAIN = "Copy the file again, or export it anew as Bundler v0.3."
_FLIP = np.diag([1.0, -1.0, -1.0])


def read_bundler_list(path: Path) -> list[str]:
    """Names of the photographs from a list file: the first word of every line, bare of folders.

    Raises
    ------
    InputError
        The file cannot be read.
    """
    try:
        text = whole_file(path).decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(
            "This file is no text.", file=path, found=str(error), fix=_EXPORT_AGAIN
        ) from None
    return [
        PurePosixPath(line.split()[0].replace("\\", "/")).name
        for line in text.splitlines()
        if line.strip()
    ]


def read_bundler(
    path: Path, names: Sequence[str], sizes: Mapping[str, tuple[int, int]]
) -> ColmapModel:
    """Read the placed cameras and the points.

    Parameters
    ----------
    path : the bundle file.
    names : of the photographs in the order of the file's cameras.
    sizes : width and height by name; the file has none. Cameras without are left out.

    Returns
    -------
    Camera i as image i + 1 with its own RADIAL camera; those that Bundler did not place, with a
    focal length of zero, are not in it.

    Raises
    ------
    InputError
        The file is no bundle file, ends too early, has a value that is no number or not
        finite, or its number of cameras is not that of the names; the place is named.
    """
    words = _Words(path)
    cameras, points = words.whole("the number of cameras"), words.whole("the number of points")
    if cameras != len(names):
        raise InputError(
            "The bundle file does not go with these photographs.",
            file=path,
            expected=f"{len(names)} cameras",
            found=str(cameras),
            fix="Put the list file with the names of the photographs beside it.",
        )
    poses: dict[int, NDArray[np.float64]] = {}
    lenses: dict[int, ColmapCamera] = {}
    for number in range(cameras):
        focal, k1, k2, *motion = words.numbers(15, f"camera {number}")
        if focal == 0.0 or names[number] not in sizes:
            continue
        camera_from_world = rigid(np.reshape(motion[:9], (3, 3)), motion[9:])
        if not is_rigid(camera_from_world, 1e-3) or focal < 0.0:
            raise words.error(f"camera {number}", "a rotation and a focal length", "neither")
        poses[number] = nearest_rigid(camera_from_world)
        width, height = sizes[names[number]]
        params = (focal, width / 2.0, height / 2.0, k1, k2)
        lenses[number + 1] = ColmapCamera(number + 1, "RADIAL", width, height, params)
    pixels: dict[int, list[tuple[float, float]]] = {number: [] for number in poses}
    owners: dict[int, list[int]] = {number: [] for number in poses}
    found = {}
    for number in range(points):
        place = words.numbers(6, f"point {number}")
        if not all(0 <= shade <= 255 for shade in place[3:]):
            raise words.error(f"point {number}", "colours from 0 to 255", str(place[3:]))
        track = []
        for _ in range(words.whole(f"point {number}")):
            camera, _, x, y = words.numbers(4, f"point {number}")
            if not (camera.is_integer() and 0 <= camera < cameras):
                raise words.error(f"point {number}", "a camera's number", str(camera))
            if camera in poses:
                width, height = sizes[names[int(camera)]]
                track.append((int(camera) + 1, len(pixels[int(camera)])))
                pixels[int(camera)].append((width / 2.0 + x, height / 2.0 - y))
                owners[int(camera)].append(number + 1)
        found[number + 1] = ColmapPoint(
            number + 1,
            np.array(place[:3]),
            np.array(place[3:], np.uint8),
            -1.0,
            np.array(track, np.int64).reshape(-1, 2),
        )
    images = {
        number + 1: ColmapImage(
            image_id=number + 1,
            camera_from_world=rigid(_FLIP @ pose[:3, :3], _FLIP @ pose[:3, 3]),
            camera_id=number + 1,
            name=names[number],
            points2d=np.array(pixels[number], float).reshape(-1, 2),
            point3d_ids=np.array(owners[number], np.int64),
        )
        for number, pose in poses.items()
    }
    return ColmapModel(lenses, images, found)


class _Words:
    """The words of a bundle file after its header, taken from the front."""

    def __init__(self, path: Path) -> None:
        self._path = path
        data = whole_file(path)
        if not data.startswith(_HEADER.encode()):
            raise InputError(
                "This is no bundle file of version 0.3.",
                file=path,
                expected=_HEADER,
                found=repr(data[:20]),
                fix=_EXPORT_AGAIN,
            )
        self._words = data[len(_HEADER) :].split()
        self._at = 0

    def numbers(self, count: int, where: str) -> list[float]:
        words = self._words[self._at : self._at + count]
        if len(words) < count:
            raise self.error(where, f"{count} numbers", "the end of the file")
        try:
            values = [float(word) for word in words]
        except ValueError as error:
            raise self.error(where, f"{count} numbers", str(error)) from None
        if not np.isfinite(values).all():
            raise self.error(where, "finite numbers", repr(b" ".join(words)))
        self._at += count
        return values

    def whole(self, where: str) -> int:
        (value,) = self.numbers(1, where)
        if not value.is_integer() or not 0 <= value <= len(self._words):
            raise self.error(where, "a number of things", str(value))
        return int(value)

    def error(self, where: str, expected: str, found: str) -> InputError:
        return InputError(
            "The bundle file is damaged.",
            file=self._path,
            where=where,
            expected=expected,
            found=found[:200],
            fix=_EXPORT_AGAIN,
        )
