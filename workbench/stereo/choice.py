"""Which photographs are compared with which, and between which depths."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import PurePosixPath

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.colmap import ColmapModel
from workbench.geometry.lines import place_nearest_to
from workbench.geometry.photo_camera import PhotoCamera

# Degrees between the views of a point from which they are compared best, and how soon that
# gets worse below and above (Yao et al. 2018, equation 1, for wider baselines).
_BEST_ANGLE, _BELOW, _ABOVE = 12.0, 5.0, 15.0
_FEWEST_POINTS = 30
_FIBONACCI = 700
_FARTHEST_PERCENTILE = 1.0
_MARGIN = 0.25
# The object is no ball: its surface may be anywhere within, and a little past the ball's rim.
_LAYERS, _PAST_THE_RIM = (0.2, 0.6, 1.0), -0.2
# Beyond this the axes of the cameras meet nowhere in particular.
_WORST_CONDITION = 1e4


@dataclass(frozen=True)
class SeenPoints:
    """Places on the object, and which photographs show them.

    Attributes
    ----------
    names : of the photographs.
    points : (n, 3) float64 in the world.
    seen : (n, photographs) bool.
    measured : whether they are places that photographs share, and no guess.
    """

    names: tuple[str, ...]
    points: NDArray[np.float64]
    seen: NDArray[np.bool_]
    measured: bool = True


def seen_points(model: ColmapModel, shares: Mapping[str, float]) -> SeenPoints:
    """The model's own points, or, where it has too few, those of a ball all cameras look at.

    Parameters
    ----------
    shares : by photograph, how much of the shorter side of its picture the object takes.
    """
    cameras = model.photo_cameras()
    names = tuple(sorted(cameras))
    if len(model.points) < _FEWEST_POINTS:
        return _ball(names, cameras, shares)
    column = {name: k for k, name in enumerate(names)}
    of_image = {
        number: column[PurePosixPath(image.name).stem] for number, image in model.images.items()
    }
    points = np.array([point.xyz for point in model.points.values()])
    seen = np.zeros((len(points), len(names)), bool)
    for row, point in enumerate(model.points.values()):
        seen[row, [of_image[image] for image in point.track[:, 0].tolist()]] = True
    if seen.any(axis=1).sum() < _FEWEST_POINTS:
        # Orientations often come without the tracks: then a camera may see what it looks at.
        seen = np.column_stack([_in_picture(cameras[name], points) for name in names])
    return SeenPoints(names, points, seen)


def _in_picture(camera: PhotoCamera, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which points (n, 3) are in front of a camera and within its picture."""
    pixels, depths = camera.project(points)
    with np.errstate(invalid="ignore"):
        inside = (pixels >= 0.0).all(axis=1) & (pixels < [camera.width, camera.height]).all(axis=1)
    return np.asarray(inside & (depths > 0.0))


def depth_span(points: SeenPoints, number: int, camera: PhotoCamera) -> tuple[float, float]:
    """Least and greatest depth of what a photograph shows, with room on both sides."""
    own = points.points[points.seen[:, number]]
    axis = camera.camera_from_world[2]
    depths = own @ axis[:3] + axis[3]
    depths = depths[depths > 0.0]
    if len(depths) < _FEWEST_POINTS // 3:
        raise InputError(
            "Too few points tell how far the object is from a photograph",
            where=points.names[number],
            found=f"{len(depths)} points",
            fix="leave it out, or photograph with more overlap",
        )
    near, far = np.percentile(depths, [_FARTHEST_PERCENTILE, 100.0 - _FARTHEST_PERCENTILE])
    room = _MARGIN * (far - near) + 0.02 * near
    return float(max(near - room, 0.3 * near)), float(far + room)


def chosen_neighbours(
    points: SeenPoints, cameras: Mapping[str, PhotoCamera], most: int
) -> dict[str, tuple[str, ...]]:
    """By photograph the others it is compared with, the best first.

    Each point that both show counts by the angle between the views of it.
    """
    centers = np.array([cameras[name].center for name in points.names])
    scores = np.zeros((len(points.names), len(points.names)))
    for i in range(len(points.names)):
        own = points.seen[:, i]
        ways = _unit(centers[:, None] - points.points[own][None])
        angle = np.degrees(np.arccos(np.clip((ways * ways[i]).sum(axis=2), -1.0, 1.0)))
        spread = np.where(angle < _BEST_ANGLE, _BELOW, _ABOVE)
        good = np.exp(-0.5 * ((angle - _BEST_ANGLE) / spread) ** 2)
        scores[i] = (good * points.seen[own].T).sum(axis=1)
        scores[i, i] = 0.0
    order = np.argsort(-scores, axis=1, kind="stable")[:, :most]
    return {
        name: tuple(points.names[j] for j in order[i] if scores[i, j] > 0.0)
        for i, name in enumerate(points.names)
    }


def _ball(
    names: tuple[str, ...], cameras: Mapping[str, PhotoCamera], shares: Mapping[str, float]
) -> SeenPoints:
    """Points on and within a ball where the axes of the cameras meet."""
    centers = np.array([cameras[name].center for name in names])
    axes = np.array([cameras[name].camera_from_world[2, :3] for name in names])
    middle = place_nearest_to(zip(centers, axes, strict=True), _WORST_CONDITION)
    if middle is None:
        raise InputError(
            "Nothing tells how far the object is from the cameras",
            found="cameras that look the same way, and came without points",
            fix="bring the orientation with its points, or leave out --cameras",
        )
    radii = [
        0.5 * shares[name] * min(cameras[name].width, cameras[name].height)
        / cameras[name].params[0] * float(axis @ (middle - center))
        for name, axis, center in zip(names, axes, centers, strict=True)
    ]  # fmt: skip
    turn = np.arange(_FIBONACCI) * np.pi * (3.0 - np.sqrt(5.0))
    up = 1.0 - 2.0 * (np.arange(_FIBONACCI) + 0.5) / _FIBONACCI
    level = np.sqrt(1.0 - up**2)
    outward = np.column_stack([level * np.cos(turn), level * np.sin(turn), up])
    outward = np.repeat(outward, len(_LAYERS), axis=0)
    layers = np.tile(_LAYERS, _FIBONACCI)[:, None]
    points = middle + float(np.median(radii)) * layers * outward
    ways = _unit(centers[None] - points[:, None])
    seen = (ways * outward[:, None]).sum(axis=2) > _PAST_THE_RIM
    return SeenPoints(names, points, seen, measured=False)


def _unit(vectors: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.asarray(vectors / np.linalg.norm(vectors, axis=-1, keepdims=True))
