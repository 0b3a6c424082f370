"""Pictures of surfaces in the light that rays find, also of surfaces larger than memory."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any, cast

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.formats.gltf import encoded_from_linear
from workbench.formats.surface_files import read_surface
from workbench.project.project import Project
from workbench.raytracing.opening import opened_rays
from workbench.raytracing.ray_light import LightKind, LightOptions, picture_light, primary_rays
from workbench.raytracing.surface_source import (
    MeshSource,
    PlySource,
    SurfaceSource,
    surface_bounds,
)
from workbench.viewer.drawn_models import DrawnModel
from workbench.viewer.wanted_views import WantedView
from workbench.voxels.voxel_set import grid_of_mesh

# Towards the sun in the camera's axes: over the left shoulder.
_SUN_IN_CAMERA = np.array([-0.55, -0.62, -0.56])
# Share of the diagonal beyond which an obstacle no longer hides the sky of ``ambient``.
_REACH = 0.25
_PIXELS_AT_ONCE = 1 << 20


@dataclass(frozen=True)
class RayMemory:
    """What rays may take: bytes for geometry, and a folder for the chunks of what needs more."""

    bytes: int
    folder: Path


def ray_picture(
    path: Path, kind: str, wanted: WantedView, memory: RayMemory, samples: int
) -> tuple[DrawnModel, dict[str, Any]]:
    """The picture, and what was done for it: whether in core, rays, queries and bytes read.

    Parameters
    ----------
    path
        A surface file, or a project's folder with an exported PLY; binary PLY is read in parts.
    kind
        One of ``ray_light.LIGHT_KINDS``.
    wanted
        From where; without a light of its own, as the kind is one.
    memory
        For geometry.
    samples
        Rays a pixel sends on, at most.

    Raises
    ------
    SettingsError
        The place of a photograph, or a light, is asked for.
    InputError
        There is no surface, or it cannot be used.
    """
    if wanted.photo is not None or wanted.light is not None:
        raise SettingsError(
            f"--mode {kind} has its own light, and no photographs",
            expected="a camera around the object, and no --light",
            fix="leave --light out; --camera 30,15",
        )
    source = _source(path)
    low, high = surface_bounds(source)
    origin = 0.5 * (low + high)
    up = "z" if path.is_dir() else "y"
    camera = wanted.camera(grid_of_mesh(np.stack([low, high]), 1), up, origin)
    sun = _SUN_IN_CAMERA @ camera.camera_from_world[:3, :3]
    with opened_rays(source, memory.bytes, memory.folder) as caster:
        reach = _REACH * float(np.linalg.norm(high - low)) / caster.frame.unit
        options = LightOptions(
            samples=samples, reach=reach, sun=(float(sun[0]), float(sun[1]), float(sun[2]))
        )
        rays, order = primary_rays(caster.frame, camera)
        picture = np.zeros((len(rays), 4), np.uint8)
        for first in range(0, len(rays), _PIXELS_AT_ONCE):
            some = slice(first, first + _PIXELS_AT_ONCE)
            linear, met = picture_light(caster, rays[some], cast("LightKind", kind), options)
            picture[order[some]] = _bytes(linear, met)
        told = {
            "in_core": caster.in_core,
            "rays": caster.counts.rays,
            "queries": caster.counts.queries,
            "bytes_read": caster.counts.bytes_read,
        }
    drawn = picture.reshape(camera.height, camera.width, 4)
    return DrawnModel(drawn, wanted.view(camera, origin)), told


def _bytes(linear: NDArray[np.float32], met: NDArray[np.bool_]) -> NDArray[np.uint8]:
    """(n, 4) sRGB and alpha."""
    colors = np.rint(255.0 * encoded_from_linear(np.clip(linear, 0.0, 1.0)))
    return np.column_stack([colors, 255.0 * met]).astype(np.uint8)


def _source(path: Path) -> SurfaceSource:
    file = path
    if path.is_dir():
        store = Project(path).store
        if not store.exists("surface_ply"):
            raise InputError(
                "The project has no surface as PLY",
                file=path,
                fix=f"workbench export {path} --set export.ply=true",
            )
        file = store.path("surface_ply")
    return PlySource(file) if file.suffix.lower() == ".ply" else MeshSource(read_surface(file))
