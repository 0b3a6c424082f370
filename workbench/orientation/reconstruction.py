"""What pycolmap reconstructed, as a model of plain arrays."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.formats.colmap import NO_POINT, ColmapCamera, ColmapImage, ColmapModel, ColmapPoint
from workbench.geometry.photo_camera import PhotoCamera
from workbench.geometry.transforms import rigid
from workbench.orientation.features import PhotoFeatures


def colmap_model(found: Any, features: Sequence[PhotoFeatures]) -> ColmapModel:
    """Pycolmap's ``Reconstruction`` as our model; observations are all features.

    Image i + 1 is the photograph of features i; a point has the mean colour of its features.
    """
    numbers = sorted(found.reg_image_ids())
    ids = {number: np.full(len(features[number - 1].points), NO_POINT) for number in numbers}
    points = {}
    for number in sorted(found.point3D_ids()):
        point = found.points3D[number]
        track = np.array(
            [(element.image_id, element.point2D_idx) for element in point.track.elements], np.int64
        )
        for image, row in track:
            ids[image][row] = number
        shades = np.array([features[image - 1].colors[row] for image, row in track])
        points[number] = ColmapPoint(
            number,
            np.array(point.xyz),
            np.rint(shades.mean(axis=0)).astype(np.uint8),
            float(point.error),
            track,
        )
    images = {}
    for number in numbers:
        image = found.images[number]
        pose = image.cam_from_world().matrix()
        images[number] = ColmapImage(
            image_id=number,
            camera_from_world=rigid(pose[:, :3], pose[:, 3]),
            camera_id=image.camera_id,
            name=image.name,
            points2d=features[number - 1].points.astype(np.float64),
            point3d_ids=ids[number],
        )
    used = sorted({image.camera_id for image in images.values()})
    cameras = {
        number: ColmapCamera(
            number, camera.model.name, camera.width, camera.height, tuple(map(float, camera.params))
        )
        for number in used
        for camera in (found.cameras[number],)
    }
    return ColmapModel(cameras, images, points)


def reprojection_px(model: ColmapModel) -> float:
    """Root mean square distance of all observations from the images of their points."""
    squares: list[NDArray[np.float64]] = []
    for image in model.images.values():
        lens = model.cameras[image.camera_id]
        camera = PhotoCamera(
            lens.model, lens.width, lens.height, lens.params, image.camera_from_world
        )
        seen = np.flatnonzero(image.point3d_ids != NO_POINT)
        places = np.array([model.points[point].xyz for point in image.point3d_ids[seen]])
        if len(places):
            pixels, _ = camera.project(places)
            squares.append(((pixels - image.points2d[seen]) ** 2).sum(axis=1))
    return float(np.sqrt(np.concatenate(squares).mean())) if squares else float("nan")
