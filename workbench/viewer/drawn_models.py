"""Pictures of projects and files without a browser, each kind of model by its own renderer."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.formats.glb_container import read_glb_description
from workbench.formats.potree import METADATA
from workbench.formats.potree_reading import PotreeCloud
from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.photo_view import reduced_camera
from workbench.geometry.surface_texture import SurfaceTexture
from workbench.pipeline.stitched_pictures import StitchedProject
from workbench.project.project import Project
from workbench.surfels.surfel_file import SURFEL_SUFFIX, SurfelFile
from workbench.viewer.cloud_pictures import cloud_picture
from workbench.viewer.link_views import LinkView
from workbench.viewer.site import DATA, model_bounds
from workbench.viewer.surface_pictures import surface_picture
from workbench.viewer.surfel_pictures import surfel_picture
from workbench.viewer.voxel_pictures import graph_picture, voxel_picture
from workbench.viewer.wanted_views import WantedView
from workbench.voxels.dag_file import SUFFIX as GRAPH_SUFFIX
from workbench.voxels.graph_pictures import picture
from workbench.voxels.lod_file import LodFile
from workbench.voxels.voxel_points import LOD_SUFFIX, traceable_graph
from workbench.voxels.voxel_set import grid_of_mesh

_SURFACES = ("surface_ply", "surface_glb")


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
    """Voxels of a file or a project: levels of detail, or where there are none a graph."""
    made = _made(path, f"voxels-*/*{LOD_SUFFIX}")
    file = made or _exported(path, ("voxel_lod", "voxel_graph"), "voxels", "export.voxels=voxels")
    if file.suffix != LOD_SUFFIX or wanted.light in (None, "lamp"):
        return _traced(path, file, wanted)
    grid = LodFile(file).grid
    origin = _origin(path) if path.is_dir() else grid.center
    camera = wanted.camera(grid, _up(path), origin)
    store = Project(path).store if path.is_dir() else None
    surface = None
    if store is not None and store.exists("surface_ply"):
        surface = read_surface(store.path("surface_ply"))
    drawn = voxel_picture(file, surface, camera, wanted.page_light("voxels"))
    return DrawnModel(drawn, wanted.view(camera, origin))


def _graph(path: Path, wanted: WantedView) -> DrawnModel:
    """A voxel graph of a file or a project."""
    made = _made(path, f"graph-*/*{GRAPH_SUFFIX}")
    file = made or _exported(path, ("voxel_graph",), "voxel graph", "export.voxels=ssvdag")
    return _traced(path, file, wanted)


def _traced(path: Path, file: Path, wanted: WantedView) -> DrawnModel:
    voxels = traceable_graph(file)
    origin = _origin(path) if path.is_dir() else voxels.grid.center
    camera = wanted.camera(voxels.grid, _up(path), origin)
    if wanted.light in (None, "lamp"):
        drawn = picture(voxels, camera)
    else:
        drawn = graph_picture(voxels, camera, wanted.page_light("graph"))
    return DrawnModel(drawn, wanted.view(camera, origin))


def _cloud(path: Path, wanted: WantedView) -> DrawnModel:
    """The points of a folder of Potree, or those that a project exported."""
    made = _made(path, f"cloud-*/{METADATA}")
    own = path if path.name == METADATA or (path / METADATA).is_file() else None
    cloud = PotreeCloud(
        own or made or _exported(path, ("potree_metadata",), "points", 'export.clouds=["potree"]')
    )
    low, high = cloud.box
    inside = path.is_dir() and own is None
    origin = _origin(path) if inside else 0.5 * (low + high)
    camera = wanted.camera(grid_of_mesh(np.stack([low, high]), 1), _up(path), origin)
    drawn = cloud_picture(cloud, camera, wanted.page_light("cloud"))
    return DrawnModel(drawn, wanted.view(camera, origin))


def _surface(path: Path, wanted: WantedView) -> DrawnModel:
    """A surface file, or what a project exported, with its photographs where it has them."""
    mesh, texture = _painted(path)
    origin = _origin(path) if path.is_dir() else _middle(mesh)
    camera = wanted.camera(grid_of_mesh(mesh.vertices, 1), _up(path), origin)
    light = wanted.page_light("surface", "even" if texture is not None else "camera")
    drawn = surface_picture(mesh, texture, camera, light)
    return DrawnModel(drawn, wanted.view(camera, origin))


def _surfels(path: Path, wanted: WantedView) -> DrawnModel:
    """A surfel file, or a project's, exported or made for the browser."""
    made = _made(path, f"surfels-*/*{SURFEL_SUFFIX}")
    file = SurfelFile(made or _exported(path, ("surfels",), "surfels", "export.surfels=50000"))
    bounds = file.bounds(0)
    origin = _origin(path) if path.is_dir() else bounds.mean(axis=0)
    camera = wanted.camera(grid_of_mesh(bounds, 1), _up(path), origin)
    drawn = surfel_picture(file, camera, wanted.page_light("surfels"))
    return DrawnModel(drawn, wanted.view(camera, origin))


def _stitched(path: Path, wanted: WantedView) -> DrawnModel:
    """A project's depth meshes with their photographs."""
    if path.is_file():
        raise InputError(
            "Photographs are stitched on a project", file=path, fix="name the project's folder"
        )
    wanted.page_light("stitch", "even")
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
    "graph": _graph,
    "stitch": _stitched,
    "surface": _surface,
    "surfels": _surfels,
    "cloud": _cloud,
}
MODES = tuple(_RENDERERS)


def drawn_model(path: Path, mode: str, wanted: WantedView) -> DrawnModel:
    """Draw a file or a project.

    Parameters
    ----------
    path
        A file of the mode's kind, or a project's folder.
    mode
        One of ``MODES``.
    wanted
        From where.

    Raises
    ------
    SettingsError
        The place of a photograph is asked for in another mode than ``stitch``, or a lamp
        where nothing throws shadows.
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


def _made(path: Path, pattern: str) -> Path | None:
    """What was made for the page of a project last, if anything."""
    found = sorted(
        (path / "work" / "view" / DATA).glob(pattern), key=lambda file: file.stat().st_mtime_ns
    )
    return found[-1] if found else None


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
    from workbench.formats.textured_surface import read_textured_surface

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
