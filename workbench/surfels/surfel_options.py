"""How an object becomes surfels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from workbench.errors import SettingsError

# Measured at the peak of a node: per triangle Embree's tree and the corners, per ray the
# candidate that about half of the rays find, per point the order.
_BYTES_PER_TRIANGLE, _BYTES_PER_RAY, _BYTES_PER_POINT = 400, 90, 250
_CHILDREN = 8
_MIB = 1 << 20


@dataclass(frozen=True)
class SurfelOptions:
    """How an object becomes surfels.

    Attributes
    ----------
    count : surfels of each node, at most.
    candidates_resolution : pixels along the longer side of each of the pictures that a node's
        candidates come from; at least that of the display it is meant for (Brandt 2019, 3.1).
    views : how many pictures: 8 from the corners of a node's bounds as in the paper, 14 from the
        faces, too, 26 from the edges, too. More see further into hollows.
    seed : of the first surfel and of random rounds.
    order : ``exact`` is the greedy permutation, ``progressive`` the published approximation.
    opposite_share : up to what spacing, as a share of the object's diagonal, both sides of thin
        walls keep surfels of their own; 0 is the plain distance of the paper. The progressive
        order knows the plain distance alone.
    colors : ``mean`` over what a surfel stands for, also for short prefixes, or the ``sample``
        of its own place.
    positions : ``float32``, or ``quantised`` to 16 bits an axis of a node's box.
    split_above : a node with more triangles or points than this has children.
    memory_mib : what a node's making may take; a smaller one makes more and smaller nodes.
    workers : nodes made at once, as far as memory allows; they do not change the file.
    """

    count: int = 100_000
    candidates_resolution: int = 1024
    views: Literal[8, 14, 26] = 14
    seed: int = 0
    order: Literal["exact", "progressive"] = "exact"
    opposite_share: float = 0.1
    colors: Literal["mean", "sample"] = "mean"
    positions: Literal["quantised", "float32"] = "quantised"
    split_above: int = 500_000
    memory_mib: int = 2048
    workers: int = 1

    def __post_init__(self) -> None:
        bounds = {
            "count": (self.count, 1, 20_000_000),
            "candidates_resolution": (self.candidates_resolution, 8, 8192),
            "opposite_share": (self.opposite_share, 0.0, 1.0),
            "split_above": (self.split_above, 1000, 1 << 31),
            "memory_mib": (self.memory_mib, 16, 1 << 24),
            "views": (self.views, 8, 26),
            "workers": (self.workers, 1, 1024),
            "seed": (self.seed, 0, 1 << 62),
        }
        for name, (value, least, most) in bounds.items():
            if not least <= value <= most:
                raise SettingsError(
                    f"{name} of a surfel export is out of its bounds.",
                    expected=f"{least} to {most}",
                    found=str(value),
                    fix=f"Set {name} to a value between these.",
                )

    @property
    def ray_bytes(self) -> int:
        """What the pictures and candidates of one node take, and those of its children."""
        rays = self.views * self.candidates_resolution**2 * _BYTES_PER_RAY
        return max(rays, _CHILDREN * self.count * _BYTES_PER_POINT)

    def most_triangles(self) -> int:
        """Triangles of a leaf.

        Raises
        ------
        SettingsError
            The pictures alone take more memory than there may be used.
        """
        return self._most(self.ray_bytes, _BYTES_PER_TRIANGLE)

    def most_points(self) -> int:
        """Points of a leaf; errors are those of `most_triangles`."""
        inner = _CHILDREN * self.count * _BYTES_PER_POINT
        return min(self._most(0, _BYTES_PER_POINT), self._most(inner, 1))

    def _most(self, fixed: int, each: int) -> int:
        left = self.memory_mib * _MIB - fixed
        most = min(self.split_above, left // each)
        if most < 1000:
            raise SettingsError(
                "The memory does not suffice for the surfels of one node.",
                expected=f"memory_mib of {fixed // _MIB + 1 + each * 1000 // _MIB} or more",
                found=str(self.memory_mib),
                fix="Allow more memory, or take a lower candidates_resolution or count.",
            )
        return most

    def nodes_at_once(self, most_items: int, *, triangles: bool) -> int:
        """Nodes that may be made side by side, at least one."""
        fixed = self.ray_bytes if triangles else _CHILDREN * self.count * _BYTES_PER_POINT
        each = _BYTES_PER_TRIANGLE if triangles else _BYTES_PER_POINT
        return max(1, min(self.workers, self.memory_mib * _MIB // (fixed + each * most_items)))
