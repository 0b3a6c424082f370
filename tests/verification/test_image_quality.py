from __future__ import annotations

import cv2
import numpy as np
import pytest

from workbench.errors import InputError
from workbench.verification.image_quality import color_steps, psnr, sharpness, ssim


def grain(shape=(60, 70, 3), seed=0):
    return np.random.default_rng(seed).random(shape)


def test_psnr_is_that_of_the_injected_noise_inside_the_mask():
    truth = grain()
    noise = np.random.default_rng(1).normal(0, 0.02, truth.shape)
    mask = np.zeros((60, 70), bool)
    mask[10:50, 10:60] = True
    picture = truth + noise
    picture[~mask] = 99.0
    assert psnr(picture, truth, mask) == pytest.approx(-20 * np.log10(0.02), abs=0.15)
    assert psnr(truth, truth, mask) == np.inf


def test_ssim_looks_at_the_mask_alone_and_falls_with_noise():
    truth = cv2.GaussianBlur(grain(), (0, 0), 2)
    mask = np.zeros((60, 70), bool)
    mask[10:50, 10:60] = True
    beside = truth.copy()
    beside[~mask] = 0.0
    assert ssim(beside, truth, mask) == pytest.approx(1.0)
    values = [ssim(truth + s * (grain(seed=3) - 0.5), truth, mask) for s in (0.02, 0.1, 0.5)]
    assert 1 > values[0] > values[1] > values[2]


def test_ssim_is_wangs_formula():
    """One window, by hand, with the constants 0.01² and 0.03² and unbiased covariances."""
    one, other = grain((7, 7, 3), 1), grain((7, 7, 3), 2)
    expected = []
    for k in range(3):
        a, b = one[..., k].ravel(), other[..., k].ravel()
        c = np.cov(a, b)
        upper = (2 * a.mean() * b.mean() + 1e-4) * (2 * c[0, 1] + 9e-4)
        lower = (a.mean() ** 2 + b.mean() ** 2 + 1e-4) * (c[0, 0] + c[1, 1] + 9e-4)
        expected.append(upper / lower)
    # With nothing around, the window is the picture's middle.
    wide = [np.pad(each, ((3, 3), (3, 3), (0, 0))) for each in (one, other)]
    mask = np.zeros((13, 13), bool)
    mask[3:10, 3:10] = True
    assert ssim(wide[0], wide[1], mask) == pytest.approx(np.mean(expected), abs=1e-9)


def test_sharpness_falls_with_blur_and_is_the_slope_squared():
    y, x = np.mgrid[:30, :40]
    slope = np.repeat((x * 2 + y)[..., None] / 255, 3, axis=2)
    mask = np.ones((30, 40), bool)
    assert sharpness(slope, mask) == pytest.approx(5.0)
    picture = grain()
    whole = np.ones((60, 70), bool)
    blurred = [sharpness(cv2.GaussianBlur(picture, (0, 0), s), whole) for s in (0.5, 1, 2)]
    assert sharpness(picture, whole) > blurred[0] > blurred[1] > blurred[2]


def test_steps_of_colour_at_borders_of_labels():
    label = np.zeros((4, 6), np.int32)
    label[:, 3:] = 1
    color = np.where(label[..., None] == 1, 0.6, 0.5) * np.ones(3)
    color[:, :3, 0] += 0.03 * (np.arange(4) % 2)[:, None]
    depth = np.ones((4, 6), np.float32)
    depth[3, 3:] = 2.0
    steps = color_steps(color, label, depth, 0.1)
    # Rows 0 and 2: 0.1 in all channels; row 1: 0.07 in one; row 3 does not hang together.
    assert steps.pairs == 3
    assert steps.across == pytest.approx(255 * (0.1 + 0.1 + 0.09) / 3)
    assert steps.within == pytest.approx(255 * 0.01 * 9 / (16 + 15))
    depth[:, 3:] = np.inf
    alone = color_steps(color, label, depth, 0.1)
    assert np.isnan(alone.across)
    assert alone.pairs == 0


def test_what_cannot_be_compared_says_so():
    picture = grain()
    with pytest.raises(InputError, match="no pixel"):
        psnr(picture, picture, np.zeros((60, 70), bool))
    thin = np.zeros((60, 70), bool)
    thin[20] = True
    with pytest.raises(InputError, match="no pixel"):
        ssim(picture, picture, thin)
    with pytest.raises(InputError, match="one size"):
        psnr(picture, picture[:50], np.ones((60, 70), bool))
