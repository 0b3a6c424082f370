"""The flash found from real photographs: a sculpture walked round, and one chart."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.color.chart_finding import FoundChart, chart_at
from workbench.color.flash_chart import chart_place, flash_by_chart
from workbench.color.flash_estimation import estimated_flash, sample_scatter
from workbench.color.flash_light import FlashLight, value_trust
from workbench.color.flash_observations import FlashObservations
from workbench.color.patches import measured_patches
from workbench.formats.colmap import read_colmap_text
from workbench.formats.surface_files import read_surface
from workbench.geometry.photo_camera import PhotoCamera
from workbench.photos.decoding import read_linear

LUMINANCE = np.array([0.2126, 0.7152, 0.0722])


@dataclass(frozen=True)
class Skull:
    """Observations of the sculpture, and which of them the figures of its README are about."""

    seen: FlashObservations
    coarse: NDArray[np.float64]
    told: NDArray[np.bool_]

    def scatter(self, taken_out: NDArray[np.float64]) -> float:
        """Of the logarithm of luminance, less something; best gains are not taken out here."""
        left = np.log(self.seen.values @ LUMINANCE) - taken_out
        return sample_scatter(left[self.told], self.seen.sample[self.told])

    def with_gains(self, taken_out: NDArray[np.float64]) -> float:
        """The same with the gain for every photograph that leaves least, by alternation."""
        kept = self.told
        sample, photo = self.seen.sample[kept], self.seen.photo[kept]
        left = (np.log(self.seen.values @ LUMINANCE) - taken_out)[kept]
        gains = np.zeros(photo.max() + 1)
        for _ in range(60):
            rest = left - gains[photo]
            means = np.bincount(sample, rest) / np.maximum(np.bincount(sample), 1)
            gains += np.bincount(photo, rest - means[sample]) / np.maximum(np.bincount(photo), 1)
        return sample_scatter(left - gains[photo], sample)

    def received(self, light: FlashLight, normals: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.log(np.maximum(light.received(self.seen.places_in_camera, normals), 1e-9))


def normals_near(
    vertices: NDArray[np.float64],
    triangles: NDArray[np.int32],
    points: NDArray[np.float64],
    radius: float,
) -> NDArray[np.float64]:
    """Mean normals (n, 3), by area, of the surface about points."""
    corners = vertices[triangles]
    areas = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    sums = np.zeros_like(vertices)
    for k in range(3):
        np.add.at(sums, triangles[:, k], areas)
    tree = cKDTree(vertices)
    _, nearest = tree.query(points, k=40)
    near = tree.query_ball_point(points, radius)
    chosen = [found if len(found) >= 40 else few for found, few in zip(near, nearest, strict=True)]
    normals = np.array([sums[which].sum(axis=0) for which in chosen])
    return normals / np.linalg.norm(normals, axis=1, keepdims=True)


@pytest.fixture(scope="module")
def skull(shared_data: Callable[..., Path]) -> Skull:
    folder = shared_data("skull-flash")
    model = read_colmap_text(folder / "cameras")
    points = np.array([point.xyz for point in model.points.values()])
    pairs = np.load(folder / "cameras" / "visibility.npz")
    sample, image = pairs["point_index"].astype(int), pairs["image_id"].astype(int)
    mesh = read_surface(folder / "geometry.ply")
    fine = normals_near(mesh.vertices, mesh.triangles, points, 0.01)
    coarse = normals_near(mesh.vertices, mesh.triangles, points, 0.05)
    places, values = np.empty((len(sample), 3)), np.empty((len(sample), 3))
    own, wide = np.empty((len(sample), 3)), np.empty((len(sample), 3))
    cameras = model.photo_cameras()
    for number, picture in model.images.items():
        here = image == number
        rotation, shift = picture.camera_from_world[:3, :3], picture.camera_from_world[:3, 3]
        places[here] = points[sample[here]] @ rotation.T + shift
        own[here], wide[here] = fine[sample[here]] @ rotation.T, coarse[sample[here]] @ rotation.T
        light = read_linear(folder / "photos" / picture.name).values
        pixels, _ = cameras[Path(picture.name).stem].project(points[sample[here]])
        blurred = cv2.GaussianBlur(light, (0, 0), 2.0)
        at = (pixels - 0.5).astype(np.float32)[None]
        values[here] = cv2.remap(blurred, at, None, cv2.INTER_LINEAR)[0]
    seen = FlashObservations(sample, image - 1, places, own, values, value_trust(values))
    # What the README's figures are about: found by trying what gives all of them.
    facing = -(wide * places).sum(axis=1) / np.linalg.norm(places, axis=1) > 0.5
    told = facing & (values @ LUMINANCE > 0.05) & (values.max(axis=1) < 0.9)
    told &= (np.bincount(sample[told], minlength=len(points)) >= 4)[sample]
    return Skull(seen, wide, told)


@pytest.mark.slow
def test_a_real_flash_is_found_above_the_lens(skull: Skull) -> None:
    """The README of the photographs: 0.258 as shot, 0.109 gains, 0.083 flash in the lens."""
    lens = FlashLight(np.zeros(3), reference_distance=3.6, epsilon=0.0)
    assert skull.scatter(np.zeros(len(skull.told))) == pytest.approx(0.258, rel=0.03)
    assert skull.with_gains(np.zeros(len(skull.told))) == pytest.approx(0.109, rel=0.03)
    at_lens = skull.with_gains(skull.received(lens, skull.coarse))
    assert at_lens == pytest.approx(0.083, rel=0.08)

    estimate = estimated_flash(skull.seen)
    assert estimate, estimate
    gains = np.log(estimate.gains)[skull.seen.photo]
    after = skull.scatter(skull.received(estimate.light, skull.seen.normals_in_camera) + gains)
    assert after <= 0.050
    assert estimate.scatter_held_out <= 1.05 * estimate.scatter
    assert estimate.scatter_as_shot > 4 * estimate.scatter
    # The photographs lie as the camera was held; its flash pops up above the lens.
    right, down, _ = estimate.light.position_in_camera
    assert down < -0.6
    assert abs(right) < 0.3 * abs(down)
    assert estimate.converged


@pytest.mark.slow
def test_a_flash_fitted_to_half_of_a_real_surface_serves_the_other_half(skull: Skull) -> None:
    seen = skull.seen
    first = np.random.default_rng(3).random(seen.sample.max() + 1) < 0.5
    half = first[seen.sample]
    estimate = estimated_flash(
        FlashObservations(*(getattr(seen, name)[half] for name in seen.__dataclass_fields__))
    )
    assert estimate
    other = skull.told & ~half
    light = skull.received(estimate.light, seen.normals_in_camera)
    left = np.log(seen.values @ LUMINANCE) - light - np.log(estimate.gains)[seen.photo]
    assert sample_scatter(left[other], seen.sample[other]) <= 0.052


def test_a_real_chart_tells_its_flash(shared_data: Callable[..., Path]) -> None:
    """Lit from about 0.35 m: the README has 5.97 without falloff and 5.33 with a flash at the lens.

    It is overexposed, which is what the rest is.
    """
    photo = read_linear(shared_data("raw", "olympus-c5050", "PB180004.JPG"), half_size=True)
    corners = np.array([[239, 293], [2271, 299], [2277, 1696], [209, 1663]]) / 2
    chart = chart_at(photo.values, corners)
    assert isinstance(chart, FoundChart)
    # A 1/1.8" sensor is 7.18 mm wide; EXIF tells 7.1 mm.
    focal = 7.1 / 7.18 * 1280
    camera = PhotoCamera("PINHOLE", 1280, 960, (focal, focal, 640.0, 480.0), np.eye(4))
    place = chart_place(chart, camera)
    assert place
    assert 0.29 < place.middle[2] < 0.36
    found = flash_by_chart(measured_patches(photo.values, photo.usable, chart), place)
    assert found
    assert found.delta_e_even == pytest.approx(5.97, rel=0.06)
    assert found.delta_e_at_lens == pytest.approx(5.33, rel=0.06)
    assert found.delta_e <= 5.0
    assert -0.12 < found.light.position_in_camera[1] < -0.03
