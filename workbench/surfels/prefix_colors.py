"""Colours of surfels as means over what they stand for, also in short prefixes."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from workbench.formats.gltf import srgb_from_linear
from workbench.geometry.neighbours import nearest
from workbench.geometry.point_set import PointSet
from workbench.kernels.srgb_bytes import LINEAR_OF_BYTE
from workbench.surfels.surfel_layout import coarse_counts


def mean_colors(
    colors: NDArray[np.uint8], owner: NDArray[np.integer], count: int
) -> tuple[NDArray[np.uint8], NDArray[np.int64]]:
    """Colours (count, 3), sRGB, of owners: means in linear light over what each owns.

    Parameters
    ----------
    colors : (n, 3) uint8 sRGB.
    owner : (n,) whose each colour is; each owner has at least one.
    count : of the owners.

    Returns
    -------
    means : (count, 3) uint8 sRGB.
    shares : (count,) how many colours each owns.
    """
    shares = np.bincount(owner, minlength=count)
    sums = np.stack(
        [np.bincount(owner, LINEAR_OF_BYTE[colors[:, k]], count) for k in range(3)], axis=1
    )
    return srgb_from_linear(sums / np.maximum(shares, 1)[:, None]), shares


def coarse_colors(
    surfels: PointSet, shares: NDArray[np.int64], reach: NDArray[np.float64]
) -> list[NDArray[np.uint8]]:
    """Colours for short prefixes, each a mean over the surfels that stand nearest to it.

    The paper names this as open (Brandt 2019, 6): early surfels would show the colour of the
    single point they lie on, however large the part of the object that they stand for.

    Parameters
    ----------
    surfels
        (k) in their order, with normals and colours.
    shares
        (k,) the weight of each colour.
    reach
        (k + 1,) of their order.

    Returns
    -------
    Lists of colours of the lengths ``coarse_counts``, or none without colours.
    """
    if surfels.color is None or surfels.normals is None:
        return []
    linear = LINEAR_OF_BYTE[surfels.color] * shares[:, None]
    middle = 0.5 * (surfels.bounds[0] + surfels.bounds[1])
    found = []
    for count in coarse_counts(len(surfels)):
        # Opposite normals are twice the spacing apart: what is behind a thin wall is not meant.
        places = np.hstack([surfels.points - middle, surfels.normals * reach[count]])
        _, owner = nearest(cKDTree(places[:count]), places)
        weight = np.bincount(owner, shares, count)
        sums = np.stack([np.bincount(owner, linear[:, k], count) for k in range(3)], axis=1)
        # A copy of a place may leave its surfel nothing.
        own = LINEAR_OF_BYTE[surfels.color[:count]]
        means = np.where(weight[:, None] > 0, sums / np.maximum(weight, 1)[:, None], own)
        found.append(srgb_from_linear(means))
    return found
