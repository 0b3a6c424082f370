"""Photographs that nobody placed: upright, and as large as known distances say."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from stages.orient.options import OrientOptions
from stages.orient.scaling import OwnScale, in_own_scale
from tests.orientation.blob import body, photographed
from workbench.formats.colmap import ColmapModel
from workbench.geometry.similarity import Similarity
from workbench.orientation.alignment import transformed

# On its side, elsewhere, and seven times as large.
ASTRAY = Similarity(7.0, np.array([[0, 0, 1.0], [1, 0, 0], [0, 1, 0]]), np.array([9, 8, 7.0]))


def scaled(*, cameras: bool, **options: Any) -> tuple[ColmapModel, ColmapModel, OwnScale]:
    """The blob's photographs as they are, and as they come out of their own frame."""
    true = photographed(body())
    job: Any = SimpleNamespace(
        scene=SimpleNamespace(cameras=cameras), options=OrientOptions(**options)
    )
    return true, *in_own_scale(job, transformed(true, ASTRAY), {}, ())


def places(model: ColmapModel) -> np.ndarray:
    cameras = model.photo_cameras()
    return np.array([cameras[name].center for name in sorted(cameras)])


def test_a_frame_of_their_own_is_turned_upright_and_scaled_by_a_known_distance() -> None:
    true, found, told = scaled(cameras=False)
    assert told.told == {"way": "none"}
    assert told.warnings[0].startswith("no scale")
    heights = places(true)[:, 2]
    # Upright to a degree, in the unit it came in.
    assert np.ptp(places(found)[:, 2] / 7.0 - heights) < 0.02 * np.ptp(places(true))
    names = sorted(true.photo_cameras())
    known = float(np.linalg.norm(places(true)[0] - places(true)[3]))
    distances = {f"{names[0]} {names[3]}": known}
    _, found, told = scaled(cameras=False, camera_distances_m=distances)
    assert told.told["metres"] == pytest.approx(1.0 / 7.0)
    assert np.ptp(places(found)[:, 2] - heights) < 0.02 * np.ptp(places(true))
    assert np.linalg.norm(places(found)[0] - places(found)[3]) == pytest.approx(known)


def test_a_frame_that_was_brought_is_kept() -> None:
    true, found, told = scaled(cameras=True)
    assert places(found) == pytest.approx(ASTRAY.apply(places(true)))
    assert told.told == {"way": "cameras as given"}
