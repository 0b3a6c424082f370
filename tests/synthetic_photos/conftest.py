from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from workbench.synthetic import OBJECT, SUPPORT, Scene, solids
from workbench.synthetic.photo_options import PhotoOptions
from workbench.synthetic.photography import Photograph, photograph
from workbench.synthetic.scene import painted

MakeOptions = Callable[..., PhotoOptions]


@pytest.fixture(scope="session")
def photo_options() -> MakeOptions:
    """Options of tiny photographs with all truth; given dictionaries add to the defaults."""

    def make(**changes: Any) -> PhotoOptions:
        given: dict[str, Any] = {
            "seed": 5,
            "photos": 6,
            "camera": {"long_side_px": 240, "short_side_px": 160},
            "rendering": {"truth": "full"},
            "surface": {"indirect_rays": 8},
            "charts": {"color_frames": 1, "linearity_distances_m": (1.9, 3.0)},
        }
        for name, value in changes.items():
            given[name] = {**given.get(name, {}), **value} if isinstance(value, dict) else value
        return PhotoOptions.model_validate(given)

    return make


@pytest.fixture(scope="session")
def ball_scene() -> Scene:
    """A ball of stone between two rods: everything about it has a formula."""
    parts = [painted(solids.geodesic_sphere((0.0, 0.0, 0.6), 0.3, 6), OBJECT, np.array([0.6]))]
    for x, y in ((0.12, 0.5), (-0.3, -0.5)):
        rod = solids.tube([(x, y, 0.1), (x, y, 1.1)], 0.02, 64)
        parts.append(painted(rod, SUPPORT, np.array([0.1])))
    return Scene("statue", solids.collected(parts), np.zeros(3), np.array([0.0, 0.0, 0.6]))


@pytest.fixture(scope="session")
def ball_options(photo_options: MakeOptions) -> PhotoOptions:
    return photo_options()


@pytest.fixture(scope="session")
def ball_photo(ball_scene: Scene, ball_options: PhotoOptions) -> Photograph:
    return photograph(ball_scene, ball_options, 0)
