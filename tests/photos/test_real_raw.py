"""Every real file is developed, and LibRaw says the same of its light."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import rawpy

from workbench.errors import InputError
from workbench.photos.decoding import read_linear

MOSAICS = (
    *("canon/CRW_0101.CRW", "canon/CRW_0119.CRW", "canon/CRW_0304.CRW"),
    *("kodak-dc120/P003910.KDC", "kodak-dc50/DC0008L.KDC", "odd/Blackmagic.dng"),
)


def _libraw(path: Path, **changes) -> np.ndarray:
    """LibRaw's own linear output, by its plain command ``-4 -o 0 -r 1 1 1 1 -W -M -c 0``."""
    with rawpy.imread(str(path)) as raw:
        params = rawpy.Params(
            gamma=(1, 1),
            output_bps=16,
            output_color=rawpy.ColorSpace.raw,
            user_wb=[1, 1, 1, 1],
            no_auto_bright=True,
            adjust_maximum_thr=0.0,
            **changes,
        )
        return raw.postprocess(params)


@pytest.mark.parametrize(
    "file",
    [
        *("canon/CRW_0304.CRW", "kodak-dc120/P003910.KDC", "kodak-dc50/DC0008L.KDC"),
        "odd/canon_eos_6d.dng",
        pytest.param("odd/Blackmagic.dng", marks=pytest.mark.slow),
        pytest.param("canon/CRW_0101.CRW", marks=pytest.mark.slow),
        pytest.param("canon/CRW_0119.CRW", marks=pytest.mark.slow),
    ],
)
def test_decoded_light_is_librawes(shared_data, file: str) -> None:
    path = shared_data("raw", *file.split("/"))
    digital = np.rint(read_linear(path, "ahd").values.astype(float) * 65535)
    assert np.abs(digital - _libraw(path)).max() <= 1


@pytest.mark.parametrize("file", MOSAICS[:3] + MOSAICS[-1:])
def test_decoded_light_is_that_of_the_photosites(shared_data, file: str) -> None:
    """Without LibRaw's processing: the mosaic itself, less black, over the range."""
    path = shared_data("raw", *file.split("/"))
    with rawpy.imread(str(path)) as raw:
        mosaic, colors = raw.raw_image_visible.astype(float), raw.raw_colors_visible
        black, white = raw.black_level_per_channel[0], raw.white_level
        light = np.clip((mosaic - black) / (white - black), 0, 1)
        rows, cols = (side // 2 * 2 for side in light.shape)
        blocks = light[:rows, :cols].reshape(rows // 2, 2, cols // 2, 2)
        kinds = colors[:2, :2]
    seen = read_linear(path, half_size=True).values
    for channel in (0, 2):
        down, right = np.argwhere(kinds == channel)[0]
        expected = blocks[:, down, :, right]
        apart = np.abs(seen[: rows // 2, : cols // 2, channel] - expected)
        assert apart.max() <= 1.5 / 65535


@pytest.mark.parametrize(
    "file",
    [
        *MOSAICS,
        *("canon/CRW_0104.CRW", "kodak-dc120/P003911.KDC", "kodak-dc50/DC0009L.KDC"),
        *("canon/IMG_0301.JPG", "olympus-c5050/PB180004.JPG"),
        *("odd/canon_eos_6d.dng", "odd/Nikon_uncompressed.nef"),
    ],
)
def test_every_file_develops(shared_data, file: str) -> None:
    photo = read_linear(shared_data("raw", *file.split("/")), half_size=True)
    assert photo.values.shape[:2] == photo.usable.shape
    assert min(photo.usable.shape) > 200
    assert np.isfinite(photo.values).all()
    assert (photo.usable == 255).mean() > 0.9
    assert 0.01 < photo.values.mean() < 0.9
    assert (photo.linearised_from is not None) == file.endswith("JPG")


def test_three_colours_at_every_photosite_are_not_all_full(shared_data) -> None:
    """LibRaw tells of 8 bits for this scanner's file and gives 16."""
    photo = read_linear(shared_data("raw", "odd", "Nikon_uncompressed.nef"))
    assert photo.white_level == 65535
    assert photo.values.max() < 0.9
    assert photo.values.std() > 0.05
    assert photo.white_balance is None


def test_unlike_photosites_are_stretched_with_their_mask(shared_data) -> None:
    photo = read_linear(shared_data("raw", "kodak-dc120", "P003910.KDC"))
    assert photo.usable.shape == photo.values.shape[:2] == (976, 1301)


@pytest.mark.parametrize(
    "file",
    [
        *("canon/CRW_0304.CRW", "kodak-dc120/P003910.KDC", "odd/Blackmagic.dng"),
        *("odd/canon_eos_6d.dng", "odd/Nikon_uncompressed.nef", "canon/IMG_0301.JPG"),
    ],
)
@pytest.mark.parametrize("share", [0.001, 0.3, 0.97, 0.9995])
def test_cut_files_are_named(shared_data, tmp_path: Path, file: str, share: float) -> None:
    original = shared_data("raw", *file.split("/"))
    data = original.read_bytes()
    path = tmp_path / original.name
    path.write_bytes(data[: int(share * len(data))])
    with pytest.raises(InputError) as error:
        read_linear(path)
    assert error.value.file == str(path)
