"""The truth about photographs against formulas and other programs."""

from __future__ import annotations

import itertools
from collections.abc import Callable

import numpy as np
import pytest

from workbench.geometry import transforms
from workbench.synthetic import Scene
from workbench.synthetic.camera import local_from_camera
from workbench.synthetic.flash import Flash
from workbench.synthetic.photo_options import PathOptions, PhotoOptions
from workbench.synthetic.photography import Photograph, photograph, studio_of

BALL, RADIUS = np.array([0.0, 0.0, 0.6]), 0.3
RODS = ((0.12, 0.5), (-0.3, -0.5))
ROD_RADIUS, ROD_LOW, ROD_HIGH = 0.02, 0.1, 1.1


def pixel_points(photo: Photograph, scene: Scene, options: PhotoOptions) -> np.ndarray:
    """Local points (rows, cols, 3) from depth and pose; NaN where nothing is seen."""
    lens = studio_of(scene, options).lens
    assert photo.depth is not None
    v, u = np.indices(photo.depth.shape) + 0.5
    slopes = lens.slopes(np.column_stack([u.ravel(), v.ravel()])).reshape(*u.shape, 2)
    depth = np.where(np.isfinite(photo.depth), photo.depth, np.nan)[..., None]
    in_camera = np.concatenate([slopes * depth, depth], axis=-1)
    return transforms.apply(photo.local_from_camera, in_camera)


def hidden_by_ball(starts: np.ndarray, target: np.ndarray) -> np.ndarray:
    way = target - starts
    along = np.clip(((BALL - starts) * way).sum(-1) / (way**2).sum(-1), 0, 1)
    return np.linalg.norm(starts + along[..., None] * way - BALL, axis=-1) < RADIUS - 2e-3


def hidden_by_rod(starts: np.ndarray, target: np.ndarray, rod: tuple[float, float]) -> np.ndarray:
    way = target - starts
    flat, offset = way[..., :2], np.array(rod) - starts[..., :2]
    along = np.clip((offset * flat).sum(-1) / (flat**2).sum(-1), 0, 1)
    nearest = starts + along[..., None] * way
    inside = (nearest[..., 2] > ROD_LOW) & (nearest[..., 2] < ROD_HIGH)
    return inside & (np.linalg.norm(nearest[..., :2] - rod, axis=-1) < ROD_RADIUS)


def hidden_share(points: np.ndarray, flash: Flash) -> np.ndarray:
    """Share of the flash that formulas say is hidden from points (n, 3) on the ball."""
    grid = (np.arange(6) + 0.5) / 6 - 0.5
    normal = (points - BALL) / RADIUS
    hidden = np.zeros(len(points))
    for s in grid:
        for t in grid:
            source = flash.middle + s * flash.across + t * flash.down
            dark = ((source - points) * normal).sum(-1) <= 0
            for rod in RODS:
                dark |= hidden_by_rod(points, source, rod)
            hidden += dark
    return hidden / 36


def test_depth_points_lie_on_the_surface(
    ball_photo: Photograph, ball_scene: Scene, ball_options: PhotoOptions
) -> None:
    points = pixel_points(ball_photo, ball_scene, ball_options)
    on_ball = np.abs(np.linalg.norm(points - BALL, axis=-1) - RADIUS) < 1e-4
    inner = ball_photo.object_mask > 0
    assert on_ball[inner].mean() > 0.97
    # Only a pixel on the very border may have the ball at its centre and mostly show the rod.
    assert on_ball[ball_photo.support_mask > 0].mean() < 0.03


def test_true_points_project_to_the_pixel_that_sees_them(
    ball_photo: Photograph, ball_scene: Scene, ball_options: PhotoOptions
) -> None:
    lens = studio_of(ball_scene, ball_options).lens
    vertices = ball_scene.surface.vertices[ball_scene.material == 0]
    in_camera = transforms.apply(transforms.inverse(ball_photo.local_from_camera), vertices)
    pixels = lens.project(in_camera)
    facing = ((ball_photo.local_from_camera[:3, 3] - vertices) * (vertices - BALL)).sum(-1) > 0.1
    assert ball_photo.depth is not None
    seen = ball_photo.depth[
        np.clip(pixels[:, 1].astype(int), 0, lens.height - 1),
        np.clip(pixels[:, 0].astype(int), 0, lens.width - 1),
    ]
    difference = in_camera[:, 2] - seen
    # What lies further away than its pixel's depth is hidden by the rod before it.
    visible = facing & (difference < 0.1)
    assert visible.sum() > 0.9 * facing.sum()
    slope_of_a_pixel = 2.0 / lens.focal_px
    assert np.quantile(np.abs(difference[visible]), 0.9) < 4 * slope_of_a_pixel
    assert np.median(np.abs(difference[visible])) < slope_of_a_pixel


def test_shadows_agree_with_brute_force(
    ball_photo: Photograph, ball_scene: Scene, ball_options: PhotoOptions
) -> None:
    points = pixel_points(ball_photo, ball_scene, ball_options)
    inner = np.abs(np.linalg.norm(points - BALL, axis=-1) - RADIUS) < 1e-4
    inner &= ball_photo.object_mask > 0
    share = hidden_share(points[inner], ball_photo.flash)
    dark = ball_photo.shadow_mask[inner] > 0
    clear = (share < 0.05) | (share > 0.95)
    assert (dark == (share > 0.5))[clear].mean() > 0.985
    # The rod before the ball throws a shadow on it that is more than a rounding.
    on_front = (share > 0.95) & (
        ((ball_photo.flash.middle - points[inner]) * (points[inner] - BALL)).sum(-1) > 0.05
    )
    assert on_front.sum() > 30
    assert dark[on_front].mean() > 0.9


def test_a_larger_flash_has_softer_shadows(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    def half_lit(size: float) -> int:
        options = photo_options(
            flash={"size_m": (size, size), "ambient_lux": 0.0},
            surface={"indirect_rays": 0, "varnish": 0.0, "oren_nayar_sigma_deg": 0.0},
            rendering={"samples_per_pixel": 16, "edge_samples": 0},
        )
        photo = photograph(ball_scene, options, 0)
        points = pixel_points(photo, ball_scene, options)
        assert photo.diffuse is not None
        way = photo.flash.middle - points
        distance = np.linalg.norm(way, axis=-1)
        normal = (points - BALL) / RADIUS
        cosine = (way * normal).sum(-1) / distance
        full = photo.diffuse[..., 1] * distance**2 / cosine
        steep = (cosine > 0.5) & (np.abs(np.linalg.norm(points - BALL, axis=-1) - RADIUS) < 1e-4)
        relative = full[steep] / np.median(full[steep])
        return int(((relative > 0.15) & (relative < 0.8)).sum())

    assert half_lit(0.2) > 1.8 * half_lit(0.02)


def test_direct_light_is_the_inverse_square_and_the_cosine(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    options = photo_options(
        flash={"size_m": (0.0, 0.0), "ambient_lux": 0.0, "edge_falloff": 0.0},
        surface={"indirect_rays": 0, "varnish": 0.0, "oren_nayar_sigma_deg": 0.0},
    )
    photo = photograph(ball_scene, options, 0)
    points = pixel_points(photo, ball_scene, options)
    assert photo.diffuse is not None
    way = photo.flash.middle - points
    distance = np.linalg.norm(way, axis=-1)
    cosine = (way * (points - BALL)).sum(-1) / distance / RADIUS
    camera, flash = options.camera, options.flash
    law = 0.128 / 0.18 * (flash.guide_number_m / camera.f_number) ** 2 * camera.iso / 100
    expected = law * photo.flash.power * cosine / distance**2
    lit = (photo.object_mask > 0) & (photo.shadow_mask == 0) & (cosine > 0.4)
    inner = np.abs(np.linalg.norm(points - BALL, axis=-1) - RADIUS) < 1e-4
    error = photo.diffuse[..., 1][lit & inner] / expected[lit & inner] - 1
    assert np.abs(np.median(error)) < 0.002
    assert np.quantile(np.abs(error), 0.9) < 0.01


def test_bounced_light_is_there_and_small(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    def light(rays: int) -> np.ndarray:
        options = photo_options(surface={"indirect_rays": rays})
        diffuse = photograph(ball_scene, options, 0).diffuse
        assert diffuse is not None
        return diffuse.astype(float)

    none, few, many = light(0), light(24), light(128)
    gain = many - none
    assert gain.min() > -1e-6
    bright = none[..., 1] > 0.1
    assert 1e-4 < (gain[bright] / none[bright]).mean() < 0.1
    # The noise of few rays stays below the shot noise of a photosite in the same light.
    full_scale_e = studio_of(ball_scene, photo_options()).sensor.full_scale_e
    shot = np.sqrt(none[bright] * full_scale_e) / full_scale_e
    assert (np.abs(few - many)[bright] / shot).mean() < 0.5


def test_power_follows_the_mode(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    def powers(mode: str) -> np.ndarray:
        options = photo_options(
            flash={"mode": mode},
            camera={"long_side_px": 16, "short_side_px": 16},
            surface={"indirect_rays": 0},
        )
        return np.array([photograph(ball_scene, options, k).flash.power for k in range(6)])

    assert np.std(np.log(powers("manual"))) < 0.03
    assert 0.04 < np.std(np.log(powers("ttl"))) < 0.4


def test_daylight_comes_from_above_and_the_sky_shows(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    options = photo_options(
        flash={"mode": "off", "ambient_lux": 8000.0, "ambient_color": (1.0, 0.5, 1.0), "sky": 0.7},
        surface={"surroundings": "none", "indirect_rays": 24},
        camera={"vignetting_cosine_power": 0.0, "vignetting_corner_loss": 0.0},
    )
    photo = photograph(ball_scene, options, 0)
    assert not photo.metadata.flash_fired
    assert not photo.shadow_mask.any()
    assert photo.diffuse is not None
    assert photo.specular is not None
    points = pixel_points(photo, ball_scene, options)
    camera = options.camera
    level = 0.25 * 8000 / camera.f_number**2 * camera.exposure_time_s * camera.iso / 100 / 0.78
    up = (points - BALL)[..., 2] / RADIUS
    inner = (photo.object_mask > 0) & (
        np.abs(np.linalg.norm(points - BALL, axis=-1) - RADIUS) < 1e-4
    )
    expected = (0.5 + 0.5 * up[inner])[:, None] * level * np.array([1.0, 0.5, 1.0])
    assert np.quantile(np.abs(photo.diffuse[inner] / expected - 1), 0.9) < 0.01
    assert not photo.specular.any()
    # A white sky, as the sensor's colours and noise tell it.
    sensor = studio_of(ball_scene, options).sensor
    black, white = options.sensor.black_level, options.sensor.white_level
    share = (photo.mosaic.astype(float) - black) / (white - black)
    sky = photo.depth == np.inf
    assert sky.any()
    for row, column, channel in ((0, 0, 0), (0, 1, 1), (1, 1, 2)):
        there = share[row::2, column::2][sky[row::2, column::2]]
        expected_share = min(0.7 * sensor.camera_from_scene[channel].sum(), 1.0)
        assert np.median(there) == pytest.approx(expected_share, rel=0.02)


def test_a_turntable_keeps_the_camera_on_its_circle(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    options = photo_options(
        path={"kind": "turntable", "elevations_deg": (20.0,)},
        camera={"long_side_px": 16, "short_side_px": 16},
        surface={"indirect_rays": 0},
    )
    poses = [photograph(ball_scene, options, k).local_from_camera for k in range(6)]
    centers = np.array([pose[:3, 3] for pose in poses])
    np.testing.assert_allclose(np.linalg.norm(centers - BALL, axis=1), 2.0, atol=1e-12)
    np.testing.assert_allclose(centers[:, 2], 0.6 + 2 * np.sin(np.radians(20)), atol=1e-12)
    turn = np.diff(np.unwrap(np.arctan2(centers[:, 1], centers[:, 0])))
    np.testing.assert_allclose(turn, np.pi / 3, atol=1e-12)


def test_focus_falls_off_with_distance(
    ball_scene: Scene, photo_options: Callable[..., PhotoOptions]
) -> None:
    def steepness(focus: str) -> tuple[float, float]:
        options = photo_options(
            camera={
                "long_side_px": 600,
                "short_side_px": 400,
                "focus": focus,
                "f_number": 1.4,
                "iso": 25,
                "blur_sigma_px": 0.0,
            },
            flash={"guide_number_m": 4.0},
            rendering={"samples_per_pixel": 16, "edge_samples": 0},
            surface={"indirect_rays": 0, "surroundings": "none"},
        )
        photo = photograph(ball_scene, options, 0)
        green = photo.mosaic[0::2, 1::2].astype(float) - options.sensor.black_level
        # Few rays over the aperture leave noise, which rows of an upright edge average out.
        green = green.reshape(-1, 10, green.shape[1]).mean(axis=1)
        steps = np.abs(np.diff(green, axis=1))
        rows = (photo.object_mask > 0).any(axis=1).reshape(-1, 20)
        middle = len(rows) // 2
        outline = np.flatnonzero(photo.object_mask[20 * middle + 10])[[0, -1]] // 2
        ball = max(steps[middle, column - 4 : column + 5].max() for column in outline)
        return float(ball), float(steps[~rows.any(axis=1)].max())

    sharp, blurred = steepness("everywhere"), steepness("thin lens")
    # The ball's outline is in focus, the rod half a metre before it is not.
    assert blurred[1] / sharp[1] < 0.75 * blurred[0] / sharp[0]


def test_strips_do_not_show(
    ball_scene: Scene,
    photo_options: Callable[..., PhotoOptions],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    options = photo_options(sensor={"read_noise_e": 0.0})
    whole = photograph(ball_scene, options, 1)
    monkeypatch.setattr("workbench.synthetic.photography.STRIP_ROWS", 22)
    cut = photograph(ball_scene, options, 1)
    for name in ("object_mask", "support_mask", "shadow_mask", "albedo", "diffuse", "specular"):
        np.testing.assert_array_equal(getattr(whole, name), getattr(cut, name))


def test_a_walk_along_walls_turns_round_the_corners_without_a_leap() -> None:
    options = PathOptions(
        kind="along walls", distance_m=12.0, turns=2, position_sigma_m=0.0, aim_sigma_m=0.0,
        roll_sigma_deg=0.0,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    poses = [local_from_camera(np.zeros(3), options, 80, k, rng) for k in range(80)]
    for number, pose in enumerate(poses):
        assert pose[2, 3] == (1.7 if number < 40 else 12.0)
        # Never nearer to the outline of 30 × 20 m than it should be, nor further away.
        beyond = np.maximum(np.abs(pose[:2, 3]) - [15.0, 10.0], 0.0)
        assert np.linalg.norm(beyond) == pytest.approx(12.0)
        middle = -pose[:2, 3] @ pose[:2, 2]
        assert middle > 0
    for one, other in itertools.pairwise(poses[:40]):
        assert np.linalg.norm(other[:2, 3] - one[:2, 3]) < 7.0
        assert one[:3, 2] @ other[:3, 2] > np.cos(np.radians(25.0))
