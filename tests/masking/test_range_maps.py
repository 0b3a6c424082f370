from __future__ import annotations

import io
from dataclasses import replace

import numpy as np
import pytest
from numpy.typing import NDArray

from workbench.errors import InputError, SettingsError
from workbench.geometry.rangemap import RangeMap
from workbench.masking import surface_cut as surface_cut_module
from workbench.masking.evaluation import masking_errors
from workbench.masking.grid_surface import grid_surface
from workbench.masking.range_map_signal import range_map_picture, reflectance_span
from workbench.masking.range_maps import (
    RangeMapClassifier,
    RangeMapMaskingOptions,
    learned_range_maps,
    mask_of_range_map,
)
from workbench.masking.sample_filters import eroded, median_of_samples
from workbench.masking.surface_cut import surface_cut

STONE, METAL, NONE = 0, 1, 2
ALBEDO = np.array([0.6, 0.1])
Mask = NDArray[np.uint8]


def scene(
    seed: int, turn_deg: float = 0.0, albedo: NDArray[np.float64] = ALBEDO
) -> tuple[RangeMap, Mask, NDArray[np.float64]]:
    """A stone column with a grazing stone wing, a metal bar before, a metal wall behind.

    Returns the range map, the true mask and the true cosine of incidence, 0 in holes.
    """
    rng = np.random.default_rng(seed)
    v, u = np.meshgrid(np.linspace(-0.4, 0.4, 90), np.linspace(-0.6, 0.6, 130), indexing="ij")
    ray = np.stack([u, v, np.ones_like(u)], axis=-1)
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    tilt = np.radians(97.0 + turn_deg)
    wing, before = np.array([np.sin(tilt), 0.0, -np.cos(tilt)]), np.array([0.0, 0.0, -1.0])
    hits = [_column(ray), _plane(ray, wing, -0.216), _plane(ray, before, -2.2)]
    deep = hits[1][0] * ray[..., 2]
    hits[1][0][~((deep > 0.9) & (deep < 2.1))] = np.inf
    bar = _plane(ray, before, -0.9)
    bar[0][(v < 0.02 + 0.05 * u) | (v > 0.1 + 0.05 * u)] = np.inf
    distances = np.stack([hit[0] for hit in (*hits, bar)])
    first = distances.argmin(axis=0)
    distance = np.take_along_axis(distances, first[None], axis=0)[0]
    cosines = np.stack([hit[1] for hit in (*hits, bar)])
    cosine = np.take_along_axis(cosines, first[None], axis=0)[0]
    material = np.array([STONE, STONE, METAL, METAL])[first]
    hole = rng.random(first.shape) < 0.02
    signal = albedo[material] * cosine * (1 + 0.04 * rng.standard_normal(first.shape))
    points = (distance + 4e-4 * rng.standard_normal(first.shape))[..., None] * ray
    grid = np.full(first.shape, -1, np.int32)
    grid[~hole] = np.arange((~hole).sum())
    scan = RangeMap(
        "scene",
        points[~hole],
        grid,
        np.zeros(3),
        np.maximum(signal, 0.0)[~hole].astype(np.float32),
    )
    truth = np.where((material == STONE) & ~hole, 255, 0).astype(np.uint8)
    return scan, truth, np.where(hole, 0.0, cosine)


def _column(ray: NDArray[np.float64]) -> list[NDArray[np.float64]]:
    """An upright column of radius 0.3 m, 1.5 m away."""
    a = ray[..., 0] ** 2 + ray[..., 2] ** 2
    b = -1.5 * ray[..., 2]
    root = b**2 - a * (1.5**2 - 0.3**2)
    distance = np.where(root > 0, (-b - np.sqrt(np.maximum(root, 0))) / a, np.inf)
    normal = distance[..., None] * ray - [0.0, 0.0, 1.5]
    normal[..., 1] = 0.0
    with np.errstate(invalid="ignore"):
        cosine = -np.einsum("ijk,ijk->ij", normal / 0.3, ray)
    return [distance, np.nan_to_num(cosine)]


def _plane(
    ray: NDArray[np.float64], normal: NDArray[np.float64], offset: float
) -> list[NDArray[np.float64]]:
    slope = ray @ normal
    return [np.where(slope * offset > 0, offset / slope, np.inf), np.abs(slope)]


def test_every_stone_is_kept_and_no_metal_after_one_example() -> None:
    classifier = learned_range_maps([scene(1)[:2]])
    assert classifier
    scan, truth, _ = scene(2, turn_deg=1.0)
    errors = masking_errors(mask_of_range_map(scan, classifier), truth, samples=scan.grid >= 0)
    assert errors.false_positive_percent < 0.3
    assert errors.false_negatives < 0.005 * errors.model_samples


def test_incidence_is_what_keeps_grazing_stone() -> None:
    scan, truth, cosine = scene(2)
    # Where stone is as dark as metal that faces the scanner.
    grazing = (truth > 0) & (cosine > 0.08) & (cosine < 0.2)
    assert grazing.sum() > 300
    part = {}
    for bins in (1, 10):
        options = RangeMapMaskingOptions(incidence_bins=bins, smoothness=0.0)
        mask = mask_of_range_map(scan, learned_range_maps([scene(1)[:2]], options), options)
        part[bins] = (mask[grazing] > 0).mean()
    assert part[10] > 0.8
    assert part[10] > part[1] + 0.3


def test_incidence_is_true_on_planes_and_beside_edges() -> None:
    scan, _, cosine = scene(3)
    surface = grid_surface(scan)
    error = np.abs(surface.incidence_cos[scan.grid[scan.grid >= 0]] - cosine[scan.grid >= 0])
    assert np.nanmedian(error) < 0.03
    assert np.nanpercentile(error, 95) < 0.2
    assert (np.einsum("ni,ni->n", surface.normals, -scan.points_in_scan) >= 0).all()


def _two_walls() -> RangeMap:
    """Two walls side by side, 20 × 40 samples, 1 m apart in depth from column 20 on."""
    row, col = np.mgrid[:20, :40]
    depth = np.where(col < 20, 1.0, 2.0)
    points = np.stack([0.01 * col * depth, 0.01 * row * depth, depth], axis=-1).reshape(-1, 3)
    grid = np.arange(800, dtype=np.int32).reshape(20, 40)
    return RangeMap("walls", points.astype(np.float64), grid, np.zeros(3))


def test_labels_spread_over_a_surface_and_end_at_its_depth_step() -> None:
    scan = _two_walls()
    evidence = np.zeros((20, 40))
    # Weak evidence against what only links to the strong one can outvote.
    evidence[:, 2], evidence[:, 10:30] = 5.0, -0.02
    kept = surface_cut(scan, grid_surface(scan), evidence.ravel(), 1.0, 3.0).reshape(20, 40)
    assert kept[:, :20].all()
    assert not kept[:, 20:].any()
    flat = replace(scan, points_in_scan=scan.points_in_scan / scan.points_in_scan[:, 2:])
    assert surface_cut(flat, grid_surface(flat), evidence.ravel(), 1.0, 3.0).all()


def test_cut_by_tiles_is_the_cut_as_a_whole(monkeypatch: pytest.MonkeyPatch) -> None:
    scan, truth, _ = scene(4)
    classifier = learned_range_maps([(scan, truth)])
    whole = mask_of_range_map(scan, classifier)
    monkeypatch.setattr(surface_cut_module, "_TILE", 40)
    monkeypatch.setattr(surface_cut_module, "_CONTEXT", 24)
    np.testing.assert_array_equal(mask_of_range_map(scan, classifier), whole)


def test_holes_are_not_kept_and_what_a_mask_says_of_them_does_not_matter() -> None:
    scan, truth, _ = scene(1)
    hole = scan.grid < 0
    classifier = learned_range_maps([(scan, truth)])
    careless = learned_range_maps([(scan, np.where(hole, 255, truth).astype(np.uint8))])
    np.testing.assert_array_equal(classifier.log_odds, careless.log_odds)
    mask = mask_of_range_map(scan, classifier)
    assert mask.dtype == np.uint8
    assert set(np.unique(mask)) == {0, 255}
    assert not mask[hole].any()


def test_stray_returns_are_not_kept() -> None:
    scan, truth, _ = scene(1)
    # The reflectance alone, since to it a stray return from stone is stone.
    options = RangeMapMaskingOptions(incidence_bins=1)
    classifier = learned_range_maps([(scan, truth)], options)
    assert scan.grid is not None
    stray = scan.grid[40:60:3, 60:70:3]
    stray = stray[stray >= 0]
    assert len(stray) > 20
    points = scan.points_in_scan.copy()
    points[stray] *= 0.7
    stone = np.full(len(scan), 0.58, np.float32)
    dirty = replace(scan, points_in_scan=points, reflectance=stone)

    def kept(least_neighbours: int) -> NDArray[np.bool_]:
        chosen = replace(options, least_neighbours=least_neighbours)
        mask = mask_of_range_map(dirty, classifier, chosen)
        found = np.zeros(len(scan), bool)
        found[scan.grid[scan.grid >= 0]] = mask[scan.grid >= 0] > 0
        return found

    assert kept(0).all()
    assert not kept(1)[stray].any()
    assert np.delete(kept(1), stray).mean() > 0.99


def test_clutter_alone_teaches_when_only_a_quarter_of_it_is_marked() -> None:
    scan, truth, _ = scene(1)
    marked = np.full_like(truth, 255)
    marked[:, ::4] = truth[:, ::4]
    told = learned_range_maps([(scan, marked)], clutter_only=True)
    assert told
    other, other_truth, _ = scene(2)
    samples = other.grid >= 0
    errors = masking_errors(mask_of_range_map(other, told), other_truth, samples=samples)
    assert errors.false_positive_percent < 1.0
    assert errors.false_negatives < 0.02 * errors.model_samples
    # The same mask taken for the whole truth calls most of the metal an object.
    misled = mask_of_range_map(other, learned_range_maps([(scan, marked)]))
    assert masking_errors(misled, other_truth, samples=samples).false_positives > 500


@pytest.mark.parametrize("seed", range(6))
def test_one_appearance_is_reported_as_not_separable(seed: int) -> None:
    row, col = np.mgrid[:60, :60]
    rng = np.random.default_rng(seed)
    depth = 1.0 + 2e-4 * rng.standard_normal((60, 60))
    points = np.stack([0.005 * (col - 29.5), 0.005 * row, depth], axis=-1).reshape(-1, 3)
    grid = np.arange(3600, dtype=np.int32).reshape(60, 60)
    reflectance = rng.normal(0.5, 0.05, 3600).astype(np.float32)
    scan = RangeMap("flat", points, grid, np.zeros(3), reflectance)
    mask = np.where(col < 30, 255, 0).astype(np.uint8)
    for clutter_only in (False, True):
        classifier = learned_range_maps([(scan, mask)], clutter_only=clutter_only)
        assert not classifier
        assert "like" in classifier.separability.reason
    assert not RangeMapClassifier.from_arrays(classifier.arrays())


def test_a_small_object_among_unmarked_clutter_is_still_told_apart() -> None:
    scan, truth, _ = scene(1)
    assert scan.grid is not None
    # Stone is a twentieth of what is unmarked.
    stone = scan.grid[(scan.grid >= 0) & (truth > 0)]
    gone = np.random.default_rng(0).permutation(stone)[: int(0.95 * len(stone))]
    few = replace(scan, grid=np.where(np.isin(scan.grid, gone), -1, scan.grid))
    marked = np.full_like(truth, 255)
    marked[:, ::4] = truth[:, ::4]
    assert learned_range_maps([(few, marked)], clutter_only=True)


def test_colours_that_tell_nothing_change_nothing() -> None:
    scan, truth, _ = scene(1)
    assert scan.grid is not None
    marked = np.full_like(truth, 255)
    marked[:, ::4] = truth[:, ::4]
    grey = np.full((len(scan), 3), 90, np.uint8)
    black_metal = np.zeros((len(scan), 3), np.uint8)
    black_metal[scan.grid[truth > 0]] = 90
    for color, mask, clutter_only in ((grey, marked, True), (black_metal, truth, False)):
        told = learned_range_maps([(replace(scan, color=color), mask)], clutter_only=clutter_only)
        without = learned_range_maps([(scan, mask)], clutter_only=clutter_only)
        np.testing.assert_array_equal(
            mask_of_range_map(replace(scan, color=color), told), mask_of_range_map(scan, without)
        )


def test_without_reflectance_luminance_and_chromaticity_tell() -> None:
    def colored(seed: int, metal: tuple[int, int, int]) -> tuple[RangeMap, Mask]:
        scan, truth, _ = scene(seed)
        assert scan.grid is not None
        stone = np.zeros(len(scan), bool)
        stone[scan.grid[scan.grid >= 0]] = truth[scan.grid >= 0] > 0
        color = np.where(stone[:, None], (150, 150, 140), metal)
        noise = np.random.default_rng(seed).normal(0, 4, color.shape)
        color = np.clip(color + noise, 0, 255).astype(np.uint8)
        return replace(scan, reflectance=None, color=color), truth

    # Darker grey; then as bright, but orange.
    for metal in ((70, 70, 65), (200, 138, 60)):
        classifier = learned_range_maps([colored(1, metal)])
        assert classifier.signal == "luminance"
        scan, truth = colored(2, metal)
        assert masking_errors(mask_of_range_map(scan, classifier), truth).iou > 0.98
    with pytest.raises(InputError, match="no colour"):
        mask_of_range_map(replace(scan, color=None), classifier)


def test_without_reflectance_and_colour_the_surface_alone_tells() -> None:
    def rough_stone(seed: int) -> tuple[RangeMap, Mask]:
        scan, truth, _ = scene(seed)
        assert scan.grid is not None
        bump = 0.004 * np.random.default_rng(seed).standard_normal(len(scan))
        stone = scan.grid[(scan.grid >= 0) & (truth > 0)]
        points = scan.points_in_scan.copy()
        points[stone] *= 1.0 + bump[stone][:, None]
        return replace(scan, reflectance=None, points_in_scan=points), truth

    classifier = learned_range_maps([rough_stone(1)])
    assert classifier.signal == "roughness"
    scan, truth = rough_stone(2)
    assert masking_errors(mask_of_range_map(scan, classifier), truth).iou > 0.85


def test_unknown_viewpoint_leaves_the_incidence_out() -> None:
    scan, truth, cosine = scene(1)
    nowhere = replace(scan, viewpoint_in_scan=None)
    assert np.isnan(grid_surface(nowhere).incidence_cos).all()
    mask = mask_of_range_map(nowhere, learned_range_maps([(nowhere, truth)]))
    alone = RangeMapMaskingOptions(incidence_bins=1)
    by_signal = mask_of_range_map(scan, learned_range_maps([(scan, truth)], alone), alone)
    assert (mask != by_signal).mean() < 1e-3
    assert not mask[truth == 0].any()
    # Only stone that is as dark as the metal is lost.
    facing = (truth > 0) & (cosine > 0.25)
    assert facing.sum() > 2000
    assert (mask[facing] > 0).mean() > 0.99


def test_same_input_same_mask_and_a_saved_classifier_is_the_same() -> None:
    scan, truth, _ = scene(1)
    color = np.full((len(scan), 3), 90, np.uint8)
    classifier = learned_range_maps([(replace(scan, color=color), truth)])
    again = learned_range_maps([(replace(scan, color=color), truth)])
    file = io.BytesIO()
    np.savez(file, allow_pickle=False, **classifier.arrays())
    file.seek(0)
    restored = RangeMapClassifier.from_arrays(np.load(file))
    assert (restored.signal, restored.span) == (classifier.signal, classifier.span)
    assert restored.separability == classifier.separability
    for name in ("log_odds", "chroma_log_odds"):
        np.testing.assert_array_equal(getattr(restored, name), getattr(classifier, name))
        np.testing.assert_array_equal(getattr(again, name), getattr(classifier, name))
    np.testing.assert_array_equal(
        mask_of_range_map(scan, restored), mask_of_range_map(scan, classifier)
    )
    with pytest.raises(InputError, match="not a classifier"):
        RangeMapClassifier.from_arrays({"signal": np.array("reflectance")})


def test_erosion_stays_away_from_clutter_and_steps_but_not_from_holes() -> None:
    scan = _two_walls()
    assert scan.grid is not None
    grid = scan.grid.copy()
    grid[10, 30] = -1
    scan = replace(scan, grid=grid)
    kept = np.ones((20, 40), bool)
    kept[:, 0] = False
    found = eroded(scan, grid_surface(scan), kept.ravel(), 2).reshape(20, 40)
    expected = np.ones((20, 40), bool)
    expected[:, :3] = expected[:, 18:22] = False
    expected[10, 30] = found[10, 30]
    np.testing.assert_array_equal(found, expected)


def test_median_asks_samples_only() -> None:
    scan = _two_walls()
    assert scan.grid is not None
    kept = np.ones((20, 40), bool)
    kept[5, 5] = False
    kept[12, 12] = False
    grid = scan.grid.copy()
    grid[11:14, 11:14] = -1
    grid[12, 12] = scan.grid[12, 12]
    found = median_of_samples(replace(scan, grid=grid), kept.ravel(), 3).reshape(20, 40)
    assert found[5, 5]
    assert not found[12, 12]


def test_span_is_of_all_scans_and_not_of_glints() -> None:
    scan, _, _ = scene(1)
    assert scan.reflectance is not None
    glint = scan.reflectance.copy()
    glint[:3] = 1e4
    low, high = reflectance_span([scan, replace(scan, reflectance=2 * glint)])
    assert 0.05 < low < 0.1
    assert 1.0 < high < 1.6
    with pytest.raises(InputError, match="no scan has"):
        reflectance_span([replace(scan, reflectance=None)])


def test_picture_shows_reflectance_else_colour_else_shading() -> None:
    scan, _, _ = scene(1)
    assert scan.grid is not None
    hole = scan.grid < 0
    bright = range_map_picture(scan, (0.0, 0.6))
    assert bright.shape == (*hole.shape, 3)
    assert bright.dtype == np.uint8
    assert not bright[hole].any()
    assert (range_map_picture(scan, (0.0, 2.4)) <= bright).all()
    color = np.random.default_rng(0).integers(0, 256, (len(scan), 3)).astype(np.uint8)
    shown = range_map_picture(replace(scan, reflectance=None, color=color))
    np.testing.assert_array_equal(shown[~hole], color)
    shaded = range_map_picture(replace(scan, reflectance=None))
    wall, edge = shaded[45:, 95:].max(), np.median(shaded[10:30, 45])
    assert wall > 240
    assert edge < 0.9 * wall


def test_bad_input_is_refused_in_plain_words() -> None:
    scan, truth, _ = scene(1)
    classifier = learned_range_maps([(scan, truth)])
    without_grid = replace(scan, grid=None)
    for act in (
        lambda: mask_of_range_map(without_grid, classifier),
        lambda: range_map_picture(without_grid),
        lambda: learned_range_maps([(without_grid, truth)]),
    ):
        with pytest.raises(InputError, match="no grid"):
            act()
    with pytest.raises(InputError, match="no masked range maps"):
        learned_range_maps([])
    with pytest.raises(InputError, match="not of the scan's grid"):
        learned_range_maps([(scan, truth[1:])])
    with pytest.raises(InputError, match="nothing to keep"):
        learned_range_maps([(scan, np.zeros_like(truth))])
    with pytest.raises(InputError, match="no clutter"):
        learned_range_maps([(scan, np.full_like(truth, 255))])
    with pytest.raises(InputError, match="no reflectance"):
        mask_of_range_map(replace(scan, reflectance=None), classifier)
    with pytest.raises(SettingsError, match="odd"):
        RangeMapMaskingOptions(median_px=4)
    with pytest.raises(SettingsError, match="positive"):
        RangeMapMaskingOptions(keep_odds=0.0)
