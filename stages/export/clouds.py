"""The consolidated samples of the scans in the formats that programs for clouds open."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from shutil import copyfile
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from stages.export.options import ExportOptions
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.point_sources import cloud_stream
from workbench.cloud.schema import POINTS
from workbench.formats.point_stream import PointStream, slices_of, surveyed
from workbench.geometry.point_set import PointSet
from workbench.metrics import Metric
from workbench.pipeline.stage import Job, Products

_UNKNOWN = 128
_POTREE = {"metadata.json": "potree_metadata", "hierarchy.bin": "potree_hierarchy",
           "octree.bin": "potree_octree"}  # fmt: skip


def write_clouds(job: Job[ExportOptions], origin: NDArray[np.float64]) -> list[Metric]:
    """Write the samples in every format that is wanted; a metric for each, none without samples.

    Parameters
    ----------
    origin : (3,) of the project, in the user's coordinates.
    """
    from workbench.cloud.point_export import export_points

    products, metrics = job.products, []
    for name in job.options.clouds:
        with job.progress.step(f"writing the samples as {name}"), _samples(products) as found:
            if found is None:
                return []
            stream = found.moved(origin)
            if name == "potree":
                told = _write_potree(products, stream)
            else:
                with products.writing(f"points_{name}") as path:
                    told = export_points(stream, path, name)
        metrics.append(
            Metric(f"points_{name}", told["bytes"] / 1e6, "MB",
                   f"{told['items']} samples as {name}, coordinates rounded by at most "
                   f"{told['rounding_error']:.2g} m.")
        )  # fmt: skip
    return metrics


def _write_potree(products: Products, stream: PointStream) -> dict[str, Any]:
    from workbench.cloud.point_export import export_points

    with TemporaryDirectory() as folder:
        told = export_points(stream, Path(folder) / "potree", "potree")
        for file, artefact in _POTREE.items():
            with products.writing(artefact) as path:
                copyfile(Path(folder) / "potree" / file, path)
    return told


@contextmanager
def _samples(products: Products) -> Iterator[PointStream | None]:
    """The samples with what colours there are, around the project's origin."""
    coloured = products.load_if_there("colored_cloud")
    cloud = coloured or products.load_if_there("sample_cloud")
    if cloud is not None:
        with LayeredCloud(Path(cloud)) as opened:
            yield _photographed(products, opened) if coloured else cloud_stream(opened)
        return
    held = products.load_if_there("samples")
    yield None if held is None else surveyed(slices_of(_held(products, held)))


def _photographed(products: Products, cloud: LayeredCloud) -> PointStream:
    """A cloud with the colours that photographs gave its samples; grey where none did."""
    from workbench.color.blending_display import encoded_srgb

    plain, space = cloud_stream(cloud), products.load("flash")["space"]

    def batches() -> Iterator[PointSet]:
        names = [POINTS, "normals", "radius_m", "albedo"]
        for _, arrays in cloud.blocks(names):
            color = np.full((len(arrays[POINTS]), 3), _UNKNOWN, np.uint8)
            known = np.isfinite(arrays["albedo"]).all(axis=1)
            color[known] = encoded_srgb(arrays["albedo"][known], space)
            yield PointSet(np.asarray(arrays[POINTS]), arrays["normals"], color, arrays["radius_m"])

    return replace(plain, batches=batches, attributes=frozenset({"normals", "color", "radius"}))


def _held(products: Products, held: Mapping[str, NDArray[Any]]) -> PointSet:
    """Samples in memory, coloured as the nearest place of the surface where that has colours."""
    color = held.get("color")
    told, surface = products.load_if_there("surface_color"), products.load_if_there("surface")
    if told is not None and surface is not None:
        from scipy.spatial import cKDTree

        from workbench.color.blending_display import encoded_srgb
        from workbench.geometry.neighbours import nearest

        color = np.full((len(held["points"]), 3), _UNKNOWN, np.uint8)
        known = np.isfinite(told["color"]).all(axis=1)
        vertex = nearest(cKDTree(surface.vertices), held["points"])[1]
        near = known[vertex]
        color[near] = encoded_srgb(told["color"][vertex[near]], told["space"].item())
    return PointSet(
        held["points"],
        held["normals"].astype(np.float32),
        color,
        held["radius_m"].astype(np.float32),
    )
