"""E57 files of clouds, read by our reader, by pye57, and damaged."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pye57
import pytest
from pye57 import libe57

from tests.formats.point_fixtures import check_damage, some_points
from workbench.errors import InputError
from workbench.formats.e57_writing import write_e57_points
from workbench.formats.point_files import point_batches, read_points
from workbench.formats.point_stream import BATCH_POINTS, slices_of, surveyed

UTM = (431_000.0, 5_400_000.0, 320.0)


@pytest.mark.parametrize("attributes", [True, False])
def test_points_come_back_to_the_bit(tmp_path: Path, attributes: bool) -> None:
    points = some_points(BATCH_POINTS + 10, offset=UTM, attributes=attributes)
    path = tmp_path / "cloud.e57"
    told = write_e57_points(path, surveyed(slices_of(points)))
    assert told["bytes"] == path.stat().st_size
    assert told["rounding_error"] == 0
    assert told["left_out"] == (["radius"] if attributes else [])
    found = read_points(path)
    np.testing.assert_array_equal(found.points, points.points)
    if not attributes:
        assert found.color is None
        return
    np.testing.assert_array_equal(found.color, points.color)
    with pye57.E57(str(path)) as file:
        assert file.scan_count == 1
        header = file.get_header(0)
        assert not header.has_pose()
        values = np.empty(len(points), np.float32)
        buffers = libe57.VectorSourceDestBuffer()
        buffers.append(
            libe57.SourceDestBuffer(file.image_file, "nor:normalZ", values, len(points), True, True)
        )
        reader = header.points.reader(buffers)
        assert reader.read() == len(points)
        reader.close()
    np.testing.assert_array_equal(values, points.normals[:, 2])


def test_same_points_same_bytes(tmp_path: Path) -> None:
    stream = surveyed(slices_of(some_points(100)))
    for name in ("a.e57", "b.e57"):
        write_e57_points(tmp_path / name, stream)
    assert (tmp_path / "a.e57").read_bytes() == (tmp_path / "b.e57").read_bytes()


def test_every_damage_is_told(tmp_path: Path) -> None:
    """Pages have checksums, so there is no damage that goes unnoticed."""
    path = tmp_path / "cloud.e57"
    write_e57_points(path, surveyed(slices_of(some_points(300))))
    assert check_damage(path, point_batches, tries=60, lengths=25) == 0


def test_a_folder_that_is_not_there(tmp_path: Path) -> None:
    with pytest.raises(InputError) as told:
        write_e57_points(tmp_path / "no" / "cloud.e57", surveyed(slices_of(some_points(3))))
    assert told.value.file == str(tmp_path / "no" / "cloud.e57")
