"""What is remembered of one cast for the next: the hierarchy of query pairs and its leaves.

Source: Jaspe 2018, 4.4.5 and 4.5.1 (temporal coherence, pull-up).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.query_pairs import (
    CHILDREN,
    DIVIDED,
    INVISIBLE,
    NODE,
    PARENT,
    STATE,
    TILE,
    UNKNOWN,
    VISIBLE,
)

_FIRST_ROOM = 1 << 12


class VisibilityFront:
    """Query pairs of casts that resemble one another: of views in a row, or of one direction.

    Attributes
    ----------
    pairs : (p, 4) int32 as of `workbench.kernels.query_pairs`; ``count`` of them are there.
    casts : how often it was used.
    """

    def __init__(self) -> None:
        self.pairs: NDArray[np.int32] = np.zeros((_FIRST_ROOM, 4), np.int32)
        self.count = 0
        self.casts = 0
        self._rays = -1

    def begin(self, rays: int) -> None:
        """Before a cast of so many rays; other tiles than last time have nothing to remember."""
        if rays != self._rays:
            self.count, self._rays = 0, rays
        if not self.count:
            self.pairs[0] = (0, 0, -1, UNKNOWN)
            self.count = 1
        self.casts += 1

    def visible(self) -> NDArray[np.int32]:
        """(k,) rows of the pairs that were cast."""
        return self._of(VISIBLE)

    def invisible(self) -> NDArray[np.int32]:
        """(k,) rows of the pairs that were culled, those of a tile together."""
        rows = self._of(INVISIBLE)
        return rows[np.argsort(self.pairs[rows, TILE], kind="stable")]

    def unknown(self) -> NDArray[np.int32]:
        """(k,) rows of the pairs that were not asked yet."""
        return self._of(UNKNOWN)

    def tiles_and_nodes(
        self, rows: NDArray[np.int32]
    ) -> tuple[NDArray[np.int32], NDArray[np.int32]]:
        """(k,) each, of some pairs."""
        return np.ascontiguousarray(self.pairs[rows, TILE]), np.ascontiguousarray(
            self.pairs[rows, NODE]
        )

    def make_room(self) -> None:
        """Twice the room where it is nearly full."""
        if self.count + 2 * CHILDREN > len(self.pairs):
            self.pairs = np.concatenate([self.pairs, np.zeros_like(self.pairs)])

    def pull_up(self) -> None:
        """Pairs all of whose children were culled become culled leaves, one level a cast."""
        pairs = self.pairs[: self.count]
        parents = pairs[1:, PARENT]
        children = np.bincount(parents, minlength=self.count)
        culled = np.bincount(parents[pairs[1:, STATE] == INVISIBLE], minlength=self.count)
        pulled = (children > 0) & (children == culled)
        assert (pairs[pulled, STATE] == DIVIDED).all()
        pairs[pulled, STATE] = INVISIBLE
        kept = np.ones(self.count, np.bool_)
        kept[1:] = ~pulled[parents]
        new_rows = np.cumsum(kept, dtype=np.int32) - 1
        left = pairs[kept]
        left[1:, PARENT] = new_rows[left[1:, PARENT]]
        self.pairs[: len(left)] = left
        self.count = len(left)

    def _of(self, state: int) -> NDArray[np.int32]:
        return np.flatnonzero(self.pairs[: self.count, STATE] == state).astype(np.int32)
