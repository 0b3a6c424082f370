"""Samples of a scan with normals: what registration and fusion start from."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import (
    breadth_first_order,
    connected_components,
    minimum_spanning_tree,
)

from workbench.errors import InputError
from workbench.geometry.neighbours import k_nearest, tree_of
from workbench.geometry.rangemap import RangeMap
from workbench.kernels.plane_fit import grid_planes, grid_spacing

_TANGENT_NEIGHBOURS = 12


@dataclass(frozen=True)
class OrientedScan:
    """Trusted samples of one range map, in the scan's frame.

    Attributes
    ----------
    points : (n, 3) float64, metres.
    normals : (n, 3) float64, unit, towards the scanner.
    spacing_m : (n,) float64, distance to the next sample on the surface.
    reach_m : (n,) float64, how far the surface around a sample is covered by it: the coarser
        of its two sample distances.
    incidence_cos : (n,) float64 in (0, 1], cosine between normal and line of sight; 1 where
        the scanner's place is unknown.
    roughness_m : (n,) float64, RMS distance of the neighbourhood to its plane.
    border : (n,) bool, next to a hole, a depth step or the edge of the scan.
    source : (n,) int64, index into the range map's samples.
    """

    points: NDArray[np.float64]
    normals: NDArray[np.float64]
    spacing_m: NDArray[np.float64]
    reach_m: NDArray[np.float64]
    incidence_cos: NDArray[np.float64]
    roughness_m: NDArray[np.float64]
    border: NDArray[np.bool_]
    source: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.points)

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> OrientedScan:
        """The samples at ``index``, in that order."""
        return OrientedScan(
            **{name: getattr(self, name)[index] for name in self.__dataclass_fields__}
        )

    def check(self, name: str) -> None:
        """Raise `InputError` unless all places and normals are finite; ``name`` is the scan's."""
        sound = np.isfinite(self.points).all(axis=1) & np.isfinite(self.normals).all(axis=1)
        if not sound.all():
            raise InputError(
                f"the samples of {name} cannot be registered",
                where=f"sample {int(np.argmin(sound))}",
                expected="finite places and normals",
                found=f"{int((~sound).sum())} without",
                fix="leave such samples out",
            )

    def thinned(self, most: int) -> OrientedScan:
        """At most ``most`` samples, an even choice that is the same each time.

        Those left lie further apart, and each speaks for as much more of the surface.
        """
        if len(self) <= most:
            return self
        chosen = np.random.default_rng(0).choice(len(self), most, replace=False)
        apart = np.sqrt(len(self) / most)
        few = self.take(np.sort(chosen))
        return replace(few, spacing_m=few.spacing_m * apart, reach_m=few.reach_m * apart)


@dataclass(frozen=True)
class OrientationSettings:
    """How samples are judged.

    Attributes
    ----------
    half_window : half width of the plane-fit window on the grid, cells.
    step_factor : a grid neighbour further away than this many sample spacings (per cell) is
        across a depth step.
    min_neighbours : samples with fewer neighbours on their surface are isolated returns.
    max_incidence_deg : samples seen more obliquely than this are dropped.
    border_erosion : rings of samples dropped along depth steps, where the beam straddles
        two surfaces (mixed pixels).
    """

    half_window: int = 2
    step_factor: float = 4.0
    min_neighbours: int = 6
    max_incidence_deg: float = 80.0
    border_erosion: int = 1


def orient(scan: RangeMap, settings: OrientationSettings) -> OrientedScan:
    """Normals, spacing and trust of a range map; untrusted samples are left out.

    Returns
    -------
    The trusted samples; possibly none. Mixed pixels at silhouettes, isolated returns and
    grazing samples are gone.
    """
    grid = scan.grid
    if grid is None:
        return _orient_cloud(scan, settings)
    alive = np.ones(len(scan), bool)
    for ring in range(settings.border_erosion + 1):
        spacing, reach, normals, residual, neighbours, missing = _fit(scan, grid, settings)
        trusted = alive & (neighbours >= settings.min_neighbours) & (normals != 0).any(axis=1)
        if ring == settings.border_erosion:
            break
        # A step, not a mere hole: dropouts inside a surface do not make its rim suspect.
        alive = trusted & ~_beside_step(scan.points_in_scan, grid, spacing, settings)
        # One more at the end, for the cells without a sample.
        grid = np.where(np.append(alive, False)[grid], grid, -1).astype(np.int32)
    normals, cosine = _towards_viewpoint(scan, normals)
    trusted &= cosine >= np.cos(np.radians(settings.max_incidence_deg))
    index = np.flatnonzero(trusted)
    return OrientedScan(
        scan.points_in_scan[index],
        normals[index],
        spacing[index],
        reach[index],
        cosine[index],
        residual[index],
        missing[index] > 0,
        index,
    )


def _fit(
    scan: RangeMap, grid: NDArray[np.int32], settings: OrientationSettings
) -> tuple[NDArray[np.float64], ...]:
    nearest, fourth = grid_spacing(scan.points_in_scan, grid)
    finite = nearest[np.isfinite(nearest)]
    typical = float(np.median(finite)) if len(finite) else 0.0
    # The nearest neighbour alone jumps with noise; no sample is finer than half the typical.
    spacing = np.where(np.isfinite(nearest), np.maximum(nearest, 0.5 * typical), typical)
    fit = grid_planes(
        scan.points_in_scan, grid, settings.half_window, settings.step_factor * spacing
    )
    # The fourth neighbour may lie across a step, and a sample seen obliquely is stretched far
    # along the sight: neither is evidence for the surface between.
    reach = np.clip(np.where(np.isfinite(fourth), fourth, spacing), spacing, 1.5 * spacing)
    return (spacing, reach, *fit)


def _beside_step(
    points: NDArray[np.float64],
    grid: NDArray[np.int32],
    spacing: NDArray[np.float64],
    settings: OrientationSettings,
) -> NDArray[np.bool_]:
    """Samples with a direct grid neighbour (row or column) across a depth step."""
    beside = np.zeros(len(points), bool)
    for a, b in ((grid[:-1], grid[1:]), (grid[:, :-1], grid[:, 1:])):
        both = (a >= 0) & (b >= 0)
        i, j = a[both], b[both]
        gap = np.linalg.norm(points[i] - points[j], axis=1)
        step = gap > settings.step_factor * np.minimum(spacing[i], spacing[j])
        beside[i[step]] = True
        beside[j[step]] = True
    return beside


def _orient_cloud(scan: RangeMap, settings: OrientationSettings) -> OrientedScan:
    """The same for samples without a grid: neighbours by distance."""
    points, k = scan.points_in_scan, 12
    if len(points) <= k:
        none = np.zeros(0, np.int64)
        return OrientedScan(
            points[none], points[none], *(np.zeros(0),) * 4, np.zeros(0, bool), none
        )
    distance, neighbour = k_nearest(tree_of(points), points, k + 1)
    offsets = points[neighbour] - points[:, None]
    centred = offsets - offsets.mean(axis=1, keepdims=True)
    covariance = np.einsum("nki,nkj->nij", centred, centred) / (k + 1)
    values, vectors = np.linalg.eigh(covariance)
    spacing = distance[:, 1:5].mean(axis=1)
    typical = float(np.median(spacing))
    flat = values[:, 1] > 1e-12 * values[:, 2]
    isolated = spacing > settings.step_factor * typical
    normals = vectors[:, :, 0]
    if scan.viewpoint_in_scan is None:
        normals, cosine = _consistent(points, normals), np.ones(len(points))
    else:
        normals, cosine = _towards_viewpoint(scan, normals)
    # The rim of a surface has its neighbours on one side: in half a disc their middle lies
    # 4 / 3π of the radius away.
    border = np.linalg.norm(offsets.mean(axis=1), axis=1) > 0.3 * distance[:, -1]
    keep = flat & ~isolated & (cosine >= np.cos(np.radians(settings.max_incidence_deg)))
    index = np.flatnonzero(keep)
    return OrientedScan(
        points[index],
        normals[index],
        spacing[index],
        distance[index, 6],
        cosine[index],
        np.sqrt(np.maximum(values[index, 0], 0.0)),
        border[index],
        index,
    )


def _towards_viewpoint(
    scan: RangeMap, normals: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Normals turned to the scanner and the cosine to the line of sight."""
    if scan.viewpoint_in_scan is None:
        return _consistent(scan.points_in_scan, normals), np.ones(len(normals))
    sight = scan.viewpoint_in_scan - scan.points_in_scan
    length = np.linalg.norm(sight, axis=1)
    cosine = np.einsum("ni,ni->n", normals, sight) / np.where(length > 0, length, 1.0)
    return np.where(cosine[:, None] < 0, -normals, normals), np.abs(cosine)


def _consistent(points: NDArray[np.float64], normals: NDArray[np.float64]) -> NDArray[np.float64]:
    """Normals made consistent with each other where nobody knows where the scanner stood."""
    import open3d as o3d

    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(points - points.mean(axis=0)))
    cloud.normals = o3d.utility.Vector3dVector(normals)
    try:
        cloud.orient_normals_consistent_tangent_plane(_TANGENT_NEIGHBOURS)
    except RuntimeError:
        # Its triangulation of space fails for samples in one plane or at one place.
        return _consistent_with_neighbours(points, normals)
    return np.asarray(cloud.normals).copy()


def _consistent_with_neighbours(
    points: NDArray[np.float64], normals: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Signs carried along the tree of least turns among neighbours (Hoppe et al. 1992, 3.3).

    Of every part that hangs together, the uppermost sample faces up.
    """
    n = len(points)
    _, near = k_nearest(tree_of(points), points, min(_TANGENT_NEIGHBOURS, n - 1) + 1)
    start, end = np.repeat(np.arange(n), near.shape[1]), near.ravel()
    turn = 1.0 - np.abs(np.einsum("ei,ei->e", normals[start], normals[end]))
    # A weight of 0 would be no edge; two samples at one place are the nearest of neighbours.
    kept = start != end
    links = coo_array((np.maximum(turn[kept], 0.0) + 1e-9, (start[kept], end[kept])), shape=(n, n))
    # An edge told from both ends is one edge of that weight, not of twice.
    least = minimum_spanning_tree(links.tocsr().maximum(links.T.tocsr())).tocoo()
    _, part = connected_components(least, directed=False)
    roots = _uppermost(points[:, 2], part)
    # One more sample, beside all roots, makes one tree of them, walked at once.
    tree = coo_array(
        (
            np.ones(len(least.row) + len(roots)),
            (np.append(least.row, roots), np.append(least.col, np.full(len(roots), n))),
        ),
        shape=(n + 1, n + 1),
    )
    parent = breadth_first_order(tree.tocsr(), n, directed=False)[1][:n].astype(np.int64)
    parent[roots] = roots
    sign = np.where(normals[:, 2] < 0.0, -1.0, 1.0)
    inner = parent != np.arange(n)
    along = np.einsum("ni,ni->n", normals[inner], normals[parent[inner]])
    sign[inner] = np.where(along < 0.0, -1.0, 1.0)
    # Every round doubles how far up its tree a sample has looked.
    while (parent != parent[parent]).any():
        sign, parent = np.where(parent == parent[parent], sign, sign * sign[parent]), parent[parent]
    sign[inner] *= sign[parent[inner]]
    return np.asarray(normals * sign[:, None])


def _uppermost(heights: NDArray[np.float64], part: NDArray[np.integer]) -> NDArray[np.int64]:
    """The highest sample of every part, the first among equals."""
    order = np.lexsort((-heights, part))
    return np.asarray(order[np.flatnonzero(np.diff(part[order], prepend=-1))], np.int64)
