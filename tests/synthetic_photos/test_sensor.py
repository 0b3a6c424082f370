"""Noise, levels and colour of the sensor, measured as a lab would measure them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from workbench.synthetic.photo_options import PhotoOptions, SensorOptions
from workbench.synthetic.sensor import COLOR_MATRIX_D65, XYZ_FROM_REC709, Sensor

ISO = 200
QUANTIZATION_VARIANCE = 1 / 12


def sensor_of(**options: float | str) -> Sensor:
    return Sensor.from_options(SensorOptions.model_validate(options), ISO, 5600.0, seed=3)


def frames(sensor: Sensor, level: float, count: int = 2, side: int = 256) -> np.ndarray:
    light = np.full((side, side, 3), level)
    rngs = (np.random.default_rng([int(1e6 * level), k]) for k in range(count))
    return np.array([sensor.exposed(light, 0, 1 / 250, rng) for rng in rngs], float)


def test_photon_transfer_curve_recovers_gain_and_read_noise() -> None:
    sensor = sensor_of(read_noise_e=12.0, prnu=0.01)
    means, variances = [], []
    for level in np.linspace(0.02, 0.5, 16):
        a, b = frames(sensor, level, side=384)
        for channel in range(3):
            seen = sensor.mosaic_channel(0, *a.shape) == channel
            means.append(0.5 * (a[seen].mean() + b[seen].mean()) - sensor.options.black_level)
            # The difference of two frames is free of the fixed pattern.
            variances.append(0.5 * (a - b)[seen].var())
    weight = 1 / np.array(variances)
    slope, _ = np.polyfit(means, variances, 1, w=weight)
    assert 1 / slope == pytest.approx(sensor.gain_e_per_dn, rel=0.02)
    assert sensor.gain_e_per_dn == pytest.approx(58000 * 100 / ISO / (15892 - 600))

    a, b = frames(sensor, 0.0, side=512)
    read_dn = np.sqrt(0.5 * (a - b).var() - QUANTIZATION_VARIANCE)
    assert read_dn * sensor.gain_e_per_dn == pytest.approx(12.0, rel=0.02)


def test_fixed_pattern_has_the_spread_asked_for_and_stays() -> None:
    sensor = sensor_of(prnu=0.02)
    light = np.full((128, 128, 3), 0.5)
    many = [sensor.exposed(light, 0, 0, np.random.default_rng(k)) - 600.0 for k in range(60)]
    mean = np.mean(many, axis=0)
    green = sensor.mosaic_channel(0, 128, 128) == 1
    shot = 1 / np.sqrt(60 * 0.5 * sensor.full_scale_e)
    relative = mean[green] / mean[green].mean()
    assert np.sqrt(relative.var() - shot**2) == pytest.approx(0.02, rel=0.05)
    part = sensor.exposed(light[:10], 70, 0, np.random.default_rng(0))
    whole = sensor_of(prnu=0.02)._sensitivity(0, 128, 128)[70:80]
    np.testing.assert_array_equal(whole, sensor._sensitivity(70, 10, 128))
    assert part.shape == (10, 128)


def test_black_white_and_mosaic_levels() -> None:
    sensor = sensor_of(cfa="GBRG", black_level=700, white_level=15000)
    (dark,) = frames(sensor, 0.0, 1)
    assert dark.mean() == pytest.approx(700, abs=0.05)
    (bright,) = frames(sensor, 3.0, 1)
    assert bright.min() == bright.max() == 15000
    light = np.full((64, 64, 3), 0.3)
    grey = sensor.exposed(light, 0, 0, np.random.default_rng(0)).astype(float) - 700
    expected = 0.3 * sensor.neutral * (15000 - 700)
    for place, channel in (((0, 0), 1), ((0, 1), 2), ((1, 0), 0), ((1, 1), 1)):
        mean = grey[place[0] :: 2, place[1] :: 2].mean()
        assert mean == pytest.approx(expected[channel], rel=0.005)


def test_an_odd_strip_continues_the_mosaic() -> None:
    sensor = sensor_of(cfa="RGGB")
    whole = sensor.mosaic_channel(0, 7, 4)
    np.testing.assert_array_equal(sensor.mosaic_channel(3, 4, 4), whole[3:])
    assert whole[:2, :2].tolist() == [[0, 1], [1, 2]]


def test_colour_goes_back_through_the_published_matrix() -> None:
    sensor = sensor_of(response_deviation=0.0, neutral_deviation=0.0)
    published = COLOR_MATRIX_D65 @ XYZ_FROM_REC709
    published /= published.sum(axis=1, keepdims=True)
    rgb = np.random.default_rng(0).uniform(0, 1, (20, 3))
    camera = rgb @ sensor.camera_from_scene.T
    told = sensor.as_shot_neutral / sensor.as_shot_neutral[1]
    np.testing.assert_allclose(camera / told @ np.linalg.inv(published).T, rgb, atol=1e-12)


def test_a_body_strays_from_its_published_response_by_what_is_asked() -> None:
    exact = sensor_of(response_deviation=0.0, neutral_deviation=0.0)
    body = sensor_of(response_deviation=0.05, neutral_deviation=0.05)
    np.testing.assert_allclose(body.camera_from_scene @ np.ones(3), exact.neutral)
    strays = body.camera_from_scene / exact.camera_from_scene - 1
    assert 0.01 < np.abs(strays).max() < 0.4
    told = body.as_shot_neutral / body.as_shot_neutral[1]
    assert 0.005 < np.abs(told / exact.neutral - 1).max() < 0.2


def test_the_neutral_follows_the_colour_temperature() -> None:
    warm = Sensor.from_options(SensorOptions(neutral_deviation=0.0), 100, 3200.0, 0).neutral
    cold = Sensor.from_options(SensorOptions(neutral_deviation=0.0), 100, 7500.0, 0).neutral
    assert warm[0] / warm[2] > 1.5 * cold[0] / cold[2]


def test_options_refuse_what_no_sensor_has(photo_options: Callable[..., PhotoOptions]) -> None:
    with pytest.raises(ValueError, match="white_level"):
        SensorOptions(black_level=3000, white_level=3000)
    with pytest.raises(ValueError, match="even sides"):
        photo_options(camera={"long_side_px": 241})
    with pytest.raises(ValueError, match="Extra inputs"):
        photo_options(flash={"brightness": 3})
