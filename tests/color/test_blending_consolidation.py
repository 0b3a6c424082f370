"""Coarse samples that stand for finer ones, and chunks of a cloud as blocks to be seen."""

from __future__ import annotations

import numpy as np
import pytest

from tests.color.blending_scene import RADIUS, ball, camera_at
from workbench.cloud.building import build_cloud
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.numbered_chunks import NumberedChunks, view_region
from workbench.cloud.schema import Attribute, Schema
from workbench.color.blending_consolidation import consolidated
from workbench.geometry.photo_view import view_of_samples, view_of_surface
from workbench.geometry.surface_rays import SurfaceRays


def test_a_coarse_sample_is_the_mean_of_what_is_nearest_to_it():
    points = np.array([[0.0, 0, 0], [10.0, 0, 0], [20.0, 0, 0]])
    colors = np.array([[0.2, 0.2, 0.2], [np.nan] * 3, [np.nan] * 3])
    weights = np.array([1.0, 0.0, 0.0])
    finer = (
        np.array([[1.0, 0, 0], [9.0, 0, 0], [11.0, 0, 0], [2.0, 0, 0]]),
        np.array([[0.8, 0.2, 0.5], [0.1, 0.1, 0.1], [0.4, 0.4, 0.4], [np.nan] * 3]),
        np.array([3.0, 1.0, 2.0, 0.0]),
    )
    mean, total = consolidated(points, colors, weights, finer)
    assert mean[0] == pytest.approx([0.65, 0.2, 0.425])
    assert mean[1] == pytest.approx([0.3, 0.3, 0.3])
    assert np.isnan(mean[2]).all()
    assert total.tolist() == [4.0, 3.0, 0.0]


def test_without_finer_samples_nothing_changes():
    nothing = (np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0))
    colors = np.array([[0.1, 0.2, 0.3], [np.nan] * 3])
    mean, total = consolidated(np.zeros((2, 3)), colors, np.array([0.5, 0.0]), nothing)
    assert mean[0] == pytest.approx([0.1, 0.2, 0.3])
    assert np.isnan(mean[1]).all()
    assert total.tolist() == [0.5, 0.0]
    empty = consolidated(np.zeros((0, 3)), np.zeros((0, 3)), np.zeros(0), nothing)
    assert empty[0].shape == (0, 3)


@pytest.fixture(scope="module")
def cloud(tmp_path_factory):
    """The vertices of a ball in a layered cloud of many small chunks."""
    path = tmp_path_factory.mktemp("cloud") / "ball.cloud"
    mesh = ball(6)
    normals = mesh.vertex_attributes["normal"].astype(np.float32)
    schema = Schema((Attribute("normals", "float32", 3),))
    build_cloud(
        path, [{"points": mesh.vertices, "normals": normals}], schema, points_per_chunk=2000
    )
    with LayeredCloud(path) as opened:
        yield opened


def test_chunks_are_numbered_through_without_a_gap(cloud):
    chunks = NumberedChunks(cloud)
    assert chunks.starts[-1] == len(cloud)
    ranges = list(chunks.ranges(5000))
    assert len(ranges) > 3
    assert [r.start for r in ranges[1:]] == [r.stop for r in ranges[:-1]]
    assert ranges[-1].stop == len(chunks.order)
    assert all(chunks.starts[r.stop] - chunks.starts[r.start] <= 5000 for r in ranges)
    # Samples of all levels together lie closer than those of one.
    edge = RADIUS * 1.1 / 2**6
    leaves = [chunks.spacing[leaf] for leaf in cloud.leaves()]
    assert chunks.spacing[0] == min(leaves)
    assert edge < chunks.spacing[0] < 3.0 * edge


def test_a_cloud_shows_what_the_surface_shows(cloud):
    camera, mesh = camera_at(1.1), ball(6)
    blocks = list(NumberedChunks(cloud).blocks(camera))
    assert sum(len(block.points) for block in blocks) == len(cloud)
    samples = view_of_samples(blocks, camera)
    surface = view_of_surface(SurfaceRays(mesh), mesh.vertex_attributes["normal"], camera)
    clear = surface.seen & (surface.cosines > 0.3)
    assert samples.seen[clear].mean() > 0.999
    both = clear & samples.seen
    assert np.abs(surface.depth[both] - samples.depth[both]).max() < 0.05 * RADIUS


def test_what_lies_beside_the_picture_is_not_read(cloud):
    camera = camera_at(1.1)
    low, high = cloud.bounds
    region = view_region(camera, low, high)
    pixels = np.random.default_rng(0).uniform(0, 240, (200, 2))
    # Whatever a pixel shows within the bounds lies in the region, the rim's corners too.
    pixels[:4] = [[0, 0], [240, 0], [240, 240], [0, 240]]
    for depth in (1.2, 1.5, 1.75):
        ways = camera.directions(pixels)
        assert region.contains(camera.center + depth * ways).all()
    turned = camera_at(1.1, middle=(0.0, 0.0, 0.0))
    away = turned.camera_from_world.copy()
    away[[0, 2]] *= -1.0  # half a turn about the vertical: the ball is behind
    behind = type(turned)(turned.model, 240, 240, turned.params, away)
    assert not list(NumberedChunks(cloud).blocks(behind))
