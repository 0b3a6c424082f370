"""Consolidated samples wherever they are: held in memory, or in a layered cloud on disk."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.sample_cloud import samples_in
from workbench.geometry.regions import Box
from workbench.geometry.samples import Samples

# A seed of its own, so that thinning and nothing else depends on it.
_THINNING_SEED = 33


class SampleSource(Protocol):
    """Samples that need not be in memory at once."""

    def __len__(self) -> int:
        """Number of samples."""
        ...

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Corners (3,), (3,) of their box, metres."""
        ...

    def within(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Samples:
        """Those in a closed box."""
        ...

    def places(self) -> Iterator[NDArray[np.float64]]:
        """All points (n, 3), some at a time."""
        ...

    def owners(self) -> Iterator[NDArray[np.int32]]:
        """The scan (n,) of all samples, some at a time."""
        ...

    def thinned(self, most: int) -> Samples:
        """At most ``most`` of them, spread like all of them."""
        ...


@dataclass(frozen=True)
class HeldSamples:
    """Samples in memory."""

    samples: Samples

    def __len__(self) -> int:
        return len(self.samples)

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self.samples.bounds

    def within(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Samples:
        return self.samples.chosen(Box(low, high).contains(self.samples.points))

    def places(self) -> Iterator[NDArray[np.float64]]:
        yield self.samples.points

    def owners(self) -> Iterator[NDArray[np.int32]]:
        yield self.samples.scan

    def thinned(self, most: int) -> Samples:
        n = len(self.samples)
        if n <= most:
            return self.samples
        order = np.random.default_rng(_THINNING_SEED).permutation(n)[:most]
        return self.samples.chosen(np.sort(order))


@dataclass(frozen=True)
class CloudSamples:
    """Samples in a layered cloud."""

    cloud: LayeredCloud

    def __len__(self) -> int:
        return len(self.cloud)

    @property
    def bounds(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        return self.cloud.bounds

    def within(self, low: NDArray[np.float64], high: NDArray[np.float64]) -> Samples:
        return samples_in(self.cloud, Box(low, high))

    def places(self) -> Iterator[NDArray[np.float64]]:
        for _, arrays in self.cloud.blocks(["points"]):
            yield arrays["points"]

    def owners(self) -> Iterator[NDArray[np.int32]]:
        for _, arrays in self.cloud.blocks(["scan"]):
            yield arrays["scan"]

    def thinned(self, most: int) -> Samples:
        """The coarsest levels that hold no more than ``most``; the coarsest one at least."""
        nodes = self.cloud.tree.nodes
        held = np.cumsum(np.bincount(nodes["level"], nodes["count"]))
        level = max(0, int(np.searchsorted(held, most, side="right")) - 1)
        return samples_in(self.cloud, level=level)


@contextmanager
def opened_samples(
    held: Mapping[str, NDArray[Any]] | None, cloud: Path | None
) -> Iterator[SampleSource]:
    """Samples from what was stored of them: arrays, or the path of a cloud.

    A process can open a cloud once at a time.
    """
    if cloud is not None:
        with LayeredCloud(cloud, read_ahead=False) as opened:
            yield CloudSamples(opened)
    elif held is not None:
        yield HeldSamples(Samples(**held))
    else:
        raise ValueError("neither samples nor a cloud of them")
