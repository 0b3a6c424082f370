"""A camera of three channels and pictures of a chart, drawn without the code under test."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.color.chart import reference_xyz_d50

# From CIE XYZ relative to D50 to the camera; a perfect diffuser fills 0.8 of green.
CAMERA = np.array([[0.42, 0.08, -0.03], [-0.33, 0.98, 0.16], [-0.01, 0.13, 0.62]])
PATCH = 0.88


@dataclass(frozen=True)
class DrawnChart:
    """A picture and where its chart is."""

    values: NDArray[np.float32]
    corners: NDArray[np.float64]  # of the 6 × 4 cells
    board: NDArray[np.float64]


@pytest.fixture(scope="session")
def camera_of_xyz():
    """From XYZ (n, 3) to camera RGB."""
    return lambda xyz: xyz @ CAMERA.T


@pytest.fixture(scope="session")
def draw_chart():
    """A function that draws a chart seen in perspective, softly and with noise."""

    def draw(
        size: tuple[int, int] = (480, 640),
        corners: list[list[float]] | None = None,
        turns: int = 0,
        background: float = 0.0,
        noise: float = 0.002,
        level: float = 1.0,
        edition: str = "after_2014",
    ) -> DrawnChart:
        height, width = size
        placed = np.array(corners or [[180, 150], [470, 170], [455, 360], [190, 350]], float)
        placed = np.roll(placed, -turns, axis=0)
        cells = np.array([[0, 0], [6, 0], [6, 4], [0, 4]], np.float32)
        to_pixel = cv2.getPerspectiveTransform(cells, placed.astype(np.float32))
        fine = 4
        picture = np.full((height * fine, width * fine, 3), background, np.float32)

        def paint(polygon, color) -> None:
            raised = np.c_[np.array(polygon, float), np.ones(len(polygon))] @ to_pixel.T
            pixels = np.rint(fine * raised[:, :2] / raised[:, 2:]).astype(np.int32)
            cv2.fillConvexPoly(picture, pixels, [float(value) for value in color])

        board = [[-0.25, -0.36], [6.25, -0.36], [6.25, 4.36], [-0.25, 4.36]]
        paint(board, np.array([0.03, 0.03, 0.03]) * level)
        colors = reference_xyz_d50(edition) @ CAMERA.T * level
        for k, color in enumerate(colors):
            row, col = divmod(k, 6)
            near, far = 0.5 - PATCH / 2, 0.5 + PATCH / 2
            square = [[near, near], [far, near], [far, far], [near, far]]
            paint(np.add(square, [col, row]), color)
        small = cv2.resize(picture, (width, height), interpolation=cv2.INTER_AREA)
        rng = np.random.default_rng(7)
        seen = cv2.GaussianBlur(small, (0, 0), 0.7) + noise * rng.standard_normal(small.shape)
        raised = np.c_[np.array(board), np.ones(4)] @ to_pixel.T
        outline = raised[:, :2] / raised[:, 2:]
        return DrawnChart(np.clip(seen, 0, 1).astype(np.float32), placed, outline)

    return draw
