"""Photographs fill what a scan missed: a ball scanned but for a cap."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stages.main import PIPELINE
from tests.stages.conftest import metrics_of
from tests.stages.painted_ball import COUNT, SETTINGS, photographed_ball
from workbench.cloud.sample_source import opened_samples
from workbench.errors import SettingsError
from workbench.formats.range_ply import write_range_ply
from workbench.geometry.neighbours import nearest, tree_of
from workbench.geometry.rangemap import RangeMap
from workbench.pipeline.planner import make_plan
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.project import Project

# The cap that was not scanned is seen by the first camera and those next to it.
CAP_AXIS, CAP_DEG, SPACING = np.array([1.0, 0.0, 0.0]), 38.0, 0.025
MIDDLE = np.array([30.0, -20.0, 700.0])


def on_ball(count: int) -> np.ndarray:
    turn = np.arange(count) * np.pi * (3.0 - np.sqrt(5.0))
    up = 1.0 - 2.0 * (np.arange(count) + 0.5) / count
    level = np.sqrt(1.0 - up**2)
    return np.column_stack([level * np.cos(turn), up, level * np.sin(turn)])


def in_cap(points: np.ndarray, degrees: float = CAP_DEG) -> np.ndarray:
    along = points @ CAP_AXIS / np.linalg.norm(points, axis=1)
    return np.asarray(along > np.cos(np.radians(degrees)))


def scan(path: Path, radius: float = 1.0) -> Path:
    """A scan of the ball without its cap, in the frame of the cameras."""
    points = on_ball(round(4.0 * np.pi / SPACING**2))
    write_range_ply(path, RangeMap("scan", MIDDLE + radius * points[~in_cap(points)]))
    return path


def run_to(
    project: Path, last: str, fill: str = "missed", fuse: dict[str, Any] | None = None
) -> list[dict[str, Any]]:
    overrides = {
        "densify": SETTINGS["densify"] | {"fill": fill},
        "ingest": {"missing_pose": "identity"},
        "infill": {"depth": 6},
        "fuse": fuse or {},
    }
    request = RunRequest(last=last, overrides=overrides, workers=1)
    return run_pipeline(PIPELINE, Project(project), request, Progress(quiet=True))


@pytest.fixture(scope="module")
def project(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("cap")
    return photographed_ball(folder, [scan(folder / "scan.ply")], on_ball(2000), middle=MIDDLE)


def to_ball(project: Path) -> np.ndarray:
    """What brings the project's coordinates to those around the middle of the ball."""
    return np.array(Project(project).store.load("scan_inventory")["origin_m"]) - MIDDLE


def surface(project: Path) -> tuple[np.ndarray, np.ndarray]:
    mesh = Project(project).store.load("surface")
    return mesh.vertices + to_ball(project), mesh.vertex_attributes["provenance"] == 0


def test_photographs_fill_the_cap(project: Path) -> None:
    run_to(project, "infill", fill="never")
    vertices, measured = surface(project)
    inner = in_cap(vertices, CAP_DEG - 8.0)
    assert not measured[inner].any()

    told = {one["name"]: one for one in run_to(project, "infill")}
    assert told["orient"]["action"] == told["densify"]["action"] == "run"
    vertices, measured = surface(project)
    inner = in_cap(vertices, CAP_DEG - 8.0)
    assert measured[inner].mean() > 0.9
    off = np.linalg.norm(vertices[measured], axis=1) - 1.0
    assert np.sqrt((off**2).mean()) < 0.01

    found = metrics_of(project, "fuse")
    # Of what is photographed a good part was scanned, and a step is nowhere to be warned of.
    assert 40.0 < found["scans_hold"] < 90.0
    assert abs(found["photographs_off"]) < 0.5 * SPACING
    assert not told["fuse"]["warnings"]
    samples = Project(project).store.load("samples")
    photographed = samples["scan"] > 0
    assert photographed.sum() == found["photographed_samples"] > 50
    assert in_cap(samples["points"][photographed] + to_ball(project), CAP_DEG + 3.0).all()


def test_photographs_of_what_was_scanned_are_left_out(project: Path) -> None:
    run_to(project, "densify")
    inventory = Project(project).store.load("photo_range_inventory")
    shares = inventory["coverage"]
    # The first camera looks at the cap, the seventh from behind.
    assert shares["photo_00"] < 0.85
    assert shares["photo_06"] == 1.0
    matched = {one["name"] for one in inventory["scans"]}
    assert "photo_00" in matched
    assert "photo_06" not in matched
    assert metrics_of(project, "densify")["covered_photographs"] == COUNT - len(matched)
    # Whoever is matched is so for something missed, or because its neighbour is.
    for name in matched:
        beside = [one["neighbours"] for one in inventory["scans"] if shares[one["name"]] < 0.99]
        assert shares[name] < 0.99 or any(name in others for others in beside)


def test_what_is_scanned_all_over_needs_no_photograph(tmp_path: Path) -> None:
    whole = tmp_path / "scan.ply"
    write_range_ply(whole, RangeMap("scan", MIDDLE + on_ball(20_000)))
    made = photographed_ball(tmp_path, [whole], on_ball(2000), middle=MIDDLE)
    told = {one["name"]: one for one in run_to(made, "fuse")}
    found = {m["name"]: m["value"] for m in told["densify"]["metrics"]}
    assert found == {"covered_photographs": COUNT, "covered": 100.0}
    assert (Project(made).store.load("samples")["scan"] == 0).all()


def test_photographs_off_the_scans_are_warned_of(tmp_path: Path) -> None:
    """A scan larger than the ball of the cameras: a step where they fill."""
    made = photographed_ball(tmp_path, [scan(tmp_path / "scan.ply", 1.12)], middle=MIDDLE)
    told = {one["name"]: one for one in run_to(made, "fuse")}
    (warning,) = told["fuse"]["warnings"]
    assert "lie off the scans by more than" in warning
    assert "alignment.toml" in warning
    # No second shell within the first: what is off is no nearer to fill for it.
    samples = Project(made).store.load("samples")
    filled = samples["points"][samples["scan"] > 0] + to_ball(made)
    assert in_cap(filled, CAP_DEG + 8.0).mean() > 0.97


def test_cameras_of_another_frame_are_warned_of(tmp_path: Path) -> None:
    made = photographed_ball(tmp_path, [scan(tmp_path / "scan.ply")], middle=MIDDLE + 9.0)
    told = {one["name"]: one for one in run_to(made, "fuse")}
    (warning,) = told["fuse"]["warnings"]
    assert warning.startswith("100 % of what photographs agree on lies beyond")
    assert (Project(made).store.load("samples")["scan"] == 0).all()


def test_photographs_of_nothing_scanned_prove_no_frame(tmp_path: Path) -> None:
    """They show something beside what was scanned, near enough to be of the object."""
    aside = MIDDLE + np.array([0.0, 0.0, 2.5])
    points = on_ball(20_000)
    write_range_ply(tmp_path / "scan.ply", RangeMap("scan", MIDDLE + points * [9.0, 1.0, 1.0]))
    made = photographed_ball(tmp_path, [tmp_path / "scan.ply"], middle=aside)
    told = {one["name"]: one for one in run_to(made, "fuse")}
    assert any("nothing proves" in warning for warning in told["fuse"]["warnings"])


def test_without_places_it_is_refused_before_anything_runs(tmp_path: Path) -> None:
    made = photographed_ball(tmp_path, [scan(tmp_path / "scan.ply")], cameras=False)
    with pytest.raises(SettingsError, match="cannot fill what the scans missed") as caught:
        run_to(made, "infill")
    assert "alignment.toml" in (caught.value.fix or "")


def test_the_plan_tells_what_is_for_what(project: Path) -> None:
    reasons = {one.stage.name: one.reason for one in make_plan(PIPELINE, Project(project), {})}
    assert reasons["densify"] == (
        "the scans tell the surface; densify.fill=missed fills what they missed"
    )
    overrides = {"densify": {"fill": "missed"}}
    plan = make_plan(PIPELINE, Project(project), overrides)
    names = [one.stage.name for one in plan if one.action != "left out"]
    assert names.index("register") < names.index("densify") < names.index("fuse")
    assert names.index("orient") < names.index("densify")


def test_on_disk_it_is_the_same(project: Path) -> None:
    """Scans that do not fit in memory: what fills them is found from those that do."""
    run_to(project, "fuse")
    held = Project(project).store.load("samples")
    expected = held["points"][held["scan"] > 0]
    run_to(project, "fuse", fuse={"memory_samples": 8000})
    assert metrics_of(project, "fuse")["on_disk"]
    path = Project(project).store.load("sample_cloud")
    with opened_samples(None, path) as source:
        samples = source.thinned(len(source))
    filled = samples.points[samples.scan > 0]
    assert len(samples) > len(expected) > 0
    # Of 19,000 samples 8,000 stand further apart: they hold a little more to the side.
    assert len(expected) * 0.6 < len(filled) <= len(expected)
    assert nearest(tree_of(expected), filled)[0].max() < 0.1
