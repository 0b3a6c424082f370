"""Projection and its inverse, against pycolmap."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from workbench.kernels.lens_distortion import distorted_points, undistorted_points
from workbench.synthetic.lens import Lens
from workbench.synthetic.photo_options import PhotoOptions

MODELS = ("SIMPLE_RADIAL", "RADIAL", "OPENCV")
BARREL = (-0.09, 0.05, 0.0004, -0.0003)
STRONG = (-0.25, 0.12, 0.002, -0.003)

LensOf = Callable[..., Lens]


@pytest.fixture
def lens_of(photo_options: Callable[..., PhotoOptions]) -> LensOf:
    def make(model: str, distortion: tuple[float, ...], **camera: float) -> Lens:
        size = {"long_side_px": 3000, "short_side_px": 2000}
        given = {"model": model, "distortion": distortion, **size, **camera}
        return Lens.from_options(photo_options(camera=given).camera)

    return make


def pixels_of(lens: Lens) -> np.ndarray:
    u, v = np.meshgrid(np.linspace(0, lens.width, 23), np.linspace(0, lens.height, 31))
    return np.column_stack([u.ravel(), v.ravel()])


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("distortion", [BARREL, STRONG, (0.15, -0.05, -0.001, 0.002)])
def test_projection_undoes_itself(
    lens_of: LensOf, model: str, distortion: tuple[float, ...]
) -> None:
    lens = lens_of(model, distortion)
    pixels = pixels_of(lens)
    slopes = lens.slopes(pixels)
    points = np.column_stack([slopes, np.ones(len(slopes))]) * 3.7
    assert np.abs(lens.project(points) - pixels).max() < 1e-9
    assert np.abs(slopes - (pixels - lens.center_px) / lens.focal_px).max() > 1e-4


@pytest.mark.parametrize("model", MODELS)
def test_pycolmap_projects_to_the_same_pixels(lens_of: LensOf, model: str) -> None:
    pycolmap = pytest.importorskip("pycolmap")
    lens = lens_of(model, STRONG)
    ours = lens.colmap_camera()
    theirs = pycolmap.Camera(
        model=ours.model, width=ours.width, height=ours.height, params=np.array(ours.params)
    )
    points = np.random.default_rng(0).uniform([-0.5, -0.7, 1.6], [0.5, 0.7, 2.4], (200, 3))
    assert np.abs(theirs.img_from_cam(points) - lens.project(points)).max() < 1e-9


def test_focal_length_differs_from_the_engraved_one(lens_of: LensOf) -> None:
    lens = lens_of("RADIAL", BARREL, focal_length_mm=50.0, focal_deviation=0.02)
    assert lens.focal_px == pytest.approx(50 * 1.02 * 3000 / 36)


def test_vignetting_is_the_cosine_law_and_the_barrel(lens_of: LensOf) -> None:
    natural = lens_of(
        "RADIAL",
        BARREL,
        vignetting_cosine_power=4,
        vignetting_corner_loss=0,
        principal_offset=(0, 0),
    )
    light = natural.vignetting(0, natural.height)
    radius = np.hypot(natural.width / 2 - 0.5, natural.height / 2 - 0.5)
    assert light[0, 0] == pytest.approx(np.cos(np.arctan(radius / natural.focal_px)) ** 4, rel=1e-9)
    assert light.max() == pytest.approx(1.0, abs=1e-6)
    dark = lens_of(
        "RADIAL",
        BARREL,
        vignetting_cosine_power=0,
        vignetting_corner_loss=0.3,
        principal_offset=(0, 0),
    )
    assert dark.vignetting(0, 1)[0, 0] == pytest.approx(0.7, abs=1e-3)
    np.testing.assert_array_equal(dark.vignetting(100, 5), dark.vignetting(0, 200)[100:105])


def test_pixels_that_no_ray_reaches_have_none() -> None:
    # r (1 − 0.4 r²) is at most 0.609, at r = 0.913; the same places come from beyond it, too.
    coefficients = np.array([-0.4, 0.0, 0.0, 0.0])
    inner = np.linspace(0.0, 0.9, 50)
    ideal = np.stack([inner, np.zeros(50)], axis=1)
    back = undistorted_points(distorted_points(ideal, coefficients), coefficients)
    assert np.abs(back - ideal).max() < 1e-9
    beyond = np.array([[0.62, 0.0], [0.5, 0.6], [-3.0, 2.0], [np.nan, 0.1], [np.inf, 0.0]])
    assert np.isnan(undistorted_points(beyond, coefficients)).all()
