"""Upper nodes of a tree too large for memory: planned on a sample, filled by a stream."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack
from dataclasses import dataclass
from io import FileIO
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.cloud.row_sources import FileRows, Rows, RowSource, Survey, ahead
from workbench.errors import InputError
from workbench.kernels.layered_kdtree import BY_ORDER, balanced_split, sift, widest_axis


@dataclass(frozen=True)
class UpperNodes:
    """Binary tree whose leaves are buckets.

    Attributes
    ----------
    plan : (k, 3) int32 axis, left, right; a child below 0 is bucket −1 − child.
    splits : (k,) float64; the left child lies below.
    fractions : (k,) float64 share of all samples in each node's region, estimated.
    certainty : (k,) int64 how many samples of the plan that rests on.
    """

    plan: NDArray[np.int32]
    splits: NDArray[np.float64]
    fractions: NDArray[np.float64]
    certainty: NDArray[np.int64]


def planned(found: Survey, bucket_rows: int, most_nodes: int) -> UpperNodes:
    """Split the most populous region at the median of its sample until all fit a bucket.

    ``found`` must not have all its samples in one place.
    """
    sample = found.sample
    regions = [sample]
    plan: list[list[int]] = []
    splits: list[float] = []
    sizes: list[int] = []
    # links[r] is where region r hangs: (node, side)
    links: list[tuple[int, int]] = [(-1, 0)]
    done: list[bool] = [False]
    rows_per_sample = found.count / len(sample)
    while len(plan) < most_nodes:
        open_ = [r for r in range(len(regions)) if not done[r]]
        if not open_:
            break
        largest = max(open_, key=lambda r: len(regions[r]))
        here = regions[largest]
        if plan and len(here) * rows_per_sample <= 0.85 * bucket_rows:
            break
        axis, split = _split(here, found, first=not plan)
        if axis == BY_ORDER:
            done[largest] = True
            continue
        node, (parent, side) = len(plan), links[largest]
        if parent >= 0:
            plan[parent][1 + side] = node
        plan.append([axis, 0, 0])
        splits.append(split)
        sizes.append(len(here))
        left = here[:, axis] < split
        regions[largest], links[largest] = here[left], (node, 0)
        regions.append(here[~left])
        links.append((node, 1))
        done.append(False)
    for bucket, (node, side) in enumerate(links):
        plan[node][1 + side] = -1 - bucket
    counts = np.array(sizes, np.int64)
    return UpperNodes(np.array(plan, np.int32), np.array(splits), counts / len(sample), counts)


def _split(here: NDArray[np.float64], found: Survey, first: bool) -> tuple[int, float]:
    """Axis and value that halve a region's sample; ``BY_ORDER`` where it has one place."""
    if len(here):
        low, high = here.min(axis=0), here.max(axis=0)
        axis = widest_axis(low, high)
        if axis != BY_ORDER:
            values = np.ascontiguousarray(here[:, axis])
            return axis, float(balanced_split(values, low[axis], high[axis]))
    if first:
        # The whole sample coincides but not all rows do: part those from the rest.
        for axis in range(3):
            if found.low[axis] < here[0, axis]:
                return axis, float(here[0, axis])
            if found.high[axis] > here[0, axis]:
                return axis, float(np.nextafter(here[0, axis], np.inf))
    return BY_ORDER, 0.0


@dataclass(frozen=True)
class Parted:
    """What a stream left where.

    Attributes
    ----------
    kept : per upper node (≤ m, words) the rows it keeps.
    buckets : per bucket its file and how many rows it holds.
    """

    kept: list[Rows]
    buckets: list[tuple[FileRows, int]]


def part(
    source: RowSource,
    count: int,
    upper: UpperNodes,
    inner: int,
    folder: Path,
    seed: int,
    progress: Callable[[float], None],
) -> Parted:
    """Send every row to the upper node that keeps it or to the file of its bucket.

    Each upper node keeps ``inner`` random rows of those its ancestors leave.

    Raises
    ------
    InputError
        where the source does not yield ``count`` rows, as it did before.
    """
    nodes = len(upper.plan)
    kept: Rows | None = None
    keys = np.empty((nodes, inner), np.uint64)
    slots = np.empty((nodes, inner), np.int32)
    counts = np.zeros(nodes, np.int64)
    limits = _hash_limits(upper, count, inner)
    totals = np.zeros(nodes + 1, np.int64)
    paths = [folder / f"bucket-{b}" for b in range(nodes + 1)]
    number = 0
    with ExitStack() as stack:
        files = [stack.enter_context(open(p, "wb", buffering=0)) for p in paths]
        pool = stack.enter_context(ThreadPoolExecutor(1))
        writing: Future[None] | None = None
        for rows in ahead(iter(source)):
            if kept is None:
                kept = np.zeros((nodes, inner, rows.shape[1]), np.uint64)
            fallen, starts = sift(
                rows, number, seed, upper.plan, upper.splits, limits, kept, keys, slots, counts
            )
            number += len(rows)
            totals += np.diff(starts)
            if writing is not None:
                writing.result()
            writing = pool.submit(_append, files, fallen, starts)
            progress(number / count)
        if writing is not None:
            writing.result()
    if number != count or kept is None:
        raise InputError(
            "the blocks were not the same when read again",
            expected=f"{count} samples",
            found=f"{number} samples",
            fix="give blocks that can be read twice alike, or an iterator that is read once",
        )
    words = kept.shape[2]
    return Parted(
        [kept[k, : counts[k]] for k in range(nodes)],
        [(FileRows(p, words), int(n)) for p, n in zip(paths, totals, strict=True)],
    )


def _append(files: Sequence[FileIO], fallen: Rows, starts: NDArray[np.int64]) -> None:
    for b, file in enumerate(files):
        if starts[b + 1] > starts[b]:
            piece = fallen[starts[b] : starts[b + 1]].data.cast("B")
            while len(piece):
                piece = piece[file.write(piece) :]


def _hash_limits(upper: UpperNodes, count: int, inner: int) -> NDArray[np.uint64]:
    """(k,) uint64 just above the largest hash each node is expected to keep.

    A node keeps the ``inner`` lowest hashes its ancestors leave of its region, so its hashes
    fill about the next inner / (region's samples) of all hashes after its parent's.
    """
    share = np.zeros(len(upper.plan))
    for node in range(len(upper.plan)):
        margin = 1.0 + 5.0 / np.sqrt(upper.certainty[node]) + 5.0 / np.sqrt(inner)
        share[node] += margin * inner / (upper.fractions[node] * count)
        for child in upper.plan[node, 1:]:
            if child >= 0:
                share[child] = share[node]
    limits = np.full(len(share), np.iinfo(np.uint64).max)
    below = share < 1.0
    limits[below] = (share[below] * 2.0**64).astype(np.uint64)
    return limits
