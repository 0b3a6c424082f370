"""What COLMAP writes on a graphics card, for a ball of which the truth is known."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np

from workbench.stereo.views import StereoView


def normals_of(view: StereoView, depth: np.ndarray) -> np.ndarray:
    """Of the unit ball, in the camera's frame, (h, w, 3); 0 where nothing is met."""
    rows, columns = np.indices(depth.shape)
    across = (columns - view.lens[2]) / view.lens[0], (rows - view.lens[3]) / view.lens[1]
    slopes = np.stack([*across, np.ones(depth.shape)], axis=2)
    center = view.camera_from_world[:3, 3]
    met = np.isfinite(depth)
    return np.where(met[..., None], slopes * np.where(met, depth, 0.0)[..., None] - center, 0.0)


def write_map(path: Path, values: np.ndarray) -> None:
    """As COLMAP writes maps (h, w, parts): part by part, row by row."""
    height, width, parts = values.shape
    header = f"{width}&{height}&{parts}&".encode()
    path.write_bytes(header + np.moveaxis(values, 2, 0).astype("<f4").tobytes())


def write_true_maps(folder: Path, shown: Mapping[str, tuple[StereoView, np.ndarray]]) -> None:
    """The true depths and normals of the ball, by name of the picture."""
    for name, (view, depth) in shown.items():
        there = np.where(np.isfinite(depth), depth, 0.0)[..., None]
        for kind, values in (("depth_maps", there), ("normal_maps", normals_of(view, depth))):
            write_map(folder / "stereo" / kind / f"{name}.geometric.bin", values)
