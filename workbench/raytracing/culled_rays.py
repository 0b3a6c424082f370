"""Rays against a surface on disk: what no ray can meet is culled, the rest cast in batches.

Source: Jaspe 2018, chapter 4 (CHC+RT), after Mattausch et al. 2015. Where that draws boxes on a
graphics card with occlusion queries, here a compiled loop holds rays against boxes, and Embree
takes the part of the intersecting shader.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.query_pairs import (
    INVISIBLE,
    NODE,
    STATE,
    UNKNOWN,
    box_distance,
    gather_rays,
    keep_nearest,
    push,
    refine_pairs,
    visible_groups,
)
from workbench.raytracing.chunk_file import ChunkFile
from workbench.raytracing.embree_scene import BYTES_PER_TRIANGLE, NO_TRIANGLE, EmbreeScene
from workbench.raytracing.geometry_cache import GeometryCache
from workbench.raytracing.ray_hits import RayCounts, RayHits
from workbench.raytracing.ray_tiles import RayTiles, ray_tiles
from workbench.raytracing.visibility_front import VisibilityFront

# A ray that has met something and needs no more.
_DONE = np.float32(-1.0)
_LARGEST_INVERSE = np.float32(1e30)


@dataclass(frozen=True)
class CullingOptions:
    """How casts are divided.

    Attributes
    ----------
    balance : t_q of the rule that divides boxes or tiles (4.4.4).
    smallest_tile : rays of a tile that is divided no further, at most.
    most_triangles, most_height : of subtrees that are cast as they are.
    found_at_once : m, visible pairs that are collected before they are cast. With few, near ones
        hide what is behind them; with many, a subtree is read once for all rays that may meet it,
        which is worth more here than on a graphics card.
    recheck_every : casts after which visible pairs are asked again.
    threshold : rays of a tile that a box may meet and be culled nevertheless: 0 is conservative,
        more is aggressive.
    cache_parts : subtrees of the largest size that the cache has room for, at least.
    """

    balance: float = 0.5
    smallest_tile: int = 1024
    most_triangles: int = 1 << 20
    most_height: int = 24
    found_at_once: int = 1 << 16
    recheck_every: int = 3
    threshold: int = 0
    cache_parts: int = 24


@dataclass(frozen=True)
class _Cast:
    """One call's rays with all that the kernels ask for."""

    rays: NDArray[np.float32]
    origins: NDArray[np.float32]
    inverse: NDArray[np.float32]
    nearest: NDArray[np.float32]
    tiles: RayTiles
    middles: NDArray[np.float32]
    boxes: NDArray[np.float32]
    take: Callable[[EmbreeScene, NDArray[np.float32], NDArray[np.int64]], None]


class CulledRays:
    """As `RayCaster`, with a bounded part of the surface in memory.

    Parameters
    ----------
    file : the surface.
    memory_bytes : for geometry; the rays of one call take about 100 B each besides.
    options : how casts are divided.
    """

    in_core = False

    def __init__(
        self, file: ChunkFile, memory_bytes: int, options: CullingOptions | None = None
    ) -> None:
        self.frame = file.frame
        self.counts = RayCounts()
        self.options = options or CullingOptions()
        self.cache = GeometryCache(file, memory_bytes)
        self._colored = file.colored
        tree = file.tree
        most = memory_bytes // (self.options.cache_parts * BYTES_PER_TRIANGLE)
        self._ends = tree.ends(min(self.options.most_triangles, most), self.options.most_height)
        self._tree = tree

    def nearest(
        self,
        rays: NDArray[np.float32],
        reach: float = np.inf,
        front: VisibilityFront | None = None,
    ) -> RayHits:
        """See `RayCaster`."""
        hits = RayHits.none_yet(len(rays), reach, colored=self._colored)

        def take(scene: EmbreeScene, some: NDArray[np.float32], numbers: NDArray[np.int64]) -> None:
            distances, rows, normals = scene.first_met(some)
            names = np.where(rows == NO_TRIANGLE, rows, scene.numbers[rows].astype(np.int64))
            keep_nearest(
                numbers, distances, names, normals, hits.distances, hits.triangles, hits.normals
            )
            if hits.colors is not None and scene.colors is not None:
                won = (names != NO_TRIANGLE) & (hits.triangles[numbers] == names)
                hits.colors[numbers[won]] = scene.colors[rows[won]]

        self._trace(rays, hits.distances, take, front)
        return hits.ended()

    def blocked(
        self,
        rays: NDArray[np.float32],
        reach: float = np.inf,
        front: VisibilityFront | None = None,
    ) -> NDArray[np.bool_]:
        """See `RayCaster`."""
        nearest = np.full(len(rays), reach, np.float32)

        def take(scene: EmbreeScene, some: NDArray[np.float32], numbers: NDArray[np.int64]) -> None:
            nearest[numbers[scene.blocked(some, reach)]] = _DONE

        self._trace(rays, nearest, take, front)
        return np.asarray(nearest < 0.0)

    def _trace(
        self,
        rays: NDArray[np.float32],
        nearest: NDArray[np.float32],
        take: Callable[[EmbreeScene, NDArray[np.float32], NDArray[np.int64]], None],
        front: VisibilityFront | None,
    ) -> None:
        """Algorithm 4.7: pairs seen last time, then those that were not, then what is new."""
        self.counts.rays += len(rays)
        if not len(rays):
            return
        front = front or VisibilityFront()
        front.begin(len(rays))
        cast = self._prepared(np.ascontiguousarray(rays), nearest, take)
        visible = front.visible()
        # Nodes that would have to be read wait for new pairs of theirs, so that a cast reads each
        # of them once; whether their rays still meet them is asked again before.
        kept = np.array([int(node) in self.cache for node in front.pairs[visible, NODE]], np.bool_)
        self._intersect(cast, front, visible[kept])
        waiting = np.concatenate([front.unknown(), self._turned_visible(cast, front)])
        self._refine(cast, front, waiting, visible[~kept])
        self._recheck(cast, front, visible)
        front.pull_up()
        self.counts.bytes_read = self.cache.bytes_read

    def _prepared(
        self,
        rays: NDArray[np.float32],
        nearest: NDArray[np.float32],
        take: Callable[[EmbreeScene, NDArray[np.float32], NDArray[np.int64]], None],
    ) -> _Cast:
        tiles = ray_tiles(len(rays), self.options.smallest_tile)
        direction = np.ascontiguousarray(rays[:, 3:].T)
        with np.errstate(divide="ignore", over="ignore"):
            inverse = np.clip(np.float32(1.0) / direction, -_LARGEST_INVERSE, _LARGEST_INVERSE)
        # Rays are held against boxes in float32, whose steps grow with what is subtracted.
        farthest = float(np.abs(rays[:, :3]).max(initial=0.0, where=np.isfinite(rays[:, :3])))
        boxes = self._tree.boxes(1e-6 * (1.0 + farthest))
        middle = np.minimum(tiles.slices.sum(axis=1) // 2, len(rays) - 1)
        origins = np.ascontiguousarray(rays[:, :3].T)
        middles = rays[middle, :3].copy()
        return _Cast(rays, origins, inverse, nearest, tiles, middles, boxes, take)

    def _turned_visible(self, cast: _Cast, front: VisibilityFront) -> NDArray[np.int32]:
        """Rows of pairs culled last time that have to be asked one by one: multi-queries."""
        rows = front.invisible()
        if not len(rows):
            return rows
        tiles, nodes = front.tiles_and_nodes(rows)
        starts = np.concatenate([[0], 1 + np.flatnonzero(np.diff(tiles)), [len(tiles)]])
        turned = visible_groups(
            cast.origins, cast.inverse, cast.nearest, cast.tiles.slices, starts,
            tiles[starts[:-1]], nodes, cast.boxes, self._tree.children, self._ends,
            self.options.threshold,
        )  # fmt: skip
        self.counts.queries += len(turned)
        some: NDArray[np.int32] = rows[np.repeat(turned, np.diff(starts))]
        front.pairs[some, STATE] = UNKNOWN
        return some

    def _refine(
        self,
        cast: _Cast,
        front: VisibilityFront,
        waiting: NDArray[np.int32],
        unread: NDArray[np.int32],
    ) -> None:
        """Ask pairs and divide them; what is found is cast, with the visible pairs ``unread``."""
        keys = np.zeros(len(front.pairs), np.float32)
        queue = np.zeros(len(front.pairs), np.int32)
        tiles, nodes = front.tiles_and_nodes(waiting)
        size = 0
        for row, tile, node in zip(waiting, tiles, nodes, strict=True):
            key = box_distance(cast.middles[tile], cast.boxes[node])
            size = push(keys, queue, size, key, row)
        found = np.zeros(self.options.found_at_once, np.int32)
        while size:
            front.make_room()
            more = len(front.pairs) - len(keys)
            keys, queue = np.pad(keys, (0, more)), np.pad(queue, (0, more))
            front.count, size, hits, queries = refine_pairs(
                front.pairs, front.count, keys, queue, size, cast.origins, cast.inverse,
                cast.nearest, cast.tiles.slices, cast.tiles.quarters, cast.middles,
                cast.tiles.shares, cast.boxes, self._tree.children, self._ends,
                self._tree.shares, self.options.balance, self.options.threshold, found,
            )  # fmt: skip
            self.counts.queries += queries
            self._intersect(cast, front, np.concatenate([unread, found[:hits]]))
            unread = unread[:0]
        self._intersect(cast, front, unread)

    def _recheck(self, cast: _Cast, front: VisibilityFront, visible: NDArray[np.int32]) -> None:
        """Ask a share of the pairs that were visible before whether they still are."""
        every = self.options.recheck_every
        rows = visible[(visible + front.casts) % every == 0]
        if not len(rows):
            return
        tiles, nodes = front.tiles_and_nodes(rows)
        still = visible_groups(
            cast.origins, cast.inverse, cast.nearest, cast.tiles.slices, np.arange(len(rows) + 1),
            tiles, nodes, cast.boxes, self._tree.children, self._ends, self.options.threshold,
        )  # fmt: skip
        self.counts.queries += len(rows)
        front.pairs[rows[~still], STATE] = INVISIBLE

    def _intersect(self, cast: _Cast, front: VisibilityFront, rows: NDArray[np.int32]) -> None:
        """Cast the rays of pairs, all tiles of a node at once: nodes in memory, then near ones."""
        if not len(rows):
            return
        tiles, nodes = front.tiles_and_nodes(rows)
        order = np.lexsort((tiles, nodes))
        tiles, nodes = tiles[order], nodes[order]
        starts = np.concatenate([[0], 1 + np.flatnonzero(np.diff(nodes))])
        groups = []
        for node, some in zip(nodes[starts], np.split(tiles, starts[1:]), strict=True):
            distance = min(box_distance(cast.middles[tile], cast.boxes[node]) for tile in some)
            groups.append((int(node) not in self.cache, distance, int(node), some))
        for _, _, node, some in sorted(groups, key=lambda group: group[:3]):
            self._intersect_node(cast, node, cast.tiles.slices[some])

    def _intersect_node(self, cast: _Cast, node: int, slices: NDArray[np.int64]) -> None:
        count = int((slices[:, 1] - slices[:, 0]).sum())
        gathered, numbers = np.empty((count, 6), np.float32), np.empty(count, np.int64)
        count = gather_rays(
            cast.rays, cast.origins, cast.inverse, cast.nearest, slices, cast.boxes[node],
            gathered, numbers,
        )  # fmt: skip
        # What was cast before may hide the node from all its rays: it is not even read then.
        if count:
            cast.take(self.cache.scene(node), gathered[:count], numbers[:count])
            self.counts.casts += 1
            self.counts.rays_cast += count
