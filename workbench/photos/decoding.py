"""From a photograph's file to light on the sensor: linear, unclipped where it says so, upright.

RAW files are decoded by LibRaw with nothing of a picture's making: no tone curve, no automatic
brightness, no white balance, no colour matrix, and a scale that is the same for all photographs
of a camera. Pictures of other kinds are linearised from their profile and say so.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.icc_profile import MatrixProfile, read_matrix_profile, srgb_profile
from workbench.formats.photo_reading import (
    PLAIN_SUFFIXES,
    QUARTER_TURNS,
    in_three_channels,
    opened_raw,
    readable,
)
from workbench.formats.picture_file import opened_picture, require_whole_chunks

if TYPE_CHECKING:
    from PIL.Image import Image

Demosaic = Literal["dht", "ahd", "vng", "linear"]

_FULL = 65535
# A photosite this close below the white level says no more than one at it.
_NEAR_WHITE = 0.998
# How a level stands out at which a sensor is full, among so many levels below it.
_LEVELS_COMPARED, _PILED_UP, _FEWEST_FULL = 20, 8.0, 50
# Every algorithm looks so far around a photosite, at most.
_REACH_PX = {"linear": 1, "vng": 2, "ahd": 3, "dht": 3}
# EXIF orientation → counter-clockwise quarter turns after a mirroring, left to right.
_EXIF_TURNS = {1: 0, 3: 2, 6: 3, 8: 1, 2: 0, 4: 2, 5: 1, 7: 3}
_EXIF_MIRRORED = (2, 4, 5, 7)
_EXIF_ORIENTATION = 0x0112
_SINGULAR = 1e-6
# IEC 61966-2-1.
_XYZ_FROM_SRGB = np.array(
    [[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]]
)


@dataclass(frozen=True)
class LinearPhoto:
    """A photograph as light on the sensor.

    Attributes
    ----------
    values : (h, w, 3) float32 linear RGB of the camera, upright, 1 where the sensor is full, all
        channels alike for a camera without colour; linear RGB of the profile where the picture
        was linearised from one.
    usable : (h, w) uint8, 255 where no photosite that the pixel was made of is full, else 0.
    white_balance : (3,) multipliers that the camera chose, green 1; None where it tells none.
    camera_from_xyz : (3, 3) the camera's colour matrix relative to D65 as LibRaw knows it;
        None where it knows none.
    black_level, white_level : of the file's numbers; 0 and the largest for other pictures.
    linearised_from : how a picture that is not RAW was made linear, for people; None for RAW.
    profile_matrix : (3, 3) from its linear RGB to CIE XYZ relative to D50; None for RAW.
    """

    values: NDArray[np.float32]
    usable: NDArray[np.uint8]
    white_balance: NDArray[np.float64] | None = None
    camera_from_xyz: NDArray[np.float64] | None = None
    black_level: float = 0.0
    white_level: float = _FULL
    linearised_from: str | None = None
    profile_matrix: NDArray[np.float64] | None = None


def read_linear(path: Path, demosaic: Demosaic = "dht", *, half_size: bool = False) -> LinearPhoto:
    """A photograph as light on the sensor.

    Parameters
    ----------
    path : RAW, JPEG, PNG or TIFF.
    demosaic : how the colours between a mosaic's photosites are found. ``dht`` needs no white
        balance to do well; ``ahd``, LibRaw's own default, does.
    half_size : each 2 × 2 photosites become one pixel instead, which is quick and exact.

    Raises
    ------
    InputError
        When the file is damaged, incomplete or no photograph, with its name.
    """
    with _whole(path), readable(path):
        if path.suffix.lower() in PLAIN_SUFFIXES:
            photo = _read_picture(path)
            return _halved(photo) if half_size else photo
        import rawpy

        with opened_raw(path) as raw:
            if raw.raw_type == rawpy.RawType.Flat:
                return _developed(raw, raw.raw_image_visible, demosaic, half_size)
            # All colours at every photosite: LibRaw has nothing to interpolate or to halve.
            photo = _developed(raw, raw.raw_image_visible[..., :3], demosaic, False)
            return _halved(photo) if half_size else photo


def _developed(
    raw: Any, mosaic: NDArray[np.uint16], demosaic: Demosaic, half_size: bool
) -> LinearPhoto:
    """What LibRaw makes of an opened file."""
    import rawpy

    highest, white = int(mosaic.max()), int(raw.white_level)
    if highest > 4 * white:
        # Three-colour files of scanners hold 16 bits where LibRaw tells of 8.
        white = _FULL
    black = np.array(raw.black_level_per_channel, float)
    full = _full_level(raw, mosaic, white)
    options: dict[str, Any] = {
        "user_wb": [1.0, 1.0, 1.0, 1.0],
        "output_color": rawpy.ColorSpace.raw,
        "gamma": (1, 1),
        "no_auto_bright": True,
        # Else a photograph without highlights is brightened, each by another factor.
        "adjust_maximum_thr": 0.0,
        "output_bps": 16,
        "half_size": half_size,
        "demosaic_algorithm": rawpy.DemosaicAlgorithm[demosaic.upper()],
    }
    if white != raw.white_level:
        options["user_sat"] = white
    usable = _usable(raw, mosaic, full, black, half_size, _REACH_PX[demosaic])
    digital = raw.postprocess(**options)
    balance = np.array(raw.camera_whitebalance[:3], float)
    values = in_three_channels(digital).astype(np.float32) * np.float32(1 / _FULL)
    height, width = values.shape[:2]
    if usable.shape != (height, width):  # photosites that are not square
        stretched = cv2.resize(usable, (width, height), interpolation=cv2.INTER_NEAREST)
        usable = stretched.astype(np.uint8)
    colored = raw.num_colors > 1  # no channel of a camera without colour has a balance
    # LibRaw says 1, 1, 1 where the file says nothing.
    known = colored and bool((balance > 0).all()) and not bool((balance == 1.0).all())
    return LinearPhoto(
        values,
        np.ascontiguousarray(usable, np.uint8),
        balance / balance[1] if known else None,
        _camera_matrix(raw) if colored else None,
        float(black.mean()),
        float(white),
    )


def _camera_matrix(raw: Any) -> NDArray[np.float64] | None:
    """(3, 3) from CIE XYZ to the camera, but for a factor of each row; None where unknown."""
    known = np.array(raw.rgb_xyz_matrix[:3], float)
    if np.abs(np.linalg.det(known)) > _SINGULAR:
        return known
    # Of a DNG's own matrices LibRaw makes the way to linear sRGB.
    srgb_from_camera = np.array(raw.color_matrix, float)[:3, :3]
    if np.abs(np.linalg.det(srgb_from_camera)) > _SINGULAR:
        return np.asarray(np.linalg.inv(_XYZ_FROM_SRGB @ srgb_from_camera), np.float64)
    return None


def _full_level(raw: Any, mosaic: NDArray[np.uint16], white: int) -> float:
    """The lowest number that a full photosite is written as.

    The white level that LibRaw knows of a camera, or the file's own; some sensors are full
    below it, and then the highest number of all occurs far more often than those before it.
    """
    told = raw.camera_white_level_per_channel
    level = min([value for value in told or () if 0.5 * white < value <= white], default=white)
    counts = np.bincount(mosaic.ravel())
    highest = len(counts) - 1
    before = counts[:-1][counts[:-1] > 0][-_LEVELS_COMPARED:]
    piled_up = (
        0.5 * white < highest < level
        and len(before) == _LEVELS_COMPARED
        and counts[-1] >= max(_FEWEST_FULL, _PILED_UP * float(np.median(before)))
    )
    return float(highest if piled_up else level)


def _usable(
    raw: Any,
    mosaic: NDArray[np.uint16],
    full: float,
    black: NDArray[np.float64],
    half_size: bool,
    reach_px: int,
) -> NDArray[np.uint8]:
    """The mask (h, w) of pixels that no full photosite has gone into, upright."""
    threshold = black.mean() + _NEAR_WHITE * (full - black.mean())
    if mosaic.ndim == 3:
        clipped = (mosaic >= threshold).any(axis=2).astype(np.uint8)
    else:
        clipped = (mosaic >= threshold).astype(np.uint8)
        if half_size:
            rows, cols = (side // 2 for side in clipped.shape)
            blocks = clipped[: 2 * rows, : 2 * cols].reshape(rows, 2, cols, 2)
            clipped = blocks.max(axis=(1, 3))
        else:
            side = 2 * reach_px + 1
            clipped = cv2.dilate(clipped, np.ones((side, side), np.uint8)).astype(np.uint8)
    mask = np.where(clipped > 0, 0, 255).astype(np.uint8)
    return np.rot90(mask, QUARTER_TURNS.get(raw.sizes.flip, 0))


def _read_picture(path: Path) -> LinearPhoto:
    with opened_picture(path) as opened:
        opened.load()
        orientation = int(opened.getexif().get(_EXIF_ORIENTATION, 1))
        embedded = opened.info.get("icc_profile")
        plain = _sixteen_bits(path, opened)
        if plain is None:
            plain = np.asarray(opened.convert("RGB"), np.uint8)
    profile, told = _profile_of(embedded)
    values = profile.linear(plain)
    full = np.iinfo(plain.dtype).max
    usable = np.where((plain >= full).any(axis=2), 0, 255).astype(np.uint8)
    return LinearPhoto(
        _upright(values, orientation),
        _upright(usable, orientation),
        white_level=float(full),
        linearised_from=told,
        profile_matrix=profile.xyz_d50_from_rgb,
    )


def _sixteen_bits(path: Path, opened: Image) -> NDArray[np.uint16] | None:
    """The picture with all its bits where it has sixteen, which Pillow reads eight of."""
    if opened.format not in ("PNG", "TIFF"):
        return None
    content = path.read_bytes()
    require_whole_chunks(content)
    data = np.frombuffer(content, np.uint8)
    # As stored: the orientation is applied to both kinds of pictures alike, later.
    flags = cv2.IMREAD_UNCHANGED | cv2.IMREAD_IGNORE_ORIENTATION
    picture = cv2.imdecode(data, flags)
    if picture is None or picture.dtype != np.uint16:
        return None
    if picture.ndim == 2:
        picture = np.repeat(picture[..., None], 3, axis=2)
    return np.ascontiguousarray(picture[..., 2::-1], np.uint16)


def _profile_of(embedded: bytes | None) -> tuple[MatrixProfile, str]:
    """What a picture is linearised with, and how to say so."""
    if not embedded:
        return srgb_profile(), "sRGB (the file has no profile)"
    profile = read_matrix_profile(embedded)
    if profile is None:
        return srgb_profile(), "sRGB (the file's profile is not of curves and a matrix)"
    from PIL import ImageCms

    try:
        opened = ImageCms.ImageCmsProfile(io.BytesIO(embedded))
        name = ImageCms.getProfileDescription(opened).strip()
    except (OSError, ImageCms.PyCMSError):
        name = ""
    return profile, name or "the file's profile"


def _upright(picture: NDArray[Any], orientation: int) -> NDArray[Any]:
    mirrored = picture[:, ::-1] if orientation in _EXIF_MIRRORED else picture
    return np.ascontiguousarray(np.rot90(mirrored, _EXIF_TURNS.get(orientation, 0)))


def _halved(photo: LinearPhoto) -> LinearPhoto:
    rows, cols = (max(side // 2, 1) for side in photo.usable.shape)
    values = cv2.resize(photo.values, (cols, rows), interpolation=cv2.INTER_AREA)
    usable = cv2.resize(photo.usable, (cols, rows), interpolation=cv2.INTER_AREA)
    return replace(
        photo,
        values=np.asarray(values, np.float32),
        usable=np.where(usable == 255, 255, 0).astype(np.uint8),
    )


@contextmanager
def _whole(path: Path) -> Iterator[None]:
    """What is not even a file, or an empty one, is told before any reader guesses."""
    if not path.is_file():
        raise InputError("There is no such photograph", file=path, fix="check the path")
    if path.stat().st_size == 0:
        raise InputError(
            "The photograph is empty", file=path, found="0 bytes", fix="copy it from the card again"
        )
    if path.suffix.lower() == ".dng":
        _require_all_pixels(path)
    yield


def _require_all_pixels(path: Path) -> None:
    """Tell a DNG that ends too early: a decoder fills in what is missing of a last tile."""
    import tifffile

    size = path.stat().st_size
    try:
        with tifffile.TiffFile(path) as file:
            pages = [file.pages.first, *(file.pages.first.pages or ())]
            ends = [
                offset + count
                for page in pages
                for offset, count in zip(page.dataoffsets, page.databytecounts, strict=False)
            ]
    except Exception:  # its directories are beyond this reader; LibRaw has the word
        return
    if max(ends, default=0) > size:
        raise InputError(
            "The photograph is incomplete",
            file=path,
            expected=f"{max(ends)} bytes",
            found=f"{size} bytes",
            fix="copy it from the card again, or leave it out",
        )
