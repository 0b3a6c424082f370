"""Pictures of a project's stitched depth meshes, by the command."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest

from stages.main import PIPELINE
from tests.texturing.scenes import paint, picture, ring
from tests.texturing.test_candidates import maps_of
from workbench.cli import run_cli
from workbench.formats.color_png import read_color_png
from workbench.formats.surface_files import write_surface_ply
from workbench.geometry.surface_rays import SurfaceRays
from workbench.project.creation import create_project
from workbench.texturing.cost_options import CostOptions, far_of_scene
from workbench.texturing.multi_mesh import labelled_depth_mesh

COUNT, HELD_OUT = 8, 3


@pytest.fixture(scope="module")
def project(sphere, tmp_path_factory) -> Path:
    """A painted ball, with all that the stage texture makes of seven photographs round it."""
    folder = tmp_path_factory.mktemp("stitched")
    ball = sphere(subdivisions=5)
    write_surface_ply(folder / "ball.ply", ball)
    store = create_project(folder / "ball", geometry=folder / "ball.ply").store
    cameras = ring(COUNT)
    rays = SurfaceRays(ball)
    used = [k for k in cameras if k != HELD_OUT]
    pictures = {k: picture(rays, cameras[k]) for k in used}
    small = ring(COUNT, size=(96, 72), focal=104.0)
    maps = maps_of(ball, {k: small[k] for k in used})
    given = {k: cameras[k] for k in used}
    costs = CostOptions(far_of_scene(maps.values()))
    names = np.array([f"photo_{k}" for k in used])
    for k, name in zip(used, names, strict=True):
        made = labelled_depth_mesh(k, maps, given, pictures.__getitem__, costs, 2)
        # Stored labels count the photographs that are there.
        arrays = made.arrays()
        place = np.append([used.index(n) if n in used else -1 for n in range(COUNT)], -1)
        arrays["labels"] = place[arrays["labels"]].astype(np.int32)
        store.save("depth_meshes", {**arrays, "photos": names}, str(name))
        store.save("depth_maps", maps[k].arrays(), str(name))
        store.save("texture_photos", pictures[k], str(name))
    poses = {
        f"photo_{k}": {
            "model": camera.model,
            "size": [camera.width, camera.height],
            "params": list(camera.params),
            "camera_from_world": camera.camera_from_world.tolist(),
        }
        for k, camera in cameras.items()
    }
    store.save("photo_poses", {"frame": "world", "photos": poses})
    store.save(
        "texturing",
        {
            "photographs": [str(name) for name in names],
            "held_out": [f"photo_{HELD_OUT}"],
            "far_m": costs.far,
            "image_px": 240,
        },
    )
    return folder / "ball"


@pytest.fixture
def cli(capsys, project):
    """Render the project; returns (exit code, the one JSON object)."""

    def call(*arguments):
        code = run_cli(
            PIPELINE, ["render", str(project), "--mode", "stitch", *map(str, arguments), "--json"]
        )
        return code, json.loads(capsys.readouterr().out)

    return call


def test_a_photograph_held_out_is_seen_as_it_is(cli, tmp_path, sphere):
    out = tmp_path / "a.png"
    code, told = cli("--camera", f"photo:photo_{HELD_OUT}", "--size", "480x400", "--out", out)
    assert code == 0
    assert (told["mode"], told["width"], told["height"]) == ("stitch", 480, 360)
    camera = ring(COUNT)[HELD_OUT]
    expected = picture(SurfaceRays(sphere(subdivisions=5)), camera)
    found = cv2.resize(read_color_png(out), (240, 180), interpolation=cv2.INTER_AREA)
    both = (found[..., 3] == 255) & (expected[..., 3] == 255)
    assert both.sum() > 0.9 * (expected[..., 3] == 255).sum()
    error = np.abs(found[..., :3].astype(int) - expected[..., :3])[both]
    # The paint runs over 200 bytes; other photographs see it a little further off.
    assert error.mean() < 4
    assert (read_color_png(out)[0, 0] == 0).all()


def test_the_ball_is_seen_from_around(cli, tmp_path):
    means = []
    for azimuth in (0, 90):
        out = tmp_path / f"{azimuth}.png"
        code, told = cli(f"--camera={azimuth},10", "--size", "160x160", "--out", out)
        assert code == 0
        assert 0.2 < told["shown"] < 0.6
        image = read_color_png(out)[60:100, 60:100]
        assert (image[..., 3] == 255).all()
        means.append(image[..., :3].reshape(-1, 3).mean(axis=0))
    # At 0 the viewer stands on −y, at 90 on +x; a cap of that size has nearly its middle's paint.
    for mean, direction in zip(means, ([0.0, -1.0, 0.17], [1.0, 0.0, 0.17]), strict=True):
        middle = np.array(direction) / np.linalg.norm(direction)
        assert np.abs(mean - 255 * paint(middle[None])[0]).max() < 30


def test_a_photograph_that_is_not_there_is_told(cli, tmp_path):
    code, told = cli("--camera", "photo:photo_33", "--out", tmp_path / "a.png")
    assert code == 2
    assert "did you mean 'photo_3'" in told["error"]["fix"]
