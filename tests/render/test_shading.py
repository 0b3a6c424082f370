from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from workbench.geometry.mesh import TriangleMesh
from workbench.render import palette, shading
from workbench.render.camera import orbit_camera
from workbench.render.palette import ColorScale
from workbench.render.raycast import render_buffers
from workbench.render.shading import View


def is_orange(picture: np.ndarray) -> np.ndarray:
    red, green, blue = (picture[..., k].astype(int) for k in range(3))
    return (red - blue > 60) & (red > green)


@pytest.fixture(scope="module")
def half_infilled(sphere) -> TriangleMesh:
    mesh = sphere(subdivisions=4)
    return mesh.with_attributes(provenance=(mesh.vertices[:, 0] > 0.3).astype(np.uint8))


def test_infilled_surface_is_orange_and_measured_surface_is_not(half_infilled):
    camera = orbit_camera(half_infilled.vertices, 0, 0, 160, 160)
    picture = shading.provenance(View.of(half_infilled, camera))
    assert picture.shape == (160, 160, 3)
    assert picture.dtype == np.uint8
    at_infilled, at_measured = (
        camera.project(np.array([[x, -np.sqrt(1 - x * x), 0.0]])).astype(int)[0]
        for x in (0.45, 0.15)
    )
    orange = is_orange(picture)
    assert orange[at_infilled[1], at_infilled[0]]
    assert not orange[at_measured[1], at_measured[0]]
    hit = render_buffers(half_infilled, camera).hit
    # Seen from −y, x > 0.3 covers the share of a disc beyond 0.3 of its radius.
    beyond = (np.arccos(0.3) - 0.3 * np.sqrt(1 - 0.09)) / np.pi
    assert orange.sum() / hit.sum() == pytest.approx(beyond, abs=0.04)


def test_nothing_is_orange_where_all_was_measured(half_infilled):
    measured = half_infilled.with_attributes(
        provenance=np.zeros(len(half_infilled.vertices), np.uint8)
    )
    camera = orbit_camera(measured.vertices, 200, 10, 90, 90)
    assert not is_orange(shading.provenance(View.of(measured, camera, ambient_rays=4))).any()


def test_the_upper_left_is_lit_brighter_than_the_lower_right(sphere):
    mesh = sphere(subdivisions=4)
    picture = shading.lit(View.of(mesh, orbit_camera(mesh.vertices, 0, 0, 120, 120))).astype(float)
    assert picture[40, 40].mean() > picture[80, 80].mean() + 30


def test_a_hollow_is_darker_with_ambient_rays():
    """The bottom of a narrow shaft sees little sky; the plain round it sees all of it."""
    outer = [[-3, -3, 0], [3, -3, 0], [3, 3, 0], [-3, 3, 0]]
    rim = [[-0.5, -0.5, 0], [0.5, -0.5, 0], [0.5, 0.5, 0], [-0.5, 0.5, 0]]
    floor = [[x, y, -1] for x, y, _ in rim]
    quads = [(k, (k + 1) % 4, 4 + (k + 1) % 4, 4 + k) for k in range(4)]
    quads += [(4 + k, 4 + (k + 1) % 4, 8 + (k + 1) % 4, 8 + k) for k in range(4)]
    quads += [(8, 9, 10, 11)]
    triangles = [[(a, b, c), (a, c, d)] for a, b, c, d in quads]
    mesh = TriangleMesh(
        np.array([*outer, *rim, *floor], float), np.array(triangles, np.int32).reshape(-1, 3)
    )
    camera = orbit_camera(mesh.vertices, 0, 90, 120, 120)
    plain = shading.lit(View.of(mesh, camera)).astype(float).mean(axis=2)
    soft = shading.lit(View.of(mesh, camera, ambient_rays=16)).astype(float).mean(axis=2)
    assert plain[60, 60] == pytest.approx(plain[60, 25], abs=2)
    assert soft[60, 25] == pytest.approx(plain[60, 25], abs=6)
    assert soft[60, 60] < soft[60, 25] - 25


def test_edges_of_the_silhouette_are_smoothed(sphere):
    mesh = sphere(subdivisions=4)
    picture = shading.lit(
        View.of(mesh, orbit_camera(mesh.vertices, 0, 0, 64, 64)), albedo=(0, 0, 0)
    )
    column = picture[:, 20, 0].astype(int)
    mixed = (column > 20) & (column < 180)  # neither the black object nor the background
    assert mixed.any()


def test_vertex_colours_come_through_the_shading(sphere):
    mesh = sphere(subdivisions=4)
    colors = np.where(mesh.vertices[:, 2:] > 0, [[200, 30, 30]], [[30, 30, 200]]).astype(np.uint8)
    camera = orbit_camera(mesh.vertices, 0, 0, 100, 100)
    picture = shading.vertex_colored(View.of(mesh.with_attributes(color=colors), camera)).astype(
        int
    )
    assert picture[30, 50, 0] > picture[30, 50, 2] + 80
    assert picture[70, 50, 2] > picture[70, 50, 0] + 60


def test_deviation_is_blue_below_red_above_grey_where_unknown(sphere):
    mesh = sphere(subdivisions=4)
    scale = ColorScale.diverging(0.5, "Deviation (mm)")
    x = mesh.vertices[:, 0]
    values = np.where(np.abs(x) < 0.2, np.nan, x)
    camera = orbit_camera(mesh.vertices, 0, 0, 100, 100)
    picture = shading.scalar(View.of(mesh, camera), values, scale).astype(int)
    assert picture[50, 25, 2] > picture[50, 25, 0] + 60
    assert picture[50, 75, 0] > picture[50, 75, 2] + 60
    assert np.ptp(picture[50, 50]) < 12


def test_a_scale_is_symmetric_and_saturates():
    scale = ColorScale.diverging(2.0, "mm")
    colors = scale.colors([-9, -2, 0, 2, 9, np.nan])
    assert np.array_equal(colors[0], colors[1])
    assert np.array_equal(colors[3], colors[4])
    assert colors[2].min() > 240
    assert tuple(colors[5]) == palette.UNKNOWN_COLOR


def test_the_inside_of_an_open_surface_is_darker(sphere):
    whole = sphere(subdivisions=4)
    centers = whole.vertices[whole.triangles].mean(axis=1)
    bowl = whole.keep_triangles(centers[:, 1] > 0)
    cameras = [orbit_camera(whole.vertices, azimuth, 0, 80, 80) for azimuth in (0, 180)]
    inside, outside = (
        shading.lit(View.of(bowl, camera))[40, 40].astype(int).sum() for camera in cameras
    )
    assert inside < 0.85 * outside


def test_the_same_picture_gives_the_same_png(sphere):
    mesh = sphere(subdivisions=3)
    camera = orbit_camera(mesh.vertices, 10, 10, 50, 70)
    first, second = (
        shading.png_bytes(shading.lit(View.of(mesh, camera, ambient_rays=8))) for _ in range(2)
    )
    assert first == second
    assert np.asarray(Image.open(io.BytesIO(first))).shape == (70, 50, 3)


def test_srgb_codes_survive_the_way_to_linear_light_and_back():
    codes = np.arange(256, dtype=np.uint8)
    back = palette.srgb_from_linear(palette.linear_from_srgb(codes)).astype(int)
    assert np.abs(back[8:] - codes[8:]).max() <= 1


def test_a_colour_bar_has_the_size_asked_for_and_both_ends():
    bar = shading.color_bar(ColorScale.diverging(0.3, "Deviation (mm)"), 400, 64)
    assert bar.shape == (64, 400, 3)
    row = bar[12].astype(int)
    assert (row[:, 2] > row[:, 0] + 60).any()
    assert (row[:, 0] > row[:, 2] + 60).any()
