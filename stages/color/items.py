"""What is asked of each photograph by itself: what it sees, and where its flash reaches."""

from __future__ import annotations

from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np

from workbench.pipeline.photo_surface import developed_picture, ready_surface, told_camera
from workbench.pipeline.tasks import ItemProducts, Payload

if TYPE_CHECKING:
    from workbench.color.blending_observations import WeighedPhoto
    from workbench.color.blending_surface import ReadySurface


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

    camera = told_camera(payload["camera"], payload["image_px"])
    picture, usable = developed_picture(products, payload, (camera.width, camera.height))
    options = WeightOptions(**payload["weights"])
    return surface.weighed(camera, picture, usable, options, payload["normal_px"])


def light_photo(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """How far what a photograph sees lies clear of its flash's shadows."""
    from workbench.color.blending_weights import feathered
    from workbench.geometry.photo_view import lit_by_flash
    from workbench.kernels.photo_buffers import between_pixels

    start, name = perf_counter(), payload["name"]
    surface = ready_surface(products, payload["surface"])
    camera = told_camera(payload["camera"], payload["image_px"])
    view = surface.view(camera)
    lit = lit_by_flash(view, surface.rays, np.array(payload["flash"]))
    clear = feathered(lit, payload["feather"])
    index = products.load("photo_observations", name)["index"]
    pixels, _ = camera.project(surface.mesh.vertices[index])
    trust = between_pixels(clear[..., None], pixels)[:, 0]
    products.save("photo_lighting", {"lit": trust.astype(np.float32)}, name)
    dark = float(1.0 - lit[view.seen].mean()) if view.seen.any() else 0.0
    return {"dark": dark, "seconds": perf_counter() - start}
