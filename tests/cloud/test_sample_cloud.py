from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from tests.cloud.cloud_fixtures import build
from workbench.cloud.building import build_cloud
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.sample_cloud import SampleBlocks, samples_in, samples_schema
from workbench.errors import InputError
from workbench.geometry.regions import Box
from workbench.geometry.samples import Samples

RNG = np.random.default_rng(12)


def some_samples(n: int, color: bool) -> Samples:
    normals = RNG.normal(size=(n, 3))
    return Samples(
        RNG.random((n, 3)) + np.array([5e5, 5.2e6, 0]),
        normals / np.linalg.norm(normals, axis=1)[:, None],
        RNG.uniform(0.001, 0.01, n),
        RNG.uniform(0.1, 9, n),
        RNG.integers(0, 5, n).astype(np.int32),
        RNG.integers(0, 256, (n, 3), dtype=np.uint8) if color else None,
    )


@pytest.mark.parametrize("color", [True, False])
def test_a_box_gives_back_its_samples(tmp_path: Path, color: bool):
    parts = [some_samples(700, color), some_samples(500, color)]
    path = tmp_path / "c"
    build_cloud(path, SampleBlocks(parts), samples_schema(color), points_per_chunk=100)
    box = Box([5e5, 5.2e6, 0.2], [5e5 + 0.7, 5.2e6 + 0.9, 0.8])
    with LayeredCloud(path) as cloud:
        found = samples_in(cloud, box)
        assert 0 < len(samples_in(cloud, box, level=1)) < len(found)
    points = np.concatenate([p.points for p in parts])
    inside = box.contains(points)
    order, back = np.lexsort(points[inside].T), np.lexsort(found.points.T)
    for name in Samples.__dataclass_fields__:
        if not color and name == "color":
            assert found.color is None
            continue
        expected = np.concatenate([getattr(p, name) for p in parts])[inside][order]
        got = getattr(found, name)[back]
        assert got.dtype == expected.dtype
        exact = name in ("points", "scan", "color")
        assert np.allclose(got, expected, rtol=0 if exact else 6e-8, atol=0)


def test_other_clouds_are_refused(tmp_path: Path):
    build(tmp_path / "c", RNG.random((10, 3)))
    with LayeredCloud(tmp_path / "c") as cloud, pytest.raises(InputError, match="samples"):
        samples_in(cloud)
