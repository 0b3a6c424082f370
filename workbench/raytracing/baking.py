"""How open and how accessible a surface is at each vertex, in files that need not fit in memory.

``ambient_occlusion`` is the share in [0, 1] of the cosine-weighted hemisphere over a vertex that no
part of the surface hides within the reach: 1 is open.

``accessibility`` is the radius of the largest ball that touches the surface at the vertex from
outside and meets it nowhere else: what a tool or a probe of that size can reach, and where dirt and
old paint stay. A ball of radius r about p + r n is met by a ray from p, at angle θ to the normal n,
at distance 2 r cos θ; so a hit at distance d lets r be no more than d / (2 cos θ), and the least of
these over the rays is taken (the measure is Miller's: "Efficient Algorithms for Local and Global
Accessibility Shading", SIGGRAPH 1994; he finds it by distances and by rays). It ends at half the
reach.
"""

from __future__ import annotations

import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.ply_layout import SCALAR_TYPES, ElementLayout, PlyHeader
from workbench.kernels.morton import morton_codes
from workbench.raytracing.frame import LocalFrame
from workbench.raytracing.opening import opened_rays
from workbench.raytracing.ray_hits import RayCaster, RayCounts
from workbench.raytracing.ray_light import LightOptions, Places, hemisphere_rays
from workbench.raytracing.surface_source import PlySource, SurfaceSource, surface_frame

OCCLUSION, ACCESSIBILITY = "ambient_occlusion", "accessibility"
_VERTICES_AT_ONCE = 1 << 16
# Flatter rays than this end at the facets beside a vertex, not at what keeps a ball away.
_LEAST_COSINE = 0.2
_TYPE_NAMES = {np.dtype(code): name for name, code in reversed(SCALAR_TYPES.items())}
_COPIED_AT_ONCE = 1 << 24


@dataclass(frozen=True)
class Baked:
    """What baking did.

    Attributes
    ----------
    in_core : whether the surface fitted in memory and plain Embree was asked.
    counts : of rays.
    vertices : of the surface, and ``without_normal``, those that have no side and are given NaN.
    """

    in_core: bool
    counts: RayCounts
    vertices: int
    without_normal: int


def bake(
    path: Path,
    out: Path,
    *,
    names: tuple[str, ...] = (OCCLUSION, ACCESSIBILITY),
    memory_bytes: int,
    options: LightOptions,
    progress: Callable[[float], None] = lambda share: None,
) -> Baked:
    """Write a PLY file again with float properties of each vertex more.

    Parameters
    ----------
    path
        Binary PLY, triangles; its ``nx ny nz`` say which side is looked at, else the winding.
    out
        The file to write. Temporary files are made in its folder, 24 B a vertex and, where the
        surface is too large, the size of the chunk file and 12 B a vertex and 24 B a triangle.
    names
        ``OCCLUSION``, ``ACCESSIBILITY``, or both.
    memory_bytes
        For geometry.
    options
        Samples, reach in the surface's unit, seed and rays at once.
    progress
        Is told the share that is done.

    Raises
    ------
    InputError
        A file that cannot be read in parts or has such properties already.
    """
    source = PlySource(path)
    there = set(source.vertex_row.names or ()) & set(names)
    if there:
        raise InputError(
            "The vertices have such values already.",
            file=path,
            found=", ".join(sorted(there)),
            fix="Remove them, or choose the other with --what.",
        )
    with (
        tempfile.TemporaryDirectory(prefix=f".{out.name}.", dir=out.parent) as scratch,
        opened_rays(source, memory_bytes, Path(scratch)) as caster,
    ):
        positions, normals = _vertices(source, Path(scratch))
        without = 0

        def values() -> Iterator[NDArray[np.float32]]:
            nonlocal without
            for first in range(0, source.vertices, _VERTICES_AT_ONCE):
                some = slice(first, first + _VERTICES_AT_ONCE)
                part = vertex_openness(caster, positions[some], normals[some], options)
                without += int(np.isnan(part[:, 0]).sum())
                yield part[:, [(OCCLUSION, ACCESSIBILITY).index(name) for name in names]]
                progress(min(1.0, some.stop / source.vertices))

        _write(source, out, names, values())
        counts, in_core = caster.counts, caster.in_core
    return Baked(in_core, counts, source.vertices, without)


def vertex_openness(
    caster: RayCaster,
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
    options: LightOptions,
) -> NDArray[np.float32]:
    """Open share and accessible radius (n, 2) of places; NaN for those without a normal.

    Parameters
    ----------
    caster : of the surface.
    positions : (n, 3) local.
    normals : (n, 3) of any length.
    options : ``reach`` in the surface's unit, as the radius.
    """
    answer = np.full((len(positions), 2), np.nan, np.float32)
    length = np.linalg.norm(normals, axis=1)
    sided = np.flatnonzero((length > 0.0) & np.isfinite(length))
    cells = np.clip((positions[sided] + 1.0) * (1 << 20), 0, (1 << 21) - 1).astype(np.int64)
    sided = sided[np.argsort(morton_codes(cells), kind="stable")]
    places = Places.on(positions[sided], normals[sided] / length[sided, None])
    reach = np.float32(options.reach / caster.frame.unit)
    free = np.zeros(len(sided), np.float32)
    radius = np.full(len(sided), 0.5 * reach, np.float32)
    for _, rays, cosines in hemisphere_rays(places, options):
        distances = caster.nearest(rays, float(reach)).distances
        free += np.isinf(distances).reshape(-1, len(sided)).sum(axis=0)
        allowed = np.where(cosines >= _LEAST_COSINE, distances / (2.0 * cosines), np.inf)
        radius = np.minimum(radius, allowed.reshape(-1, len(sided)).min(axis=0))
    answer[sided, 0] = free / np.float32(options.samples)
    answer[sided, 1] = radius * np.float32(caster.frame.unit)
    return answer


def _vertices(source: PlySource, folder: Path) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Local positions and normals (n, 3) of all vertices, in temporary files."""
    frame = surface_frame(source)
    shape = (source.vertices, 3)
    positions = np.memmap(folder / "vertices", np.float32, "w+", shape=shape)
    normals = np.memmap(folder / "normals", np.float32, "w+", shape=shape)
    _fill(positions, (frame.local(points) for points in source.points()))
    given = source.normals()
    if given is not None:
        _fill(normals, given)
    else:
        _add_face_normals(source, frame, positions, normals)
    return positions, normals


def _fill(values: NDArray[np.float32], parts: Iterator[NDArray[np.float32]]) -> None:
    first = 0
    for part in parts:
        values[first : first + len(part)] = part
        first += len(part)


def _add_face_normals(
    source: SurfaceSource,
    frame: LocalFrame,
    positions: NDArray[np.float32],
    normals: NDArray[np.float32],
) -> None:
    """Normals of triangles, weighted by their areas, summed at their vertices."""
    for corners in source.corners():
        a, b, c = np.moveaxis(positions[corners].astype(np.float64), 1, 0)
        # Lengths are of no matter, but float32 must not lose the smallest.
        face = np.cross(b - a, c - a) * 2.0**30
        for corner in range(3):
            np.add.at(normals, corners[:, corner], face.astype(np.float32))


def _write(
    source: PlySource, out: Path, names: tuple[str, ...], values: Iterator[NDArray[np.float32]]
) -> None:
    order = source.header.byte_order or "<"
    fields = source.vertex_row.descr + [(name, f"{order}f4") for name in names]
    with replacing(out) as partial, open(partial, "wb") as file:
        file.write(_header(source.header, names).encode())
        rest = np.empty((0, len(names)), np.float32)
        for rows in source.vertex_rows():
            while len(rest) < len(rows):
                rest = np.concatenate([rest, next(values)])
            wider = np.empty(len(rows), np.dtype(fields))
            for name in source.vertex_row.names or ():
                wider[name] = rows[name]
            for column, name in enumerate(names):
                wider[name] = rest[: len(rows), column]
            rest = rest[len(rows) :]
            file.write(wider.tobytes())
        with open(source.path, "rb") as faces:
            faces.seek(source.face_start)
            while part := faces.read(_COPIED_AT_ONCE):
                file.write(part)


def _header(header: PlyHeader, names: tuple[str, ...]) -> str:
    byte_order = "big" if header.byte_order == ">" else "little"
    lines = ["ply", f"format binary_{byte_order}_endian 1.0"]
    lines += [f"comment {text}" for text in header.comments]
    lines += [f"obj_info {text}" for text in header.obj_info]
    for element in header.elements:
        lines += _element_lines(element)
        if element.name == "vertex":
            lines += [f"property float {name}" for name in names]
    return "\n".join([*lines, "end_header", ""])


def _element_lines(element: ElementLayout) -> Iterator[str]:
    yield f"element {element.name} {element.count}"
    for declared in element.properties:
        kind = _TYPE_NAMES[declared.value_type.newbyteorder("=")]
        if declared.count_type is None:
            yield f"property {kind} {declared.name}"
        else:
            counter = _TYPE_NAMES[declared.count_type.newbyteorder("=")]
            yield f"property list {counter} {kind} {declared.name}"
