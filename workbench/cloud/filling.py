"""What photographs saw and scans missed: samples that lie on no scanned surface."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.cloud.sample_source import SampleSource
from workbench.geometry.filling_box import filling_box
from workbench.geometry.neighbours import k_nearest, tree_of
from workbench.geometry.regions import Box
from workbench.geometry.robust import robust_sigma
from workbench.geometry.samples import Samples

# Of so many nearest samples one does not face away where there is such a surface at all.
_NEIGHBOURS = 8
_LEAST_COSINE = 0.0
# In distances of samples: nearer was scanned; within the farther a map tells how far off it is.
_NEAR, _BESIDE = 3.0, 12.0
_SCATTER = 3.0
# Fewer tell nothing about how far off a map is.
_FEWEST = 100


@dataclass(frozen=True)
class Missed:
    """What scans missed of one photograph's depths.

    Attributes
    ----------
    samples : those that fill.
    given, scanned, beyond : how many there were, lie on a scanned surface, and lie too far off
        to be of the object.
    offset_m, scatter_m : where both measured, the median of how far the depths lie before
        (positive) or behind the scanned surface, and the robust standard deviation; NaN where too
        little was measured by both.
    """

    samples: Samples
    given: int
    scanned: int
    beyond: int
    offset_m: float
    scatter_m: float


@dataclass(frozen=True)
class ScannedSurface:
    """The samples of all scans, to be asked what else they hold.

    Attributes
    ----------
    tree, normals : of the samples, in the project frame.
    apart_m : typical distance between neighbouring ones.
    box : that is filled.
    """

    tree: cKDTree
    normals: NDArray[np.float64]
    apart_m: float
    box: Box

    @classmethod
    def of(cls, source: SampleSource, apart_m: float, most: int) -> ScannedSurface:
        """Of consolidated samples ``apart_m`` apart; no more than ``most`` are held."""
        few = source.thinned(most)
        apart_m *= float(np.sqrt(len(source) / len(few)))
        return cls(tree_of(few.points), few.normals, apart_m, filling_box(*source.bounds))

    def missed(self, samples: Samples) -> Missed:
        """Which of a photograph's samples, in the project frame, lie on no scanned surface.

        A sample is scanned where the closest scanned sample that does not face away from it (the
        far side of a thin wall does) is hardly further to the side than samples are apart, and
        before or behind by that and by how far depths are off at most: their median and three
        standard deviations where both measured, for cameras may be a little off.
        """
        inside = self.box.contains(samples.points)
        held = samples.chosen(inside)
        beside, offset = self._from_surface(held)
        across = beside <= _NEAR * self.apart_m
        off = offset[across & (np.abs(offset) <= _BESIDE * self.apart_m)]
        middle = scatter = float("nan")
        near = _NEAR * self.apart_m
        if len(off) >= _FEWEST:
            middle = float(np.median(off))
            scatter = robust_sigma(off - middle)
            near += abs(middle) + _SCATTER * scatter
        near = min(near, _BESIDE * self.apart_m)
        missing = ~(across & (np.abs(offset) <= near))
        return Missed(
            held.chosen(missing),
            len(samples),
            int((~missing).sum()),
            int((~inside).sum()),
            middle,
            scatter,
        )

    def _from_surface(self, samples: Samples) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """How far (n,) beside and before the closest scanned sample that does not face away.

        Infinitely far beside where none does.
        """
        n = len(samples)
        if not n:
            return np.zeros(0), np.zeros(0)
        distance, index = k_nearest(self.tree, samples.points, min(_NEIGHBOURS, self.tree.n))
        facing = np.einsum("ni,nki->nk", samples.normals, self.normals[index]) >= _LEAST_COSINE
        closest = np.where(facing, distance, np.inf).argmin(axis=1)
        chosen = index[np.arange(n), closest]
        between = samples.points - np.asarray(self.tree.data)[chosen]
        offset = np.einsum("ni,ni->n", between, self.normals[chosen])
        beside = np.linalg.norm(between - offset[:, None] * self.normals[chosen], axis=1)
        return np.where(facing[np.arange(n), closest], beside, np.inf), offset
