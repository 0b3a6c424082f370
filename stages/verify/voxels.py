"""What is to be said of exported voxels, gathered from their file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from stages.verify.frames import users_origin
from workbench.geometry.mesh import TriangleMesh
from workbench.metrics import Metric
from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.verification.report_content import Section
    from workbench.verification.voxel_sections import ExportedVoxels, LevelFigures
    from workbench.voxels.dag_file import VoxelGraph
    from workbench.voxels.lod_file import LodFile

_PICTURE_PX = (560, 560)
# All encodings of more voxels take minutes; what the file's own takes is told in any case.
_MOST_COMPARED = 50_000_000
_FINEST_COMPARED, _LEAST_RAYS = 11, 512


def voxel_chapter(
    products: Products,
    surface: TriangleMesh,
    *,
    up: Literal["x", "y", "z"],
    front_deg: float,
) -> tuple[tuple[Section, ...], list[Metric]]:
    """The section on voxels, where the export has some.

    Parameters
    ----------
    surface : as the report knows it, around the project's origin.
    up, front_deg : how the picture is turned; voxels are drawn upright along y or z.
    """
    from workbench.verification.voxel_sections import voxel_metrics, voxel_section

    graph, levels = (products.load_if_there(name) for name in ("voxel_graph", "voxel_lod"))
    if graph is not None:
        told = _of_graph(Path(graph), "y" if up == "y" else "z", front_deg)
    elif levels is not None:
        moved = replace(surface, vertices=surface.vertices + users_origin(products))
        told = _of_levels(Path(levels), moved, "y" if up == "y" else "z", front_deg)
    else:
        return (), []
    return (voxel_section(told),), voxel_metrics(told)


def _of_graph(path: Path, up: str, front_deg: float) -> ExportedVoxels:
    from workbench.verification.voxel_sections import ExportedVoxels
    from workbench.voxels.dag_decoding import DagWalk
    from workbench.voxels.dag_file import read_voxel_graph
    from workbench.voxels.dag_reading import dag_of
    from workbench.voxels.dag_reduction import reduced_dag
    from workbench.voxels.graph_export import encoding_figures

    voxels = read_voxel_graph(path)
    graph, figures = voxels.graph, []
    if graph.voxels <= _MOST_COMPARED:
        figures = encoding_figures(reduced_dag(DagWalk(dag_of(graph)).codes(), graph.level))
    return ExportedVoxels(
        voxels.grid, graph.voxels, path.stat().st_size, graph.encoding, figures, (), 0,
        _pictures(voxels, up, front_deg),
    )  # fmt: skip


def _of_levels(path: Path, surface: TriangleMesh, up: str, front_deg: float) -> ExportedVoxels:
    from workbench.verification.voxel_sections import ExportedVoxels
    from workbench.voxels.lod_file import LodFile
    from workbench.voxels.voxel_points import voxel_points

    file = LodFile(path)
    counts = np.bincount(file.nodes["level"], file.nodes["voxels"]).astype(np.int64)
    # No pixel of the picture sees more.
    drawn = max(level for level in np.flatnonzero(counts) if level <= _FINEST_COMPARED)
    return ExportedVoxels(
        file.grid, int(counts[-1]), path.stat().st_size, "", (), _levels(file, surface),
        int(file.nodes["geometry_stored"].sum(dtype=np.int64)),
        _pictures(voxel_points(path, int(drawn)).graph(), up, front_deg),
    )  # fmt: skip


def _levels(file: LodFile, surface: TriangleMesh) -> list[LevelFigures]:
    """Levels of a file that pictures can tell apart, coarse to fine."""
    from workbench.verification.voxel_errors import MeshViews, seconds_to_make
    from workbench.verification.voxel_sections import LevelFigures

    there = [int(level) for level in np.unique(file.nodes["level"]) if level <= _FINEST_COMPARED]
    views = MeshViews.of(surface, file.grid, max(1 << there[-1], _LEAST_RAYS))
    figures = []
    seconds_to_make(surface, file, there[0])  # Compiled before the clock counts.
    for level in there:
        nodes = file.nodes[file.nodes["level"] == level]
        figures.append(
            LevelFigures(
                level,
                int(nodes["voxels"].sum(dtype=np.int64)),
                len(nodes),
                float(nodes["stored"].sum(dtype=np.int64)) / 1e6,
                seconds_to_make(surface, file, level),
                views.error_of(file, level),
            )
        )
    return figures


def _pictures(voxels: VoxelGraph, up: str, front_deg: float) -> dict[str, NDArray[np.uint8]]:
    """From the front and from the back."""
    from workbench.voxels.graph_pictures import camera_around, picture

    width, height = _PICTURE_PX
    return {
        name: picture(
            voxels, camera_around(voxels.grid, width, height, azimuth=front_deg + turned, up=up)
        )
        for name, turned in (("Front", 0.0), ("Back", 180.0))
    }
