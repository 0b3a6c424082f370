"""Real photographs whose cameras are known; the bounds are those of the specification."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from tests.orientation.real_sets import dtu_scan37, fountain_p11, poses_of, skull_flash
from workbench.orientation.features import FeatureSettings
from workbench.orientation.structure_from_motion import OrientationSettings, oriented


def test_six_photographs_of_a_clamp_in_their_masks(shared_data: Callable[..., Path]) -> None:
    known = dtu_scan37(shared_data("dtu-scan37"))
    some = replace(known, photos=known.photos[8:14])
    settings = OrientationSettings(features=FeatureSettings(max_image_px=800, max_features=3000))
    found = oriented(some.photos, settings)
    assert found.unplaced == {}
    assert known.center_errors(poses_of(found.model)).max() < 0.01 * known.object_distance


@pytest.mark.slow
def test_fountain(shared_data: Callable[..., Path]) -> None:
    known = fountain_p11(shared_data("fountain-p11"))
    found = oriented(known.photos)
    assert len(found.model.images) == 11
    # Metres, against surveyed cameras.
    assert np.median(known.center_errors(poses_of(found.model))) < 0.006


@pytest.mark.slow
def test_skull(shared_data: Callable[..., Path]) -> None:
    known = skull_flash(shared_data("skull-flash"))
    found = oriented(known.photos)
    assert len(found.model.images) == 66
    errors = known.center_errors(poses_of(found.model)) / known.object_distance
    assert np.median(errors) < 0.0005
    assert found.pairs_compared < 0.5 * 66 * 65 / 2


@pytest.mark.slow
def test_clamp_in_its_masks(shared_data: Callable[..., Path]) -> None:
    known = dtu_scan37(shared_data("dtu-scan37"))
    found = oriented(known.photos)
    assert len(found.model.images) == 49
    errors = known.center_errors(poses_of(found.model)) / known.object_distance
    assert np.median(errors) < 0.003
