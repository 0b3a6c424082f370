"""Decoded chunks in memory: least recently used ones leave first, wanted ones come early.

Source: Jaspe-Villanueva 2018, section 3.3.1, the L2 asynchronous cache.
"""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from typing import Any

from numpy.typing import NDArray

Array = NDArray[Any]
#: (chunk, attribute name).
Key = tuple[int, str]


class ChunkCache:
    """Arrays by chunk and attribute, at most ``capacity_bytes`` of them.

    A thread of its own loads what ``want`` lists while the caller works on what it has.

    Parameters
    ----------
    load : gives the arrays of some attributes of a chunk; called by both threads.
    write_back : stores changed arrays; called by the caller's thread only.
    capacity_bytes : may be passed by one chunk.
    read_ahead : whether to start the thread.
    """

    def __init__(
        self,
        load: Callable[[int, list[str]], dict[str, Array]],
        write_back: Callable[[dict[Key, Array]], None],
        capacity_bytes: int,
        read_ahead: bool,
    ) -> None:
        self._load, self._write_back = load, write_back
        self.capacity_bytes = capacity_bytes
        self.hits = self.misses = 0
        self._entries: OrderedDict[Key, Array] = OrderedDict()
        self._dirty: set[Key] = set()
        self._bytes = 0
        self._changes = 0
        self._loading: int | None = None
        self._wanted: list[tuple[int, list[str]]] = []
        self._closed = False
        self._state = threading.Condition()
        self._thread = threading.Thread(target=self._run, name="cloud read-ahead", daemon=True)
        if read_ahead:
            self._thread.start()

    def get(self, chunk: int, names: list[str]) -> dict[str, Array]:
        """The arrays, read-only; loaded here where they are not yet in memory."""
        with self._state:
            while self._loading == chunk:
                self._state.wait()
            missing = [n for n in names if (chunk, n) not in self._entries]
            found = {n: self._entries[chunk, n] for n in names if n not in missing}
            for name in found:
                self._entries.move_to_end((chunk, name))
            self.hits += len(found)
            self.misses += len(missing)
        if missing:
            loaded = self._load(chunk, missing)
            found.update(loaded)
            self._keep(chunk, loaded)
        return found

    def put(self, chunk: int, arrays: dict[str, Array]) -> None:
        """Replace arrays; they are stored when they leave the cache or at ``write_all``."""
        with self._state:
            self._changes += 1
            for name in arrays:
                old = self._entries.pop((chunk, name), None)
                self._bytes -= old.nbytes if old is not None else 0
                self._dirty.add((chunk, name))
        self._keep(chunk, arrays)

    def write_all(self) -> None:
        """Store every changed array; they stay in memory."""
        with self._state:
            changed = {key: self._entries[key] for key in sorted(self._dirty)}
        if changed:
            self._write_back(changed)
            with self._state:
                self._dirty.clear()

    def want(self, chunks: Iterable[int], names: list[str]) -> None:
        """Load these, in this order, in place of what was wanted before."""
        with self._state:
            self._wanted = [(int(c), names) for c in reversed(list(chunks))]
            self._state.notify_all()

    def wait_idle(self) -> None:
        """Wait until all that is wanted is loaded or does not fit."""
        with self._state:
            while self._thread.is_alive() and (self._wanted or self._loading is not None):
                self._state.wait()

    def close(self) -> None:
        """Stop the thread and forget everything; changes not written are lost."""
        with self._state:
            self._closed = True
            self._state.notify_all()
        if self._thread.is_alive():
            self._thread.join()
        self._entries.clear()
        self._bytes = 0

    def _keep(self, chunk: int, arrays: dict[str, Array]) -> None:
        """Put into memory from the caller's thread; the oldest entries make room."""
        with self._state:
            for name, array in arrays.items():
                self._insert((chunk, name), array)
        while True:
            with self._state:
                oldest = next(iter(self._entries), None)
                if self._bytes <= self.capacity_bytes or len(self._entries) <= len(arrays):
                    return
                if oldest is not None and oldest not in self._dirty:
                    self._bytes -= self._entries.pop(oldest).nbytes
                    continue
            # One transaction for all that changed is cheaper than one for each.
            self.write_all()

    def _insert(self, key: Key, array: Array) -> None:
        if key not in self._entries:
            array.flags.writeable = False
            self._entries[key] = array
            self._bytes += array.nbytes

    # -- the thread ------------------------------------------------------------------------

    def _run(self) -> None:
        while True:
            with self._state:
                while not self._wanted and not self._closed:
                    self._state.wait()
                if self._closed:
                    return
                chunk, names = self._wanted.pop()
                missing = [n for n in names if (chunk, n) not in self._entries]
                if not missing:
                    self._state.notify_all()
                    continue
                self._loading = chunk
                changes = self._changes
            try:
                loaded = self._load(chunk, missing)
            except Exception:
                # Whoever asks for the chunk itself gets the error and its reason.
                loaded = {}
            with self._state:
                self._loading = None
                # What was written meanwhile is newer than what was read.
                if changes == self._changes:
                    self._accept(chunk, loaded)
                self._state.notify_all()

    def _accept(self, chunk: int, loaded: dict[str, Array]) -> None:
        """Keep what was read ahead; only clean old entries make room for it."""
        need = sum(a.nbytes for a in loaded.values())
        for key in [k for k in self._entries if k not in self._dirty]:
            if self._bytes + need <= self.capacity_bytes:
                break
            self._bytes -= self._entries.pop(key).nbytes
        if self._bytes + need <= self.capacity_bytes:
            for name, array in loaded.items():
                self._insert((chunk, name), array)
        else:
            self._wanted.clear()
