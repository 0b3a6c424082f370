"""Surfels as the bytes of a file, and back."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.point_set import PointSet

_STEPS = 65535.0


def surfel_record(exact: bool, colored: bool) -> np.dtype[np.void]:
    """One surfel in a file; ``exact`` positions are float32, others 16 bits an axis."""
    fields: list[tuple[str, str, tuple[int, ...]]] = [
        ("position", "<f4" if exact else "<u2", (3,)),
        ("normal", "<i2" if exact else "i1", (2,)),
    ]
    if colored:
        fields += [("color", "u1", (3,)), ("reserved", "u1", ())]
    return np.dtype(fields)


def packed_surfels(
    surfels: PointSet, lower: NDArray[np.float64], size: NDArray[np.float64], exact: bool
) -> NDArray[np.void]:
    """Records of surfels with normals in the box of corner ``lower`` (3,) and sides ``size``."""
    records = np.zeros(len(surfels), surfel_record(exact, surfels.color is not None))
    local = surfels.points - lower
    if exact:
        records["position"] = local
    else:
        share = local / np.where(size > 0.0, size, 1.0)
        records["position"] = np.rint(np.clip(share, 0.0, 1.0) * _STEPS)
    if surfels.normals is not None:
        most = np.iinfo(records.dtype["normal"].base).max
        records["normal"] = np.rint(octahedral(surfels.normals) * most)
    if surfels.color is not None:
        records["color"] = surfels.color
    return records


def unpacked_surfels(
    records: NDArray[np.void], lower: NDArray[np.float64], size: NDArray[np.float64]
) -> PointSet:
    """The surfels of `packed_surfels`."""
    names = records.dtype.names or ()
    kind = records.dtype["position"].base
    local = records["position"].astype(np.float64)
    points = lower + (local if kind.kind == "f" else local * (size / _STEPS))
    most = np.iinfo(records.dtype["normal"].base).max
    normals = direction_of(records["normal"].astype(np.float64) / most)
    color = records["color"].copy() if "color" in names else None
    return PointSet(points, normals, color, None)


def octahedral(normals: NDArray[np.floating]) -> NDArray[np.float64]:
    """Unit normals (n, 3) as places (n, 2) in −1 … 1: the faces of an octahedron, unfolded."""
    long = np.asarray(normals, np.float64)
    flat = long[:, :2] / np.maximum(np.abs(long).sum(axis=1, keepdims=True), 1e-30)
    folded = (1.0 - np.abs(flat[:, ::-1])) * np.where(flat >= 0.0, 1.0, -1.0)
    return np.asarray(np.where(long[:, 2:] < 0.0, folded, flat))


def direction_of(places: NDArray[np.float64]) -> NDArray[np.float32]:
    """Unit normals (n, 3) of `octahedral`."""
    up = 1.0 - np.abs(places).sum(axis=1)
    folded = (1.0 - np.abs(places[:, ::-1])) * np.where(places >= 0.0, 1.0, -1.0)
    normals = np.column_stack([np.where(up[:, None] < 0.0, folded, places), up])
    # The fold of the lowest integer, which is one step outside, is not quite zero.
    length = np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-30)
    return np.asarray(normals / length, np.float32)
