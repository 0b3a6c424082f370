"""COLMAP's sparse model as text: ``cameras.txt``, ``images.txt``, ``points3D.txt``.

Source: https://colmap.github.io/format.html. The camera looks along +z with x right and y
down; the centre of the upper left pixel is (0.5, 0.5).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.geometry import transforms
from workbench.geometry.photo_camera import PhotoCamera

CAMERAS, IMAGES, POINTS = "cameras.txt", "images.txt", "points3D.txt"
PARAMETER_COUNTS = {
    "SIMPLE_PINHOLE": 3,
    "PINHOLE": 4,
    "SIMPLE_RADIAL": 4,
    "RADIAL": 5,
    "OPENCV": 8,
    "OPENCV_FISHEYE": 8,
    "FULL_OPENCV": 12,
    "FOV": 5,
    "SIMPLE_RADIAL_FISHEYE": 4,
    "RADIAL_FISHEYE": 5,
    "THIN_PRISM_FISHEYE": 12,
}
NO_POINT = -1
LARGEST_SIDE_PX = 1 << 20
"""No picture is taken for wider or higher."""

_EXPORT_AGAIN = "Correct that line, or export the model again."

_Item = TypeVar("_Item")


def _no_points2d() -> NDArray[np.float64]:
    return np.zeros((0, 2))


def _no_ids() -> NDArray[np.int64]:
    return np.zeros(0, np.int64)


@dataclass(frozen=True)
class ColmapCamera:
    """One camera: ``model`` is COLMAP's name, ``params`` in COLMAP's order, pixels."""

    camera_id: int
    model: str
    width: int
    height: int
    params: tuple[float, ...]


@dataclass(frozen=True)
class ColmapImage:
    """One oriented photograph.

    Attributes
    ----------
    image_id, camera_id : positive identifiers.
    camera_from_world : (4, 4) float64 rigid, x right, y down, z forward.
    name : path of the photograph relative to the image folder.
    points2d : (n, 2) float64 observed pixels.
    point3d_ids : (n,) int64 the point each observation belongs to, `NO_POINT` for none.
    """

    image_id: int
    camera_from_world: NDArray[np.float64]
    camera_id: int
    name: str
    points2d: NDArray[np.float64] = field(default_factory=_no_points2d)
    point3d_ids: NDArray[np.int64] = field(default_factory=_no_ids)


@dataclass(frozen=True)
class ColmapPoint:
    """One reconstructed point.

    Attributes
    ----------
    point3d_id : identifier.
    xyz : (3,) float64 in the world frame.
    rgb : (3,) uint8 sRGB-encoded.
    error : mean reprojection error, pixels.
    track : (n, 2) int64 rows of image id and index into that image's observations.
    """

    point3d_id: int
    xyz: NDArray[np.float64]
    rgb: NDArray[np.uint8]
    error: float
    track: NDArray[np.int64]


@dataclass(frozen=True)
class ColmapModel:
    """Cameras, images and points by their identifiers, in the order of the files."""

    cameras: dict[int, ColmapCamera]
    images: dict[int, ColmapImage]
    points: dict[int, ColmapPoint] = field(default_factory=dict)

    def photo_cameras(self) -> dict[str, PhotoCamera]:
        """Every image as an oriented photograph, by its file name without folder and suffix."""
        return {
            PurePosixPath(image.name).stem: PhotoCamera(
                camera.model,
                camera.width,
                camera.height,
                camera.params,
                image.camera_from_world,
            )
            for image in self.images.values()
            for camera in (self.cameras[image.camera_id],)
        }

    def image_named(self, name: str) -> ColmapImage:
        """The image of that name; ``KeyError`` where there is none."""
        for image in self.images.values():
            if image.name == name:
                return image
        raise KeyError(name)


def write_colmap_text(folder: Path, model: ColmapModel) -> None:
    """Write the three files; numbers keep all their digits, so reading gives them back.

    Parameters
    ----------
    folder : made where it is missing.
    model : what to write.

    Raises
    ------
    InputError
        A name holds a space, which COLMAP's own reader takes for its end.
    """
    for image in model.images.values():
        if image.name.split() != [image.name]:
            raise InputError(
                "COLMAP's text files have no room for this name.",
                file=folder / IMAGES,
                expected="a name without spaces",
                found=repr(image.name),
                fix="Rename the photograph.",
            )
    folder.mkdir(parents=True, exist_ok=True)
    _write_lines(
        folder / CAMERAS,
        "CAMERA_ID MODEL WIDTH HEIGHT PARAMS[]",
        (
            " ".join(
                [str(c.camera_id), c.model, str(c.width), str(c.height), *map(_digits, c.params)]
            )
            for c in model.cameras.values()
        ),
    )
    _write_lines(
        folder / IMAGES,
        "IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME, then X Y POINT3D_ID of every observation",
        (line for image in model.images.values() for line in _image_lines(image)),
    )
    _write_lines(
        folder / POINTS,
        "POINT3D_ID X Y Z R G B ERROR, then IMAGE_ID POINT2D_INDEX of every observation",
        (_point_line(point) for point in model.points.values()),
    )


def read_colmap_text(folder: Path) -> ColmapModel:
    """Read ``cameras.txt``, ``images.txt`` and, where it is there, ``points3D.txt``.

    Raises
    ------
    InputError
        A file is missing, a line has the wrong number of values or no numbers, a camera
        model is unknown, an identifier comes twice, or an image names a camera that is not
        there; the file and the line are named.
    """
    folder = Path(folder)
    cameras = {
        camera.camera_id: camera
        for camera in _unique(folder / CAMERAS, _camera, lambda camera: camera.camera_id)
    }
    images = {
        image.image_id: image
        for image in _unique(folder / IMAGES, _image, lambda image: image.image_id, lines_each=2)
    }
    check_cameras_are_there(images, cameras, folder / IMAGES)
    points: dict[int, ColmapPoint] = {}
    if (folder / POINTS).exists():
        points = {
            point.point3d_id: point
            for point in _unique(folder / POINTS, _point, lambda point: point.point3d_id)
        }
    return ColmapModel(cameras, images, points)


def check_cameras_are_there(
    images: Mapping[int, ColmapImage], cameras: Mapping[int, ColmapCamera], file: Path
) -> None:
    """Refuse images, read from ``file``, whose camera is not among ``cameras``."""
    for image in images.values():
        if image.camera_id not in cameras:
            raise InputError(
                "An image refers to a camera that is not there.",
                file=file,
                where=f"image {image.image_id} ({image.name})",
                expected="one of " + ", ".join(map(str, list(cameras)[:20])),
                found=str(image.camera_id),
                fix=_EXPORT_AGAIN,
            )


def checked_sides(width: int, height: int) -> tuple[int, int]:
    """Width and height of a picture, pixels; ValueError where none can be of that size."""
    if not (1 <= width <= LARGEST_SIDE_PX and 1 <= height <= LARGEST_SIDE_PX):
        raise ValueError(f"a picture of {width:.6g} × {height:.6g} pixels")
    return width, height


def _digits(value: float) -> str:
    return repr(float(value))


def _image_lines(image: ColmapImage) -> tuple[str, str]:
    x, y, z, w = Rotation.from_matrix(image.camera_from_world[:3, :3]).as_quat()
    numbers = [w, x, y, z, *image.camera_from_world[:3, 3]]
    observations = (
        f"{_digits(u)} {_digits(v)} {point}"
        for (u, v), point in zip(image.points2d, image.point3d_ids, strict=True)
    )
    pose = " ".join(map(_digits, numbers))
    return f"{image.image_id} {pose} {image.camera_id} {image.name}", " ".join(observations)


def _point_line(point: ColmapPoint) -> str:
    place = " ".join(map(_digits, point.xyz))
    color = " ".join(str(int(value)) for value in point.rgb)
    track = " ".join(str(int(value)) for value in point.track.ravel())
    return f"{point.point3d_id} {place} {color} {_digits(point.error)} {track}".rstrip()


def _write_lines(path: Path, legend: str, lines: Iterator[str]) -> None:
    with replacing(path) as partial, partial.open("w", encoding="utf-8", newline="\n") as file:
        file.write(f"# {legend}\n")
        file.writelines(f"{line}\n" for line in lines)


def _unique(
    path: Path,
    parse: Callable[[list[str]], _Item],
    identifier: Callable[[_Item], int],
    lines_each: int = 1,
) -> Iterator[_Item]:
    """Items of a file, each from ``lines_each`` lines; comments and headers left out."""
    try:
        text = path.read_text(encoding="utf-8")
    except FileNotFoundError:
        raise InputError(
            "A file of the COLMAP model is missing.",
            file=path,
            fix="Export the model as text: colmap model_converter --output_type TXT.",
        ) from None
    except UnicodeDecodeError as error:
        raise InputError(
            "This file is no text.", file=path, found=str(error), fix=_EXPORT_AGAIN
        ) from None
    except OSError as error:
        raise InputError(
            "The file cannot be read.", file=path, found=str(error), fix="Check its permissions."
        ) from error
    numbered = [
        (number, line)
        for number, line in enumerate(text.splitlines(), start=1)
        if not line.startswith("#")
    ]
    if lines_each == 1:
        numbered = [(number, line) for number, line in numbered if line.strip()]
    seen: set[int] = set()
    for first in range(0, len(numbered), lines_each):
        group = numbered[first : first + lines_each]
        if not group[0][1].strip():
            continue
        where = f"line {group[0][0]}"
        # The list of observations may be missing from the last image.
        texts = [line for _, line in group] + [""] * (lines_each - len(group))
        try:
            item = parse(texts)
        except (ValueError, IndexError, OverflowError) as error:
            raise InputError(
                "A line of the COLMAP model cannot be read.",
                file=path,
                where=where,
                found=f"{group[0][1][:80]!r}: {error}",
                fix=_EXPORT_AGAIN,
            ) from None
        if identifier(item) in seen:
            raise InputError(
                "An identifier comes twice.",
                file=path,
                where=where,
                found=str(identifier(item)),
                fix=_EXPORT_AGAIN,
            )
        seen.add(identifier(item))
        yield item


def _camera(lines: list[str]) -> ColmapCamera:
    identifier, model, width, height, *params = lines[0].split()
    if model not in PARAMETER_COUNTS:
        raise ValueError(f"unknown camera model {model}")
    if len(params) != PARAMETER_COUNTS[model]:
        raise ValueError(f"{model} has {PARAMETER_COUNTS[model]} parameters, not {len(params)}")
    numbers = tuple(_finite(params).tolist())
    sides = checked_sides(int(width), int(height))
    return ColmapCamera(int(identifier), model, *sides, numbers)


def _image(lines: list[str]) -> ColmapImage:
    words = lines[0].split(maxsplit=9)
    if len(words) != 10:
        raise ValueError(f"10 values expected, {len(words)} found")
    w, x, y, z, *shift = _finite(words[1:8])
    if w * w + x * x + y * y + z * z < 1e-12:
        raise ValueError("the quaternion is zero")
    observations = _finite(lines[1].split()).reshape(-1, 3)
    return ColmapImage(
        image_id=int(words[0]),
        camera_from_world=transforms.from_quaternion_xyzw([x, y, z, w], shift),
        camera_id=int(words[8]),
        name=words[9],
        points2d=observations[:, :2].copy(),
        point3d_ids=observations[:, 2].astype(np.int64),
    )


def _point(lines: list[str]) -> ColmapPoint:
    words = lines[0].split()
    numbers = _finite(words[1:8])
    if len(numbers) != 7:
        raise ValueError(f"at least 8 values expected, {len(words)} found")
    color = numbers[3:6]
    if ((color < 0) | (color > 255)).any():
        raise ValueError("colours must lie in 0 to 255")
    track = np.array([int(word) for word in words[8:]], np.int64).reshape(-1, 2)
    return ColmapPoint(
        int(words[0]), numbers[:3].copy(), color.astype(np.uint8), float(numbers[6]), track
    )


def _finite(words: list[str]) -> NDArray[np.float64]:
    values = np.array([float(word) for word in words], float)
    if not np.isfinite(values).all():
        raise ValueError("a value is not finite")
    return values
