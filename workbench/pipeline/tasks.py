"""Independent items — a scan, a photograph, a chunk — mapped over workers.

One worker runs in this process. More run on a local Dask cluster, or on any Dask scheduler
given by address over a folder all workers see. Items are small: names, paths, indices. What
an item makes it writes into the project itself, and a small note of it (the key of all that
went in, the hashes of what came out) makes the item's work survive an interrupted run.
"""

from __future__ import annotations

import json
import os
import time
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import Future, wait
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from threading import Thread
from typing import TYPE_CHECKING, Any

from workbench.errors import InputError, WorkbenchError
from workbench.formats.atomic import replacing
from workbench.pipeline.records import still_at_work
from workbench.pipeline.threads import one_blas_thread
from workbench.project.hashing import FileHashes, hash_of_value, is_whole, sealed
from workbench.project.project import PROJECT_FILE
from workbench.project.store import ProductStore

if TYPE_CHECKING:
    from workbench.pipeline.progress import Progress

Payload = Mapping[str, Any]

# What a local cluster costs: some two seconds to start, and as much again until its workers
# have imported what this process has imported already (measured on two cores).
_CLUSTER_START_SECONDS = 4.0


class ItemProducts:
    """What an item's function reads and writes with; it remembers what was written.

    Parameters
    ----------
    store : the project's artefacts.
    reads, writes : what the stage declared; nothing else can be touched.
    wanted : raises where what is written is no longer wanted.
    """

    def __init__(
        self,
        store: ProductStore,
        reads: tuple[str, ...],
        writes: tuple[str, ...],
        wanted: Callable[[], None] = lambda: None,
    ) -> None:
        self._store = store
        self._wanted = wanted
        self._reads = frozenset(reads) | frozenset(writes)
        self._writes = frozenset(writes)
        self.written: list[Path] = []

    def load(self, name: str, item: str | None = None) -> Any:
        """The value of a declared artefact."""
        if name not in self._reads:
            raise PermissionError(f"the stage does not declare that it reads {name!r}")
        return self._store.load(name, item)

    def save(self, name: str, value: Any, item: str) -> None:
        """Store one declared product of this item whole."""
        if name not in self._writes:
            raise PermissionError(f"the stage does not declare that it writes {name!r}")
        self.written.append(self._store.save(name, value, item, self._wanted))


ItemFunction = Callable[[ItemProducts, Payload], dict[str, Any]]
ItemOutcome = tuple[dict[str, Any], list[str]]


@dataclass(frozen=True)
class Tasks:
    """Where and how the items of one stage run.

    Attributes
    ----------
    root : the project folder, as every worker sees it.
    stage, fingerprint : the stage and the hash of its version, options and libraries.
    hashes : the project's content hashes.
    progress : where to report.
    reads, writes : the artefacts the stage declared.
    libraries : distributions whose version can change the result.
    workers : how many processes on this machine.
    cluster : address of a Dask scheduler, instead of local workers.
    asked_by : the run that asks, as its note names it. Items of a run that was killed may still
        be at work elsewhere; what they make no longer takes its place.
    item_memory_bytes : what the stage announced that a worker takes, 0 where it did not.
    """

    root: Path
    stage: str
    fingerprint: str
    hashes: FileHashes
    progress: Progress
    reads: tuple[str, ...] = ()
    writes: tuple[str, ...] = ()
    libraries: tuple[str, ...] = ()
    workers: int = 1
    cluster: str | None = None
    asked_by: str | None = None
    item_memory_bytes: int = 0

    def map_items(
        self, label: str, function: ItemFunction, items: Mapping[str, Payload]
    ) -> dict[str, dict[str, Any]]:
        """Run ``function(products, payload)`` for every item that is not done yet.

        Parameters
        ----------
        label : what is being done, for people.
        function : importable by name; it writes its products and returns a small summary
            (plain data). It must depend on nothing but the payload, what the payload names
            and the stage's options.
        items : item name → payload (plain data); everything that can change the result is in
            it, content hashes of input files included.

        Returns
        -------
        item name → summary, in the order of ``items``, whatever the number of workers.
        """
        done: dict[str, dict[str, Any]] = {}
        keys = {
            name: hash_of_value([self.fingerprint, function.__qualname__, payload])
            for name, payload in items.items()
        }
        with self.progress.step(label, len(items)) as step:
            todo: dict[str, Payload] = {}
            for name, payload in items.items():
                summary = self._finished(function, name, keys[name])
                if summary is None:
                    todo[name] = payload
                else:
                    done[name] = summary
                    step.advance(reused=True)
            for name, (summary, written) in self._results(function, todo):
                note = {
                    "key": keys[name],
                    "summary": summary,
                    "written": [[path, self.hashes.of_file(self.root / path)] for path in written],
                }
                # By way of JSON, as a later run will read it: a tuple is a list either way.
                text = json.dumps(sealed(note))
                self._write_note(function, name, text)
                done[name] = json.loads(text)["summary"]
                step.advance()
        return {name: done[name] for name in items}

    def _note_path(self, function: ItemFunction, name: str) -> Path:
        return self.root / "work" / self.stage / "items" / function.__name__ / f"{name}.json"

    def _write_note(self, function: ItemFunction, name: str, text: str) -> None:
        path = self._note_path(function, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")

    def _finished(self, function: ItemFunction, name: str, key: str) -> dict[str, Any] | None:
        """The summary of an item whose note and products still hold, else None."""
        try:
            note = json.loads(self._note_path(function, name).read_text(encoding="utf-8"))
            if note["key"] != key or not is_whole(note):
                return None
            for path, content in note["written"]:
                if self.hashes.of_file(self.root / path) != content:
                    return None
            return dict(note["summary"])
        except (OSError, ValueError, RecursionError, KeyError, TypeError, InputError):
            return None

    def _results(
        self, function: ItemFunction, todo: Mapping[str, Payload]
    ) -> Iterator[tuple[str, ItemOutcome]]:
        """Results as they come; how many workers made them cannot be told from them."""
        if not todo:
            return
        from workbench.pipeline.cluster import (
            bound_to_main_thread,
            local_cluster,
            results_of,
            the_cluster_at,
        )

        asked = None if self.asked_by is None else (self.stage, self.asked_by)
        run = partial(run_item, str(self.root), self.reads, self.writes, asked, function)
        waiting = dict(todo)
        if self.cluster is not None:
            witness = self.root / PROJECT_FILE
            with the_cluster_at(self.cluster, witness, self.libraries, self.progress) as client:
                yield from results_of(client, run, waiting, self.item_memory_bytes)
            return
        if self.workers == 1:
            for name, payload in waiting.items():
                yield name, run(name, payload)
            return
        if bound_to_main_thread(self.libraries):
            with local_cluster(min(self.workers, len(waiting)), self.libraries) as client:
                yield from results_of(client, run, waiting, self.item_memory_bytes)
            return
        # Items begin here, and what is not begun after as long as a cluster takes to start
        # goes to workers. So small items never pay for a cluster, and large ones wait for
        # none: however long items take, at most that start is lost.
        began = time.monotonic()
        while waiting:
            name = next(iter(waiting))
            here = _in_a_thread(partial(run, name, waiting.pop(name)))
            left = began + _CLUSTER_START_SECONDS - time.monotonic()
            finished, _ = wait([here], timeout=max(left, 0.0) if waiting else None)
            if not finished:
                break
            yield name, here.result()
        if waiting:
            with local_cluster(min(self.workers, len(waiting))) as client:
                for outcome in results_of(client, run, waiting, self.item_memory_bytes):
                    if here.done():
                        here.result()  # an error of it is told now, not after all the others
                    yield outcome
            yield name, here.result()


def run_item(
    root: str,
    reads: tuple[str, ...],
    writes: tuple[str, ...],
    asked_by: tuple[str, str] | None,
    function: ItemFunction,
    name: str,
    payload: Payload,
) -> ItemOutcome:
    """One item, in whichever process; returns its summary and the products it wrote.

    ``asked_by`` are the stage and the run that asked, None where nobody can take over.
    """

    def wanted() -> None:
        if asked_by is not None and not still_at_work(Path(root), *asked_by):
            raise WorkbenchError(
                "The run that asked for this has ended, or another has taken over",
                file=root,
                fix="nothing needs to be done: what was made is not kept",
            )

    products = ItemProducts(ProductStore(Path(root)), reads, writes, wanted)
    try:
        with one_blas_thread():
            summary = function(products, payload)
    except Exception as error:
        error.add_note(f"while at work on {name}")
        raise
    return summary, [os.path.relpath(path, root) for path in products.written]


def _in_a_thread(work: Callable[[], ItemOutcome]) -> Future[ItemOutcome]:
    """The outcome to be of work in a thread that does not keep a stopped program alive."""
    future: Future[ItemOutcome] = Future()

    def fulfil() -> None:
        try:
            future.set_result(work())
        except BaseException as error:
            future.set_exception(error)

    Thread(target=fulfil, daemon=True).start()
    return future
