"""The stage `color`: from photographs and cameras to a coloured surface and its exports."""

from __future__ import annotations

import json
from pathlib import Path
from shutil import copyfile
from typing import Any

import cv2
import numpy as np
import pytest
from PIL import Image
from scipy.spatial import cKDTree

from stages.main import PIPELINE
from tests.color.blending_scene import FLASH, ball, paint, photographed, ring
from tests.stages.conftest import metrics_of, workbench
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.formats.colmap import (
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    write_colmap_text,
)
from workbench.formats.gltf import linear_from_srgb, srgb_from_linear
from workbench.formats.surface_files import read_surface, write_surface_ply
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.creation import create_project
from workbench.project.project import Project

GAIN, EXIF_IFD, FLASH_TAG = 0.9, 0x8769, 0x9209
MESH = ball(4)
GIVEN: dict[str, Any] = {
    "flash": "given",
    "flash_position_m": FLASH.position_in_camera.tolist(),
    "roughness_deg": 0.0,
    "epsilon": 0.0,
}


def take(folder: Path, number: int, flash_fired: bool | None = None) -> None:
    """One photograph of the ball as a camera would deliver it, 8-bit and sRGB-encoded."""
    camera = ring(10, size=200)[number]
    values, _ = photographed(camera, gain=GAIN, seed=number)
    picture = Image.fromarray(srgb_from_linear(values))
    exif = Image.Exif()
    if flash_fired is not None:
        exif.get_ifd(EXIF_IFD)[FLASH_TAG] = int(flash_fired)
    folder.mkdir(parents=True, exist_ok=True)
    picture.save(folder / f"photo_{number:02d}.jpg", quality=98, subsampling=0, exif=exif)


def brought(folder: Path, photos: int = 9, dark: tuple[int, ...] = ()) -> Path:
    """A project of a surface, photographs and their cameras; ``dark`` ones had no flash."""
    for number in range(photos):
        take(folder / "photos", number, number not in dark)
    cameras = ring(10, size=200)
    lens = ColmapCamera(1, cameras[0].model, 200, 200, cameras[0].params)
    images = {
        k + 1: ColmapImage(k + 1, camera.camera_from_world, 1, f"photo_{k:02d}.jpg")
        for k, camera in enumerate(cameras)
    }
    write_colmap_text(folder / "colmap", ColmapModel({1: lens}, images))
    write_surface_ply(folder / "ball.ply", MESH)
    create_project(
        folder / "project",
        photos=[folder / "photos"],
        cameras=folder / "colmap",
        geometry=folder / "ball.ply",
    )
    return folder / "project"


def run_to(project: Path, last: str, **options: Any) -> dict[str, str]:
    """Stage → what was done."""
    overrides = {"develop": {"chart": "none"}, "color": options}
    request = RunRequest(last=last, overrides=overrides, workers=1)
    told = run_pipeline(PIPELINE, Project(project), request, Progress(quiet=True))
    return {step["name"]: step["action"] for step in told}


def colors_of(project: Path) -> dict[str, np.ndarray]:
    return dict(Project(project).store.load("surface_color"))


def warnings_of(project: Path) -> str:
    record = json.loads((project / "work" / "color" / "record.json").read_text())
    return " ".join(record["warnings"])


@pytest.fixture(scope="module")
def colored(tmp_path_factory) -> Path:
    """A project run to its exports."""
    project = brought(tmp_path_factory.mktemp("color"))
    done = run_to(project, "export")
    assert done["color"] == "run"
    return project


def relative(colors: dict[str, np.ndarray], flag: int = 0) -> np.ndarray:
    """Colours over the paint, scaled to a median of 1."""
    told = colors["color_provenance"] == flag
    ratio = colors["color"][told] / paint(MESH.vertices[told])
    return np.asarray(ratio / np.median(ratio))


def test_the_paint_comes_out_without_the_flash(colored):
    found = colors_of(colored)
    assert (found["color_provenance"] == 0).mean() > 0.85
    assert np.median(np.abs(relative(found) - 1.0)) < 0.015
    assert relative(found).std() < 0.05
    assert np.array_equal(found["weight"] > 0.0, found["color_provenance"] == 0)
    # Without a chart the level is that of the photographs at the median distance.
    ratio = found["color"][found["photos"] > 0] / paint(MESH.vertices[found["photos"] > 0])
    told = json.loads((colored / "work" / "color" / "flash.json").read_text())
    reach = told["light"]["reference_distance_m"] / FLASH.reference_distance
    assert np.median(ratio) == pytest.approx(GAIN / reach**2, rel=0.1)
    assert "no chart" in told["level"]
    assert "level" in warnings_of(colored)


def test_the_flash_is_found_beside_the_lens(colored):
    told = metrics_of(colored, "color")
    assert told["flash_right"] == pytest.approx(FLASH.position_in_camera[0], abs=0.03)
    assert told["flash_down"] == pytest.approx(FLASH.position_in_camera[1], abs=0.03)
    assert told["scatter_corrected"] < 0.25 * told["scatter_as_shot"]
    assert told["seam_step"] < told["step_noise"]
    assert told["photographed_share"] + told["inpainted_share"] == pytest.approx(100.0)


def test_exports_carry_the_colours_encoded_once(colored):
    found = colors_of(colored)
    for suffix in ("ply", "glb", "obj"):
        surface = read_surface(colored / "exports" / f"surface.{suffix}")
        linear = linear_from_srgb(surface.vertex_attributes["color"])
        told = found["color_provenance"] < 2
        assert np.abs(linear - np.clip(found["color"], 0, 1))[told].max() < 0.006
        if suffix != "obj":
            flags = surface.vertex_attributes["color_provenance"]
            assert np.array_equal(flags, found["color_provenance"])


def test_holes_are_filled_between_their_rims(colored):
    found = colors_of(colored)
    assert 0.0 < (found["color_provenance"] == 1).mean() < 0.15
    assert not (found["color_provenance"] == 2).any()
    photographed_only = found["color"][found["color_provenance"] == 0]
    filled = found["color"][found["color_provenance"] == 1]
    assert (filled >= photographed_only.min(axis=0) - 1e-6).all()
    assert (filled <= photographed_only.max(axis=0) + 1e-6).all()


def test_a_photograph_that_is_added_is_all_that_is_looked_through(tmp_path):
    project = brought(tmp_path, photos=5)
    run_to(project, "color", least_weight=0.0, **GIVEN)
    before = colors_of(project)
    kept = {p: p.stat().st_mtime_ns for p in (project / "work/color/seen").glob("*.npz")}
    assert len(kept) == 5
    assert run_to(project, "color", least_weight=0.0, **GIVEN)["color"] == "fresh"
    take(tmp_path / "photos", 5)
    assert run_to(project, "color", least_weight=0.0, **GIVEN)["color"] == "run"
    assert len(list((project / "work/color/seen").glob("*.npz"))) == 6
    assert all(p.stat().st_mtime_ns == at for p, at in kept.items())
    assert (colors_of(project)["photos"] >= before["photos"]).all()
    (tmp_path / "photos" / "photo_05.jpg").unlink()
    run_to(project, "color", least_weight=0.0, **GIVEN)
    again = colors_of(project)
    for name, values in before.items():
        assert np.array_equal(values, again[name], equal_nan=values.dtype.kind == "f")


def test_options_do_what_they_say(tmp_path):
    project = brought(tmp_path, photos=6)
    run_to(project, "color", flash="none", inpaint=False)
    plain = colors_of(project)
    assert relative(plain).std() > 0.1
    assert (plain["color_provenance"] == 2).any()
    assert np.isnan(plain["color"][plain["color_provenance"] == 2]).all()
    assert "keep the light" in warnings_of(project)
    run_to(project, "color", **GIVEN)
    assert relative(colors_of(project)).std() < 0.02
    told = json.loads((project / "work/color/flash.json").read_text())
    assert told["way"] == "given"
    assert told["light"]["position_in_camera_m"] == GIVEN["flash_position_m"]
    assert np.ptp(list(told["gains"].values())) < 0.02
    # Looked at in half the size, a quarter of the pixels: a little coarser, no more.
    run_to(project, "color", image_px=100, **GIVEN)
    assert np.median(np.abs(relative(colors_of(project)) - 1.0)) < 0.02


def test_photographs_without_flash_keep_their_light(tmp_path):
    project = brought(tmp_path, photos=6, dark=(2, 5))
    run_to(project, "color", **GIVEN)
    told = metrics_of(project, "color")
    assert told["without_flash"] == 2
    assert "photo_02" in warnings_of(project)
    lit = {path.stem for path in (project / "work/color/lit").glob("*.npz")}
    assert "photo_02" not in lit
    assert len(lit) == 4


def test_one_photograph_alone_is_corrected_from_the_lens(tmp_path):
    project = brought(tmp_path, photos=1)
    run_to(project, "color")
    assert "at the lens" in warnings_of(project)
    assert (colors_of(project)["color_provenance"] == 0).mean() > 0.2


def test_masks_keep_what_they_mask_out_of_the_colours(tmp_path):
    project = brought(tmp_path, photos=5)
    mask = np.full((200, 200), 255, np.uint8)
    mask[:, :100] = 0
    for number in range(5):
        (project / "masks" / "corrected").mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(project / "masks" / "corrected" / f"photo_{number:02d}.png"), mask)
    run_to(project, "color", **GIVEN)
    for camera, path in zip(
        ring(10, size=200), sorted((project / "work/color/seen").glob("*.npz")), strict=False
    ):
        with np.load(path) as seen:
            pixels, _ = camera.project(MESH.vertices[seen["index"]])
        assert pixels[:, 0].min() >= 99.5


def test_without_photographs_or_surface_it_is_left_out(tmp_path):
    write_surface_ply(tmp_path / "ball.ply", MESH)
    create_project(tmp_path / "bare", geometry=tmp_path / "ball.ply")
    plan = {s["name"]: s for s in workbench("plan", tmp_path / "bare")["stages"]}
    assert plan["color"]["action"] == "left out"
    assert plan["color"]["reason"] == "no photographs"
    take(tmp_path / "photos", 0)
    create_project(tmp_path / "flat", photos=[tmp_path / "photos"])
    plan = {s["name"]: s for s in workbench("plan", tmp_path / "flat")["stages"]}
    assert plan["color"]["action"] == "left out"
    assert "no surface" in plan["color"]["reason"]


def test_photographs_in_a_frame_of_their_own_colour_nothing(tmp_path):
    project = brought(tmp_path, photos=3)
    request = RunRequest(last="export", overrides={"orient": {"align": "own"}}, workers=1)
    run_pipeline(PIPELINE, Project(project), request, Progress(quiet=True))
    assert "not oriented" in warnings_of(project)
    surface = read_surface(project / "exports" / "surface.ply")
    assert (surface.vertex_attributes["color_provenance"] == 2).all()


@pytest.mark.slow
def test_the_statues_paint_from_raw_files(simulated):
    project = simulated("--scene", "statue", "--seed", "1", "--size", "small",
                        "--scans", "12", "--photos", "24",
                        "--set", "world_offset_m=[4000000,2500000,300]")  # fmt: skip
    mask = Path("truth") / "photos" / "object" / "photo_000.png"
    (project / "masks" / "training").mkdir(parents=True)
    copyfile(project / mask, project / "masks" / "training" / "photo_000.png")
    copyfile(project / "truth/masks/scan_00.png", project / "masks/training/scan_00.png")
    # So few samples in memory that they are kept in a layered cloud, which is coloured too.
    given = ("--set", "fuse.memory_samples=20000", "--set", "texture.depth_meshes=false",
             "--set", "texture.single_mesh=false")  # fmt: skip
    workbench("run", project, "--to", "color", *given)
    told = metrics_of(project, "color")
    assert told["photographed_share"] > 85.0
    assert told["seam_step"] < told["step_noise"]
    assert told["scatter_corrected"] < 0.3 * told["scatter_as_shot"]
    assert told["flash_right"] == pytest.approx(-0.13, abs=0.03)
    surface = Project(project).store.load("surface")
    found = colors_of(project)
    # Level and all: the chart anchors it.
    workbench("verify", project, *given)
    verified = metrics_of(project, "verify")
    assert verified["albedo_delta_e_mean"] < 1.5
    assert verified["camera_center_error_median"] < 0.005
    assert verified["silhouette_iou"] > 0.97
    # The cloud has the colours of the surface, finely and from afar.
    known = found["color_provenance"] == 0
    tree = cKDTree(surface.vertices[known])
    with LayeredCloud(project / "work" / "color" / "samples.cloud") as cloud:
        fine = cloud.query().arrays
        coarse = cloud.query(level=0).arrays
        assert cloud.levels > 2
    for points, colors in (
        (fine["points"], fine["albedo"]), (coarse["points"], coarse["far_albedo"])
    ):  # fmt: skip
        there = np.isfinite(colors).all(axis=1)
        assert there.mean() > 0.85
        near = tree.query(points[there])[1]
        apart = np.log(colors[there].mean(axis=1) / found["color"][known][near].mean(axis=1))
        assert abs(np.median(apart)) < 0.03
        assert np.median(np.abs(apart)) < 0.15
    total = np.nansum(fine["albedo_weight"])
    assert np.nansum(coarse["far_weight"]) == pytest.approx(total, rel=1e-3)
