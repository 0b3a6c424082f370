"""Merging samples that are too many for memory: part by part of space."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from workbench.cloud.fusion import merged
from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.sample_cloud import samples_in
from workbench.geometry.regions import Box
from workbench.geometry.samples import Samples


@dataclass(frozen=True)
class MergedParts:
    """The samples of a cloud, merged within each of the boxes that share out space.

    Samples on both sides of a face between boxes stay apart: of the order of one in a
    thousand where a box holds a million.

    Attributes
    ----------
    path : cloud of samples.
    cell_m : as for `merged`.
    most_samples : in memory at once.
    further : samples that lie where those of the cloud do not; they stay as they are.
    """

    path: Path
    cell_m: float
    most_samples: int
    further: tuple[Samples, ...] = ()

    def __iter__(self) -> Iterator[Samples]:
        with LayeredCloud(self.path) as cloud:
            for low, high in cloud.cells(self.most_samples):
                yield merged(samples_in(cloud, Box(low, high)), self.cell_m)
        yield from self.further
