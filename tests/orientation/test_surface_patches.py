"""Patches followed over a painted body: exact, unbiased, and only where they can be seen."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest

from tests.orientation.blob import body, photographed
from workbench.geometry.robust import robust_sigma
from workbench.geometry.surface_rays import SurfaceRays
from workbench.orientation import surface_patches
from workbench.orientation.bundle import Bundle
from workbench.orientation.surface_patches import PatchOptions, with_surface_patches

OPTIONS = PatchOptions(per_photo=300, apart_px=8.0)


def paint(places: np.ndarray) -> np.ndarray:
    """Solid paint in [0, 1], spots of about a centimetre."""
    rng = np.random.default_rng(7)
    total = np.zeros(len(places))
    for _ in range(40):
        way = rng.normal(size=3)
        way *= 2 * np.pi / rng.uniform(0.012, 0.03) / np.linalg.norm(way)
        total += np.cos(places @ way + rng.uniform(0, 6.28))
    return 0.5 + 0.5 * np.tanh(0.25 * total)


@pytest.fixture(scope="module")
def scene():
    """A body by lamp light that moves with the camera: model, pictures, rays."""
    mesh = body(5)
    model = photographed(mesh, cameras=12)
    model = replace(model, images={n: model.images[n] for n in (1, 2, 3, 4)})
    rays, pictures = SurfaceRays(mesh), {}
    for number, image in model.images.items():
        camera = model.photo_cameras()[image.name.removesuffix(".png")]
        seen = rays.seen_by(camera)
        value = np.zeros(len(seen.points))
        at = seen.points[seen.found]
        towards = camera.center - at
        towards /= np.linalg.norm(towards, axis=1, keepdims=True)
        light = np.abs((seen.normals[seen.found] * towards).sum(axis=1))
        value[seen.found] = (0.2 + 0.6 * paint(at)) * light
        grey = np.round(255 * value).reshape(camera.height, camera.width)
        pictures[number] = cv2.GaussianBlur(grey.astype(np.uint8), (0, 0), 0.7)
    return model, pictures, rays


def test_patches_are_found_to_a_twentieth_of_a_pixel_and_not_too_deep(scene):
    model, pictures, rays = scene
    patched = with_surface_patches(model, pictures, {}, rays, OPTIONS)
    found = patched.model
    assert len(found.points) > 150
    bundle = Bundle.of(found, 10_000)
    apart = bundle.projected() - bundle.pixels
    assert robust_sigma(apart.ravel()) < 0.05
    # Where the observations alone put the points: neither before nor behind the surface.
    system = bundle.linearised(0.05)
    inverse = np.linalg.pinv(system.point_hessian, hermitian=True)
    free = bundle.points - np.einsum("nij,nj->ni", inverse, system.point_gradient)
    near = rays.nearest(free)
    depth = ((free - near.points) * near.normals).sum(axis=1)
    assert abs(np.median(depth)) < 5e-5


def test_a_wrong_camera_is_seen_by_its_patches(scene):
    model, pictures, rays = scene
    pose = model.images[2].camera_from_world.copy()
    pose[0, 3] += 1.5e-3
    off = dict(model.images) | {2: replace(model.images[2], camera_from_world=pose)}
    moved = replace(model, images=off)
    found = with_surface_patches(moved, pictures, {}, rays, OPTIONS).model
    bundle = Bundle.of(found, 10_000)
    apart = bundle.projected() - bundle.pixels
    in_two = bundle.seen_image == 1
    away = np.linalg.norm(apart, axis=1) > 1e-9
    # 1.5 mm at 1.7 m and f = 900 are 0.8 pixels.
    assert np.median(apart[in_two & away, 0]) == pytest.approx(0.8, abs=0.15)


def test_masks_and_reduced_pictures(scene):
    model, pictures, rays = scene
    masks = {n: np.full(p.shape, 255, np.uint8) for n, p in pictures.items()}
    for mask in masks.values():
        mask[:, :400] = 0
    found = with_surface_patches(model, pictures, masks, rays, OPTIONS).model
    pixels = np.concatenate([image.points2d for image in found.images.values()])
    assert len(pixels) > 50
    assert pixels[:, 0].min() > 400
    halves = {
        n: np.asarray(cv2.resize(p, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA))
        for n, p in pictures.items()
    }
    reduced = with_surface_patches(model, halves, {}, rays, OPTIONS).model
    bundle = Bundle.of(reduced, 10_000)
    assert len(bundle.points) > 50
    # Still in pixels of the photographs, and as exact in those of the reduced ones.
    assert np.abs(np.median(bundle.projected() - bundle.pixels, axis=0)).max() < 0.05
    assert robust_sigma((bundle.projected() - bundle.pixels).ravel()) < 0.2


def test_of_too_many_patches_those_that_most_see_are_kept(scene, monkeypatch):
    model, pictures, rays = scene
    every = with_surface_patches(model, pictures, {}, rays, OPTIONS).model.points
    monkeypatch.setattr(surface_patches, "MOST_TRACKS", 4 * 20)
    kept = with_surface_patches(model, pictures, {}, rays, OPTIONS).model.points
    assert len(kept) == 80 < len(every)
    lengths = [sorted(len(p.track) for p in points.values()) for points in (every, kept)]
    assert lengths[1][0] >= lengths[0][0]
    assert np.mean(lengths[1]) > np.mean(lengths[0])


def test_patches_are_looked_up_in_near_and_far_photographs_but_no_more_than_asked(scene):
    model, pictures, rays = scene
    every = with_surface_patches(model, pictures, {}, rays, OPTIONS).model.points
    assert max(len(point.track) for point in every.values()) == 4
    two = with_surface_patches(model, pictures, {}, rays, replace(OPTIONS, most_photos=2))
    seen = [tuple(point.track[:, 0]) for point in two.model.points.values()]
    # The cameras stand in a row: of the first, the second sees most and the fourth least.
    assert {who for who in seen if who[0] == 1} == {(1, 2, 4)}
    assert {len(who) for who in seen} == {3}
    enough = with_surface_patches(model, pictures, {}, rays, replace(OPTIONS, most_photos=3))
    assert len(enough.model.points) == len(every)


def test_without_paint_there_is_nothing_to_follow(scene):
    model, pictures, rays = scene
    blank = {n: np.full_like(p, 128) for n, p in pictures.items()}
    assert not with_surface_patches(model, blank, {}, rays, OPTIONS).model.points


def test_sure_observations_count_for_more_and_shared_noise_is_told(scene):
    model, pictures, rays = scene
    dense = with_surface_patches(model, pictures, {}, rays, replace(OPTIONS, apart_px=4.0))
    spread = with_surface_patches(model, pictures, {}, rays, replace(OPTIONS, apart_px=20.0))
    assert dense.overlap > 1.5 * spread.overlap > 1.0
    bundle = Bundle.of(dense.model, 10_000, dense.information)
    white = np.einsum("mij,mj->mi", bundle.whitening, bundle.projected() - bundle.pixels)
    known = np.concatenate([dense.information[n] for n in sorted(dense.information)])
    area = known[:, 0] * known[:, 2] - known[:, 1] ** 2
    # What is thought the surer half errs less in pixels, and whitening makes all alike.
    apart = bundle.projected() - bundle.pixels
    away = np.linalg.norm(apart, axis=1) > 1e-9
    sure = area > np.median(area[away])
    raw = robust_sigma(apart[away & ~sure].ravel()) / robust_sigma(apart[away & sure].ravel())
    even = robust_sigma(white[away & ~sure].ravel()) / robust_sigma(white[away & sure].ravel())
    assert raw > 1.2
    assert abs(np.log(even)) < 0.6 * np.log(raw)
