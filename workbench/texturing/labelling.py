"""Which photograph textures which triangle: the choices, their costs, and what was chosen.

Source: Arikan et al., section 5.2.3, eq. 1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.geometry.labelled_mesh import NO_PHOTO
from workbench.kernels.grouping import grouped
from workbench.kernels.pair_costs import rows_of_labels, seam_costs

FULL_COLOR = 65535


@dataclass(frozen=True)
class LabellingProblem:
    """Triangles, the photographs each may be textured with, and what every choice costs.

    A triangle without candidates stays without a photograph; edges beside it cost nothing.

    Attributes
    ----------
    starts : (m + 1,) int64; the candidates of triangle t are those from ``starts[t]`` to
        ``starts[t + 1]``.
    labels : (c,) int32 photographs, rising within each triangle.
    costs : (c,) float64 data cost, eq. 2, with the triangle's area in it.
    edges : (e, 2) int32 triangles side by side.
    edge_lengths : (e,) float64 of the edge between them, in the world's units.
    edge_starts : (e + 1,) int64, as ``starts`` for the rows below.
    edge_labels : (d,) int32 photographs that are candidates of either triangle, rising.
    edge_colors : (d, s, 3) uint16 colours along the edge as that photograph shows them:
        sRGB-encoded, `FULL_COLOR` for 1, the same s places in all.
    smoothness : λs of eq. 1, in the world's units.

    Raises
    ------
    InputError : arrays do not belong together, or costs, lengths or λs are negative or not finite.
    """

    starts: NDArray[np.int64]
    labels: NDArray[np.int32]
    costs: NDArray[np.float64]
    edges: NDArray[np.int32]
    edge_lengths: NDArray[np.float64]
    edge_starts: NDArray[np.int64]
    edge_labels: NDArray[np.int32]
    edge_colors: NDArray[np.uint16]
    smoothness: float

    def __post_init__(self) -> None:
        shapes = {
            "costs": (len(self.costs), len(self.labels)),
            "candidates": (int(self.starts[-1]), len(self.labels)),
            "edge lengths": (len(self.edge_lengths), len(self.edges)),
            "edges' starts": (len(self.edge_starts), len(self.edges) + 1),
            "edges' labels": (int(self.edge_starts[-1]), len(self.edge_labels)),
            "edges' colours": (len(self.edge_colors), len(self.edge_labels)),
        }
        for what, (found, expected) in shapes.items():
            if found != expected:
                raise InputError(
                    f"the {what} of a labelling do not belong to it",
                    expected=str(expected), found=str(found),
                )  # fmt: skip
        for what, numbers in (
            ("data costs", self.costs),
            ("edge lengths", self.edge_lengths),
            ("smoothness", np.array([self.smoothness])),
        ):
            if not (np.isfinite(numbers) & (numbers >= 0.0)).all():
                raise InputError(
                    f"the {what} of a labelling must be finite and not negative",
                    found=f"{int((~(np.isfinite(numbers) & (numbers >= 0.0))).sum())} that are not",
                    fix="look for broken vertices in the mesh and for broken cameras",
                )
        for what, starts, labels in (
            ("candidates", self.starts, self.labels),
            ("edges' labels", self.edge_starts, self.edge_labels),
        ):
            rising = np.diff(labels) > 0
            first = starts[1:-1][(starts[1:-1] > 0) & (starts[1:-1] < len(labels))] - 1
            rising[first] = True
            if not rising.all() or (labels < 0).any():
                raise InputError(f"the {what} of a labelling must rise and begin at 0 or later")

    @property
    def triangles(self) -> int:
        """How many there are."""
        return len(self.starts) - 1

    @property
    def edge_weights(self) -> NDArray[np.float64]:
        """(e,) λs times the length: what a colour difference of 1 costs."""
        return self.smoothness * self.edge_lengths

    def cheapest(self) -> NDArray[np.int32]:
        """(m,) int32 the candidate of least data cost, the first among equals, or `NO_PHOTO`."""
        best = np.full(self.triangles, NO_PHOTO, np.int32)
        count = np.diff(self.starts)
        some = np.flatnonzero(count)
        if len(some):
            least = np.minimum.reduceat(self.costs, self.starts[some])
            cheap = np.flatnonzero(self.costs == np.repeat(least, count[some]))
            owner = np.repeat(np.arange(self.triangles), count)[cheap]
            # Backwards, so that the first of equals is written last.
            best[owner[::-1]] = self.labels[cheap[::-1]]
        return best

    def rows(self, labels: NDArray[np.int32]) -> NDArray[np.int64]:
        """(m,) int64 where each triangle's label stands among the candidates; −1 for no photograph.

        Raises
        ------
        InputError : a label is no candidate, or a triangle with candidates has none.
        """
        owner = np.repeat(np.arange(self.triangles), np.diff(self.starts))
        chosen = np.flatnonzero(self.labels == labels[owner])
        rows = np.full(self.triangles, -1, np.int64)
        rows[owner[chosen]] = chosen
        wrong = (rows < 0) & ((labels != NO_PHOTO) | (np.diff(self.starts) > 0))
        if wrong.any():
            raise InputError(
                "a labelling has photographs that are not among the candidates",
                found=f"triangle {int(np.flatnonzero(wrong)[0])}",
            )
        return rows

    def energy(self, labels: NDArray[np.int32]) -> Energy:
        """What a labelling (m,) costs.

        Raises
        ------
        InputError : a label is no candidate, or a triangle with candidates has none.
        """
        rows = self.rows(labels)
        colors = rows_of_labels(labels, self.edges, self.edge_starts, self.edge_labels)
        seams = seam_costs(colors, self.edge_weights, self.edge_colors)
        return Energy(float(self.costs[rows[rows >= 0]].sum()), float(seams.sum()))


def by_photo(labels: NDArray[np.int32]) -> dict[int, NDArray[np.int64]]:
    """Where each photograph of ``labels`` (n,), all of them 0 or more, stands, in order."""
    starts, places = grouped(labels, int(labels.max(initial=-1)) + 1)
    found = np.flatnonzero(np.diff(starts)).tolist()
    return {photo: places[starts[photo] : starts[photo + 1]] for photo in found}


@dataclass(frozen=True)
class Energy:
    """Both terms of eq. 1; the smoothness with λs in it."""

    data: float
    smoothness: float

    @property
    def total(self) -> float:
        return self.data + self.smoothness


@dataclass(frozen=True)
class Labelling:
    """What was chosen, and how.

    Attributes
    ----------
    labels : (m,) int32 photograph of each triangle; `NO_PHOTO` where it has no candidates.
    before : of the labelling that was started from.
    cycles : energies after each cycle.
    converged : whether no move was left that lowers the energy.
    lower_bound : no labelling costs less; the sum of the least data costs if no better is known.
    moves : expansion moves solved by max-flow, and how many were taken.
    flow_seconds : spent in max-flow.
    """

    labels: NDArray[np.int32]
    before: Energy
    cycles: tuple[Energy, ...]
    converged: bool
    lower_bound: float
    moves: tuple[int, int]
    flow_seconds: float

    @property
    def energy(self) -> Energy:
        """Of the labels."""
        return self.cycles[-1] if self.cycles else self.before

    @property
    def gap(self) -> float:
        """Share of the energy above the lower bound, in [0, 1]; 0 is proven to be the best."""
        total = self.energy.total
        return max(0.0, (total - self.lower_bound) / total) if total > 0.0 else 0.0
