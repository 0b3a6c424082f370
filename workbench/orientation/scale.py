"""How large a model of photographs alone is: by coded markers, or by known distances.

Markers are those of ArUco and AprilTag (Garrido-Jurado et al. 2014; Olson 2011), found by OpenCV.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.geometry.lines import place_nearest_to
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import apply

MARKER_DICTIONARIES = {
    "aruco-4x4": cv2.aruco.DICT_4X4_1000,
    "aruco-5x5": cv2.aruco.DICT_5X5_1000,
    "aruco-6x6": cv2.aruco.DICT_6X6_1000,
    "apriltag-36h11": cv2.aruco.DICT_APRILTAG_36h11,
}
# A corner that is seen so far from where the others put it is of another marker.
_WORST_PX = 4.0
_LEAST_ANGLE_DEG = 2.0
_WORST_CONDITION = 1e8


@dataclass(frozen=True)
class Scale:
    """Metres to a unit of the model.

    Attributes
    ----------
    metres : of one unit.
    spread : relative scatter of the single distances it is the median of; 0 for one.
    told_by : how many distances.
    way : ``markers``, ``cameras``.
    """

    metres: float
    spread: float
    told_by: int
    way: str


@dataclass(frozen=True)
class NoScale:
    """Why nothing tells how large the model is; falsy."""

    reason: str

    def __bool__(self) -> bool:
        return False


def scale_by_cameras(
    cameras: Mapping[str, PhotoCamera], distances_m: Mapping[tuple[str, str], float]
) -> Scale | NoScale:
    """The scale by known distances between the places of cameras."""
    missing = sorted({name for pair in distances_m for name in pair if name not in cameras})
    if missing:
        return NoScale(f"no camera was found for {', '.join(missing)}")
    lengths = {
        pair: float(np.linalg.norm(cameras[pair[0]].center - cameras[pair[1]].center))
        for pair in distances_m
    }
    return _of_ratios([distances_m[pair] / lengths[pair] for pair in distances_m], "cameras")


def scale_by_markers(
    cameras: Mapping[str, PhotoCamera],
    corners: Mapping[str, Mapping[int, NDArray[np.float64]]],
    size_m: float | None,
    distances_m: Mapping[tuple[int, int], float],
) -> Scale | NoScale:
    """The scale by coded markers of known side, or by known distances between their middles.

    Parameters
    ----------
    corners : photograph → marker → (4, 2) pixels, by `markers_in`.
    """
    places = {}
    for marker in sorted({number for found in corners.values() for number in found}):
        seen = {name: found[marker] for name, found in corners.items() if marker in found}
        four = [
            _intersection({name: cameras[name] for name in seen}, {n: seen[n][k] for n in seen})
            for k in range(4)
        ]
        crossing = [place for place in four if place is not None]
        if len(crossing) == len(four):
            places[marker] = np.array(crossing)
    ratios = []
    if size_m is not None:
        for place in places.values():
            sides = np.linalg.norm(place - np.roll(place, 1, axis=0), axis=1)
            ratios += [size_m / float(side) for side in sides]
    for (one, other), distance_m in distances_m.items():
        if one in places and other in places:
            apart = np.linalg.norm(places[one].mean(axis=0) - places[other].mean(axis=0))
            ratios.append(distance_m / float(apart))
    if not ratios:
        return NoScale("no marker of known size or distance is seen well by two photographs")
    return _of_ratios(ratios, "markers")


def markers_in(picture: NDArray[np.uint8], dictionary: str) -> dict[int, NDArray[np.float64]]:
    """Coded markers of a picture (h, w) or (h, w, 3): number → (4, 2) corners, pixels.

    The middle of the upper left pixel is (0.5, 0.5). A number that comes twice is left out.
    """
    settings = cv2.aruco.DetectorParameters()
    settings.cornerRefinementMethod = cv2.aruco.CORNER_REFINE_SUBPIX
    known = cv2.aruco.getPredefinedDictionary(MARKER_DICTIONARIES[dictionary])
    found: Any = cv2.aruco.ArucoDetector(known, settings).detectMarkers(picture)
    corners, numbers, _ = found
    if numbers is None:
        return {}
    flat = [int(number) for number in numbers.ravel()]
    return {
        number: np.asarray(four, np.float64).reshape(4, 2) + 0.5
        for number, four in zip(flat, corners, strict=True)
        if flat.count(number) == 1
    }


def _intersection(
    cameras: Mapping[str, PhotoCamera], pixels: Mapping[str, NDArray[np.float64]]
) -> NDArray[np.float64] | None:
    """The place (3,) nearest to the rays through pixels; None where they hardly cross or do not."""
    if len(cameras) < 2:
        return None
    centers = np.array([cameras[name].center for name in cameras])
    ways = np.array([cameras[name].directions(pixels[name][None])[0] for name in cameras])
    if (ways @ ways.T).min() > np.cos(np.radians(_LEAST_ANGLE_DEG)):
        return None
    place = place_nearest_to(zip(centers, ways, strict=True), _WORST_CONDITION)
    if place is None:
        return None
    for name, camera in cameras.items():
        if apply(camera.camera_from_world, place[None])[0, 2] <= 0.0:
            return None
        if np.linalg.norm(camera.project(place[None])[0][0] - pixels[name]) > _WORST_PX:
            return None
    return place


def _of_ratios(ratios: list[float], way: str) -> Scale | NoScale:
    if not ratios:
        return NoScale("no distance is known")
    if not np.isfinite(ratios).all() or min(ratios) <= 0.0:
        return NoScale("places that are told to be apart are the same")
    middle = float(np.median(ratios))
    spread = float(1.4826 * np.median(np.abs(np.array(ratios) / middle - 1.0)))
    return Scale(middle, spread, len(ratios), way)
