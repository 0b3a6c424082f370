"""Forms of a project's model that a browser shows, each made of what the project exported."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import Any

from workbench.formats.surface_files import read_surface
from workbench.geometry.mesh import TriangleMesh
from workbench.project.store import ProductStore


@dataclass(frozen=True)
class SiteOptions:
    """What a site is made with.

    Attributes
    ----------
    resolution : voxels along the side of the cube around the surface.
    surfels : of each node, at most.
    workers : threads.
    """

    resolution: int = 1024
    surfels: int = 50_000
    workers: int = 1


@dataclass(frozen=True)
class Exports:
    """What a project exported; the surface is read when it is asked for, and once.

    Attributes
    ----------
    store : of the project.
    """

    store: ProductStore

    @cached_property
    def surface(self) -> TriangleMesh:
        """The exported PLY, in the user's coordinates."""
        return read_surface(self.store.path("surface_ply"))


@dataclass(frozen=True)
class Made:
    """Files of one form, as a maker leaves them in its folder.

    Attributes
    ----------
    items : triangles, voxels, surfels or points.
    unit : what items are, in the plural.
    told : a sentence on it for the page.
    facts : what else the page needs to know, plain data.
    """

    items: int
    unit: str
    told: str = ""
    facts: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True)
class Representation:
    """One form of the model.

    Attributes
    ----------
    mode : its name in links.
    kind : the script that draws it.
    label : its name on the page.
    file : the file that the script begins with, in the form's folder.
    sources : artefacts it is made of; it is left out where one is missing.
    missing : why it is left out then, and what brings it.
    make : writes the files to a folder.
    settings : what of the options changes them.
    """

    mode: str
    kind: str
    label: str
    file: str
    sources: tuple[str, ...]
    missing: str
    make: Callable[[Exports, Path, SiteOptions], Made]
    settings: Callable[[SiteOptions], Any] = lambda options: None
