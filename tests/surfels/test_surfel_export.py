from itertools import pairwise

import numpy as np
import pytest
from scipy.spatial import cKDTree

from workbench.errors import InputError, SettingsError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.point_set import PointSet
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.textured_mesh import TexturedMesh
from workbench.surfels.drawing import disc_view
from workbench.surfels.node_tree import item_tree
from workbench.surfels.point_normals import estimated_normals, sound_normals
from workbench.surfels.surfel_export import export_surfels
from workbench.surfels.surfel_file import SurfelFile, surfel_points
from workbench.surfels.surfel_options import SurfelOptions
from workbench.surfels.surfel_size import FoveaZones
from workbench.surfels.view_surfels import shown_prefixes, view_surfels

SMALL = {"count": 1500, "candidates_resolution": 96, "split_above": 4000}


@pytest.fixture(scope="module")
def shells(sphere) -> TriangleMesh:
    """A coloured ball with another inside that nobody sees from without."""
    outer, inner = sphere(1.0, subdivisions=5), sphere(0.8, subdivisions=4)
    vertices = np.concatenate([outer.vertices, inner.vertices]) + np.array([100.0, 0, 0])
    triangles = np.concatenate([outer.triangles, inner.triangles + len(outer.vertices)])
    color = np.rint(127 + 127 * np.concatenate([outer.vertices, inner.vertices])).astype(np.uint8)
    return TriangleMesh(vertices, triangles, {"color": color})


@pytest.fixture(scope="module")
def tree_file(tmp_path_factory, shells):
    path = tmp_path_factory.mktemp("surfels") / "a.surfels"
    figures = export_surfels(shells, path, SurfelOptions(**SMALL))
    return SurfelFile(path), figures


def away(points):
    return np.linalg.norm(points.points - [100, 0, 0], axis=1)


def test_figures_are_those_of_the_file(tree_file, shells):
    file, figures = tree_file

    assert figures["format"] == "surfels"
    assert figures["bytes"] == file.path.stat().st_size
    assert figures["items"] == file.nodes["surfels"].sum()
    assert figures["bits_per_item"] == pytest.approx(8 * figures["bytes"] / figures["items"])
    assert figures["nodes"] == len(file.nodes) > 8
    assert figures["levels"] == file.nodes["level"].max() + 1 >= 2
    assert figures["source_items"] == len(shells.triangles)
    assert figures["finest_items"] == len(surfel_points(file.path))
    lattice = np.sqrt(4 * np.pi / (1500 * np.sqrt(3) / 2))
    # Of children that have hardly more surfels than their parent wants, it cannot take the best.
    assert 0.65 * lattice < figures["median_distance"] < 1.05 * lattice
    assert figures["warnings"] == []


def test_nodes_count_their_triangles_and_bound_their_children(tree_file):
    file, _ = tree_file
    nodes = file.nodes
    for row in range(len(nodes)):
        children = file.children(row)
        if len(children):
            assert nodes["items"][row] == nodes["items"][children].sum()
            assert (nodes["level"][children] == nodes["level"][row] + 1).all()
            for child in children:
                lower, upper = file.bounds(child)
                # A parent drops what cannot be seen, so it may be smaller.
                assert (lower < file.bounds(row)[1]).all()
                assert (upper > file.bounds(row)[0]).all()
        else:
            assert nodes["items"][row] <= 4000


def test_the_root_shows_the_outside_alone(tree_file):
    file, _ = tree_file

    root = file.node(0).surfels
    finest = surfel_points(file.path)

    assert away(root).min() > 0.98
    # A part that is seen from its own outside shows what the whole hides.
    assert away(finest).min() < 0.82
    outward = (root.points - [100, 0, 0]) / away(root)[:, None]
    assert np.einsum("ij,ij->i", outward, root.normals).min() > 0.9


def test_colors_survive_the_levels(tree_file):
    file, _ = tree_file
    root = file.node(0).surfels

    expected = 127 + 127 * (root.points - [100, 0, 0])
    # A surfel's cell is a tenth of the radius wide.
    assert np.abs(root.color - expected).max() < 12


def test_workers_do_not_change_a_byte(tmp_path, tree_file, shells):
    for workers in (2, 3):
        path = tmp_path / f"{workers}.surfels"
        export_surfels(shells, path, SurfelOptions(**SMALL, workers=workers))
        assert path.read_bytes() == tree_file[0].path.read_bytes()


def test_the_seed_changes_the_surfels(tmp_path, shells):
    options = {"count": 200, "candidates_resolution": 48}
    for seed in (0, 1):
        export_surfels(shells, tmp_path / f"{seed}", SurfelOptions(**options, seed=seed))
    assert (tmp_path / "0").read_bytes() != (tmp_path / "1").read_bytes()


def camera(distance, px=200) -> PhotoCamera:
    pose = np.eye(4)
    pose[:3, 3] = [-100, 0, distance]
    return PhotoCamera("PINHOLE", px, px, (px, px, px / 2, px / 2), pose)


@pytest.mark.parametrize(("distance", "size"), [(2.2, 2.0), (4.0, 3.0), (9.0, 2.0), (60.0, 1.0)])
def test_views_take_what_they_need_and_have_no_holes(tree_file, shells, distance, size):
    file, _ = tree_file
    seen_by = camera(distance)

    shown = shown_prefixes(file, seen_by, size)
    surfels = view_surfels(file, shown)
    view = disc_view(surfels, surfels.radius, seen_by)

    seen = SurfaceRays(shells).seen_by(seen_by)
    found = seen.found.reshape(view.depth.shape)
    depth = ((seen.points - seen_by.center) @ [0, 0, 1.0]).reshape(view.depth.shape)
    # Well inside the outline.
    inner = found & (depth < distance - 0.3)
    assert inner.sum() > 10
    assert view.covered[inner].all()
    assert (np.abs(view.depth - depth)[inner] < 2 * surfels.radius.max()).all()
    if distance == 60.0:
        assert [part.row for part in shown] == [0]
        assert len(surfels) < 1500
    if distance == 2.2:
        assert all(not len(file.children(part.row)) for part in shown)


def test_zones_take_fewer_surfels_away_from_where_one_looks(tree_file):
    file, _ = tree_file
    seen_by = camera(40.0)

    sharp = shown_prefixes(file, seen_by, 1.0)
    beside = shown_prefixes(file, seen_by, 1.0, FoveaZones((0.0, 0.0), (10, 60), (1.0, 2.0)))
    at = shown_prefixes(file, seen_by, 1.0, FoveaZones((100.0, 100.0), (10, 60), (1.0, 2.0)))

    assert sharp == at
    assert beside[0].count == pytest.approx(sharp[0].count / 4, abs=1.5)


def test_nothing_behind_the_camera_is_shown(tree_file):
    file, _ = tree_file
    assert shown_prefixes(file, camera(-5.0)) == []
    assert len(view_surfels(file, [])) == 0


def test_trees_split_what_they_are_given():
    places = np.random.default_rng(0).normal(size=(5000, 3))

    tree = item_tree(places, 300)

    leaves = [node for node in tree.nodes if not node.children]
    assert sum(node.items for node in leaves) == 5000
    np.testing.assert_array_equal(
        np.sort(np.concatenate([tree.items(node) for node in leaves])), np.arange(5000)
    )
    assert max(node.items for node in leaves) <= 300
    for node in tree.nodes:
        if node.children:
            parts = [tree.nodes[row] for row in node.children]
            assert 2 <= len(parts) <= 8
            assert (parts[0].first, parts[-1].last) == (node.first, node.last)
            assert all(a.last == b.first for a, b in pairwise(parts))
            assert all(part.level == node.level + 1 for part in parts)
    copies = item_tree(np.zeros((2000, 3)), 300)
    assert len(copies.nodes) == 1


def test_points_are_their_own_candidates(tmp_path, sphere):
    mesh = sphere(1.0, subdivisions=5)
    normals = mesh.vertices.astype(np.float32)
    cloud = PointSet(mesh.vertices, normals, None, None)

    figures = export_surfels(
        cloud, tmp_path / "a.surfels", SurfelOptions(count=500, positions="float32")
    )

    surfels = surfel_points(tmp_path / "a.surfels")
    apart, rows = cKDTree(mesh.vertices).query(surfels.points)
    assert apart.max() < 1e-6
    np.testing.assert_allclose(surfels.normals, normals[rows], atol=1e-4)
    assert surfels.color is None
    assert figures["warnings"] == []
    assert figures["source_items"] == len(mesh.vertices)


def test_normals_of_points_are_found(tmp_path, sphere):
    mesh = sphere(1.0, subdivisions=5)

    normals = estimated_normals(mesh.vertices + np.array([3e5, 0, 0]))
    cosines = np.abs(np.einsum("ij,ij->i", normals, mesh.vertices))
    assert cosines.min() > np.cos(np.radians(1.0))
    np.testing.assert_array_equal(estimated_normals(np.zeros((2, 3))), [[0, 0, 1]] * 2)
    assert np.isfinite(estimated_normals(np.zeros((50, 3)))).all()

    cloud = PointSet(mesh.vertices, None, None, None)
    options = SurfelOptions(count=900, split_above=3000, candidates_resolution=96)
    figures = export_surfels(cloud, tmp_path / "a.surfels", options)
    assert figures["levels"] == 2
    assert "no normals" in figures["warnings"][0]
    root = SurfelFile(tmp_path / "a.surfels").node(0)
    apart, _ = cKDTree(root.surfels.points).query(mesh.vertices)
    assert apart.max() < 1.05 * root.radius


def test_normals_that_are_none_are_found_and_others_kept(sphere):
    vertices = sphere(1.0, subdivisions=4).vertices
    given = (3.0 * vertices).astype(np.float32)
    given[::3], given[1] = 0.0, np.nan

    normals = sound_normals(vertices, given)

    np.testing.assert_allclose(normals[2::3], vertices[2::3], atol=1e-6)
    cosines = np.abs(np.einsum("ij,ij->i", normals, vertices))
    assert cosines.min() > np.cos(np.radians(3.0))


def test_fewer_points_than_surfels_are_told(tmp_path):
    points = np.random.default_rng(0).normal(size=(50, 3))
    figures = export_surfels(
        PointSet(points, None, None, None), tmp_path / "a", SurfelOptions(count=100)
    )
    assert figures["items"] == 50
    assert any("50 surfels, not 100" in text for text in figures["warnings"])


def test_one_point_is_a_file_too(tmp_path):
    color = np.array([[1, 2, 3]], np.uint8)
    export_surfels(PointSet(np.ones((1, 3)), None, color, None), tmp_path / "a")
    one = surfel_points(tmp_path / "a")
    np.testing.assert_array_equal(one.points, [[1, 1, 1]])
    np.testing.assert_array_equal(one.color, color)


def test_textures_color_surfels(tmp_path):
    picture = np.zeros((8, 8, 3), np.uint8)
    picture[:, 4:] = 255
    sheet = TriangleMesh(
        np.array([[0, 0, 0], [2, 0, 0], [2, 2, 0], [0, 2, 0.0]]),
        np.array([[0, 1, 2], [0, 2, 3]], np.int32),
    )
    places = np.array([[0, 0], [1, 0], [1, 1], [0, 1.0]])
    textured = TexturedMesh(sheet, places, np.zeros(2, np.int32), (picture,))

    export_surfels(textured, tmp_path / "a", SurfelOptions(count=300, candidates_resolution=64))

    surfels = surfel_points(tmp_path / "a")
    # Cells that the border runs through mix.
    sure = np.abs(surfels.points[:, 0] - 1) > surfels.radius[0]
    expected = np.where(surfels.points[sure, :1] > 1, 255, 0) * np.ones(3)
    np.testing.assert_array_equal(surfels.color[sure], expected)


@pytest.mark.parametrize("order", ["exact", "progressive"])
@pytest.mark.parametrize("colors", ["mean", "sample"])
def test_every_order_and_color_makes_a_file(tmp_path, shells, order, colors):
    options = SurfelOptions(count=300, candidates_resolution=64, order=order, colors=colors)
    figures = export_surfels(shells, tmp_path / "a", options)
    assert figures["items"] == 300
    assert SurfelFile(tmp_path / "a").colored


def test_memory_makes_nodes_smaller_or_is_refused(tmp_path, shells):
    tight = SurfelOptions(count=500, candidates_resolution=80, memory_mib=16)
    assert tight.most_triangles() < len(shells.triangles)
    assert export_surfels(shells, tmp_path / "a", tight)["nodes"] > 1
    with pytest.raises(SettingsError, match="memory"):
        export_surfels(shells, tmp_path / "b", SurfelOptions(memory_mib=64))
    assert SurfelOptions(workers=8, memory_mib=4096).nodes_at_once(10_000, triangles=True) < 8


def test_bad_sources_and_options_are_refused(tmp_path):
    with pytest.raises(InputError, match="no points"):
        export_surfels(PointSet(np.zeros((0, 3)), None, None, None), tmp_path / "a")
    with pytest.raises(InputError, match="no points"):
        export_surfels(PointSet(np.full((3, 3), np.nan), None, None, None), tmp_path / "a")
    for wrong in ({"count": 0}, {"candidates_resolution": 1}, {"opposite_share": -1}, {"seed": -1}):
        with pytest.raises(SettingsError, match=next(iter(wrong))):
            SurfelOptions(**wrong)
