"""Level-of-detail and point formats of any surface or cloud, by one name each."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from workbench.cloud.point_export import export_points
from workbench.cloud.point_sources import CLOUD_SUFFIX
from workbench.errors import InputError, SettingsError
from workbench.pipeline.model_source import ModelSource
from workbench.pipeline.surface_cells import surface_cells
from workbench.pointcodecs.codecs import CODECS
from workbench.pointcodecs.cube_export import CubeOptions, export_point_cubes
from workbench.pointcodecs.cube_file import SUFFIX as CUBE_SUFFIX
from workbench.pointcodecs.cube_file import write_point_cubes
from workbench.project.settings import suggestion
from workbench.surfels.painted_surface import PaintedSurface
from workbench.surfels.surfel_export import export_surfels
from workbench.surfels.surfel_file import SURFEL_SUFFIX
from workbench.surfels.surfel_options import SurfelOptions
from workbench.voxels.dag_file import SUFFIX as GRAPH_SUFFIX
from workbench.voxels.lod_export import LodOptions
from workbench.voxels.surface_export import (
    LOD_FORMAT,
    VOXEL_FORMATS,
    check_voxel_options,
    write_surface_voxels,
)
from workbench.voxels.voxel_points import LOD_SUFFIX

Subset = Literal["thin", "conservative"]

_VOXELS, _CELLS = 2048, 1024
#: Formats of clouds, and the files they are kept in.
CLOUD_FILES: Mapping[str, str] = {
    "laz": "points.laz",
    "las": "points.las",
    "copc": "points.copc.laz",
    "potree": "potree",
    "e57": "points.e57",
    "ply": "points.ply",
    "layered": f"points{CLOUD_SUFFIX}",
}


@dataclass(frozen=True)
class FormatOptions:
    """What may be chosen; None leaves it to the format.

    Attributes
    ----------
    resolution : voxels or cells along the longest side.
    count : surfels of each node, at most.
    candidates : pixels along a side of the pictures that surfels are chosen from.
    seed : of random draws.
    shell : voxels: faces both ways, for models one can enter.
    subset : voxels and graphs: which voxels are kept.
    geometry : voxels: keep the surface itself.
    compare : graphs: tell what other encodings take.
    workers : threads; they change no file.
    """

    resolution: int | None = None
    count: int | None = None
    candidates: int | None = None
    seed: int | None = None
    shell: bool | None = None
    subset: Subset | None = None
    geometry: bool | None = None
    compare: bool | None = None
    workers: int = 1

    def given(self) -> set[str]:
        """Names of those that were chosen."""
        names = set(self.__dataclass_fields__) - {"workers"}
        return {name for name in names if getattr(self, name) is not None}


Write = Callable[[ModelSource, Path, FormatOptions], dict[str, Any]]


@dataclass(frozen=True)
class ModelFormat:
    """One format.

    Attributes
    ----------
    file : its name in a folder; the ending is that of all its files.
    unit : what it consists of, in the plural.
    options : those it knows, by name.
    write : from a source to a file; what it tells has ``items`` and ``bytes``.
    check : raises where options cannot be, before a large file is read.
    """

    file: str
    unit: str
    options: frozenset[str]
    write: Write
    check: Callable[[FormatOptions], Any]

    def place(self, out: Path) -> Path:
        """``out`` where it has the format's ending, else the format's file in that folder."""
        named = self.ending and out.name.endswith(self.ending)
        return out if named else out / self.file

    @property
    def ending(self) -> str:
        """From the first dot on; nothing for a folder."""
        return "".join(Path(self.file).suffixes)


def write_format(
    path: Path, out: Path, name: str, options: FormatOptions | None = None
) -> dict[str, Any]:
    """Write the model in a file in one of `FORMATS`; same model and options, same bytes.

    Parameters
    ----------
    path
        A surface or a cloud.
    out
        The file to write, known by the format's ending, or a folder; made where it is missing.
    name
        Of the format.
    options
        See `FormatOptions`.

    Returns
    -------
    ``format``, ``file``, ``items``, ``unit``, ``bytes``, ``bits_per_item``, and what the format
    tells of its own.

    Raises
    ------
    SettingsError
        No such format, or an option that it does not know or cannot have.
    InputError
        The file cannot be read, or has nothing the format can hold.
    """
    chosen = options or FormatOptions()
    made = format_named(name)
    _check_options(name, made, chosen)
    made.check(chosen)
    place = made.place(out)
    if place.parent.exists() and not place.parent.is_dir():
        raise InputError(
            "A folder was expected, this is a file.", file=place.parent, fix="Name a folder."
        )
    is_new = not place.parent.exists()
    place.parent.mkdir(parents=True, exist_ok=True)
    try:
        told = made.write(ModelSource(path), place, chosen)
    except BaseException:
        if is_new:
            with suppress(OSError):
                place.parent.rmdir()
        raise
    return {
        **told,
        "format": name,
        "file": str(place),
        "unit": made.unit,
        "bits_per_item": 8.0 * told["bytes"] / max(told["items"], 1),
    }


def format_named(name: str) -> ModelFormat:
    """One of `FORMATS`.

    Raises
    ------
    SettingsError
        There is none of this name.
    """
    if name not in FORMATS:
        raise SettingsError(
            f"There is no format {name!r}",
            expected=", ".join(FORMATS),
            fix=suggestion(name, FORMATS) or "choose one of the expected names",
        )
    return FORMATS[name]


def _check_options(name: str, made: ModelFormat, options: FormatOptions) -> None:
    """No option is passed over in silence."""
    for option in sorted(options.given() - made.options):
        those = ", ".join(other for other, one in FORMATS.items() if option in one.options)
        raise SettingsError(
            f"--{option} does not belong to this format",
            expected=f"--format {those}",
            found=f"--format {name}",
            fix="leave it out, or choose another format",
        )


def _needs_surface(source: ModelSource) -> None:
    if not source.has_surface:
        raise InputError(
            "Voxels are cut from a surface, this is a cloud of points.",
            file=source.path,
            fix="Choose --format surfels, ci, eci, context or a format of clouds; or make a "
            "surface of it first.",
        )


def _lod_options(name: str, options: FormatOptions) -> LodOptions:
    given = LodOptions(
        resolution=options.resolution or _VOXELS,
        subset=options.subset or ("thin" if name == LOD_FORMAT else "conservative"),
        shell=bool(options.shell),
        geometry=options.geometry is not False,
        workers=options.workers,
    )
    check_voxel_options(name, given)
    return given


def _voxels(name: str) -> Write:
    def write(source: ModelSource, path: Path, options: FormatOptions) -> dict[str, Any]:
        _needs_surface(source)
        given = _lod_options(name, options)
        mesh, texture = source.surface
        told = write_surface_voxels(
            mesh, path, name, given, texture=texture, compare=bool(options.compare)
        )
        return told | {"items": told["voxels"], "colors": _colors(source), "subset": given.subset}

    return write


def _surfel_options(options: FormatOptions) -> SurfelOptions:
    plain = SurfelOptions()
    return SurfelOptions(
        count=plain.count if options.count is None else options.count,
        candidates_resolution=options.candidates or plain.candidates_resolution,
        seed=options.seed or 0,
        workers=options.workers,
    )


def _surfels(source: ModelSource, path: Path, options: FormatOptions) -> dict[str, Any]:
    given = _surfel_options(options)
    if not source.has_surface:
        return export_surfels(source.points, path, given)
    return export_surfels(PaintedSurface(*source.surface), path, given) | {
        "colors": _colors(source)
    }


def _cubes(codec: str) -> Write:
    def write(source: ModelSource, path: Path, options: FormatOptions) -> dict[str, Any]:
        resolution = options.resolution or _CELLS
        if source.has_surface:
            mesh, texture = source.surface
            cells = surface_cells(mesh, resolution, texture, options.workers)
            told = write_point_cubes(path, cells, codec)
        else:
            told = export_point_cubes(source.points, path, CubeOptions(codec, resolution))
        return {
            **told,
            "items": told["points"],
            "resolution": resolution,
            "cells_of": "surface" if source.has_surface else "points",
        }

    return write


def _cloud(name: str) -> Write:
    def write(source: ModelSource, path: Path, options: FormatOptions) -> dict[str, Any]:
        del options
        return export_points(source.path, path, name)

    return write


def _colors(source: ModelSource) -> str:
    mesh, texture = source.surface
    if texture is not None:
        return "texture"
    return "vertices" if "color" in mesh.vertex_attributes else "none"


def _formats() -> Mapping[str, ModelFormat]:
    lod = frozenset({"resolution", "subset", "shell", "geometry"})
    graph = frozenset({"resolution", "subset", "compare"})
    return {
        **{
            name: ModelFormat(
                f"voxels{LOD_SUFFIX if name == LOD_FORMAT else GRAPH_SUFFIX}",
                "voxels",
                lod if name == LOD_FORMAT else graph,
                _voxels(name),
                partial(_lod_options, name),
            )
            for name in VOXEL_FORMATS
        },
        "surfels": ModelFormat(
            f"surfels{SURFEL_SUFFIX}",
            "surfels",
            frozenset({"count", "candidates", "seed"}),
            _surfels,
            _surfel_options,
        ),
        **{
            name: ModelFormat(
                f"points{CUBE_SUFFIX}",
                "points",
                frozenset({"resolution"}),
                _cubes(name),
                lambda options: None,
            )
            for name in CODECS
        },
        **{
            name: ModelFormat(file, "points", frozenset(), _cloud(name), lambda options: None)
            for name, file in CLOUD_FILES.items()
        },
    }


FORMATS: Mapping[str, ModelFormat] = _formats()
"""All formats by name."""
