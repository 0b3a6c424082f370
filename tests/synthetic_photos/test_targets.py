"""White targets and the ColorChecker: shading and colours that are known in advance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from workbench.geometry import transforms
from workbench.synthetic import Scene
from workbench.synthetic.chart import PATCH_ALBEDO, board_corners, patch_corners
from workbench.synthetic.photo_options import PhotoOptions
from workbench.synthetic.photography import (
    Photograph,
    chart_photograph,
    studio_of,
    target_photograph,
)

POINT_FLASH = {"size_m": (0.0, 0.0), "ambient_lux": 0.0, "power_sigma": 0.0}
EXACT_SENSOR = {"prnu": 0.0, "response_deviation": 0.0, "neutral_deviation": 0.0}


def green_levels(photo: Photograph, options: PhotoOptions) -> np.ndarray:
    """Level (rows, cols) at green photosites, NaN elsewhere; 1 is the full scale."""
    sensor = options.sensor
    level = (photo.mosaic.astype(float) - sensor.black_level) / (
        sensor.white_level - sensor.black_level
    )
    rows, cols = np.indices(level.shape)
    level[(rows + cols) % 2 == 0] = np.nan
    return level


def block_means(values: np.ndarray, block: int) -> np.ndarray:
    rows, cols = (side // block for side in values.shape)
    cut = values[: rows * block, : cols * block].reshape(rows, block, cols, block)
    return np.nanmean(cut, axis=(1, 3))


def expected_flat(options: PhotoOptions, distance: float, scene: Scene) -> np.ndarray:
    """The flash law by hand: inverse square, cosine, beam, vignetting, guide number."""
    lens = studio_of(scene, options).lens
    camera, flash = options.camera, options.flash
    v, u = np.indices((lens.height, lens.width)) + 0.5
    slopes = lens.slopes(np.column_stack([u.ravel(), v.ravel()]))
    points = np.column_stack([slopes, np.ones(len(slopes))]) * distance
    way = points - np.array(flash.offset_in_camera_m)
    d = np.linalg.norm(way, axis=1)
    axis = np.array([*np.tan(np.radians(flash.beam_tilt_deg)), 1.0])
    axis /= np.linalg.norm(axis)
    along = way @ axis / d
    beam = 1 - flash.edge_falloff * (1 / along**2 - 1) / lens.corner_slope**2
    law = 0.128 / 0.18 * (flash.guide_number_m / camera.f_number) ** 2 * camera.iso / 100
    level = options.charts.flat_reflectance * law * beam * way[:, 2] / d**3
    return level.reshape(v.shape) * lens.vignetting(0, lens.height)


@pytest.mark.parametrize("held", ["upright", "level"])
def test_flat_target_recovers_vignetting_and_beam(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions], held: str
) -> None:
    options = photo_options(flash=POINT_FLASH, sensor=EXACT_SENSOR, camera={"held": held})
    photo = target_photograph(ball_scene, options, "flat", 0)
    measured = block_means(green_levels(photo, options), 20)
    expected = block_means(expected_flat(options, 2.0, ball_scene), 20)
    np.testing.assert_allclose(measured, expected, rtol=0.004)
    assert measured.min() < 0.85 * measured.max()


def test_flat_target_without_vignetting_differs(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    flat = {"vignetting_cosine_power": 0.0, "vignetting_corner_loss": 0.0}
    options = photo_options(flash=POINT_FLASH, sensor=EXACT_SENSOR)
    plain = photo_options(flash=POINT_FLASH, sensor=EXACT_SENSOR, camera=flat)
    ratio = block_means(
        green_levels(target_photograph(ball_scene, options, "flat", 0), options), 20
    ) / block_means(green_levels(target_photograph(ball_scene, plain, "flat", 0), plain), 20)
    lens = studio_of(ball_scene, options).lens
    np.testing.assert_allclose(ratio, block_means(lens.vignetting(0, lens.height), 20), rtol=0.006)


def test_linearity_series_follows_the_inverse_square(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    distances = (1.9, 2.4, 3.0, 4.0)
    options = photo_options(
        flash={**POINT_FLASH, "offset_in_camera_m": (0.0, 0.0, 0.0), "beam_tilt_deg": (0, 0)},
        sensor=EXACT_SENSOR,
        charts={"linearity_distances_m": distances},
    )
    levels = [
        np.nanmean(
            green_levels(target_photograph(ball_scene, options, "linearity", k), options)[
                110:130, 70:90
            ]
        )
        for k in range(len(distances))
    ]
    slope = np.polyfit(np.log(distances), np.log(levels), 1)[0]
    assert slope == pytest.approx(-2.0, abs=0.01)


def test_iso_and_aperture_change_the_exposure_as_they_should(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    def middle(**camera: float) -> float:
        options = photo_options(flash=POINT_FLASH, sensor=EXACT_SENSOR, camera=camera)
        photo = target_photograph(ball_scene, options, "flat", 0)
        return float(np.nanmean(green_levels(photo, options)[100:140, 60:100]))

    base = middle(iso=100, f_number=11.0)
    assert middle(iso=200, f_number=11.0) == pytest.approx(2 * base, rel=0.005)
    assert middle(iso=100, f_number=22.0) == pytest.approx(base / 4, rel=0.01)
    # The flash is shorter than any shutter time.
    assert middle(iso=100, f_number=11.0, exposure_time_s=1 / 60) == pytest.approx(base, rel=0.005)


def test_patch_colours_are_the_published_ones() -> None:
    colour = pytest.importorskip("colour")
    chart = colour.CCS_COLOURCHECKERS["ColorChecker24 - After November 2014"]
    for expected, xy_y in zip(PATCH_ALBEDO, chart.data.values(), strict=True):
        rgb = colour.XYZ_to_RGB(
            colour.xyY_to_XYZ(xy_y),
            "sRGB",
            illuminant=chart.illuminant,
            chromatic_adaptation_transform="Bradford",
        )
        np.testing.assert_allclose(rgb, expected, atol=2e-5)


@pytest.fixture(scope="module")
def chart_options(photo_options: Callable[..., PhotoOptions]) -> PhotoOptions:
    return photo_options(
        flash={**POINT_FLASH, "edge_falloff": 0.0},
        sensor=EXACT_SENSOR,
        camera={"long_side_px": 900, "short_side_px": 600},
    )


@pytest.fixture(scope="module")
def chart_photo(ball_scene: Scene, chart_options: PhotoOptions) -> Photograph:
    return chart_photograph(ball_scene, chart_options, 0)


def test_patches_lie_where_truth_says_and_have_their_colours(
    ball_scene: Scene, chart_options: PhotoOptions, chart_photo: Photograph
) -> None:
    lens = studio_of(ball_scene, chart_options).lens
    camera_from_chart = transforms.inverse(chart_photo.local_from_camera)
    corners = lens.project(transforms.apply(camera_from_chart, patch_corners().reshape(-1, 3)))
    assert chart_photo.albedo is not None
    for quad, albedo in zip(corners.reshape(24, 4, 2), PATCH_ALBEDO, strict=True):
        inner = quad.mean(axis=0) + 0.8 * (quad - quad.mean(axis=0))
        for u, v in inner:
            seen = chart_photo.albedo[int(v), int(u)] / 65535
            np.testing.assert_allclose(seen, np.clip(albedo, 0, 1), atol=2e-5)


def test_the_chart_is_tilted_and_whole(
    ball_scene: Scene, chart_options: PhotoOptions, chart_photo: Photograph
) -> None:
    normal = np.array([0.0, 0.0, 1.0])
    cosine = -normal @ chart_photo.local_from_camera[:3, 2]
    assert np.degrees(np.arccos(cosine)) == pytest.approx(18.0, abs=2.0)
    lens = studio_of(ball_scene, chart_options).lens
    in_camera = transforms.apply(transforms.inverse(chart_photo.local_from_camera), board_corners())
    pixels = lens.project(in_camera)
    assert (pixels > 20).all()
    assert (pixels < [lens.width - 20, lens.height - 20]).all()
    # Upper left of the chart is upper left in the picture.
    assert pixels[0, 0] < pixels[1, 0]
    assert pixels[0, 1] < pixels[3, 1]
