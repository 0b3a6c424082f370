"""Samples of scans and of photographs' depth maps in the project frame."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

from workbench.pipeline.shape_sources import ShapeSource

if TYPE_CHECKING:
    from workbench.geometry.samples import Samples


class PlacedSources:
    """Every source's trusted samples in the project frame, one source in memory at a time."""

    def __init__(self, products: Any, sources: Sequence[ShapeSource], colored: bool) -> None:
        self._products, self._sources = products, sources
        self.colored = colored

    def __iter__(self) -> Iterator[Samples]:
        for source in self._sources:
            yield self.of(source)

    def of(self, source: ShapeSource) -> Samples:
        """One source's."""
        from workbench.cloud.fusion import placed_samples
        from workbench.geometry.orientedscan import OrientedScan

        assert source.project_from_map is not None
        arrays = self._products.load("oriented_scans", source.name)
        color, sigma = arrays.pop("color", None), arrays.pop("sigma_m", None)
        return placed_samples(
            OrientedScan(**arrays),
            source.project_from_map,
            color if self.colored else None,
            source.number,
            sigma,
        )
