"""Numbers that are none, without bound or next to zero, in every method's input.

One number of the input is exchanged. A method that is told of nothing else must refuse NaN and
infinity by name, or pass them over where its documentation says so; a denormal number is as good
as zero.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, partial
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.cloud.fusion import merged
from workbench.color.blending import blended
from workbench.color.blending_colors import Colored
from workbench.color.diffusion_graph import edges_of_cloud, sample_graph
from workbench.color.flash_estimation import estimated_flash
from workbench.color.flash_light import FlashLight
from workbench.color.flash_observations import FlashObservations, NoFlashEstimate
from workbench.color.inpainting import inpainted
from workbench.color.linearity import NotChecked, fitted_linearity
from workbench.errors import InputError
from workbench.geometry.mesh import TriangleMesh
from workbench.geometry.orientedscan import OrientationSettings, OrientedScan, orient
from workbench.geometry.point_set import PointSet
from workbench.geometry.rangemap import RangeMap
from workbench.geometry.samples import Samples
from workbench.geometry.similarity import NoSimilarity, best_similarity
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.surface_sampling import sample_surface
from workbench.geometry.transforms import Matrix4
from workbench.pointcodecs.point_cells import cells_of_points, frame_of_resolution
from workbench.registration.adjustment import AdjustmentSettings, adjust
from workbench.registration.placement import PlacementSettings, place
from workbench.render.stitch.levelling import levelling
from workbench.stability.camera_cases import ball_mesh
from workbench.stability.case import Bound, Case, Measured, Refused
from workbench.stability.diffusion_cases import square_graph
from workbench.stability.flash_cases import flash_scene
from workbench.stability.scanned_bodies import Scanned, body_scans
from workbench.stability.surface_cases import ball_samples
from workbench.stability.texture_cases import chain_problem
from workbench.surface.poisson import PoissonSettings, reconstruct
from workbench.surface.provenance import support_of
from workbench.surface.refinement import moved_onto_samples
from workbench.surfels.orders import exact_order
from workbench.surfels.point_normals import estimated_normals
from workbench.texturing.expansion import expanded
from workbench.voxels.voxel_set import grid_of_mesh

_VALUES = {"NaN": np.nan, "infinite": np.inf, "denormal": 5e-324}
Numbers = NDArray[np.float64]
Answer = Callable[[float], Numbers]
_Given = TypeVar("_Given", Samples, FlashObservations)


def broken(values: Numbers, value: float, at: int = 7) -> Numbers:
    """A copy with one number exchanged."""
    copied = values.copy()
    copied.flat[at] = value
    return copied


def _with(given: _Given, name: str, value: float) -> _Given:
    """The same with one number of an attribute exchanged."""
    changed: dict[str, Any] = {name: broken(getattr(given, name), value)}
    return replace(given, **changed)


@cache
def _body() -> Scanned:
    return body_scans(views=3, side=24)


def _adjusted_points(value: float) -> Numbers:
    body = _body()
    first = replace(body.scans[0], points=broken(body.scans[0].points, value, 900))
    return _poses((first, *body.scans[1:]), body.coarse)


def _adjusted_poses(value: float) -> Numbers:
    body = _body()
    return _poses(body.scans, (broken(body.coarse[0], value, 3), *body.coarse[1:]))


def _poses(scans: tuple[OrientedScan, ...], coarse: tuple[Matrix4, ...]) -> Numbers:
    found = adjust(scans, coarse, _body().names, AdjustmentSettings(max_rounds=3))
    return np.array([*found.poses])


def _placed(value: float) -> Numbers:
    body = _body()
    first = replace(body.scans[0], normals=broken(body.scans[0].normals, value))
    found = place(
        (first, *body.scans[1:]), body.viewpoints, body.names, PlacementSettings(threads=1)
    )
    return np.array([*found.poses])


def _oriented(value: float, ordered: bool) -> Numbers:
    x, y = (v.ravel() for v in np.meshgrid(np.linspace(0, 1, 20), np.linspace(0, 1, 20)))
    points = broken(np.column_stack([x, y, 0.1 * np.sin(5 * x)]), value, 605)
    grid = np.arange(400, dtype=np.int32).reshape(20, 20) if ordered else None
    scan = RangeMap("scan", points, grid, np.array([0.0, 0.0, 5.0]))
    found = orient(scan, OrientationSettings())
    return np.concatenate([found.points.ravel(), found.normals.ravel(), found.reach_m])


def _solved(value: float) -> Numbers:
    ball = ball_samples(300)
    mesh = reconstruct(broken(ball.points, value), ball.normals, PoissonSettings(5))
    return mesh.vertices


def _merged(name: str) -> Answer:
    def run(value: float) -> Numbers:
        ball = ball_samples(300)
        found = merged(_with(ball, name, value), 0.5)
        return np.concatenate([found.points.ravel(), found.normals.ravel(), found.confidence])

    return run


def _moved(name: str) -> Answer:
    def run(value: float) -> Numbers:
        ball = ball_samples(300)
        return moved_onto_samples(ball_mesh(), _with(ball, name, value), 1).vertices

    return run


def _supported(value: float) -> Numbers:
    mesh, ball = ball_mesh(), ball_samples(300)
    there = replace(ball, points=broken(ball.points, value))
    return support_of(mesh.vertices, mesh.vertex_attributes["normal"], there, 1.0).distance_m


def _painted(what: str) -> Answer:
    def run(value: float) -> Numbers:
        graph = square_graph(12, np.ones)
        weights = np.ones(144)
        weights[50:90] = 0.0
        colors = np.full((144, 3), 0.5)
        if what == "colour":
            colors = broken(colors, value)
        elif what == "weight":
            weights = broken(weights, value)
        else:
            graph = replace(graph, conductances=broken(graph.conductances, value))
        return inpainted(colors, weights, graph).colors

    return run


def _neighbours(value: float) -> Numbers:
    points = broken(ball_samples(200).points, value)
    return sample_graph(edges_of_cloud(points), points).conductances


def _flash(what: str) -> Answer:
    def run(value: float) -> Numbers:
        seen = flash_scene()
        found = estimated_flash(_with(seen, what, value))
        if isinstance(found, NoFlashEstimate):
            raise InputError("no flash", found=found.reason)
        return np.concatenate([found.light.position_in_camera, found.gains])

    return run


def _light(value: float) -> Numbers:
    light = FlashLight(np.array([-0.1, value, 0.0]))
    return light.received(np.array([[0.0, 0.0, 1.0]]), np.array([[0.0, 0.0, -1.0]]))


def _blended(value: float) -> Numbers:
    index = np.arange(20)
    photos = [Colored(index, broken(np.full((20, 3), 0.4), value), np.ones(20)) for _ in range(3)]
    return blended(photos, 20).colors


def _linear(value: float) -> Numbers:
    frames = {"a": (1.0, 0.5), "b": (2.0, 0.125), "c": (value, 0.03)}
    found = fitted_linearity(frames, metric=True)
    if isinstance(found, NotChecked):
        raise InputError("linearity cannot be told", found=found.reason)
    return np.array([found.factor, found.residual, found.exponent])


def _labelled(value: float) -> Numbers:
    costs = np.random.default_rng(0).random((5, 3))
    problem = chain_problem([(0, 1, 2)] * 5, broken(costs, value).tolist())
    return expanded(problem).labels.astype(float)


def _view(value: float) -> Numbers:
    label = np.zeros((30, 40), np.int32)
    label[:, 20:] = 1
    color = np.full((30, 40, 3), 0.5, np.float32)
    color[15, 19, 1] = value
    return levelling(color, label, np.ones((30, 40), np.float32), 0.1).change.astype(float)


def _gridded(value: float) -> Numbers:
    grid = grid_of_mesh(broken(ball_mesh().vertices, value), 5)
    return np.array([*grid.origin, grid.size])


def _coded(value: float) -> Numbers:
    points = broken(ball_samples(300).points, value)
    return cells_of_points(PointSet(points), frame_of_resolution(points, 64)).cells.astype(float)


def _ordered(value: float) -> Numbers:
    return exact_order(broken(ball_samples(300).points, value), 50).picks.astype(float)


def _normals(value: float) -> Numbers:
    return estimated_normals(broken(ball_samples(300).points, value)).astype(float)


def _rays(value: float) -> Numbers:
    mesh = ball_mesh()
    rays = SurfaceRays(TriangleMesh(broken(mesh.vertices, value), mesh.triangles))
    return rays.first_met(np.array([0.0, -3.0, 0.0]), np.array([[0.0, 1.0, 0.0]])).points


def _sampled(value: float) -> Numbers:
    mesh = ball_mesh()
    return sample_surface(TriangleMesh(broken(mesh.vertices, value), mesh.triangles), 100, 0)[0]


def _similar(value: float) -> Numbers:
    points = ball_samples(50).points
    found = best_similarity(broken(points, value), points)
    if isinstance(found, NoSimilarity):
        raise InputError("no similarity", found=found.reason)
    return np.concatenate([found.rotation.ravel(), found.shift, [found.scale]])


@dataclass(frozen=True)
class _Input:
    """A method's input.

    Attributes
    ----------
    method, what : who is asked, and what of its input is broken.
    run : the method's answer with one number of the input exchanged for another.
    passed_over : whether what is no number is left out, rather than refused.
    refusal : words of the refusal.
    tolerance : how far the answer to a denormal number may be from that to zero.
    """

    method: str
    what: str
    run: Answer
    passed_over: bool = False
    refusal: str = "finite"
    tolerance: float = 1e-9


_INPUTS = (
    _Input("joint adjustment of scans", "a sample", _adjusted_points),
    _Input("joint adjustment of scans", "a pose", _adjusted_poses),
    _Input("placement by shape", "a normal", _placed),
    _Input("normals of scans", "a sample of a grid", partial(_oriented, ordered=True), True),
    _Input("normals of scans", "a sample of a cloud", partial(_oriented, ordered=False)),
    _Input("screened Poisson", "a sample", _solved),
    _Input("merging samples", "a place", _merged("points")),
    _Input("merging samples", "a normal", _merged("normals")),
    _Input("moving onto samples", "a normal", _moved("normals")),
    _Input("moving onto samples", "a reach", _moved("radius_m")),
    _Input("provenance", "a sample", _supported),
    _Input("diffusion of colour", "a colour", _painted("colour")),
    _Input("diffusion of colour", "a weight", _painted("weight")),
    _Input("diffusion of colour", "a conductance", _painted("conductance")),
    _Input("neighbours for diffusion", "a place", _neighbours),
    _Input("estimate of the flash", "a value", _flash("values"), True, tolerance=1e-3),
    _Input("estimate of the flash", "a place", _flash("places_in_camera"), True),
    _Input("flash correction", "the flash's place", _light),
    _Input("blending of photographs", "a colour", _blended),
    _Input("linearity of the sensor", "a distance", _linear, refusal="a distance or a level"),
    _Input("choice of photographs", "a cost", _labelled),
    _Input("levelling of a view", "a colour", _view),
    _Input("voxelisation", "a vertex", _gridded),
    _Input("point codecs", "a point", _coded),
    _Input("surfels", "a point", _ordered),
    _Input("normals of points", "a point", _normals),
    _Input("rays", "a vertex", _rays),
    _Input("sampling of surfaces", "a vertex", _sampled),
    _Input("similarity of points", "a point", _similar),
)


def _asked(given: _Input, value: float) -> Measured | Refused:
    """How many numbers of the answer are none; and for denormal ones, whether zero does as well."""
    found = given.run(value)
    wrong = float((~np.isfinite(found)).sum())
    if np.isfinite(value):
        plain = given.run(0.0)
        if plain.shape != found.shape:
            return Measured.nothing(f"{found.shape} numbers, not {plain.shape} as with 0")
        wrong += float(np.abs(found - plain).max() > given.tolerance)
    return Measured(wrong, "passed over" if given.passed_over else "")


def _case(given: _Input, name: str, value: float) -> Case:
    # Linearity at no distance has no answer either way.
    refused = not (np.isfinite(value) or given.passed_over)
    impossible = given.run is _linear
    return Case(
        f"numbers/{given.method}: {given.what}, {name}",
        given.method,
        f"One number of {given.what} is {name}.",
        partial(_asked, given, value),
        None if refused or impossible else Bound(0.0, "", "no number of the answer is none"),
        given.refusal if refused or impossible else None,
    )


NUMBER_CASES = tuple(
    _case(given, name, value) for given in _INPUTS for name, value in _VALUES.items()
)
