"""Vignetting from frames whose light is known."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.photos.vignetting import FlatFrame, Vignetting, fitted_vignetting, flat_frame

HEIGHT, WIDTH, FOCAL = 400, 600, 800.0
TRUE = Vignetting((-0.3, -0.05, 0.02), 0.0)


def _frame(*, flash: tuple[float, float] | None = None, noise: float = 0.003) -> FlatFrame:
    light = 0.6 * TRUE.relative_light(HEIGHT, WIDTH).astype(float)
    if flash is not None:
        # A plane at distance 1, the flash beside the lens: cos i / r².
        x = (np.arange(WIDTH) + 0.5 - 0.5 * WIDTH)[None, :] / FOCAL - flash[0]
        y = (np.arange(HEIGHT) + 0.5 - 0.5 * HEIGHT)[:, None] / FOCAL - flash[1]
        light = light * (1 + x**2 + y**2) ** -1.5
    rng = np.random.default_rng(6)
    values = np.repeat(light[..., None], 3, axis=2) * (1 + noise * rng.standard_normal((1, 1, 3)))
    values = values + noise * rng.standard_normal(values.shape)
    return flat_frame(values.astype(np.float32), np.full((HEIGHT, WIDTH), 255, np.uint8))


def _worst(found: Vignetting) -> float:
    light = found.relative_light(HEIGHT, WIDTH) / TRUE.relative_light(HEIGHT, WIDTH)
    return float(np.abs(light - 1).max())


def test_even_light_gives_the_lens() -> None:
    found = fitted_vignetting(_frame(), None, flash_fired=False)
    assert isinstance(found, Vignetting)
    assert _worst(found) < 0.004
    assert found.corner == pytest.approx(TRUE.corner, abs=0.004)


def test_a_flash_beside_the_lens_is_told_from_the_lens() -> None:
    frame = _frame(flash=(-0.07, 0.02))
    found = fitted_vignetting(frame, FOCAL, flash_fired=True)
    assert isinstance(found, Vignetting)
    assert _worst(found) < 0.006
    assert found.flash_offset == pytest.approx((-0.07, 0.02), abs=0.004)
    blind = fitted_vignetting(frame, None, flash_fired=False)
    assert not blind or _worst(blind) > 0.05, "taking the flash for even light costs much"


def test_places_and_pixels_agree() -> None:
    light = TRUE.relative_light(HEIGHT, WIDTH)
    places = np.array([[0.5, 0.5], [300.5, 200.5], [599.5, 10.5]])
    seen = [light[int(y), int(x)] for x, y in places]
    np.testing.assert_allclose(TRUE.at(places, HEIGHT, WIDTH), seen, atol=1e-6)
    assert TRUE.relative_light(2, 2).shape == (2, 2)


def test_refusals_say_why() -> None:
    dark, clipped, uneven = _frame(), _frame(), _frame()
    dark = FlatFrame(0.01 * dark.levels, 0.0, HEIGHT, WIDTH)
    clipped = FlatFrame(clipped.levels, 0.2, HEIGHT, WIDTH)
    fold = uneven.levels.copy()
    fold[:, :9] *= 0.7
    for frame, focal, fired, word in (
        (dark, FOCAL, True, "dark"),
        (clipped, FOCAL, True, "clipped"),
        (_frame(), None, True, "focal length"),
        (FlatFrame(fold, 0.0, HEIGHT, WIDTH), FOCAL, False, "uneven"),
    ):
        found = fitted_vignetting(frame, focal, flash_fired=fired)
        assert not found
        assert not isinstance(found, Vignetting)
        assert word in found.reason
