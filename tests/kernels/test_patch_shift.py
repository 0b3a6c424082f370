"""Patches are found again to a fiftieth of a pixel, whatever the light, or not at all."""

import cv2
import numpy as np
import pytest

from workbench.kernels.patch_shift import patch_shifts

HALF = 6


def painted(dx: float = 0.0, dy: float = 0.0) -> np.ndarray:
    """Soft spots, each exactly (dx, dy) further right and down."""
    rng = np.random.default_rng(0)
    y, x = np.mgrid[:120, :160].astype(float)
    image = np.zeros(x.shape)
    for _ in range(700):
        u, v, sign = rng.uniform(0, 160), rng.uniform(0, 120), rng.choice([-1.0, 1.0])
        image += sign * np.exp(-((x - u - dx) ** 2 + (y - v - dy) ** 2) / (2 * 2.5**2))
    return np.asarray(100 * image, np.float32)


@pytest.fixture(scope="module")
def scene() -> np.ndarray:
    return painted()


def grid(middles: np.ndarray) -> np.ndarray:
    steps = np.arange(-HALF, HALF + 1.0)
    return middles[:, None] + np.stack(np.meshgrid(steps, steps), -1).reshape(1, -1, 2)


MIDDLES = np.array([[40.0, 40.0], [80.0, 60.0], [110.0, 70.0], [60.0, 90.0]])


@pytest.mark.parametrize("shift", [(0.3, -0.45), (1.4, 0.8), (-0.05, 0.02)])
def test_a_shift_is_found_in_other_light(scene, shift):
    darker = 0.4 * painted(*shift) + 7
    found, agreement, _ = patch_shifts(scene, darker, MIDDLES, grid(MIDDLES), HALF, 20)
    assert found == pytest.approx(np.tile(shift, (4, 1)), abs=0.02)
    assert agreement.min() > 0.99


def test_patches_are_sampled_where_they_are_expected_not_as_squares(scene):
    turn = cv2.getRotationMatrix2D((80, 60), 25, 0.9)
    turned = cv2.warpAffine(scene, turn, scene.shape[::-1], flags=cv2.INTER_CUBIC)
    middles = np.array([[80.0, 60.0], [70.0, 50.0]])
    expected = grid(middles) @ turn[:, :2].T + turn[:, 2]
    found, agreement, _ = patch_shifts(scene, turned, middles, expected, HALF, 20)
    assert np.abs(found).max() < 0.03
    assert agreement.min() > 0.98
    as_squares, _, _ = patch_shifts(scene, turned, middles, grid(expected[:, 84]), HALF, 20)
    assert not np.abs(np.nan_to_num(as_squares, nan=9)).max() < 0.03


def plainly(image: np.ndarray, places: np.ndarray) -> np.ndarray:
    """Catmull and Rom's interpolation (Keys 1981, a = −1/2), every neighbour by its distance."""
    near = np.floor(places).astype(int)
    total = np.zeros(len(places))
    for j in range(-1, 3):
        for i in range(-1, 3):
            part = np.ones(len(places))
            for axis, step in ((0, i), (1, j)):
                d = np.abs(places[:, axis] - near[:, axis] - step)
                part *= np.where(
                    d < 1, 1.5 * d**3 - 2.5 * d**2 + 1, -0.5 * d**3 + 2.5 * d**2 - 4 * d + 2
                )
            total += part * image[near[:, 1] + j, near[:, 0] + i]
    return total


def test_the_shift_is_that_of_plain_least_squares(scene):
    target, middle = painted(0.2, 0.1) + scene[::-1], MIDDLES[:1]
    found, _, _ = patch_shifts(scene, target, middle, grid(middle), HALF, 50)
    template = plainly(scene, grid(middle)[0])
    shift = np.zeros(2)
    for _ in range(50):
        at = grid(middle)[0] + shift
        value = plainly(target, at)
        slopes = [
            (plainly(target, at + e) - plainly(target, at - e)) / 2e-5 for e in 1e-5 * np.eye(2)
        ]
        design = np.column_stack([template, np.ones_like(value), *slopes])
        shift -= np.linalg.lstsq(design, value, rcond=None)[0][2:]
    assert found[0] == pytest.approx(shift, abs=2e-3)


def test_nothing_is_claimed_of_flat_ground_of_edges_and_beyond_the_image(scene):
    flat = np.zeros_like(scene)
    edge = np.tile(np.tanh((np.arange(160) - 80) / 2.0).astype(np.float32), (120, 1))
    for image, middle in ((flat, (80.0, 60.0)), (edge, (80.0, 60.0)), (scene, (3.0, 60.0))):
        middles = np.array([middle])
        found, agreement, _ = patch_shifts(image, image, middles, grid(middles), HALF, 20)
        assert np.isnan(found).all()
        assert np.isnan(agreement).all()
    holed = scene.copy()
    holed[60, 80] = np.nan
    found, _, _ = patch_shifts(scene, holed, MIDDLES[1:2], grid(MIDDLES[1:2]), HALF, 20)
    assert np.isnan(found).all()


@pytest.mark.parametrize("noise", [0.02, 0.08])
def test_what_is_said_of_the_shift_is_how_it_scatters(scene, noise):
    rng = np.random.default_rng(3)
    target = painted(0.3, -0.2)
    sigma = noise * float(scene.std())
    found, said = [], []
    for _ in range(60):
        noisy = (target + sigma * rng.standard_normal(target.shape)).astype(np.float32)
        shifts, _, information = patch_shifts(scene, noisy, MIDDLES, grid(MIDDLES), HALF, 20)
        found.append(shifts)
        said.append(information)
    xx, xy, yy = np.mean(said, axis=0).T
    spread = np.std(found, axis=0)
    expected = np.sqrt(np.column_stack([yy, xx]) / (xx * yy - xy**2)[:, None])
    # Interpolation makes neighbours err together, which no patch sees: a factor common to all.
    assert 1.0 < np.mean(spread / expected) < 1.6
    # Sixty draws know a spread to a tenth.
    assert np.ptp(np.log(spread / expected)) < np.log(1.5)
