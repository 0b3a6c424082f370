"""Closing a surface that runs out of the solver's cube.

Where nothing was scanned from below, say, the reconstruction goes on to the wall of its
cube and ends there. It is cut at the samples' own box and the cut is closed by a flat cap.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from itertools import pairwise

import mapbox_earcut
import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh

Point3 = NDArray[np.float64]
# Deviation from a plane, relative to the loop's size, below which a loop counts as flat.
_FLAT = 1e-6


def closed_at_box(mesh: TriangleMesh, low: Point3, high: Point3) -> TriangleMesh:
    """The part of an open mesh inside the box (``low``, ``high``), its openings capped.

    Returns
    -------
    A mesh without attributes. The caps carry no more vertices than the openings had, save one
    in the middle of an opening that goes round an edge of the box.
    """
    for axis in range(3):
        for side, limit in ((-1.0, -low[axis]), (1.0, high[axis])):
            mesh = clipped(mesh, side * np.eye(3)[axis], float(limit))
    return capped(mesh)


def clipped(mesh: TriangleMesh, normal: Point3, offset: float) -> TriangleMesh:
    """The part of a mesh where ``normal · x ≤ offset``; crossing triangles are cut."""
    height = mesh.vertices @ normal - offset
    if not (height > 0.0).any():
        return mesh
    # A vertex on the plane would be cut into triangles without area.
    scale = float(np.abs(height).max())
    height = np.where(np.abs(height) < 1e-9 * scale, -1e-9 * scale, height)
    above = height > 0.0
    count = above[mesh.triangles].sum(axis=1)
    kept = mesh.triangles[count == 0].astype(np.int64)
    crossing = mesh.triangles[(count == 1) | (count == 2)].astype(np.int64)
    # Turn each so that the vertex alone on its side comes first.
    lone_above = above[crossing].sum(axis=1) == 1
    alone = np.argmax(above[crossing] == lone_above[:, None], axis=1)
    turned = np.take_along_axis(crossing, (alone[:, None] + np.arange(3)) % 3, axis=1)
    a, b, c = turned.T
    edges = np.sort(np.concatenate([np.stack([a, b], 1), np.stack([a, c], 1)]), axis=1)
    unique, place = np.unique(edges, axis=0, return_inverse=True)
    u, v = unique.T
    share = (height[u] / (height[u] - height[v]))[:, None] if len(unique) else np.zeros((0, 1))
    cuts = mesh.vertices[u] + share * (mesh.vertices[v] - mesh.vertices[u])
    place = place.ravel() + len(mesh.vertices)
    ab, ac = place[: len(a)], place[len(a) :]
    top, bottom = lone_above, ~lone_above
    pieces = [
        kept,
        np.stack([a, ab, ac], 1)[bottom],
        np.stack([ab, b, c], 1)[top],
        np.stack([ab, c, ac], 1)[top],
    ]
    triangles = np.concatenate(pieces).astype(np.int32)
    whole = TriangleMesh(np.concatenate([mesh.vertices, cuts]), triangles)
    return whole.keep_triangles(np.ones(len(triangles), bool))


def capped(mesh: TriangleMesh) -> TriangleMesh:
    """The mesh with every opening closed; flat openings may lie inside each other."""
    caps: list[NDArray[np.int64]] = []
    round_edges: list[NDArray[np.int64]] = []
    flat: dict[tuple[int, float], list[NDArray[np.int64]]] = {}
    size = float(np.ptp(mesh.vertices, axis=0).max()) if len(mesh.vertices) else 0.0
    for loop in boundary_loops(mesh.triangles):
        points = mesh.vertices[loop]
        axis = _flat_axis(points)
        if axis is None:
            round_edges.append(loop)
            continue
        height = float(points[:, axis].mean())
        planes = (p for p in flat if p[0] == axis and abs(p[1] - height) <= _FLAT * size)
        flat.setdefault(next(planes, (axis, height)), []).append(loop)
    for (axis, _), loops in flat.items():
        found, unclosed = _flat_caps(mesh, loops, axis)
        caps += found
        round_edges += unclosed
    # Round an edge of the box: a fan about the middle closes it all the same.
    middles = [mesh.vertices[loop].mean(axis=0, keepdims=True) for loop in round_edges]
    for middle, loop in enumerate(round_edges, start=len(mesh.vertices)):
        caps.append(np.stack([np.roll(loop, -1), loop, np.full(len(loop), middle)], axis=1))
    triangles = np.concatenate([mesh.triangles, *caps]).astype(np.int32)
    return TriangleMesh(np.concatenate([mesh.vertices, *middles]), triangles)


def boundary_loops(triangles: NDArray[np.int32]) -> list[NDArray[np.int64]]:
    """Closed loops of the edges with one face, in the direction of that face.

    No loop passes a vertex twice: where openings touch they are told apart.
    """
    edges = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).astype(np.int64)
    span = int(edges.max(initial=0)) + 1
    forward, backward = edges[:, 0] * span + edges[:, 1], edges[:, 1] * span + edges[:, 0]
    open_edges = edges[~np.isin(forward, backward)]
    following: dict[int, list[int]] = {}
    for start, end in open_edges.tolist():
        following.setdefault(start, []).append(end)
    loops = []
    for start in sorted(following):
        path, place = [start], {start: 0}
        while following.get(path[-1]):
            end = following[path[-1]].pop()
            if end not in place:
                place[end] = len(path)
                path.append(end)
                continue
            at = place[end]
            loops.append(np.array(path[at:], np.int64))
            for vertex in path[at + 1 :]:
                del place[vertex]
            del path[at + 1 :]
    return loops


def _flat_axis(points: Point3) -> int | None:
    """The axis a loop is constant along, None when it is not flat on a box face."""
    spread = np.ptp(points, axis=0)
    axis = int(np.argmin(spread))
    return axis if spread[axis] <= _FLAT * max(float(spread.max()), 1e-300) else None


def _flat_caps(
    mesh: TriangleMesh, loops: Sequence[NDArray[np.int64]], axis: int
) -> tuple[list[NDArray[np.int64]], list[NDArray[np.int64]]]:
    """Triangles over all loops in one plane, holes spared (ear clipping).

    Returns
    -------
    The caps, and the loops that ear clipping cannot close: those that cross themselves or
    whose caps would run along an edge of the mesh.
    """
    u, v = (axis + 1) % 3, (axis + 2) % 3
    plane = [mesh.vertices[loop][:, [u, v]] for loop in loops]
    area = [_signed_area(points) for points in plane]
    # Outlines and holes wind against each other; the widest loop is an outline.
    sign = np.sign(area[int(np.argmax(np.abs(area)))])
    outlines = [k for k in range(len(loops)) if np.sign(area[k]) == sign]
    holes: dict[int, list[int]] = {k: [] for k in outlines}
    for k in range(len(loops)):
        if k in holes:
            continue
        around = [o for o in outlines if _inside(plane[k][0], plane[o])]
        if around:
            holes[min(around, key=lambda o: abs(area[o]))].append(k)
        else:
            holes[k] = []
    caps, unclosed = [], []
    for outline, inner in holes.items():
        rings = [outline, *inner]
        points = np.concatenate([plane[k] for k in rings])
        ends = np.cumsum([len(plane[k]) for k in rings]).astype(np.uint32)
        index = np.concatenate([loops[k] for k in rings])
        corner = mapbox_earcut.triangulate_float64(points, ends).reshape(-1, 3).astype(np.int64)
        # The cap runs through each open edge against the face that is there.
        cap_area = sum(_signed_area(points[t]) for t in corner)
        if np.sign(cap_area) == np.sign(area[outline]):
            corner = corner[:, ::-1]
        following = np.arange(1, len(points) + 1)
        following[ends - 1] = [0, *ends[:-1]]
        closed = _through_every_point(points, corner, following)
        if closed is None or _runs_along(index[closed], mesh.triangles):
            unclosed += [loops[k] for k in rings]
        else:
            caps.append(index[closed])
    return caps, unclosed


def _runs_along(cap: NDArray[np.int64], triangles: NDArray[np.int32]) -> bool:
    """Whether an edge of the mesh is also an edge between two triangles of its cap."""
    touching = np.isin(triangles, cap).sum(axis=1) >= 2
    there, here = _directed(triangles[touching].astype(np.int64)), _directed(cap)
    return any((b, a) in here and ((a, b) in there or (b, a) in there) for a, b in here)


def _through_every_point(
    points: NDArray[np.float64], triangles: NDArray[np.int64], following: NDArray[np.int64]
) -> NDArray[np.int64] | None:
    """Triangles split at the points that ear clipping passed over.

    Ear clipping leaves out points in line with their neighbours; the faces beside the cap
    would stay open there.

    Parameters
    ----------
    points : (n, 2) of all rings.
    triangles : (m, 3), running against the rings.
    following : (n,) the next point on the ring of each.

    Returns
    -------
    Triangles with every ring edge among theirs, or None where that is out of reach.
    """
    wanted = {(int(end), start) for start, end in enumerate(following)}
    edges = _directed(triangles)
    loose = {(a, b) for a, b in edges if (b, a) not in edges} - wanted
    passed = np.unique(np.array([*wanted - edges.keys(), *loose], np.int64).reshape(-1))
    between = {edge: _in_line(points, *edge, passed) for edge in loose}

    def split(a: int, b: int, c: int) -> list[tuple[int, int, int]]:
        for first, second, third in ((a, b, c), (b, c, a), (c, a, b)):
            inner = between.get((first, second))
            if inner:
                path = [first, *inner, second]
                pieces = [split(p, q, third) for p, q in pairwise(path)]
                return [piece for part in pieces for piece in part]
        return [(a, b, c)]

    whole = [piece for a, b, c in triangles.tolist() for piece in split(a, b, c)]
    result = np.array(whole, np.int64).reshape(-1, 3)
    edges = _directed(result)
    rim = {(a, b) for a, b in edges if (b, a) not in edges}
    return result if rim == wanted and max(edges.values(), default=1) == 1 else None


def _directed(triangles: NDArray[np.int64]) -> Counter[tuple[int, int]]:
    """How often each directed edge occurs."""
    pairs = triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2).tolist()
    return Counter((a, b) for a, b in pairs)


def _in_line(points: NDArray[np.float64], a: int, b: int, among: NDArray[np.int64]) -> list[int]:
    """Those of ``among`` between points a and b and in line with them, from a to b."""
    way, offset = points[b] - points[a], points[among] - points[a]
    length = float(way @ way)
    along = offset @ way
    across = np.abs(offset[:, 0] * way[1] - offset[:, 1] * way[0])
    inside = (along > 0) & (along < length) & (across <= 1e-12 * length) & (among != a)
    inside &= among != b
    return [int(k) for k in among[inside][np.argsort(along[inside])]]


def _signed_area(points: NDArray[np.float64]) -> float:
    x, y = points.T
    return 0.5 * float(np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y))


def _inside(point: NDArray[np.float64], polygon: NDArray[np.float64]) -> bool:
    """Even-odd test of a point (2,) against a closed polygon (n, 2)."""
    x, y = polygon.T
    x2, y2 = np.roll(x, -1), np.roll(y, -1)
    crosses = (y > point[1]) != (y2 > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        at = x + (point[1] - y) / (y2 - y) * (x2 - x)
    return bool(np.count_nonzero(crosses & (point[0] < at)) % 2)
