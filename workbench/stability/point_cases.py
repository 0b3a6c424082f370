"""Points that coincide, lie in line or far away: codecs, clouds, surfels, normals."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.cloud.building import build_cloud
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.schema import Attribute, Schema
from workbench.geometry.orientedscan import OrientationSettings, orient
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.point_set import PointSet
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.regions import Box
from workbench.geometry.transforms import inverse, looking_at
from workbench.pointcodecs.cube_export import CubeOptions, export_point_cubes
from workbench.pointcodecs.cube_file import read_point_cubes
from workbench.stability.case import Bound, Case, Measured, Refused
from workbench.stability.surface_cases import ball_samples
from workbench.surfels.drawing import disc_view
from workbench.surfels.orders import exact_order, progressive_order
from workbench.surfels.point_normals import estimated_normals
from workbench.surfels.surfel_export import export_surfels
from workbench.surfels.surfel_file import surfel_points
from workbench.surfels.surfel_options import SurfelOptions

_CODEC, _CLOUD, _SURFELS = "point codecs", "layered cloud", "surfels"
_UTM = np.array([512_345.0, 5_412_345.0, 312.0])


def _points(kind: str) -> NDArray[np.float64]:
    rng = np.random.default_rng(0)
    if kind == "ball":
        return ball_samples(5000).points
    if kind == "line":
        return np.outer(rng.uniform(-1, 1, 2000), [1.0, 2.0, 3.0])
    if kind == "half in one place":
        return np.concatenate([np.full((1000, 3), 0.25), rng.uniform(-1, 1, (1000, 3))])
    if kind == "1e12:1":
        return np.concatenate([1e-6 * rng.random((1000, 3)), 1e6 * rng.random((2, 3))])
    return np.full((1 if kind == "one point" else 2000, 3), 0.25)


# -- codecs --------------------------------------------------------------------------------


def _coded(kind: str, codec: str, factor: float = 1.0, shift: float = 0.0) -> Measured | Refused:
    """The farthest that a point is from what is read again, over half a cell's diagonal."""
    points = factor * _points(kind) + shift * _UTM
    with TemporaryDirectory() as folder:
        path = Path(folder) / "points.pcube"
        figures = export_point_cubes(PointSet(points), path, CubeOptions(codec, 512))
        read = read_point_cubes(path)
    centers = read.frame.centers(read.cells)
    places = np.floor((points - read.frame.origin) / read.frame.cell_size)
    asked = np.unique(places.astype(np.int64), axis=0)
    if not np.array_equal(asked, np.unique(read.cells.astype(np.int64), axis=0)):
        return Measured.nothing(f"{len(read.cells)} cells, not {len(asked)}")
    near = np.abs(points - read.frame.centers(places.astype(np.int32))).max()
    told = f"{len(centers)} cells, points moved by {figures['largest_move']:.3g} at most"
    return Measured(float(near / read.frame.cell_size), told)


# -- clouds --------------------------------------------------------------------------------


def _cloud_of(points: NDArray[np.float64]) -> Measured:
    """A cloud gives back its samples to the bit, and by regions the ones in them."""
    numbers = np.arange(len(points), dtype=np.int32)
    schema = Schema((Attribute("number", "int32"),))
    with TemporaryDirectory() as folder:
        path = Path(folder) / "points.cloud"
        block: dict[str, NDArray[Any]] = {"points": points, "number": numbers}
        build_cloud(path, [block], schema, points_per_chunk=500, workers=1)
        with LayeredCloud(path) as cloud:
            found = cloud.query().arrays
            levels = cloud.levels
            low, high = points.min(axis=0), np.median(points, axis=0)
            part = cloud.query(Box(low, high)).arrays
    order = np.argsort(found["number"])
    same = np.array_equal(found["points"][order].view(np.int64), points.view(np.int64))
    inside = ((points >= low) & (points <= high)).all(axis=1)
    wrong = not np.array_equal(np.sort(part["number"]), numbers[inside])
    return Measured(float(not same) + float(wrong), f"{len(points)} samples in {levels} levels")


def _special_cloud() -> Measured:
    """Coordinates of both zeros, denormal and as large as may be squared."""
    special = np.array([0.0, -0.0, 5e-324, -5e-324, 2.2e-308, 1e-30, 1e30, -1e30, 1.0])
    rng = np.random.default_rng(1)
    return _cloud_of(rng.choice(special, (3000, 3)))


# -- surfels -------------------------------------------------------------------------------


def _ordered(kind: str, exact: bool) -> Measured:
    """Every prefix of an order covers all points to within the reach that is told."""
    points = _points(kind)
    order = (exact_order if exact else progressive_order)(points, min(400, len(points)))
    if len(np.unique(order.picks)) != len(order.picks):
        return Measured.nothing("a point is taken twice")
    size = max(float(np.ptp(points, axis=0).max()), 1e-300)
    worst = 0.0
    for count in {1, len(order) // 2, len(order)} - {0}:
        taken = points[order.picks[:count]]
        apart = np.linalg.norm(points[:, None] - taken, axis=2).min(axis=1).max()
        told = order.reach[count] if count < len(order) else order.rest
        if exact and not np.isfinite(told):
            return Measured.nothing("no reach is told")
        worst = max(worst, float(apart - told) / size) if exact else worst
    return Measured(worst, f"{len(order)} of {len(points)} taken")


def _surfel_file(kind: str, factor: float = 1.0, shift: float = 0.0) -> Measured | Refused:
    """Surfels of a cloud lie where some of its points do, to the steps of 16 bits."""
    points = factor * _points(kind) + shift * _UTM
    with TemporaryDirectory() as folder:
        path = Path(folder) / "points.surfels"
        figures = export_surfels(PointSet(points), path, SurfelOptions(count=500, memory_mib=512))
        read = surfel_points(path)
    normals = np.linalg.norm(np.asarray(read.normals, float), axis=1)
    if not np.allclose(normals, 1.0, atol=1e-3):
        return Measured.nothing("normals that are not unit")
    near = np.abs(read.points[:, None] - points).max(axis=2).min(axis=1).max()
    size = max(float(np.ptp(points, axis=0).max()), 1e-300)
    return Measured(float(near / size), f"{figures['items']} surfels of {len(points)} points")


def _drawn_behind() -> Measured:
    """Discs behind the camera, at it and edge-on: no pixel without a depth before it."""
    rng = np.random.default_rng(2)
    points = np.concatenate([rng.uniform(-1, 1, (500, 3)), np.zeros((20, 3))])
    normals = rng.standard_normal((520, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    camera = PhotoCamera(
        "SIMPLE_PINHOLE", 64, 64, (60.0, 32.0, 32.0),
        inverse(looking_at((0.0, 0.0, 0.0), (0.0, 1.0, 0.0))),
    )  # fmt: skip
    view = disc_view(PointSet(points, normals.astype(np.float32)), 0.05, camera)
    wrong = view.covered & ~(np.isfinite(view.depth) & (view.depth > 0.0))
    return Measured(float(wrong.sum()), f"{int(view.covered.sum())} pixels covered")


# -- normals -------------------------------------------------------------------------------


def _plane_normals(factor: float, shift: float) -> Measured:
    """Normals of a tilted plane in another unit and at another place, degrees."""
    rng = np.random.default_rng(3)
    flat = rng.uniform(-1, 1, (2000, 2))
    points = np.column_stack([flat, 0.37 * flat[:, 0] + 0.21 * flat[:, 1]])
    true = np.array([-0.37, -0.21, 1.0]) / np.linalg.norm([0.37, 0.21, 1.0])
    found = estimated_normals(factor * points + shift * _UTM).astype(float)
    return Measured(_degrees(found, true))


def _degrees(found: NDArray[np.float64], true: NDArray[np.float64]) -> float:
    return float(np.degrees(np.linalg.norm(np.cross(found, true), axis=1).max()))


def _unit_normals(kind: str) -> Measured:
    """Every point has a unit normal, whether or not its neighbours tell one."""
    lengths = np.linalg.norm(estimated_normals(_points(kind)).astype(float), axis=1)
    return Measured(float(np.abs(lengths - 1.0).max()))


def _scan_of(kind: str) -> Measured | Refused:
    """A scan without a grid: samples whose neighbours span no plane are left out."""
    found = orient(RangeMap("scan", _points(kind)), OrientationSettings())
    return Measured(float(len(found)), f"{len(found)} samples trusted")


def _grid_far() -> Measured:
    """A scan's grid at UTM coordinates: normals of a plane, in degrees."""
    x, y = np.meshgrid(np.linspace(0, 1, 40), np.linspace(0, 1, 40))
    points = np.stack([x, y, 0.3 * x], axis=-1).reshape(-1, 3) + _UTM
    grid = np.arange(1600, dtype=np.int32).reshape(40, 40)
    viewpoint = _UTM + np.array([0.0, 0.0, 5.0])
    found = orient(RangeMap("scan", points, grid, viewpoint), OrientationSettings())
    true = np.array([-0.3, 0.0, 1.0]) / np.hypot(0.3, 1.0)
    return Measured(_degrees(found.normals, true), f"{len(found)} of 1600 trusted")


def _case(
    name: str,
    method: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
) -> Case:
    return Case(f"points/{name}", method, stiff, run, bound, refusal)


_HALF = Bound(0.5 + 1e-6, "cells", "a cell's half side: the codec is lossless for cells")
_BITS = Bound(0.0, "", "lossless to the bit")
_STEP = Bound(1.5e-5, "of the size", "steps of 16 bits along an axis")
_COVER = Bound(1e-7, "of the size", "distances are compared in single precision")
_UNIT = Bound(1e-6, "", "single precision")
_FLAT = Bound(1e-3, "°", "single precision of the normals and rounding of the places")

POINT_CASES = (
    *(
        _case(f"{codec}, {kind}", _CODEC, f"Points: {kind}.", partial(_coded, kind, codec), _HALF)
        for codec in ("ci", "eci", "context")
        for kind in ("line", "half in one place", "1e12:1")
    ),
    _case("one place, coded", _CODEC, "All points in one place have no extent.",
          partial(_coded, "one place", "context"), refusal="one place"),
    _case("scale 1e-6, coded", _CODEC, "A ball of a micrometre.",
          partial(_coded, "ball", "context", 1e-6), _HALF),
    _case("UTM offset, coded", _CODEC, "A ball 5400 km away.",
          partial(_coded, "ball", "context", 1.0, 1.0), _HALF),
    _case("ball in a cloud", _CLOUD, "An ordinary cloud, to compare with.",
          lambda: _cloud_of(_points("ball")), _BITS),
    *(
        _case(f"{kind} in a cloud", _CLOUD, f"Samples: {kind}.",
              partial(lambda kind: _cloud_of(_points(kind)), kind), _BITS)
        for kind in ("one place", "half in one place", "one point", "1e12:1", "line")
    ),
    _case("special numbers in a cloud", _CLOUD, "Both zeros, denormal and huge coordinates.",
          _special_cloud, _BITS),
    *(
        _case(f"{'exact' if exact else 'rounds'} of {kind}", _SURFELS, f"Points: {kind}.",
              partial(_ordered, kind, exact), _COVER)
        for exact in (True, False)
        for kind in ("one place", "half in one place", "line", "one point", "1e12:1")
    ),
    *(
        _case(f"file of {kind}", _SURFELS, f"Points: {kind}.", partial(_surfel_file, kind), _STEP)
        for kind in ("one place", "line", "one point", "1e12:1")
    ),
    _case("file at UTM", _SURFELS, "A ball 5400 km away.",
          partial(_surfel_file, "ball", 1.0, 1.0), _STEP),
    _case("file, scale 1e-6", _SURFELS, "A ball of a micrometre.",
          partial(_surfel_file, "ball", 1e-6), _STEP),
    _case("discs at the camera", _SURFELS, "Discs behind the camera, in it and edge-on.",
          _drawn_behind, Bound(0.0, "", "none is allowed")),
    _case("normals, scale 1e-6", "normals of points", "A plane of a micrometre.",
          partial(_plane_normals, 1e-6, 0.0), _FLAT),
    _case("normals, scale 1e5", "normals of points", "A plane of a hundred kilometres.",
          partial(_plane_normals, 1e5, 0.0), _FLAT),
    _case("normals, UTM offset", "normals of points", "A plane 5400 km away.",
          partial(_plane_normals, 1.0, 1.0), _FLAT),
    *(
        _case(f"normals of {kind}", "normals of points", f"Points: {kind}.",
              partial(_unit_normals, kind), _UNIT)
        for kind in ("line", "one place", "one point")
    ),
    *(
        _case(f"scan of {kind}", "normals of scans", f"Samples: {kind}.", partial(_scan_of, kind),
              Bound(0.0, "samples", "no neighbourhood spans a plane"))
        for kind in ("line", "one place")
    ),
    _case("scan at UTM", "normals of scans", "A scanner's grid 5400 km from its origin.",
          _grid_far, Bound(1e-3, "°", "places are rounded to 1e-9 m, samples are 2.5 cm apart")),
)  # fmt: skip
