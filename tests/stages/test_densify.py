"""Projects of photographs alone: a painted ball becomes a surface."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
import pytest

from stages.main import PIPELINE
from tests.stages.conftest import metrics_of
from tests.stages.painted_ball import COUNT, FOCAL, SETTINGS, SIZE, photographed_ball
from tests.stereo.ball_card import write_true_maps
from tests.stereo.scenes import ball, seen
from workbench.errors import InputError
from workbench.formats.colmap import (
    read_colmap_text,
)
from workbench.geometry.transforms import apply
from workbench.pipeline.planner import make_plan
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.creation import create_project
from workbench.project.photo_scale import scale_is_known
from workbench.project.project import Project
from workbench.stereo import colmap_stereo


@pytest.fixture(scope="module")
def photographed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs with cameras and no scale told."""
    folder = tmp_path_factory.mktemp("ball")
    return photographed_ball(folder)


def run_to(project: Path, last: str, **options: Any) -> list[dict[str, Any]]:
    overrides = SETTINGS | {"densify": SETTINGS["densify"] | options}
    request = RunRequest(last=last, overrides=overrides, workers=1)
    return run_pipeline(PIPELINE, Project(project), request, Progress(quiet=True))


def test_the_plan_orients_before_it_makes_the_surface(photographed: Path) -> None:
    plan = make_plan(PIPELINE, Project(photographed))
    wanted = [one.stage.name for one in plan if one.action != "left out"]
    assert wanted == [
        *("develop", "mask", "orient", "densify", "fuse", "infill"),
        *("color", "texture", "export", "verify"),
    ]
    orient = next(one for one in plan if one.stage.name == "orient")
    assert "surface" not in orient.reads


def test_a_ball_of_photographs_alone(photographed: Path) -> None:
    told = run_to(photographed, "infill")
    assert {one["name"]: one["action"] for one in told}["densify"] == "run"
    store = Project(photographed).store
    mesh = store.load("surface")
    measured = mesh.vertices[mesh.vertex_attributes["provenance"] == 0]
    off = np.linalg.norm(measured, axis=1) - 1.0
    # A pixel is 0.021 on the ball.
    assert np.sqrt((off**2).mean()) < 0.015
    assert len(measured) > 0.6 * len(mesh.vertices)
    found = metrics_of(photographed, "densify")
    assert found["depth_maps"] == COUNT
    assert found["agreed"] > 35.0
    assert 0.0005 < found["depth_sigma"] < 0.02
    inventory = store.load("photo_range_inventory")
    assert [one["samples"] for one in inventory["scans"]] == [
        len(store.load("photo_range_maps", one["name"])) for one in inventory["scans"]
    ]
    for one in inventory["scans"]:
        number = int(one["name"][-2:])
        # Neighbours in the ring, the same height or the other.
        apart = [abs(int(other[-2:]) - number) for other in one["neighbours"]]
        assert all(min(steps, COUNT - steps) <= 2 for steps in apart)

    again = run_to(photographed, "infill")
    assert {one["name"]: one["action"] for one in again}["densify"] == "fresh"
    stricter = run_to(photographed, "densify", agreeing=3, geometric=False)
    assert stricter[-1]["action"] == "run"
    assert metrics_of(photographed, "densify")["agreed"] < found["agreed"]
    assert not store.items("better_estimates")


def test_given_cameras_are_in_metres_unless_they_are_said_not_to_be(photographed: Path) -> None:
    def told(**options: Any) -> dict[str, Any]:
        request = RunRequest(last="orient", overrides={"orient": options}, workers=1)
        run_pipeline(PIPELINE, Project(photographed), request, Progress(quiet=True))
        return dict(Project(photographed).store.load("records", "orient"))

    poses = Project(photographed).store
    (warning,) = told()["warnings"]
    assert "taken for metres" in warning
    assert "given_unit" in warning
    assert scale_is_known(poses.load("photo_poses"))
    (warning,) = told(given_unit="none")["warnings"]
    assert warning.startswith("no scale")
    assert not scale_is_known(poses.load("photo_poses"))
    # What was brought stays in the user's frame.
    cameras = read_colmap_text(photographed / "work/orient/colmap").photo_cameras()
    assert cameras["photo_00"].center == pytest.approx([5.0, 1.5, 0.0])


def test_colmap_matches_where_there_is_a_card(
    photographed: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="COLMAP cannot match here") as caught:
        run_to(photographed, "densify", matcher="colmap")
    assert "densify.matcher=own" in (caught.value.fix or "")

    def match(folder: str, options: Any) -> None:
        """A card that knows the ball."""
        images = pycolmap.Reconstruction(f"{folder}/sparse").images.values()
        places = {image.name: tuple(image.projection_center().tolist()) for image in images}
        shown = {name: seen(ball, place, SIZE, FOCAL) for name, place in places.items()}
        write_true_maps(Path(folder), shown)

    monkeypatch.setattr(pycolmap, "has_cuda", True)
    monkeypatch.setattr(pycolmap, "patch_match_stereo", match)
    monkeypatch.setattr(colmap_stereo, "_CARDS", "/dev/nul[l]")
    run_to(photographed, "densify", matcher="auto")
    # Cameras 30° apart: not every place is seen by three.
    assert metrics_of(photographed, "densify")["agreed"] > 45.0
    store = Project(photographed).store
    inventory = store.load("photo_range_inventory")
    assert inventory["why_own_matcher"] is None
    told = inventory["scans"][0]
    scan = store.load("photo_range_maps", told["name"])
    off = np.linalg.norm(apply(np.array(told["world_from_scan"]), scan.points_in_scan), axis=1)
    assert np.median(np.abs(off - 1.0)) < 0.005


def test_with_scans_depth_maps_are_left_out(tmp_path: Path, photographed: Path) -> None:
    points = np.random.default_rng(0).normal(size=(200, 3))
    np.savetxt(tmp_path / "scan.xyz", points)
    project = create_project(
        tmp_path / "p", scans=[tmp_path / "scan.xyz"], photos=[photographed.parent / "photos"]
    )
    plan = make_plan(PIPELINE, project)
    names = [one.stage.name for one in plan]
    assert names == [stage.name for stage in PIPELINE]
    densify = next(one for one in plan if one.stage.name == "densify")
    told = "the scans tell the surface; densify.fill=missed fills what they missed"
    assert (densify.action, densify.reason) == ("left out", told)
