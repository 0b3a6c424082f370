"""Photographs oriented in a project: brought along, brought onto a surface, and refused."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from stages.main import PIPELINE
from tests.orientation.blob import body, photographed
from tests.stages.conftest import workbench
from workbench.errors import InputError
from workbench.formats.colmap import ColmapModel, read_colmap_text, write_colmap_text
from workbench.formats.surface_files import write_surface_ply
from workbench.geometry.mesh import vertex_normals
from workbench.geometry.similarity import Similarity, best_similarity
from workbench.geometry.transforms import inverse, rotation_angle_deg
from workbench.orientation.alignment import transformed
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.creation import create_project
from workbench.project.project import Project

ELSEWHERE = Similarity(2.5, np.array([[0, -1.0, 0], [1, 0, 0], [0, 0, 1]]), np.array([9, 8, 7.0]))


def brought(folder: Path, *, moved: bool) -> Path:
    """A project of grey photographs with cameras and a surface."""
    mesh = body()
    model = photographed(mesh)
    if moved:
        model = transformed(model, ELSEWHERE)
    photos = folder / "photos"
    photos.mkdir(parents=True)
    for number in model.images:
        picture = np.random.default_rng(number).integers(40, 200, (600, 800, 3), dtype=np.uint8)
        cv2.imwrite(str(photos / f"photo_{number:02d}.png"), picture)
    write_colmap_text(folder / "colmap", model)
    write_surface_ply(folder / "body.ply", mesh.with_attributes(normal=vertex_normals(mesh)))
    create_project(
        folder / "project",
        photos=[photos],
        cameras=folder / "colmap",
        geometry=folder / "body.ply",
    )
    return folder / "project"


def oriented(project: Path, **options: Any) -> dict[str, Any]:
    request = RunRequest(last="orient", overrides={"orient": options}, workers=1)
    told = run_pipeline(PIPELINE, Project(project), request, Progress(quiet=True))
    assert told[-1]["action"] == "run"
    return dict(Project(project).store.load("photo_poses"))


def placed_model(project: Path) -> ColmapModel:
    return read_colmap_text(project / "work" / "orient" / "colmap")


def centers(model: ColmapModel) -> np.ndarray:
    return np.array([inverse(model.images[n].camera_from_world)[:3, 3] for n in model.images])


def test_cameras_that_fit_are_kept_to_the_last_digit(tmp_path):
    project = brought(tmp_path, moved=False)
    plan = {s["name"]: s for s in workbench("plan", project)["stages"]}
    assert plan["orient"]["action"] == "run"
    assert "elsewhere" in plan["orient"]["reason"]
    poses = oriented(project)
    assert poses["frame"] == "world"
    assert poses["way"] == "as given"
    given = read_colmap_text(tmp_path / "colmap")
    for number, image in placed_model(project).images.items():
        before = given.images[number].camera_from_world
        assert image.camera_from_world == pytest.approx(before, abs=1e-12)
    again = {s["name"]: s["action"] for s in workbench("plan", project)["stages"]}
    assert again["orient"] == "fresh"


def test_cameras_from_elsewhere_are_brought_onto_the_surface(tmp_path):
    project = brought(tmp_path, moved=True)
    poses = oriented(project, refine="always", patch_rounds=0)
    assert poses["way"] == "shape"
    truth = photographed(body())
    apart = np.linalg.norm(centers(placed_model(project)) - centers(truth), axis=1)
    assert np.median(apart) < 5e-4
    assert len(poses["photos"]["photo_01"]["center_sigma_m"]) == 3
    record = json.loads((project / "work" / "orient" / "record.json").read_text())
    named = {m["name"]: m["value"] for m in record["metrics"]}
    assert named["placed"] == len(truth.images)
    assert named["tied_points"] > 500


def test_left_alone_when_asked(tmp_path):
    project = brought(tmp_path, moved=True)
    assert oriented(project, align="own")["frame"] == "own"
    given = read_colmap_text(tmp_path / "colmap")
    assert centers(placed_model(project)) == pytest.approx(centers(given), abs=1e-9)


def test_wrong_places_and_names_are_told_before_any_work(tmp_path):
    project = brought(tmp_path, moved=True)
    place = "[[points]]\nworld = [0, 0, 1]\n"
    for text, word in (
        ("points = 3", "no places"),
        (place + "photo_99 = [1, 2]\nphoto_01 = [1, 2]", "no such photograph"),
        (place + "photo_01 = [1, 2]", "two photographs"),
        (place + "photo_01 = [1, 2]\nphoto_02 = [1, nan]", "no place"),
        (place + "photo_01 = [1, 2]\nphoto_02 = [1, 3]", "few places"),
        ("[[points]", "cannot be read"),
    ):
        (project / "alignment.toml").write_text(text)
        with pytest.raises(InputError, match=word):
            oriented(project)
    spaced = brought(tmp_path / "spaced", moved=False)
    (tmp_path / "spaced/photos/photo_01.png").rename(tmp_path / "spaced/photos/photo 01.png")
    with pytest.raises(InputError, match="name"):
        oriented(spaced)


@pytest.mark.slow
def test_the_simulated_statue_from_raw_files_to_cameras_on_its_surface(tmp_path):
    project = tmp_path / "statue"
    workbench("simulate", project, "--scene", "statue", "--seed", "1", "--size", "small",
              "--scans", "12", "--photos", "24")  # fmt: skip
    workbench("orient", project)
    poses = Project(project).store.load("photo_poses")
    assert poses["frame"] == "world"
    assert len(poses["photos"]) == 24
    assert not poses["unplaced"]
    truth = read_colmap_text(project / "truth" / "photos")
    found = placed_model(project)
    pairs = [
        (image.camera_from_world, truth.image_named(image.name).camera_from_world)
        for image in found.images.values()
    ]
    theirs = np.array([inverse(true)[:3, 3] for _, true in pairs])
    frame = best_similarity(theirs, centers(found))
    assert isinstance(frame, Similarity)
    assert frame.scale == pytest.approx(1.0, abs=2e-3)
    apart = np.linalg.norm(frame.apply(theirs) - centers(found), axis=1)
    assert np.median(apart) < 2e-3
    turns = [rotation_angle_deg(ours @ inverse(frame.camera_from_b(true))) for ours, true in pairs]
    assert np.median(turns) < 0.15
