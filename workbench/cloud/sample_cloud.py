"""Consolidated samples in a layered cloud, and out of it by region.

Positions keep every bit. Normals, radii and confidences are kept as float32: 1e-7 of a unit
vector or of a radius is far below what any scanner resolves.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.schema import POINTS, Arrays, Attribute, Schema
from workbench.errors import InputError
from workbench.geometry.regions import EVERYWHERE, Region
from workbench.geometry.samples import Samples

_ALWAYS = (
    Attribute("normals", "float32", 3),
    Attribute("radius_m", "float32"),
    Attribute("confidence", "float32"),
    Attribute("scan", "int32"),
)
_COLOR = Attribute("color", "uint8", 3)


def samples_schema(color: bool) -> Schema:
    """Attributes of a cloud of ``Samples``, with or without colour."""
    return Schema((*_ALWAYS, _COLOR) if color else _ALWAYS)


@dataclass(frozen=True)
class SampleBlocks:
    """Samples as blocks for ``build_cloud``.

    Attributes
    ----------
    parts : samples, all with colour or all without; iterated as often as the blocks are.
    """

    parts: Iterable[Samples]

    def __iter__(self) -> Iterator[Arrays]:
        for part in self.parts:
            arrays = part.arrays()
            narrow = {a.name: arrays[a.name].astype(a.dtype) for a in _ALWAYS}
            rest = {n: a for n, a in arrays.items() if n not in narrow}
            yield {POINTS: part.points, **narrow, **rest}


def samples_in(
    cloud: LayeredCloud,
    region: Region = EVERYWHERE,
    *,
    level: int | None = None,
    spacing_m: float | None = None,
) -> Samples:
    """The samples of a region, to a level or a spacing as in ``LayeredCloud.query``.

    Raises
    ------
    InputError
        where the cloud is not one of samples.
    """
    missing = [a.name for a in _ALWAYS if a.name not in cloud.schema.names]
    if missing:
        raise InputError(
            "the cloud does not hold consolidated samples",
            file=cloud.path,
            expected="the attributes " + ", ".join(a.name for a in _ALWAYS),
            found=", ".join(cloud.schema.names),
            fix="build it with samples_schema",
        )
    colored = _COLOR.name in cloud.schema.names
    names = [a.name for a in _ALWAYS] + [_COLOR.name] * colored
    found = cloud.query(region, names=names, level=level, spacing_m=spacing_m).arrays
    return Samples(
        found[POINTS],
        found["normals"].astype(np.float64),
        found["radius_m"].astype(np.float64),
        found["confidence"].astype(np.float64),
        found["scan"],
        found[_COLOR.name] if colored else None,
    )
