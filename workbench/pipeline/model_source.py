"""A model in a file, whatever it is: a surface, or points."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from workbench.cloud.point_sources import CLOUD_SUFFIX, points_of
from workbench.errors import InputError
from workbench.formats.ply_layout import LONGEST_HEADER, parse_header
from workbench.formats.point_files import POINT_SUFFIXES
from workbench.formats.surface_files import SURFACE_SUFFIXES
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.point_set import PointSet
from workbench.geometry.surface_texture import SurfaceTexture

MODEL_SUFFIXES = tuple(dict.fromkeys((*SURFACE_SUFFIXES, ".gltf", *POINT_SUFFIXES, CLOUD_SUFFIX)))
"""The extensions of files with a surface or points, in lower case."""


@dataclass(frozen=True)
class ModelSource:
    """A file with a surface or points; it is read when it is asked for, and once.

    Attributes
    ----------
    path : of the file.
    """

    path: Path

    @cached_property
    def has_surface(self) -> bool:
        """Whether the file has triangles, as far as its name and header tell.

        Raises
        ------
        InputError
            Another kind of file, or its header is damaged.
        """
        suffix = self.path.suffix.lower()
        if suffix not in MODEL_SUFFIXES:
            raise InputError(
                "This kind of file is read neither as a surface nor as points.",
                file=self.path,
                expected=", ".join(MODEL_SUFFIXES),
                found=suffix or "no extension",
                fix="Export it to one of these formats.",
            )
        if suffix != ".ply":
            return suffix in SURFACE_SUFFIXES or suffix == ".gltf"
        if not self.path.is_file():
            return True  # Reading it as a surface says what is wrong.
        with open(self.path, "rb") as file:
            header = parse_header(file.read(LONGEST_HEADER), self.path)
        return any(element.name == "face" and element.count for element in header.elements)

    @cached_property
    def surface(self) -> tuple[TriangleMesh, SurfaceTexture | None]:
        """As `read_textured_surface` gives it, with the same errors."""
        from workbench.formats.textured_surface import read_textured_surface

        return read_textured_surface(self.path)

    @cached_property
    def points(self) -> PointSet:
        """As `points_of` gives them, with the same errors: of a surface its vertices."""
        return points_of(self.path)
