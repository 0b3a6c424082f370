"""A thousand photographs in the memory of a few, and in any order."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
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
    """Print by how much blending raised the process's peak memory, and how far colours are off."""
    # What is loaded and compiled once is not the photographs' doing.
    blended(OnDisk(Path(folder), range(20)), len(MESH.vertices), at_once=AT_ONCE)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    found = blended(OnDisk(Path(folder), range(count)), len(MESH.vertices), at_once=AT_ONCE)
    grown = 1024 * (resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before)
    off = np.abs(level_of(found.colors) - level_of(paint(MESH.vertices)))
    print(json.dumps([grown, float(np.quantile(off, 0.99))]))


def growth_and_error(folder: Path, count: int) -> tuple[int, float]:
    """The same, in a process of its own: the peak of a process never falls."""
    call = f"import {__name__} as it; it.blend_and_tell({str(folder)!r}, {count})"
    done = subprocess.run([sys.executable, "-c", call], capture_output=True, text=True, check=True)
    grown, error = json.loads(done.stdout)
    return int(grown), float(error)


@pytest.mark.slow
def test_a_thousand_photographs_stream_through_constant_memory(tmp_path):
    take(tmp_path, 1000)
    grown, error = {}, {}
    for count in (100, 1000):
        grown[count], error[count] = growth_and_error(tmp_path, count)
    # All at once would be 1000 × some 800 samples × 40 bytes, 32 MB more than the first hundred.
    assert grown[1000] - grown[100] < 4 << 20
    assert grown[1000] < 40 << 20
    assert error[1000] < 0.02
    order = np.random.default_rng(1).permutation(1000).tolist()
    one, other = (
        blended(OnDisk(tmp_path, numbers), len(MESH.vertices), at_once=AT_ONCE)
        for numbers in (range(1000), order)
    )
    assert np.nanmax(np.abs(one.colors - other.colors)) < 1e-6
    assert np.array_equal(one.photos, other.photos)
