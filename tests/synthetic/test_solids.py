from __future__ import annotations

import numpy as np
import pytest

from workbench.geometry.mesh import TriangleMesh, edge_census, face_normals_and_areas
from workbench.synthetic import solids

CIRCLE = np.linspace(0, 2 * np.pi, 400, endpoint=False)


def volume(mesh: TriangleMesh) -> float:
    a, b, c = (mesh.vertices[mesh.triangles[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize(
    ("mesh", "expected"),
    [
        (solids.box((1, 2, 3), (2, 4, 6)), 6.0),
        (solids.prism([(0, 0), (1, 0), (0, 1)], -1.0, 1.0), 1.0),
        (solids.tube([(0, 0, 0), (0, 0, 2)], 0.5, 400), 0.5 * np.pi),
        (solids.lathed([(1, 0), (0.5, 3)], 400), np.pi * (1 + 0.5 + 0.25)),
        (
            solids.band(np.column_stack([np.cos(CIRCLE), np.sin(CIRCLE)]), 0.1, 0.0, 2.0),
            2 * np.pi * (1.21 - 1.0),
        ),
        (solids.geodesic_sphere((5, 0, 0), 2.0, 5), 4 / 3 * np.pi * 8),
        (
            solids.height_field_slab(
                np.linspace(0, 2, 9),
                np.linspace(0, 1, 5),
                np.random.default_rng(0).random((9, 5)),
                0.1,
            ),
            0.2,
        ),
    ],
    ids=["box", "prism", "tube", "lathed", "band", "sphere", "slab"],
)
def test_bodies_are_closed_face_outward_and_have_their_volume(
    mesh: TriangleMesh, expected: float
) -> None:
    assert edge_census(mesh.triangles).watertight
    assert face_normals_and_areas(mesh)[1].min() > 0
    assert volume(mesh) == pytest.approx(expected, rel=2e-3)


def test_a_bent_tube_keeps_its_radius() -> None:
    turn = np.linspace(0, 1.5 * np.pi, 80)
    path = np.column_stack([np.cos(turn), np.sin(turn), 0.3 * turn])
    mesh = solids.tube(path, 0.1, 24)
    rings = mesh.vertices[:-2].reshape(80, 24, 3)
    assert np.allclose(np.linalg.norm(rings - path[:, None], axis=2), 0.1)
    assert edge_census(mesh.triangles).watertight


def test_collecting_keeps_common_attributes_and_every_face() -> None:
    one = solids.box((0, 0, 0), (1, 1, 1)).with_attributes(a=np.zeros(8), b=np.ones(8))
    two = solids.box((2, 0, 0), (3, 1, 1)).with_attributes(a=np.ones(8))
    both = solids.collected([one, two])
    assert edge_census(both.triangles).watertight
    assert list(both.vertex_attributes) == ["a"]
    assert both.vertex_attributes["a"].tolist() == [0.0] * 8 + [1.0] * 8
    assert volume(both) == pytest.approx(2.0)
