"""COLMAP as the matcher: what it is given, and what is made of what it leaves."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap
import pytest

from tests.stereo.ball_card import write_true_maps
from tests.stereo.scenes import ball, plane, seen
from workbench.errors import InputError
from workbench.stereo import colmap_stereo
from workbench.stereo.colmap_stereo import colmap_planes, planes_of, read_map, why_not_colmap
from workbench.stereo.matching import MatchingSettings, judged
from workbench.stereo.views import StereoView

PLACES = {"a": (0.0, 0.0, 5.0), "b": (1.2, 0.0, 4.9), "c": (-1.2, 0.2, 4.9)}
PAIRS = {"a": ["b", "c"], "b": ["a", "c"], "c": ["a"]}
SPAN = (3.0, 7.0)


def views_of(body: Any) -> dict[str, tuple[StereoView, np.ndarray]]:
    return {name: seen(body, place) for name, place in PLACES.items()}


@pytest.fixture
def card(monkeypatch: pytest.MonkeyPatch) -> list[Path]:
    """A card that knows the ball: writes its true depths; the folders it was given."""
    given: list[Path] = []
    shown = views_of(ball)

    def match(folder: str, options: Any) -> None:
        root = Path(folder)
        given.append(root)
        assert (options.depth_min, options.depth_max) == SPAN
        write_true_maps(root, {f"{name}.png": view for name, view in shown.items()})

    monkeypatch.setattr(pycolmap, "patch_match_stereo", match)
    return given


def test_colmap_reads_what_it_is_given(tmp_path, card):
    shown = views_of(ball)
    colmap_planes(tmp_path, list(PLACES), lambda name: shown[name][0], PAIRS, SPAN)
    (root,) = card
    model = pycolmap.Reconstruction(str(root / "sparse"))
    assert {image.name for image in model.images.values()} == {"a.png", "b.png", "c.png"}
    rng = np.random.default_rng(0)
    for image in model.images.values():
        view = shown[image.name[0]][0]
        point = 0.4 * rng.normal(size=3)
        pixel, _ = view.project(point[None])
        # COLMAP's pixels begin at the corner, ours at the middle of the first.
        np.testing.assert_allclose(image.project_point(point), pixel[0] + 0.5, atol=1e-6)
        picture = cv2.imread(str(root / "images" / image.name), cv2.IMREAD_GRAYSCALE)
        assert np.abs(picture - view.grey.clip(0.0, 255.0)).max() <= 0.51
    lines = (root / "stereo" / "patch-match.cfg").read_text().splitlines()
    assert lines == ["a.png", "b.png, c.png", "b.png", "a.png, c.png", "c.png", "a.png"]


def test_its_depths_and_normals_become_planes_that_fit_the_pictures(tmp_path, card):
    shown = views_of(ball)
    planes = colmap_planes(tmp_path, list(PLACES), lambda name: shown[name][0], PAIRS, SPAN)
    view, depth = shown["a"]
    found = planes("a")
    met = np.isfinite(depth)
    np.testing.assert_allclose(1.0 / found[met, 0], depth[met], rtol=1e-5)
    # Along the plane of a pixel the depth next to it is met, but for the ball's bend.
    inner = met[:, :-1] & met[:, 1:] & (depth[:, :-1] < 4.3)
    beside = found[:, :-1, 0] + found[:, :-1, 1]
    np.testing.assert_allclose(beside[inner], found[:, 1:, 0][inner], rtol=1e-3)
    others = [shown[name][0] for name in PAIRS["a"]]
    estimate = judged(view, others, found, SPAN, MatchingSettings())
    # The middle of the ball, which both others see.
    middle = depth < 4.15
    assert np.median(estimate.cost[middle]) < 0.1
    assert np.isfinite(estimate.sigma[middle]).mean() > 0.95
    assert (estimate.cost[~met] == 2.0).all()
    assert np.isinf(estimate.sigma[~met]).all()
    off = judged(view, others, found * np.float32(1.06), SPAN, MatchingSettings())
    assert np.median(off.cost[middle]) > 0.5


def test_planes_of_a_tilted_plane_are_one_plane():
    view, depth = seen(plane, (0.0, 0.0, 5.0))
    normal = view.camera_from_world[:3, :3] @ np.array([-0.3, 0.0, 1.0])
    found = planes_of(
        depth.astype(np.float32), np.broadcast_to(normal, (*depth.shape, 3)), view.lens
    )
    assert np.ptp(found[..., 1]) < 1e-6
    assert np.ptp(found[..., 2]) < 1e-6
    rows, columns = np.indices(depth.shape)
    flat = found[0, 0, 0] + found[0, 0, 1] * columns + found[0, 0, 2] * rows
    np.testing.assert_allclose(flat, found[..., 0], rtol=1e-4)


@pytest.mark.parametrize(
    ("data", "said"),
    [(None, "left no map"), (b"3&2&1&" + bytes(20), "not of its"), (b"2&3&1&" + bytes(24), "size")],
)
def test_maps_of_another_size_are_refused(tmp_path, data, said):
    path = tmp_path / "x.bin"
    if data is not None:
        path.write_bytes(data)
    with pytest.raises(InputError, match=said) as caught:
        read_map(path, (2, 3), 1)
    assert caught.value.file == str(path)
    assert "densify.matcher=own" in caught.value.fix


def test_failing_says_what_to_do(tmp_path, monkeypatch):
    def fail(*_: Any, **__: Any) -> None:
        raise RuntimeError("CUDA driver version is insufficient")

    monkeypatch.setattr(pycolmap, "patch_match_stereo", fail)
    shown = views_of(ball)
    with pytest.raises(InputError, match="failed") as caught:
        colmap_planes(tmp_path, list(PLACES), lambda name: shown[name][0], PAIRS, SPAN)
    assert "insufficient" in caught.value.found
    assert "densify.matcher=own" in caught.value.fix


def test_why_colmap_is_left_out(monkeypatch):
    monkeypatch.setattr(pycolmap, "has_cuda", False)
    assert why_not_colmap() == "this pycolmap is built without CUDA"
    monkeypatch.setattr(pycolmap, "has_cuda", True)
    monkeypatch.setattr(colmap_stereo, "_CARDS", "/nowhere/card[0-9]*")
    assert why_not_colmap() == "there is no NVIDIA card"
    monkeypatch.setattr(colmap_stereo, "_CARDS", "/dev/nul[l]")
    assert why_not_colmap() is None
