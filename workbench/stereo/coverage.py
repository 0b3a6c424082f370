"""How much of what photographs show was scanned: which of them there is a use for."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.geometry.filling_box import filling_box
from workbench.geometry.neighbours import k_nearest, nearest, tree_of
from workbench.geometry.regions import Box
from workbench.stereo.choice import SeenPoints

# So many samples of a scan tell where it has any.
_PER_SCAN = 200_000
# In distances of samples: what is nearer was scanned; what is farther lies on another surface.
_NEAR, _BESIDE = 4.0, 20.0
# Points scatter: so many times as far as half of them lie from the scans still is on them.
_SCATTER = 4.0
_FEWEST_POINTS = 30


@dataclass(frozen=True)
class ScannedPlaces:
    """Where scans have samples.

    Attributes
    ----------
    tree : of samples, metres.
    apart_m : typical distance between neighbouring ones.
    box : within which something may have been missed.
    """

    tree: cKDTree
    apart_m: float
    box: Box

    @classmethod
    def of(cls, scans: Iterable[NDArray[np.float64]]) -> ScannedPlaces | None:
        """Of the points (n, 3) of every scan in one frame; None where there are none."""
        parts, apart = [], []
        rng = np.random.default_rng(0)
        for points in scans:
            if len(points) < 2:
                continue
            few = points[np.sort(rng.permutation(len(points))[:_PER_SCAN])]
            parts.append(few)
            apart.append(float(np.median(k_nearest(tree_of(few), few, 2)[0][:, 1])))
        if not parts:
            return None
        every = np.concatenate(parts)
        box = filling_box(every.min(axis=0), every.max(axis=0))
        return cls(tree_of(every), float(np.median(apart)), box)

    def hold(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Which points (n, 3) were scanned: near a sample, or no farther than most scatter."""
        distance, _ = nearest(self.tree, points)
        beside = distance[distance <= _BESIDE * self.apart_m]
        scatter = float(np.median(beside)) if len(beside) else 0.0
        return np.asarray(distance <= max(_NEAR * self.apart_m, _SCATTER * scatter))


def held_shares(seen: SeenPoints, scanned: ScannedPlaces | None) -> dict[str, float | None]:
    """By photograph, the share of its points that scans hold; None where too few tell.

    Points are those that photographs share: they lie on the object in space, so that something
    before or behind what was scanned is not taken for scanned. Those beyond what was scanned do
    not count.
    """
    if scanned is None:
        return dict.fromkeys(seen.names)
    around = scanned.box.contains(seen.points)
    points, by_photo = seen.points[around], seen.seen[around]
    held = scanned.hold(points)
    shares: dict[str, float | None] = {}
    for number, name in enumerate(seen.names):
        own = held[by_photo[:, number]]
        shares[name] = float(own.mean()) if len(own) >= _FEWEST_POINTS else None
    return shares
