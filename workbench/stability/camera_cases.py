"""Cameras whose pictures tell too little, that stand where none should, or fold what they see."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.color.blending_surface import ReadySurface
from workbench.color.blending_weights import WeightOptions
from workbench.formats.colmap import ColmapCamera, ColmapImage, ColmapModel, ColmapPoint
from workbench.geometry.mesh import TriangleMesh, vertex_normals
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.photo_view import view_of_surface
from workbench.geometry.similarity import Similarity, best_similarity
from workbench.geometry.surface_rays import SurfaceRays
from workbench.geometry.transforms import Matrix4, apply, from_twist, inverse, looking_at, rigid
from workbench.kernels.lens_distortion import distorted_points, undistorted_points
from workbench.orientation.features import PhotoFeatures
from workbench.orientation.mapping import MappingSettings, placed, quiet_pycolmap, start_camera
from workbench.orientation.picks import NoPicks, Pick, similarity_of_picks
from workbench.orientation.sparse_points import SparsePoints
from workbench.orientation.surface_adjustment import (
    NotAdjusted,
    SurfaceAdjustmentOptions,
    adjusted_to_surface,
)
from workbench.orientation.surface_search import NoShapeFit, fit_by_shape
from workbench.orientation.two_views import VerificationSettings, verified
from workbench.stability.case import Bound, Case, Measured, Refused
from workbench.surface.poisson import PoissonSettings, reconstruct
from workbench.texturing.cost_options import CostOptions
from workbench.texturing.shown_candidates import shown_candidates

_SFM, _SHAPE, _VIEW = "structure from motion", "cameras by shape", "what a camera sees"
_SIZE, _FOCAL = (800, 600), 900.0


def _camera(
    center: tuple[float, float, float], target: tuple[float, float, float] = (0.0, 0.0, 0.0),
    bend: float = 0.0,
) -> PhotoCamera:  # fmt: skip
    params = (_FOCAL, 0.5 * _SIZE[0], 0.5 * _SIZE[1], bend)
    return PhotoCamera("SIMPLE_RADIAL", *_SIZE, params, inverse(looking_at(center, target)))


@cache
def ball_mesh(radius: float = 1.0, count: int = 3000) -> TriangleMesh:
    """A closed ball about the origin, with normals and colours at its vertices."""
    z = 1 - (2 * np.arange(count) + 1) / count
    turn = np.pi * (1 + np.sqrt(5)) * np.arange(count)
    ring = np.sqrt(1 - z**2)
    way = np.stack([ring * np.cos(turn), ring * np.sin(turn), z], axis=1)
    mesh = reconstruct(way, way, PoissonSettings(5))
    mesh = TriangleMesh(radius * mesh.vertices, mesh.triangles)
    return mesh.with_attributes(
        normal=vertex_normals(mesh), color=np.full((len(mesh.vertices), 3), 128, np.uint8)
    )


# -- structure from motion -----------------------------------------------------------------


def _mapped(
    poses: list[Matrix4], points: NDArray[np.float64], noise_px: float = 0.3
) -> Measured | Refused:
    """Cameras found from exact matches, their true ones being ``camera_from_world``."""
    rng = np.random.default_rng(0)
    features = []
    for pose in poses:
        camera = PhotoCamera("SIMPLE_RADIAL", *_SIZE, (_FOCAL, 400.0, 300.0, 0.0), pose)
        pixels = camera.project(points)[0] + rng.normal(0.0, noise_px, (len(points), 2))
        n = len(points)
        features.append(
            PhotoFeatures(
                *_SIZE, pixels.astype(np.float32), np.ones(n, np.float32),
                np.zeros((n, 128), np.uint8), np.zeros((n, 3), np.uint8),
            )
        )  # fmt: skip
    camera = start_camera(1, *_SIZE, _FOCAL)
    matches = np.repeat(np.arange(len(points), dtype=np.uint32)[:, None], 2, axis=1)
    pairs = []
    with quiet_pycolmap():
        for i in range(len(poses)):
            for j in range(i + 1, len(poses)):
                pair = verified(
                    i, j, (features[i], features[j]), (camera, camera), matches,
                    VerificationSettings(), 0,
                )  # fmt: skip
                if pair is not None:
                    pairs.append(pair)
        if not pairs:
            return Refused("no pair of photographs obeys one motion")
        names = [f"photo_{k}" for k in range(len(poses))]
        found = placed(
            names, features, [1] * len(poses), {1: camera}, pairs, MappingSettings(), 0,
            lambda: None,
        )  # fmt: skip
    if found is None:
        return Refused("no photographs could be placed: their views are too much alike")
    return _center_error(found, poses)


def _center_error(found: Any, poses: list[Matrix4]) -> Measured:
    """How far centres are off, over the size of their ring, once brought onto the true ones."""
    numbers = sorted(found.reg_image_ids())
    ours = np.array([found.images[k].projection_center() for k in numbers])
    true = np.array([inverse(poses[k - 1])[:3, 3] for k in numbers])
    told = f"{len(numbers)} of {len(poses)} placed"
    fit = best_similarity(ours, true)
    if not isinstance(fit, Similarity):
        return Measured.nothing(f"{told}: {fit.reason}")
    apart = np.linalg.norm(fit.apply(ours) - true, axis=1)
    return Measured(float(apart.max() / np.ptp(true, axis=0).max()), told)


def _cloud(count: int = 300, flat: bool = False) -> NDArray[np.float64]:
    points = np.random.default_rng(3).uniform(-0.5, 0.5, (count, 3))
    if flat:
        points[:, 2] = 0.0
    return points


def _ring() -> list[Matrix4]:
    return [
        _camera((2.0 * np.sin(a), 2.0 * np.cos(a), 0.4 + 0.2 * k % 2)).camera_from_world
        for k, a in enumerate(np.linspace(0.0, 1.2, 5))
    ]


def _turned_only() -> Measured | Refused:
    """A camera on a tripod that turns: rays of a place in two photographs are the same."""
    base = _camera((0.0, -2.5, 0.3)).camera_from_world
    turns = [from_twist([0.0, 0.03 * k, 0.02 * k, 0.0, 0.0, 0.0]) for k in range(5)]
    return _mapped([turn @ base for turn in turns], _cloud())


def _same_place() -> Measured | Refused:
    """The same photograph five times."""
    return _mapped([_camera((0.0, -2.5, 0.3)).camera_from_world] * 5, _cloud())


def _in_line() -> Measured | Refused:
    """A camera that moves along its own view: the middle of the picture does not move."""
    poses = [_camera((0.0, -3.0 + 0.2 * k, 0.0)).camera_from_world for k in range(5)]
    return _mapped(poses, _cloud())


# -- placing by shape and by picked places -------------------------------------------------


def _by_shape(mesh: TriangleMesh, points: NDArray[np.float64]) -> Measured | Refused:
    outward = points / np.linalg.norm(points, axis=1, keepdims=True)
    turn = from_twist([0.3, -0.2, 0.5, 0.0, 0.0, 0.0])
    known = SparsePoints(
        np.arange(len(points)), 0.3 * apply(turn, points), outward @ turn[:3, :3].T
    )
    found = fit_by_shape(known, mesh)
    if isinstance(found, NoShapeFit):
        return Refused(found.reason)
    return Measured.nothing(f"placed with an error of {found.error:.3g}, lead {found.lead:.3g}")


def _shape_of_ball() -> Measured | Refused:
    mesh = ball_mesh()
    return _by_shape(mesh, mesh.vertices[::4])


def _shape_of_few() -> Measured | Refused:
    mesh = ball_mesh()
    return _by_shape(mesh, mesh.vertices[:3])


def _picked_in_line() -> Measured | Refused:
    """Picked places on one line, which leave the turn about it open."""
    cameras = [_camera((2.0, 0.0, 0.3)), _camera((0.0, 2.0, 0.3))]
    places = np.linspace([-0.4, -0.4, 0.0], [0.4, 0.4, 0.0], 5)
    images = {
        k: ColmapImage(k, camera.camera_from_world, 1, f"p{k}.png")
        for k, camera in enumerate(cameras, 1)
    }
    lens = ColmapCamera(1, "SIMPLE_RADIAL", *_SIZE, cameras[0].params)
    model = ColmapModel({1: lens}, images, {})
    picks = tuple(
        Pick(place, {f"p{k}": c.project(place[None])[0][0] for k, c in enumerate(cameras, 1)})
        for place in places
    )
    found = similarity_of_picks(model, picks)
    if isinstance(found, NoPicks):
        return Refused(found.reason)
    return Measured.nothing("placed by places in line")


def _adjusted(count: int) -> Measured | Refused:
    """A joint adjustment of cameras that see ``count`` points of a ball."""
    mesh = ball_mesh()
    points = mesh.vertices[np.linspace(0, len(mesh.vertices) - 1, 4 * count).astype(int)]
    points = points[np.argsort(points[:, 0])[-count:]]
    cameras = [_camera((4.0, y, 0.3)) for y in (-0.5, 0.0, 0.5)]
    ids = np.arange(1, count + 1)
    images = {
        k: ColmapImage(k, c.camera_from_world, 1, f"p{k}.png", c.project(points)[0], ids)
        for k, c in enumerate(cameras, 1)
    }
    lens = ColmapCamera(1, "SIMPLE_RADIAL", *_SIZE, cameras[0].params)
    tracks = [np.array([(k, row) for k in images]) for row in range(count)]
    gray = np.full(3, 128, np.uint8)
    known = {i: ColmapPoint(i, points[i - 1], gray, 0.1, tracks[i - 1]) for i in ids.tolist()}
    model = ColmapModel({1: lens}, images, known)
    found = adjusted_to_surface(model, SurfaceRays(mesh), SurfaceAdjustmentOptions(0.05))
    if isinstance(found, NotAdjusted):
        return Refused(found.reason)
    return Measured.nothing(f"adjusted with condition {found.condition:.3g}")


def _similarity(spread: float) -> Measured | Refused:
    """Pairs of points along a line, ``spread`` off it."""
    rng = np.random.default_rng(1)
    points = np.outer(np.linspace(-1, 1, 20), [1.0, 2.0, 3.0]) + spread * rng.normal(size=(20, 3))
    truth = Similarity(2.5, from_twist([0.3, 0.2, 0.1, 0, 0, 0])[:3, :3], np.array([5.0, 6.0, 7.0]))
    found = best_similarity(points, truth.apply(points))
    if not isinstance(found, Similarity):
        return Refused(found.reason)
    return Measured(float(np.abs(found.rotation - truth.rotation).max()))


# -- what a camera sees --------------------------------------------------------------------


def _inside_color() -> Measured:
    """A camera within a closed ball sees its inside, which has no colour to tell."""
    ready = ReadySurface(ball_mesh())
    camera = _camera((0.1, 0.0, 0.0), (1.0, 0.0, 0.0))
    picture = np.full((_SIZE[1], _SIZE[0], 3), 0.5, np.float32)
    usable = np.ones(picture.shape[:2], bool)
    photo = ready.weighed(camera, picture, usable, WeightOptions(), 5)
    return Measured(float(len(ready.observed(photo).index)))


def _inside_texture() -> Measured:
    """The same camera textures no triangle."""
    picture = np.full((_SIZE[1], _SIZE[0], 4), 255, np.uint8)
    camera = _camera((0.1, 0.0, 0.0), (1.0, 0.0, 0.0))
    shown = shown_candidates(ball_mesh(), {0: camera}, lambda _: picture, CostOptions(far=10.0))
    return Measured(float(len(shown.labels)))


def _on_surface() -> Measured:
    """A camera that stands on a vertex sees nothing infinite or without number."""
    mesh = ball_mesh()
    camera = _camera((float(mesh.vertices[:, 0].max()), 0.0, 0.0))
    view = view_of_surface(SurfaceRays(mesh), mesh.vertex_attributes["normal"], camera)
    wrong = np.isnan(view.depth) | ~np.isfinite(view.normals).all(axis=2) | (view.depth < 0)
    return Measured(float(wrong.sum()), f"{int(view.seen.sum())} pixels see the surface")


def _folded() -> Measured:
    """Places beyond the circle at which a lens folds its picture are not seen in it."""
    camera = _camera((0.0, -2.0, 0.0), bend=-0.6)
    mesh = ball_mesh()
    wide = TriangleMesh(mesh.vertices * [3.0, 0.2, 3.0], mesh.triangles)
    view = view_of_surface(SurfaceRays(wide), vertex_normals(wide), camera)
    pixels, depths = camera.project(wide.vertices)
    slopes = np.linalg.norm(
        apply(camera.camera_from_world, wide.vertices)[:, :2] / depths[:, None], axis=1
    )
    # r (1 − 0.6 r²) falls from r = 1 / √1.8 on.
    beyond = slopes > 1.1 / np.sqrt(1.8)
    seen = view.which_are_seen(pixels, depths)
    told = f"{int(beyond.sum())} places beyond the fold, {int(seen.sum())} seen"
    if not (seen.any() and beyond.any()):
        return Measured.nothing(told)
    return Measured(float((seen & beyond).sum()), told)


def _far_view() -> Measured:
    """A ball 5400 km from the origin shows the same depths as one at it."""
    shift = np.array([512_345.0, 5_412_345.0, 312.0])
    mesh, camera = ball_mesh(), _camera((3.0, 1.0, 0.5))
    there = TriangleMesh(mesh.vertices + shift, mesh.triangles)
    far = camera.camera_from_world @ rigid(np.eye(3), -shift)
    moved = PhotoCamera(camera.model, *_SIZE, camera.params, far)
    views = [
        view_of_surface(SurfaceRays(m), mesh.vertex_attributes["normal"], c)
        for m, c in ((mesh, camera), (there, moved))
    ]
    both = views[0].seen & views[1].seen
    odd = float((views[0].seen != views[1].seen).sum())
    apart = np.abs(views[0].depth[both].astype(float) - views[1].depth[both]).max()
    return Measured(
        max(float(apart), 0.0 if odd < 20 else odd), f"{odd:.0f} pixels at the rim differ"
    )


def _distortion(coefficients: tuple[float, float, float, float], reach: float) -> Measured:
    """Lens distortion undone, up to ``reach``, against what was distorted."""
    ways = np.linspace(0, 2 * np.pi, 60)
    rings = np.linspace(0.01, reach, 40)
    points = np.stack([np.outer(rings, np.cos(ways)), np.outer(rings, np.sin(ways))], axis=-1)
    points = points.reshape(-1, 2)
    numbers = np.array(coefficients)
    back = undistorted_points(distorted_points(points, numbers), numbers)
    return Measured(float(np.abs(back - points).max()))


def _beyond_fold() -> Measured:
    """Pixels that no ray reaches, and some without a number, have no ray."""
    # 1 − 0.4 r²: the image reaches no farther than 0.609 from its middle.
    pixels = np.array(
        [[0.7, 0.0], [0.5, 0.6], [-3.0, 2.0], [np.nan, 0.1], [np.inf, 0.0], [1e300, 0]]
    )
    found = undistorted_points(pixels, np.array([-0.4, 0.0, 0.0, 0.0]))
    return Measured(float(np.isfinite(found).sum()))


def _case(
    name: str,
    method: str,
    stiff: str,
    run: Callable[[], Measured | Refused],
    bound: Bound | None = None,
    refusal: str | None = None,
) -> Case:
    return Case(f"cameras/{name}", method, stiff, run, bound, refusal)


_NONE = Bound(0.0, "", "none is allowed")
_CENTERS = Bound(0.01, "of their spread", "0.3 px of noise over 900 px at four times the spread")

CAMERA_CASES = (
    _case("all round", _SFM, "An ordinary arc of cameras, to compare with.",
          lambda: _mapped(_ring(), _cloud()), _CENTERS),
    _case("a plane", _SFM, "All points lie in one plane.",
          lambda: _mapped(_ring(), _cloud(flat=True)), _CENTERS),
    _case("turned only", _SFM, "A camera that turns about its own centre.", _turned_only,
          refusal="no photographs could be placed"),
    _case("the same photograph", _SFM, "Five times the same photograph.", _same_place,
          refusal="no photographs could be placed"),
    _case("along the view", _SFM, "A camera that moves straight towards the object.", _in_line,
          _CENTERS, "no photographs could be placed"),
    _case("a ball", _SHAPE, "Points on a ball fit it in every turn.", _shape_of_ball,
          refusal="in more than one way"),
    _case("three points", _SHAPE, "Three points fit everywhere.", _shape_of_few,
          refusal="reliable points"),
    _case("picked in line", "cameras by picked places", "Picked places on one line.",
          _picked_in_line, refusal="in line"),
    _case("six points", "adjustment to a surface", "Fewer points than hold a camera.",
          partial(_adjusted, 6), refusal="fewer than a dozen points"),
    _case("a hundredth off a line", "similarity of points", "Points a hundredth off a line.",
          partial(_similarity, 1e-2),
          Bound(1e-10, "", "rounding of 1e-16, ten thousand times for the squared leverage")),
    _case("1e-5 off a line", "similarity of points", "Points a hundred-thousandth off a line.",
          partial(_similarity, 1e-5),
          Bound(1e-4, "", "rounding of 1e-16, 1e10 times for the squared leverage"),
          "leave the rotation open"),
    _case("in line", "similarity of points", "Points on a line but for rounding.",
          partial(_similarity, 0.0), refusal="in line"),
    _case("inside, colour", _VIEW, "The camera stands inside the object.", _inside_color, _NONE),
    _case("inside, texture", _VIEW, "The camera stands inside the object.", _inside_texture,
          _NONE),
    _case("on the surface", _VIEW, "The camera stands on the object.", _on_surface, _NONE),
    _case("folded", _VIEW, "A lens that images places behind its rim into the picture again.",
          _folded, _NONE),
    _case("UTM offset", _VIEW, "Object and camera 5400 km from the origin.", _far_view,
          Bound(1e-5, "m", "Embree's single precision over 4 m")),
    _case("k1 = −0.3", "lens distortion", "Strong barrel distortion, to nine tenths of its fold.",
          partial(_distortion, (-0.3, 0.0, 1e-3, -1e-3), 0.94),
          Bound(1e-8, "", "ten times what Newton's last step leaves")),
    _case("k1 = 1", "lens distortion", "Strong cushion distortion, 60° from the axis.",
          partial(_distortion, (1.0, 0.2, 0.0, 0.0), 1.7),
          Bound(1e-8, "", "ten times what Newton's last step leaves")),
    _case("beyond the fold", "lens distortion", "Pixels no ray is imaged at.", _beyond_fold,
          _NONE),
)  # fmt: skip
