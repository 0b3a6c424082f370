"""The photographs' observations as they lie on disk, one at a time in memory."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from workbench.pipeline.stage import Products

if TYPE_CHECKING:
    from workbench.color.blending_colors import Colored
    from workbench.color.blending_observations import Observations
    from workbench.color.flash_light import FlashLight
    from workbench.color.flash_observations import FlashObservations

# Observations that the flash is looked for with.
_FLASH_OBSERVATIONS = 400_000


@dataclass(frozen=True)
class Photographs:
    """Some photographs and how to bring their colours to one light; iterated again and again.

    Attributes
    ----------
    products : where observations lie.
    names : of the photographs.
    poses : name → camera_from_world.
    points : (n, 3) of all samples.
    light : of the flash; None takes colours as photographed.
    gains : name → value of a white diffuser that gets light 1; 1 where nothing is said.
    cloud_span : None for the vertices of the surface; else the samples [first, last) of the
        cloud, which ``points`` are, and the shadows are known already.
    """

    products: Products
    names: Sequence[str]
    poses: Mapping[str, NDArray[np.float64]]
    points: NDArray[np.float64]
    light: FlashLight | None = None
    gains: Mapping[str, float] = field(default_factory=dict)
    cloud_span: tuple[int, int] | None = None

    def __iter__(self) -> Iterator[Colored]:
        from workbench.color.blending_colors import corrected, uncorrected

        for name in self.names:
            seen, gain = self.observations(name), self.gains.get(name, 1.0)
            if self.light is None:
                yield uncorrected(seen, gain)
            else:
                if self.cloud_span is None:
                    lit = self.products.load("photo_lighting", name)["lit"]
                    seen = replace(seen, weights=seen.weights * lit)
                yield corrected(seen, self.points[seen.index], self.poses[name], self.light, gain)

    def observations(self, name: str) -> Observations:
        """What one photograph says."""
        from workbench.color.blending_observations import Observations

        if self.cloud_span is None:
            return Observations.from_arrays(self.products.load("photo_observations", name))
        first, last = self.cloud_span
        seen = Observations.from_arrays(self.products.load("cloud_observations", name))
        within = seen.chosen(slice(*np.searchsorted(seen.index, [first, last])))
        return replace(within, index=within.index - first)

    def of(self, chosen: Callable[[str], bool]) -> Photographs:
        """Some of them."""
        return replace(self, names=[name for name in self.names if chosen(name)])

    def told_twice(self) -> tuple[NDArray[np.int64], NDArray[np.uint64]]:
        """How many photographs see each sample (n,), and a number for the set of them (n,)."""
        count = np.zeros(len(self.points), np.int64)
        sets = np.zeros(len(self.points), np.uint64)
        draw = np.random.default_rng(0)
        for name in self.names:
            index = self.observations(name).index
            count[index] += 1
            sets[index] ^= draw.integers(1, 2**63, dtype=np.uint64)
        return count, sets

    def for_the_flash(self, count: NDArray[np.int64]) -> FlashObservations:
        """Observations of evenly chosen samples that several photographs see.

        Parameters
        ----------
        count : (n,) photographs that see each sample.
        """
        from workbench.color.flash_observations import FlashObservations
        from workbench.geometry.transforms import apply

        several = np.flatnonzero(count >= 2)
        total = int(count[several].sum())
        step = max(1, -(-total // _FLASH_OBSERVATIONS))
        chosen = np.zeros(len(count), bool)
        chosen[several[::step]] = True
        parts: list[dict[str, NDArray[Any]]] = []
        for number, name in enumerate(self.names):
            seen = self.observations(name)
            # Weights in blending compare photographs; here 1 says that nothing is amiss.
            usual = np.median(seen.weights) if len(seen) else 1.0
            seen = seen.chosen(chosen[seen.index])
            parts.append(
                {
                    "sample": seen.index,
                    "photo": np.full(len(seen), number),
                    "places_in_camera": apply(self.poses[name], self.points[seen.index]),
                    "normals_in_camera": seen.normals.astype(np.float64),
                    "values": seen.values,
                    "weights": np.minimum(seen.weights / usual, 1.0).astype(np.float64),
                }
            )
        return FlashObservations(**{k: np.concatenate([p[k] for p in parts]) for k in parts[0]})


@dataclass(frozen=True)
class Together:
    """Groups of photographs, one after the other; iterated again and again."""

    groups: Sequence[Photographs]

    def __iter__(self) -> Iterator[Colored]:
        for group in self.groups:
            yield from group
