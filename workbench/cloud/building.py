"""Layered clouds from streams of samples of any number, in bounded memory.

Source: Jaspe-Villanueva 2018, section 3.3.1. One pass counts and samples, a second sends
every sample through the upper nodes of the tree into files small enough for memory; the
subtree of each file is then built, compressed and stored.
"""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

from filelock import FileLock, Timeout

from workbench.cloud.schema import Arrays, Schema
from workbench.cloud.store import ChunkStore
from workbench.cloud.tree import Tree
from workbench.cloud.tree_building import BUCKETS_IN_MEMORY, Limits, Progress, TreeBuilder
from workbench.errors import InputError, ProjectLockedError, SettingsError, WorkbenchError
from workbench.formats.atomic import remove_unfinished, replacing

FORMAT = 1
POINTS_PER_CHUNK = 32_768
MEMORY_BYTES = 1 << 30


@dataclass(frozen=True)
class BuildReport:
    """What was built: samples, chunks, levels and the size of the file."""

    samples: int
    chunks: int
    levels: int
    file_bytes: int


def build_cloud(
    path: Path,
    blocks: Iterable[Arrays],
    schema: Schema,
    *,
    memory_bytes: int = MEMORY_BYTES,
    points_per_chunk: int = POINTS_PER_CHUNK,
    compression_level: int = 1,
    workers: int | None = None,
    progress: Progress | None = None,
) -> BuildReport:
    """Build the cloud at ``path`` from blocks of arrays.

    The file appears when it is whole; a build that is killed leaves an earlier file as it
    was. Same blocks, schema, ``memory_bytes`` and ``points_per_chunk``: same bytes, however
    the samples are cut into blocks and whatever the worker count.

    Parameters
    ----------
    path : the file to make; its folder needs room for twice the uncompressed samples. The
        empty files ``<path>-lock`` and ``<path>-writer`` beside it keep processes apart.
    blocks : ``{"points": (n, 3) float64 metres, name: array, …}`` with exactly the
        attributes of ``schema``. What can be iterated twice is read twice; an iterator is
        copied to disk first.
    memory_bytes : bound of the working memory, on top of the interpreter's own.
    points_per_chunk : most samples of a chunk.
    compression_level : of zstd, 1 to 19.
    workers : threads; by default one per processor, at most 4.
    progress : called with what is under way and the share of it that is done, 0 to 1.

    Raises
    ------
    SettingsError
        where an option is out of bounds.
    InputError
        where there are no samples, a block is wrong (it is named), or the disk is full.
    ProjectLockedError
        where another process writes the same cloud.
    """
    path = Path(path)
    least = 16 * points_per_chunk * schema.row_bytes
    if not 1 <= points_per_chunk <= 1 << 24 or not 1 <= compression_level <= 19:
        raise SettingsError(
            "a build option is out of bounds",
            expected="points_per_chunk 1 to 16777216 and compression_level 1 to 19",
            found=f"{points_per_chunk} and {compression_level}",
        )
    if memory_bytes < least:
        raise SettingsError(
            "too little memory for one chunk and its neighbours",
            expected=f"memory_bytes of at least {least}",
            found=str(memory_bytes),
            fix="allow more memory or make the chunks smaller",
        )
    threads = min(workers or _processors(), BUCKETS_IN_MEMORY)
    with _working_folder(path) as folder, replacing(path) as partial:
        lock = Path(f"{partial}-lock")
        store = ChunkStore(partial, create=True)
        try:
            limits = Limits(memory_bytes, points_per_chunk, compression_level, threads)
            with ThreadPoolExecutor(threads) as pool:
                builder = TreeBuilder(schema, store, pool, limits, progress or _silent)
                tree = builder.build(blocks, folder)
            store.commit(header_of(schema, tree, compression_level), tree.as_bytes())
            store.flush()
        finally:
            store.close()
            lock.unlink(missing_ok=True)
        # A reader of the file that is replaced keeps its own lock table, now nameless.
        Path(f"{path}-lock").unlink(missing_ok=True)
    return BuildReport(tree.total, len(tree), tree.levels, path.stat().st_size)


def header_of(schema: Schema, tree: Tree, compression_level: int) -> dict[str, object]:
    """The header record of a cloud."""
    return {
        "format": FORMAT,
        "schema": schema.as_json(),
        "chunks": len(tree),
        "samples": tree.total,
        "compression_level": compression_level,
    }


def building_folder(path: Path) -> Path:
    """Where a build keeps its files meanwhile; one that is left over was interrupted."""
    return path.with_name(f".{path.name}.building")


@contextmanager
def _working_folder(path: Path) -> Iterator[Path]:
    folder = building_folder(path)
    writer = FileLock(f"{path}-writer")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        writer.acquire(timeout=0)
        shutil.rmtree(folder, ignore_errors=True)
        remove_unfinished(path.parent, path.name)
        folder.mkdir()
    except Timeout:
        raise ProjectLockedError(
            "another process is writing this point cloud", file=path, fix="wait for it to end"
        ) from None
    except OSError as error:
        raise _disk_error(path, error) from error
    try:
        yield folder
    except OSError as error:
        raise _disk_error(path, error) from error
    finally:
        shutil.rmtree(folder, ignore_errors=True)
        writer.release()


def _disk_error(path: Path, error: OSError) -> WorkbenchError:
    return InputError(
        "the point cloud cannot be built there",
        file=path,
        found=str(error),
        fix="free disk space (twice the uncompressed samples) or choose another folder",
    )


def _silent(what: str, share: float) -> None:
    """No progress is wanted."""


def _processors() -> int:
    """Those this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
