"""Pictures without a display: of voxel files, and of projects from their photographs."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from workbench.cli.parameters import JsonOption
from workbench.console import Answer
from workbench.errors import InputError, SettingsError
from workbench.pipeline.meter import Meter
from workbench.pipeline.progress import Progress
from workbench.project.project import Project
from workbench.project.settings import suggestion

if TYPE_CHECKING:
    from workbench.geometry.photo_camera import PhotoCamera
    from workbench.voxels.voxel_set import VoxelGrid

MODES = ("voxels", "stitch")
_MOST_PIXELS = 1 << 26
_VOXEL_EXPORTS = ("voxel_graph", "voxel_lod")


@dataclass(frozen=True)
class _Wanted:
    """What ``--camera`` and ``--size`` ask for; angles in degrees, or the name of a photograph."""

    photo: str | None
    azimuth: float
    elevation: float
    up: str | None
    width: int
    height: int

    def around(self, grid: VoxelGrid, up: str) -> PhotoCamera:
        """A camera that sees the whole of a cube."""
        from workbench.voxels.graph_pictures import camera_around

        return camera_around(
            grid,
            self.width,
            self.height,
            azimuth=self.azimuth,
            elevation=self.elevation,
            up=self.up or up,
        )


def add_render_commands(app: typer.Typer) -> None:
    """``render``."""

    @app.command(rich_help_panel="Tools")
    def render(
        path: Annotated[Path, typer.Argument(help="A .voxgraph or .vlod file, or a project.")],
        out: Annotated[Path, typer.Option(help="The PNG file to write.")],
        mode: Annotated[
            str,
            typer.Option(
                help="voxels: traced, with hard shadows; stitch: a project's depth meshes with "
                "its photographs."
            ),
        ] = "voxels",
        camera: Annotated[
            str,
            typer.Option(
                metavar="AZ,EL[,UP]",
                help="Degrees around and above the object, and its upward axis (y, or z for "
                "projects); photo:NAME for the place of a project's photograph.",
            ),
        ] = "30,15",
        size: Annotated[
            str, typer.Option(metavar="WxH", help="Pixels; a photograph's view fits inside.")
        ] = "1280x720",
        as_json: JsonOption = False,
    ) -> Answer:
        """A picture without a display."""
        if mode not in MODES:
            raise SettingsError(
                f"There is no mode {mode!r}",
                expected=", ".join(MODES),
                fix=suggestion(mode, MODES) or "choose one of the expected names",
            )
        wanted = _wanted(camera, size)
        if out.suffix.lower() != ".png" or not out.parent.is_dir():
            raise InputError(
                "The picture cannot be written there",
                file=out,
                expected="a .png file in a folder that exists",
                fix="correct --out",
            )
        with Progress().step(f"rendering {path.name}"), Meter() as meter:
            drawn = _stitched(path, wanted) if mode == "stitch" else _traced(path, wanted)
            _write(out, drawn)
        height, width = drawn.shape[:2]
        shown = float((drawn[..., 3] > 0).mean())
        return Answer(
            {
                "file": str(out),
                "mode": mode,
                "width": width,
                "height": height,
                "shown": shown,
                "seconds": meter.seconds,
                "peak_rss_bytes": meter.peak_rss_bytes,
            },
            f"{out}: {width} × {height} pixels in {meter.seconds:.1f} s",
        )


def _traced(path: Path, wanted: _Wanted) -> Any:
    """A voxel file, or the one that a project exported."""
    from workbench.voxels.graph_pictures import picture
    from workbench.voxels.voxel_points import traceable_graph

    if wanted.photo is not None:
        raise SettingsError(
            "Voxels are drawn from around the object",
            expected="AZ,EL[,UP]",
            found=f"photo:{wanted.photo}",
            fix="such as --camera 30,15; or --mode stitch",
        )
    up = "z" if path.is_dir() else "y"
    voxels = traceable_graph(_exported_voxels(path) if path.is_dir() else path)
    return picture(voxels, wanted.around(voxels.grid, up))


def _exported_voxels(folder: Path) -> Path:
    store = Project(folder).store
    for name in _VOXEL_EXPORTS:
        if store.exists(name):
            return store.path(name)
    raise InputError(
        "The project has no voxels",
        file=folder,
        fix=f"workbench export {folder} --set export.voxels=ssvdag",
    )


def _stitched(path: Path, wanted: _Wanted) -> Any:
    from workbench.geometry.photo_view import reduced_camera
    from workbench.pipeline.stitched_pictures import StitchedProject
    from workbench.voxels.voxel_set import grid_of_mesh

    if path.is_file():
        raise InputError(
            "Photographs are stitched on a project", file=path, fix="name the project's folder"
        )
    project = StitchedProject.of(Project(path))
    if wanted.photo is None:
        return project.picture(wanted.around(grid_of_mesh(project.surface.vertices, 1), "z"))
    camera = project.camera_of(wanted.photo)
    share = min(wanted.width / camera.width, wanted.height / camera.height)
    width, height = (max(1, round(share * side)) for side in (camera.width, camera.height))
    return project.picture(reduced_camera(camera, width, height))


def _write(out: Path, drawn: Any) -> None:
    from workbench.formats.atomic import replacing
    from workbench.formats.color_png import write_color_png

    with replacing(out) as partial:
        write_color_png(partial, drawn)


def _wanted(camera: str, size: str) -> _Wanted:
    """What the texts say.

    Raises
    ------
    SettingsError
        They say nothing that is understood.
    """
    sides = re.fullmatch(r"(\d{1,6})[x×](\d{1,6})", size)
    width, height = (int(side) for side in sides.groups()) if sides else (0, 0)
    if not 0 < width * height <= _MOST_PIXELS:
        raise SettingsError(
            f"--size {size!r} is not understood",
            expected=f"WxH, at most {_MOST_PIXELS:,} pixels",
            fix="such as --size 1280x720",
        )
    kind, _, name = camera.partition(":")
    if kind == "photo" and name:
        return _Wanted(name, 0.0, 0.0, None, width, height)
    number = r"\s*([+-]?\d+(?:\.\d*)?)\s*"
    found = re.fullmatch(rf"{number},{number}(?:,\s*([yz])\s*)?", camera)
    if not found or abs(float(found[2])) >= 90.0:
        raise SettingsError(
            f"--camera {camera!r} is not understood",
            expected="AZ,EL[,y or z] in degrees, EL between -90 and 90; or photo:NAME",
            fix="such as --camera 30,15",
        )
    return _Wanted(None, float(found[1]), float(found[2]), found[3], width, height)
