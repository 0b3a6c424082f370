"""What is asked of each photograph by itself: its picture, its depth map, its labelled mesh."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.pipeline.photo_surface import developed_picture, ready_surface, told_camera
from workbench.pipeline.tasks import ItemProducts, Payload

if TYPE_CHECKING:
    from workbench.color.blending_surface import ReadySurface
    from workbench.geometry.photo_camera import PhotoCamera
    from workbench.geometry.photo_view import Block, PlainBlock
    from workbench.texturing.depth_map import DepthMap
    from workbench.texturing.picture_cache import PictureCache

_lock = threading.Lock()
_pictures: list[SharedPictures] = []
_last_samples: list[tuple[str, PlainBlock]] = []
_NEIGHBOURS = 4


def free_photo(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """A photograph free of its flash, and what is seen from where it was taken."""
    from workbench.color.flash_light import FlashLight
    from workbench.color.photo_correction import flash_free_picture
    from workbench.geometry.photo_view import lit_by_flash
    from workbench.texturing.depth_map import (
        depth_map_of_samples,
        depth_map_of_surface,
        small_camera,
        usable_pixels,
    )

    start, name = perf_counter(), payload["name"]
    surface = ready_surface(products, payload["surface"])
    camera = told_camera(payload["camera"], payload["image_px"])
    picture, usable = developed_picture(products, payload, (camera.width, camera.height))
    view = surface.view(camera).smoothed(payload["normal_px"])
    light = None
    if payload["light"] is not None:
        light = FlashLight.from_document(payload["light"])
        usable &= lit_by_flash(view, surface.rays, light.position_in_camera)
    free = flash_free_picture(
        view, picture, usable, payload["space"], light, payload["gain"], payload["border_px"]
    )
    doubted = 0.0
    if payload["doubt"] is not None:
        wrong = _doubted(products, payload["doubt"], free, camera, surface)
        doubted = float((wrong & (free[..., 3] > 0)).sum() / max(int((free[..., 3] > 0).sum()), 1))
        free[wrong, 3] = 0
    products.save("texture_photos", free, name)
    small = small_camera(camera, payload["depth_map_px"])
    whole = usable_pixels(free[..., 3], small)
    if payload["samples"] is None:
        depth = depth_map_of_surface(surface.rays, small, whole, payload["surface"]["closed"])
    else:
        with _sample_blocks(products, payload["samples"], small) as blocks:
            depth = depth_map_of_samples(blocks, small, whole)
    depth = replace(depth, flatness_px=payload["flatness_px"])
    products.save("depth_maps", depth.arrays(), name)
    used = float((free[..., 3] > 0).sum() / max(int(view.seen.sum()), 1))
    return {"used": used, "doubted": doubted, "seconds": perf_counter() - start}


def _doubted(
    products: ItemProducts,
    limit: float,
    free: NDArray[np.uint8],
    camera: PhotoCamera,
    surface: ReadySurface,
) -> NDArray[np.bool_]:
    """Pixels that the blend of all photographs contradicts."""
    from workbench.color.blending_display import encoded_srgb
    from workbench.color.photo_doubt import doubted_pixels
    from workbench.surface.provenance import PHOTOGRAPHED

    told = products.load("surface_color")
    known = told["color_provenance"] == PHOTOGRAPHED
    colors = np.zeros((len(known), 3), np.uint8)
    colors[known] = encoded_srgb(told["color"][known], told["space"].item())
    cell_px = surface.spacing_px(camera)
    return doubted_pixels(free, camera, surface.rays, colors, known, cell_px, limit)


def label_photo(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """The depth mesh of a photograph, labelled with those that see it."""
    from workbench.texturing.cost_options import CostOptions
    from workbench.texturing.multi_mesh import labelled_depth_mesh

    # Numbers by name, so that a label is the same whatever other photographs there are.
    names = sorted(payload["photos"])
    cameras = {
        number: told_camera(payload["photos"][name]["camera"], payload["image_px"])
        for number, name in enumerate(names)
    }
    depth_maps = {
        number: read_depth_map(products, name, cameras[number]) for number, name in enumerate(names)
    }
    shared = _shared_pictures(products, payload["cache_mb"] << 20)
    loads, seconds = shared.cache.loads, shared.cache.load_seconds
    numbers = [shared.number(name, payload["photos"][name]["picture"]) for name in names]
    found = labelled_depth_mesh(
        names.index(payload["name"]),
        depth_maps,
        cameras,
        lambda number: shared.cache.get(numbers[number]),
        CostOptions(**payload["costs"]),
        max_cycles=payload["cycles"],
        bound_sweeps=payload["bound_sweeps"],
    )
    products.save("depth_meshes", {**found.arrays(), "photos": np.array(names)}, payload["name"])
    labelling, labelled = found.labelling, found.labelled
    return {
        "triangles": len(labelled.labels),
        "foreground": int(labelled.foreground.sum()),
        "unseen": int((labelled.labels < 0).sum()),
        "outer": found.outer,
        "photos": len(found.photos),
        "candidates": found.candidates,
        "before": labelling.before.total,
        "energy": labelling.energy.total,
        "seams": labelling.energy.smoothness,
        "bound": labelling.lower_bound,
        "cycles": len(labelling.cycles),
        "cost_seconds": found.cost_seconds,
        "label_seconds": found.label_seconds,
        "loads": shared.cache.loads - loads,
        "load_seconds": shared.cache.load_seconds - seconds,
    }


@contextmanager
def _sample_blocks(
    products: ItemProducts, told: Mapping[str, Any], camera: PhotoCamera
) -> Iterator[Callable[[], Iterable[Block]]]:
    """The samples that a camera may see, to be asked for again and again.

    Parameters
    ----------
    told : which artefact they are in, and its content.
    """
    from workbench.cloud.layered_cloud import LayeredCloud
    from workbench.cloud.numbered_chunks import NumberedChunks

    if told["artefact"] == "sample_cloud":
        with LayeredCloud(products.load("sample_cloud")) as cloud:
            chunks = NumberedChunks(cloud)
            yield lambda: chunks.blocks(camera)
        return
    with _lock:
        if not _last_samples or _last_samples[0][0] != told["hash"]:
            _last_samples[:] = [(told["hash"], _block_of(products.load("samples")))]
        block = _last_samples[0][1]
    yield lambda: (block,)


def _block_of(samples: Mapping[str, NDArray[Any]]) -> PlainBlock:
    """Samples in memory; each stands for what lies between it and its nearest neighbours."""
    from scipy.spatial import cKDTree

    from workbench.geometry.photo_view import PlainBlock

    points = samples["points"]
    apart = np.asarray(cKDTree(points).query(points, k=_NEIGHBOURS + 1)[0])
    return PlainBlock(0, points, samples["normals"].astype(np.float64), apart[:, 1:].mean(axis=1))


class SharedPictures:
    """Texture pictures of a project, kept between items of one process."""

    def __init__(self, products: ItemProducts, budget_bytes: int) -> None:
        from workbench.texturing.picture_cache import PictureCache

        self.products = products
        self.budget_bytes = budget_bytes
        self._names: list[str] = []
        self._numbers: dict[tuple[str, str], int] = {}
        self.cache: PictureCache = PictureCache(self._load, budget_bytes)

    def number(self, name: str, content: str) -> int:
        """What a picture of that content is asked for by."""
        key = (name, content)
        if key not in self._numbers:
            self._numbers[key] = len(self._names)
            self._names.append(name)
        return self._numbers[key]

    def _load(self, number: int) -> NDArray[np.uint8]:
        return np.asarray(self.products.load("texture_photos", self._names[number]))


def read_depth_map(products: ItemProducts, name: str, camera: PhotoCamera) -> DepthMap:
    """The depth map of a photograph."""
    from workbench.texturing.depth_map import DepthMap

    return DepthMap.from_arrays(camera, products.load("depth_maps", name))


def _shared_pictures(products: ItemProducts, budget_bytes: int) -> SharedPictures:
    with _lock:
        if not _pictures or _pictures[0].budget_bytes != budget_bytes:
            _pictures[:] = [SharedPictures(products, budget_bytes)]
        # Another project, or this one anew: contents tell pictures apart, the folder does not.
        _pictures[0].products = products
        return _pictures[0]
