"""One LMDB file that holds the chunks of a cloud: crash-safe, memory-mapped, growing.

Values have versions. What is written between two commits goes under the next version in
small transactions, so memory stays bounded; the commit is one transaction that makes that
version the valid one. A process killed before it leaves the last commit untouched, and the
next writer sweeps what was left behind.
"""

from __future__ import annotations

import json
import os
import struct
import threading
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any, TypeVar

import lmdb
import numpy as np
from filelock import FileLock, Timeout
from numpy.typing import NDArray

from workbench.cloud.lmdb_pages import CutShortError, NoLmdbError, check_pages
from workbench.errors import InputError, ProjectLockedError, WorkbenchError

_FIRST_MAP_BYTES = 1 << 24
_KEY = struct.Struct(">cIHI")
_CHUNK, _HEADER, _TREE, _VERSIONS = b"c", b"header", b"tree", b"versions"
T = TypeVar("T")

#: (chunk, attribute number) of a value.
Key = tuple[int, int]


class ChunkStore:
    """Values by (chunk, attribute number) and two records, in one file.

    Parameters
    ----------
    path : the file; ``<path>-lock`` beside it is LMDB's table of readers.
    writable : whether to write; one writer at a time, any number of readers.
    create : make a new file, written by its maker alone; nothing may be under the path.

    Raises
    ------
    InputError
        where the file is missing, foreign, cut short or damaged.
    ProjectLockedError
        where another process writes it.
    """

    def __init__(self, path: Path, *, writable: bool = False, create: bool = False) -> None:
        self.path = Path(path)
        self.writable = writable or create
        self._guard = threading.RLock()
        self._writer = FileLock(f"{self.path}-writer")
        if not create:
            _check_file(self.path, writable=self.writable)
        if writable:
            try:
                self._writer.acquire(timeout=0)
            except Timeout:
                raise ProjectLockedError(
                    "another process is writing this point cloud",
                    file=self.path,
                    fix="wait for it to end, or open the cloud for reading",
                ) from None
        try:
            self._environment = lmdb.open(
                str(self.path),
                subdir=False,
                readonly=not self.writable,
                create=create,
                map_size=_FIRST_MAP_BYTES if create else 0,
                # A value is many pages in a row: without the kernel's read-ahead every page
                # would be a disk access of its own.
                readahead=True,
                meminit=True,
                sync=not create,
                # Where nobody may write, nobody can make the table of readers, nor needs it.
                lock=self.writable or os.access(self.path.parent, os.W_OK),
                max_dbs=0,
            )
        except (lmdb.Error, OSError) as error:
            self._writer.release(force=True)
            if "already open" in str(error):
                raise InputError(
                    "the point cloud is already open in this process",
                    file=self.path,
                    fix="use the one that is open, or close it first",
                ) from None
            raise self._failure("cannot be opened", error) from error
        self.generation = 0
        self._versions: dict[int, NDArray[np.uint32]] = {}
        self._pending: set[Key] = set()

    # -- records -------------------------------------------------------------------------

    def read_header(self) -> tuple[dict[str, Any], bytes]:
        """The header as plain data and the bytes of the tree; learns which values are valid."""
        records = self._read([_HEADER, _TREE, _VERSIONS])
        if any(r is None for r in records):
            raise InputError(
                "not a point cloud of the workbench",
                file=self.path,
                found="an LMDB file without the records of a cloud",
                fix="give a file made by the workbench, or build the cloud again",
            )
        head, tree, versions = (r for r in records if r is not None)
        try:
            header = json.loads(head)
            self.generation = int(header["generation"])
            table = np.frombuffer(versions, "<u4").reshape(-1, int(header["chunks"]))
        except (ValueError, KeyError, TypeError) as error:
            raise self._failure("has a damaged header", error) from error
        self._versions = {k: row.copy() for k, row in enumerate(table)}
        return header, tree

    def sweep(self) -> None:
        """Remove what a killed writer left uncommitted."""
        with self._guard, self._transaction(False) as read, read.cursor() as cursor:
            left = [
                bytes(key)
                for key in cursor.iternext(values=False)
                if key[:1] == _CHUNK and not self._is_valid(bytes(key))
            ]
        if left:
            self._write(lambda txn: [txn.delete(key) for key in left])

    def _is_valid(self, key: bytes) -> bool:
        _, chunk, attribute, version = _KEY.unpack(key)
        versions = self._versions.get(attribute)
        return versions is not None and chunk < len(versions) and versions[chunk] == version

    # -- values --------------------------------------------------------------------------

    def get(self, keys: Iterable[Key]) -> list[bytes | None]:
        """The values, pending ones included; None for those never written."""
        keys = list(keys)
        found = self._values(keys)
        if found is None:
            # A writer has committed since and removed what it replaced.
            self.read_header()
            found = self._values(keys)
        if found is None:
            raise InputError(
                "a point cloud is damaged",
                file=self.path,
                found="a chunk is missing",
                fix="restore the file from a copy or build it again",
            )
        return found

    def _values(self, keys: list[Key]) -> list[bytes | None] | None:
        """The values; None where one should be there and is not."""
        names = [self._name(key) for key in keys]
        read = self._read([name for name in names if name])
        if any(value is None for value in read):
            return None
        values = iter(read)
        return [next(values) if name else None for name in names]

    def _name(self, key: Key) -> bytes | None:
        chunk, attribute = key
        if key in self._pending:
            version = self.generation + 1
        else:
            versions = self._versions.get(attribute)
            version = int(versions[chunk]) if versions is not None else 0
        return _KEY.pack(_CHUNK, chunk, attribute, version) if version else None

    def check_writable(self) -> None:
        """Raise WorkbenchError where the cloud was opened for reading only."""
        if not self.writable:
            raise WorkbenchError(
                "the point cloud was opened for reading only",
                file=self.path,
                fix="open it with writable=True",
            )

    def put(self, values: Iterable[tuple[Key, bytes]]) -> None:
        """Write values of the next commit, in one transaction."""
        items = list(values)
        version = self.generation + 1

        def write(txn: lmdb.Transaction) -> None:
            for (chunk, attribute), value in items:
                txn.put(_KEY.pack(_CHUNK, chunk, attribute, version), value)

        self._write(write)
        self._pending.update(key for key, _ in items)

    def commit(self, header: dict[str, Any], tree: bytes) -> None:
        """Make all pending values valid, and the old ones of the same keys vanish, at once.

        ``header["chunks"]`` and ``header["schema"]`` give the size of the version table.
        """
        generation = self.generation + 1
        rows = len(header["schema"]) + 1
        table = np.zeros((rows, header["chunks"]), "<u4")
        for attribute, versions in self._versions.items():
            if attribute < rows:
                table[attribute, : len(versions)] = versions
        old = []
        for chunk, attribute in sorted(self._pending):
            before = int(table[attribute, chunk])
            if before:
                old.append(_KEY.pack(_CHUNK, chunk, attribute, before))
            table[attribute, chunk] = generation
        record = json.dumps({**header, "generation": generation}, sort_keys=True).encode()

        def write(txn: lmdb.Transaction) -> None:
            for name in old:
                txn.delete(name)
            txn.put(_HEADER, record)
            txn.put(_TREE, tree)
            txn.put(_VERSIONS, table.tobytes())

        self._write(write)
        self.generation = generation
        self._versions = dict(enumerate(np.ascontiguousarray(table)))
        self._pending.clear()

    def flush(self) -> None:
        """Wait until everything committed is on disk."""
        with self._guard:
            self._guarded(lambda: self._environment.sync(True))

    def close(self) -> None:
        """Release the file; uncommitted values are lost."""
        with self._guard:
            self._environment.close()
            self._writer.release(force=True)

    # -- transactions --------------------------------------------------------------------

    def _transaction(self, write: bool) -> lmdb.Transaction:
        try:
            return self._environment.begin(write=write)
        except lmdb.MapResizedError:
            # Another process grew the file.
            self._environment.set_mapsize(0)
            return self._environment.begin(write=write)

    def _read(self, names: list[bytes]) -> list[bytes | None]:
        def read() -> list[bytes | None]:
            with self._transaction(False) as txn:
                return [_plain(txn.get(name)) for name in names]

        # The map may only be resized while no transaction of the process is open.
        with self._guard:
            return self._guarded(read)

    def _write(self, change: Callable[[lmdb.Transaction], object]) -> None:
        self.check_writable()

        def attempt() -> bool:
            try:
                with self._transaction(True) as txn:
                    change(txn)
            except lmdb.MapFullError:
                self._environment.set_mapsize(2 * self._environment.info()["map_size"])
                return False
            return True

        with self._guard:
            while not self._guarded(attempt):
                pass

    def _guarded(self, action: Callable[[], T]) -> T:
        try:
            return action()
        except (lmdb.Error, OSError) as error:
            raise self._failure("cannot be read or written", error) from error

    def _failure(self, what: str, error: Exception) -> InputError:
        return InputError(
            f"the point cloud {what}",
            file=self.path,
            found=f"{type(error).__name__}: {error}",
            fix="make sure of free disk space and of the right to write there; a damaged "
            "file must be restored from a copy or built again",
        )


def _plain(value: bytes | memoryview | None) -> bytes | None:
    return None if value is None else bytes(value)


def _check_file(path: Path, *, writable: bool) -> None:
    """Raise where a file is not whole: LMDB would crash on pages that are not there."""
    if not path.is_file():
        raise InputError("there is no such point cloud", file=path, fix="build it first")
    with open(path, "rb") as file:
        try:
            check_pages(file, writable=writable)
        except NoLmdbError as error:
            raise InputError(
                "not a point cloud of the workbench",
                file=path,
                found=f"{path.stat().st_size} bytes, of which {error}",
                fix="give a file made by the workbench, or build the cloud again",
            ) from error
        except CutShortError as error:
            raise InputError(
                "a point cloud is cut short",
                file=path,
                expected=str(error),
                found=f"{path.stat().st_size} bytes",
                fix="restore the file from a copy or build it again",
            ) from error
        except ValueError as error:
            raise InputError(
                "a point cloud is damaged",
                file=path,
                where="its pages",
                found=str(error),
                fix="restore the file from a copy or build it again",
            ) from error
