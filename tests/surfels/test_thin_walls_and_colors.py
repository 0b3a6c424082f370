"""What the paper names as open: both sides of thin walls, and the colours of early surfels."""

import numpy as np
import pytest
import trimesh
from scipy.spatial import cKDTree

from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.point_set import PointSet
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.surfels.candidates import surface_candidates
from workbench.surfels.node_surfels import Candidates, chosen_surfels
from workbench.surfels.orders import exact_order
from workbench.surfels.painted_surface import PaintedSurface
from workbench.surfels.prefix_colors import mean_colors
from workbench.surfels.surfel_options import SurfelOptions

RED, BLUE = (255, 0, 0), (0, 0, 255)


@pytest.fixture(scope="module")
def plate():
    """Candidates of a plate of 2 × 2 × 0.01, red above and blue below."""
    solid = trimesh.creation.box((2.0, 2.0, 0.01))
    vertices = np.asarray(solid.vertices)[solid.faces].reshape(-1, 3)
    color = np.where(vertices[:, 2:] > 0, [RED], [BLUE]).astype(np.uint8)
    triangles = np.arange(len(vertices), dtype=np.int32).reshape(-1, 3)
    mesh = TriangleMesh(vertices, triangles, {"color": color})
    return surface_candidates(PaintedSurface.of(mesh), 200)[0]


def same_side_gap(candidates, picks):
    """How far a candidate is at most from the nearest pick on its side."""
    farthest = 0.0
    for up in (True, False):
        side = (candidates.normals[:, 2] > 0.5) if up else (candidates.normals[:, 2] < -0.5)
        tree = cKDTree(candidates.points[picks[side[picks]]])
        farthest = max(farthest, tree.query(candidates.points[side])[0].max())
    return farthest


def test_opposite_normals_keep_both_sides_of_a_thin_wall(plate):
    plain = exact_order(plate.points, 400).picks
    sided = exact_order(plate.points, 400, normals=plate.normals, opposite=0.2).picks

    # 200 picks a side of 2 × 2 in a hexagonal lattice; no order knows it beforehand.
    lattice = np.sqrt(4.0 / (200 * np.sqrt(3) / 2))
    assert same_side_gap(plate, sided) < 1.15 * lattice
    assert same_side_gap(plate, plain) > 1.6 * lattice


def test_colors_of_a_thin_wall_do_not_mix(plate):
    node = chosen_surfels(Candidates(plate, 0.01, 12, 0.2), SurfelOptions(count=1000), 0)

    # Where the rim, which has both colours, does not matter.
    inner = np.abs(node.surfels.points[:, :2]).max(axis=1) < 0.55
    up = inner & (node.surfels.normals[:, 2] > 0.5)
    down = inner & (node.surfels.normals[:, 2] < -0.5)
    assert min(up[:63].sum(), down[:63].sum()) > 4
    for colors in (node.surfels.color, *node.coarse_colors):
        assert (colors[up[: len(colors)]] == RED).all()
        assert (colors[down[: len(colors)]] == BLUE).all()
    assert len(node.coarse_colors) == 2


@pytest.fixture(scope="module")
def speckled_ball(sphere):
    """Candidates of a ball: grey that darkens downwards, one in twenty pixels bright green."""
    points, gap = surface_candidates(PaintedSurface.of(sphere(1.0)), 160)
    grey = np.rint(100 + 80 * points.points[:, 2:]).astype(np.uint8)
    color = np.repeat(grey, 3, axis=1)
    speckle = np.random.default_rng(0).random(len(points)) < 0.05
    color[speckle] = (0, 255, 0)
    return PointSet(points.points, points.normals, color, None), gap


def test_means_show_what_early_surfels_stand_for(speckled_ball):
    points, gap = speckled_ball
    given = Candidates(points, gap, 1, 0.2)
    mean = chosen_surfels(given, SurfelOptions(count=4000, colors="mean"), 0)
    sample = chosen_surfels(given, SurfelOptions(count=4000, colors="sample"), 0)

    for prefix in (60, 200, 1000, 4000):
        averaged, plain = mean.prefix(prefix), sample.prefix(prefix)
        np.testing.assert_array_equal(averaged.points, plain.points)
        _, owner = cKDTree(averaged.points).query(points.points)
        truth = (
            np.stack(
                [np.bincount(owner, LINEAR_OF_BYTE[points.color[:, k]], prefix) for k in range(3)],
                1,
            )
            / np.bincount(owner, minlength=prefix)[:, None]
        )

        def error(shown, truth=truth):
            return np.sqrt(((LINEAR_OF_BYTE[shown.color] - truth) ** 2).mean())

        assert error(averaged) < 0.25 * error(plain)


def test_means_are_taken_in_linear_light():
    colors = np.array([[0, 0, 0], [255, 255, 255], [10, 20, 30]], np.uint8)

    means, shares = mean_colors(colors, np.array([0, 0, 1]), 2)

    # Half of the light of white is the byte 188, not 128.
    np.testing.assert_array_equal(means, [[188, 188, 188], [10, 20, 30]])
    np.testing.assert_array_equal(shares, [2, 1])
