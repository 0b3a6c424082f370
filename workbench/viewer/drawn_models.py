"""Pictures of projects and files without a browser, each kind of model by its own renderer."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.formats.glb_container import read_glb_description
from workbench.formats.textured_surface import read_textured_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import reduced_camera
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.pipeline.stitched_pictures import StitchedProject
from workbench.project.project import Project
from workbench.surfels.surfel_file import SURFEL_SUFFIX, SurfelFile
from workbench.viewer.link_views import LinkView
from workbench.viewer.page_light import Light
from workbench.viewer.site import DATA, model_bounds
from workbench.viewer.surface_pictures import surface_picture
from workbench.viewer.surfel_pictures import surfel_picture
from workbench.voxels.graph_pictures import camera_around, picture
from workbench.voxels.voxel_points import traceable_graph
from workbench.voxels.voxel_set import VoxelGrid, grid_of_mesh

_MOST_PIXELS = 1 << 26
_VOXEL_EXPORTS = ("voxel_graph", "voxel_lod")
_SURFACES = ("surface_ply", "surface_glb")


@dataclass(frozen=True)
class WantedView:
    """What ``--camera`` and ``--size`` ask for.

    Attributes
    ----------
    photo : the name of a photograph whose place is meant, or None.
    link : a view of the page, or None.
    azimuth, elevation, up : otherwise where the camera stands around the object, degrees, and
        the object's upward axis, where it is told.
    width, height : of the picture, pixels.
    """

    photo: str | None
    link: LinkView | None
    azimuth: float
    elevation: float
    up: str | None
    width: int
    height: int

    @classmethod
    def of_texts(cls, camera: str, size: str) -> WantedView:
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
            return cls(name, None, 0.0, 0.0, None, width, height)
        if "=" in camera:
            return cls(None, LinkView.of_text(camera), 0.0, 0.0, None, width, height)
        number = r"\s*([+-]?\d+(?:\.\d*)?)\s*"
        found = re.fullmatch(rf"{number},{number}(?:,\s*([yz])\s*)?", camera)
        if not found or abs(float(found[2])) >= 90.0:
            raise SettingsError(
                f"--camera {camera!r} is not understood",
                expected="AZ,EL[,y or z] in degrees, EL between -90 and 90; eye=…;to=…;fov=…; "
                "or photo:NAME",
                fix="such as --camera 30,15",
            )
        return cls(None, None, float(found[1]), float(found[2]), found[3], width, height)

    def camera(self, grid: VoxelGrid, up: str, origin: NDArray[np.float64]) -> PhotoCamera:
        """The camera of a model in a cube, whose local coordinates begin at ``origin``."""
        if self.link is not None:
            return self.link.camera(origin, self.width, self.height)
        return camera_around(
            grid,
            self.width,
            self.height,
            azimuth=self.azimuth,
            elevation=self.elevation,
            up=self.up or up,
        )

    def view(self, camera: PhotoCamera, origin: NDArray[np.float64]) -> LinkView:
        """The view of a camera that was chosen so."""
        return self.link or LinkView.of_camera(camera, origin)


@dataclass(frozen=True)
class DrawnModel:
    """A picture, and where it was taken.

    Attributes
    ----------
    picture : (h, w, 4) uint8 sRGB; alpha 0 where nothing is.
    view : in the model's local coordinates; of photographs without lens and roll.
    """

    picture: NDArray[np.uint8]
    view: LinkView


def _voxels(path: Path, wanted: WantedView) -> DrawnModel:
    """A voxel file, or the one that a project exported."""
    file = _exported(path, _VOXEL_EXPORTS, "voxels", "export.voxels=ssvdag")
    voxels = traceable_graph(file)
    origin = _origin(path) if path.is_dir() else voxels.grid.center
    camera = wanted.camera(voxels.grid, _up(path), origin)
    return DrawnModel(picture(voxels, camera), wanted.view(camera, origin))


def _surface(path: Path, wanted: WantedView) -> DrawnModel:
    """A surface file, or what a project exported, with its photographs where it has them."""
    mesh, texture = _painted(path)
    origin = _origin(path) if path.is_dir() else _middle(mesh)
    camera = wanted.camera(grid_of_mesh(mesh.vertices, 1), _up(path), origin)
    light: Light = "even" if texture is not None else "camera"
    drawn = surface_picture(mesh, texture, camera, light)
    return DrawnModel(drawn, wanted.view(camera, origin))


def _surfels(path: Path, wanted: WantedView) -> DrawnModel:
    """A surfel file, or a project's, exported or made for the browser."""
    site = path / "work" / "view" / DATA
    made = sorted(site.glob(f"surfels-*/*{SURFEL_SUFFIX}")) if path.is_dir() else []
    file = SurfelFile(
        made[-1] if made else _exported(path, ("surfels",), "surfels", "export.surfels=50000")
    )
    bounds = file.bounds(0)
    origin = _origin(path) if path.is_dir() else bounds.mean(axis=0)
    camera = wanted.camera(grid_of_mesh(bounds, 1), _up(path), origin)
    return DrawnModel(surfel_picture(file, camera), wanted.view(camera, origin))


def _stitched(path: Path, wanted: WantedView) -> DrawnModel:
    """A project's depth meshes with their photographs."""
    if path.is_file():
        raise InputError(
            "Photographs are stitched on a project", file=path, fix="name the project's folder"
        )
    project = StitchedProject.of(Project(path))
    origin = _middle(project.surface)
    if wanted.photo is None:
        camera = wanted.camera(grid_of_mesh(project.surface.vertices, 1), "z", origin)
    else:
        whole = project.camera_of(wanted.photo)
        share = min(wanted.width / whole.width, wanted.height / whole.height)
        width, height = (max(1, round(share * side)) for side in (whole.width, whole.height))
        camera = reduced_camera(whole, width, height)
    return DrawnModel(project.picture(camera), wanted.view(camera, origin))


_RENDERERS: Mapping[str, Callable[[Path, WantedView], DrawnModel]] = {
    "voxels": _voxels,
    "stitch": _stitched,
    "surface": _surface,
    "surfels": _surfels,
}


def drawn_model(path: Path, mode: str, wanted: WantedView) -> DrawnModel:
    """Draw a file or a project.

    Parameters
    ----------
    path
        A file of the mode's kind, or a project's folder.
    mode
        ``voxels``, ``stitch``, ``surface`` or ``surfels``.
    wanted
        From where.

    Raises
    ------
    SettingsError
        The place of a photograph is asked for in another mode than ``stitch``.
    InputError
        There is nothing to draw, or it is damaged.
    """
    if wanted.photo is not None and mode != "stitch":
        raise SettingsError(
            "The places of photographs belong to projects that are stitched",
            expected="a camera around the object: AZ,EL[,UP] or eye=…;to=…;fov=…",
            found=f"photo:{wanted.photo}",
            fix="such as --camera 30,15; or --mode stitch",
        )
    return _RENDERERS[mode](path, wanted)


def _up(path: Path) -> str:
    return "z" if path.is_dir() else "y"


def _exported(path: Path, names: tuple[str, ...], what: str, setting: str) -> Path:
    """A file, or the first of a project's artefacts that is there."""
    if not path.is_dir():
        return path
    store = Project(path).store
    for name in names:
        if store.exists(name):
            return store.path(name)
    raise InputError(
        f"The project has no {what}", file=path, fix=f"workbench export {path} --set {setting}"
    )


def _painted(path: Path) -> tuple[TriangleMesh, SurfaceTexture | None]:
    """A surface and its texture, in the user's coordinates."""
    file = _exported(path, ("textured_glb", *_SURFACES), "surface", "export.ply=true")
    mesh, texture = read_textured_surface(file)
    if texture is not None and file.suffix.lower() == ".glb":
        told = read_glb_description(file)
        if not any("translation" in node for node in told.get("nodes", [])):
            # Far from the world's origin the place stands beside the mesh alone.
            extras = told.get("asset", {}).get("extras", {})
            moved = mesh.vertices + np.asarray(extras.get("world_from_positions", [0.0] * 3))
            mesh = TriangleMesh(moved, mesh.triangles, mesh.vertex_attributes)
    return mesh, texture


def _origin(folder: Path) -> NDArray[np.float64]:
    """(3,) where local coordinates of a project's site begin."""
    low, high = model_bounds(Project(folder).store)
    return np.asarray(0.5 * (low + high))


def _middle(mesh: TriangleMesh) -> NDArray[np.float64]:
    low, high = mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)
    return np.asarray(0.5 * (low + high))
