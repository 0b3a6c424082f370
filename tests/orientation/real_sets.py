"""Real photographs whose cameras are known, and how far cameras lie from those."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from workbench.formats.colmap import ColmapModel, read_colmap_text
from workbench.geometry.similarity import Similarity, best_similarity
from workbench.geometry.transforms import Matrix4, inverse, rigid
from workbench.orientation.photographs import PhotoToOrient


@dataclass(frozen=True)
class KnownSet:
    """Photographs, and camera_from_world of each by its name."""

    photos: list[PhotoToOrient]
    truth: dict[str, Matrix4]

    @property
    def object_distance(self) -> float:
        """Median distance of the cameras from the point all look at, in the truth's unit."""
        poses = [inverse(pose) for pose in self.truth.values()]
        across = [np.eye(3) - np.outer(pose[:3, 2], pose[:3, 2]) for pose in poses]
        places = [pose[:3, 3] for pose in poses]
        middle = np.linalg.solve(
            sum(across), sum(a @ place for a, place in zip(across, places, strict=True))
        )
        return float(np.median(np.linalg.norm(np.array(places) - middle, axis=1)))

    def center_errors(self, found: Mapping[str, Matrix4]) -> np.ndarray:
        """Distances of found cameras to the true ones after the best similarity."""
        centers = np.array([inverse(pose)[:3, 3] for pose in found.values()])
        true = np.array([inverse(self.truth[name])[:3, 3] for name in found])
        similarity = best_similarity(centers, true)
        assert isinstance(similarity, Similarity)
        return np.linalg.norm(similarity.apply(centers) - true, axis=1)


def poses_of(model: ColmapModel) -> dict[str, Matrix4]:
    """camera_from_world by name."""
    return {image.name: image.camera_from_world for image in model.images.values()}


def skull_flash(folder: Path) -> KnownSet:
    """66 flash photographs; 55 mm on a sensor 22.2 mm wide."""
    photos = [
        PhotoToOrient(path.name, path, "EOS 1100D 55 mm", 55.0 / 22.2 * 2136)
        for path in sorted((folder / "photos").glob("*.jpg"))
    ]
    return KnownSet(photos, poses_of(read_colmap_text(folder / "cameras")))


def fountain_p11(folder: Path) -> KnownSet:
    """11 photographs, surveyed cameras in metres (Strecha 2008); no focal length is known."""
    photos = [PhotoToOrient(path.name, path) for path in sorted((folder / "photos").glob("*.jpg"))]
    truth = {}
    for photo in photos:
        text = (folder / "cameras" / f"{photo.name}.camera").read_text()
        numbers = np.array(text.split(), float)
        truth[photo.name] = inverse(rigid(numbers[12:21].reshape(3, 3), numbers[21:24]))
    return KnownSet(photos, truth)


def dtu_scan37(folder: Path) -> KnownSet:
    """49 photographs with masks, cameras of a robot's arm in millimetres."""
    paths = sorted((folder / "photos").glob("*.jpg"))
    matrices = np.load(folder / "cameras_sphere.npz")
    photos, truth = [], {}
    for number, path in enumerate(paths):
        mask = folder / "masks" / f"{number:03d}.png"
        photos.append(PhotoToOrient(path.name, path, mask=mask))
        projection = matrices[f"world_mat_{number}"][:3]
        _, rotation, place = cv2.decomposeProjectionMatrix(projection)[:3]
        center = (place[:3] / place[3]).ravel()
        truth[path.name] = rigid(rotation, -rotation @ center)
    return KnownSet(photos, truth)
