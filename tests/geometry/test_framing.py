"""Boxes that pictures hold."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry.framing import main_box, main_vertices
from workbench.geometry.mesh import TriangleMesh


def test_of_a_compact_object_everything_is_held() -> None:
    rng = np.random.default_rng(0)
    body = rng.uniform([-1, -1, 0], [1, 1, 6], (5000, 3))
    arm = rng.uniform([1, -0.2, 4], [1.9, 0.2, 4.4], (50, 3))
    points = np.concatenate([body, arm])
    assert main_box(points) == pytest.approx(np.stack([points.min(0), points.max(0)]))
    sheet = np.column_stack([body[:, :2], 1e-3 * body[:, 2]])
    sheet[0, 2] = 0.1
    assert main_box(sheet) == pytest.approx(np.stack([sheet.min(0), sheet.max(0)]))
    assert main_box([[1.0, 2.0, 3.0]]) == pytest.approx(np.array([[1.0, 2.0, 3.0]] * 2))


def test_what_lies_far_behind_is_left_out() -> None:
    rng = np.random.default_rng(1)
    fountain = rng.uniform([-3, -1, 0], [3, 1, 4], (5000, 3))
    behind = rng.uniform([-40, 20, 0], [40, 60, 30], (60, 3))
    low, high = main_box(np.concatenate([fountain, behind]))
    assert (low >= [-6.1, -1.0, 0.0]).all()
    assert (high <= [6.1, 2.1, 6.1]).all()


def test_small_pieces_far_off_are_not_framed_and_those_beside_are(sphere) -> None:
    fountain, wall, bit = sphere(subdivisions=4), sphere(subdivisions=2), sphere(subdivisions=2)
    parts = (
        fountain.vertices,
        wall.vertices * 2.0 + [0.0, 9.0, 0.0],
        bit.vertices * 0.1 + [1.5, 0.0, 0.0],
    )
    starts = np.cumsum([0] + [len(part) for part in parts])
    faces = [
        mesh.triangles + start for mesh, start in zip((fountain, wall, bit), starts, strict=False)
    ]
    mesh = TriangleMesh(np.concatenate(parts), np.concatenate(faces))
    framed = main_vertices(mesh)
    assert framed[: starts[1]].all()
    assert not framed[starts[1] : starts[2]].any()
    assert framed[starts[2] :].all()
    # Two of a size are both the object, however far apart.
    twins = TriangleMesh(
        np.concatenate([fountain.vertices, fountain.vertices + np.array([50.0, 0, 0])]),
        np.concatenate([fountain.triangles, fountain.triangles + starts[1]]),
    )
    assert main_vertices(twins).all()
