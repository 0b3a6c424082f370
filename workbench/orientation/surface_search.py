"""Where a sparse model of unknown scale fits a surface, by shape alone.

Rotations are tried evenly over all there are, and a few scales, against a field of distances;
the best are settled by trimmed similarity ICP in both directions, for in one alone everything
fits once it is small enough. Buildings and furniture fit nearly as well turned by a half or a
quarter, and what tells is little, a portico say, which trimming takes for an outlier: such turns
of the best are settled too, and the one that misplaces fewest points wins. A shape that fits in
two ways is said to.

Source: rotations by Alexa 2022, "Super-Fibonacci spirals"; similarity ICP by Zinsser, Schmidt
and Niemann 2005, trimmed as by Chetverikov et al. 2005.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.geometry.similarity import Similarity, best_similarity
from workbench.geometry.surface_sampling import sample_surface
from workbench.orientation.sparse_points import SparsePoints

_ROTATIONS = 4000
_SCALES = (0.75, 0.84, 0.92, 1.0, 1.09, 1.19, 1.33)
_FIELD_CELLS = 64
_POINTS, _SURFACE_POINTS, _ASKED_BACK = 700, 12_000, 700
# Steps of the search: how many go on, after how many rounds of ICP.
_STEPS = ((120, 4), (30, 12), (8, 40))
# Parts of the pairs that count: photographs see more than scans, or less.
_FORWARD_PART, _BACKWARD_PART = 0.9, 0.4
# Solutions turned less than this against each other are one.
_SAME_DEG = 12.0
_LEAST_LEAD = 1.25
_LEAST_POINTS = 30
# Of the surface's size: a fit coarser than this is none.
_WORST_FIT = 0.03
# Points are misplaced that lie further off than so many errors, or so much of the size; one
# solution misplaces fewer than another where chance would say so this many sigmas seldom.
_MISPLACED_ERRORS, _MISPLACED_SHARE = 3.0, 0.004
_COUNTED_POINTS = 4000
# Of the extent: points nearer to each other than that are one.
_FINEST_CELL = 1e-9
_SURE_SIGMAS = 4.0


@dataclass(frozen=True)
class ShapeFit:
    """A similarity found by shape.

    Attributes
    ----------
    surface_from_model : brings the sparse model onto the surface.
    error : trimmed root mean square distance both ways, in the surface's unit.
    lead : error of the best other solution, of those that misplace as few points, over this
        one's; infinite where there is none.
    """

    surface_from_model: Similarity
    error: float
    lead: float


@dataclass(frozen=True)
class NoShapeFit:
    """Why shape alone does not say where the model belongs; falsy."""

    reason: str

    def __bool__(self) -> bool:
        return False


def fit_by_shape(points: SparsePoints, surface: TriangleMesh) -> ShapeFit | NoShapeFit:
    """The similarity that brings a sparse model onto a surface, from nowhere.

    Parameters
    ----------
    points : of the model, mostly on what the surface shows; a tenth may be elsewhere.
    surface : in its own frame and unit; photographed from most sides, else no fit is claimed.
    """
    if len(points) < _LEAST_POINTS:
        return NoShapeFit(f"only {len(points)} reliable points, {_LEAST_POINTS} are needed")
    search = _Search(points, surface)
    found = search.coarse()
    for count, rounds in _STEPS:
        found = sorted((search.settled(x, rounds) for _, x in found[:count]), key=_error)
    if np.isfinite(found[0][0]):
        found += [search.settled(x, _STEPS[-1][1]) for x in search.turned(found[0][1])]
    reach = max(_MISPLACED_ERRORS * found[0][0], _MISPLACED_SHARE * search.size)
    misplaced = [search.misplaced(x, reach) for _, x in found]
    chosen = int(np.argmin(misplaced))
    if not _fewer(misplaced[chosen], misplaced[0], len(search.counted)):
        chosen = 0
    best_error, best = found[chosen]
    others = [
        error
        for (error, x), lost in zip(found, misplaced, strict=True)
        if _turn_deg(x, best) > _SAME_DEG
        and not _fewer(misplaced[chosen], lost, len(search.counted))
    ]
    lead = min(others, default=np.inf) / max(best_error, 1e-12 * search.size)
    if best_error > _WORST_FIT * search.size:
        return NoShapeFit(
            f"the best fit leaves {100 * best_error / search.size:.1f} % of the object's size"
        )
    if lead < _LEAST_LEAD:
        return NoShapeFit("the shape fits in more than one way")
    return ShapeFit(best, best_error, float(lead))


def _fewer(share: float, other: float, count: int) -> bool:
    """Whether one share of so many is smaller than another, beyond chance."""
    spread = (share * (1.0 - share) + other * (1.0 - other)) / count
    return other - share > _SURE_SIGMAS * float(np.sqrt(spread + 1.0 / count**2))


def _error(candidate: tuple[float, Similarity]) -> float:
    return candidate[0]


def _turn_deg(one: Similarity, other: Similarity) -> float:
    turn = Rotation.from_matrix(one.rotation @ other.rotation.T)
    return float(np.degrees(turn.magnitude()))


class _Search:
    def __init__(self, points: SparsePoints, surface: TriangleMesh) -> None:
        self.counted = points.chosen(_thinned(points.points, _COUNTED_POINTS))
        kept = points.chosen(_thinned(points.points, _POINTS))
        self.points, self.outward = kept.points, kept.outward
        self.surface, triangles, _ = sample_surface(surface, _SURFACE_POINTS, seed=0)
        self.normals = face_normals_and_areas(surface)[0][triangles]
        self.middle = np.median(self.surface, axis=0)
        self.size = 2.0 * float(np.sqrt(((self.surface - self.middle) ** 2).sum(1).mean()))
        self.tree, self.model_tree = cKDTree(self.surface), cKDTree(self.points)
        pick = np.linspace(0, len(self.surface) - 1, _ASKED_BACK).astype(int)
        self.asked = self.surface[pick]
        self.asked_normals = self.normals[pick]

    def coarse(self) -> list[tuple[float, Similarity]]:
        """Every rotation and scale about the middles, the best by the field of distances first."""
        low, cell, field = self._distance_field()
        middle = np.median(self.points, axis=0)
        centred = self.points - middle
        spread = 2.0 * float(np.sqrt(np.median((centred**2).sum(axis=1))))
        size = 2.0 * float(np.sqrt(np.median(((self.surface - self.middle) ** 2).sum(axis=1))))
        last = np.array(field.shape) - 1
        found = []
        for rotation in even_rotations(_ROTATIONS):
            turned = centred @ rotation.T
            for factor in _SCALES:
                scale = factor * size / spread
                places = scale * turned + self.middle
                index = np.clip(np.rint((places - low) / cell).astype(int), 0, last)
                far = np.sort(field[index[:, 0], index[:, 1], index[:, 2]])
                error = float(far[: int(_FORWARD_PART * len(far))].mean()) / scale
                similarity = Similarity(scale, rotation, self.middle - scale * rotation @ middle)
                found.append((error * size / spread, similarity))
        return sorted(found, key=_error)

    def settled(self, start: Similarity, rounds: int) -> tuple[float, Similarity]:
        """Trimmed ICP in both directions; its error, and the similarity."""
        now, error = start, np.inf
        for _ in range(rounds):
            ours, theirs, apart = self._pairs(now)
            error = float(np.sqrt((apart**2).mean())) if len(apart) else np.inf
            moved = best_similarity(ours, theirs)
            if not isinstance(moved, Similarity):
                return np.inf, now
            step = np.abs(moved.apply(self.points) - now.apply(self.points)).max()
            now = moved
            if step < 1e-4 * self.size:
                break
        return error, now

    def turned(self, best: Similarity) -> list[Similarity]:
        """A solution turned by quarters about the axes along which the surface extends."""
        centred = self.surface - self.middle
        axes = np.linalg.eigh(centred.T @ centred)[1].T
        found = []
        for axis in axes:
            for quarters in (2, 1, 3):
                turn = Rotation.from_rotvec(0.5 * np.pi * quarters * axis).as_matrix()
                shift = turn @ (best.shift - self.middle) + self.middle
                found.append(Similarity(best.scale, turn @ best.rotation, shift))
        return found

    def misplaced(self, now: Similarity, reach: float) -> float:
        """Share of the points that lie off the surface by more, or on the wrong side of it."""
        apart, index = _nearest(self.tree, now.apply(self.counted.points))
        facing = self.counted.outward @ now.rotation.T
        wrong = (self.normals[index] * facing).sum(axis=1) < 0.0
        return float((wrong | (apart > reach)).mean())

    def _pairs(
        self, now: Similarity
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Model points, surface points, and how far they lie apart."""
        placed, facing = now.apply(self.points), self.outward @ now.rotation.T
        apart, index = _nearest(self.tree, placed)
        # A surface is seen from its outside only.
        wrong = (self.normals[index] * facing).sum(axis=1) < 0.0
        ahead = _nearest_part(np.where(wrong, np.inf, apart), _FORWARD_PART)
        back = now.inverse()
        away, nearest = _nearest(self.model_tree, back.apply(self.asked))
        wrong = (self.asked_normals * facing[nearest]).sum(axis=1) < 0.0
        behind = _nearest_part(np.where(wrong, np.inf, now.scale * away), _BACKWARD_PART)
        return (
            np.concatenate([self.points[ahead], self.points[nearest[behind]]]),
            np.concatenate([self.surface[index[ahead]], self.asked[behind]]),
            np.concatenate([apart[ahead], now.scale * away[behind]]),
        )

    def _distance_field(self) -> tuple[NDArray[np.float64], float, NDArray[np.float64]]:
        low, high = self.surface.min(axis=0), self.surface.max(axis=0)
        margin = 0.25 * (high - low).max()
        low, high = low - margin, high + margin
        cell = float((high - low).max()) / _FIELD_CELLS
        shape = np.ceil((high - low) / cell).astype(int) + 1
        empty = np.ones(shape, bool)
        empty[tuple(np.rint((self.surface - low) / cell).astype(int).T)] = False
        return low, cell, cell * distance_transform_edt(empty)


def even_rotations(count: int) -> NDArray[np.float64]:
    """Rotations spread evenly over all there are, (count, 3, 3); always the same ones."""
    phi, psi = np.sqrt(2.0), 1.533751168755204288118041
    s = np.arange(count) + 0.5
    r, big_r = np.sqrt(s / count), np.sqrt(1.0 - s / count)
    alpha, beta = 2 * np.pi * s / phi, 2 * np.pi * s / psi
    quaternions = np.column_stack(
        [r * np.sin(alpha), r * np.cos(alpha), big_r * np.sin(beta), big_r * np.cos(beta)]
    )
    return np.asarray(Rotation.from_quat(quaternions).as_matrix())


def _nearest(
    tree: cKDTree, asked: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.intp]]:
    apart, index = tree.query(asked)
    return np.asarray(apart, float), np.asarray(index, np.intp)


def _nearest_part(apart: NDArray[np.float64], part: float) -> NDArray[np.intp]:
    order = np.argsort(apart, kind="stable")[: max(3, int(part * len(apart)))]
    return order[np.isfinite(apart[order])]


def _thinned(points: NDArray[np.float64], count: int) -> NDArray[np.intp]:
    """About ``count`` points, evenly over space rather than where texture is rich."""
    low, high = np.quantile(points, [0.02, 0.98], axis=0)
    order = np.arange(len(points))
    extent = float((high - low).max())
    cell = extent / 4.0
    # Where all are wanted, or copies leave too few places, none is left out.
    while len(points) > count and cell > _FINEST_CELL * extent:
        _, first = np.unique(np.floor((points - low) / cell).astype(int), axis=0, return_index=True)
        if len(first) >= count:
            order = np.sort(first)
            break
        cell /= 1.2
    inside = ((points[order] >= low - (high - low)) & (points[order] <= high + (high - low))).all(1)
    return np.asarray(order[inside])
