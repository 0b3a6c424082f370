from __future__ import annotations

import numpy as np
import pytest
from bodies import sphere_samples, volume

from workbench.errors import InputError
from workbench.geometry.mesh import edge_census
from workbench.surface.poisson import (
    PoissonSettings,
    cell_size_m,
    depth_for_spacing,
    reconstruct,
)

SAMPLES = sphere_samples(4000)
DEPTH = PoissonSettings(5)


def box(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points.min(axis=0), points.max(axis=0)


def test_a_sphere_comes_back_closed_round_and_facing_outwards() -> None:
    mesh = reconstruct(SAMPLES.points, SAMPLES.normals, DEPTH)
    assert edge_census(mesh.triangles).watertight
    assert mesh.triangles.dtype == np.int32
    error = np.linalg.norm(mesh.vertices, axis=1) - 1.0
    assert np.sqrt(np.mean(error**2)) < 0.1 * cell_size_m(*box(SAMPLES.points), 5)
    assert volume(mesh) == pytest.approx(4 / 3 * np.pi, rel=0.01)


def test_one_thread_gives_the_same_bits_twice() -> None:
    first = reconstruct(SAMPLES.points, SAMPLES.normals, DEPTH)
    second = reconstruct(SAMPLES.points, SAMPLES.normals, DEPTH)
    assert np.array_equal(first.vertices, second.vertices)
    assert np.array_equal(first.triangles, second.triangles)


@pytest.mark.parametrize(("scale", "offset"), [(1e-3, 0.0), (1e3, 5e6)])
def test_neither_place_nor_size_matter(scale: float, offset: float) -> None:
    here = reconstruct(SAMPLES.points, SAMPLES.normals, DEPTH)
    there = reconstruct(SAMPLES.points * scale + offset, SAMPLES.normals, DEPTH)
    back = (there.vertices - offset) / scale
    radius = np.linalg.norm(back, axis=1)
    assert edge_census(there.triangles).watertight
    assert abs(len(back) - len(here.vertices)) < 0.02 * len(back)
    assert np.abs(radius - 1).max() < 1.1 * np.abs(np.linalg.norm(here.vertices, axis=1) - 1).max()


@pytest.mark.parametrize(
    ("spacing", "depth"), [(1.1 / 2**7, 7), (1.1 / 2**9, 9), (1.0, 5), (1.1 / 2**15, 15)]
)
def test_the_finest_cell_is_about_one_spacing(spacing: float, depth: int) -> None:
    points = np.array([[0, 0, 0], [1, 0.5, 0.2]])
    assert depth_for_spacing(*box(points), spacing) == depth
    if depth > 5:
        assert 0.5 < cell_size_m(*box(points), depth) / spacing <= 1.2


def test_samples_that_make_no_surface_are_refused() -> None:
    points, normals = SAMPLES.points[:20].copy(), SAMPLES.normals[:20]
    with pytest.raises(InputError, match="too few"):
        reconstruct(points[:9], normals[:9], DEPTH)
    with pytest.raises(InputError, match="one place"):
        reconstruct(np.ones((20, 3)), normals, DEPTH)
    points[3, 1] = np.nan
    with pytest.raises(InputError, match="usable"):
        reconstruct(points, normals, DEPTH)
