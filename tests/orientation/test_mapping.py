"""The last adjustment takes the lens that the photographs bear, and no fuller one."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from workbench.orientation.mapping import MappingSettings, adjusted, quiet_pycolmap

pycolmap = pytest.importorskip("pycolmap")

WIDTH, HEIGHT, FOCAL = 1000, 800, 900.0


def seen_through(model: str, params: list[float], photos: int = 16) -> Any:
    """A noisy reconstruction through a known lens, given as if it were the plainest one."""
    options = pycolmap.SyntheticDatasetOptions()
    options.num_rigs, options.num_cameras_per_rig, options.num_frames_per_rig = 1, 1, photos
    options.num_points3D = 400
    options.camera_width, options.camera_height = WIDTH, HEIGHT
    options.camera_model_id = getattr(pycolmap.CameraModelId, model)
    options.camera_params = params
    pycolmap.set_random_seed(3)
    with quiet_pycolmap():
        found = pycolmap.synthesize_dataset(options)
        noise = pycolmap.SyntheticNoiseOptions()
        noise.point2D_stddev = 0.3
        pycolmap.synthesize_noise(noise, found)
    for camera in found.cameras.values():
        camera.model = pycolmap.CameraModelId.SIMPLE_RADIAL
        camera.params = [FOCAL, WIDTH / 2, HEIGHT / 2, 0.0]
    return found


def lens_of(reconstruction: Any) -> tuple[str, np.ndarray]:
    (camera,) = reconstruction.cameras.values()
    return camera.model.name, np.array(camera.params)


PLAIN = ("SIMPLE_RADIAL", [FOCAL, WIDTH / 2, HEIGHT / 2, -0.05])
OFF_AXIS = ("SIMPLE_RADIAL", [FOCAL, WIDTH / 2 + 15, HEIGHT / 2 - 10, -0.05])
FULL = ("OPENCV", [FOCAL, FOCAL + 4, WIDTH / 2 + 15, HEIGHT / 2 - 10, -0.1, 0.08, 2e-3, -1e-3])


@pytest.mark.parametrize("lens", [PLAIN, OFF_AXIS, FULL])
def test_the_lens_is_as_full_as_it_has_to_be(lens: tuple[str, list[float]]) -> None:
    given = seen_through(*lens)
    with quiet_pycolmap():
        found = adjusted(given, MappingSettings())
    model, params = lens_of(found)
    assert model == lens[0]
    np.testing.assert_allclose(params[:4], lens[1][:4], atol=2.0 if lens is not FULL else 4.0)
    if lens is PLAIN:
        assert params[1:3].tolist() == [WIDTH / 2, HEIGHT / 2]
    # Noise of 0.3 pixels in each direction, little of which the points can take up.
    assert 0.25 < found.compute_mean_reprojection_error() < 0.4
    assert lens_of(given)[1].tolist() == [FOCAL, WIDTH / 2, HEIGHT / 2, 0.0]


def test_few_photographs_and_a_word_keep_it_plain_and_a_word_makes_it_full() -> None:
    with quiet_pycolmap():
        for found in (
            adjusted(seen_through(*OFF_AXIS, photos=8), MappingSettings()),
            adjusted(seen_through(*OFF_AXIS), MappingSettings(lens="simple")),
        ):
            model, params = lens_of(found)
            assert model == "SIMPLE_RADIAL"
            assert params[1:3].tolist() == [WIDTH / 2, HEIGHT / 2]
        model, params = lens_of(adjusted(seen_through(*PLAIN), MappingSettings(lens="full")))
        assert model == "OPENCV"
        # These photographs say little of the term in r⁴: what auto leaves it out for.
        np.testing.assert_allclose(params[[4, 6, 7]], [-0.05, 0, 0], atol=0.02)


def test_outliers_pull_little() -> None:
    given = seen_through(*PLAIN)
    clean = seen_through(*PLAIN)
    rng = np.random.default_rng(0)
    for image in given.images.values():
        for point in image.points2D:
            if point.has_point3D() and rng.random() < 0.03:
                point.xy = point.xy + rng.choice([-3.5, 3.5], 2)
    with quiet_pycolmap():
        focal = lens_of(adjusted(given, MappingSettings(lens="simple")))[1][0]
        undisturbed = lens_of(adjusted(clean, MappingSettings(lens="simple")))[1][0]
    assert focal == pytest.approx(undisturbed, abs=0.5)
