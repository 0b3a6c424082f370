"""A long painted wall in even light, photographed along it, as a project to texture."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

from PIL import Image

from stages.main import PIPELINE
from tests.texturing.scenes import camera_at, picture, sheet
from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, write_colmap_text
from workbench.formats.surface_files import write_surface_ply
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.surface_rays import SurfaceRays
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.creation import create_project
from workbench.project.project import Project

PLACES, APART, AWAY = 8, 0.6, 1.0
# Photographs are 1.2 m wide on the wall: one shows its neighbours' halves, and no more.
SIZE, FOCAL = (192, 144), 160.0
WALL = sheet((-1.0, 0.0, -0.6), (PLACES * APART + 2.0, 0, 0), (0, 0, 1.2), 60)
# The wall is drawn from pixel to pixel with as much as a depth map has.
QUICK: dict[str, Any] = {"depth_map_px": 48, "border_px": 0, "normal_px": 1}


def wall_camera(number: int) -> PhotoCamera:
    """The one of a place along the wall; the wall's outside is towards −y."""
    x = number * APART
    return camera_at((x, -AWAY, 0.0), (x, 0.0, 0.0), SIZE, FOCAL, bend=-0.02)


def photo_name(number: int) -> str:
    return f"photo_{number:02d}"


def take(folder: Path, numbers: Iterable[int]) -> None:
    """Photographs of the wall from some of its places."""
    folder.mkdir(parents=True, exist_ok=True)
    rays = SurfaceRays(WALL)
    for number in numbers:
        shown = picture(rays, wall_camera(number))[..., :3]
        path = folder / f"{photo_name(number)}.jpg"
        Image.fromarray(shown).save(path, quality=98, subsampling=0)


def brought(folder: Path, numbers: Iterable[int]) -> Path:
    """A project of the wall and photographs from some places; all places' cameras are known."""
    take(folder / "photos", numbers)
    lens = ColmapCamera(1, "SIMPLE_RADIAL", *SIZE, wall_camera(0).params)
    images = {
        k + 1: ColmapImage(k + 1, wall_camera(k).camera_from_world, 1, f"{photo_name(k)}.jpg")
        for k in range(PLACES)
    }
    write_colmap_text(folder / "colmap", ColmapModel({1: lens}, images))
    write_surface_ply(folder / "wall.ply", WALL)
    create_project(
        folder / "project",
        photos=[folder / "photos"],
        cameras=folder / "colmap",
        geometry=folder / "wall.ply",
    )
    return folder / "project"


def run_texture(
    project: Path, color: Mapping[str, Any] | None = None, **options: Any
) -> dict[str, str]:
    """Stage → what was done."""
    overrides = {
        "develop": {"chart": "none"},
        "color": dict(color or {"flash": "none"}),
        "texture": {**QUICK, **options},
    }
    request = RunRequest(last="texture", overrides=overrides, workers=1)
    told = run_pipeline(PIPELINE, Project(project), request, Progress(quiet=True))
    return {step["name"]: step["action"] for step in told}
