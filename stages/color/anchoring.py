"""The level of the colours: white where the chart says so, or as photographed."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from stages.color.flashing import FoundFlash
from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.color.flash_chart import ChartPlace


@dataclass(frozen=True)
class Level:
    """What the level of the colours rests on.

    Attributes
    ----------
    gain : value of a white diffuser that gets light 1.
    words : for people.
    """

    gain: float
    words: str


def anchored_level(products: Products, flash: FoundFlash) -> Level:
    """The level of white in the flash's light."""
    if flash.light is None:
        return Level(1.0, "as photographed, in the light there was")
    place = _chart_place(products)
    if isinstance(place, str):
        distance = flash.light.reference_distance
        return Level(
            1.0, f"that of a surface facing the flash at {distance:.3g} m, as photographed: {place}"
        )
    from workbench.color.flash_light import anchored

    gain = anchored(flash.light, place.middle, place.normal)
    return Level(gain, f"that of the chart {np.linalg.norm(place.middle):.3g} m from the camera")


def _chart_place(products: Products) -> ChartPlace | str:
    """The chart that gave the colours, in its camera's frame, or why its place is not known."""
    import cv2

    from workbench.color.chart import COLS, ROWS
    from workbench.color.chart_finding import FoundChart
    from workbench.color.flash_chart import NoChartPlace, chart_place
    from workbench.geometry.photo_camera import PhotoCamera

    found = products.load("color_calibration")
    if not found["calibrated"]:
        return "no chart gave the colours"
    entries = {e["name"]: e for e in products.load("photo_inventory")["photos"]}
    poses = products.load("photo_poses")["photos"]
    chart = entries.get(found["chart"])
    kind = ("camera", "lens", "focal_length_mm")
    alike = [
        name
        for name in poses
        if chart is None or [entries[name][k] for k in kind] == [chart[k] for k in kind]
    ]
    if not alike:
        return "no other photograph was taken with the chart's lens"
    lens = poses[alike[0]]
    corners = np.array(found["corners_px"], np.float32)
    cells = np.array([[0, 0], [COLS, 0], [COLS, ROWS], [0, ROWS]], np.float32)
    pixel_from_cell = cv2.getPerspectiveTransform(cells, corners)
    place = chart_place(
        FoundChart(corners.astype(float), np.asarray(pixel_from_cell, float), "corners"),
        PhotoCamera(
            lens["model"], lens["size"][0], lens["size"][1], tuple(lens["params"]), np.eye(4)
        ),
    )
    return place.reason if isinstance(place, NoChartPlace) else place
