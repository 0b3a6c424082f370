"""Points as a stream, wherever they are: in a file, in a layered cloud or in memory."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from workbench.cloud.layered_cloud import LayeredCloud
from workbench.cloud.schema import POINTS, Arrays, Attribute, Schema
from workbench.formats.point_files import point_stream
from workbench.formats.point_stream import PointStream, slices_of, surveyed
from workbench.geometry.point_set import PointSet, joined

CLOUD_SUFFIX = ".cloud"
"""Of layered clouds; every other file is one that `read_points` knows."""

_ATTRIBUTES = {
    "normals": Attribute("normals", "float32", 3),
    "color": Attribute("color", "uint8", 3),
    "radius": Attribute("radius_m", "float32"),
}


PointSource = Path | LayeredCloud | PointSet | PointStream


@contextmanager
def open_points(source: PointSource) -> Iterator[PointStream]:
    """The points of a source, for as long as the body of the ``with`` lasts.

    Parameters
    ----------
    source
        A layered cloud, open or a file that ends in ``.cloud``; any other file of points; or
        points in memory; or a stream as it is.

    Raises
    ------
    InputError
        As `read_points` and `LayeredCloud`.
    """
    if isinstance(source, PointStream):
        yield source
    elif isinstance(source, PointSet):
        yield surveyed(slices_of(source))
    elif isinstance(source, LayeredCloud):
        yield cloud_stream(source)
    elif Path(source).suffix.lower() == CLOUD_SUFFIX:
        with LayeredCloud(Path(source)) as cloud:
            yield cloud_stream(cloud)
    else:
        yield point_stream(Path(source))


def points_of(source: Path) -> PointSet:
    """All points of any file, layered clouds included; see `open_points`."""
    with open_points(source) as stream:
        return joined([*stream.batches()])


def cloud_stream(cloud: LayeredCloud) -> PointStream:
    """The samples of a layered cloud chunk by chunk, neighbours together.

    The attributes ``normals``, ``color`` and ``radius_m`` come along where the cloud has them
    in the types of `cloud_schema`; others do not.
    """
    names = {
        name: attribute.name
        for name, attribute in _ATTRIBUTES.items()
        if attribute.name in cloud.schema.names
        and _same_kind(cloud.schema[attribute.name], attribute)
    }

    def batches() -> Iterator[PointSet]:
        for _, arrays in cloud.blocks([POINTS, *names.values()]):
            yield PointSet(
                np.asarray(arrays[POINTS]), **{name: arrays[kept] for name, kept in names.items()}
            )

    low, high = cloud.bounds
    return PointStream(batches, len(cloud), low, high, frozenset(names))


def cloud_schema(attributes: frozenset[str]) -> Schema:
    """Schema of a layered cloud of points with some of ``normals``, ``color``, ``radius``."""
    return Schema(tuple(_ATTRIBUTES[name] for name in _ATTRIBUTES if name in attributes))


class StreamBlocks:
    """A stream as blocks for ``build_cloud``, iterated as often as needed."""

    def __init__(self, stream: PointStream) -> None:
        self._stream = stream

    def __iter__(self) -> Iterator[Arrays]:
        for batch in self._stream.batches():
            arrays = batch.arrays()
            yield {POINTS: arrays[POINTS]} | {
                attribute.name: arrays[name]
                for name, attribute in _ATTRIBUTES.items()
                if name in self._stream.attributes
            }


def _same_kind(one: Attribute, other: Attribute) -> bool:
    return (one.dtype, one.components) == (other.dtype, other.components)
