"""Independent items — a scan, a photograph, a chunk — mapped over workers.

One worker runs in this process. More run on a local Dask cluster, or on any Dask scheduler
given by address over a folder all workers see. Items are small: names, paths, indices. What
an item makes it writes into the project itself, and a small note of it (the key of all that
went in, the hashes of what came out) makes the item's work survive an interrupted run.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from workbench.errors import InputError, WorkbenchError
from workbench.formats.atomic import replacing
from workbench.project.hashing import FileHashes, hash_of_value
from workbench.project.store import ProductStore

if TYPE_CHECKING:
    from workbench.pipeline.progress import Progress

Payload = Mapping[str, Any]


class ItemProducts:
    """What an item's function writes with; it remembers what was written."""

    def __init__(self, store: ProductStore) -> None:
        self._store = store
        self.written: list[Path] = []

    def load(self, name: str, item: str | None = None) -> Any:
        """The value of an artefact."""
        return self._store.load(name, item)

    def save(self, name: str, value: Any, item: str | None = None) -> None:
        """Store one product of this item whole."""
        self.written.append(self._store.save(name, value, item))


ItemFunction = Callable[[ItemProducts, Payload], dict[str, Any]]


@dataclass(frozen=True)
class Tasks:
    """Where and how the items of one stage run.

    Attributes
    ----------
    root : the project folder, as every worker sees it.
    stage, fingerprint : the stage and the hash of its version, options and libraries.
    hashes : the project's content hashes.
    progress : where to report.
    workers : how many processes on this machine.
    cluster : address of a Dask scheduler, instead of local workers.
    """

    root: Path
    stage: str
    fingerprint: str
    hashes: FileHashes
    progress: Progress
    workers: int = 1
    cluster: str | None = None

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
                self._write_note(function, name, note)
                done[name] = summary
                step.advance()
        return {name: done[name] for name in items}

    def _note_path(self, function: ItemFunction, name: str) -> Path:
        return self.root / "work" / self.stage / "items" / function.__name__ / f"{name}.json"

    def _write_note(self, function: ItemFunction, name: str, note: dict[str, Any]) -> None:
        path = self._note_path(function, name)
        path.parent.mkdir(parents=True, exist_ok=True)
        with replacing(path) as temporary:
            temporary.write_text(json.dumps(note), encoding="utf-8")

    def _finished(self, function: ItemFunction, name: str, key: str) -> dict[str, Any] | None:
        """The summary of an item whose note and products still hold, else None."""
        try:
            note = json.loads(self._note_path(function, name).read_text(encoding="utf-8"))
            if note["key"] != key:
                return None
            for path, content in note["written"]:
                if self.hashes.of_file(self.root / path) != content:
                    return None
            return dict(note["summary"])
        except (OSError, ValueError, KeyError, TypeError, InputError):
            return None

    def _results(
        self, function: ItemFunction, todo: Mapping[str, Payload]
    ) -> Iterator[tuple[str, tuple[dict[str, Any], list[str]]]]:
        """Results as they come; how many workers made them cannot be told from them."""
        local = min(self.workers, len(todo))
        if not todo:
            return
        if self.cluster is None and local <= 1:
            for name, payload in todo.items():
                yield name, run_item(str(self.root), function, payload)
            return
        from distributed import as_completed

        with _client(self.cluster, local) as client:
            if self.cluster:
                self.progress.line(f"  dashboard: {client.dashboard_link}")
            futures = {
                client.submit(run_item, str(self.root), function, payload, pure=False): name
                for name, payload in todo.items()
            }
            for future in as_completed(futures):
                yield futures[future], future.result()


def run_item(
    root: str, function: ItemFunction, payload: Payload
) -> tuple[dict[str, Any], list[str]]:
    """One item, in whichever process; returns its summary and the products it wrote."""
    products = ItemProducts(ProductStore(Path(root)))
    summary = function(products, payload)
    return summary, [os.path.relpath(path, root) for path in products.written]


@contextmanager
def _client(cluster: str | None, workers: int) -> Iterator[Any]:
    import dask
    from distributed import Client, LocalCluster

    if cluster is not None:
        try:
            client = Client(cluster, timeout="10s")
        except (OSError, ValueError) as error:
            raise WorkbenchError(
                "The Dask scheduler does not answer",
                found=f"{cluster}: {error}",
                fix="start it with `dask scheduler`, or leave --cluster out",
            ) from error
        with client:
            yield client
        return
    settings = {"distributed.worker.daemon": True, "distributed.admin.tick.interval": "1s"}
    with (
        dask.config.set(settings),
        LocalCluster(
            n_workers=workers,
            threads_per_worker=1,
            processes=True,
            dashboard_address=None,
            silence_logs=50,
            host="127.0.0.1",
        ) as local,
        Client(local) as client,
    ):
        yield client
