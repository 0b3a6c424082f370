"""Normal equations of a bundle adjustment, which observations are added to part by part."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from workbench.kernels.normal_equations import add_observations, eliminate_points

Matrices = NDArray[np.float64]
POSE = 6


@dataclass(frozen=True)
class Dependence:
    """Which unknowns of the cameras each point depends on.

    Attributes
    ----------
    count : c, of the cameras' unknowns: each image's pose, then each lens's parameters.
    starts : (p + 1,) where each point's begin.
    unknowns : (n,) rising in each point.
    places : (m, u) of each observation those of its image and of its lens, −1 where its lens has
        fewer than another.
    """

    count: int
    starts: NDArray[np.int64]
    unknowns: NDArray[np.int64]
    places: NDArray[np.int64]

    @classmethod
    def of(
        cls,
        seen_image: NDArray[np.intp],
        seen_point: NDArray[np.intp],
        camera_of_image: NDArray[np.intp],
        lens_sizes: tuple[int, ...],
        points: int,
    ) -> Dependence:
        """Of observations (m,), each of an image and a point."""
        images = len(camera_of_image)
        widths = np.array([POSE] * images + list(lens_sizes), np.int64)
        firsts = np.cumsum(widths) - widths
        lens = camera_of_image[seen_image]
        groups = seen_point[:, None] * len(widths) + np.column_stack([seen_image, images + lens])
        found, where = np.unique(groups, return_inverse=True)
        where = where.reshape(groups.shape)
        width = widths[found % len(widths)]
        begin = np.cumsum(width) - width
        steps = np.arange(width.sum()) - np.repeat(begin, width)
        unknowns = np.repeat(firsts[found % len(widths)], width) + steps
        ends = np.searchsorted(found, np.arange(points + 1) * len(widths))
        starts = np.concatenate([begin, [len(unknowns)]])[ends]
        most = np.arange(max(lens_sizes, default=0))
        own = begin[where[:, 1], None] + most
        own[most >= np.array(lens_sizes, np.int64)[lens, None]] = -1
        places = np.hstack([begin[where[:, 0], None] + np.arange(POSE), own])
        return cls(int(widths.sum()), starts, unknowns, places)


@dataclass(frozen=True)
class Linearised:
    """Normal equations of the reprojections; c camera unknowns, p points.

    Attributes
    ----------
    camera_hessian : (c, c); every image's rotation and shift, then every lens's parameters.
    camera_gradient : (c,).
    point_hessian : (p, 3, 3).
    point_gradient : (p, 3).
    depends : the places of ``blocks``.
    blocks : (n, 3) mixed derivatives, of each point by each unknown that it depends on.
    weights : (m,) robust weight of each observation.
    """

    camera_hessian: Matrices
    camera_gradient: Matrices
    point_hessian: Matrices
    point_gradient: Matrices
    depends: Dependence
    blocks: Matrices
    weights: Matrices

    @classmethod
    def empty(cls, depends: Dependence) -> Linearised:
        """Without any observation yet."""
        points, count = len(depends.starts) - 1, depends.count
        return cls(
            np.zeros((count, count)),
            np.zeros(count),
            np.zeros((points, 3, 3)),
            np.zeros((points, 3)),
            depends,
            np.zeros((len(depends.unknowns), 3)),
            np.zeros(len(depends.places)),
        )

    def add(
        self,
        part: slice,
        seen_point: NDArray[np.intp],
        by_camera: Matrices,
        by_point: Matrices,
        residuals: Matrices,
        weights: Matrices,
        sigma: float,
    ) -> None:
        """Add some of the observations.

        Parameters
        ----------
        part : which of all they are.
        seen_point : (m,) rows of points.
        by_camera, by_point : (m, 2, u) and (m, 2, 3) derivatives of the residuals, (m, 2).
        weights : (m,) robust ones.
        sigma : of the residuals.
        """
        self.weights[part] = weights
        add_observations(
            self.camera_hessian,
            self.camera_gradient,
            self.point_hessian,
            self.point_gradient,
            self.blocks,
            self.depends.unknowns,
            self.depends.places[part],
            seen_point,
            by_camera,
            by_point,
            residuals,
            weights / sigma**2,
        )

    def mirror(self) -> None:
        """Fill the upper half of the cameras' part, when all observations are there."""
        lower = np.tril(self.camera_hessian, -1)
        self.camera_hessian[:] = np.tril(self.camera_hessian) + lower.T

    @property
    def coupling(self) -> sparse.bsr_array:
        """(3p, c) mixed derivatives of points and cameras, as a matrix; nothing is copied."""
        shape = (3 * len(self.point_hessian), self.depends.count)
        parts = (self.blocks[:, :, None], self.depends.unknowns, self.depends.starts)
        return sparse.bsr_array(parts, shape=shape)

    def without_points(self, inverse: Matrices, gradient: Matrices) -> tuple[Matrices, Matrices]:
        """The cameras' system (c, c) and right side (c,) with the points eliminated.

        Parameters
        ----------
        inverse, gradient : (p, 3, 3) inverses of the points' blocks, and (p, 3) their gradient.
        """
        reduced, right = np.array(self.camera_hessian), -self.camera_gradient
        depends = self.depends
        eliminate_points(
            reduced, right, depends.starts, depends.unknowns, self.blocks, inverse, gradient
        )
        return reduced, right
