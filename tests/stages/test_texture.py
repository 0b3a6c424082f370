"""The stage `texture`: pictures free of flash, depth meshes, an atlas, more photographs."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from stages.main import PIPELINE
from tests.color import blending_scene
from tests.stages import test_color as ball_project
from tests.stages.conftest import metrics_of, workbench
from tests.stages.texture_scene import brought, photo_name, run_texture, take
from workbench.formats.gltf import linear_from_srgb
from workbench.formats.surface_files import write_surface_ply
from workbench.geometry.surface_rays import SurfaceRays
from workbench.pipeline.planner import make_plan
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.pipeline.stitched_pictures import StitchedProject
from workbench.project.creation import create_project
from workbench.project.project import Project
from workbench.render.stitch.renderer import stitched_view
from workbench.render.stitch.scene import StitchScene

HELD = 2


def folder_of(project: Path) -> Path:
    return project / "work" / "texture"


def contents(project: Path) -> dict[str, bytes]:
    """Products of the stage: every file that it made but its notes and its record."""
    folder = folder_of(project)
    return {
        str(path.relative_to(folder)): path.read_bytes()
        for path in sorted(folder.rglob("*"))
        if path.is_file() and "items" not in path.parts and path.name != "record.json"
    }


def notes(project: Path, function: str) -> dict[str, int]:
    """Photograph → when what is asked of it was last done."""
    folder = folder_of(project) / "items" / function
    return {path.stem: path.stat().st_mtime_ns for path in folder.glob("*.json")}


def again(before: dict[str, int], after: dict[str, int]) -> set[str]:
    """Those that were done anew."""
    return {name for name, at in after.items() if before.get(name) != at}


def of_the_paint(colors: np.ndarray, places: np.ndarray) -> np.ndarray:
    """sRGB-encoded colours [0, 1] over the ball's paint, their median 1: the level is free."""
    ratio = linear_from_srgb(np.round(255 * colors).astype(np.uint8))
    ratio = ratio / blending_scene.paint(places)
    return np.asarray(ratio / np.median(ratio))


@pytest.fixture(scope="module")
def textured(tmp_path_factory) -> Path:
    """The ball in a flash's light; two of nine photographs kept out."""
    project = ball_project.brought(tmp_path_factory.mktemp("texture"))
    done = run_texture(
        project, ball_project.GIVEN, held_out=HELD, depth_map_px=100, border_px=2, normal_px=5
    )
    assert done["texture"] == "run"
    return project


def test_every_product_is_there_and_labels_are_photographs(textured):
    store = Project(textured).store
    told = store.load("texturing")
    names = told["photographs"]
    assert len(names) == 7
    assert len(told["held_out"]) == HELD
    assert not set(names) & set(told["held_out"])
    assert sorted(store.items("depth_meshes")) == names
    assert len(store.items("texture_photos")) == len(store.items("depth_maps")) == 9
    for name in names:
        stored = store.load("depth_meshes", name)
        own = [str(other) for other in stored["photos"]]
        assert name in own
        assert set(own) <= set(names)
        assert stored["labels"].min() >= -1
        assert stored["labels"].max() < len(own)
        assert np.isfinite(stored["penalties"][stored["labels"] >= 0]).all()
        assert (stored["labels"] >= 0).mean() > 0.9
    surface = store.load("labelled_surface")
    assert [str(name) for name in surface["photos"]] == names
    assert len(surface["labels"]) == len(ball_project.MESH.triangles)
    assert (surface["labels"] >= 0).mean() > 0.7
    assert len(store.items("texture_pages")) == metrics_of(textured, "texture")["atlas_pages"]


def test_a_view_that_textured_nothing_is_rendered_in_the_paints_colours(textured):
    stitched = StitchedProject.of(Project(textured))
    scene = stitched.scene
    held = Project(textured).store.load("texturing")["held_out"][0]
    number = int(held.split("_")[1])
    camera = blending_scene.ring(10, size=200)[number]
    shown = stitched_view(StitchScene.of(scene.meshes), camera, scene.cameras, scene.picture)
    met = SurfaceRays(ball_project.MESH).seen_by(camera)
    seen = met.found & shown.shown.seen.ravel() & (shown.shown.label.ravel() >= 0)
    assert seen.sum() > 0.85 * met.found.sum()
    assert held not in scene.names
    ratio = of_the_paint(shown.color.reshape(-1, 3)[seen], met.points[seen])
    # The photographs' noise is 1 %, and eight bits and JPEG add as much.
    assert ratio.std() < 0.05
    assert np.median(np.abs(ratio - 1.0)) < 0.02


def test_the_atlas_has_the_paints_colours_and_no_flash(textured):
    store = Project(textured).store
    atlas = store.load("texture_atlas")
    vertices, triangles = atlas["vertices"], atlas["triangles"]
    middles = vertices[triangles].mean(axis=1)
    places = atlas["texture_places"][triangles].mean(axis=1)
    colors = np.zeros((len(triangles), 3))
    for page, item in enumerate(sorted(store.items("texture_pages"))):
        texels = np.asarray(store.load("texture_pages", item))[..., :3]
        own = atlas["pages"] == page
        column, row = (places[own] * texels.shape[1::-1]).astype(int).T
        colors[own] = texels[row, column] / 255.0
    mesh = ball_project.MESH
    own = mesh.vertices[mesh.triangles].mean(axis=1)
    assert cKDTree(middles).query(own)[0].max() < 1e-6
    ratio = of_the_paint(colors, middles)
    assert np.median(np.abs(ratio - 1.0)) < 0.03
    assert np.percentile(np.abs(ratio - 1.0), 95) < 0.2


def test_unchanged_it_is_fresh_and_a_changed_option_makes_it_stale(tmp_path):
    project = brought(tmp_path, range(4))
    assert run_texture(project)["texture"] == "run"
    before = contents(project)
    assert run_texture(project)["texture"] == "fresh"
    # More memory for pictures changes nothing.
    assert run_texture(project, cache_mb=64)["texture"] == "fresh"
    plan = make_plan(PIPELINE, Project(project), {"texture": {"smoothness": 3.0}})
    stage = next(planned for planned in plan if planned.stage.name == "texture")
    assert stage.action == "stale"
    meshes = notes(project, "label_photo")
    assert run_texture(project, smoothness=3.0)["texture"] == "run"
    assert contents(project).keys() == before.keys()
    assert again(meshes, notes(project, "label_photo")) == {photo_name(k) for k in range(4)}


def test_products_that_are_not_asked_for_are_taken_away(tmp_path):
    project = brought(tmp_path, range(3))
    run_texture(project)
    store = Project(project).store
    assert store.items("depth_meshes")
    assert store.items("texture_pages")
    run_texture(project, depth_meshes=False)
    assert not store.items("depth_meshes")
    assert "depth_meshes" not in metrics_of(project, "texture")
    assert store.items("texture_pages")
    run_texture(project, single_mesh=False)
    assert len(store.items("depth_meshes")) == 3
    assert not store.items("texture_pages")
    assert not store.exists("texture_atlas")
    assert not store.exists("labelled_surface")


def test_two_photographs_more_concern_the_meshes_that_they_see(tmp_path):
    """New ones at one end of the wall, first in order: all numbers move, few meshes do."""
    added, kept = range(2), range(2, 8)
    color = {"flash": "none"}
    options = {"doubt": None}
    project = brought(tmp_path / "grown", kept)
    run_texture(project, color, **options)
    pictures, meshes = notes(project, "free_photo"), notes(project, "label_photo")
    take(tmp_path / "grown" / "photos", added)
    assert run_texture(project, color, **options)["texture"] == "run"
    new = {photo_name(number) for number in added}
    assert again(pictures, notes(project, "free_photo")) == new
    # The second of the new ones shows half of its neighbour's wall, and no more.
    assert again(meshes, notes(project, "label_photo")) == {*new, photo_name(2)}
    scratch = brought(tmp_path / "scratch", range(8))
    run_texture(scratch, color, **options)
    grown, made = contents(project), contents(scratch)
    assert grown.keys() == made.keys()
    assert [name for name in made if grown[name] != made[name]] == []
    # And taken away again, all is as it was.
    for number in added:
        (tmp_path / "grown" / "photos" / f"{photo_name(number)}.jpg").unlink()
    run_texture(project, color, **options)
    assert len(Project(project).store.items("depth_meshes")) == 6
    assert len(Project(project).store.items("texture_photos")) == 6


def test_without_photographs_surface_or_wishes_it_is_left_out(tmp_path):
    write_surface_ply(tmp_path / "ball.ply", ball_project.MESH)
    create_project(tmp_path / "bare", geometry=tmp_path / "ball.ply")
    plan = {s["name"]: s for s in workbench("plan", tmp_path / "bare")["stages"]}
    assert (plan["texture"]["action"], plan["texture"]["reason"]) == ("left out", "no photographs")
    take(tmp_path / "photos", [0])
    create_project(tmp_path / "flat", photos=[tmp_path / "photos"])
    for overrides, reason in (
        ({}, "no surface to texture"),
        ({"texture": {"depth_meshes": False, "single_mesh": False}}, "neither depth meshes nor"),
    ):
        made = make_plan(PIPELINE, Project(tmp_path / "flat"), overrides)
        stage = next(planned for planned in made if planned.stage.name == "texture")
        assert stage.action == "left out"
        assert reason in stage.reason


def test_photographs_that_are_not_oriented_texture_nothing(tmp_path):
    project = brought(tmp_path, range(2))
    request = RunRequest(last="texture", overrides={"orient": {"align": "own"}}, workers=1)
    run_pipeline(PIPELINE, Project(project), request, Progress(quiet=True))
    record = json.loads((folder_of(project) / "record.json").read_text())
    assert "not oriented" in " ".join(record["warnings"])
    assert contents(project) == {}
