"""COLMAP's own PatchMatch stereo on a graphics card, where there is one.

Source: Schönberger et al. 2016, "Pixelwise view selection for unstructured multi-view stereo";
the workspace and its map files are those of COLMAP's documentation ("Output Format").
"""

from __future__ import annotations

import glob
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, write_colmap_text
from workbench.stereo.views import StereoView

_CARDS = "/dev/nvidia[0-9]*"
_LONGEST_SIZE = 64


def why_not_colmap() -> str | None:
    """Why COLMAP cannot match on this machine; None where it can."""
    import pycolmap

    if not pycolmap.has_cuda:
        return "this pycolmap is built without CUDA"
    if not glob.glob(_CARDS):
        return "there is no NVIDIA card"
    return None


def colmap_planes(
    folder: Path,
    names: Sequence[str],
    view_of: Callable[[str], StereoView],
    pairs: Mapping[str, Sequence[str]],
    span: tuple[float, float],
) -> Callable[[str], NDArray[np.float32]]:
    """Have COLMAP match all views; returns what gives a view's planes (h, w, 3), 0 for none.

    Parameters
    ----------
    folder : empty; pictures and maps are kept here, and read from here later.
    pairs : by view, the others it is compared with.
    span : least and greatest depth of all views.

    Raises
    ------
    InputError
        Where COLMAP fails, or leaves no map of a view.
    """
    import pycolmap

    sizes = {}
    cameras, images = {}, {}
    (folder / "images").mkdir()
    for number, name in enumerate(names, start=1):
        view = view_of(name)
        height, width = sizes[name] = view.grey.shape
        grey = np.clip(view.grey, 0.0, 255.0).round().astype(np.uint8)
        cv2.imwrite(str(folder / "images" / f"{name}.png"), grey)
        fx, fy, cx, cy = view.lens
        # There the corner of the picture is (0, 0), here the middle of its first pixel.
        params = (float(fx), float(fy), float(cx) + 0.5, float(cy) + 0.5)
        cameras[number] = ColmapCamera(number, "PINHOLE", width, height, params)
        images[number] = ColmapImage(number, view.camera_from_world, number, f"{name}.png")
    write_colmap_text(folder / "sparse", ColmapModel(cameras, images))
    for kind in ("depth_maps", "normal_maps", "consistency_graphs"):
        (folder / "stereo" / kind).mkdir(parents=True)
    lines = [f"{name}.png\n{', '.join(f'{one}.png' for one in pairs[name])}\n" for name in names]
    (folder / "stereo" / "patch-match.cfg").write_text("".join(lines))
    options = pycolmap.PatchMatchOptions()
    options.depth_min, options.depth_max = span
    # What is believed is decided over all views, later.
    options.filter = False
    try:
        pycolmap.patch_match_stereo(str(folder), options=options)
    except (RuntimeError, ValueError) as error:
        raise InputError(
            "COLMAP's PatchMatch stereo failed",
            found=str(error)[:200],
            fix="--set densify.matcher=own, which needs no graphics card",
        ) from error

    def planes(name: str) -> NDArray[np.float32]:
        maps = [
            read_map(folder / "stereo" / kind / f"{name}.png.geometric.bin", sizes[name], parts)
            for kind, parts in (("depth_maps", 1), ("normal_maps", 3))
        ]
        return planes_of(maps[0][..., 0], maps[1], view_of(name).lens)

    return planes


def planes_of(
    depth: NDArray[np.float32], normal: NDArray[np.float32], lens: NDArray[np.float64]
) -> NDArray[np.float32]:
    """Planes (h, w, 3) of depths (h, w) and normals (h, w, 3) in the camera's frame.

    A plane is one over depth and its change for a pixel to the right and down; 0 where the
    depth is not above 0.
    """
    rows, columns = np.indices(depth.shape)
    ray = np.stack(
        [(columns - lens[2]) / lens[0], (rows - lens[3]) / lens[1], np.ones(depth.shape)], axis=-1
    )
    across = (normal * ray).sum(axis=2)
    there = (depth > 0.0) & np.isfinite(depth) & (across != 0.0)
    per = np.where(there, 1.0 / np.where(there, depth * across, 1.0), 0.0)
    nearness = np.where(there, 1.0 / np.where(there, depth, 1.0), 0.0)
    found = np.stack(
        [nearness, normal[..., 0] * per / lens[0], normal[..., 1] * per / lens[1]], axis=-1
    )
    return found.astype(np.float32)


def read_map(path: Path, shape: tuple[int, int], parts: int) -> NDArray[np.float32]:
    """One of COLMAP's maps (h, w, parts): ``width&height&parts&``, then float32, part by part.

    Raises
    ------
    InputError
        Where the file is missing or not of this size.
    """
    try:
        data = path.read_bytes()
    except FileNotFoundError as error:
        raise InputError(
            "COLMAP left no map of a photograph",
            file=str(path),
            fix="--set densify.matcher=own",
        ) from error
    height, width = shape
    header = f"{width}&{height}&{parts}&".encode()
    if not data.startswith(header) or len(data) != len(header) + 4 * width * height * parts:
        raise InputError(
            "A map of COLMAP's is not of its photograph's size",
            file=str(path),
            found=data[:_LONGEST_SIZE].split(b"\0")[0].decode("ascii", "replace"),
            fix="--set densify.matcher=own",
        )
    values = np.frombuffer(data, "<f4", offset=len(header)).reshape(parts, height, width)
    return np.ascontiguousarray(np.moveaxis(values, 0, 2), dtype=np.float32)
