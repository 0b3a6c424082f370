"""PLY files as columns: text, little-endian and big-endian, lists of any length.

Source: G. Turk, *The PLY Polygon File Format* (Stanford, 1994).
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from workbench.errors import InputError
from workbench.formats.atomic import replacing
from workbench.formats.number_text import as_bytes_array, line_number, numbers_in_text
from workbench.formats.ply_layout import (
    SCALAR_TYPES,
    ByteOrder,
    Column,
    ElementLayout,
    ListColumn,
    PlyElement,
    PlyFile,
    PropertyLayout,
    parse_header,
)
from workbench.formats.whole_file import whole_file
from workbench.kernels import ply_lists as kernel

__all__ = ["ListColumn", "PlyElement", "PlyFile", "read_ply", "write_ply"]

_Value = TypeVar("_Value", bound=np.generic)

_TYPE_NAMES: dict[np.dtype[np.generic], str] = {
    np.dtype(code): name for name, code in reversed(SCALAR_TYPES.items())
}
_CUT_SHORT = "The file was cut short or its header is wrong: copy or export it again."


def read_ply(path: Path) -> PlyFile:
    """Read a PLY file whole.

    Columns have the declared type in the machine's byte order. Floating-point columns of
    text files are float64 whatever is declared, since the digits are there: georeferenced
    coordinates written as text and declared ``float`` keep their centimetres. Bytes after
    the last element are ignored.

    Raises
    ------
    InputError
        No PLY; unknown types; a body that is shorter than declared (element, row, byte);
        something that is not a number, or does not fit the declared type (element, row).
        Memory stays within a fixed multiple of the file's size whatever the header says.
    """
    path = Path(path)
    data = whole_file(path)
    header = parse_header(data, path)
    elements = (
        _text_elements(data, header.body_start, header.elements, path)
        if header.byte_order is None
        else _binary_elements(data, header.body_start, header.elements, header.byte_order, path)
    )
    return PlyFile(
        {element.name: element for element in elements}, header.comments, header.obj_info
    )


def _text_elements(
    data: bytes, start: int, layouts: Sequence[ElementLayout], path: Path
) -> list[PlyElement]:
    text = as_bytes_array(data)
    read = numbers_in_text(text, start, len(data))
    elements, position = [], 0
    for layout in layouts:
        if not (layout.count and layout.properties):
            elements.append(_element_without_values(layout))
            continue
        rows = layout.count
        is_list = np.array([p.count_type is not None for p in layout.properties], bool)
        width = len(is_list)
        available = (len(read.values) - position) // width
        if rows > available:
            # Every property takes at least one number, so nothing larger than the file's own
            # numbers is ever allocated for a count that cannot be true.
            status, row = kernel.TOO_SHORT, available
        elif is_list.any():
            starts, lengths = np.empty((2, rows, width), np.int64)
            status, row, _, position = kernel.walk_number_rows(
                read.values, position, is_list, starts, lengths
            )
        else:
            table = read.values[position : position + rows * width].reshape(rows, width)
            elements.append(_text_element(layout, list(table.T), None, path))
            position += rows * width
            continue
        if status == kernel.TOO_SHORT:
            raise InputError(
                f"The PLY body ends before its element '{layout.name}' does."
                if read.problem == "the text ends"
                else f"Something in the PLY body is not a number: {read.problem}.",
                file=path,
                where=f"element '{layout.name}', row {row}, line {line_number(text, read.end)}, "
                f"byte {read.end}",
                expected=f"{rows} rows",
                found=read.problem,
                fix=_CUT_SHORT,
            )
        if status == kernel.BAD_COUNT:
            raise _value_error(layout, row, "a list length", float(read.values[position]), path)
        columns = [_gathered(read.values, starts[:, k], lengths[:, k]) for k in range(width)]
        elements.append(_text_element(layout, columns, lengths, path))
    return elements


def _element_without_values(layout: ElementLayout) -> PlyElement:
    columns: dict[str, Column] = {}
    for declared in layout.properties:
        empty = np.empty(0, declared.value_type)
        columns[declared.name] = (
            empty if declared.count_type is None else ListColumn(empty, np.empty(0, np.int64))
        )
    return PlyElement(layout.name, layout.count, columns)


def _text_element(
    layout: ElementLayout,
    numbers: Sequence[NDArray[np.float64]],
    lengths: NDArray[np.int64] | None,
    path: Path,
) -> PlyElement:
    columns: dict[str, Column] = {}
    for k, declared in enumerate(layout.properties):
        if declared.count_type is None or lengths is None:
            columns[declared.name] = _as_declared(numbers[k], declared, layout, None, path)
        else:
            values = _as_declared(numbers[k], declared, layout, lengths[:, k], path)
            columns[declared.name] = ListColumn(values, lengths[:, k].copy())
    return PlyElement(layout.name, layout.count, columns)


def _as_declared(
    numbers: NDArray[np.float64],
    declared: PropertyLayout,
    layout: ElementLayout,
    lengths: NDArray[np.int64] | None,
    path: Path,
) -> NDArray[np.generic]:
    if declared.value_type.kind == "f":
        return np.ascontiguousarray(numbers)
    limits = np.iinfo(declared.value_type.str)
    # Written so that NaN fails; the float of the 64-bit maximum is one too many.
    fits = (numbers >= limits.min) & (numbers <= limits.max) & (numbers < 2.0**63)
    fits &= numbers == np.floor(numbers)
    if not fits.all():
        bad = int(np.argmin(fits))
        row = bad if lengths is None else int(np.searchsorted(np.cumsum(lengths), bad, "right"))
        kind = f"property '{declared.name}' ({declared.value_type.name})"
        raise _value_error(layout, row, kind, float(numbers[bad]), path)
    return numbers.astype(declared.value_type)


def _value_error(
    layout: ElementLayout, row: int, what: str, found: float, path: Path
) -> InputError:
    return InputError(
        "A number in the PLY file does not fit its declared type.",
        file=path,
        where=f"element '{layout.name}', row {row}",
        expected=what,
        found=repr(found),
        fix="Correct the declared type or the number, or export the file again.",
    )


def _binary_elements(
    data: bytes, position: int, layouts: Sequence[ElementLayout], order: ByteOrder, path: Path
) -> list[PlyElement]:
    elements = []
    for layout in layouts:
        if not (layout.count and layout.properties):
            elements.append(_element_without_values(layout))
            continue
        smallest = sum((p.count_type or p.value_type).itemsize for p in layout.properties)
        left = len(data) - position
        if layout.count * smallest > left:
            raise _too_short(layout, left // smallest, len(data), path)
        rows = _rows_of_one_layout(data, position, layout, order)
        if rows is not None:
            columns = {p.name: _native_column(rows, k, p) for k, p in enumerate(layout.properties)}
            position += rows.nbytes
        else:
            columns, position = _rows_of_lists(data, position, layout, order, path)
        elements.append(PlyElement(layout.name, layout.count, columns))
    return elements


def _rows_of_one_layout(
    data: bytes, position: int, layout: ElementLayout, order: ByteOrder
) -> NDArray[np.void] | None:
    """The rows as a structured array, when no list or only lists of one common length occur."""
    fields: list[tuple[str, object]] = []
    offset = position
    for k, declared in enumerate(layout.properties):
        value = declared.value_type.newbyteorder(order)
        if declared.count_type is None:
            fields.append((f"v{k}", value))
            offset += value.itemsize
            continue
        count_type = declared.count_type.newbyteorder(order)
        if offset + count_type.itemsize > len(data):
            return None
        length = int(np.frombuffer(data, count_type, 1, offset)[0])
        if not 0 <= length <= len(data):
            return None
        fields += [(f"c{k}", count_type), (f"v{k}", (value, (length,)))]
        offset += count_type.itemsize + length * value.itemsize
    if offset - position > 1 << 20 or position + layout.count * (offset - position) > len(data):
        return None
    rows = np.frombuffer(data, np.dtype(fields), layout.count, position)
    for name in rows.dtype.names or ():
        if name.startswith("c") and not (rows[name] == rows[name][:1]).all():
            return None
    return rows


def _native_column(rows: NDArray[np.void], k: int, declared: PropertyLayout) -> Column:
    values = np.array(rows[f"v{k}"], declared.value_type)
    if declared.count_type is None:
        return values
    return ListColumn(values.reshape(-1), np.full(len(rows), values.shape[1], np.int64))


def _rows_of_lists(
    data: bytes, position: int, layout: ElementLayout, order: ByteOrder, path: Path
) -> tuple[dict[str, Column], int]:
    declared = layout.properties
    starts, lengths = np.empty((2, layout.count, len(declared)), np.int64)
    status, row, k, position = kernel.walk_byte_rows(
        as_bytes_array(data),
        position,
        np.array([p.value_type.itemsize for p in declared], np.int64),
        np.array([p.count_type.itemsize if p.count_type else 0 for p in declared], np.int64),
        np.array([p.count_type is not None and p.count_type.kind == "i" for p in declared], bool),
        order == ">",
        starts,
        lengths,
    )
    if status == kernel.TOO_SHORT:
        raise _too_short(layout, row, position, path)
    if status == kernel.BAD_COUNT:
        raise InputError(
            f"A list '{declared[k].name}' has a negative length.",
            file=path,
            where=f"element '{layout.name}', row {row}, byte {position}",
            fix=_CUT_SHORT,
        )
    columns: dict[str, Column] = {}
    for k, p in enumerate(declared):
        # One view entry per byte: a value may start anywhere, rows of lists know no alignment.
        everywhere = np.ndarray(
            (len(data) - p.value_type.itemsize + 1,),
            p.value_type.newbyteorder(order),
            data,
            strides=(1,),
        )
        values = _gathered(everywhere, starts[:, k], lengths[:, k], p.value_type.itemsize)
        native = values.astype(p.value_type)
        columns[p.name] = (
            native if p.count_type is None else ListColumn(native, lengths[:, k].copy())
        )
    return columns, position


def _gathered(
    source: NDArray[_Value], starts: NDArray[np.int64], lengths: NDArray[np.int64], step: int = 1
) -> NDArray[_Value]:
    """The values of all rows one after the other: ``lengths[i]`` of them from ``starts[i]``."""
    index = starts
    if not (lengths == 1).all():
        before = np.cumsum(lengths) - lengths
        within = np.arange(int(lengths.sum()), dtype=np.int64) - np.repeat(before, lengths)
        index = np.repeat(starts, lengths) + within * step
    gathered: NDArray[_Value] = source[index]
    return gathered


def _too_short(layout: ElementLayout, row: int, position: int, path: Path) -> InputError:
    return InputError(
        f"The PLY body ends before its element '{layout.name}' does.",
        file=path,
        where=f"element '{layout.name}', row {row}, byte {position}",
        expected=f"{layout.count} rows",
        fix=_CUT_SHORT,
    )


def write_ply(
    path: Path,
    elements: Sequence[PlyElement],
    comments: Sequence[str] = (),
    obj_info: Sequence[str] = (),
) -> None:
    """Write a binary little-endian PLY file, whole or not at all; same input, same bytes.

    Parameters
    ----------
    path
        The file to write.
    elements
        in the order of the file. Column types become PLY types; lists are counted
        with ``uchar`` where no list is longer than 255, else with ``int``.
    comments, obj_info
        header lines, without the keyword.
    """
    header = ["ply", "format binary_little_endian 1.0"]
    header += [f"comment {' '.join(line.split())}" for line in comments]
    header += [f"obj_info {' '.join(line.split())}" for line in obj_info]
    for element in elements:
        header.append(f"element {element.name} {element.count}")
        for name, column in element.columns.items():
            if len(column) != element.count:
                raise ValueError(f"{element.name}.{name}: {len(column)} rows of {element.count}")
            if isinstance(column, ListColumn):
                kinds = f"list {_TYPE_NAMES[_count_type(column)]} {_type_name(column.values)}"
                header.append(f"property {kinds} {name}")
            else:
                header.append(f"property {_type_name(column)} {name}")
    header.append("end_header\n")
    with replacing(path) as partial, open(partial, "wb") as file:
        file.write("\n".join(header).encode())
        for element in elements:
            file.write(_packed(element).data)


def _type_name(values: NDArray[np.generic]) -> str:
    return _TYPE_NAMES[values.dtype.newbyteorder("=")]


def _count_type(column: ListColumn) -> np.dtype[np.generic]:
    return np.dtype("u1" if column.lengths.max(initial=0) <= 255 else "i4")


def _packed(element: PlyElement) -> NDArray[np.uint8]:
    """All rows of an element as bytes, little-endian."""
    sizes = np.zeros(element.count, np.int64)
    for column in element.columns.values():
        if isinstance(column, ListColumn):
            sizes += _count_type(column).itemsize + column.lengths * column.values.dtype.itemsize
        else:
            sizes += column.dtype.itemsize
    packed = np.empty(int(sizes.sum()), np.uint8)
    at = np.cumsum(sizes) - sizes
    for column in element.columns.values():
        if isinstance(column, ListColumn):
            _scatter(packed, at, column.lengths.astype(_count_type(column)))
            at = at + _count_type(column).itemsize
            size = column.values.dtype.itemsize
            within = np.arange(len(column.values), dtype=np.int64)
            within -= np.repeat(column.offsets[:-1], column.lengths)
            _scatter(packed, np.repeat(at, column.lengths) + within * size, column.values)
            at = at + column.lengths * size
        else:
            _scatter(packed, at, column)
            at = at + column.dtype.itemsize
    return packed


def _scatter(packed: NDArray[np.uint8], at: NDArray[np.int64], values: NDArray[np.generic]) -> None:
    if len(values):
        size = values.dtype.itemsize
        everywhere = np.ndarray(
            (len(packed) - size + 1,), values.dtype.newbyteorder("<"), packed.data, strides=(1,)
        )
        everywhere[at] = values
