"""Photographs over the surface they show, as the items of stages ask for them."""

from __future__ import annotations

import threading
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.pipeline.stage import Products
from workbench.pipeline.tasks import ItemProducts

if TYPE_CHECKING:
    from workbench.color.blending_surface import ReadySurface
    from workbench.geometry.mesh import TriangleMesh
    from workbench.geometry.photo_camera import PhotoCamera

_lock = threading.Lock()
_last_surface: list[tuple[str, ReadySurface]] = []
# A reduced pixel is used where all pixels it is made of may be.
_ALL = 254


def told_surface(products: Products) -> dict[str, Any]:
    """Which surface photographs are laid over: the one made of the scans, or the user's own."""
    if products.is_there("surface"):
        return {"hash": products.content_hash("surface"), "path": None}
    path = products.input_paths("geometry_file")[0]
    return {"hash": products.input_hash(path), "path": str(path)}


def surface_mesh(products: Products | ItemProducts, told: Mapping[str, Any]) -> TriangleMesh:
    """The surface that `told_surface` told."""
    from workbench.formats.surface_files import read_surface

    mesh: TriangleMesh
    mesh = read_surface(Path(told["path"])) if told["path"] else products.load("surface")
    return mesh


def ready_surface(products: ItemProducts, told: Mapping[str, Any]) -> ReadySurface:
    """The surface, kept between items: its rays take longer than a photograph."""
    from workbench.color.blending_surface import ReadySurface

    with _lock:
        if not _last_surface or _last_surface[0][0] != told["hash"]:
            _last_surface.clear()
            _last_surface.append((told["hash"], ReadySurface(surface_mesh(products, told))))
        return _last_surface[0][1]


def told_photo(
    products: Products, name: str, pose: Mapping[str, Any], masked: bool
) -> dict[str, Any]:
    """What an item has to know of an oriented photograph, its contents included.

    Parameters
    ----------
    pose : of ``photo_poses``.
    masked : whether it has a mask.
    """
    contents = [("developed_photos", name), ("unclipped_masks", name)]
    contents += [("photo_masks", name)] if masked else []
    return {
        "name": name,
        "contents": [products.content_hash(*content) for content in contents],
        "masked": masked,
        "camera": {k: pose[k] for k in ("model", "size", "params", "camera_from_world")},
    }


def told_camera(told: Mapping[str, Any], image_px: int) -> PhotoCamera:
    """The camera of a photograph whose longer side is at most so many pixels.

    Parameters
    ----------
    told : of ``photo_poses``: model, size, params and camera_from_world.
    """
    from workbench.geometry.photo_camera import PhotoCamera
    from workbench.geometry.photo_view import within

    width, height = told["size"]
    camera = PhotoCamera(
        told["model"], width, height, tuple(told["params"]), np.array(told["camera_from_world"])
    )
    return within(camera, image_px)


def developed_picture(
    products: ItemProducts, told: Mapping[str, Any], size: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The developed photograph (h, w, 3) at some size, and what of it may be used (h, w).

    Parameters
    ----------
    told : the photograph, by `told_photo`.
    size : width and height in pixels.
    """
    import cv2

    name = told["name"]
    picture = products.load("developed_photos", name).values
    masks = [products.load("unclipped_masks", name)]
    if told["masked"]:
        masks.append(products.load("photo_masks", name))
    usable = np.full(picture.shape[:2], 255, np.uint8)
    for mask in masks:
        # A photograph developed at half size has a mask of full size.
        usable = np.minimum(
            usable, cv2.resize(mask, picture.shape[1::-1], interpolation=cv2.INTER_AREA)
        )
    if size != picture.shape[1::-1]:
        picture = cv2.resize(picture, size, interpolation=cv2.INTER_AREA)
        usable = cv2.resize(usable, size, interpolation=cv2.INTER_AREA)
    return np.asarray(picture, np.float32), np.asarray(usable >= _ALL)
