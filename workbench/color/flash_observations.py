"""Samples of a surface as several photographs saw them, made ready to find the flash with."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from workbench.errors import InputError

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # ITU-R BT.709


@dataclass(frozen=True)
class FlashObservations:
    """What photographs show of samples of a surface.

    Attributes
    ----------
    sample : (m,) integer, which place of the surface; any numbers.
    photo : (m,) integer from 0, which photograph.
    places_in_camera : (m, 3) the place in that photograph's camera frame, x right, y down,
        z forward.
    normals_in_camera : (m, 3) its outward unit normal, best smoothed over a neighbourhood.
    values : (m, 3) linear RGB or (m,) luminance, in any unit that is the same for all.
    weights : (m,) in [0, 1], how far to trust them: `workbench.color.flash_light.value_trust`.

    Raises
    ------
    InputError : lengths differ, or a photograph's number is negative.
    """

    sample: NDArray[np.integer]
    photo: NDArray[np.integer]
    places_in_camera: NDArray[np.float64]
    normals_in_camera: NDArray[np.float64]
    values: NDArray[np.floating]
    weights: NDArray[np.float64]

    def __post_init__(self) -> None:
        count = len(self.sample)
        fits = (
            self.sample.shape == self.photo.shape == self.weights.shape == (count,)
            and self.places_in_camera.shape == self.normals_in_camera.shape == (count, 3)
            and self.values.shape in ((count,), (count, 3))
        )
        if not fits:
            raise InputError(
                "observations of a flash's light must be equally many",
                expected=f"{count} of each, places and normals of three numbers",
                found=", ".join(
                    str(getattr(self, name).shape) for name in self.__dataclass_fields__
                ),
            )
        if count and int(self.photo.min()) < 0:
            raise InputError("photographs are numbered from 0", found=str(self.photo.min()))

    @property
    def luminance(self) -> NDArray[np.float64]:
        """(m,) of the values."""
        values = np.asarray(self.values, np.float64)
        return values if values.ndim == 1 else values @ _LUMINANCE


@dataclass(frozen=True)
class LogObservations:
    """Usable observations, sorted by photograph.

    Attributes
    ----------
    sample : (m,) int64 from 0, without gaps.
    photo : (m,) int64 from 0, without gaps, rising.
    places : (m, 3) in the camera's frame, in median distances.
    normals : (m, 3) unit.
    log_values : (m,) natural logarithm of the light.
    weights : (m,) in (0, 1].
    samples, photos : how many there are.
    """

    sample: NDArray[np.int64]
    photo: NDArray[np.int64]
    places: NDArray[np.float64]
    normals: NDArray[np.float64]
    log_values: NDArray[np.float64]
    weights: NDArray[np.float64]
    samples: int
    photos: int

    @cached_property
    def first_rows(self) -> NDArray[np.int64]:
        """(photos + 1,) where each photograph's observations begin."""
        return np.searchsorted(self.photo, np.arange(self.photos + 1)).astype(np.int64)

    def of_samples(self, kept: NDArray[np.bool_]) -> LogObservations:
        """Those of some samples; the photographs keep their numbers."""
        chosen = kept[self.sample]
        return LogObservations(
            (np.cumsum(kept) - 1)[self.sample[chosen]],
            self.photo[chosen],
            self.places[chosen],
            self.normals[chosen],
            self.log_values[chosen],
            self.weights[chosen],
            int(kept.sum()),
            self.photos,
        )

    def sums(
        self, columns: NDArray[np.float64], weights: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Weighted sums (samples, k) of columns (m, k) over each sample, and of the weights."""
        parts = [np.bincount(self.sample, weights * c, self.samples) for c in columns.T]
        sums = np.stack(parts, axis=1) if parts else np.empty((self.samples, 0))
        total = np.bincount(self.sample, weights, self.samples)
        return np.asarray(sums, np.float64), np.asarray(total, np.float64)

    def about_means(
        self, values: NDArray[np.float64], weights: NDArray[np.float64]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Values (m,) less their sample's weighted mean, and the part of each that is left (m,).

        An observation makes up its share of the weights of the mean; the rest is left. Nothing
        is left of a sample without weights.
        """
        sums, total = self.sums(values[:, None], weights)
        safe = np.where(total > 0.0, total, 1.0)
        left = np.where(total > 0.0, 1.0, 0.0)[self.sample] - weights / safe[self.sample]
        return values - (sums[:, 0] / safe)[self.sample], left

    def about_medians(self, values: NDArray[np.float64]) -> NDArray[np.float64]:
        """Values (m,) less their sample's median."""
        order = np.lexsort((values, self.sample))
        first = np.searchsorted(self.sample[order], np.arange(self.samples + 1))
        last = first[1:] - 1
        low, high = order[(first[:-1] + last) // 2], order[(first[:-1] + last + 1) // 2]
        return np.asarray(values - (0.5 * (values[low] + values[high]))[self.sample])


@dataclass(frozen=True)
class NoFlashEstimate:
    """Why the photographs do not tell the flash."""

    reason: str

    def __bool__(self) -> Literal[False]:
        return False


def usable_observations(
    seen: FlashObservations,
) -> tuple[LogObservations, NDArray[np.int64], NDArray[np.int64], float] | NoFlashEstimate:
    """What of the observations can tell of the flash.

    Left out are those that are dark, not finite or without weight, samples that one photograph
    alone saw, and photographs that share no sample, directly or by way of others, with the most.

    Returns
    -------
    The observations, which of the given they are (k,), their photographs' numbers (photos,) and
    the median distance; or why there are none.
    """
    light = seen.luminance
    length = np.linalg.norm(seen.normals_in_camera, axis=1)
    with np.errstate(invalid="ignore"):
        sound = (light > 0.0) & (seen.weights > 0.0) & np.isfinite(light * seen.weights)
        sound &= np.isfinite(seen.places_in_camera).all(axis=1) & (np.abs(length - 1.0) < 0.01)
    chosen = np.flatnonzero(sound)
    if not len(chosen):
        return NoFlashEstimate("no sample has light, a place, a normal and a weight")
    chosen = chosen[_seen_again(seen.sample[chosen], seen.photo[chosen])]
    if not len(chosen):
        if len(np.unique(seen.photo[sound])) == 1:
            return NoFlashEstimate("one photograph alone does not tell the flash from the colours")
        return NoFlashEstimate("no sample of the surface is seen in two photographs")
    chosen = chosen[_joined(seen.sample[chosen], seen.photo[chosen])]
    chosen = chosen[np.argsort(seen.photo[chosen], kind="stable")]
    samples, sample = np.unique(seen.sample[chosen], return_inverse=True)
    photos, photo = np.unique(seen.photo[chosen], return_inverse=True)
    places = np.asarray(seen.places_in_camera[chosen], np.float64)
    distance = float(np.median(np.linalg.norm(places, axis=1)))
    if distance <= 0.0:
        return NoFlashEstimate("the samples lie at the camera")
    ready = LogObservations(
        sample.astype(np.int64),
        photo.astype(np.int64),
        places / distance,
        np.asarray(seen.normals_in_camera[chosen], np.float64),
        np.log(light[chosen]),
        np.minimum(seen.weights[chosen], 1.0).astype(np.float64),
        len(samples),
        len(photos),
    )
    return ready, chosen, photos.astype(np.int64), distance


def _seen_again(sample: NDArray[np.integer], photo: NDArray[np.integer]) -> NDArray[np.bool_]:
    """(m,) whether another photograph, too, saw the sample."""
    _, number = np.unique(sample, return_inverse=True)
    first = np.full(int(number.max()) + 1, np.iinfo(np.int64).max)
    last = np.full(len(first), -1)
    np.minimum.at(first, number, photo)
    np.maximum.at(last, number, photo)
    return np.asarray((first != last)[number])


def _joined(sample: NDArray[np.integer], photo: NDArray[np.integer]) -> NDArray[np.bool_]:
    """(m,) observations of the largest set of photographs that samples join."""
    _, number = np.unique(sample, return_inverse=True)
    photos, row = np.unique(photo, return_inverse=True)
    size = len(photos) + int(number.max()) + 1
    pairs = coo_array((np.ones(len(row), np.int8), (row, len(photos) + number)), (size, size))
    label = connected_components(pairs, directed=False)[1][row]
    return np.asarray(label == np.bincount(label).argmax())
