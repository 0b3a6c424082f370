"""Matching samples of overlapping scans, and the overlap graph that says which overlap."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from workbench.geometry.neighbours import nearest, tree_of
from workbench.geometry.orientedscan import OrientedScan
from workbench.geometry.transforms import Matrix4, apply, inverse, rotate

# Matches whose normals differ more lie on different surfaces.
_MAX_NORMAL_ANGLE_DEG = 45.0


@dataclass(frozen=True)
class Matches:
    """Matched samples of two scans, all in the world frame.

    Attributes
    ----------
    source, target : indices of the scans.
    source_points, target_points, source_normals, target_normals : (m, 3) float64.
    queried : how many source samples were asked.
    """

    source: int
    target: int
    source_points: NDArray[np.float64]
    target_points: NDArray[np.float64]
    source_normals: NDArray[np.float64]
    target_normals: NDArray[np.float64]
    queried: int

    def __len__(self) -> int:
        return len(self.source_points)

    @property
    def overlap(self) -> float:
        """Matched share of the samples asked, in [0, 1]."""
        return len(self) / self.queried if self.queried else 0.0

    def plane_residuals(self) -> NDArray[np.float64]:
        """(m,) signed distance between the samples along their mean normal, metres.

        The mean normal makes the distance exact to second order on curved surfaces, where
        the distance to one tangent plane is biased (Rusinkiewicz 2019, symmetric ICP).
        """
        normal = self.mean_normals()
        gap = self.source_points - self.target_points
        return np.asarray(np.einsum("mi,mi->m", gap, normal))

    def mean_normals(self) -> NDArray[np.float64]:
        """(m, 3) unit bisectors of the matched normals."""
        total = self.source_normals + self.target_normals
        length: NDArray[np.float64] = np.linalg.norm(total, axis=1, keepdims=True)
        return total / length


class Matcher:
    """Finds closest samples between scans at given poses.

    Parameters
    ----------
    scans : oriented scans in their own frames.
    samples_per_scan : how many evenly picked samples of a scan ask for a match.
    """

    def __init__(self, scans: Sequence[OrientedScan], samples_per_scan: int) -> None:
        self.scans = scans
        # Trees stay in the scan's frame, so moving a scan costs nothing.
        self._trees = [tree_of(scan.points) for scan in scans]
        self._asking = [_evenly(len(scan), samples_per_scan) for scan in scans]

    def with_samples(self, samples_per_scan: int) -> Matcher:
        """The same scans and trees with another number of asking samples."""
        other = object.__new__(Matcher)
        other.scans, other._trees = self.scans, self._trees
        other._asking = [_evenly(len(scan), samples_per_scan) for scan in self.scans]
        return other

    def asking_points(self, scan: int) -> NDArray[np.float64]:
        """(m, 3) the samples of a scan that ask for matches, in its own frame."""
        return self.scans[scan].points[self._asking[scan]]

    def match(
        self,
        source: int,
        target: int,
        poses: Sequence[Matrix4] | Mapping[int, Matrix4],
        max_distance_m: float,
    ) -> Matches:
        """Samples of ``source`` with their closest sample of ``target``.

        A match is refused beyond ``max_distance_m``, on the target's border (the true
        partner may lie past it) and where the normals disagree.
        """
        asking, goal = self._asking[source], self.scans[target]
        target_from_source = inverse(poses[target]) @ poses[source]
        points = apply(target_from_source, self.scans[source].points[asking])
        normals = rotate(target_from_source, self.scans[source].normals[asking])
        distance, index = nearest(self._trees[target], points, max_distance_m)
        hit = np.flatnonzero(np.isfinite(distance))
        found = index[hit]
        agree = np.einsum("mi,mi->m", normals[hit], goal.normals[found])
        good = ~goal.border[found] & (agree > np.cos(np.radians(_MAX_NORMAL_ANGLE_DEG)))
        hit, found = hit[good], found[good]
        return Matches(
            source,
            target,
            apply(poses[target], points[hit]),
            apply(poses[target], goal.points[found]),
            rotate(poses[target], normals[hit]),
            rotate(poses[target], goal.normals[found]),
            len(asking),
        )


@dataclass(frozen=True)
class OverlapGraph:
    """Which scans overlap.

    Attributes
    ----------
    fraction : (n, n) float64; row i, column j: matched share of scan i's samples in scan j.
    pairs : (i, j) with i < j that overlap enough.
    component : (n,) int, the connected component each scan belongs to.
    """

    fraction: NDArray[np.float64]
    pairs: tuple[tuple[int, int], ...]
    component: NDArray[np.int32]

    @property
    def connected(self) -> bool:
        return int(self.component.max(initial=0)) == 0


def overlap_graph(
    matcher: Matcher, poses: Sequence[Matrix4], max_distance_m: float, min_overlap: float
) -> OverlapGraph:
    """Ask every pair of scans whose boxes come near each other how much they share."""
    n = len(matcher.scans)
    boxes = [_box(scan, pose) for scan, pose in zip(matcher.scans, poses, strict=True)]
    fraction = np.zeros((n, n))
    pairs = []
    for i in range(n):
        for j in range(i + 1, n):
            low = np.maximum(boxes[i][0], boxes[j][0])
            high = np.minimum(boxes[i][1], boxes[j][1])
            if (low > high + max_distance_m).any():
                continue
            fraction[i, j] = matcher.match(i, j, poses, max_distance_m).overlap
            fraction[j, i] = matcher.match(j, i, poses, max_distance_m).overlap
            if max(fraction[i, j], fraction[j, i]) >= min_overlap:
                pairs.append((i, j))
    if pairs:
        rows, columns = np.array(pairs).T
    else:
        rows, columns = np.zeros((2, 0), int)
    links = coo_array((np.ones(len(rows)), (rows, columns)), shape=(n, n))
    _, component = connected_components(links, directed=False)
    return OverlapGraph(fraction, tuple(pairs), component.astype(np.int32))


def _evenly(n: int, wanted: int) -> NDArray[np.int64]:
    """At most ``wanted`` indices spread evenly over 0 … n − 1."""
    return np.unique(np.linspace(0, max(n - 1, 0), min(n, wanted)).round().astype(np.int64))


def _box(scan: OrientedScan, pose: Matrix4) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    if not len(scan):
        return np.full(3, np.inf), np.full(3, -np.inf)
    points = apply(pose, scan.points)
    return points.min(axis=0), points.max(axis=0)
