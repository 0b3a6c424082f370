"""Potree folders read back: every point once, and damage told."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from workbench.cloud.point_export import export_points
from workbench.errors import InputError
from workbench.formats.point_files import read_points
from workbench.formats.potree_reading import PotreeCloud
from workbench.geometry.point_set import PointSet

PLACE = np.array([500_000.0, 5_200_000.0, 100.0])


@pytest.fixture
def points() -> PointSet:
    """A patch of a paraboloid, far from the origin."""
    rng = np.random.default_rng(5)
    flat = rng.uniform(-1.0, 1.0, (40_000, 2))
    places = np.column_stack([flat, (flat**2).sum(axis=1)]) + PLACE
    normals = np.column_stack([-2.0 * flat, np.ones(len(flat))])
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    color = rng.integers(0, 256, (len(flat), 3)).astype(np.uint8)
    return PointSet(places, normals.astype(np.float32), color)


@pytest.fixture
def folder(points: PointSet, tmp_path: Path) -> Path:
    """The same as a folder of Potree."""
    export_points(points, tmp_path / "cloud", "potree")
    return tmp_path / "cloud"


def test_every_point_comes_back_once(points: PointSet, folder: Path):
    back = read_points(folder / "metadata.json")
    assert len(back) == len(points)
    middle = points.points.mean(axis=0)
    away, whose = cKDTree(points.points - middle).query(back.points - middle)
    # Half a step of the rounding along each axis.
    assert away.max() < 0.5e-4 * np.sqrt(3.0)
    assert len(np.unique(whose)) == len(points)
    np.testing.assert_array_equal(back.color, points.color[whose])
    np.testing.assert_allclose(back.normals, points.normals[whose], atol=1e-6)


def test_points_lie_in_their_nodes_and_children_in_their_octants(folder: Path):
    cloud = PotreeCloud(folder)
    assert len(cloud.nodes) > 4
    for node in cloud.nodes:
        inside = cloud.read(node).points - node.lower
        assert (inside > -1e-4).all()
        assert (inside < node.side + 1e-4).all()
        for child in (cloud.nodes[row] for row in node.children):
            upper = np.round((child.lower - node.lower) / child.side).astype(int)
            assert child.octant == upper @ [4, 2, 1]
            assert child.side == node.side / 2


@pytest.mark.parametrize(
    ("key", "value", "told"),
    [
        ("version", "1.8", "version"), ("encoding", "BROTLI", "compressed"),
        ("scale", [0, 1, 1], "scale"), ("spacing", "wide", "must"),
        ("hierarchy", {"firstChunkSize": 10**9}, "cut short"),
        ("hierarchy", {"firstChunkSize": 22}, "too early"),
        ("attributes", [], "must"), ("boundingBox", {"min": [0, 0, 0]}, "must"),
        ("boundingBox", {"min": [0, 0, 0], "max": [float("nan")] * 3}, "no such thing"),
    ],
)  # fmt: skip
def test_a_folder_that_says_nonsense_is_refused(folder: Path, key: str, value, told: str):
    path = folder / "metadata.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | {key: value}))
    with pytest.raises(InputError, match="Potree") as error:
        PotreeCloud(folder)
    assert told in str(error.value)


def test_points_cut_short_are_refused(folder: Path):
    path = folder / "octree.bin"
    path.write_bytes(path.read_bytes()[:-5])
    cloud = PotreeCloud(folder)
    with pytest.raises(InputError, match="cut short"):
        list(cloud.batches())
