"""One photograph's depth map by PatchMatch stereo, coarse to fine.

Source: Xu and Tao 2019, sections 3 and 4: red and black propagation, choice of views, coarse
depth maps as the start of finer ones, geometric consistency.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.kernels.patch_cost import WORST, Scene
from workbench.kernels.patch_match import first_costs, polished, sweep
from workbench.kernels.slanted_planes import random_planes
from workbench.stereo.views import StereoView

_SMALLEST_SIDE_PX = 120


@dataclass(frozen=True)
class MatchingSettings:
    """How depth maps are found.

    Attributes
    ----------
    levels : sizes, each twice the one before.
    first_rounds : of both colours, at the coarsest size, from planes at random.
    rounds : at every finer size.
    half_px : half width of the patches compared.
    least_variance : of grey levels in a patch; a flatter one shows nothing but noise.
    geometry_weight : of disagreement with the other views' depth maps, a pixel.
    """

    levels: int = 3
    first_rounds: int = 6
    rounds: int = 2
    half_px: int = 3
    least_variance: float = 2.0
    geometry_weight: float = 0.1


@dataclass(frozen=True)
class DepthEstimate:
    """Planes seen by the pixels of a view.

    Attributes
    ----------
    planes : (h, w, 3) float32, one over depth and its change for a pixel to the right and down.
    cost : (h, w) float32, 1 − NCC over the views that have a say; 2 where nothing was found.
    sigma : (h, w) float32, standard deviation of one over depth; infinite where unknown.
    pixel : the change of one over depth that moves a place by a pixel in the other views.
    """

    planes: NDArray[np.float32]
    cost: NDArray[np.float32]
    sigma: NDArray[np.float32]
    pixel: float

    def arrays(self, usable: NDArray[np.bool_]) -> dict[str, NDArray[Any]]:
        """As stored: of usable pixels alone, which are those that have planes."""
        return {
            "planes": self.planes[usable],
            "cost": self.cost[usable].astype(np.float16),
            "sigma": self.sigma[usable],
            "pixel": np.array(self.pixel),
        }

    @classmethod
    def from_arrays(
        cls, arrays: dict[str, NDArray[Any]], usable: NDArray[np.bool_]
    ) -> DepthEstimate:
        """The estimate that `arrays` told."""
        planes = np.zeros((*usable.shape, 3), np.float32)
        cost = np.full(usable.shape, WORST, np.float32)
        sigma = np.full(usable.shape, np.inf, np.float32)
        planes[usable], cost[usable], sigma[usable] = (
            arrays[name] for name in ("planes", "cost", "sigma")
        )
        return cls(planes, cost, sigma, float(arrays["pixel"]))

    @property
    def nearness(self) -> NDArray[np.float32]:
        """(h, w) one over depth, 0 where nothing was found."""
        return np.where(self.cost < WORST, self.planes[..., 0], np.float32(0.0))


def matched(
    view: StereoView,
    others: Sequence[StereoView],
    span: tuple[float, float],
    settings: MatchingSettings,
    seed: int,
    *,
    last: bool = True,
) -> DepthEstimate:
    """A view's depth map from what other views show.

    Parameters
    ----------
    span : least and greatest depth.
    seed : of the draws of this view.
    last : False where `agreed` comes after, which is what tells how sure depths are.
    """
    pyramid = [(view, tuple(others))]
    while len(pyramid) < settings.levels and min(pyramid[-1][0].grey.shape) > _SMALLEST_SIDE_PX:
        finer, around = pyramid[-1]
        pyramid.append((finer.halved(), tuple(other.halved() for other in around)))
    estimate = None
    for level in range(len(pyramid) - 1, -1, -1):
        one, around = pyramid[level]
        rounds = settings.first_rounds if estimate is None else settings.rounds
        search = _Search(one, around, span, settings, None, seed + level)
        if estimate is None:
            planes = np.zeros((*one.grey.shape, 3), np.float32)
            random_planes(one.usable, one.lens, search.nearness, seed, planes)
        else:
            planes = _finer(estimate.planes, one.grey.shape)
        from_nothing = estimate is None
        estimate = search.estimate(planes, rounds, from_nothing, last=last and level == 0)
    assert estimate is not None
    return estimate


def agreed(
    view: StereoView,
    others: Sequence[StereoView],
    estimate: DepthEstimate,
    nearness: Sequence[NDArray[np.float32]],
    span: tuple[float, float],
    settings: MatchingSettings,
    seed: int,
) -> DepthEstimate:
    """A depth map bettered so that those of the other views, ``nearness`` (h, w), agree with it."""
    search = _Search(view, others, span, settings, nearness, seed)
    return search.estimate(estimate.planes.copy(), 1)


def judged(
    view: StereoView,
    others: Sequence[StereoView],
    planes: NDArray[np.float32],
    span: tuple[float, float],
    settings: MatchingSettings,
) -> DepthEstimate:
    """Planes (h, w, 3) found elsewhere, 0 for none, with what they cost and how sure they are."""
    found = _Search(view, others, span, settings, None, 0).estimate(planes.copy(), 0)
    none = planes[..., 0] <= 0.0
    found.cost[none], found.sigma[none] = WORST, np.inf
    return found


class _Search:
    """The search at one size."""

    def __init__(
        self,
        view: StereoView,
        others: Sequence[StereoView],
        span: tuple[float, float],
        settings: MatchingSettings,
        nearness: Sequence[NDArray[np.float32]] | None,
        seed: int,
    ) -> None:
        self.view, self.settings, self.seed = view, settings, seed
        self.nearness = (1.0 / span[1], 1.0 / span[0])
        self._there, self._back = pair_geometry(view, others)
        pictures = stacked([other.grey for other in others])
        masks = stacked([other.usable for other in others])
        sizes = np.array([other.grey.shape[::-1] for other in others], np.int64)
        known = np.zeros((1, 1, 1), np.float32) if nearness is None else stacked(nearness)
        weight = 0.0 if nearness is None else settings.geometry_weight
        parts = (view.grey, view.usable, view.lens, (*self._there, *self._back))
        self._scene: Scene = (*parts, (pictures, masks, sizes), (known, weight))
        self._plain: Scene = (*parts, (pictures, masks, sizes), (known, 0.0))

    def estimate(
        self,
        planes: NDArray[np.float32],
        rounds: int,
        from_nothing: bool = False,
        *,
        last: bool = True,
    ) -> DepthEstimate:
        """Planes bettered in some rounds of both colours; only the last tells how sure they are."""
        settings = self.settings
        given = (settings.half_px, settings.least_variance)
        shape = self.view.grey.shape
        costs = np.full((*shape, len(self._there[0])), WORST, np.float32)
        first_costs(self._scene, given, planes, costs)
        scores = np.sort(costs, axis=2)[..., : max(1, costs.shape[2] // 2)].mean(axis=2)
        pixel = self.nearness_of_a_pixel()
        reach = self.nearness[1] - self.nearness[0]
        for turn in range(2 * rounds):
            done = (turn // 2) / max(rounds, 1)
            change = (0.25 * reach if from_nothing else 2.0 * pixel) * 0.25 ** (turn // 2)
            change = max(change, pixel)
            trial = (change, 0.5 * (1.0 - done) + 0.05, 3)
            sweep(
                self._scene, given, self.nearness, from_nothing, trial, self.seed, turn,
                planes, costs, scores,
            )  # fmt: skip
        sigma = np.full(shape, np.inf, np.float32)
        if last:
            polished(self._plain, given, 0.5 * pixel, planes, costs, scores, sigma)
        return DepthEstimate(planes, scores, sigma, pixel)

    def nearness_of_a_pixel(self) -> float:
        """The change of one over depth that moves a place by a pixel in the other views, median."""
        A, e = self._there
        w = 0.5 * sum(self.nearness)
        middle = np.append(self.view.lens[2:], 1.0)
        seen = A @ middle + w * e
        moved = (e[:, :2] - seen[:, :2] / seen[:, 2:] * e[:, 2:]) / seen[:, 2:]
        return float(1.0 / np.median(np.linalg.norm(moved, axis=1)))


def pair_geometry(
    view: StereoView, others: Sequence[StereoView]
) -> tuple[tuple[NDArray[np.float64], NDArray[np.float64]], ...]:
    """(A, e) that lead a pixel p with nearness w to A p + w e in each other view, and back."""
    there, back = [], []
    for other in others:
        between = other.camera_from_world @ np.linalg.inv(view.camera_from_world)
        turn, shift = between[:3, :3], between[:3, 3]
        there.append((other.matrix @ turn @ np.linalg.inv(view.matrix), other.matrix @ shift))
        back.append(
            (view.matrix @ turn.T @ np.linalg.inv(other.matrix), -view.matrix @ turn.T @ shift)
        )
    return tuple(
        (np.array([pair[0] for pair in pairs]), np.array([pair[1] for pair in pairs]))
        for pairs in (there, back)
    )


def _finer(planes: NDArray[np.float32], shape: tuple[int, ...]) -> NDArray[np.float32]:
    """The planes of pixels half as large."""
    rows, columns = (np.arange(side) for side in shape)
    v, u = 0.5 * rows - 0.25, 0.5 * columns - 0.25
    row = np.clip(rows // 2, 0, planes.shape[0] - 1)
    column = np.clip(columns // 2, 0, planes.shape[1] - 1)
    near = planes[row[:, None], column[None, :]]
    finer = np.empty_like(near)
    finer[..., 0] = (
        near[..., 0] + near[..., 1] * (u - column)[None, :] + near[..., 2] * (v - row)[:, None]
    )
    finer[..., 1:] = 0.5 * near[..., 1:]
    return finer


def stacked(pictures: Sequence[NDArray[np.generic]], beside: float = 0.0) -> NDArray[Any]:
    """Pictures of whatever sizes as one array, ``beside`` where a picture is smaller."""
    height = max(picture.shape[0] for picture in pictures)
    width = max(picture.shape[1] for picture in pictures)
    first = pictures[0]
    found = np.full((len(pictures), height, width, *first.shape[2:]), beside, first.dtype)
    for number, picture in enumerate(pictures):
        found[number, : picture.shape[0], : picture.shape[1]] = picture
    return found
