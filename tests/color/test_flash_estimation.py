"""The flash found from simulated observations whose light is written down independently."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from tests.color.flash_scene import FlashScene, flash_scene
from workbench.color.flash_estimation import FlashEstimate, estimated_flash, sample_scatter
from workbench.color.flash_observations import FlashObservations
from workbench.errors import InputError

FLASH = np.array([-0.13, -0.05, 0.02])


def error_mm(estimate: FlashEstimate, flash: np.ndarray = FLASH) -> float:
    return 1e3 * float(np.linalg.norm(estimate.light.position_in_camera - flash))


def in_sigmas(estimate: FlashEstimate, flash: np.ndarray = FLASH) -> float:
    """Mahalanobis distance of the truth."""
    off = estimate.light.position_in_camera - flash
    return float(np.sqrt(off @ np.linalg.solve(estimate.position_covariance, off)))


def found(scene: FlashScene, **options) -> FlashEstimate:
    estimate = estimated_flash(scene.seen, **options)
    assert estimate, estimate
    return estimate


def kept(estimate: FlashEstimate) -> set[str]:
    return {trial.term for trial in estimate.trials if trial.kept}


@pytest.mark.parametrize("seed", [0, 1])
def test_a_bare_flash_is_found_and_no_term_is_invented(seed: int) -> None:
    scene = flash_scene(seed, outliers=0.05, gain_sigma=0.3)
    estimate = found(scene)
    assert error_mm(estimate) < 2.0
    assert in_sigmas(estimate) < 4.0
    assert kept(estimate) == set()
    assert (estimate.position_sigma < 0.01).all()
    assert estimate.converged
    assert not estimate.warnings
    np.testing.assert_allclose(estimate.gains, scene.gains, rtol=0.004)
    # A hundredth of noise, of which a sample's mean takes up some.
    assert 0.008 < estimate.scatter < 0.012
    assert estimate.scatter_held_out == pytest.approx(estimate.scatter, rel=0.05)
    assert estimate.scatter_as_shot > estimate.scatter_with_gains > 5 * estimate.scatter
    assert estimate.used == pytest.approx(0.9, abs=0.06)


@pytest.mark.parametrize(
    ("made_of", "terms"),
    [
        ({"sigma": 0.35}, {"roughness"}),
        ({"beam": 0.4}, {"falloff"}),
        ({"indirect": 0.05}, {"indirect"}),
        ({"sigma": 0.35, "beam": 0.4, "indirect": 0.03}, {"falloff", "roughness", "indirect"}),
    ],
)
def test_the_terms_that_there_are_are_kept(made_of: dict[str, float], terms: set[str]) -> None:
    scene = flash_scene(1, outliers=0.05, gain_sigma=0.2, **made_of)
    estimate = found(scene)
    assert kept(estimate) == terms
    assert error_mm(estimate) < 6.0
    assert in_sigmas(estimate) < 5.0
    assert estimate.light.roughness_rad == pytest.approx(made_of.get("sigma", 0.0), abs=0.01)
    d0 = estimate.light.reference_distance
    assert estimate.light.indirect / d0**2 == pytest.approx(made_of.get("indirect", 0), abs=0.003)
    np.testing.assert_allclose(estimate.gains, scene.gains, rtol=0.01)
    assert estimate.scatter < 0.012


def test_without_a_needed_term_the_flash_is_misplaced() -> None:
    """The bounds above mean something: a beam taken for even light costs centimetres."""
    scene = flash_scene(1, beam=0.4, gain_sigma=0.2)
    assert error_mm(found(scene, terms=())) > 10.0


def test_a_known_roughness_stays_and_places_the_flash() -> None:
    scene = flash_scene(1, sigma=0.35, outliers=0.05, gain_sigma=0.2)
    estimate = found(scene, roughness_rad=0.35)
    assert estimate.light.roughness_rad == 0.35
    assert kept(estimate) == set()
    assert error_mm(estimate) < 3.0
    assert error_mm(found(scene, terms=())) > 100.0


def test_light_falls_as_told_wherever_the_estimate_is_used() -> None:
    """The albedo, up to one factor: what the estimate is for."""
    scene = flash_scene(3, sigma=0.35, beam=0.4, outliers=0.05, gain_sigma=0.2)
    estimate = found(scene)
    seen = scene.seen
    received = estimate.light.received(seen.places_in_camera, seen.normals_in_camera)
    albedo = seen.values / (estimate.gains[seen.photo] * received)
    ratio = np.log(albedo / scene.albedo)[~scene.outlier]
    assert ratio.std() < 0.013


def test_wrong_normals_widen_the_stated_uncertainty() -> None:
    for seed in (0, 1):
        estimate = found(flash_scene(seed, normal_error=0.05, outliers=0.05))
        assert error_mm(estimate) < 100.0
        off = np.abs(estimate.light.position_in_camera - FLASH)
        assert (off < 4.0 * estimate.position_sigma).all()
        assert np.sqrt(np.trace(estimate.position_covariance)) > 0.01
        assert off[:2].max() < 0.02


def test_a_flash_set_by_hand_may_not_make_up_for_distances() -> None:
    scene = flash_scene(2, gain_sigma=0.01, outliers=0.02, photos=12, samples=800)
    estimate = found(scene, gain_sigma=0.03, terms=())
    free = found(scene, terms=())
    assert error_mm(estimate) < 3.0
    assert estimate.position_covariance.trace() <= 1.1 * free.position_covariance.trace()
    np.testing.assert_allclose(estimate.gains, scene.gains, rtol=0.005)


@pytest.mark.parametrize("scale", [1e-6, 1e5])
def test_units_of_length_and_light_do_not_matter(scale: float) -> None:
    scene = flash_scene(0, samples=800, outliers=0.05, gain_sigma=0.3)
    plain = found(scene, terms=())
    large = replace(
        scene.seen,
        places_in_camera=scale * scene.seen.places_in_camera,
        values=scene.seen.values / scale,
    )
    other = estimated_flash(large, terms=())
    assert other
    np.testing.assert_allclose(
        other.light.position_in_camera / scale, plain.light.position_in_camera, atol=1e-6
    )
    np.testing.assert_allclose(other.position_sigma / scale, plain.position_sigma, rtol=1e-3)


def test_same_observations_same_flash_whatever_their_order() -> None:
    seen = flash_scene(0, samples=600, outliers=0.05).seen
    mixed = np.random.default_rng(0).permutation(len(seen.sample))
    one = estimated_flash(seen)
    again = estimated_flash(seen)
    other = estimated_flash(
        FlashObservations(*(getattr(seen, n)[mixed] for n in seen.__dataclass_fields__))
    )
    assert one
    assert again
    assert other
    np.testing.assert_array_equal(one.light.position_in_camera, again.light.position_in_camera)
    np.testing.assert_allclose(
        one.light.position_in_camera, other.light.position_in_camera, atol=1e-6
    )


def test_a_direction_that_is_not_fixed_is_told() -> None:
    """A small ball from one distance: its shading tells the flash's side, not how far off."""
    scene = flash_scene(
        0, samples=150, photos=10, radius=0.015, distances=(2.0, 2.0001), gain_sigma=0.2
    )
    estimate = found(scene, terms=())
    assert len(estimate.loose) == 1
    assert np.abs(estimate.loose[0, 2]) > 0.9
    assert "along the view" in estimate.warnings[0]
    assert estimate.condition > 3.0
    assert in_sigmas(estimate) < 4.0
    assert estimate.position_sigma[:2].max() < 0.04
    fixed = found(flash_scene(0, samples=2000, photos=20), terms=())
    assert not len(fixed.loose)


def spoiled(seen: FlashObservations, part: float) -> FlashObservations:
    """Some observations black, without a number, without a normal, or far above all."""
    rng = np.random.default_rng(0)
    values, normals = seen.values.copy(), seen.normals_in_camera.copy()
    places = seen.places_in_camera.copy()
    kinds = np.where(rng.random(len(values)) < part, rng.integers(0, 6, len(values)), 9)
    values[kinds == 0] = 0.0
    values[kinds == 1] = np.nan
    values[kinds == 2] = np.inf
    normals[kinds == 3] = 0.0
    normals[kinds == 4] = np.nan
    places[kinds == 5] = np.nan
    return replace(seen, values=values, normals_in_camera=normals, places_in_camera=places)


def test_black_infinite_and_missing_numbers_are_passed_over() -> None:
    scene = flash_scene(0, samples=1500, gain_sigma=0.2)
    estimate = estimated_flash(spoiled(scene.seen, 0.3), terms=())
    assert estimate
    assert error_mm(estimate) < 3.0
    assert estimate.observations == pytest.approx(0.7 * len(scene.seen.sample), rel=0.05)


def test_photographs_apart_from_the_others_have_no_gain() -> None:
    scene = flash_scene(0, samples=1000, photos=12)
    seen = scene.seen
    apart = np.where(seen.photo >= 10, seen.sample + 5000, seen.sample)
    estimate = estimated_flash(replace(seen, sample=apart), terms=())
    assert estimate
    assert np.isnan(estimate.gains[10:]).all()
    assert np.isfinite(estimate.gains[:10]).all()
    assert any("share no sample" in told for told in estimate.warnings)


def test_what_cannot_be_told_is_refused_with_its_reason() -> None:
    seen = flash_scene(0, samples=300, photos=6).seen
    alone = seen.photo == 2
    one = FlashObservations(*(getattr(seen, n)[alone] for n in seen.__dataclass_fields__))
    cases = {
        "one photograph": one,
        "two photographs": replace(seen, sample=np.arange(len(seen.sample))),
        "no sample has light": replace(seen, values=np.zeros(len(seen.sample))),
        "too few": FlashObservations(
            *(getattr(seen, n)[np.isin(seen.sample, [0, 1, 2])] for n in seen.__dataclass_fields__)
        ),
    }
    cases["no sample has light, a place"] = replace(seen, weights=np.zeros(len(seen.sample)))
    nothing = np.zeros(0, bool)
    nothing = np.flatnonzero(nothing)
    cases["no sample"] = FlashObservations(
        *(getattr(seen, n)[nothing] for n in seen.__dataclass_fields__)
    )
    for reason, given in cases.items():
        refused = estimated_flash(given)
        assert not refused
        assert reason in refused.reason


def test_unequal_numbers_and_impossible_options_are_errors() -> None:
    seen = flash_scene(0, samples=50, photos=3).seen
    with pytest.raises(InputError, match="equally many"):
        replace(seen, values=seen.values[1:])
    with pytest.raises(InputError, match="from 0"):
        replace(seen, photo=seen.photo - 1)
    for options in (
        {"gain_sigma": 0.0},
        {"gain_sigma": np.nan},
        {"epsilon": 2.0},
        {"roughness_rad": 9.0},
    ):
        with pytest.raises(InputError):
            estimated_flash(seen, **options)


def test_scatter_of_samples_by_hand() -> None:
    """Two samples that vary by ±0.1 and ±0.3 in four photographs, and one seen but twice."""
    logarithms = np.array([1.1, 0.9, 1.1, 0.9, 5.3, 4.7, 5.3, 4.7, 0.0, 9.0])
    sample = np.array([7, 7, 7, 7, 3, 3, 3, 3, 1, 1])
    few = sample_scatter(
        np.tile(logarithms, 10), np.tile(sample, 10) + np.repeat(range(10), 10) * 9
    )
    assert few == pytest.approx(0.2)
    assert sample_scatter(logarithms, sample) == pytest.approx(0.3)
    assert np.isnan(sample_scatter(np.zeros(3), np.arange(3)))


@pytest.mark.slow
def test_the_stated_uncertainty_is_honest_over_many_scenes() -> None:
    distances = [
        in_sigmas(
            found(flash_scene(seed, samples=400, photos=15, outliers=0.05, sigma=0.3, beam=0.2))
        )
        for seed in range(20)
    ]
    # A chi distribution of three degrees of freedom has its median at 1.54 and 99 % below 3.4.
    assert 0.4 < np.median(distances) < 2.2
    assert np.sort(distances)[-3] < 4.0


@pytest.mark.slow
def test_a_million_observations_take_seconds() -> None:
    scene = flash_scene(0, samples=60_000, photos=80, outliers=0.05, sigma=0.3, beam=0.3)
    assert len(scene.seen.sample) > 1_000_000
    start = time.process_time()
    estimate = found(scene)
    assert time.process_time() - start < 30.0
    assert error_mm(estimate) < 4.0
