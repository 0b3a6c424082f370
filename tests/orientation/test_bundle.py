"""Normal equations do not depend on how many observations are taken at once."""

from __future__ import annotations

import numpy as np

from tests.orientation.blob import body, photographed
from workbench.orientation import bundle as module
from workbench.orientation.bundle import Bundle


def test_observations_are_added_part_by_part(monkeypatch) -> None:
    found = photographed(body(4), cameras=8)
    bundle = Bundle.of(found, 10_000)
    rng = np.random.default_rng(2)
    bundle.pixels[:] += rng.normal(scale=0.3, size=bundle.pixels.shape)
    whole = bundle.linearised(0.5)
    monkeypatch.setattr(module, "OBSERVATIONS_AT_ONCE", len(bundle.pixels) // 3 - 1)
    parts = bundle.linearised(0.5)
    assert len(whole.weights) > 1000
    np.testing.assert_array_equal(parts.weights, whole.weights)
    for name in ("camera_hessian", "camera_gradient", "point_hessian", "point_gradient"):
        one, other = getattr(parts, name), getattr(whole, name)
        assert np.abs(one - other).max() < 1e-9 * np.abs(other).max(), name
    assert abs(parts.coupling - whole.coupling).max() < 1e-9 * abs(whole.coupling).max()
