"""Ready-made orientations of photographs, whatever program they come from."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from workbench.errors import InputError
from workbench.formats import bundler, colmap, colmap_binary
from workbench.formats.agisoft import read_agisoft
from workbench.formats.colmap import NO_POINT, ColmapCamera, ColmapModel, ColmapPoint
from workbench.formats.nerf_transforms import read_nerf_transforms
from workbench.formats.photo_reading import photo_size

_LIST_FILES = ("list.txt", "bundle.list.txt", "bundle.out.list.txt")
_COLMAP_FOLDERS = (".", "sparse/0", "sparse", "0")
# Models with one focal length in place of two.
_ONE_FOCAL = frozenset(
    ("SIMPLE_PINHOLE", "SIMPLE_RADIAL", "RADIAL", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE")
)
_KINDS = (
    "a folder with cameras.txt and images.txt or cameras.bin and images.bin (COLMAP), "
    "bundle.out (Bundler), *.xml (Agisoft), transforms.json (NeRF)"
)


def read_orientations(path: Path, photos: Sequence[Path]) -> ColmapModel:
    """The orientations of ``photos`` that a file or folder tells.

    Parameters
    ----------
    path : a COLMAP model as text or binary, or a folder that has one as ``sparse/0``; a
        Bundler file with its list of names beside it; Agisoft's XML; ``transforms.json``; or a
        folder with one of these.
    photos : the photographs; an image belongs to the one of the same file name or, where
        there is none, of the same name without suffix, in any case of letters.

    Returns
    -------
    Images bear the file names of their photographs and the numbers of the file. A photograph
    the file does not place is not in it; an image of the file without a photograph is left
    out, with its observations. Cameras are those of the photographs at their full size.

    Raises
    ------
    InputError
        Nothing known is there, it is damaged, it places none of the photographs, two of them
        could be meant by one name, or a camera's picture is not of the photograph's shape.
    """
    path = Path(path)
    by_name = _Names(photos)
    source, model = _read(path, photos, by_name)
    named: dict[int, Path] = {}
    for number, image in model.images.items():
        photo = by_name.photo_of(image.name, source)
        if photo is not None:
            if photo in named.values():
                raise InputError(
                    "A photograph is oriented twice.",
                    file=source,
                    where=image.name,
                    fix="Remove one of the two, or rename the photographs so that they differ.",
                )
            named[number] = photo
    if not named:
        raise InputError(
            "None of the photographs is oriented here.",
            file=source,
            expected=", ".join(photo.name for photo in photos[:3]) + (" …" if photos[3:] else ""),
            found=", ".join(image.name for image in list(model.images.values())[:3]) or "nothing",
            fix="Name the photographs as they were when they were oriented.",
        )
    return _at_full_size(_only(model, named), named, source)


class _Names:
    """Photographs by how their names may be written."""

    def __init__(self, photos: Sequence[Path]) -> None:
        self._by_key: dict[str, list[Path]] = {}
        for photo in photos:
            for key in {photo.name, photo.name.lower(), f"{photo.stem.lower()}."}:
                self._by_key.setdefault(key, []).append(photo)

    def photo_of(self, name: str, source: Path) -> Path | None:
        """The photograph meant; None where there is none, InputError where several could be."""
        bare = PurePosixPath(name.replace("\\", "/"))
        for key in (bare.name, bare.name.lower(), f"{bare.stem.lower()}.", f"{bare.name.lower()}."):
            found = self._by_key.get(key, [])
            if len(found) > 1:
                raise InputError(
                    "Several photographs could be meant.",
                    file=source,
                    where=name,
                    found=", ".join(str(photo) for photo in found),
                    fix="Give the photographs names that differ by more than suffix and folder.",
                )
            if found:
                return found[0]
        return None


def _read(path: Path, photos: Sequence[Path], by_name: _Names) -> tuple[Path, ColmapModel]:
    """The file or folder that was read, and what it says."""
    if path.is_dir():
        for below in _COLMAP_FOLDERS:
            folder = path / below
            if (folder / colmap_binary.IMAGES).exists():
                return folder, colmap_binary.read_colmap_binary(folder)
            if (folder / colmap.IMAGES).exists():
                return folder, colmap.read_colmap_text(folder)
        files = [
            file
            for pattern in ("bundle.out", "transforms.json", "*.xml", "bundle/bundle.out")
            for file in sorted(path.glob(pattern))
        ]
        if len(files) != 1:
            raise InputError(
                "There is no orientation in this folder."
                if not files
                else "There is more than one orientation in this folder.",
                file=path,
                expected=_KINDS,
                found=", ".join(file.name for file in files) or "none of these",
                fix="Name the file itself, or leave one of them there.",
            )
        return _read(files[0], photos, by_name)
    if path.name in (colmap.CAMERAS, colmap.IMAGES, colmap.POINTS):
        return path.parent, colmap.read_colmap_text(path.parent)
    if path.name in (colmap_binary.CAMERAS, colmap_binary.IMAGES, colmap_binary.POINTS):
        return path.parent, colmap_binary.read_colmap_binary(path.parent)
    if path.suffix.lower() == ".out":
        names = _bundler_names(path, photos)
        sizes = {}
        for name in names:
            photo = by_name.photo_of(name, path)
            if photo is not None:
                sizes[name] = photo_size(photo)
        return path, bundler.read_bundler(path, names, sizes)
    if path.suffix.lower() == ".xml":
        return path, read_agisoft(path)
    if path.suffix.lower() == ".json":

        def size_of(name: str) -> tuple[int, int] | None:
            photo = by_name.photo_of(name, path)
            return None if photo is None else photo_size(photo)

        return path, read_nerf_transforms(path, size_of)
    raise InputError(
        "This is no orientation that can be read."
        if path.exists()
        else "There is no such file or folder.",
        file=path,
        expected=_KINDS,
        fix="Check the path, or export the orientation in one of these ways.",
    )


def _bundler_names(path: Path, photos: Sequence[Path]) -> list[str]:
    """Names from the list file beside or above; without one, all photographs in their order."""
    for folder in (path.parent, path.parent.parent):
        for name in _LIST_FILES:
            if (folder / name).exists():
                return bundler.read_bundler_list(folder / name)
    return sorted(photo.name for photo in photos)


def _only(model: ColmapModel, named: Mapping[int, Path]) -> ColmapModel:
    """The images with a photograph, under its name, and the points they see."""
    points = {}
    for number, point in model.points.items():
        track = point.track[np.isin(point.track[:, 0], list(named))]
        if len(track) or not len(point.track):
            points[number] = replace(point, track=track)
    images = {}
    for number, photo in named.items():
        image = model.images[number]
        ids = np.where(np.isin(image.point3d_ids, list(points)), image.point3d_ids, NO_POINT)
        images[number] = replace(image, name=photo.name, point3d_ids=ids)
    return ColmapModel(model.cameras, images, points)


def _at_full_size(model: ColmapModel, named: Mapping[int, Path], source: Path) -> ColmapModel:
    """Cameras and observations in pixels of the photographs as they are."""
    cameras: dict[int, ColmapCamera] = {}
    numbers: dict[tuple[int, tuple[int, int]], int] = {}
    images, ratios = {}, {}
    next_free = max(model.cameras) + 1
    for number, image in model.images.items():
        camera, size = model.cameras[image.camera_id], photo_size(named[number])
        key = (image.camera_id, size)
        if key not in numbers:
            numbers[key] = image.camera_id if image.camera_id not in cameras else next_free
            next_free += numbers[key] == next_free
            cameras[numbers[key]] = _scaled(camera, numbers[key], size, named[number], source)
        ratio = np.array(size) / (camera.width, camera.height)
        ratios[number] = float(ratio.mean())
        images[number] = replace(image, camera_id=numbers[key], points2d=image.points2d * ratio)
    points: dict[int, ColmapPoint] = {}
    for number, point in model.points.items():
        growth = [ratios[image] for image in point.track[:, 0]]
        points[number] = replace(point, error=point.error * float(np.mean(growth or [1.0])))
    return ColmapModel(cameras, images, points)


def _scaled(
    camera: ColmapCamera, number: int, size: tuple[int, int], photo: Path, source: Path
) -> ColmapCamera:
    """The camera of the same lens on a picture of another size."""
    across, down = size[0] / camera.width, size[1] / camera.height
    # Reducing a picture rounds each side to whole pixels.
    if abs(camera.width * down - size[0]) > max(1.0, down) + 0.5:
        raise InputError(
            "The photograph is not of the shape it was oriented with.",
            file=photo,
            expected=f"{camera.width} × {camera.height} or the same made larger or smaller, "
            f"as in {source}",
            found=f"{size[0]} × {size[1]}",
            fix="Give the very photographs that were oriented, upright, neither cropped nor "
            "undistorted.",
        )
    one = camera.model in _ONE_FOCAL
    ratios = ([0.5 * (across + down)] if one else [across, down]) + [across, down]
    params = np.array(camera.params)
    params[: len(ratios)] *= ratios
    return ColmapCamera(number, camera.model, *size, tuple(params.tolist()))
