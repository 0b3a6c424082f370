"""A range map: the samples one scan took, with the scanner's own grid where it has one."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class RangeMap:
    """One scan in its own frame.

    Attributes
    ----------
    name : unique within a project; letters, digits, ``.``, ``_`` and ``-``.
    points_in_scan : (n, 3) float64, metres, all finite.
    grid : (rows, cols) int32 of indices into the points, −1 where the scanner saw
        nothing; None for a cloud without order.
    viewpoint_in_scan : (3,) float64, where the scanner stood, metres; a far point for
        scanners with (nearly) parallel rays; None when unknown.
    reflectance : (n,) float32 in the instrument's own units, or None.
    color : (n, 3) uint8, sRGB-encoded, or None.
    world_from_scan : 4×4 float64 coarse pose, or None when the file gave none.
    sigma_m : (n,) float32 standard deviation along the line of sight, metres, or None where
        nobody knows it.
    """

    name: str
    points_in_scan: NDArray[np.float64]
    grid: NDArray[np.int32] | None = None
    viewpoint_in_scan: NDArray[np.float64] | None = None
    reflectance: NDArray[np.float32] | None = None
    color: NDArray[np.uint8] | None = None
    world_from_scan: NDArray[np.float64] | None = None
    sigma_m: NDArray[np.float32] | None = None

    def __post_init__(self) -> None:
        n = len(self.points_in_scan)
        if self.points_in_scan.shape != (n, 3) or self.points_in_scan.dtype != np.float64:
            raise ValueError(f"{self.name}: points_in_scan must be (n, 3) float64")
        if self.grid is not None and self.grid.size and self.grid.max() >= n:
            raise ValueError(f"{self.name}: the grid points past the last sample")
        if self.reflectance is not None and self.reflectance.shape != (n,):
            raise ValueError(f"{self.name}: reflectance must be ({n},)")
        if self.sigma_m is not None and self.sigma_m.shape != (n,):
            raise ValueError(f"{self.name}: sigma_m must be ({n},)")
        if self.color is not None and self.color.shape != (n, 3):
            raise ValueError(f"{self.name}: color must be ({n}, 3)")

    def __len__(self) -> int:
        return len(self.points_in_scan)

    def masked(self, mask: NDArray[np.uint8]) -> RangeMap:
        """The samples that a mask of the grid, (rows, cols) uint8 with 255 = keep, keeps."""
        if self.grid is None or mask.shape != self.grid.shape:
            raise ValueError(f"{self.name}: the mask is not of the scan's grid")
        keep = np.zeros(len(self) + 1, bool)
        # Holes are −1, the entry behind the last sample.
        keep[self.grid[mask > 127]] = True
        return self.subset(keep[:-1])

    def subset(self, keep: NDArray[np.bool_]) -> RangeMap:
        """The samples where ``keep`` (n,) is true; the grid follows."""
        new_index = np.full(len(self) + 1, -1, np.int32)
        new_index[:-1][keep] = np.arange(int(keep.sum()), dtype=np.int32)
        return replace(
            self,
            points_in_scan=self.points_in_scan[keep],
            grid=None if self.grid is None else new_index[self.grid],
            reflectance=None if self.reflectance is None else self.reflectance[keep],
            color=None if self.color is None else self.color[keep],
            sigma_m=None if self.sigma_m is None else self.sigma_m[keep],
        )
