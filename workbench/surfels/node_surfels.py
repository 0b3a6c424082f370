"""The surfels of one node, from the candidates it has."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.point_set import PointSet
from workbench.surfels.orders import SurfelOrder, exact_order, progressive_order
from workbench.surfels.prefix_colors import coarse_colors, mean_colors
from workbench.surfels.spacing import measured_spacing, nearest_owner
from workbench.surfels.surfel_file import SurfelNode
from workbench.surfels.surfel_layout import coarse_counts
from workbench.surfels.surfel_options import SurfelOptions


@dataclass(frozen=True)
class Candidates:
    """What the surfels of a node are chosen from.

    Attributes
    ----------
    points : with normals; with colours or without.
    gap : how far a place of the surface may be from the nearest of them.
    items : triangles or points that they stand for.
    opposite : distance of opposite normals in the unit of the points, as in ``exact_order``.
    """

    points: PointSet
    gap: float
    items: int
    opposite: float


def chosen_surfels(candidates: Candidates, options: SurfelOptions, seed: int) -> SurfelNode:
    """Choose, order and colour the surfels of a node.

    Raises
    ------
    InputError
        No candidates, or some that are not finite.
    """
    given = candidates.points
    order = _order(candidates, options, seed)
    surfels = given.chosen(order.picks)
    coarse: list[NDArray[np.uint8]] = []
    own = surfels.color
    if own is not None and given.color is not None and order.owner is not None:
        if options.colors == "mean":
            means, shares = mean_colors(given.color, order.owner, len(surfels))
            surfels = PointSet(surfels.points, surfels.normals, means, None)
            coarse = coarse_colors(surfels, shares, np.append(order.reach, order.rest))
        else:
            coarse = [own[:short] for short in coarse_counts(len(surfels))]
    return SurfelNode(
        surfels,
        coarse,
        measured_spacing(surfels.points, order, candidates.gap),
        order.rest + candidates.gap,
        candidates.items,
    )


def _order(candidates: Candidates, options: SurfelOptions, seed: int) -> SurfelOrder:
    points = candidates.points.points
    if options.order == "progressive":
        order = progressive_order(points, options.count, seed=seed)
        return nearest_owner(points, order)
    return exact_order(
        points,
        options.count,
        seed=seed,
        normals=candidates.points.normals,
        opposite=candidates.opposite,
    )
