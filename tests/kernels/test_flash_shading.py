"""The kernels of the flash against plain NumPy, and against what energy conservation asks."""

from __future__ import annotations

import numpy as np
import pytest

from workbench.kernels.bounced_light import bounced_light, gathered_light, neighbour_means
from workbench.kernels.flash_shading import add_to_pixels, reflected_light, surface_points

AXIS = np.array([0.1, -0.2, 1.0]) / np.linalg.norm([0.1, -0.2, 1.0])


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def surface_seen(count: int, seed: int = 3) -> tuple[np.ndarray, ...]:
    """Normals, views and ways to the flash of a random bumpy surface before camera and flash."""
    rng = np.random.default_rng(seed)
    normals = unit(rng.normal(size=(count, 3)) * 0.8 + [0.0, 0.0, -1.0])
    points = rng.uniform(-0.5, 0.5, (count, 3)) + np.array([0.0, 0.0, 2.0])
    views = unit(points)
    to_flash = np.array([-0.13, -0.03, 0.01]) - points
    return normals.astype(np.float32), views.astype(np.float32), to_flash.astype(np.float32)


def reflected_by_numpy(
    normals: np.ndarray,
    views: np.ndarray,
    to_flash: np.ndarray,
    gloss: np.ndarray,
    alpha: np.ndarray,
    falloff: float,
    sigma_deg: float,
) -> np.ndarray:
    """Oren and Nayar 1994 by its angles, and GGX by Walter et al. 2007, eqs. 33 and 34."""
    n, v, flash = normals.astype(float), -views.astype(float), to_flash.astype(float)
    distance = np.linalg.norm(flash, axis=1)
    light_way = flash / distance[:, None]
    cos_l = np.sum(n * light_way, axis=1)
    lit = cos_l > 0
    cos_v = np.clip(np.sum(n * v, axis=1), 0.02, 1.0)
    cosine = -light_way @ AXIS
    level = (1 - falloff * (1 / cosine**2 - 1)) / distance**2
    theta_l, theta_v = np.arccos(np.clip(cos_l, 0, 1)), np.arccos(cos_v)
    flat_l = light_way - cos_l[:, None] * n
    flat_v = v - np.sum(n * v, axis=1)[:, None] * n
    cos_phi = np.sum(unit(flat_l) * unit(flat_v), axis=1)
    s2 = np.radians(sigma_deg) ** 2
    a, b = 1 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)
    wide, narrow = np.maximum(theta_l, theta_v), np.minimum(theta_l, theta_v)
    diffuse = cos_l * (a + b * np.maximum(cos_phi, 0) * np.sin(wide) * np.tan(narrow))
    h = unit(light_way + v)
    tan2 = 1 / np.sum(n * h, axis=1) ** 2 - 1
    density = alpha**2 / (np.pi * np.sum(n * h, axis=1) ** 4 * (alpha**2 + tan2) ** 2)

    def masking(cos: np.ndarray) -> np.ndarray:
        return 2 / (1 + np.sqrt(1 + alpha**2 * (1 / cos**2 - 1)))

    fresnel = 0.04 + 0.96 * (1 - np.sum(light_way * h, axis=1)) ** 5
    lobe = fresnel * density * masking(cos_l) * masking(cos_v) / (4 * cos_l * cos_v)
    specular = gloss * np.pi * lobe * cos_l
    return np.where(lit[:, None], np.stack([diffuse, specular], axis=1) * level[:, None], 0.0)


@pytest.mark.parametrize("sigma_deg", [0.0, 15.0, 40.0])
def test_reflection_is_the_published_one(sigma_deg: float) -> None:
    normals, views, to_flash = surface_seen(4000)
    rng = np.random.default_rng(5)
    gloss = rng.uniform(0.1, 1.0, len(normals)).astype(np.float32)
    alpha = rng.uniform(0.1, 0.6, len(normals)).astype(np.float32)
    s2 = np.radians(sigma_deg) ** 2
    rough = np.array([1 - 0.5 * s2 / (s2 + 0.33), 0.45 * s2 / (s2 + 0.09)])
    found = reflected_light(normals, views, to_flash, gloss, alpha, AXIS, 0.2, rough)
    expected = reflected_by_numpy(normals, views, to_flash, gloss, alpha, 0.2, sigma_deg)
    # Seen at less than one degree nothing is told; the model there is cut off on purpose.
    told = np.sum(normals * -views, axis=1) > 0.03
    np.testing.assert_allclose(found[told], expected[told], rtol=2e-3, atol=1e-5)
    assert (found[told][:, 0] > 0).mean() > 0.5


def test_twice_as_far_is_a_quarter_of_the_light() -> None:
    n = np.array([[0.0, 0.0, -1.0]] * 2, np.float32)
    way = np.array([[0.0, 0.0, -1.0], [0.0, 0.0, -2.0]], np.float32)
    none = np.zeros(2, np.float32)
    found = reflected_light(
        n, -n, way, none, none, np.array([0.0, 0.0, 1.0]), 0.3, np.array([1.0, 0.0])
    )
    np.testing.assert_allclose(found, [[1.0, 0.0], [0.25, 0.0]], rtol=1e-6)


def test_points_and_normals_follow_the_corners() -> None:
    rng = np.random.default_rng(0)
    vertices = rng.normal(size=(30, 3)) + np.array([5e5, 5.2e6, 0.0])
    triangles = rng.permutation(30).reshape(10, 3).astype(np.int32)
    normals = unit(rng.normal(size=(10, 3, 3)) * 0.2 + [0, 0, 1]).astype(np.float32)
    hit = rng.integers(0, 10, 200)
    uv = rng.dirichlet([1, 1, 1], 200)[:, 1:].astype(np.float32)
    points, shading = surface_points(hit, uv, vertices, triangles, normals)
    weights = np.column_stack([1 - uv.sum(axis=1, dtype=float), uv])
    np.testing.assert_allclose(
        points, np.einsum("nk,nkd->nd", weights, vertices[triangles[hit]]), rtol=0, atol=2e-9
    )
    np.testing.assert_allclose(
        shading, unit(np.einsum("nk,nkd->nd", weights, normals[hit])), atol=1e-6
    )


def test_samples_add_up_in_their_pixels() -> None:
    rng = np.random.default_rng(1)
    n, pixels, exposure = 500, 40, 0.7
    places, kinds = rng.integers(0, pixels, n), rng.integers(0, 4, n).astype(np.uint8)
    distance = rng.uniform(1, 2, n)
    albedo, other = (rng.random((n, 3)).astype(np.float32) for _ in range(2))
    direct = np.where(rng.random((n, 1)) < 0.3, 0, rng.random((n, 2))).astype(np.float32)
    hidden = rng.random(n) < 0.4
    totals = np.zeros((pixels, 15))
    add_to_pixels(places, kinds, distance, albedo, direct, hidden, other, exposure, totals)
    flash = np.where(hidden[:, None], 0, exposure * direct.astype(float))
    light = flash[:, :1] + other
    rows = np.column_stack(
        [
            albedo * light + flash[:, 1:],
            albedo,
            light,
            flash[:, 1],
            *(np.minimum(kinds, 2) == k for k in range(3)),
            ~hidden & (direct[:, 0] > 0),
            distance,
        ]
    )
    expected = np.zeros_like(totals)
    np.add.at(expected, places, rows)
    np.testing.assert_allclose(totals, expected, rtol=1e-6, atol=1e-9)


def test_bounced_light_is_the_mean_of_what_rays_meet() -> None:
    rng = np.random.default_rng(2)
    triangles = rng.permutation(60).reshape(20, 3).astype(np.int32)
    radiosity = rng.random((60, 3)).astype(np.float32)
    seen = rng.integers(-1, 20, (60, 7)).astype(np.int32)
    light = bounced_light(seen, triangles, radiosity)
    of_triangle = np.vstack([radiosity[triangles].mean(axis=1), np.zeros(3)])
    np.testing.assert_allclose(light, of_triangle[seen].mean(axis=1), rtol=1e-5)
    uv = rng.dirichlet([1, 1, 1], 20)[:, 1:].astype(np.float32)
    weights = np.column_stack([1 - uv.sum(axis=1), uv])
    found = gathered_light(np.arange(20), uv, triangles, light)
    np.testing.assert_allclose(
        found, np.einsum("nk,nkd->nd", weights, light[triangles]), rtol=1e-5, atol=1e-7
    )


def test_averaging_over_neighbours_keeps_even_light_even() -> None:
    triangles = np.array([[0, 1, 2], [2, 1, 3], [3, 1, 4]], np.int32)
    even = np.full((6, 2), 0.3, np.float32)
    np.testing.assert_allclose(neighbour_means(triangles, even), even, rtol=1e-6)
    spike = np.zeros((6, 1), np.float32)
    spike[1] = 1.0
    # Vertex 0 has one triangle: itself and two others; vertex 5 has none.
    means = neighbour_means(triangles, spike)
    np.testing.assert_allclose(means[[0, 1, 5], 0], [1 / 3, 1 / 7, 0.0], rtol=1e-6)
