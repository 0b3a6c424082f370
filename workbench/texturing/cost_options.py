"""What choosing a photograph costs, as set by the user and as the scene's size makes it.

Source: Arikan et al., eq. 1–4 and table 3.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from workbench.errors import InputError
from workbench.texturing.depth_map import DepthMap

# Steps in which a scene's size is told, of an octave.
_SIZES = 4

# The size of scene that λs = 0.2 is meant for: costs of seams grow with length, those of
# triangles with area, and the balance must not change with the unit or the object.
_FAR_OF_SMOOTHNESS = 10.0


@dataclass(frozen=True)
class CostOptions:
    """Weights of the energy.

    Attributes
    ----------
    far : h of eq. 3, in the world's units: photographs from further away are as bad as each other.
    smoothness : λs of eq. 1 of a scene with h = 10; it is scaled with ``far``, so that a small
        copy of a scene is labelled as the scene is.
    distance, orientation : λdist and λor of eq. 2.
    edge_samples : places along each edge at which photographs are compared.
    most_candidates : photographs of least data cost that each triangle keeps; 0 keeps all.
    least_cosine : photographs that see a triangle at a flatter angle are no candidates.

    Raises
    ------
    InputError : a number is out of its range.
    """

    far: float
    smoothness: float = 0.2
    distance: float = 1.0
    orientation: float = 2.0
    edge_samples: int = 4
    most_candidates: int = 0
    least_cosine: float = 0.1

    def __post_init__(self) -> None:
        for name, good, what in (
            ("far", np.isfinite(self.far) and self.far > 0.0, "positive"),
            ("smoothness", np.isfinite(self.smoothness) and self.smoothness >= 0.0, "0 or more"),
            ("distance", np.isfinite(self.distance) and self.distance >= 0.0, "0 or more"),
            ("orientation", np.isfinite(self.orientation) and self.orientation >= 0.0, "0 or more"),
            ("edge_samples", self.edge_samples >= 1, "1 or more"),
            ("most_candidates", self.most_candidates >= 0, "0 or more"),
            ("least_cosine", 0.0 <= self.least_cosine < 1.0, "from 0 to below 1"),
        ):
            if not good:
                raise InputError(
                    f"the option {name} of labelling is out of its range",
                    expected=what, found=str(getattr(self, name)),
                )  # fmt: skip

    @property
    def smoothness_in_world(self) -> float:
        """λs in the world's units."""
        return self.smoothness * self.far / _FAR_OF_SMOOTHNESS


def far_of_scene(depth_maps: Iterable[DepthMap], distances: float = 2.0) -> float:
    """So many times the median distance from which photographs show the scene: h of small objects.

    It is rounded to a quarter of an octave, so that a few photographs more leave it as it is.

    Raises
    ------
    InputError : no depth map shows anything.
    """
    found = [m.depth[np.isfinite(m.depth)].astype(np.float64) for m in depth_maps]
    depths = np.concatenate(found) if found else np.zeros(0)
    if not len(depths):
        raise InputError(
            "no photograph shows anything of the scene", fix="check the cameras against the surface"
        )
    octaves = np.log2(distances * np.median(depths))
    return float(2.0 ** (np.round(_SIZES * octaves) / _SIZES))
