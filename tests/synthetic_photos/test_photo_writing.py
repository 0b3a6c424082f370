"""Photographs on disk: layout, the same bytes again, resuming, what other programs read."""

from __future__ import annotations

import hashlib
import json
import os
import pickle
from collections.abc import Callable, Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from workbench.formats.colmap import read_colmap_text
from workbench.pipeline.cluster import local_cluster, results_of
from workbench.synthetic import Scene, SimulationOptions
from workbench.synthetic import photo_series as series
from workbench.synthetic import photo_writing as writing
from workbench.synthetic.photo_options import PhotoOptions
from workbench.synthetic.photography import photograph, studio_of
from workbench.synthetic.simulation import build_scene

SIMULATION = SimulationOptions()


@pytest.fixture(scope="module")
def options(photo_options: Callable[..., PhotoOptions]) -> PhotoOptions:
    return photo_options(photos=3, camera={"long_side_px": 120, "short_side_px": 80})


@pytest.fixture(scope="module")
def written(
    tmp_path_factory: pytest.TempPathFactory, ball_scene: Scene, options: PhotoOptions
) -> Path:
    out = tmp_path_factory.mktemp("written")
    return series.write_photos(out, ball_scene, SIMULATION, options)


def contents(folder: Path) -> dict[str, str]:
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(folder.rglob("*"))
        if path.is_file()
    }


def test_everything_that_was_promised_is_there(written: Path) -> None:
    names = set(contents(written))
    for number in range(3):
        assert f"photos/photo_{number:03d}.dng" in names
        for kind in ("object", "support", "shadow", "albedo"):
            assert f"truth/photos/{kind}/photo_{number:03d}.png" in names
        assert f"truth/photos/depth/photo_{number:03d}.npz" in names
    for name in ("photos/chart_00", "calibration/flat_00", "calibration/linearity_01"):
        assert f"{name}.dng" in names
    for name in ("cameras.txt", "images.txt", "points3D.txt", "photos.json", "charts.json"):
        assert f"truth/photos/{name}" in names
    assert not any(name.endswith(".partial") for name in names)


def test_the_same_options_give_the_same_bytes_whatever_the_workers(
    tmp_path: Path, written: Path, ball_scene: Scene, options: PhotoOptions
) -> None:
    again = series.write_photos(tmp_path, ball_scene, SIMULATION, options, workers=1)
    assert contents(again) == contents(written)


def test_another_seed_gives_other_pictures(ball_scene: Scene, options: PhotoOptions) -> None:
    other = options.model_copy(update={"seed": 6})
    a, b = photograph(ball_scene, options, 0), photograph(ball_scene, other, 0)
    assert not np.array_equal(a.mosaic, b.mosaic)
    assert not np.allclose(a.local_from_camera, b.local_from_camera)


def test_a_photograph_is_the_same_from_another_process(
    ball_scene: Scene, options: PhotoOptions, written: Path
) -> None:
    scene, same = pickle.loads(pickle.dumps((ball_scene, options)))
    assert pickle.loads(pickle.dumps(photograph)) is photograph
    photo = photograph(scene, same, 2)
    data = (written / "photos" / "photo_002.dng").read_bytes()
    assert data.endswith(photo.mosaic.tobytes())


def test_only_what_is_missing_or_stale_is_taken_again(
    tmp_path: Path, ball_scene: Scene, options: PhotoOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken: list[str] = []
    original = writing.write_photograph

    def counted(*arguments: object) -> None:
        taken.append(arguments[3].name)  # type: ignore[attr-defined]
        original(*arguments)  # type: ignore[arg-type]

    monkeypatch.setattr(writing, "write_photograph", counted)
    series.write_photos(tmp_path, ball_scene, SIMULATION, options)
    before = contents(tmp_path)
    total = len(writing.photo_items(options))
    assert len(taken) == total
    taken.clear()
    (tmp_path / "photos" / "photo_001.dng").unlink()
    (tmp_path / "truth" / "photos" / "records" / "flat_00.json").write_text("{", encoding="utf-8")
    seen: list[tuple[int, int]] = []
    series.write_photos(
        tmp_path, ball_scene, SIMULATION, options, lambda done, of, label: seen.append((done, of))
    )
    assert sorted(taken) == ["flat_00", "photo_001"]
    assert seen[-1] == (total, total)
    assert contents(tmp_path) == before
    taken.clear()
    changed = options.model_copy(update={"flash": options.flash.model_copy(update={"mode": "ttl"})})
    series.write_photos(tmp_path, ball_scene, SIMULATION, changed)
    assert len(taken) == total


def test_truth_cameras_are_read_by_pycolmap(
    written: Path, ball_scene: Scene, options: PhotoOptions
) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    theirs = pycolmap.Reconstruction(str(written / "truth" / "photos"))
    ours = read_colmap_text(written / "truth" / "photos")
    assert len(theirs.images) == 3
    facts = json.loads((written / "truth" / "photos" / "photos.json").read_text())
    for image in theirs.images.values():
        pose = image.cam_from_world().matrix()
        np.testing.assert_allclose(
            pose, ours.image_named(image.name).camera_from_world[:3], atol=1e-12
        )
        (record,) = (r for r in facts["photos"] if r["file"] == f"photos/{image.name}")
        photo = photograph(ball_scene, options, int(image.name[6:9]))
        np.testing.assert_allclose(record["flash_middle_in_local"], photo.flash.middle)
        offset = np.array(options.flash.offset_in_camera_m)
        np.testing.assert_allclose(pose[:, :3] @ photo.flash.middle + pose[:, 3], offset, atol=1e-9)
    camera = theirs.cameras[1]
    assert camera.params[0] == pytest.approx(50 * 1.012 * 120 / 36)


def test_masks_and_albedo_are_those_of_the_photograph(
    written: Path, ball_scene: Scene, options: PhotoOptions
) -> None:
    photo = photograph(ball_scene, options, 1)
    truth = written / "truth" / "photos"
    for kind in ("object", "support", "shadow"):
        mask = cv2.imread(str(truth / kind / "photo_001.png"), cv2.IMREAD_UNCHANGED)
        np.testing.assert_array_equal(mask, getattr(photo, f"{kind}_mask"))
        assert set(np.unique(mask)) == {0, 255}
    albedo = cv2.imread(str(truth / "albedo" / "photo_001.png"), cv2.IMREAD_UNCHANGED)
    assert albedo.dtype == np.uint16
    np.testing.assert_array_equal(albedo[..., ::-1], photo.albedo)
    assert not ((photo.object_mask > 0) & (photo.support_mask > 0)).any()
    with np.load(truth / "depth" / "photo_001.npz") as arrays:
        np.testing.assert_array_equal(arrays["depth"], photo.depth)


def test_surface_albedo_belongs_to_the_vertices(
    written: Path, ball_scene: Scene, options: PhotoOptions
) -> None:
    with np.load(written / "truth" / "photos" / "surface_albedo.npz") as arrays:
        albedo = arrays["albedo"]
    assert albedo.shape == ball_scene.surface.vertices.shape
    paint = studio_of(ball_scene, options).subject.paint
    again = paint.at(ball_scene.surface.vertices, ball_scene.material).albedo
    np.testing.assert_array_equal(albedo, again)


def test_exif_tells_the_settings(written: Path, options: PhotoOptions) -> None:
    exifread = pytest.importorskip("exifread")
    times = []
    for name in ("photos/chart_00", "photos/photo_000", "photos/photo_002"):
        with (written / f"{name}.dng").open("rb") as file:
            tags = exifread.process_file(file, details=False)
        assert str(tags["EXIF FocalLength"]) == "50"
        assert str(tags["EXIF ISOSpeedRatings"]) == str(options.camera.iso)
        assert str(tags["EXIF FNumber"]) == "11"
        assert str(tags["EXIF ExposureTime"]) == "1/250"
        assert tags["EXIF Flash"].values[0] & 1
        # What a reader of EXIF takes for the focal length in pixels.
        per_mm = float(tags["EXIF FocalPlaneXResolution"].values[0]) / 10
        assert 50 * per_mm == pytest.approx(50 * 120 / 36)
        times.append(str(tags["EXIF DateTimeOriginal"]))
    assert times == sorted(times)
    assert len(set(times)) == 3


def test_a_broken_photograph_stops_the_run_and_leaves_no_half_file(
    tmp_path: Path, ball_scene: Scene, options: PhotoOptions, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(writing, "write_dng", full)
    with pytest.raises(OSError, match="space"):
        series.write_photos(tmp_path, ball_scene, SIMULATION, options)
    assert not list((tmp_path / "photos").iterdir())
    assert not list((tmp_path / "truth" / "photos" / "records").iterdir())


def test_other_processes_take_the_same_photographs(
    tmp_path: Path, photo_options: Callable[..., PhotoOptions]
) -> None:
    """They have the options and the folder alone; what they make is the same to the byte."""
    simulation = SimulationOptions(scene="sphere", scans=1)
    options = photo_options(
        photos=2,
        camera={"long_side_px": 60, "short_side_px": 40},
        charts={"color_frames": 1, "flat_frames": 0, "linearity_distances_m": ()},
    )
    scene = build_scene(simulation)
    here = series.write_photos(tmp_path / "here", scene, simulation, options)

    def two_processes(
        witness: Path, run: Callable[..., None], items: dict[str, dict[str, object]]
    ) -> Iterator[tuple[str, None]]:
        assert witness.is_file()
        with local_cluster(2) as client:
            yield from results_of(client, run, items)

    there = series.write_photos(
        tmp_path / "there", scene, simulation, options, elsewhere=two_processes
    )
    assert contents(here) == contents(there)
