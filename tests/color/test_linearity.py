from __future__ import annotations

import numpy as np
import pytest

from workbench.color.linearity import Linearity, fitted_linearity


def _frames(exponent: float, noise: float = 0.0) -> dict[str, tuple[float, float]]:
    rng = np.random.default_rng(3)
    return {
        f"f{k}": (d, 2.5 * d**exponent * float(np.exp(noise * rng.standard_normal())))
        for k, d in enumerate((1.9, 2.2, 2.6, 3.1, 3.7, 4.5))
    }


def test_a_linear_sensor_follows_the_inverse_square() -> None:
    found = fitted_linearity(_frames(-2.0, 0.01), metric=True)
    assert isinstance(found, Linearity)
    assert found.factor == pytest.approx(2.5, rel=0.01)
    assert 0.003 < found.residual < 0.02
    assert found.exponent == pytest.approx(-2.0, abs=0.03)


def test_a_tone_curve_shows() -> None:
    bent = {n: (d, level ** (1 / 1.3)) for n, (d, level) in _frames(-2.0).items()}
    found = fitted_linearity(bent, metric=True)
    assert found.residual > 0.1
    assert found.exponent == pytest.approx(-2 / 1.3, abs=0.01)


def test_only_ratios_count_where_distances_are_relative() -> None:
    scaled = {n: (100 * d, level) for n, (d, level) in _frames(-2.0).items()}
    one = fitted_linearity(_frames(-2.0), metric=False)
    other = fitted_linearity(scaled, metric=False)
    assert one.distances.min() == 1.0
    np.testing.assert_allclose(one.distances, other.distances)
    assert other.residual == pytest.approx(one.residual, abs=1e-12)


@pytest.mark.parametrize(
    ("frames", "word"),
    [
        ({"a": (1.0, 1.0), "b": (2.0, 0.25)}, "needed"),
        ({"a": (1.0, 1.0), "b": (1.1, 0.9), "c": (1.05, 0.95)}, "same distance"),
        ({"a": (1.0, 1.0), "b": (2.0, 0.0), "c": (3.0, 0.1)}, "zero"),
    ],
)
def test_refusals_say_why(frames, word: str) -> None:
    found = fitted_linearity(frames, metric=True)
    assert not found
    assert word in found.reason
