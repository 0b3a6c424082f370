"""Bodies that fit nearly as well turned by a half or a quarter."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from workbench.geometry.mesh import TriangleMesh, face_normals_and_areas
from workbench.geometry.similarity import Similarity
from workbench.geometry.surface_sampling import sample_surface
from workbench.orientation.sparse_points import SparsePoints
from workbench.orientation.surface_search import ShapeFit, fit_by_shape


def house(*, porch: bool) -> TriangleMesh:
    """Walls and roof of 30 × 20 × 9 m; a porch of 8 × 3 × 6 m before one long side."""
    parts = [trimesh.creation.box((30.0, 20.0, 9.0))]
    if porch:
        parts.append(
            trimesh.creation.box(
                (8.0, 3.0, 6.0), trimesh.transformations.translation_matrix((0.0, -11.5, -1.5))
            )
        )
    solid = trimesh.util.concatenate([part.subdivide().subdivide() for part in parts])
    return TriangleMesh(np.asarray(solid.vertices), np.asarray(solid.faces, np.int32))


def seen(mesh: TriangleMesh, rng: np.random.Generator) -> SparsePoints:
    """Points as photographs taken around it find them: none below, a few that are nowhere."""
    places, triangles, _ = sample_surface(mesh, 6000, seed=int(rng.integers(1000)))
    normals = face_normals_and_areas(mesh)[0][triangles]
    shown = normals[:, 2] > -0.5
    places, normals = places[shown], normals[shown]
    places = places + rng.normal(0.0, 0.02, places.shape)
    stray = rng.random(len(places)) < 0.01
    places[stray] += rng.normal(0.0, 3.0, (int(stray.sum()), 3))
    return SparsePoints(np.arange(len(places)), places, normals)


@pytest.mark.parametrize("seed", range(3))
def test_a_porch_tells_which_way_round_a_house_stands(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mesh = house(porch=True)
    points = seen(mesh, rng)
    turn = Rotation.random(random_state=seed).as_matrix()
    model_from_surface = Similarity(0.07, turn, rng.normal(0.0, 5.0, 3))
    model = SparsePoints(
        points.ids, model_from_surface.apply(points.points), points.outward @ turn.T
    )
    found = fit_by_shape(model, mesh)
    assert isinstance(found, ShapeFit), found.reason
    back = found.surface_from_model.apply(model_from_surface.apply(mesh.vertices))
    assert np.linalg.norm(back - mesh.vertices, axis=1).max() < 0.5


@pytest.mark.parametrize("count", [1500, 6000])
def test_copies_of_points_neither_stop_nor_trouble_the_search(count: int) -> None:
    mesh = house(porch=True)
    all_of_them = seen(mesh, np.random.default_rng(1))
    # Few different points, some of them many times.
    points = all_of_them.chosen(np.arange(count) % 1000)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = fit_by_shape(points, mesh)
    # So few of them lie too far from most of the surface to claim a fit.
    assert "the best fit leaves" in found.reason


def test_without_one_no_way_round_is_claimed() -> None:
    rng = np.random.default_rng(0)
    mesh = house(porch=False)
    found = fit_by_shape(seen(mesh, rng), mesh)
    assert not found
    assert "more than one way" in found.reason
