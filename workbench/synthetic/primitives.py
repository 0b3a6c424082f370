"""Filling the primitive table of a carved solid, with chains that follow its surface."""

from __future__ import annotations

from collections.abc import Sequence
from enum import IntEnum

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import PchipInterpolator

from workbench.geometry import transforms
from workbench.kernels import implicit_solids as solids


class Group(IntEnum):
    """What a primitive belongs to; groups are blended in this order, the last one cuts."""

    BODY = 0
    HEAD = 1
    HAIR = 2
    CLOTH = 3
    FOLDS = 4
    BASE = 5
    CUT = solids.CUT_GROUP


GROUP_BLEND_M = np.array([0.0, 0.012, 0.002, 0.005, 0.006, 0.004, 0.0])


def curve_through(points: ArrayLike, samples: int) -> NDArray[np.float64]:
    """A smooth curve (samples, 3) through control points (n, 3), evenly spaced in parameter."""
    control = np.asarray(points, float)
    step = np.linalg.norm(np.diff(control, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(step)])
    curve: NDArray[np.float64] = PchipInterpolator(along, control)(
        np.linspace(0.0, along[-1], samples)
    )
    return curve


def relaxed(path: NDArray[np.float64], passes: int = 2) -> NDArray[np.float64]:
    """The path (n, 3) with its kinks smoothed; the ends stay."""
    out = path.copy()
    for _ in range(passes):
        out[1:-1] = 0.25 * out[:-2] + 0.5 * out[1:-1] + 0.25 * out[2:]
    return out


class PrimitiveTable:
    """Rows for the kernels of ``implicit_solids``, placed in a movable frame.

    Attributes
    ----------
    solid_from_part : 4×4 float64 frame in which the next primitives are given.
    """

    def __init__(self) -> None:
        self.solid_from_part: NDArray[np.float64] = np.eye(4)
        self._rows: list[NDArray[np.float64]] = []
        self._chains = 0

    def array(self) -> NDArray[np.float64]:
        """The table (n, 23) float64."""
        table = np.array(self._rows).reshape(-1, solids.ROW_LENGTH)
        for group in Group:
            own = table[:, 1] == group
            # Where a row still matters it lies within the blend radius k of the rest of its
            # group. That rest swells by k/4 with every row that joins (five at one place is
            # ample), and its group by the groups' own blends and the weathering.
            blend = float(table[own, 3].max(initial=0.0))
            table[own, solids.REACH_COLUMN] = 2.25 * blend + GROUP_BLEND_M.max() + 0.006
        return table

    def cone(
        self,
        group: Group,
        start: ArrayLike,
        end: ArrayLike,
        radii: tuple[float, float],
        blend: float = 0.0,
        operation: int = solids.UNION,
    ) -> None:
        """The hull of two balls."""
        self._chains += 1
        self._link(group, start, end, radii, blend, operation)

    def _link(
        self,
        group: Group,
        start: ArrayLike,
        end: ArrayLike,
        radii: tuple[float, float],
        blend: float,
        operation: int,
    ) -> None:
        row = self._row(solids.ROUND_CONE, group, operation, blend)
        row[4:7] = transforms.apply(self.solid_from_part, start)
        row[7:10] = transforms.apply(self.solid_from_part, end)
        row[10:12] = radii

    def ball(
        self,
        group: Group,
        center: ArrayLike,
        radius: float,
        blend: float = 0.0,
        operation: int = solids.UNION,
    ) -> None:
        """A ball."""
        self.cone(group, center, center, (radius, radius), blend, operation)

    def ellipsoid(
        self,
        group: Group,
        center: ArrayLike,
        half_sizes: ArrayLike,
        blend: float = 0.0,
        operation: int = solids.UNION,
    ) -> None:
        """An ellipsoid along the axes of the current frame."""
        self._oriented(solids.ELLIPSOID, group, center, half_sizes, 0.0, blend, operation)

    def box(
        self,
        group: Group,
        center: ArrayLike,
        half_sizes: ArrayLike,
        edge_radius: float,
        blend: float = 0.0,
        operation: int = solids.UNION,
    ) -> None:
        """A box with rounded edges along the axes of the current frame."""
        self._oriented(solids.ROUNDED_BOX, group, center, half_sizes, edge_radius, blend, operation)

    def chain(
        self,
        group: Group,
        points: NDArray[np.float64],
        radii: ArrayLike,
        blend: float = 0.003,
        operation: int = solids.UNION,
    ) -> None:
        """Round cones through (n, 3) points with one radius or one per point."""
        radius = np.broadcast_to(np.asarray(radii, float), (len(points),))
        self._chains += 1
        for n in range(len(points) - 1):
            pair = (float(radius[n]), float(radius[n + 1]))
            self._link(group, points[n], points[n + 1], pair, blend, operation)

    def draped(
        self, points: NDArray[np.float64], lift: ArrayLike, groups: Sequence[Group]
    ) -> NDArray[np.float64]:
        """Points (n, 3) of the current frame moved onto the surface of some groups.

        Parameters
        ----------
        points : where the chain would run, near the surface.
        lift : how far above the surface the points end, metres; one or one per point.
        groups : what counts as the surface; cuts never do.
        """
        table = self.array()
        rows = np.flatnonzero(np.isin(table[:, 1], [int(group) for group in groups]))
        position = transforms.apply(self.solid_from_part, points)
        height = np.broadcast_to(np.asarray(lift, float), (len(position),))
        offsets = 1e-4 * np.concatenate([np.zeros((1, 3)), np.eye(3), -np.eye(3)])
        for _ in range(8):
            probes = (position[:, None] + offsets).reshape(-1, 3)
            value = self._distances(table, rows, probes).reshape(-1, 7)
            slope = (value[:, 1:4] - value[:, 4:7]) / 2e-4
            slope /= np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 0.3)
            # Shorter steps than Newton's keep points from jumping across a narrow fold.
            position = position - 0.7 * (value[:, 0] - height)[:, None] * slope
        return transforms.apply(transforms.inverse(self.solid_from_part), position)

    @staticmethod
    def _distances(
        table: NDArray[np.float64], rows: NDArray[np.int64], points: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        values: NDArray[np.float64] = solids.solid_distances(
            table, rows, GROUP_BLEND_M, np.zeros((solids.GROUPS, 3)), np.zeros((0, 9)),
            np.ascontiguousarray(points), 1.0, -1.0, 0,
        )  # fmt: skip
        return values

    def _row(self, kind: int, group: Group, operation: int, blend: float) -> NDArray[np.float64]:
        row = np.zeros(solids.ROW_LENGTH)
        row[:4] = kind, group, operation, blend
        row[solids.CHAIN_COLUMN] = self._chains
        self._rows.append(row)
        return row

    def _oriented(
        self,
        kind: int,
        group: Group,
        center: ArrayLike,
        half_sizes: ArrayLike,
        edge_radius: float,
        blend: float,
        operation: int,
    ) -> None:
        self._chains += 1
        row = self._row(kind, group, operation, blend)
        row[4:7] = transforms.apply(self.solid_from_part, center)
        row[7:10] = half_sizes
        row[10] = edge_radius
        row[12:21] = self.solid_from_part[:3, :3].T.ravel()
