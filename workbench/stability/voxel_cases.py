"""Voxels of triangles that are needles, points, or lie exactly where cells meet."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.stability.case import Bound, Case, Measured, Refused
from workbench.voxels.dag_decoding import DagWalk
from workbench.voxels.dag_encoding import ENCODINGS, encoded
from workbench.voxels.dag_reading import dag_of
from workbench.voxels.dag_reduction import reduced_dag
from workbench.voxels.graph_export import reduced_for
from workbench.voxels.voxel_set import VoxelGrid, grid_of_mesh
from workbench.voxels.voxelisation import triangle_census, voxel_parts, voxelise

_METHOD = "voxelisation"


def _mesh(vertices: NDArray[np.float64] | list[list[float]]) -> TriangleMesh:
    """Triangles of three vertices each, one after another."""
    points = np.asarray(vertices, float)
    return TriangleMesh(points, np.arange(len(points), dtype=np.int32).reshape(-1, 3))


def _area_error(mesh: TriangleMesh, grid: VoxelGrid) -> Measured:
    """The area in all voxels against that of all triangles; it is exact in the method."""
    total, count, sound = 0.0, 0, True
    for part in voxel_parts(mesh, grid):
        total, count = total + float(part.area.sum()), count + len(part)
        sound = sound and bool(np.isfinite(part.normal).all() and (part.area >= 0.0).all())
    told = f"{count} voxels"
    if not sound:
        return Measured.nothing(f"{told}, some without a number")
    return Measured(abs(total / float(face_normals_and_areas(mesh)[1].sum()) - 1.0), told)


def _slivers() -> Measured:
    """Needles whose length is 1e8 times their width, in all directions."""
    rng = np.random.default_rng(0)
    start, way = rng.uniform(-0.4, 0.4, (200, 3)), rng.standard_normal((200, 3))
    way *= 0.5 / np.linalg.norm(way, axis=1, keepdims=True)
    side = np.cross(way, rng.standard_normal((200, 3)))
    side *= 0.5e-8 / np.linalg.norm(side, axis=1, keepdims=True)
    mesh = _mesh(np.stack([start, start + way, start + side], axis=1).reshape(-1, 3))
    return _area_error(mesh, VoxelGrid(np.full(3, -1.0), 2.0, 7))


def _zero_area() -> Measured:
    """Points and lines among the triangles: they touch no voxel and change none."""
    whole = _mesh([[0.1, 0.1, 0.1], [0.9, 0.1, 0.1], [0.1, 0.9, 0.2]])
    lines = [[0.9, 0.9, 0.9]] * 3 + [[0.0, 0.9, 0.9], [0.5, 0.9, 0.9], [1.0, 0.9, 0.9]]
    both = _mesh(np.concatenate([whole.vertices, lines]))
    grid = VoxelGrid(np.full(3, -1.0), 4.0, 6)
    one, other = voxelise(whole, grid), voxelise(both, grid)
    if triangle_census(both).degenerate != 2:
        return Measured.nothing("triangles without area are not counted as such")
    same = np.array_equal(one.codes, other.codes) and np.array_equal(one.area, other.area)
    return Measured(0.0 if same else 1.0, f"{len(other)} voxels")


def _on_grid_planes() -> Measured:
    """A cube whose faces lie in planes of the grid: half of each face on either side."""
    low, high = -0.5, 0.5
    corners = np.array([[x, y, z] for x in (low, high) for y in (low, high) for z in (low, high)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.array([t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))], np.int32)
    mesh = TriangleMesh(corners, triangles)
    grid = VoxelGrid(np.full(3, -1.0), 2.0, 5)
    found = voxelise(mesh, grid)
    error = _area_error(mesh, grid)
    # The set is its own image in every plane of symmetry of the cube.
    cells = {tuple(cell) for cell in found.cells.tolist()}
    mirrored = {(31 - x, y, z) for x, y, z in cells}, {(x, z, y) for x, y, z in cells}
    inside = found.area[(found.centers > low).all(axis=1) & (found.centers < high).all(axis=1)]
    if any(image != cells for image in mirrored):
        return Measured.nothing("the voxels of a cube are not symmetric")
    return Measured(max(error.value, abs(float(inside.sum()) / 3.0 - 1.0)), error.told)


def _few_voxels() -> Measured:
    """The smallest grid, of two voxels a side, and a triangle in one of them."""
    mesh = _mesh([[0.1, 0.1, 0.1], [0.4, 0.1, 0.1], [0.1, 0.4, 0.2]])
    found = _area_error(mesh, VoxelGrid(np.full(3, -1.0), 2.0, 1))
    return found if found.told == "1 voxels" else Measured.nothing(found.told)


def _one_voxel() -> Measured | Refused:
    mesh = _mesh([[0.1, 0.1, 0.1], [0.4, 0.1, 0.1], [0.1, 0.4, 0.2]])
    return _area_error(mesh, VoxelGrid(np.full(3, -1.0), 2.0, 0))


def _finest(area: float) -> Measured:
    """16384 voxels a side: a triangle of a few voxels, and one across the whole grid."""
    small = [[0.5, 0.5, 0.5], [0.5 + 2e-4, 0.5, 0.5], [0.5, 0.5 + 2e-4, 0.5 + 1e-4]]
    large = [[-0.9, -0.9, -0.9], [-0.9 + area, -0.9, -0.9], [-0.9, -0.9 + area, -0.8]]
    return _area_error(_mesh(small + large), VoxelGrid(np.full(3, -1.0), 2.0, 14))


def _elsewhere(factor: float, shift: float) -> Measured:
    """The same mesh in another unit or at another place has the same voxels.

    Factor and shift are powers of two, which change no digit.
    """
    rng = np.random.default_rng(1)
    vertices = np.round(rng.uniform(-0.5, 0.5, (60, 3)) * 2**20) / 2**20
    here, there = _mesh(vertices), _mesh(factor * vertices + shift)
    one = voxelise(here, grid_of_mesh(here.vertices, 6))
    other = voxelise(there, grid_of_mesh(there.vertices, 6))
    if not np.array_equal(one.codes, other.codes):
        return Measured.nothing(f"{len(other)} voxels, not {len(one)}")
    return Measured(
        float(np.abs(other.area / factor**2 / one.area - 1.0).max()), f"{len(one)} voxels"
    )


def _broken_vertex(value: float) -> Measured | Refused:
    mesh = _mesh([[0.1, 0.1, value], [0.4, 0.1, 0.1], [0.1, 0.4, 0.2]])
    return Measured.nothing(f"{len(voxelise(mesh, VoxelGrid(np.full(3, -1.0), 2.0, 4)))} voxels")


def _graph(codes: NDArray[np.uint64], level: int) -> Measured:
    """A graph of voxels, encoded and read again, gives back the same voxels."""
    wrong = 0
    dag = reduced_dag(codes, level)
    for encoding in ENCODINGS:
        again = DagWalk(dag_of(encoded(reduced_for(dag, encoding), encoding))).codes()
        wrong += not np.array_equal(again, codes)
    return Measured(float(wrong), f"{len(codes)} voxels in {dag.node_count} nodes")


def _case(
    name: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
    method: str = _METHOD,
    quick: bool = True,
) -> Case:
    return Case(f"voxels/{name}", method, stiff, run, bound, refusal, quick)


_AREA = Bound(1e-9, "relative", "triangles are cut exactly: the areas add up but for rounding")
_LOSSLESS = Bound(0.0, "", "the encoding is lossless")

VOXEL_CASES = (
    _case("slivers 1e8:1", "Needles 1e8 times as long as wide.", _slivers,
          Bound(1e-6, "relative", "digits of a width of 5e-9 beside coordinates of 1")),
    _case("zero area", "Points and lines among the triangles.", _zero_area,
          Bound(0.0, "", "voxels and areas are the same to the bit")),
    _case("on grid planes", "Faces exactly where cells meet.", _on_grid_planes, _AREA),
    _case("two voxels a side", "A triangle in one voxel of eight.", _few_voxels, _AREA),
    _case("one voxel", "A grid of one voxel, which has no plane in its middle.", _one_voxel,
          refusal="out of bounds"),
    _case("16384³, in part", "A triangle of a few voxels at the finest resolution, another of "
          "a tenth of its width.", partial(_finest, 0.2), _AREA),
    _case("16384³, across", "A triangle across the whole of the finest grid.",
          partial(_finest, 1.7), _AREA, quick=False),
    _case("scale 2^-20", "A mesh of one micrometre.", partial(_elsewhere, 2.0**-20, 0.0), _AREA),
    _case("scale 2^17", "A mesh of one hundred kilometres.", partial(_elsewhere, 2.0**17, 0.0),
          _AREA),
    _case("UTM offset", "A mesh 4000 km from the origin.", partial(_elsewhere, 1.0, 2.0**22),
          _AREA),
    _case("NaN", "A vertex that is no number.", partial(_broken_vertex, np.nan),
          refusal="not finite"),
    _case("infinite", "A vertex infinitely far away.", partial(_broken_vertex, np.inf),
          refusal="not finite"),
    _case("denormal", "A coordinate of 5e-324.", lambda: _area_error(
        _mesh([[0.1, 0.1, 5e-324], [0.4, 0.1, 0.1], [0.1, 0.4, 0.2]]),
        VoxelGrid(np.full(3, -1.0), 2.0, 5)), _AREA),
    _case("graph of one voxel", "A graph of one voxel in the corner of 16384³.",
          lambda: _graph(np.zeros(1, np.uint64), 14), _LOSSLESS, method="voxel graphs"),
    _case("graph of a full cube", "Every node is the same.",
          lambda: _graph(np.arange(8**5, dtype=np.uint64), 5), _LOSSLESS, method="voxel graphs"),
    _case("graph of dust", "No two nodes are alike.",
          lambda: _graph(np.unique(np.random.default_rng(0).integers(0, 8**10, 20_000)).astype(
              np.uint64), 10), _LOSSLESS, method="voxel graphs"),
)  # fmt: skip
