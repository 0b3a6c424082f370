from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from workbench.geometry.mesh import TriangleMesh, edge_census, face_normals_and_areas
from workbench.synthetic import OBJECT, SUPPORT, Scene, SimulatedScan
from workbench.synthetic.figure import Posture
from workbench.synthetic.scene import painted
from workbench.synthetic.statue import statue_mesh


def part(scene: Scene, material: int) -> TriangleMesh:
    surface = scene.surface
    return surface.keep_triangles(scene.material[surface.triangles[:, 0]] == material)


def test_statue_is_one_closed_body_and_the_support_is_closed(statue_scene: Scene) -> None:
    statue, support = part(statue_scene, OBJECT), part(statue_scene, SUPPORT)
    for mesh in (statue, support):
        assert edge_census(mesh.triangles).watertight
        assert face_normals_and_areas(mesh)[1].min() > 0
    height = np.ptp(statue.vertices[:, 2])
    assert 1.1 < height < 1.25
    a, b, c = (statue.vertices[statue.triangles[:, k]] for k in range(3))
    assert 0.02 < (a * np.cross(b, c)).sum() / 6 < 0.08


@pytest.mark.parametrize(("seed", "spacing_m"), [(11, 0.012), (12, 0.0095)])
def test_statues_of_other_seeds_and_spacings_are_closed(seed: int, spacing_m: float) -> None:
    mesh = statue_mesh(np.random.default_rng(seed), spacing_m)
    assert edge_census(mesh.triangles).watertight


def test_another_seed_carves_another_figure() -> None:
    one, same, other = (statue_mesh(np.random.default_rng(seed), 0.016) for seed in (1, 1, 2))
    assert one.vertices.tobytes() == same.vertices.tobytes()
    assert one.triangles.tobytes() == same.triangles.tobytes()
    gap = cKDTree(one.vertices).query(other.vertices)[0]
    assert np.quantile(gap, 0.9) > 0.008
    postures = {Posture.drawn(np.random.default_rng(seed)) for seed in range(8)}
    assert {posture.bearded for posture in postures} == {True, False}
    assert {posture.broken_arm for posture in postures} == {True, False}


def test_materials_are_told_apart_by_reflectance(statue_scene: Scene) -> None:
    value = statue_scene.surface.vertex_attributes["reflectance"]
    stone, metal = value[statue_scene.material == OBJECT], value[statue_scene.material == SUPPORT]
    assert stone.min() >= np.float32(0.55)
    assert stone.max() <= np.float32(0.8)
    assert stone.std() > 0.02
    assert metal.min() >= np.float32(0.05)
    assert metal.max() <= np.float32(0.12)
    corner = statue_scene.material[statue_scene.surface.triangles]
    assert (corner == corner[:, :1]).all()


def test_the_support_touches_the_statue_in_many_places(statue_scene: Scene) -> None:
    statue, support = part(statue_scene, OBJECT), part(statue_scene, SUPPORT)
    gap, index = cKDTree(statue.vertices).query(support.vertices)
    assert gap.min() < 0.002
    touching = statue.vertices[index[gap < 0.004]]
    for low, high in ((-0.01, 0.08), (0.28, 0.33), (0.42, 0.45), (0.5, 0.7), (0.87, 0.93)):
        assert ((touching[:, 2] > low) & (touching[:, 2] < high)).any(), (low, high)


def test_the_support_hides_parts_of_the_statue(
    statue_scene: Scene, statue_scans: list[SimulatedScan]
) -> None:
    bare = part(statue_scene, OBJECT)
    alone = Scene("bare", painted(bare, OBJECT, np.array([0.7])), np.zeros(3), np.zeros(3))
    for one in statue_scans[:2]:
        metal = (one.samples.material == SUPPORT) & ~one.samples.is_mixed & ~one.samples.is_stray
        way = one.samples.true_points_in_scan[metal]
        distance = np.linalg.norm(way, axis=1)
        behind = alone.caster.cast(
            one.local_from_scan[:3, 3],
            (way / distance[:, None]) @ one.local_from_scan[:3, :3].T,
        )
        hidden = np.isfinite(behind.distance) & (behind.distance > distance + 1e-4)
        assert hidden.sum() > 200


def test_detail_exists_at_several_scales() -> None:
    """The finer lattice shows relief that the coarser one does not have."""
    coarse, fine = (statue_mesh(np.random.default_rng(4), h) for h in (0.014, 0.006))
    gap = cKDTree(fine.vertices).query(coarse.vertices)[0]
    assert np.quantile(gap, 0.5) < 0.003
    area = [face_normals_and_areas(mesh)[1].sum() for mesh in (coarse, fine)]
    assert area[1] > 1.03 * area[0]
