"""The Stanford bunny from its published poses, to published accuracy."""

import json

import numpy as np
import pytest
from scipy.spatial import cKDTree

from tests.stages.conftest import metrics_of, workbench
from workbench.formats.ply import read_ply
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import edge_census


@pytest.fixture(scope="module")
def bunny(shared_data, tmp_path_factory):
    project = tmp_path_factory.mktemp("projects") / "bunny"
    made = workbench("new", project, "--scans", shared_data("stanford-bunny"), "--preset", "statue")
    assert made["scans"] == 10
    return project, workbench("run", project)


def test_every_stage_runs_and_the_second_run_does_nothing(bunny):
    project, first = bunny
    actions = {stage["name"]: stage["action"] for stage in first["stages"]}
    left_out = {
        name: actions.pop(name)
        for name in ("develop", "mask", "densify", "orient", "color", "texture")
    }
    assert set(left_out.values()) == {"left out"}
    assert set(actions.values()) == {"run"}
    again = {stage["name"]: stage["action"] for stage in workbench("run", project)["stages"]}
    assert again == left_out | dict.fromkeys(actions, "fresh")


def test_the_model_is_as_close_to_the_reference_as_the_scans_allow(bunny):
    project, _ = bunny
    found = metrics_of(project, "verify")
    assert found["reference_to_model_rms"] <= 0.08e-3
    assert found["reference_to_model_p95"] <= 0.16e-3
    assert found["measured_to_reference_p95"] <= 0.2e-3
    report = json.loads((project / "report" / "report.json").read_text())
    told = {metric["name"]: metric["value"] for metric in report["metrics"]}
    assert told["reference_to_model_rms"] == found["reference_to_model_rms"]
    page = (project / "report" / "report.html").read_text()
    assert "reference_to_model_rms" in page or "Root mean square distance of the reference" in page


def test_the_distances_hold_without_the_workbenchs_own_measuring(bunny, shared_data):
    project, _ = bunny
    reference = read_ply(shared_data("stanford-bunny", "reference", "bun_zipper.ply"))
    vertex = reference.elements["vertex"]
    points = np.stack([vertex.scalar(axis) for axis in "xyz"], axis=1).astype(float)
    model = read_surface(project / "exports" / "surface.ply")
    # Dense points on the model: distances to them exceed those to the surface only slightly.
    corner = model.vertices[model.triangles]
    weights = np.random.default_rng(0).dirichlet([1, 1, 1], size=(4, len(corner)))
    dense = np.einsum("smk,mki->smi", weights, corner).reshape(-1, 3)
    distance, _ = cKDTree(np.concatenate([dense, model.vertices])).query(points, workers=-1)
    spacing = np.median(np.linalg.norm(corner[:, 0] - corner[:, 1], axis=1)) / 4
    assert np.sqrt(np.mean(np.maximum(distance**2 - spacing**2, 0))) < 0.12e-3


def test_the_exported_file_is_closed_by_any_count(bunny):
    project, _ = bunny
    triangles = read_surface(project / "exports" / "surface.ply").triangles
    census = edge_census(triangles)
    assert census.watertight
    edges = np.sort(triangles[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
    _, count = np.unique(edges, axis=0, return_counts=True)
    assert set(count) == {2}


def test_published_poses_that_already_fit_are_kept(bunny):
    project, _ = bunny
    found = metrics_of(project, "register")
    assert found["given_poses_kept"] is True
    assert 0 <= found["gain"] < 0.1


def test_the_holes_of_the_bottom_are_flagged_and_hardly_anything_else(bunny):
    project, _ = bunny
    model = read_surface(project / "exports" / "surface.ply")
    low = model.vertices[:, 1] < model.vertices[:, 1].min() + 0.005
    flagged = model.vertex_attributes["provenance"] == 1
    assert flagged[low].mean() > 0.05
    assert flagged[~low].mean() < 0.005
