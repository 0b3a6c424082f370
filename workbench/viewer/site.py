"""A model as a folder of static files that any web server hands out, without code of its own.

``index.html`` with its scripts, ``scene.json`` and ``data/``. The scene says, in JSON: ``version``
(1); ``name``, ``unit``, ``up`` (x, y or z); ``origin`` (3 numbers), which added to local
coordinates gives the user's; ``bounds`` (two corners, local); ``home`` with ``eye``, ``to``
(local) and ``fov`` (degrees over the height); ``light``, how it is lit first (none or camera);
``modes``, the forms of the model with ``mode``, ``kind``, ``label``, ``file``, ``bytes``,
``items``, ``unit``, ``told`` and what else the script of a kind asks for; and ``left_out``, those
that are not there, with ``mode``, ``label`` and ``reason``.
"""

from __future__ import annotations

import json
import os
import shutil
from dataclasses import asdict, dataclass
from importlib import resources
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.point_files import point_stream
from workbench.formats.point_stream import PointStream
from workbench.geometry.framing import main_box
from workbench.pipeline.progress import Progress
from workbench.project.hashing import FileHashes, hash_of_value
from workbench.project.photo_scale import scale_is_known
from workbench.project.project import Project
from workbench.project.store import ProductStore, require_inside
from workbench.viewer.makers import REPRESENTATIONS
from workbench.viewer.representations import Exports, Made, Representation, SiteOptions

SCENE, DATA = "scene.json", "data"
# Whatever changes the bytes that makers write.
_MAKERS = 1
_FOV_DEG = 35.0
# The camera's first place: this far round from the front, this far up, degrees.
_AZIMUTH_DEG, _ELEVATION_DEG = -60.0, 15.0
# Vertices that tell what the first view holds.
_FRAMING_POINTS = 100_000
_UP = "z"


@dataclass(frozen=True)
class Site:
    """What was made.

    Attributes
    ----------
    folder : of the site.
    scene : as ``scene.json`` has it.
    """

    folder: Path
    scene: dict[str, Any]

    @property
    def bytes(self) -> int:
        """Of all its files."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file())


def build_site(project: Project, options: SiteOptions, progress: Progress) -> Site:
    """The site of a project in its ``work/view``; forms whose sources did not change are kept.

    Raises
    ------
    InputError
        The project exported no surface.
    """
    folder = project.root / "work" / "view"
    require_inside(project.root, folder)
    hashes, exports = project.hashes, Exports(project.store)
    modes, left_out, kept = [], [], set()
    for form in REPRESENTATIONS:
        if not all(project.store.paths(name) for name in form.sources):
            left_out.append({"mode": form.mode, "label": form.label, "reason": form.missing})
            continue
        key = _key(project, hashes, form, options)
        place = folder / DATA / f"{form.mode}-{key}"
        if _told(place) is None:
            with progress.step(f"{form.label.lower()} for the browser"):
                _make(exports, form, place, options)
        made = _told(place)
        if made is None:
            raise InputError(
                "What was made for the browser cannot be read again.",
                file=place / "made.json",
                fix=f"remove {folder} and view the project again",
            )
        modes.append(_entry(form, place, made))
        kept.add(place.name)
    if not modes:
        raise InputError(
            "There is nothing of this project to show.",
            file=project.root,
            fix=f"workbench export {project.root}",
        )
    hashes.save()
    _remove_others(folder / DATA, kept)
    copy_page(folder)
    store = project.store
    poses = store.load("photo_poses") if store.exists("photo_poses") else None
    scene = {
        "version": 1,
        "name": project.name,
        "unit": "m" if scale_is_known(poses) else "u",
        "up": _UP,
        **_placed(project),
        "light": "none" if modes[0]["mode"] == "textured" else "camera",
        "modes": modes,
        "left_out": left_out,
    }
    with replacing(folder / SCENE) as partial:
        partial.write_text(json.dumps(scene, indent=1, allow_nan=False) + "\n", encoding="utf-8")
    return Site(folder, scene)


def publish(site: Site, out: Path) -> Site:
    """Copy a site to a folder of its own; an older site there is replaced once all is copied.

    Raises
    ------
    InputError
        Something else is there, or the site has a link in it, whose target would be public.
    """
    out = out.resolve()
    links = [path for path in site.folder.rglob("*") if path.is_symlink()]
    if links:
        raise InputError(
            "There is a link in the site.",
            file=links[0],
            fix=f"remove {site.folder} and publish again",
        )
    if out.exists() and not (out.is_dir() and ((out / SCENE).exists() or not any(out.iterdir()))):
        raise InputError(
            "There is something else already.",
            file=out,
            expected="no folder, an empty one, or an older site",
            fix="choose another folder, or remove it",
        )
    partial, old = out.with_name(f".{out.name}.partial"), out.with_name(f".{out.name}.old")
    for leftover in (partial, old):
        shutil.rmtree(leftover, ignore_errors=True)
    shutil.copytree(site.folder, partial, ignore=shutil.ignore_patterns("made.json"))
    if out.exists():
        os.replace(out, old)
    os.replace(partial, out)
    shutil.rmtree(old, ignore_errors=True)
    return Site(out, site.scene)


def copy_page(folder: Path) -> None:
    """The page and its scripts, as this version has them."""
    _copied(resources.files("workbench.viewer").joinpath("static"), folder)


def _copied(source: Traversable, folder: Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for entry in source.iterdir():
        if entry.is_dir():
            _copied(entry, folder / entry.name)
        else:
            with replacing(folder / entry.name) as partial:
                partial.write_bytes(entry.read_bytes())


def _key(project: Project, hashes: FileHashes, form: Representation, options: SiteOptions) -> str:
    """What a form is made of and how, in a short name."""
    files = [path for name in form.sources for path in project.store.paths(name)]
    for path in files:
        # What is shown may be published: nothing gets there that is not of the project.
        if not path.resolve().is_relative_to(project.root):
            raise InputError(
                "A file to be shown is a link that leads out of the project.",
                file=path,
                found=str(path.resolve()),
                fix="put the file itself in its place",
            )
    content = [hashes.of_file(path) for path in files]
    told = [_MAKERS, form.mode, content, form.settings(options)]
    return hash_of_value(told).rpartition(":")[2][:12]


def _make(exports: Exports, form: Representation, place: Path, options: SiteOptions) -> None:
    """Write a form's files beside, then rename: a folder that is there is whole."""
    partial = place.with_name(f".{place.name}.partial")
    shutil.rmtree(partial, ignore_errors=True)
    partial.mkdir(parents=True)
    made = form.make(exports, partial, options)
    (partial / "made.json").write_text(json.dumps(asdict(made)), encoding="utf-8")
    shutil.rmtree(place, ignore_errors=True)
    os.replace(partial, place)


def _told(place: Path) -> Made | None:
    """What was made there; None where that is not known, or damaged."""
    try:
        return Made(**json.loads((place / "made.json").read_text(encoding="utf-8")))
    except (OSError, ValueError, TypeError, RecursionError):
        return None


def _entry(form: Representation, place: Path, made: Made) -> dict[str, Any]:
    files = [path for path in place.rglob("*") if path.is_file() and path.name != "made.json"]
    return {
        "mode": form.mode,
        "kind": form.kind,
        "label": form.label,
        "file": f"{DATA}/{place.name}/{form.file}",
        "bytes": sum(path.stat().st_size for path in files),
        "items": made.items,
        "unit": made.unit,
        "told": made.told,
        **made.facts,
    }


def _remove_others(folder: Path, kept: set[str]) -> None:
    for place in folder.iterdir():
        if place.name not in kept:
            shutil.rmtree(place, ignore_errors=True)


def _placed(project: Project) -> dict[str, Any]:
    """Origin, bounds and the first view of a project's surface."""
    vertices = _exported_vertices(project.store)
    origin = 0.5 * (vertices.low + vertices.high)
    every = max(1, vertices.count // _FRAMING_POINTS)
    some = [batch.points[::every] for batch in vertices.batches()]
    low, high = main_box(np.concatenate(some)) - origin
    to = 0.5 * (low + high)
    eye = to + _first_eye(high - low)
    return {
        "origin": origin.tolist(),
        "bounds": [(vertices.low - origin).tolist(), (vertices.high - origin).tolist()],
        "home": {"eye": eye.tolist(), "to": to.tolist(), "fov": _FOV_DEG},
    }


def model_bounds(store: ProductStore) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Corners (3,), (3,) of a project's exported surface; local coordinates begin amid them.

    Raises
    ------
    InputError
        No surface was exported.
    """
    vertices = _exported_vertices(store)
    return vertices.low, vertices.high


def _exported_vertices(store: ProductStore) -> PointStream:
    for name in ("surface_ply", "surface_glb", "textured_glb"):
        if store.exists(name):
            # Of a PLY the vertices alone are read, some at a time.
            return point_stream(store.path(name))
    raise InputError(
        "The project has no surface",
        file=store.root,
        fix=f"workbench export {store.root} --set export.ply=true",
    )


def _first_eye(size: NDArray[np.float64]) -> NDArray[np.float64]:
    """(3,) from where a box of a size (3,) around the origin is wholly seen."""
    away = 0.5 * float(np.linalg.norm(size)) / np.sin(0.5 * np.radians(_FOV_DEG))
    azimuth, elevation = np.radians(_AZIMUTH_DEG), np.radians(_ELEVATION_DEG)
    flat = np.cos(elevation)
    way = np.array([flat * np.cos(azimuth), flat * np.sin(azimuth), np.sin(elevation)])
    return np.asarray(away * way, np.float64)
