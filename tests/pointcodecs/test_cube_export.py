"""Points to a file of cubes: what it tells of them."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.errors import SettingsError
from workbench.geometry.point_set import PointSet
from workbench.pointcodecs.cube_export import CubeOptions, export_point_cubes
from workbench.pointcodecs.cube_file import read_point_cubes


@pytest.fixture(scope="module")
def cloud() -> PointSet:
    """Points of a box at an easting and a northing, coloured and with normals."""
    rng = np.random.default_rng(4)
    points = np.array([482_000.0, 5_412_000.0, 90.0]) + rng.uniform(0, [4, 3, 2], (20_000, 3))
    normals = rng.normal(size=(20_000, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    color = rng.integers(0, 256, (20_000, 3)).astype(np.uint8)
    return PointSet(points, normals.astype(np.float32), color)


@pytest.mark.parametrize("codec", ["ci", "eci", "context"])
def test_points_move_by_what_is_told(tmp_path, cloud, codec):
    path = tmp_path / "a.pcube"
    figures = export_point_cubes(cloud, path, CubeOptions(codec, None, 0.05))

    back = read_point_cubes(path).point_set()
    distance = np.linalg.norm(cloud.points - _nearest(back.points, cloud.points, 0.05), axis=1)
    assert figures["largest_move"] == pytest.approx(distance.max(), rel=1e-6)
    # Points that lie anywhere in a cell are half its side from the middle, by mean squares.
    assert figures["rms_move"] == pytest.approx(np.sqrt((distance**2).mean()), rel=1e-6)
    assert figures["rms_move"] == pytest.approx(0.5 * 0.05, rel=0.02)
    assert figures["largest_move"] < 0.05 * 3**0.5 / 2
    assert (figures["given"], figures["points"]) == (20_000, len(back))
    assert figures["merged"] == 20_000 - len(back) > 0
    assert figures["cell_size"] == 0.05


def _nearest(centers: np.ndarray, points: np.ndarray, size: float) -> np.ndarray:
    """The middle of the cell each point lies in, found among those of the file."""
    origin = centers.min(axis=0)
    there = {tuple(c): k for k, c in enumerate(np.rint((centers - origin) / size).astype(int))}
    wanted = np.rint((points - origin) / size).astype(int)
    return centers[[there[tuple(c)] for c in wanted]]


def test_a_resolution_is_that_of_the_longest_side(tmp_path, cloud):
    figures = export_point_cubes(cloud, tmp_path / "a.pcube", CubeOptions("ci", 200))

    extent = np.ptp(cloud.points, axis=0).max()
    assert figures["cell_size"] == pytest.approx(extent / 200, rel=1e-6)
    cells = read_point_cubes(tmp_path / "a.pcube").cells
    assert np.ptp(cells[:, 0]) == 199


@pytest.mark.parametrize(
    ("options", "name", "message"),
    [
        (CubeOptions("zip"), "a.pcube", "codec"),
        (CubeOptions("ci", 100, 0.1), "a.pcube", "resolution or by their size"),
        (CubeOptions("ci", None, None), "a.pcube", "resolution or by their size"),
        (CubeOptions("ci", 1), "a.pcube", "resolution"),
        (CubeOptions("ci"), "a.ply", "suffix"),
    ],
)
def test_options_that_make_no_cells_are_refused(tmp_path, cloud, options, name, message):
    with pytest.raises(SettingsError, match=message):
        export_point_cubes(cloud, tmp_path / name, options)

    assert not list(tmp_path.iterdir())
