"""Whether the pages of an LMDB file hang together, looked at before the library sees them.

LMDB maps a file and believes it: a page number or an offset that was damaged ends the process.
Only the pages of keys are read, some thousandths of a cloud; values have their own checks.

Source: OpenLDAP, *Lightning Memory-Mapped Database*, file format version 1 (``mdb.c``).
"""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import BinaryIO

_PAGE_HEAD = 16
_PAGE, _NODE = struct.Struct("<QHHHH"), struct.Struct("<HHHH")
_META, _TREE = struct.Struct("<II Q Q 48s 48s QQ"), struct.Struct("<I HH QQQQQ")
_MAGIC, _DATA_VERSION = 0xBEEFC0DE, 1
_BRANCH, _LEAF, _KIND = 0x01, 0x02, 0x7F
_ELSEWHERE = 0x01
_FIXED_MAP = 0x01
_NOTHING = 2**64 - 1
_MOST_TRANSACTIONS = 2**62
_DEEPEST = 32
_TRIES = 5


@dataclass(frozen=True)
class _Root:
    """What a meta page says of a file."""

    page_bytes: int
    transaction: int
    last_page: int
    free: tuple[int, ...]
    main: tuple[int, ...]


class NoLmdbError(ValueError):
    """A file does not begin as one of LMDB."""


class CutShortError(ValueError):
    """A file ends before its last page; ``expected`` bytes at least."""

    def __init__(self, expected: int) -> None:
        super().__init__(f"at least {expected} bytes")
        self.expected = expected


def check_pages(file: BinaryIO, *, writable: bool) -> None:
    """Refuse a file of which LMDB would read or write what is not there.

    Parameters
    ----------
    file : open for reading.
    writable : whether pages that are free are asked for, too.

    Raises
    ------
    NoLmdbError, CutShortError, ValueError
        What is wrong with it.
    """
    for attempt in range(_TRIES):
        root = _newest(file)
        try:
            _check_tree(file, root, root.main)
            if writable:
                _check_tree(file, root, root.free)
        except ValueError:
            # Pages that another process gives a new use meanwhile are no damage.
            if attempt + 1 < _TRIES and _newest(file).transaction != root.transaction:
                continue
            raise
        return


def _newest(file: BinaryIO) -> _Root:
    first = _meta(file, 0)
    if first is None:
        raise NoLmdbError("it does not begin as a file of LMDB")
    if first.page_bytes not in (1 << k for k in range(9, 17)):
        raise NoLmdbError(f"pages of {first.page_bytes} bytes")
    second = _meta(file, first.page_bytes)
    root = second if second and second.transaction > first.transaction else first
    pages = (root.last_page + 1) * first.page_bytes
    if file.seek(0, 2) < pages:
        raise CutShortError(pages)
    if (root.free[1] | root.main[1]) & _FIXED_MAP or root.page_bytes != first.page_bytes:
        raise ValueError("flags that are never set")
    # LMDB finds the page of a transaction by its parity, and would take the other, unseen here.
    if root.transaction % 2 != (root is second) or root.transaction > _MOST_TRANSACTIONS:
        raise ValueError(f"transaction {root.transaction} where it never is")
    return root


def _meta(file: BinaryIO, start: int) -> _Root | None:
    file.seek(start)
    page = file.read(_PAGE_HEAD + _META.size)
    if len(page) < _PAGE_HEAD + _META.size:
        return None
    magic, version, _, _, free, main, last_page, transaction = _META.unpack_from(page, _PAGE_HEAD)
    if magic != _MAGIC or version != _DATA_VERSION:
        return None
    trees = _TREE.unpack(free), _TREE.unpack(main)
    return _Root(trees[0][0], transaction, last_page, *trees)


def _check_tree(file: BinaryIO, root: _Root, tree: tuple[int, ...]) -> None:
    depth, top = tree[2], tree[-1]
    if top == _NOTHING:
        return
    if not 1 <= depth <= _DEEPEST:
        raise ValueError(f"a tree of {depth} levels")
    seen: set[int] = set()
    waiting = [(top, 1)]
    while waiting:
        number, level = waiting.pop()
        if not 2 <= number <= root.last_page or number in seen:
            raise ValueError(f"page {number} is not there, or there twice")
        seen.add(number)
        file.seek(number * root.page_bytes)
        page = file.read(root.page_bytes)
        below = _checked_page(page, number, level == depth, root)
        waiting += [(child, level + 1) for child in below]


def _checked_page(page: bytes, number: int, is_leaf: bool, root: _Root) -> list[int]:
    """Pages of the level below."""
    told, _, flags, lower, upper = _PAGE.unpack_from(page)
    wanted = _LEAF if is_leaf else _BRANCH
    size = root.page_bytes
    if told != number or flags & _KIND & ~0x10 != wanted:
        raise ValueError(f"page {number} is of another kind")
    if not _PAGE_HEAD < lower <= upper <= size or lower % 2:
        raise ValueError(f"page {number} is filled to where it cannot be")
    below = []
    for at in struct.unpack_from(f"<{(lower - _PAGE_HEAD) // 2}H", page, _PAGE_HEAD):
        if at < upper or at + _NODE.size > size:
            raise ValueError(f"an entry of page {number} lies outside it")
        low, high, kind, key_bytes = _NODE.unpack_from(page, at)
        end = at + _NODE.size + key_bytes
        if not is_leaf:
            below.append(low | high << 16 | kind << 32)
        elif kind == _ELSEWHERE and end + 8 <= size:
            (first,) = struct.unpack_from("<Q", page, end)
            pages = -(-(_PAGE_HEAD + (low | high << 16)) // size)
            if first < 2 or first + pages - 1 > root.last_page:
                raise ValueError(f"a value of page {number} lies outside the file")
            end += 8
        elif kind == 0:
            end += low | high << 16
        else:
            raise ValueError(f"an entry of page {number} is of another kind")
        if end > size:
            raise ValueError(f"an entry of page {number} lies outside it")
    return below
