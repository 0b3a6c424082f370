"""Walking many binary decision trees for many samples."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray


@njit(cache=True, nogil=True)
def mean_leaf_values(
    samples: NDArray[np.float32],
    roots: NDArray[np.int32],
    feature: NDArray[np.int32],
    threshold: NDArray[np.float64],
    children: NDArray[np.int32],
    value: NDArray[np.float32],
) -> NDArray[np.float32]:
    """Mean over the trees of the value of the leaf that each sample (n, f) falls into, (n,).

    ``roots`` (t,) are nodes; a node with ``feature`` −1 is a leaf; of ``children`` (m, 2) the
    first is taken where the sample's feature is at most ``threshold``.
    """
    found = np.zeros(len(samples), np.float32)
    # Tree by tree, so that one tree's nodes stay in the cache for all samples.
    for root in roots:
        for n in range(len(samples)):
            node = root
            while feature[node] >= 0:
                below = samples[n, feature[node]] <= threshold[node]
                node = children[node, 0 if below else 1]
            found[n] += value[node]
    return found / np.float32(len(roots))
