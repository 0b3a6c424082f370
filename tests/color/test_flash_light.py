"""The light of a flash by hand, its limits, and how far samples are trusted."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.color.flash_scene import rough_reflection
from workbench.color.flash_light import (
    FlashLight,
    albedo,
    anchored,
    falloff_terms,
    incidence_trust,
    trust,
    value_trust,
)
from workbench.errors import InputError

FACING = np.array([[0.0, 0.0, -1.0]])
LENS = np.zeros(3)


def at(*place: float) -> np.ndarray:
    return np.array([place])


def turned(degrees: float) -> np.ndarray:
    angle = np.radians(degrees)
    return np.array([[np.sin(angle), 0.0, -np.cos(angle)]])


def unit(ways: np.ndarray) -> np.ndarray:
    return ways / np.linalg.norm(ways, axis=1, keepdims=True)


def test_a_facing_surface_at_the_reference_distance_receives_one() -> None:
    for epsilon in (0.0, 0.1, 1.0):
        light = FlashLight(np.array([0.3, 0.0, 0.0]), reference_distance=2.0, epsilon=epsilon)
        np.testing.assert_allclose(light.received(at(0.3, 0.0, 2.0), FACING), 1.0)
        np.testing.assert_allclose(light.received(at(0.3, 0.0, 6.0), FACING), 1 / 9)


@pytest.mark.parametrize("degrees", [0.0, 30.0, 60.0, 85.0, 89.9, 90.0, 120.0])
def test_incidence_follows_the_published_formula(degrees: float) -> None:
    cosine = max(np.cos(np.radians(degrees)), 0.0)
    light = FlashLight(LENS, reference_distance=1.5)
    expected = (1.5 / 2.0) ** 2 * (0.1 + 0.9 * cosine)
    np.testing.assert_allclose(light.received(at(0, 0, 2), turned(degrees)), expected, rtol=1e-12)
    signed = light.incidence(at(0, 0, 2), turned(degrees))
    np.testing.assert_allclose(signed, np.cos(np.radians(degrees)), atol=1e-15)


def test_rough_surfaces_follow_oren_and_nayar_with_angles() -> None:
    rng = np.random.default_rng(1)
    places = rng.uniform(-1, 1, (5000, 3)) + np.array([0, 0, 2.5])
    normals = unit(rng.standard_normal((5000, 3)))
    flash = np.array([-0.4, -0.2, 0.1])
    ways = unit(flash - places)
    seen = ((normals * unit(-places)).sum(axis=1) > 0.01) & ((normals * ways).sum(axis=1) > 0.01)
    for sigma in (0.1, 0.35, 0.8):
        light = FlashLight(flash, epsilon=0.0, roughness_rad=sigma)
        received = light.received(places, normals)[seen]
        distance = np.linalg.norm(flash - places, axis=1)[seen]
        expected = rough_reflection(normals, ways, unit(-places), sigma)[seen]
        np.testing.assert_allclose(received * distance**2, expected, rtol=1e-6, atol=1e-9)


def test_a_rough_surface_is_brighter_at_grazing_incidence_towards_the_flash() -> None:
    """What Jaspe says of the Lambertian model: it over-shadows at grazing angles."""
    smooth, rough = (FlashLight(LENS, epsilon=0.0, roughness_rad=s) for s in (0.0, 0.5))
    ratio = [
        float(rough.received(at(0, 0, 1), n)[0] / smooth.received(at(0, 0, 1), n)[0])
        for n in (turned(0), turned(70))
    ]
    assert ratio[0] == pytest.approx(1 - 0.5 * 0.25 / 0.58)
    assert ratio[1] > 1.4 * ratio[0]


def test_falloff_and_indirect_light() -> None:
    light = FlashLight(LENS, epsilon=0.0, falloff=(0.2, 0.0, -1.0, 0.0, -0.5))
    place = at(0.6, 0.0, 0.8)
    received = light.received(place, -place)
    np.testing.assert_allclose(received, np.exp(0.2 * 0.6 - 0.36))
    bounced = replace(light, indirect=0.05)
    np.testing.assert_allclose(bounced.received(place, -place), received + 0.05)
    # Far away the flash fades and the room does not.
    assert bounced.received(1e4 * place, -place)[0] == pytest.approx(0.05, rel=1e-5)


def test_terms_of_whole_degrees() -> None:
    direction = np.array([[0.3, -0.2, 0.9]])
    expected = [0.3, -0.2, 0.09, -0.06, 0.04, 0.027, -0.018, 0.012, -0.008]
    np.testing.assert_allclose(falloff_terms(direction, 9)[0], expected, atol=1e-15)
    with pytest.raises(InputError):
        FlashLight(LENS, falloff=(1.0,))


def test_nothing_breaks_at_the_flash_at_grazing_incidence_or_behind() -> None:
    light = FlashLight(np.array([0.0, -0.1, 0.0]), roughness_rad=0.4, falloff=(0.0, 0.0, -1, 0, -1))
    places = np.array([[0, -0.1, 0], [0, -0.1, 1e-300], [0, 0, 0], [0, 0, -3], [0, 0, 1e300]])
    for normal in (turned(0), turned(89.9), turned(90), turned(180), np.zeros((1, 3))):
        normals = np.repeat(normal, len(places), axis=0)
        with np.errstate(over="ignore"):
            received = light.received(places, normals)
            cosine = light.incidence(places, normals)
        assert np.isfinite(received).all()
        assert (received[:4] > 0.0).all()
        assert (np.abs(cosine) <= 1 + 1e-12).all()
    values = np.full((1, 3), 0.5)
    assert trust(light, at(0, 0, 1), turned(180), values) == 0.0
    assert trust(light, at(0, -0.1, 0), turned(0), values) == 0.0
    assert trust(light, at(0, 0, np.nan), turned(0), values) == 0.0


@pytest.mark.parametrize("scale", [1e-6, 1.0, 1e5])
def test_the_unit_of_length_does_not_matter(scale: float) -> None:
    light = FlashLight(np.array([-0.1, 0.05, 0.0]), 1.3, 0.1, 0.2, (0.1, 0.2), 0.01)
    large = replace(
        light,
        position_in_camera=scale * light.position_in_camera,
        reference_distance=scale * light.reference_distance,
    )
    places = np.random.default_rng(0).uniform(-1, 1, (50, 3)) + np.array([0, 0, 2])
    normals = unit(-places + 0.4)
    np.testing.assert_allclose(
        large.received(scale * places, normals), light.received(places, normals), rtol=1e-9
    )


def test_the_albedo_comes_back() -> None:
    rng = np.random.default_rng(0)
    light = FlashLight(np.array([-0.13, -0.03, 0.01]), epsilon=0.1, roughness_rad=0.3)
    places = rng.uniform(-0.5, 0.5, (100, 3)) + np.array([0, 0, 2])
    normals = unit(-places + rng.normal(0, 0.3, (100, 3)))
    paint = rng.uniform(0, 1, (100, 3))
    received = light.received(places, normals)
    np.testing.assert_allclose(albedo(0.7 * received[:, None] * paint, received, 0.7), paint)


def test_an_albedo_without_light_is_unknown_and_a_gain_is_positive() -> None:
    found = albedo(np.ones((3, 3)), np.array([1.0, 0.0, np.nan]), 1.0)
    assert np.isnan(found[1:]).all()
    assert (found[0] == 1.0).all()
    for gain in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError):
            albedo(np.ones((1, 3)), np.ones(1), gain)


def test_white_at_the_chart_is_one() -> None:
    light = FlashLight(np.array([-0.1, 0, 0]), reference_distance=2.0, roughness_rad=0.4)
    middle, normal = np.array([0.2, 0.1, 1.5]), unit(np.array([[0.1, 0.2, -1.0]]))
    gain = anchored(light, middle, normal[0])
    smooth = replace(light, roughness_rad=0.0)
    white = gain * smooth.received(middle[None], normal)
    np.testing.assert_allclose(white, 1.0)
    # A metre further off, half as bright a white: the albedo stays.
    far = middle[None] * 1.7
    value = gain * smooth.received(far, normal)
    np.testing.assert_allclose(albedo(value[:, None], smooth.received(far, normal), gain), 1.0)
    with pytest.raises(InputError, match="chart"):
        anchored(light, middle, -normal[0])


def test_trust_is_smooth_and_nothing_at_the_ends() -> None:
    levels = np.linspace(-0.2, 1.2, 2801)
    weights = value_trust(levels)
    assert (weights[levels <= 0.0] == 0.0).all()
    assert (weights[levels >= 0.98] == 0.0).all()
    assert (weights[(levels > 0.03) & (levels < 0.8)] == 1.0).all()
    assert np.abs(np.diff(weights)).max() < 0.05
    cosines = np.linspace(-1, 1, 2001)
    facing = incidence_trust(cosines)
    assert (facing[cosines <= 0.0] == 0.0).all()
    assert (facing[cosines > np.cos(np.radians(70.0))] == 1.0).all()
    assert np.abs(np.diff(facing)).max() < 0.01
    assert (np.diff(facing) >= 0.0).all()


def test_a_saturated_channel_spoils_a_sample_and_a_dark_one_does_not() -> None:
    colors = np.array([[0.5, 0.0, 0.0], [0.5, 0.5, 1.0], [np.nan, 0.5, 0.5], [0, 0, 0]])
    np.testing.assert_array_equal(value_trust(colors), [1, 0, 0, 0])
    scaled = value_trust(600 + 15000 * colors, black=600.0, full=15600.0)
    np.testing.assert_array_equal(scaled, [1, 0, 0, 0])


@pytest.mark.parametrize(
    "wrong",
    [
        {"position_in_camera": np.array([0, np.nan, 0])},
        {"position_in_camera": np.zeros(2)},
        {"reference_distance": 0.0},
        {"epsilon": 1.5},
        {"roughness_rad": -0.1},
        {"indirect": -1.0},
        {"falloff": (np.inf, 0.0)},
    ],
)
def test_impossible_lights_are_refused(wrong: dict) -> None:
    with pytest.raises(InputError):
        FlashLight(**{"position_in_camera": LENS, **wrong})
