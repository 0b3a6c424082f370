"""How far surfels of a prefix are apart, and which prefix covers an object."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.errors import InputError
from workbench.geometry.neighbours import k_nearest, nearest
from workbench.surfels.orders import SurfelOrder, exact_order, progressive_order, random_order

FIRST_PREFIX = 1000


@dataclass(frozen=True)
class Spacing:
    """The two numbers by which a renderer chooses a prefix (Brandt 2019, 4.1).

    Attributes
    ----------
    prefix : p_m, surfels of the prefix that was measured.
    distance : r_m, the median distance of its surfels to their nearest, or how far the surface
        is from them at most, where that is more; in the unit of the surfels.
    """

    prefix: int
    distance: float

    def prefix_for(self, radius: float) -> int:
        """The prefix whose discs of ``radius`` cover the object: p_m (r_m / r)², at least 1.

        It may be more than there are surfels: then these do not suffice for discs so small.

        >>> Spacing(1000, 0.02).prefix_for(0.01)
        4000
        """
        if not radius > 0.0:
            raise InputError("discs need a radius", expected="above 0", found=str(radius))
        share = self.distance / radius
        # A radius of `radius_for` gives its prefix back, whatever rounding does.
        return max(1, math.ceil(min(self.prefix * share * share, 2.0**62) - 0.001))

    def radius_for(self, prefix: int) -> float:
        """The radius at which discs of ``prefix`` surfels cover the object."""
        return self.distance * math.sqrt(self.prefix / max(prefix, 1))


def measured_spacing(points: NDArray[np.float64], order: SurfelOrder, gap: float) -> Spacing:
    """The spacing of surfels in order that serves all their prefixes.

    One prefix's numbers hold for all where the surface is smooth. Where finer surfels find more
    surface, as in folds, larger prefixes need more: of the prefixes 1000, 2000, 4000 … and all,
    that is taken which asks for most surfels.

    Parameters
    ----------
    points
        (k, 3) surfels in their order.
    order
        Where they come from; it tells its distances.
    gap
        How far the surface is from the points they were chosen from, at most.
    """
    prefixes, prefix = [len(order)], FIRST_PREFIX
    while prefix < len(order):
        prefixes.append(prefix)
        prefix *= 2
    reach = np.append(order.reach, order.rest)
    found = []
    for prefix in prefixes:
        apart = nearest_distances(points[:prefix])
        median = float(np.median(apart)) if len(apart) > 1 else 0.0
        found.append(Spacing(prefix, max(median, float(reach[prefix]) + gap)))
    return max(found, key=lambda spacing: spacing.prefix * spacing.distance**2)


def nearest_owner(points: NDArray[np.float64], order: SurfelOrder) -> SurfelOrder:
    """An order that does not tell which pick is nearest to each point (n, 3), and how far."""
    middle = points[order.picks].mean(axis=0)
    apart, owner = nearest(cKDTree(points[order.picks] - middle), points - middle)
    return SurfelOrder(order.picks, order.reach, float(apart.max()), owner.astype(np.int32))


def nearest_distances(points: NDArray[np.float64]) -> NDArray[np.float64]:
    """(n,) distance of each point to its nearest other one; infinite for a point alone."""
    if len(points) < 2:
        return np.full(len(points), np.inf)
    return k_nearest(cKDTree(points - points[0]), points - points[0], 2)[0][:, 1]


def spacing_distributions(
    points: NDArray[np.float64],
    prefixes: Iterable[int] = (1000, 5000, 10_000),
    *,
    seed: int = 0,
    normals: NDArray[np.float32] | None = None,
    opposite: float = 0.0,
) -> dict[str, dict[int, NDArray[np.float64]]]:
    """Distances of surfels to their nearest for each order and prefix (Brandt 2019, figure 3).

    Parameters
    ----------
    points
        (n, 3) candidates, more than the longest prefix.
    prefixes
        To measure.
    seed
        Of every order.
    normals, opposite
        As in ``exact_order``; with normals there is a fourth order, ``both sides``.

    Returns
    -------
    ``random``, ``progressive``, ``exact`` and ``both sides`` to prefix to distances (prefix,),
    relative to the diagonal of the points' bounds.
    """
    lengths = sorted(prefixes)
    orders = {
        "random": random_order(points, lengths[-1], seed=seed),
        "progressive": progressive_order(points, lengths[-1], seed=seed),
        "exact": exact_order(points, lengths[-1], seed=seed),
    }
    if normals is not None:
        orders["both sides"] = exact_order(
            points, lengths[-1], seed=seed, normals=normals, opposite=opposite
        )
    size = float(np.linalg.norm(np.ptp(points, axis=0)))
    return {
        name: {prefix: nearest_distances(points[order.picks[:prefix]]) / size for prefix in lengths}
        for name, order in orders.items()
    }
