"""What is asked of each photograph by itself: what it sees, and where its flash reaches."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.pipeline.tasks import ItemProducts, Payload

if TYPE_CHECKING:
    from workbench.color.blending_observations import WeighedPhoto
    from workbench.color.blending_surface import ReadySurface
    from workbench.geometry.mesh import TriangleMesh
    from workbench.geometry.photo_camera import PhotoCamera

_surface_lock = threading.Lock()
_last_surface: list[tuple[str, ReadySurface]] = []
# A reduced pixel is used where all pixels it is made of may be.
_ALL = 254


def see_photo(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """What a photograph shows of every vertex it sees, and how far that is to be trusted."""
    start = perf_counter()
    surface = ready_surface(products, payload["surface"])
    found = surface.observed(weighed(products, payload, surface))
    products.save("photo_observations", found.arrays(), payload["name"])
    return {"samples": len(found), "seconds": perf_counter() - start}


def weighed(products: ItemProducts, payload: Payload, surface: ReadySurface) -> WeighedPhoto:
    """A photograph ready to be asked for samples."""
    from workbench.color.blending_weights import WeightOptions

    camera = camera_of(payload)
    picture, usable = _picture(products, payload, (camera.width, camera.height))
    options = WeightOptions(**payload["weights"])
    return surface.weighed(camera, picture, usable, options, payload["normal_px"])


def light_photo(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """How far what a photograph sees lies clear of its flash's shadows."""
    from workbench.color.blending_weights import feathered
    from workbench.geometry.photo_view import lit_by_flash
    from workbench.kernels.photo_buffers import between_pixels

    start, name = perf_counter(), payload["name"]
    surface = ready_surface(products, payload["surface"])
    camera = camera_of(payload)
    view = surface.view(camera)
    lit = lit_by_flash(view, surface.rays, np.array(payload["flash"]))
    clear = feathered(lit, payload["feather"])
    index = products.load("photo_observations", name)["index"]
    pixels, _ = camera.project(surface.mesh.vertices[index])
    trust = between_pixels(clear[..., None], pixels)[:, 0]
    products.save("photo_lighting", {"lit": trust.astype(np.float32)}, name)
    dark = float(1.0 - lit[view.seen].mean()) if view.seen.any() else 0.0
    return {"dark": dark, "seconds": perf_counter() - start}


def ready_surface(products: ItemProducts, told: Payload) -> ReadySurface:
    """The surface to colour, kept between items: its rays take longer than a photograph."""
    from workbench.color.blending_surface import ReadySurface

    with _surface_lock:
        if not _last_surface or _last_surface[0][0] != told["hash"]:
            _last_surface.clear()
            mesh = surface_mesh(told, lambda: products.load("surface"))
            _last_surface.append((told["hash"], ReadySurface(mesh)))
        return _last_surface[0][1]


def surface_mesh(told: Payload, made: Callable[[], TriangleMesh]) -> TriangleMesh:
    """The user's own surface, or the one that was ``made`` of the scans."""
    from workbench.formats.surface_files import read_surface

    return read_surface(Path(told["path"])) if told["path"] else made()


def camera_of(payload: Payload) -> PhotoCamera:
    """The camera of a photograph, for the size it is looked at in."""
    from workbench.geometry.photo_camera import PhotoCamera
    from workbench.geometry.photo_view import reduced_camera

    told = payload["camera"]
    camera = PhotoCamera(
        told["model"],
        told["size"][0],
        told["size"][1],
        tuple(told["params"]),
        np.array(told["camera_from_world"]),
    )
    share = min(1.0, payload["image_px"] / max(payload["size"]))
    width, height = (max(1, round(share * side)) for side in payload["size"])
    return reduced_camera(camera, width, height)


def _picture(
    products: ItemProducts, payload: Payload, size: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """The developed photograph (h, w, 3) at some size, and what of it may be used (h, w)."""
    import cv2

    name = payload["name"]
    picture = products.load("developed_photos", name).values
    masks = [products.load("unclipped_masks", name)]
    if payload["masked"]:
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
