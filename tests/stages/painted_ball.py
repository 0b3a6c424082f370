"""A painted ball of radius 1, photographed from all round at two heights."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tests.stereo.scenes import ball, seen
from workbench.formats.colmap import (
    ColmapCamera,
    ColmapImage,
    ColmapModel,
    ColmapPoint,
    write_colmap_text,
)
from workbench.geometry.transforms import apply, inverse, rigid
from workbench.project.creation import create_project

SIZE, FOCAL, COUNT = (150, 150), 250.0, 12
SETTINGS: dict[str, Any] = {"densify": {"neighbours": 3, "levels": 2, "rounds": 1}}


def photographed_ball(
    folder: Path,
    scans: Sequence[Path] = (),
    points: np.ndarray | None = None,
    cameras: bool = True,
    middle: np.ndarray | None = None,
) -> Path:
    """A project of the photographs with their cameras and masks.

    ``points`` (n, 3) on the ball around 0 come with the cameras, each with those that see it; the
    world has the ball around ``middle``.
    """
    moved = rigid(np.eye(3), np.zeros(3) if middle is None else middle)
    (folder / "photos").mkdir()
    (folder / "masks" / "corrected").mkdir(parents=True)
    lens = ColmapCamera(1, "SIMPLE_PINHOLE", *SIZE, (FOCAL, 0.5 * SIZE[0], 0.5 * SIZE[1]))
    images = {}
    for k in range(COUNT):
        turn = 2.0 * np.pi * k / COUNT
        place = (5.0 * np.cos(turn), 1.5 * (-1) ** k, 5.0 * np.sin(turn))
        view, _ = seen(ball, place, SIZE, FOCAL)
        name = f"photo_{k:02d}"
        cv2.imwrite(str(folder / "photos" / f"{name}.png"), view.grey.clip(0, 255).astype(np.uint8))
        cv2.imwrite(
            str(folder / "masks" / "corrected" / f"{name}.png"), 255 * view.usable.astype(np.uint8)
        )
        camera_from_world = view.camera_from_world @ inverse(moved)
        images[k + 1] = ColmapImage(k + 1, camera_from_world, 1, f"{name}.png")
    around = [] if points is None else apply(moved, points)
    model = ColmapModel({1: lens}, images, _points(images, around, moved[:3, 3]))
    write_colmap_text(folder / "cameras", model)
    project = create_project(
        folder / "project",
        scans=scans,
        photos=[folder / "photos"],
        cameras=folder / "cameras" if cameras else None,
    ).root
    (project / "masks").mkdir()
    (folder / "masks" / "corrected").rename(project / "masks" / "corrected")
    return project


def _points(
    images: dict[int, ColmapImage], points: Iterable[np.ndarray], middle: np.ndarray
) -> dict[int, ColmapPoint]:
    found = {}
    for number, point in enumerate(points, 1):
        # A point of the unit ball is seen from beyond its tangent plane.
        sees = [
            image.image_id
            for image in images.values()
            if (point - middle) @ (inverse(image.camera_from_world)[:3, 3] - middle) > 1.5
        ]
        if len(sees) > 1:
            track = np.array([[image, 0] for image in sees], np.int64)
            found[number] = ColmapPoint(number, point, np.zeros(3, np.uint8), 0.3, track)
    return found
