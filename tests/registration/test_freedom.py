from __future__ import annotations

import numpy as np
import pytest

from workbench.registration.freedom import freedom_in_words, told_apart, unconstrained

NAMES = ["a", "b", "c"]


def unit(index: int) -> np.ndarray:
    return np.eye(18)[index]


def test_any_mixture_of_slides_and_turns_is_told_apart() -> None:
    rng = np.random.default_rng(0)
    pure = np.stack([unit(k) for k in (6 + 3, 6 + 4, 6 + 2, 12 + 5, 12 + 0)], axis=1)
    found = told_apart(pure @ rng.normal(size=(5, 5)))
    words = [freedom_in_words(motion, NAMES).sentence for motion in found]
    assert sorted(words) == [
        "b can slide along x",
        "b can slide along y",
        "b can turn about z",
        "c can slide along z",
        "c can turn about x",
    ]
    spanned = np.array(found)
    assert np.allclose(spanned @ spanned.T, np.eye(5), atol=1e-12)
    assert np.allclose(spanned.T @ spanned @ pure, pure, atol=1e-12)


def test_what_several_scans_do_together_names_them_all() -> None:
    together = (unit(6 + 5) + unit(12 + 5)) / np.sqrt(2)
    (motion,) = told_apart(together[:, None])
    assert abs(motion @ together) == pytest.approx(1)
    freedom = freedom_in_words(motion, NAMES)
    assert set(freedom.scans) == {"b", "c"}
    assert freedom.sentence.endswith("can slide along z")


def test_an_oblique_axis_is_written_out() -> None:
    motion = np.zeros(18)
    motion[9:12] = [-0.6, -0.8, 0.0]
    assert freedom_in_words(motion, NAMES).sentence == "b can slide along (0.60, 0.80, -0.00)"


def test_noise_in_the_normals_is_not_taken_for_constraint() -> None:
    # Bisectors of normals that are wrong by s along each direction are wrong by s / √2.
    s = 0.05
    rng = np.random.default_rng(1)
    first, second = (rng.normal(scale=s, size=(20000, 2)) for _ in range(2))
    angle = np.linalg.norm(first - second, axis=1)
    felt = np.mean((0.5 * (first + second))[:, 0] ** 2)
    shares = np.array([felt, 10 * felt])
    assert unconstrained(shares, float(np.mean(angle**2))).tolist() == [True, False]
    assert unconstrained(np.array([0.0, 1e-3]), 0.0).tolist() == [True, False]
