"""Points of files, clouds and memory through every format that there is."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.formats.point_fixtures import assert_same, some_points
from workbench.cloud.building import build_cloud
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.point_export import POINT_FORMATS, ROUNDED_FORMATS, export_points
from workbench.cloud.point_sources import (
    StreamBlocks,
    cloud_schema,
    cloud_stream,
    open_points,
    points_of,
)
from workbench.cloud.schema import POINTS, Attribute, Schema
from workbench.errors import InputError, SettingsError
from workbench.formats.point_stream import slices_of, surveyed
from workbench.geometry.point_set import PointSet

UTM = (431_000.0, 5_400_000.0, 320.0)
SUFFIXES = {"las": ".las", "laz": ".laz", "copc": ".copc.laz", "ply": ".ply", "e57": ".e57",
            "layered": ".cloud"}  # fmt: skip


@pytest.mark.parametrize("file_format", SUFFIXES)
@pytest.mark.parametrize("attributes", [True, False])
def test_points_come_back(tmp_path: Path, file_format: str, attributes: bool) -> None:
    points = some_points(5000, offset=UTM, attributes=attributes)
    path = tmp_path / "new" / f"cloud{SUFFIXES[file_format]}"
    told = export_points(points, path, file_format)
    assert (told["format"], told["file"], told["items"]) == (file_format, str(path), 5000)
    assert told["bytes"] == path.stat().st_size
    assert told["bits_per_item"] == pytest.approx(8 * told["bytes"] / 5000)
    assert told["rounding_error"] <= 0.5e-4
    assert set(told["attributes"]) | set(told["left_out"]) == set(points.arrays()) - {"points"}
    found = points_of(path)
    if file_format == "e57":
        order = np.lexsort(found.points.T), np.lexsort(points.points.T)
        np.testing.assert_array_equal(found.points[order[0]], points.points[order[1]])
        assert told["left_out"] == ["radius"] * attributes
        return
    assert_same(found, points, told["rounding_error"] + 2e-9)
    again = path.with_name(f"again{SUFFIXES[file_format]}")
    export_points(points, again, file_format)
    assert again.read_bytes() == path.read_bytes()


@pytest.mark.parametrize("file_format", ROUNDED_FORMATS)
def test_precision_is_kept(tmp_path: Path, file_format: str) -> None:
    told = export_points(some_points(100), tmp_path / "cloud", file_format, precision=0.01)
    assert (told["precision"], told["rounding_error"]) == (0.01, 0.005)


def test_from_every_source(tmp_path: Path) -> None:
    """A PLY, a layered cloud as a file and one that is open, and memory: the same points."""
    points = some_points(3000)
    export_points(points, tmp_path / "one.ply", "ply")
    export_points(tmp_path / "one.ply", tmp_path / "two.cloud", "layered")
    export_points(tmp_path / "two.cloud", tmp_path / "three.ply", "ply")
    with LayeredCloud(tmp_path / "two.cloud") as cloud:
        export_points(cloud, tmp_path / "four.laz", "laz", precision=1e-6)
        assert cloud_stream(cloud).count == 3000
        with pytest.raises(InputError, match="written over"):
            export_points(cloud, tmp_path / "two.cloud", "layered")
    assert_same(points_of(tmp_path / "three.ply"), points, 0.0)
    assert_same(points_of(tmp_path / "four.laz"), points, 0.5e-6)
    with open_points(tmp_path / "two.cloud") as stream, open_points(points) as other:
        np.testing.assert_array_equal([stream.low, stream.high], [other.low, other.high])
        assert stream.attributes == other.attributes == {"normals", "color", "radius"}


def test_attributes_of_other_kinds_stay_behind(tmp_path: Path) -> None:
    """Colours that are no bytes are not colours of points; other attributes have no place."""
    path = tmp_path / "odd.cloud"
    schema = Schema((Attribute("color", "float32", 3), Attribute("scan", "int32")))
    places = np.random.default_rng(0).uniform(size=(50, 3))
    block = {POINTS: places, "color": np.ones((50, 3), np.float32), "scan": np.zeros(50, np.int32)}
    build_cloud(path, [block], schema)
    assert_same(points_of(path), PointSet(places), 0.0)


def test_blocks_of_a_stream(tmp_path: Path) -> None:
    stream = surveyed(slices_of(some_points(10)))
    (block,) = StreamBlocks(stream)
    assert set(block) == set(cloud_schema(stream.attributes).names)


@pytest.mark.parametrize("file_format", POINT_FORMATS)
def test_what_cannot_be_written(tmp_path: Path, file_format: str) -> None:
    out = tmp_path / "cloud"
    broken = some_points(10)
    broken.points[3] = np.nan
    for points, word in ((PointSet(np.empty((0, 3))), "no points"), (broken, "1 of 10")):
        with pytest.raises(InputError, match=word):
            export_points(points, out, file_format)
    if file_format not in ROUNDED_FORMATS:
        with pytest.raises(SettingsError, match="precision"):
            export_points(some_points(10), out, file_format, precision=0.1)
    assert not list(tmp_path.iterdir())


def test_unknown_formats_and_sources(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="no format"):
        export_points(some_points(10), tmp_path / "cloud", "dxf")
    export_points(some_points(10), tmp_path / "cloud.ply", "ply")
    with pytest.raises(InputError, match="written over"):
        export_points(tmp_path / "cloud.ply", tmp_path / "cloud.ply", "ply")
    for name in ("absent.cloud", "absent.laz", "picture.png"):
        with pytest.raises(InputError) as told:
            points_of(tmp_path / name)
        assert told.value.file == str(tmp_path / name)
