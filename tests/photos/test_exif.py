"""What files tell of how they were taken."""

from __future__ import annotations

import shutil
import struct
import time
from pathlib import Path

import pytest
from PIL import Image

from workbench.photos.exif import PhotoFacts, photo_facts, sidecar_files


def test_a_dng_tells_everything(dng, gradient) -> None:
    facts = photo_facts(dng(gradient))
    assert facts.camera == "Maker Camera One"
    assert facts.lens == "A 35 mm lens"
    assert facts.exposure_time_s == pytest.approx(1 / 125)
    assert (facts.f_number, facts.iso, facts.focal_length_mm) == (8.0, 400.0, 35.0)
    assert facts.flash_fired is True
    assert facts.pixel_pitch_mm == pytest.approx(0.02)
    assert facts.taken_at == "2024:03:02 10:11:12"
    assert photo_facts(dng(gradient, "dark", flash_fired=False)).flash_fired is False


def test_focal_length_in_pixels_by_frame_or_by_photosite() -> None:
    by_frame = PhotoFacts(focal_length_mm=7.0, focal_length_35mm=36, pixel_pitch_mm=0.1)
    assert by_frame.focal_length_px(6000) == pytest.approx(6000.0)
    by_photosite = PhotoFacts(focal_length_mm=50.0, pixel_pitch_mm=0.005)
    assert by_photosite.focal_length_px(6000) == pytest.approx(10_000.0)
    assert PhotoFacts(focal_length_mm=50.0).focal_length_px(6000) is None


def test_nothing_told_is_none_and_no_guess(tmp_path: Path) -> None:
    Image.new("RGB", (8, 8)).save(tmp_path / "a.png")
    assert photo_facts(tmp_path / "a.png") == PhotoFacts()


def test_counts_that_ask_for_millions_of_tags_are_not_followed(tmp_path: Path) -> None:
    # Every directory claims 65,535 entries of 999 numbers each, and leads to another such.
    entry = struct.pack("<HHII", 0x0111, 3, 999, 8)
    path = tmp_path / "a.tif"
    path.write_bytes(b"II*\0" + struct.pack("<I", 8) + b"\xff\xff" + entry * 100_000)
    start = time.process_time()
    assert photo_facts(path) == PhotoFacts()
    assert time.process_time() - start < 5, "a minute and more where they are followed"


def test_crw_flash_is_in_the_picture_beside(shared_data, tmp_path: Path) -> None:
    lit, unlit = (shared_data("raw", "canon", f"CRW_{n}.CRW") for n in ("0119", "0304"))
    assert photo_facts(lit).flash_fired is True
    assert photo_facts(unlit).flash_fired is False
    assert [path.name for path in sidecar_files(lit)] == ["CRW_0119.THM"]
    alone = tmp_path / lit.name
    shutil.copy(lit, alone)
    facts = photo_facts(alone)
    assert facts.flash_fired is None, "without the .THM nobody knows"
    assert facts.f_number == pytest.approx(2.8, abs=0.01), "which LibRaw tells"
    assert facts.iso == 50.0


@pytest.mark.parametrize(
    ("file", "camera", "flash"),
    [
        ("kodak-dc50/DC0008L.KDC", "DC50", True),
        ("kodak-dc50/DC0009L.KDC", "DC50", False),
        ("olympus-c5050/PB180004.JPG", "C5050Z", True),
        ("odd/canon_eos_6d.dng", "Canon EOS 6D", False),
        ("canon/CRW_0101.CRW", "Canon PowerShot S40", False),
    ],
)
def test_real_files(shared_data, file: str, camera: str, flash: bool) -> None:
    facts = photo_facts(shared_data("raw", *file.split("/")))
    assert camera in (facts.camera or "")
    assert facts.flash_fired is flash
    assert facts.exposure_time_s
    assert facts.f_number
    assert facts.iso
