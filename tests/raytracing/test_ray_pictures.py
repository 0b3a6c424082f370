"""Pictures in the light of rays: known light, and the same whatever is in memory."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest

from tests.raytracing.scenes import sheet, stacked
from workbench.formats.surface_files import write_surface_ply
from workbench.geometry.mesh import TriangleMesh
from workbench.raytracing.frame import LocalFrame
from workbench.raytracing.ray_light import (
    LIGHT_KINDS,
    Fronts,
    LightOptions,
    Places,
    bounced_light,
    open_share,
    sun_light,
)
from workbench.raytracing.surface_source import MeshSource
from workbench.raytracing.whole_rays import WholeRays


def _slab() -> WholeRays:
    """A square of side 2 at height 1 over the places at the origin; the frame is the world's."""
    at = np.array([[-1.0, -1, 1], [1, -1, 1], [1, 1, 1], [-1, 1, 1], [0, 0, -1], [0.01, 0, -1]])
    triangles = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 4]], np.int32)
    caster = WholeRays(MeshSource(TriangleMesh(at, triangles)))
    assert caster.frame == LocalFrame(caster.frame.middle, 1.0)
    assert not caster.frame.middle.any()
    return caster


def _floor(*places) -> Places:
    points = np.array(places, np.float32)
    return Places.on(points, np.tile(np.array([0, 0, 1], np.float32), (len(points), 1)))


def test_a_square_overhead_hides_its_form_factor_of_the_sky():
    caster = _slab()
    options = LightOptions(samples=4096)
    open_ = open_share(caster, _floor((0.0, 0, 0)), options, Fronts())
    # Four parallel rectangles of side 1 at distance 1, seen from a corner: 4 · 0.1385.
    corner = np.arctan(1 / np.sqrt(2)) / np.sqrt(2) / np.pi
    assert abs(open_[0] - (1.0 - 4.0 * corner)) < 0.005
    near = LightOptions(samples=64, reach=0.9)
    assert open_share(caster, _floor((0.0, 0, 0)), near, Fronts())[0] == 1.0


def test_the_sun_is_hidden_by_the_square_and_half_hidden_over_its_edge():
    caster = _slab()
    places = _floor((0.0, 0, 0), (1.5, 0, 0), (1.0, 0.1, 0))
    hard = LightOptions(sun=(0, 0, 1), sun_light=0.8)
    assert np.allclose(sun_light(caster, places, hard, Fronts())[:2], [0.0, 0.8])
    soft = LightOptions(sun=(0, 0, 1), sun_light=0.8, sun_radius_deg=5.0, samples=512)
    light = sun_light(caster, places, soft, Fronts())
    assert light[0] == 0.0
    assert np.isclose(light[1], 0.8)
    assert abs(light[2] - 0.4) < 0.02
    from_below = LightOptions(sun=(0, 0, -1))
    assert not sun_light(caster, places, from_below, Fronts()).any()


def test_what_is_lit_sends_light_on():
    caster = _slab()
    # From below the sun lights the side of the square that the places see.
    options = LightOptions(
        samples=4096, sun=(0, 0, -1), sun_light=0.8, sky_light=0.4, rays_at_once=1000
    )
    place = _floor((0.0, 0, 0))
    hidden = 1.0 - open_share(caster, place, options, Fronts())[0]
    light = bounced_light(caster, place, options, Fronts())[0]
    assert np.allclose(light, 0.4 * (1.0 - hidden) + 0.6 * 0.8 * hidden, atol=1e-3)


@pytest.mark.parametrize("kind", LIGHT_KINDS)
def test_a_picture_is_the_same_with_a_part_of_the_surface_in_memory(cli, tmp_path, kind):
    mesh = stacked(4, 90)
    colors = np.full((len(mesh.vertices), 3), [200, 120, 60], np.uint8)
    write_surface_ply(
        tmp_path / "a.ply", TriangleMesh(mesh.vertices, mesh.triangles, {"color": colors})
    )
    pictures = {}
    for memory in (3, 900):
        out = tmp_path / f"{memory}.png"
        given = ("--mode", kind, "--size", "120x80", "--camera", "33,47,z", "--samples", 4)
        code, told = cli("render", tmp_path / "a.ply", "--out", out, "--memory-mb", memory, *given)
        assert code == 0
        assert told["in_core"] == (memory == 900)
        assert (told["bytes_read"] > 0) == (memory == 3)
        pictures[memory] = cv2.imread(str(out), cv2.IMREAD_UNCHANGED)
    assert np.array_equal(pictures[3], pictures[900])
    shown = pictures[3][..., 3] > 0
    assert 0.1 < shown.mean() < 0.9
    # Four samples leave five shares of the sky.
    assert len(np.unique(pictures[3][shown][:, 1])) >= 5


def test_options_of_rays_belong_to_rays(cli, tmp_path):
    write_surface_ply(tmp_path / "a.ply", sheet(5))
    for said, given in {
        "do not belong": ("--mode", "surface", "--samples", 4),
        "own light": ("--mode", "ambient", "--light", "even"),
        "did you mean 'ambient'": ("--mode", "ambiemt"),
    }.items():
        code, told = cli("render", tmp_path / "a.ply", "--out", tmp_path / "a.png", *given)
        assert code != 0
        assert said in json.dumps(told)
