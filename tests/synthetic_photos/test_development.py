"""A raw converter and nothing else gets the albedo back from the photographs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from scipy.ndimage import uniform_filter

from workbench.formats.dng import write_dng
from workbench.synthetic import Scene
from workbench.synthetic.photo_options import PhotoOptions
from workbench.synthetic.photography import (
    Photograph,
    photograph,
    studio_of,
    target_photograph,
)

rawpy = pytest.importorskip("rawpy")

EXACT_SENSOR = {"response_deviation": 0.0, "neutral_deviation": 0.0}


def developed(path: Path) -> np.ndarray:
    """Linear Rec. 709 (rows, cols, 3); 1 is the white level in green."""
    with rawpy.imread(str(path)) as raw:
        r, g, b, _ = raw.camera_whitebalance
        picture = raw.postprocess(
            gamma=(1, 1),
            no_auto_bright=True,
            # LibRaw would take the brightest photosite for the white level.
            adjust_maximum_thr=0.0,
            user_wb=[r, g, b, g],
            output_bps=16,
            output_color=rawpy.ColorSpace.sRGB,
            demosaic_algorithm=rawpy.DemosaicAlgorithm.LINEAR,
            highlight_mode=rawpy.HighlightMode.Clip,
            half_size=False,
        )
    return picture.astype(float) / 65535


def smooth_interior(photo: Photograph, margin: int = 3) -> np.ndarray:
    """Pixels (rows, cols) of the lit object away from every edge."""
    keep = (photo.object_mask > 0) & (photo.shadow_mask == 0)
    for axis in (0, 1):
        for step in range(-margin, margin + 1):
            keep = keep & np.roll(photo.object_mask > 0, step, axis)
            keep = keep & np.roll(photo.shadow_mask == 0, step, axis)
    return keep


def test_development_divided_by_the_shading_is_the_albedo(
    tmp_path: Path, ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    options = photo_options(
        sensor=EXACT_SENSOR,
        camera={"long_side_px": 480, "short_side_px": 320, "blur_sigma_px": 0.0},
        rendering={"samples_per_pixel": 8},
    )
    photo = photograph(ball_scene, options, 0)
    write_dng(tmp_path / "a.dng", photo.mosaic, photo.metadata)
    linear = developed(tmp_path / "a.dng")
    assert photo.albedo is not None
    assert photo.diffuse is not None
    assert photo.specular is not None
    lens = studio_of(ball_scene, options).lens
    level = linear / lens.vignetting(0, lens.height)[..., None]
    diffuse = photo.diffuse.astype(float)
    estimate = (level - photo.specular[..., None]) / np.maximum(diffuse, 1e-6)
    keep = smooth_interior(photo) & (photo.specular < 0.02) & (photo.diffuse[..., 1] > 0.25)
    assert keep.sum() > 2000
    albedo = photo.albedo / 65535.0
    # No bias, in dark paint as in bright: neighbourhoods wider than the demosaicing's reach.
    box = (9, 9, 1)
    wide = smooth_interior(photo, 6) & keep
    light = np.maximum(uniform_filter(diffuse, box), 1e-9)
    measured = (uniform_filter(level - photo.specular[..., None], box) / light)[wide]
    expected = (uniform_filter(albedo * diffuse, box) / light)[wide]
    for channel in range(3):
        bright = expected[:, channel] > np.median(expected[:, channel])
        for part in (bright, ~bright):
            ratio = measured[part, channel].mean() / expected[part, channel].mean()
            assert ratio == pytest.approx(1.0, abs=0.015)
    np.testing.assert_allclose(measured, expected, atol=0.05)
    # Where the paint is even, single pixels agree within what photons allow.
    even = keep.copy()
    for axis in (0, 1):
        for step in (-1, 1):
            change = np.abs(np.roll(albedo, step, axis) - albedo).max(axis=-1)
            even &= change < 0.02 * albedo.max(axis=-1) + 0.004
    assert even.sum() > 100
    error = estimate[even][:, 1] - albedo[even][:, 1]
    electrons = level[even][:, 1] * studio_of(ball_scene, options).sensor.full_scale_e
    sigma = albedo[even][:, 1] / np.sqrt(electrons)
    assert np.sqrt(np.mean((error / sigma) ** 2)) < 2.0
    assert np.abs(error.mean()) < 0.004


def test_white_target_is_grey_only_as_far_as_the_camera_errs(
    tmp_path: Path, ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    def spread(sensor: dict[str, float]) -> float:
        options = photo_options(sensor=sensor, flash={"ambient_lux": 0.0})
        photo = target_photograph(ball_scene, options, "flat", 0)
        write_dng(tmp_path / "w.dng", photo.mosaic, photo.metadata)
        mean = developed(tmp_path / "w.dng")[100:140, 60:100].mean(axis=(0, 1))
        return float(np.ptp(mean) / mean.mean())

    assert spread(EXACT_SENSOR) < 0.006
    assert 0.005 < spread({"neutral_deviation": 0.05, "response_deviation": 0.02}) < 0.3


def test_the_preview_shows_the_same_picture(ball_photo: Photograph, tmp_path: Path) -> None:
    write_dng(tmp_path / "a.dng", ball_photo.mosaic, ball_photo.metadata, ball_photo.preview)
    linear = developed(tmp_path / "a.dng")
    encoded = np.where(linear < 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)
    small = ball_photo.preview / 255.0
    rows, cols = small.shape[:2]
    step = linear.shape[0] // rows
    mean = encoded[: rows * step, : cols * step].reshape(rows, step, cols, step, 3).mean((1, 3))
    assert np.corrcoef(mean.ravel(), small.ravel())[0, 1] > 0.98
