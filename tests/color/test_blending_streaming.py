"""A thousand photographs in the memory of a few, and in any order."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tracemalloc
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import pytest

from tests.color.blending_scene import (
    ball,
    camera_at,
    colored,
    looked,
    paint,
    photographed,
)
from workbench.color.blending import blended
from workbench.color.blending_colors import Colored, level_of

MESH = ball(4)
AT_ONCE = 100_000


@dataclass(frozen=True)
class OnDisk:
    """Photographs that lie on disk, read one at a time."""

    folder: Path
    numbers: Sequence[int]

    def __iter__(self) -> Iterator[Colored]:
        for number in self.numbers:
            with np.load(self.folder / f"{number}.npz") as arrays:
                yield Colored(arrays["index"], arrays["colors"], arrays["weights"])


def take(folder: Path, count: int) -> None:
    """Photographs from all round the ball, 1 % noise in each."""
    rng = np.random.default_rng(0)
    for number in range(count):
        camera = camera_at(rng.uniform(0, 2 * np.pi), rng.uniform(-1.5, 1.5), size=80)
        photo = colored(MESH, looked(MESH, camera, *photographed(camera, seed=number)))
        np.savez(
            folder / f"{number}.npz",
            index=photo.index,
            colors=photo.colors,
            weights=photo.weights,
        )


def blend_and_tell(folder: str, count: int) -> None:
    """Print the process's peak memory, that of blending alone, and how far colours are off."""
    tracemalloc.start()
    found = blended(OnDisk(Path(folder), range(count)), len(MESH.vertices), at_once=AT_ONCE)
    blending = tracemalloc.get_traced_memory()[1]
    process = 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    off = np.abs(level_of(found.colors) - level_of(paint(MESH.vertices)))
    print(json.dumps([process, blending, float(np.quantile(off, 0.99))]))


def peaks_and_error(folder: Path, count: int) -> list[float]:
    """The same, in a process of its own: the peak of a process never falls."""
    call = f"import {__name__} as it; it.blend_and_tell({str(folder)!r}, {count})"
    done = subprocess.run([sys.executable, "-c", call], capture_output=True, text=True, check=True)
    return list(json.loads(done.stdout))


@pytest.mark.slow
def test_a_thousand_photographs_stream_through_constant_memory(tmp_path):
    take(tmp_path, 1000)
    few, many = (peaks_and_error(tmp_path, count) for count in (200, 1000))
    # All at once would be 32 bytes of each of 800,000 observations more: 26 MB.
    assert many[0] - few[0] < 8 << 20
    assert many[1] - few[1] < 2 << 20
    assert many[1] < 24 << 20
    assert many[2] < 0.02
    order = np.random.default_rng(1).permutation(1000).tolist()
    one, other = (
        blended(OnDisk(tmp_path, numbers), len(MESH.vertices), at_once=AT_ONCE)
        for numbers in (range(1000), order)
    )
    assert np.nanmax(np.abs(one.colors - other.colors)) < 1e-6
    assert np.array_equal(one.photos, other.photos)
