"""What photographs saw and scans missed, on a wall."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.cloud.filling import ScannedSurface
from workbench.cloud.sample_source import HeldSamples
from workbench.geometry.samples import Samples

SPACING = 0.01


def wall(x: tuple[float, float], height: float = 0.0, facing: float = 1.0) -> Samples:
    """Samples of the plane z = height between two x, 0 to 1 in y."""
    grid = np.stack(np.meshgrid(np.arange(*x, SPACING), np.arange(0, 1, SPACING)), -1)
    flat = grid.reshape(-1, 2)
    n = len(flat)
    points = np.column_stack([flat, np.full(n, height)])
    normals = np.tile([0.0, 0.0, facing], (n, 1))
    return Samples(points, normals, np.full(n, SPACING), np.ones(n), np.zeros(n, np.int32))


def scanned() -> ScannedSurface:
    return ScannedSurface.of(HeldSamples(wall((0.0, 0.6))), SPACING, 1_000_000)


def test_only_what_the_scans_have_not_is_missed() -> None:
    found = scanned().missed(wall((0.0, 0.7)))
    assert found.given == 7000
    assert (found.samples.points[:, 0] > 0.6).all()
    assert found.samples.points[:, 0].min() < 0.6 + 4.0 * SPACING
    assert found.offset_m == pytest.approx(0.0, abs=1e-12)
    assert found.scanned + len(found.samples) == found.given


def test_the_far_side_of_a_thin_wall_is_missed() -> None:
    behind = wall((0.0, 0.6), -0.5 * SPACING, facing=-1.0)
    assert len(scanned().missed(behind).samples) == len(behind)


@pytest.mark.parametrize("off", [-6.0, 6.0])
def test_depths_that_lie_off_are_no_second_wall(off: float) -> None:
    found = scanned().missed(wall((0.0, 0.8), off * SPACING))
    assert found.offset_m == pytest.approx(off * SPACING)
    assert (found.samples.points[:, 0] > 0.6).all()


def test_depths_that_scatter_are_no_second_wall() -> None:
    photographed = wall((0.0, 0.6))
    noise = np.random.default_rng(0).normal(0.0, 2.0 * SPACING, len(photographed))
    photographed.points[:, 2] += noise
    found = scanned().missed(photographed)
    assert found.scatter_m == pytest.approx(2.0 * SPACING, rel=0.1)
    assert len(found.samples) < 0.001 * len(photographed)


def test_what_lies_far_off_is_not_of_the_object() -> None:
    found = scanned().missed(wall((0.0, 2.0)))
    assert found.beyond == pytest.approx(20_000 - 7160, abs=200)
    assert found.samples.points[:, 0].max() < 0.72


def test_where_nothing_was_seen_by_both_nothing_is_told_of_the_offset() -> None:
    found = scanned().missed(wall((0.66, 0.7)))
    assert np.isnan(found.offset_m)
    assert len(found.samples) == found.given
    assert len(scanned().missed(wall((0.0, 0.0))).samples) == 0
