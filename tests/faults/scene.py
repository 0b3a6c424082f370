"""A small project in which every stage takes part, out of memory and in blocks where it can."""

from __future__ import annotations

import shutil
from pathlib import Path

from workbench.pipeline.progress import Progress
from workbench.project.creation import create_project
from workbench.project.simulated import simulate_project

_SIMULATION = (
    *("mesh_spacing_m=0.03", "scanner.rows=60", "scanner.cols=44"),
    *("scanner.mixed_step_min_m=0.02", "photos.camera.long_side_px=240"),
    *("photos.camera.short_side_px=160", "photos.rendering.samples_per_pixel=1"),
    *("photos.rendering.edge_samples=0", "photos.surface.indirect_rays=0"),
    *("photos.rendering.truth=masks", "photos.charts.color_frames=0"),
    *("photos.charts.flat_frames=0", "photos.charts.linearity_distances_m=[]"),
)
# Small enough for a second a stage; samples go to a cloud on disk, the surface to blocks.
_SETTINGS = """
[stages.mask]
trees = 1
[stages.fuse]
memory_samples = 1000
[stages.infill]
block_samples = 2000
depth = 5
[stages.orient]
patches_per_photo = 400
[stages.color]
flash_terms = []
[stages.texture]
depth_map_px = 32
page_px = 1024
held_out = 1
[stages.export]
voxels = "voxels"
voxel_resolution = 64
cells = "context"
cell_resolution = 64
clouds = ["potree"]
[stages.verify]
samples = 5000
picture_width_px = 120
texture_sizes_px = []
"""
_CAMERAS = ("cameras.txt", "images.txt", "points3D.txt")


def make_scene(folder: Path) -> Path:
    """A project that holds its inputs itself: four scans, five photographs, two drawn masks."""
    simulated, project = folder / "simulated", folder / "project"
    simulate_project(
        simulated,
        given={"scene": "statue", "seed": 7, "scans": 4, "photos": 5, "size": "small"},
        settings=_SIMULATION,
        progress=Progress(quiet=True),
        workers=1,
    )
    cameras = folder / "cameras"
    cameras.mkdir()
    for name in _CAMERAS:
        shutil.copy(simulated / "truth" / "photos" / name, cameras)
    create_project(
        project,
        scans=[simulated / "scans"],
        photos=[simulated / "photos"],
        cameras=cameras,
        copy=True,
    )
    drawn = project / "masks" / "training"
    drawn.mkdir(parents=True)
    shutil.copy(simulated / "truth" / "masks" / "scan_00.png", drawn)
    shutil.copy(simulated / "truth" / "photos" / "object" / "photo_000.png", drawn)
    file = project / "project.toml"
    file.write_text(file.read_text("utf-8") + _SETTINGS, "utf-8")
    shutil.rmtree(simulated)
    return project
