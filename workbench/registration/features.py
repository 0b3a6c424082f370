"""Local shape descriptors of scans, to find the same place in two of them.

Fast point feature histograms (Rusu, Blodow and Beetz 2009) on an evenly thinned scan: they
do not change under rigid motion and need nothing but points and normals.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.orientedscan import OrientedScan

# Radius of a histogram over the distance of keypoints (Open3D's tutorial: 5).
_RADIUS_FACTOR = 6.0
_NEIGHBOURS = 150
_MOST_CELLS = 2.0**62


@dataclass(frozen=True)
class Keypoints:
    """Evenly spread places of one scan and what the surface looks like around each.

    Attributes
    ----------
    points : (k, 3) float64, metres, in the scan's frame.
    normals : (k, 3) float64, unit.
    descriptors : (k, 33) float32.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    descriptors: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.points)


def keypoint_distance_m(scans: Sequence[OrientedScan], keypoints: int) -> float:
    """The distance at which a scan of median size has about ``keypoints`` of them.

    It is the same for all scans, for descriptors to be alike, and no less than two sample
    distances. Scans without samples do not count; 0 when all are empty.
    """
    areas = [_area_m2(scan) for scan in scans if len(scan)]
    spacing = [float(np.median(scan.spacing_m)) for scan in scans if len(scan)]
    if not areas:
        return 0.0
    return max(float(np.sqrt(np.median(areas) / keypoints)), 2.0 * float(np.median(spacing)))


def describe(scan: OrientedScan, distance_m: float, limit: int | None = None) -> Keypoints:
    """Keypoints of a scan about ``distance_m`` apart, with their histograms.

    Parameters
    ----------
    limit : keypoints at most, evenly picked; their histograms still count all neighbours.
    """
    import open3d as o3d

    points, normals = thinned(scan, distance_m)
    if not len(points):
        return Keypoints(points, normals, np.zeros((0, 33), np.float32))
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points - points.mean(axis=0)))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    search = o3d.geometry.KDTreeSearchParamHybrid(_RADIUS_FACTOR * distance_m, _NEIGHBOURS)
    found = o3d.pipelines.registration.compute_fpfh_feature(cloud, search)  # type: ignore[call-arg]
    descriptors = np.asarray(found.data, np.float32).T.reshape(len(points), -1)
    kept = np.arange(len(points))
    if limit is not None and len(points) > limit:
        kept = np.linspace(0, len(points) - 1, limit).astype(np.int64)
    # Roots make the Euclidean distance Hellinger's, which suits histograms better.
    return Keypoints(points[kept], normals[kept], np.sqrt(descriptors[kept]))


def thinned(scan: OrientedScan, cell_m: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Mean point and mean unit normal of every cubic cell that holds samples, (k, 3) each."""
    if not len(scan):
        return scan.points, scan.normals
    low = scan.points.min(axis=0)
    cell = np.floor((scan.points - low) / cell_m).astype(np.int64)
    shape = cell.max(axis=0) + 1
    key = (cell[:, 0] * shape[1] + cell[:, 1]) * shape[2] + cell[:, 2]
    if float(np.prod(shape.astype(float))) > _MOST_CELLS:
        # One sample far away makes more cells than can be numbered; those in use never are.
        key = np.unique(cell, axis=0, return_inverse=True)[1].ravel()
    _, owner, count = np.unique(key, return_inverse=True, return_counts=True)
    points = np.stack([np.bincount(owner, scan.points[:, a] - low[a]) for a in range(3)], axis=1)
    normals = np.stack([np.bincount(owner, scan.normals[:, a]) for a in range(3)], axis=1)
    length = np.linalg.norm(normals, axis=1)
    # Both sides of a thin wall cancel out: what is left points nowhere.
    clear = length > 0.5 * count
    mean = low + points[clear] / count[clear, None]
    return mean, normals[clear] / length[clear, None]


def _area_m2(scan: OrientedScan) -> float:
    return float(np.sum(scan.spacing_m * scan.reach_m))
