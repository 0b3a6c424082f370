"""Seam levelling over a whole mesh: smooth offsets that make photographs agree at seams.

Every vertex has an offset for each photograph its triangles are textured with. Least squares ask
that both sides of every seam become equal along it, that offsets of neighbours within a
photograph be equal, and, faintly, that they be small: errors at single seams would otherwise add
up over the mesh and skew its colours far away. What is asked faintly is weighed by area, and so
the mean over all that photographs show is kept. Triangles without a photograph follow: their seams
are closed afterwards, from their side alone, for what they show is a guess.

Source: Lempitsky, Ivanov 2007, section 5; Waechter, Moehrle, Goesele 2014, section 4.3, compares
colours along edges instead of at vertices, too.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array, csc_array, csr_array, diags_array, eye_array
from scipy.sparse.linalg import splu

from workbench.errors import InputError
from workbench.geometry.labelled_mesh import NO_PHOTO, LabelledMesh
from workbench.geometry.mesh import face_normals_and_areas
from workbench.texturing.dissection import dissected
from workbench.texturing.patches import Patches
from workbench.texturing.seams import Seams

_CHANNELS = 3
# Of the diagonal: for parts without area or seams, whose offsets are asked nothing but to be equal.
_RIDGE = 1e-13


@dataclass(frozen=True)
class Levelling:
    """Offsets, and how much they move.

    Attributes
    ----------
    offsets : (m, 3, 3) float32 by corner and channel of 255, triangles in the patches' order.
    mean_shift : by channel, over the area of all that photographs show: near 0.
    rms_shift, greatest_shift : root mean square over the same area, and the most anywhere.
    skewed_share : of that area, moved by more than 10 of 255 in some channel.
    shifts : photograph → mean shift by channel over what it textures.
    unknowns : of the least squares.
    residual : of their equations, as share of the right-hand side, the most of any channel.
    """

    offsets: NDArray[np.float32]
    mean_shift: tuple[float, float, float]
    rms_shift: float
    greatest_shift: float
    skewed_share: float
    shifts: dict[int, tuple[float, float, float]]
    unknowns: int
    residual: float


def levelled(
    labelled: LabelledMesh,
    patches: Patches,
    seams: Seams,
    colors: NDArray[np.float32],
    shares: NDArray[np.float64],
    stiffness: float = 0.1,
    anchor: float = 20.0,
) -> Levelling:
    """Level the seams of a labelled mesh.

    Parameters
    ----------
    seams : of the mesh; ``colors`` (e, 2, s, 3) of 255 are those along them, at ``shares`` (s,).
    stiffness : what a difference of offsets along an edge within a photograph costs beside the
        same step left across a seam as long as the mean one.
    anchor : what it costs to move all that photographs show, in the same measure and in units of
        the stiffness. Offsets fade over 1 / √anchor of the surface's width; the colours of
        photographs whose exposures differ by ± 0.3 EV come out best near 20.

    Raises
    ------
    InputError : colours are not finite, or the stiffness or the anchor is not positive.
    """
    if not np.isfinite(colors).all() or not (stiffness > 0.0 and anchor > 0.0):
        raise InputError(
            "seams cannot be levelled",
            expected="finite colours, a stiffness and an anchor above 0",
            found=f"{int((~np.isfinite(colors)).sum())} not finite, {stiffness}, {anchor}",
        )  # fmt: skip
    mesh = labelled.mesh
    corner_vertices = mesh.triangles[patches.triangles].astype(np.int64)
    corner_labels = labelled.labels[patches.triangles].astype(np.int64)
    names = corner_vertices + len(mesh.vertices) * (corner_labels - NO_PHOTO)[:, None]
    unique, unknown = np.unique(names, return_inverse=True)
    unknown = unknown.reshape(-1, 3)
    bare = unique < len(mesh.vertices)
    points = mesh.vertices[unique % len(mesh.vertices)]
    system = _System(unknown, stiffness)
    between = (corner_labels[seams.rows] != NO_PHOTO).all(axis=1)
    offsets = np.zeros((len(unique), _CHANNELS))
    areas = face_normals_and_areas(mesh)[1][patches.triangles]
    mass = np.bincount(unknown.ravel(), np.repeat(areas / 3.0, 3), len(unique))
    shown = float(mass[~bare].sum())
    held = diags_array(anchor * stiffness * mass / (shown if shown > 0.0 else 1.0))
    matrix, wanted = system.equations(seams.where(between), colors[between], shares)
    residual = _solve(csr_array(matrix + held), wanted, ~bare, points, offsets)
    if bare.any():
        matrix, wanted = system.equations(seams.where(~between), colors[~between], shares)
        residual = max(residual, _solve(matrix, wanted, bare, points, offsets))
    return _told(offsets, unknown, corner_labels, areas, residual)


class _System:
    """The least squares of a mesh whose triangles have the unknowns (m, 3) at their corners."""

    def __init__(self, unknown: NDArray[np.int64], stiffness: float) -> None:
        self._unknown, self._stiffness = unknown, stiffness
        self._count = int(unknown.max(initial=-1)) + 1
        pairs = np.concatenate([unknown[:, [k, (k + 1) % 3]] for k in range(3)])
        pairs.sort(axis=1)
        self._ties = np.unique(pairs[:, 0] * self._count + pairs[:, 1])

    def equations(
        self, seams: Seams, colors: NDArray[np.float32], shares: NDArray[np.float64]
    ) -> tuple[csr_array, NDArray[np.float64]]:
        """Normal equations: matrix (u, u) and right-hand sides (u, 3)."""
        n = self._count
        one, other = self._ties // max(n, 1), self._ties % max(n, 1)
        tie = np.full(len(one), self._stiffness)
        rows, columns = [one, other, one, other], [one, other, other, one]
        values = [tie, tie, -tie, -tie]
        wanted = np.zeros((n, _CHANNELS))
        if seams.count:
            mean = float(seams.lengths.mean())
            weight = seams.lengths / (mean if mean > 0.0 else 1.0) / len(shares)
            at = self._unknown[seams.rows[:, :, None], seams.corners].reshape(-1, 4)
            step = colors[:, 1].astype(np.float64) - colors[:, 0]
            # By sample: how the four offsets of an edge make the difference across it.
            parts = np.stack([1 - shares, shares, shares - 1, -shares], axis=1)
            for i in range(4):
                pull = np.einsum("s,esc->ec", parts[:, i], step) * weight[:, None]
                for c in range(_CHANNELS):
                    wanted[:, c] += np.bincount(at[:, i], pull[:, c], n)
                for j in range(4):
                    rows.append(at[:, i])
                    columns.append(at[:, j])
                    values.append(weight * float(parts[:, i] @ parts[:, j]))
        where = (np.concatenate(rows), np.concatenate(columns))
        return csr_array(coo_array((np.concatenate(values), where), (n, n))), wanted


def _solve(
    matrix: csr_array,
    wanted: NDArray[np.float64],
    free: NDArray[np.bool_],
    points: NDArray[np.float64],
    offsets: NDArray[np.float64],
) -> float:
    """Fill in the free rows of ``offsets`` (u, 3), which are at ``points``, the others given.

    Returns the residual relative to the right-hand side.
    """
    which = np.flatnonzero(free)
    if not len(which):
        return 0.0
    which = which[dissected(csr_array(matrix[which][:, which]), points[which])]
    rows = matrix[which]
    inner = csc_array(rows[:, which])
    right = wanted[which] - rows @ np.where(free[:, None], 0.0, offsets)
    scale = float(inner.diagonal().max())
    if scale > 0.0:
        held = inner + (_RIDGE * scale) * eye_array(len(which), format="csc")
        factors = splu(
            held, permc_spec="NATURAL", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )
        offsets[which] = factors.solve(right)
    size = np.linalg.norm(right, axis=0)
    left = np.linalg.norm(right - inner @ offsets[which], axis=0)
    return float((left / np.where(size > 0.0, size, 1.0)).max())


def _told(
    offsets: NDArray[np.float64],
    unknown: NDArray[np.int64],
    labels: NDArray[np.int64],
    areas: NDArray[np.float64],
    residual: float,
) -> Levelling:
    by_corner = offsets[unknown].astype(np.float32)
    shown = labels != NO_PHOTO
    weight = areas * shown
    total = float(weight.sum())
    means = by_corner.mean(axis=1, dtype=np.float64)
    # Of a linear function over a triangle, the mean square is exact by corners and their mean.
    squares = (np.square(by_corner, dtype=np.float64).sum(axis=1) + 9.0 * means**2) / 12.0
    share = weight / total if total > 0.0 else weight
    shifts: dict[int, tuple[float, float, float]] = {}
    for label in np.unique(labels[shown]).tolist():
        of = labels == label
        area = float(areas[of].sum())
        mean = (means[of] * areas[of, None]).sum(axis=0) / (area if area > 0.0 else 1.0)
        shifts[label] = _three(mean)
    return Levelling(
        by_corner,
        _three(share @ means),
        float(np.sqrt(share @ squares.mean(axis=1))),
        float(np.abs(by_corner[shown]).max(initial=0.0)),
        float(share @ (np.abs(means) > 10.0).any(axis=1)),
        shifts,
        len(offsets),
        residual,
    )


def _three(values: NDArray[np.float64]) -> tuple[float, float, float]:
    return float(values[0]), float(values[1]), float(values[2])
