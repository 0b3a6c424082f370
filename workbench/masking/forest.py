"""Randomised trees that tell foreground from clutter by what surrounds a pixel.

Source: Geurts, Ernst and Wehenkel 2006, "Extremely randomized trees"; scikit-learn grows them.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from itertools import product

import cv2
import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.decision_forest import mean_leaf_values
from workbench.masking.features import pixel_features
from workbench.masking.histograms import Example

# More pixels of the same few photographs teach nothing new.
_MOST_PIXELS = 100_000
_LEAST_LEAF_PIXELS = 5
_FEATURE_PART = 0.4
_SEED = 0
# A flash lights near things more than far ones, so examples are shown darker and brighter too.
_GAINS = (0.8, 1.0, 1.3)
# What stands near one camera is far from another.
_SCALES = (0.6, 1.0, 1.5)


@dataclass(frozen=True)
class Forest:
    """Trees as tables of nodes.

    Attributes
    ----------
    roots : (t,) int32 nodes.
    feature : (m,) int32, −1 for a leaf.
    threshold : (m,) float64; a sample whose feature is at most this goes to the first child.
    children : (m, 2) int32 nodes.
    value : (m,) float32 probability of foreground among the pixels that reached the node.
    """

    roots: NDArray[np.int32]
    feature: NDArray[np.int32]
    threshold: NDArray[np.float64]
    children: NDArray[np.int32]
    value: NDArray[np.float32]

    def probability(self, image: NDArray[np.uint8]) -> NDArray[np.float32]:
        """(h, w) float32 of foreground in [0, 1] of an (h, w, 3) uint8 sRGB image."""
        samples = pixel_features(image)
        flat = samples.reshape(-1, samples.shape[2])
        told = mean_leaf_values(
            flat, self.roots, self.feature, self.threshold, self.children, self.value
        )
        return np.asarray(told.reshape(image.shape[:2]), np.float32)

    def arrays(self) -> dict[str, NDArray[np.generic]]:
        """All that ``from_arrays`` needs to make the same forest."""
        return {field.name: getattr(self, field.name) for field in fields(self)}

    @classmethod
    def from_arrays(cls, arrays: Mapping[str, NDArray[np.generic]]) -> Forest:
        return cls(**{field.name: np.asarray(arrays[field.name]) for field in fields(cls)})


def grown(examples: Sequence[Example], trees: int) -> Forest:
    """A forest from photographs with masks; the same examples give the same forest.

    Parameters
    ----------
    examples : photographs at the size at which others will be looked at.
    trees : how many.

    Raises
    ------
    InputError : no examples, or one class never shown.
    """
    from sklearn.ensemble import ExtraTreesClassifier  # type: ignore[import-untyped]

    rng = np.random.default_rng(_SEED)
    samples, labels = [], []
    most = _MOST_PIXELS // max(1, len(examples) * len(_GAINS) * len(_SCALES))
    for example, gain, scale in product(examples, _GAINS, _SCALES):
        shown = _scaled(example, scale)
        foreground = shown.foreground.ravel()
        features = pixel_features(_exposed(np.asarray(shown.image, np.uint8), gain))
        picked = rng.permutation(foreground.size)[:most]
        samples.append(features.reshape(-1, features.shape[2])[picked])
        labels.append(foreground[picked])
    if not samples or len(np.unique(np.concatenate(labels))) < 2:
        raise InputError(
            "the masked photographs must show both foreground and clutter",
            fix="mask a photograph that shows both",
        )
    # One job: threads change neither the trees nor, with this little, the time.
    model = ExtraTreesClassifier(
        trees,
        min_samples_leaf=_LEAST_LEAF_PIXELS,
        max_features=_FEATURE_PART,
        random_state=_SEED,
        n_jobs=1,
    ).fit(np.vstack(samples), np.concatenate(labels))
    return _tables([tree.tree_ for tree in model.estimators_])


def _scaled(example: Example, scale: float) -> Example:
    if scale == 1.0:
        return example
    height, width = example.mask.shape
    size = (max(1, round(scale * width)), max(1, round(scale * height)))
    way = cv2.INTER_AREA if scale < 1.0 else cv2.INTER_LINEAR
    image, mask = (
        cv2.resize(np.asarray(part, np.uint8), size, interpolation=way)
        for part in (example.image, example.mask)
    )
    return Example(image, np.where(mask > 127, 255, 0).astype(np.uint8))


def _exposed(image: NDArray[np.uint8], gain: float) -> NDArray[np.uint8]:
    """The sRGB image as if the light had been ``gain`` times as strong."""
    encoded = np.arange(256) / 255.0
    linear = np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)
    brighter = np.clip(gain * linear, 0.0, 1.0)
    table = np.where(brighter <= 0.0031308, 12.92 * brighter, 1.055 * brighter ** (1 / 2.4) - 0.055)
    return np.asarray(np.rint(255.0 * table), np.uint8)[image]


def _tables(trees: Sequence[object]) -> Forest:
    roots, feature, threshold, children, value, first = [], [], [], [], [], 0
    for tree in trees:
        left, right = (np.asarray(getattr(tree, f"children_{s}")) for s in ("left", "right"))
        is_leaf = left < 0
        share = np.asarray(tree.value)[:, 0, :]  # type: ignore[attr-defined]
        roots.append(first)
        feature.append(np.where(is_leaf, -1, np.asarray(tree.feature)))  # type: ignore[attr-defined]
        threshold.append(np.asarray(tree.threshold))  # type: ignore[attr-defined]
        pair = np.column_stack([left, right])
        children.append(np.where(pair < 0, -1, pair + first))
        value.append(share[:, 1] / share.sum(axis=1))
        first += len(left)
    return Forest(
        np.array(roots, np.int32),
        np.concatenate(feature).astype(np.int32),
        np.concatenate(threshold).astype(np.float64),
        np.concatenate(children).astype(np.int32),
        np.concatenate(value).astype(np.float32),
    )
