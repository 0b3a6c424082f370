"""The layered cloud of samples, coloured as the surface is, chunk by chunk."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

import numpy as np

from stages.color.items import weighed
from stages.color.photographs import Photographs, Together
from workbench.metrics import Metric
from workbench.pipeline.photo_surface import ready_surface, told_camera
from workbench.pipeline.stage import Job
from workbench.pipeline.tasks import ItemProducts, Payload

if TYPE_CHECKING:
    from stages.color.options import ColorOptions
    from workbench.cloud.layered_cloud import LayeredCloud

# Samples blended at once, some 150 bytes each.
_AT_ONCE = 4_000_000


def see_cloud(products: ItemProducts, payload: Payload) -> dict[str, Any]:
    """What a photograph says of every sample of the cloud it sees, its flash's shadows known."""
    from workbench.cloud.layered_cloud import LayeredCloud
    from workbench.cloud.numbered_chunks import NumberedChunks
    from workbench.color.blending_observations import observed
    from workbench.color.blending_weights import feathered
    from workbench.geometry.photo_view import lit_by_flash

    surface = ready_surface(products, payload["surface"])
    photo = weighed(products, payload, surface)
    if payload["flash"] is not None:
        lit = lit_by_flash(photo.view, surface.rays, np.array(payload["flash"]))
        photo = replace(
            photo, weights=photo.weights * feathered(lit, payload["weights"]["feather"])
        )
    with LayeredCloud(products.load("sample_cloud")) as cloud:
        found = observed(
            photo, NumberedChunks(cloud).blocks(told_camera(payload["camera"], payload["image_px"]))
        )
    products.save("cloud_observations", found.arrays(), payload["name"])
    return {"samples": len(found)}


def colored_cloud(job: Job[ColorOptions], groups: tuple[Photographs, Photographs]) -> list[Metric]:
    """Blend photographs onto a copy of the cloud, then average upwards.

    Parameters
    ----------
    groups : photographs with flash and without, their light and gains known.
    """
    from workbench.cloud.layered_cloud import LayeredCloud
    from workbench.cloud.schema import Attribute

    products = job.products
    with (
        products.writing("colored_cloud") as path,
        # The store keeps files of its own beside it; they go with the folder.
        TemporaryDirectory(prefix=f".{path.name}.", dir=path.parent) as folder,
    ):
        copy = Path(folder) / "samples.cloud"
        copyfile(products.load("sample_cloud"), copy)
        with LayeredCloud(copy, writable=True) as cloud:
            for attribute in (
                Attribute("albedo", "float32", 3, fill=np.nan),
                Attribute("albedo_weight", "float32"),
                Attribute("far_albedo", "float32", 3, fill=np.nan),
                Attribute("far_weight", "float32"),
            ):
                cloud.add_attribute(attribute)
            told = _blend(job, cloud, groups)
            _consolidate(cloud)
            cloud.commit()
        copy.replace(path)
    return [
        Metric("cloud_photographed_share", 100.0 * told, "%",
               "Samples of the cloud whose colour photographs tell."),
    ]  # fmt: skip


def _blend(
    job: Job[ColorOptions], cloud: LayeredCloud, groups: tuple[Photographs, Photographs]
) -> float:
    """Colour every chunk; the share of samples that photographs tell."""
    from workbench.cloud.numbered_chunks import NumberedChunks
    from workbench.color.blending import blended

    chunks, told = NumberedChunks(cloud), 0
    for some in chunks.ranges(_AT_ONCE):
        first, last = int(chunks.starts[some.start]), int(chunks.starts[some.stop])
        points = np.concatenate(
            [cloud.read(int(chunk), ["points"])["points"] for chunk in chunks.order[some]]
        )
        together = Together(
            [replace(group, points=points, cloud_span=(first, last)) for group in groups]
        )
        result = blended(together, last - first, job.options.robust, job.options.least_weight)
        told += int((result.weights > 0.0).sum())
        for place in range(some.start, some.stop):
            part = slice(int(chunks.starts[place]) - first, int(chunks.starts[place + 1]) - first)
            cloud.write(
                int(chunks.order[place]),
                {
                    "albedo": result.colors[part].astype(np.float32),
                    "albedo_weight": result.weights[part].astype(np.float32),
                },
            )
    return told / max(len(cloud), 1)


def _consolidate(cloud: LayeredCloud) -> None:
    """From the leaves up, every sample becomes the mean of all finer ones around it, too."""
    from workbench.color.blending_consolidation import consolidated

    nodes = cloud.tree.nodes
    names = ["points", "far_albedo", "far_weight"]
    for chunk in cloud.chunks("bottom_up"):
        own = cloud.read(int(chunk), ["points", "albedo", "albedo_weight"])
        children = [int(c) for c in (nodes["left"][chunk], nodes["right"][chunk]) if c >= 0]
        below = [cloud.read(child, names) for child in children]
        finer = tuple(
            np.concatenate([np.zeros((0, 3) if k < 2 else 0), *(part[name] for part in below)])
            for k, name in enumerate(names)
        )
        colors, weights = consolidated(
            own["points"], own["albedo"], own["albedo_weight"], (finer[0], finer[1], finer[2])
        )
        cloud.write(
            int(chunk),
            {
                "far_albedo": colors.astype(np.float32),
                "far_weight": weights.astype(np.float32),
            },
        )
