"""Cameras as ``transforms.json``, as instant-ngp, nerfstudio and Blender's exporters write it.

Source: instant-ngp ``docs/nerf_dataset_tips.md`` and nerfstudio's "Data conventions". The
matrix takes the camera's frame to the world's; the camera looks along −z with y up (OpenGL).
Pixels are COLMAP's: the centre of the upper left one is (0.5, 0.5).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from pathlib import Path, PurePosixPath
from typing import Any

import numpy as np

from workbench.errors import InputError
from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, checked_sides
from workbench.formats.whole_file import whole_file
from workbench.geometry.transforms import inverse, is_rigid, nearest_rigid

_EXPORT_AGAIN = "Correct the file, or export the cameras again."
_FLIP = np.diag([1.0, -1.0, -1.0, 1.0])
_FISHEYE = "OPENCV_FISHEYE"
_FRAME_MODELS = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE")


def read_nerf_transforms(
    path: Path, size_of: Callable[[str], tuple[int, int] | None]
) -> ColmapModel:
    """Read all frames; cameras of one calibration are one.

    Parameters
    ----------
    path : the file.
    size_of : width and height of a photograph by its name in the file, None where it is not
        there; asked where the file tells no size. Frames without are left out.

    Returns
    -------
    Frame i as image i + 1, named by its file without folders; no points.

    Raises
    ------
    InputError
        The file is no JSON, a frame has no rigid matrix, no focal length or a value that is
        no finite number, or the camera model is unknown; the frame is named.
    """
    try:
        content = json.loads(whole_file(path))
    except (ValueError, RecursionError) as error:
        raise InputError(
            "This file is no JSON.", file=path, found=str(error)[:200], fix=_EXPORT_AGAIN
        ) from None
    frames = content.get("frames") if isinstance(content, dict) else None
    if not isinstance(frames, list) or not frames:
        raise InputError(
            "This file has no frames.",
            file=path,
            expected='{"frames": [...]}',
            found="none",
            fix=_EXPORT_AGAIN,
        )
    lenses: dict[tuple[Any, ...], int] = {}
    cameras: dict[int, ColmapCamera] = {}
    images = {}
    for number, frame in enumerate(frames, start=1):
        try:
            name = _name(frame)
            values = {key: value for key, value in content.items() if key != "frames"} | frame
            size = (values["w"], values["h"]) if {"w", "h"} <= set(values) else size_of(name)
            if size is None:
                continue
            model, width, height, params = _lens(values, size)
            camera_from_world = _camera_from_world(frame)
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise InputError(
                "A frame cannot be read.",
                file=path,
                where=f"frame {number}",
                found=f"no {error}" if isinstance(error, KeyError) else str(error)[:200],
                fix=_EXPORT_AGAIN,
            ) from None
        camera = lenses.setdefault((model, width, height, params), len(lenses) + 1)
        cameras[camera] = ColmapCamera(camera, model, width, height, params)
        images[number] = ColmapImage(number, camera_from_world, camera, name)
    return ColmapModel(cameras, images)


def _name(frame: Any) -> str:
    if not isinstance(frame, dict) or not isinstance(frame["file_path"], str):
        raise ValueError("a frame is an object with the file_path of a photograph")
    return PurePosixPath(frame["file_path"].replace("\\", "/")).name


def _lens(
    values: Mapping[str, Any], size: tuple[Any, Any]
) -> tuple[str, int, int, tuple[float, ...]]:
    """COLMAP's model, width, height and parameters of a frame."""
    width, height = (_number(side) for side in size)
    if not (width.is_integer() and height.is_integer()):
        raise ValueError(f"a picture of {width} × {height} pixels")
    checked_sides(int(width), int(height))
    model = values.get("camera_model", "OPENCV")
    if values.get("is_fisheye"):
        model = _FISHEYE
    if model not in (*_FRAME_MODELS, _FISHEYE):
        raise ValueError(f"unknown camera model {model!r}")
    if "fl_x" in values:
        focal_x = _number(values["fl_x"])
    else:
        focal_x = 0.5 * width / np.tan(0.5 * _number(values["camera_angle_x"]))
    if "fl_y" in values:
        focal_y = _number(values["fl_y"])
    elif "camera_angle_y" in values:
        focal_y = 0.5 * height / np.tan(0.5 * _number(values["camera_angle_y"]))
    else:
        focal_y = focal_x
    if min(focal_x, focal_y) <= 0.0:
        raise ValueError("a focal length is not positive")
    middle = _number(values.get("cx", width / 2.0)), _number(values.get("cy", height / 2.0))
    bends = ("k1", "k2", "k3", "k4") if model == _FISHEYE else ("k1", "k2", "p1", "p2")
    bent = [_number(values.get(key, 0.0)) for key in bends]
    numbers = (float(focal_x), float(focal_y), *middle, *bent)
    if model == _FISHEYE:
        return model, int(width), int(height), numbers
    k3, k4 = (_number(values.get(key, 0.0)) for key in ("k3", "k4"))
    if k4:
        raise ValueError("k4 without a fisheye lens is not known")
    if k3:
        return "FULL_OPENCV", int(width), int(height), (*numbers, k3, 0.0, 0.0, 0.0)
    return "OPENCV", int(width), int(height), numbers


def _camera_from_world(frame: Mapping[str, Any]) -> np.ndarray:
    matrix = np.array(frame["transform_matrix"], float)
    if matrix.shape == (3, 4):
        matrix = np.vstack([matrix, [0.0, 0.0, 0.0, 1.0]])
    if not is_rigid(matrix, 1e-3):
        raise ValueError("transform_matrix is not rigid")
    return inverse(nearest_rigid(matrix) @ _FLIP)


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not np.isfinite(value):
        raise ValueError(f"{value!r} is no finite number")
    return float(value)
