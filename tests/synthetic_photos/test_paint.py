"""The paint has what later stages need to be tested with: hues, busy and calm areas, detail."""

from __future__ import annotations

import colorsys
import itertools
from collections.abc import Callable

import numpy as np
import pytest

from workbench.synthetic import OBJECT, SUPPORT, Scene
from workbench.synthetic.albedo import SURROUNDINGS, WeatheredPaint
from workbench.synthetic.photo_options import PhotoOptions, SurfaceOptions
from workbench.synthetic.photography import photograph


@pytest.fixture(scope="module")
def paint(ball_scene: Scene) -> WeatheredPaint:
    return WeatheredPaint.of(ball_scene, SurfaceOptions(), seed=1)


def on_figure(count: int) -> np.ndarray:
    rng = np.random.default_rng(0)
    turn = rng.uniform(0, 2 * np.pi, count)
    return np.column_stack(
        [0.18 * np.sin(turn), 0.15 * np.cos(turn), rng.uniform(0.0, 1.15, count)]
    )


def hues(albedo: np.ndarray) -> np.ndarray:
    return np.array([colorsys.rgb_to_hsv(*rgb) for rgb in albedo.astype(float)])


def test_albedo_is_physical_and_the_same_again(paint: WeatheredPaint) -> None:
    points = on_figure(20000)
    material = np.full(len(points), OBJECT, np.uint8)
    look = paint.at(points, material)
    assert look.albedo.min() > 0.0
    assert look.albedo.max() < 1.0
    np.testing.assert_array_equal(look.albedo, paint.at(points, material).albedo)
    backwards = paint.at(points[::-1].copy(), material).albedo[::-1]
    np.testing.assert_array_equal(look.albedo, backwards)


def test_the_statue_is_colourful_and_its_support_is_not(paint: WeatheredPaint) -> None:
    points = on_figure(6000)
    statue = hues(paint.at(points, np.full(len(points), OBJECT, np.uint8)).albedo)
    metal = hues(paint.at(points, np.full(len(points), SUPPORT, np.uint8)).albedo)
    colourful = statue[statue[:, 1] > 0.25]
    filled = np.histogram(colourful[:, 0], bins=12, range=(0, 1))[0] > 0.005 * len(colourful)
    assert filled.sum() >= 4
    assert np.ptp(metal[:, 0]) < 0.05
    assert metal[:, 2].max() < 0.15
    assert 0.55 < metal[:, 0].mean() < 0.68


def test_worn_paint_shows_the_stone(ball_scene: Scene, paint: WeatheredPaint) -> None:
    points = on_figure(8000)
    points = points[points[:, 2] > 0.2]
    material = np.full(len(points), OBJECT, np.uint8)
    bare = WeatheredPaint.of(ball_scene, SurfaceOptions(paint="stone"), seed=1)
    same = np.abs(paint.at(points, material).albedo - bare.at(points, material).albedo).max(axis=1)
    worn = (same < 1e-6).mean()
    assert 0.1 < worn < 0.7


def test_detail_at_several_scales_and_calm_areas(paint: WeatheredPaint) -> None:
    rng = np.random.default_rng(2)
    points = on_figure(4000)
    way = rng.standard_normal(points.shape)
    way /= np.linalg.norm(way, axis=1, keepdims=True)
    material = np.full(len(points), OBJECT, np.uint8)
    here = np.log(paint.at(points, material).albedo[:, 1])

    def change(step: float) -> np.ndarray:
        return np.abs(np.log(paint.at(points + step * way, material).albedo[:, 1]) - here)

    steps = [change(step).mean() for step in (0.0005, 0.002, 0.01, 0.05)]
    assert steps[0] > 0.02
    assert all(later > 1.1 * earlier for earlier, later in itertools.pairwise(steps))
    local = np.median([change(0.001 * k) for k in range(1, 8)], axis=0)
    assert np.quantile(local, 0.9) > 3 * np.quantile(local, 0.1)


def test_varnish_lies_on_some_of_the_paint(paint: WeatheredPaint) -> None:
    points = on_figure(8000)
    look = paint.at(points, np.full(len(points), OBJECT, np.uint8))
    shiny = look.gloss > 0.8
    assert 0.05 < shiny.mean() < 0.7
    assert look.roughness[shiny].max() < 0.3
    assert look.roughness[~shiny].max() >= 0.55


@pytest.mark.parametrize("kind", [SUPPORT, SURROUNDINGS])
def test_other_materials_ignore_the_statue(paint: WeatheredPaint, kind: int) -> None:
    points = on_figure(100)
    look = paint.at(points, np.full(100, kind, np.uint8))
    assert look.albedo.max() < 0.2


def test_highlights_exist_and_saturate_nothing_else(
    photo_options: Callable[..., PhotoOptions], ball_scene: Scene
) -> None:
    glossy = photograph(ball_scene, photo_options(), 0)
    matt = photograph(ball_scene, photo_options(surface={"varnish": 0.0}), 0)
    assert glossy.specular is not None
    assert matt.specular is not None
    assert glossy.specular.max() > 0.05
    assert matt.specular.max() == 0.0
    np.testing.assert_array_equal(glossy.albedo, matt.albedo)
