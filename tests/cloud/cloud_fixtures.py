"""Small clouds and their samples for the tests of the layered cloud."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from workbench.cloud.building import BuildReport, build_cloud
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.schema import Attribute, Schema

SCHEMA = Schema((Attribute("number", "int64"), Attribute("color", "uint8", 3)))
CHUNK = 64
#: Small enough that a few hundred samples already go through files.
MEMORY = 16 * CHUNK * SCHEMA.row_bytes


def arrays_of(points: np.ndarray) -> dict[str, np.ndarray]:
    """Samples that carry their own number."""
    n = len(points)
    color = np.random.default_rng(n).integers(0, 256, (n, 3), dtype=np.uint8)
    return {"points": np.ascontiguousarray(points), "number": np.arange(n), "color": color}


def cut(arrays: dict[str, np.ndarray], size: int) -> list[dict[str, np.ndarray]]:
    n = len(arrays["points"])
    return [{k: a[i : i + size] for k, a in arrays.items()} for i in range(0, n, size)]


def build(path: Path, points: np.ndarray, *, block: int = 10**6, **options) -> BuildReport:
    options = {"points_per_chunk": CHUNK, "memory_bytes": MEMORY, **options}
    return build_cloud(path, cut(arrays_of(points), block), SCHEMA, **options)


def check_whole(path: Path, points: np.ndarray) -> None:
    """No sample lost, none twice, every bit as it came."""
    expected = arrays_of(points)
    with LayeredCloud(path, read_ahead=False) as cloud:
        chunks = [cloud.read(int(c)) for c in cloud.chunks()]
    found = {k: np.concatenate([c[k] for c in chunks]) for k in expected}
    order = np.argsort(found["number"])
    for name, array in expected.items():
        assert found[name].dtype == array.dtype
        assert found[name][order].tobytes() == array.tobytes(), name
