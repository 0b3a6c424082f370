"""Readers of photographs, masks and other pictures."""

from __future__ import annotations

import io
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from tests.fuzz.checksums import repaired_png
from tests.fuzz.target import MIB, Reader, Target
from tests.photos.conftest import METADATA
from workbench.formats.dng import write_dng
from workbench.formats.icc_profile import linear_rgb_profile, read_matrix_profile, srgb_profile
from workbench.formats.linear_tiff import LinearPicture, read_linear_tiff, write_linear_tiff
from workbench.formats.mask_png import write_mask_png
from workbench.formats.photo_preview import read_preview
from workbench.formats.photo_reading import photo_size, read_photo
from workbench.photos.decoding import read_linear
from workbench.photos.exif import photo_facts
from workbench.project.store import ProductStore
from workbench.project.user_masks import read_mask

_PROFILE = linear_rgb_profile(srgb_profile().xyz_d50_from_rgb, "Linear")
# Blank pictures of one bit a pixel unpack so far, and work on them takes so much a pixel.
_PHOTO_MULTIPLE = 2048 * 8 * 48
_SMALL = (12, 16)


def _noise(channels: int, kind: type = np.uint8) -> np.ndarray:
    rng = np.random.default_rng(3)
    shape = (*_SMALL, channels) if channels > 1 else _SMALL
    return rng.integers(0, np.iinfo(kind).max, shape, dtype=kind)


def _saved(picture: Image.Image, kind: str, **options: Any) -> bytes:
    file = io.BytesIO()
    picture.save(file, kind, **options)
    return file.getvalue()


def _exif() -> Image.Exif:
    exif = Image.Exif()
    exif[0x0112], exif[0x010F], exif[0x0110] = 6, "Maker", "Maker One"
    exif.get_ifd(0x8769).update({0x829A: 0.01, 0x829D: 8.0, 0x8827: 100, 0x9209: 1, 0x920A: 35.0})
    return exif


def _jpeg_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    picture = Image.fromarray(_noise(3))
    grey = Image.fromarray(_noise(1))
    return [
        (_saved(picture, "JPEG", quality=60, exif=_exif(), icc_profile=_PROFILE),),
        (_saved(picture, "JPEG", quality=60, progressive=True),),
        (_saved(grey, "JPEG", quality=60),),
        (_saved(Image.fromarray(_noise(4), "CMYK"), "JPEG", quality=60),),
    ]


def _png_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    import cv2

    deep = cv2.imencode(".png", _noise(3, np.uint16))[1].tobytes()
    return [
        (_saved(Image.fromarray(_noise(3)), "PNG", exif=_exif(), icc_profile=_PROFILE),),
        (_saved(Image.fromarray(_noise(1)).convert("P"), "PNG"),),
        (_saved(Image.fromarray(_noise(4)), "PNG"),),
        (deep,),
    ]


def _tiff_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    import tifffile

    seeds = [
        (_saved(Image.fromarray(_noise(3)), "TIFF", compression=kind, icc_profile=_PROFILE),)
        for kind in ("raw", "tiff_lzw", "tiff_adobe_deflate", "jpeg", "packbits")
    ]
    tifffile.imwrite(folder / "deep.tif", _noise(3, np.uint16), photometric="rgb")
    return [*seeds, ((folder / "deep.tif").read_bytes(),)]


def _dng_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    mosaic = np.random.default_rng(4).integers(500, 12000, (32, 40)).astype(np.uint16)
    write_dng(folder / "a.dng", mosaic, METADATA)
    noted = replace(METADATA, noise_profile=(1e-4, 1e-6), cfa="GBRG")
    write_dng(folder / "b.dng", mosaic[:24, :24], noted)
    return [((folder / name).read_bytes(),) for name in ("a.dng", "b.dng")]


def _linear_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    values = np.random.default_rng(0).uniform(0, 2.5, (13, 7, 3)).astype(np.float32)
    write_linear_tiff(folder / "a.tif", LinearPicture(values, "rec709", 2.5, _PROFILE))
    return [((folder / "a.tif").read_bytes(),)]


def _mask_seeds(folder: Path) -> list[tuple[bytes, ...]]:
    write_mask_png(folder / "a.png", np.where(_noise(1) > 99, 255, 0).astype(np.uint8))
    other = _saved(Image.fromarray(_noise(3)), "PNG")
    return [((folder / "a.png").read_bytes(),), (other,)]


def _photo_readers(name: str) -> tuple[Reader, ...]:
    whole: tuple[Callable[[Path], object], ...] = (
        read_photo,
        photo_size,
        photo_facts,
        lambda path: read_preview(path, 8),
        read_linear,
        lambda path: read_linear(path, "ahd", half_size=True),
    )
    return tuple(lambda folder, read=read: read(folder / name) for read in whole)  # type: ignore[misc]


def _product(name: str) -> Reader:
    """A product of a project that is a picture."""

    def load(folder: Path) -> object:
        store = ProductStore(folder)
        path = store.path(name, "a")
        if not path.is_symlink():
            path.parent.mkdir(parents=True, exist_ok=True)
            path.symlink_to(folder / "input.png")
        return store.load(name, "a")

    return load


def _profile_in(folder: Path) -> object:
    return read_matrix_profile((folder / "input.icc").read_bytes())


PHOTO_TARGETS = (
    Target(
        "jpeg",
        ("input.jpg",),
        _jpeg_seeds,
        _photo_readers("input.jpg"),
        memory_multiple=_PHOTO_MULTIPLE,
    ),
    Target(
        "png",
        ("input.png",),
        _png_seeds,
        _photo_readers("input.png"),
        repaired_png,
        memory_multiple=_PHOTO_MULTIPLE,
    ),
    Target(
        "tiff",
        ("input.tif",),
        _tiff_seeds,
        _photo_readers("input.tif"),
        memory_multiple=_PHOTO_MULTIPLE,
    ),
    Target(
        "raw-dng",
        ("input.dng",),
        _dng_seeds,
        _photo_readers("input.dng"),
        memory_multiple=_PHOTO_MULTIPLE,
        memory_bytes=64 * MIB,
    ),
    Target(
        "linear-tiff",
        ("input.tif",),
        _linear_seeds,
        (lambda folder: read_linear_tiff(folder / "input.tif"),),
        memory_multiple=_PHOTO_MULTIPLE,
    ),
    Target(
        "masks",
        ("input.png",),
        _mask_seeds,
        (
            lambda folder: read_mask(folder / "input.png", (_SMALL[1], _SMALL[0])),
            _product("texture_pages"),
            _product("scan_masks"),
        ),
        repaired_png,
        memory_multiple=_PHOTO_MULTIPLE,
    ),
    Target("icc", ("input.icc",), lambda _: [(_PROFILE,)], (_profile_in,)),
)
