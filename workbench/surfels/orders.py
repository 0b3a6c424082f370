"""Orders of points in which every prefix is spread over all of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.kernels.surfel_greedy import farthest_first
from workbench.kernels.surfel_rounds import farthest_of_rounds


@dataclass(frozen=True)
class SurfelOrder:
    """A choice of points in the order in which they are to be shown.

    Attributes
    ----------
    picks : (k,) int64 rows of the points.
    reach : (k,) float64 distance of each to the nearest before it when it was taken, infinite
        for the first. In the exact order no point at all is farther than ``reach[i]`` from
        the first i: discs of that radius cover everything.
    rest : the same for all k: no point is farther than this from the nearest pick; NaN where
        the order does not tell.
    owner : (n,) int32 for each point the place in the order of the pick nearest to it, or None.
    """

    picks: NDArray[np.int64]
    reach: NDArray[np.float64]
    rest: float = float("nan")
    owner: NDArray[np.int32] | None = None

    def __len__(self) -> int:
        return len(self.picks)


@dataclass(frozen=True)
class RoundOptions:
    """How the progressive order draws (Brandt 2019, 3.2).

    Attributes
    ----------
    subset : points drawn in each round.
    grow_every : rounds after which one point more is taken of each.
    near : points of a subset leave when they are nearer to those taken than this share of the
        spacing expected at the end; 0 keeps them.
    """

    subset: int = 200
    grow_every: int = 500
    near: float = 0.5


def exact_order(
    points: NDArray[np.float64],
    count: int,
    *,
    seed: int = 0,
    normals: NDArray[np.float32] | None = None,
    opposite: float = 0.0,
) -> SurfelOrder:
    """The greedy permutation: each point is the farthest of all from those before it.

    Parameters
    ----------
    points
        (n, 3) finite.
    count
        How many to take; fewer come when the rest are copies of those taken.
    seed
        Chooses the first point.
    normals
        (n, 3) unit, for ``opposite``.
    opposite
        Distance between points of one place whose normals are opposite, in the unit of the
        points: what lies straight through a thin wall is far, as it is by the way round the edge
        of the wall. As soon as the spacing is below this, both sides have points of their own.
        Normals up to a right angle apart change nothing.

    Raises
    ------
    InputError
        No points, or some that are not finite.
    SettingsError
        A count below 1, or a distance that is negative or not finite.
    """
    _check(points, count)
    if not (opposite >= 0.0 and np.isfinite(opposite)):
        raise SettingsError(
            "The distance of opposite sides makes no sense.",
            expected="0 or more",
            found=str(opposite),
            fix="Leave it at 0, or give a share of the object's size.",
        )
    first = int(np.random.default_rng(seed).integers(len(points)))
    rows = np.ascontiguousarray(points, np.float64)
    picks, reach, owner = farthest_first(rows, count, first, normals, opposite)
    return SurfelOrder(picks, reach[:-1], float(reach[-1]), owner)


def progressive_order(
    points: NDArray[np.float64],
    count: int,
    *,
    seed: int = 0,
    options: RoundOptions | None = None,
) -> SurfelOrder:
    """The published approximation: the farthest few of each random subset.

    Kept to compare with: `exact_order` is better and takes less time.

    Parameters and errors are those of `exact_order`.
    """
    _check(points, count)
    chosen = options or RoundOptions()
    if chosen.subset < 1 or chosen.grow_every < 1 or not 0.0 <= chosen.near < 1.0:
        raise SettingsError(
            "Rounds cannot be drawn so.",
            expected="a subset and a step of 1 or more, near from 0 to below 1",
            found=f"{chosen.subset}, {chosen.grow_every}, {chosen.near}",
            fix="Leave them at 200, 500 and 0.5.",
        )
    middle = 0.5 * (points.min(axis=0) + points.max(axis=0))
    word = int(np.random.default_rng(seed).integers(1 << 62))
    rounds = (chosen.subset, chosen.grow_every, chosen.near)
    return SurfelOrder(*farthest_of_rounds(points - middle, count, *rounds, word))


def random_order(points: NDArray[np.float64], count: int, *, seed: int = 0) -> SurfelOrder:
    """Points in no order, to compare with; ``reach`` is not known and NaN."""
    _check(points, count)
    picks = np.random.default_rng(seed).permutation(len(points))[:count]
    return SurfelOrder(picks.astype(np.int64), np.full(len(picks), np.nan))


def _check(points: NDArray[np.float64], count: int) -> None:
    if not len(points) or not np.isfinite(points).all():
        raise InputError(
            "There is nothing to choose surfels from.",
            expected="points, all finite",
            found=f"{int((~np.isfinite(points)).any(axis=-1).sum())} of {len(points)} not finite",
            fix="Check the file; the program that wrote it may have marked holes so.",
        )
    if count < 1:
        raise SettingsError(
            "So few surfels show nothing.", expected="1 or more", found=str(count), fix="Take more."
        )
