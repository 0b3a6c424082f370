"""The surface itself, textured: labels, levelled seams and an atlas."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from time import perf_counter
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from stages.texture.options import TextureOptions
from workbench.metrics import Metric
from workbench.pipeline.photo_surface import surface_mesh, told_camera, told_surface
from workbench.pipeline.stage import Job, Products
from workbench.pipeline.stitched_pictures import colored_surface

if TYPE_CHECKING:
    from workbench.geometry.textured_mesh import TexturedMesh
    from workbench.texturing.cost_options import CostOptions
    from workbench.texturing.labelling import Labelling
    from workbench.texturing.mesh_texture import TextureReport


def textured_surface(
    job: Job[TextureOptions],
    told: Mapping[str, Mapping[str, Any]],
    names: Sequence[str],
    costs: CostOptions,
) -> list[Metric]:
    """Texture the surface from one photograph a triangle.

    Parameters
    ----------
    told : photographs as items were asked with.
    names : those that texture.
    costs : of choosing a photograph.
    """
    from workbench.texturing.mesh_texture import AtlasOptions, textured
    from workbench.texturing.picture_cache import PictureCache
    from workbench.texturing.single_mesh import labelled_surface

    products, options = job.products, job.options
    start = perf_counter()
    cameras = {k: told_camera(told[n]["camera"], options.image_px) for k, n in enumerate(names)}
    cache = PictureCache(
        lambda number: np.asarray(products.load("texture_photos", names[number])),
        options.cache_mb << 20,
    )
    mesh = colored_surface(products, surface_mesh(products, told_surface(products)))
    with job.progress.step("labelling the surface"):
        labelled, labelling = labelled_surface(
            mesh, cameras, cache.get, costs, max_cycles=options.cycles, threads=2
        )
    halfway = perf_counter()
    with job.progress.step("drawing the atlas"):
        made, report = textured(
            labelled,
            cameras,
            cache.get,
            AtlasOptions(levels=options.seam_levelling, largest=options.page_px),
        )
    products.save("labelled_surface", {**labelled.arrays(), "photos": np.array(names)})
    _save(products, made)
    seconds = (halfway - start, perf_counter() - halfway)
    return _metrics(labelled.labels, labelling, report, seconds, cache.loads)


def _save(products: Products, made: TexturedMesh) -> None:
    products.save(
        "texture_atlas",
        {**made.mesh.arrays(), "texture_places": made.texture_places, "pages": made.pages},
    )
    pages = {f"{number:03d}": page for number, page in enumerate(made.pictures)}
    for item, page in pages.items():
        opaque = np.full(page.shape[:2], 255, np.uint8)
        products.save("texture_pages", np.dstack([page, opaque]), item)
    products.remove_items_except("texture_pages", set(pages))


def _metrics(
    labels: NDArray[np.int32],
    labelling: Labelling,
    report: TextureReport,
    seconds: tuple[float, float],
    loads: int,
) -> list[Metric]:
    untold = 100.0 * float((labels < 0).mean())
    metrics = [
        Metric("surface_triangles", len(labels), "", "Triangles of the textured surface."),
        Metric("surface_unseen", untold, "%", "Of them, those that no photograph shows wholly."),
        Metric("surface_energy_before", labelling.before.total, "",
               "Energy of the best photograph everywhere."),
        Metric("surface_energy", labelling.energy.total, "", "Energy of the labels, eq. 1."),
        Metric("atlas_patches", report.patches, "", "Patches of one photograph each."),
        Metric("atlas_pages", len(report.page_sizes), "", "Pages of the atlas."),
        Metric("atlas_use", 100.0 * report.utilisation, "%", "Texels that triangles cover."),
        Metric("seam_step_before", report.before.mean, "of 255",
               "Step of colour across seams as photographs show them, mean."),
        Metric("seam_step_after", report.after.mean, "of 255", "The same in the atlas."),
        Metric("surface_label_seconds", seconds[0], "s", "Candidates, costs and labels."),
        Metric("atlas_seconds", seconds[1], "s", "Seams levelled and the atlas drawn."),
        Metric("surface_picture_loads", loads, "", "Photographs loaded."),
    ]  # fmt: skip
    if report.levelling is not None:
        metrics += [
            Metric("levelling_moved", report.levelling.rms_shift, "of 255",
                   "How much levelling moved colours, root mean square."),
            Metric("levelling_skewed", 100.0 * report.levelling.skewed_share, "%",
                   "Of the area, what it moved by more than 10 of 255 in a channel."),
        ]  # fmt: skip
    return metrics
