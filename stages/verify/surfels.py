"""What is to be said of exported surfels and coded cells, gathered from their files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from stages.verify.frames import users_origin
from workbench.geometry.mesh import TriangleMesh
from workbench.metrics import Metric
from workbench.pipeline.stage import Products
from workbench.pipeline.stitched_pictures import colored_surface

if TYPE_CHECKING:
    from workbench.verification.report_content import Section

_PREFIXES = [1000, 3000, 10_000, 30_000, 100_000]
_COMPARED = (1000, 5000, 10_000)
# Surfels and sides of pictures for which choices are compared.
_CHOSEN, _RESOLUTIONS_PX = 10_000, (128, 256, 512)


def surfel_chapter(
    products: Products, surface: TriangleMesh
) -> tuple[tuple[Section, ...], list[Metric]]:
    """The section on surfels, where the export has some.

    Parameters
    ----------
    surface : as the report knows it, around the project's origin.
    """
    found = products.load_if_there("surfels")
    if found is None:
        return (), []
    from workbench.surfels.spacing import nearest_distances, spacing_distributions
    from workbench.surfels.surfel_file import SurfelFile, surfel_points
    from workbench.verification.surfel_errors import choice_figures, prefix_figures
    from workbench.verification.surfel_sections import (
        ExportedSurfels,
        surfel_metrics,
        surfel_section,
    )

    path = Path(found)
    file = SurfelFile(path)
    finest = surfel_points(path)
    compared = tuple(prefix for prefix in _COMPARED if prefix < 0.5 * len(finest))
    size = float(np.linalg.norm(np.ptp(surface.vertices, axis=0)))
    shown = _as_exported(products, surface, file.colored)
    spacing = (
        spacing_distributions(finest.points, compared, normals=finest.normals, opposite=0.1 * size)
        if compared
        else {}
    )
    apart = nearest_distances(file.node(0).surfels.points)
    told = ExportedSurfels(
        path.stat().st_size,
        int(file.nodes["surfels"].sum(dtype=np.int64)),
        len(file.nodes),
        int(file.nodes["level"].max()) + 1,
        float(np.median(apart)),
        prefix_figures(shown, path, _PREFIXES),
        choice_figures(shown, _CHOSEN, _RESOLUTIONS_PX),
        spacing,
    )
    return (surfel_section(told),), surfel_metrics(told)


def _as_exported(products: Products, surface: TriangleMesh, colored: bool) -> TriangleMesh:
    """The surface in the user's coordinates, with no attribute but its colour."""
    if colored and "color" not in surface.vertex_attributes:
        surface = colored_surface(products, surface)
    color = {"color": surface.vertex_attributes["color"]} if colored else {}
    vertices = surface.vertices + users_origin(products)
    return replace(surface, vertices=vertices, vertex_attributes=color)


def cell_chapter(products: Products) -> tuple[tuple[Section, ...], list[Metric]]:
    """The section on coded cells, where the export has some."""
    found = products.load_if_there("point_cubes")
    if found is None:
        return (), []
    from workbench.pointcodecs.cube_file import PointCubeFile
    from workbench.verification.cell_sections import (
        ExportedCells,
        cell_metrics,
        cell_section,
        codec_figures,
    )

    path = Path(found)
    file = PointCubeFile(path)
    cells = file.read()
    told = ExportedCells(
        file.layout.codec.name,
        path.stat().st_size,
        len(cells),
        1 << cells.frame.level,
        cells.frame.cell_size,
        codec_figures(cells),
    )
    return (cell_section(told),), cell_metrics(told)
