"""What every sample of a cloud carries besides its position."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.kernels.packed_rows import picked_columns, put_columns

Arrays = Mapping[str, NDArray[Any]]

#: The attribute every cloud has.
POINTS = "points"
#: Squares of coordinates beyond this overflow.
LARGEST_COORDINATE = 1e150


@dataclass(frozen=True)
class Attribute:
    """One value or short vector per sample.

    Attributes
    ----------
    name : letters, digits and underscores.
    dtype : NumPy name of a number type of 1, 2, 4 or 8 bytes: ``"float32"``, ``"uint8"``, …
    components : 1 for (n,) arrays, k > 1 for (n, k).
    fill : what samples have before anything is written.
    """

    name: str
    dtype: str
    components: int = 1
    fill: float = 0

    def __post_init__(self) -> None:
        try:
            dtype = np.dtype(self.dtype)
        except TypeError:
            raise InputError(
                f"attribute {self.name!r} has an unknown type", found=self.dtype
            ) from None
        if dtype.kind not in "iuf" or dtype.itemsize > 8 or not dtype.isnative:
            raise InputError(
                f"attribute {self.name!r} cannot be stored",
                expected="a native integer or floating type of at most 8 bytes",
                found=self.dtype,
            )
        if not self.name.isidentifier() or not 1 <= self.components <= 256:
            raise InputError(
                f"attribute {self.name!r} cannot be stored",
                expected="a name of letters, digits and underscores and 1 to 256 components",
                found=f"{self.components} components",
            )
        object.__setattr__(self, "dtype", dtype.name)

    @property
    def bytes_per_sample(self) -> int:
        """Uncompressed."""
        return np.dtype(self.dtype).itemsize * self.components

    def shape(self, count: int) -> tuple[int, ...]:
        """Shape of the array of ``count`` samples."""
        return (count,) if self.components == 1 else (count, self.components)

    def filled(self, count: int) -> NDArray[Any]:
        """Array of ``count`` samples that were never written."""
        return np.full(self.shape(count), self.fill, self.dtype)

    def check(self, values: object, count: int, where: str) -> None:
        """Raise InputError where ``values`` is no array of the right type and shape."""
        if not isinstance(values, np.ndarray):
            raise InputError(f"attribute {self.name!r} is not an array", where=where)
        if values.dtype != np.dtype(self.dtype):
            raise InputError(
                f"attribute {self.name!r} has the wrong type",
                where=where,
                expected=self.dtype,
                found=str(values.dtype),
                fix=f"convert it with .astype({self.dtype!r})",
            )
        if values.shape != self.shape(count):
            raise InputError(
                f"attribute {self.name!r} has the wrong shape",
                where=where,
                expected=str(self.shape(count)),
                found=str(values.shape),
                fix="give one value per sample",
            )


_POSITION = Attribute(POINTS, "float64", 3)


@dataclass(frozen=True)
class Schema:
    """The attributes of a cloud in the order they are stored; positions come on top."""

    attributes: tuple[Attribute, ...] = ()

    def __post_init__(self) -> None:
        names = [POINTS, *(a.name for a in self.attributes)]
        twice = sorted({n for n in names if names.count(n) > 1})
        if twice:
            raise InputError("attribute named twice", found=", ".join(twice))

    @property
    def all(self) -> tuple[Attribute, ...]:
        """Positions (float64, 3 components), then the declared attributes."""
        return (_POSITION, *self.attributes)

    @property
    def names(self) -> tuple[str, ...]:
        """Names in stored order, ``"points"`` first."""
        return tuple(a.name for a in self.all)

    @property
    def bytes_per_sample(self) -> int:
        """Uncompressed, positions included."""
        return sum(a.bytes_per_sample for a in self.all)

    def __getitem__(self, name: str) -> Attribute:
        for attribute in self.all:
            if attribute.name == name:
                return attribute
        raise InputError(
            f"the cloud has no attribute {name!r}", expected="one of " + ", ".join(self.names)
        )

    def with_attribute(self, attribute: Attribute) -> Schema:
        """The same schema and one more attribute."""
        return Schema((*self.attributes, attribute))

    @property
    def row_bytes(self) -> int:
        """Size of a packed row: whole 8-byte words, positions first."""
        return -(-self.bytes_per_sample // 8) * 8

    def as_json(self) -> list[dict[str, object]]:
        """The declared attributes as plain data."""
        return [
            {"name": a.name, "dtype": a.dtype, "components": a.components, "fill": a.fill}
            for a in self.attributes
        ]

    @classmethod
    def from_json(cls, data: list[dict[str, Any]]) -> Schema:
        """Undo ``as_json``."""
        return cls(tuple(Attribute(**entry) for entry in data))

    def check(self, block: Arrays, where: str) -> int:
        """Number of samples of a block of arrays.

        Raises
        ------
        InputError
            on missing, unknown, mistyped or unequally long arrays; ``where`` names the block.
        """
        missing = [n for n in self.names if n not in block]
        unknown = [n for n in block if n not in self.names]
        if missing or unknown:
            raise InputError(
                "a block does not follow the schema",
                where=where,
                expected=", ".join(self.names),
                found=", ".join(block) or "nothing",
                fix="give exactly the attributes of the schema with every block",
            )
        shape = np.shape(block[POINTS])
        count = shape[0] if len(shape) == 2 else 0
        for a in self.all:
            a.check(block[a.name], count, where)
        return count

    def rows(self, block: Arrays, where: str) -> NDArray[np.uint64]:
        """A block of arrays as (n, words) uint64 rows; raises as ``check`` does."""
        count = self.check(block, where)
        rows = np.zeros((count, self.row_bytes // 8), np.uint64)
        for attribute, word, first in self._columns():
            values = np.ascontiguousarray(block[attribute.name]).view(word)
            put_columns(rows.view(word), first, values.reshape(count, -1))
        return rows

    def arrays(self, rows: NDArray[np.uint64], order: NDArray[np.int32]) -> dict[str, NDArray[Any]]:
        """Contiguous arrays of the rows (n, words) that ``order`` names; undoes ``rows``."""
        rows = np.ascontiguousarray(rows)
        arrays = {}
        for attribute, word, first in self._columns():
            found = picked_columns(rows.view(word), order, first, attribute.components)
            shape = attribute.shape(len(order))
            arrays[attribute.name] = found.view(attribute.dtype).reshape(shape)
        return arrays

    def _columns(self) -> list[tuple[Attribute, np.dtype[Any], int]]:
        """Attributes, unsigned words of their size and their first column in such words.

        Wide ones come first in a row, so that all are aligned.
        """
        columns, offset = [], 0
        for attribute in sorted(self.all, key=lambda a: -np.dtype(a.dtype).itemsize):
            size = np.dtype(attribute.dtype).itemsize
            columns.append((attribute, np.dtype(f"u{size}"), offset // size))
            offset += attribute.bytes_per_sample
        return columns
