"""DNGs are read by independent programs: LibRaw, exifread and tifffile."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from datetime import datetime
from pathlib import Path

import numpy as np
import pytest

from workbench.errors import InputError
from workbench.formats.dng import DngMetadata, write_dng

rawpy = pytest.importorskip("rawpy")
exifread = pytest.importorskip("exifread")
tifffile = pytest.importorskip("tifffile")

METADATA = DngMetadata(
    make="House",
    model="Model One",
    lens_model="House 35mm f/2",
    serial_number="42",
    software="tests",
    taken_at=datetime(2023, 2, 3, 4, 5, 6),
    cfa="GBRG",
    black_level=512,
    white_level=15000,
    color_matrix_a=np.diag([0.8, 1.1, 0.7]),
    color_matrix_d65=np.array([[0.8, -0.2, -0.05], [-0.5, 1.25, 0.27], [-0.1, 0.2, 0.75]]),
    as_shot_neutral=(0.5, 1.0, 0.625),
    noise_profile=(3e-5, 2e-8),
    exposure_time_s=1 / 125,
    f_number=5.6,
    iso=400,
    focal_length_mm=35.0,
    pixel_pitch_mm=0.006,
    focal_length_35mm=35,
    flash_fired=True,
)


@pytest.fixture
def mosaic() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 16383, (36, 52), np.uint16)


@pytest.fixture
def file(tmp_path: Path, mosaic: np.ndarray) -> Path:
    path = tmp_path / "one.dng"
    preview = np.random.default_rng(1).integers(0, 255, (7, 9, 3), np.uint8)
    write_dng(path, mosaic, METADATA, preview)
    return path


def test_libraw_reads_every_photosite_and_level(file: Path, mosaic: np.ndarray) -> None:
    with rawpy.imread(str(file)) as raw:
        np.testing.assert_array_equal(raw.raw_image, mosaic)
        assert raw.black_level_per_channel == [512] * 4
        assert raw.white_level == 15000
        colors = "".join(raw.color_desc.decode()[k] for k in raw.raw_pattern.ravel())
        assert colors == "GBRG"
        r, g, b, _ = raw.camera_whitebalance
        np.testing.assert_allclose([r / g, b / g], [2.0, 1.6], rtol=1e-5)
        assert raw.sizes.flip == 0
        assert (raw.sizes.width, raw.sizes.height) == (52, 36)


def test_exif_is_read_back(file: Path) -> None:
    with file.open("rb") as opened:
        tags = exifread.process_file(opened, details=False)
    expected = {
        "Image Make": "House",
        "Image Model": "Model One",
        "EXIF LensModel": "House 35mm f/2",
        "EXIF DateTimeOriginal": "2023:02:03 04:05:06",
        "EXIF ExposureTime": "1/125",
        "EXIF FNumber": "28/5",
        "EXIF ISOSpeedRatings": "400",
        "EXIF FocalLength": "35",
        "EXIF FocalLengthIn35mmFilm": "35",
    }
    assert {name: str(tags[name]) for name in expected} == expected
    assert tags["EXIF Flash"].values[0] & 1
    per_cm = float(tags["EXIF FocalPlaneXResolution"].values[0])
    assert per_cm == pytest.approx(10 / 0.006, rel=1e-6)


def test_structure_is_sound_tiff(file: Path, mosaic: np.ndarray) -> None:
    with tifffile.TiffFile(file) as tiff:
        page = tiff.pages[0]
        assert page.asarray().shape == (7, 9, 3)
        raw = page.pages[0]
        np.testing.assert_array_equal(raw.asarray(), mosaic)
        codes = [tag.code for tag in page.tags]
        assert codes == sorted(codes)
        offset = raw.dataoffsets[0]
    assert file.stat().st_size == offset + mosaic.nbytes


@pytest.mark.skipif(shutil.which("exiftool") is None, reason="exiftool is not installed")
def test_exiftool_finds_no_fault(file: Path) -> None:
    answer = subprocess.run(
        ["exiftool", "-validate", "-warning", "-a", "-ColorMatrix2", str(file)],
        capture_output=True,
        text=True,
        check=True,
    ).stdout
    assert "Color Matrix 2                  : 0.8 -0.2 -0.05 -0.5 1.25 0.27" in answer
    assert "Error" not in answer


def test_same_content_same_bytes(tmp_path: Path, mosaic: np.ndarray) -> None:
    for name in ("a.dng", "b.dng"):
        write_dng(tmp_path / name, mosaic, METADATA)
    assert (tmp_path / "a.dng").read_bytes() == (tmp_path / "b.dng").read_bytes()


def test_no_flash_is_told(tmp_path: Path, mosaic: np.ndarray) -> None:
    write_dng(tmp_path / "a.dng", mosaic, replace(METADATA, flash_fired=False))
    with (tmp_path / "a.dng").open("rb") as opened:
        tags = exifread.process_file(opened, details=False)
    assert not tags["EXIF Flash"].values[0] & 1


@pytest.mark.parametrize("shape", [(3, 4), (4, 3), (4, 4, 3)])
def test_what_is_no_mosaic_is_refused(tmp_path: Path, shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="no Bayer mosaic"):
        write_dng(tmp_path / "a.dng", np.zeros(shape, np.uint16), METADATA)
    assert not list(tmp_path.iterdir())
