"""Closed parametric meshes: boxes, tubes, lathed and swept bodies, and their collection."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from workbench.geometry.mesh import TriangleMesh


def box(low: ArrayLike, high: ArrayLike) -> TriangleMesh:
    """The closed box between two corners (3,): 8 vertices, 12 triangles."""
    corners = np.stack([np.asarray(low, float), np.asarray(high, float)])
    pick = np.array([[i, j, k] for i in (0, 1) for j in (0, 1) for k in (0, 1)])
    vertices = np.take_along_axis(corners, pick, axis=0)
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return TriangleMesh(vertices, _quads_to_triangles(np.array(quads)))


def prism(profile: ArrayLike, axis_start: float, axis_end: float) -> TriangleMesh:
    """A convex (x, z) profile (n, 2), counter-clockwise seen from −y, extruded along y."""
    outline = np.asarray(profile, float)
    n = len(outline)
    near = np.stack([outline[:, 0], np.full(n, axis_start), outline[:, 1]], axis=1)
    far = near + np.array([0.0, axis_end - axis_start, 0.0])
    ring = np.arange(n)
    after = (ring + 1) % n
    sides = np.stack([ring, ring + n, after + n, after], axis=1)
    fan = np.stack([np.zeros(n - 2, int), ring[1:-1], ring[2:]], axis=1)
    triangles = np.concatenate([_quads_to_triangles(sides), fan, fan[:, ::-1] + n])
    return TriangleMesh(np.concatenate([near, far]), triangles.astype(np.int32))


def tube(path: ArrayLike, radii: ArrayLike, sides: int = 16) -> TriangleMesh:
    """A capped round tube along (n, 3) points with one radius or one per point, metres."""
    centers = np.asarray(path, float)
    radius = np.broadcast_to(np.asarray(radii, float), (len(centers),))
    turn = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    tangent = np.gradient(centers, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.eye(3)[np.abs(tangent[0]).argmin()]
    rings = []
    for center, along, r in zip(centers, tangent, radius, strict=True):
        # Carrying the side over from ring to ring keeps the tube from twisting.
        side = side - (side @ along) * along
        side /= np.linalg.norm(side)
        up = np.cross(along, side)
        rings.append(center + r * (np.cos(turn)[:, None] * side + np.sin(turn)[:, None] * up))
    return _capped(np.stack(rings), centers[0], centers[-1])


def lathed(profile: ArrayLike, sides: int, flutes: tuple[int, float] = (0, 0.0)) -> TriangleMesh:
    """A body of revolution about z from (radius, height) pairs (n, 2), bottom to top.

    ``flutes`` is how many grooves run up the body and how deep they are relative to the radius.
    """
    outline = np.asarray(profile, float)
    turn = np.linspace(0.0, 2.0 * np.pi, sides, endpoint=False)
    groove = 1.0 - flutes[1] * np.abs(np.sin(0.5 * flutes[0] * turn))
    radius = outline[:, :1] * groove
    rings = np.stack(
        [
            radius * np.cos(turn),
            radius * np.sin(turn),
            np.broadcast_to(outline[:, 1:], radius.shape),
        ],
        axis=-1,
    )
    return _capped(rings, np.array([0, 0, outline[0, 1]]), np.array([0, 0, outline[-1, 1]]))


def band(outline: ArrayLike, thickness: float, low: float, high: float) -> TriangleMesh:
    """A closed strap round a convex (x, y) outline (n, 2), counter-clockwise from above.

    The strap's inner face is the outline itself; it reaches from height ``low`` to ``high``.
    """
    inner = np.asarray(outline, float)
    tangent = np.roll(inner, -1, axis=0) - np.roll(inner, 1, axis=0)
    outward = np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    outward /= np.linalg.norm(outward, axis=1, keepdims=True)
    outer = inner + thickness * outward
    n = len(inner)
    section = [(inner, low), (outer, low), (outer, high), (inner, high)]
    vertices = np.concatenate([np.column_stack([edge, np.full(n, z)]) for edge, z in section])
    place = np.arange(n)
    after = (place + 1) % n
    quads = [
        np.stack(
            [place + n * k, after + n * k, after + n * ((k + 1) % 4), place + n * ((k + 1) % 4)],
            axis=1,
        )
        for k in range(4)
    ]
    return TriangleMesh(vertices, _quads_to_triangles(np.concatenate(quads)))


def geodesic_sphere(center: ArrayLike, radius: float, subdivisions: int) -> TriangleMesh:
    """A sphere from an icosahedron whose faces are quartered ``subdivisions`` times."""
    golden = (1 + 5**0.5) / 2
    vertices = np.array(
        [[-1, golden, 0], [1, golden, 0], [-1, -golden, 0], [1, -golden, 0],
         [0, -1, golden], [0, 1, golden], [0, -1, -golden], [0, 1, -golden],
         [golden, 0, -1], [golden, 0, 1], [-golden, 0, -1], [-golden, 0, 1]]
    )  # fmt: skip
    faces = np.array(
        [[0, 11, 5], [0, 5, 1], [0, 1, 7], [0, 7, 10], [0, 10, 11], [1, 5, 9], [5, 11, 4],
         [11, 10, 2], [10, 7, 6], [7, 1, 8], [3, 9, 4], [3, 4, 2], [3, 2, 6], [3, 6, 8],
         [3, 8, 9], [4, 9, 5], [2, 4, 11], [6, 2, 10], [8, 6, 7], [9, 8, 1]]
    )  # fmt: skip
    for _ in range(subdivisions):
        edges = np.sort(faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        unique, index = np.unique(edges, axis=0, return_inverse=True)
        middle = index.reshape(-1, 3) + len(vertices)
        vertices = np.concatenate([vertices, vertices[unique].sum(axis=1) / 2])
        vertices /= np.linalg.norm(vertices, axis=1, keepdims=True)
        a, b, c = faces.T
        ab, bc, ca = middle.T
        faces = np.concatenate(
            [
                np.stack(corner, axis=1)
                for corner in ((a, ab, ca), (b, bc, ab), (c, ca, bc), (ab, bc, ca))
            ]
        )
    vertices = vertices / np.linalg.norm(vertices, axis=1, keepdims=True)
    return TriangleMesh(np.asarray(center, float) + radius * vertices, faces.astype(np.int32))


def height_field_slab(
    x: NDArray[np.float64],
    y: NDArray[np.float64],
    height: NDArray[np.float64],
    thickness: float,
) -> TriangleMesh:
    """A closed sheet of constant vertical thickness about heights (len(x), len(y))."""
    gx, gy = np.meshgrid(x, y, indexing="ij")
    top = np.stack([gx, gy, height + 0.5 * thickness], axis=-1).reshape(-1, 3)
    bottom = top - np.array([0.0, 0.0, thickness])
    n, m = height.shape
    index = np.arange(n * m).reshape(n, m)
    quads = np.stack(
        [index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]], axis=-1
    ).reshape(-1, 4)
    rim = np.concatenate([index[:, 0], index[-1, 1:], index[-2::-1, -1], index[0, -2:0:-1]])
    after = np.roll(rim, -1)
    sides = np.stack([rim + n * m, after + n * m, after, rim], axis=1)
    upper = _quads_to_triangles(quads)
    # The same diagonals below as above keep the thickness constant.
    lower = upper[:, ::-1] + n * m
    return TriangleMesh(
        np.concatenate([top, bottom]),
        np.concatenate([upper, lower, _quads_to_triangles(sides)]).astype(np.int32),
    )


def moved(mesh: TriangleMesh, target_from_mesh: NDArray[np.float64]) -> TriangleMesh:
    """The mesh with its vertices taken through a rigid 4×4 transform."""
    vertices = mesh.vertices @ target_from_mesh[:3, :3].T + target_from_mesh[:3, 3]
    return TriangleMesh(vertices, mesh.triangles, mesh.vertex_attributes)


def collected(meshes: Sequence[TriangleMesh]) -> TriangleMesh:
    """All meshes as one, in order; attributes that every mesh has are kept."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    names = set.intersection(*(set(mesh.vertex_attributes) for mesh in meshes))
    return TriangleMesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate(
            [mesh.triangles + start for mesh, start in zip(meshes, starts, strict=True)]
        ).astype(np.int32),
        {
            name: np.concatenate([mesh.vertex_attributes[name] for mesh in meshes])
            for name in sorted(names)
        },
    )


def _quads_to_triangles(quads: NDArray[np.int64]) -> NDArray[np.int32]:
    return np.concatenate([quads[:, [0, 1, 2]], quads[:, [0, 2, 3]]]).astype(np.int32)


def _capped(
    rings: NDArray[np.float64], start: NDArray[np.float64], end: NDArray[np.float64]
) -> TriangleMesh:
    """Rings (n, k, 3), counter-clockwise about the way from start to end, with closed ends."""
    n, k, _ = rings.shape
    index = np.arange(n * k).reshape(n, k)
    after = np.roll(index, -1, axis=1)
    quads = np.stack([index[:-1], after[:-1], after[1:], index[1:]], axis=-1).reshape(-1, 4)
    first, last = n * k, n * k + 1
    bottom = np.stack([np.full(k, first), after[0], index[0]], axis=1)
    top = np.stack([np.full(k, last), index[-1], after[-1]], axis=1)
    return TriangleMesh(
        np.concatenate([rings.reshape(-1, 3), start[None], end[None]]),
        np.concatenate([_quads_to_triangles(quads), bottom, top]).astype(np.int32),
    )
