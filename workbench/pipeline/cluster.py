"""Dask: a local cluster, or one that is there already."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import ExitStack, contextmanager, suppress
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

from workbench.errors import InputError, WorkbenchError
from workbench.pipeline.records import library_versions

if TYPE_CHECKING:
    from workbench.pipeline.progress import Progress

_ANSWER_SECONDS = 10.0


@contextmanager
def local_cluster(workers: int, libraries: tuple[str, ...] = ()) -> Iterator[Any]:
    """A Dask client of ``workers`` processes on this machine, which end with the block.

    Of ``libraries``, each loads those that `bound_to_main_thread` tells.
    """
    import dask
    from distributed import Client, LocalCluster

    settings = {
        "distributed.worker.daemon": True,
        "distributed.admin.tick.interval": "1s",
        # An item whose worker dies is tried anew on another, three times in all.
        "distributed.scheduler.allowed-failures": 2,
    }
    with ExitStack() as started:
        started.enter_context(dask.config.set(settings))
        try:
            cluster = started.enter_context(
                LocalCluster(
                    n_workers=workers,
                    threads_per_worker=1,
                    processes=True,
                    # Room is checked before the run. Dask's own limit would halt or kill an item
                    # that takes more than its equal share while its neighbours take less.
                    memory_limit=0,
                    dashboard_address="127.0.0.1:0",
                    silence_logs=50,
                    host="127.0.0.1",
                )
            )
            client = started.enter_context(Client(cluster))
            client.run(load_in_main_thread, libraries)
        except (RuntimeError, OSError) as error:
            raise WorkbenchError(
                "The workers on this machine did not start",
                found=str(error) or type(error).__name__,
                fix="run it again; where memory is short, with fewer --workers",
            ) from error
        yield client


def bound_to_main_thread(libraries: tuple[str, ...]) -> tuple[str, ...]:
    """Those of a stage's libraries that a process must load in its main thread.

    PyMeshLab ends its process with a corrupted heap where another thread loaded it. While it
    works it also moves the whole process into a temporary folder, where none should start.
    """
    return tuple(name for name in libraries if name == "pymeshlab")


def load_in_main_thread(libraries: tuple[str, ...]) -> None:
    """Load what must not be loaded by the threads that items run in.

    Who lacks a library says so when it needs it.
    """
    for name in bound_to_main_thread(libraries):
        with suppress(ImportError):
            import_module(name)


async def _answer(address: str) -> None:
    """Raise OSError or ValueError where no scheduler answers.

    A client that could not connect is left to the garbage collector, which stops its loop, and
    waits for ever where it comes while another client holds the lock to start one.
    """
    from distributed.comm import connect
    from distributed.security import Security

    settings = Security().get_connection_args("client")
    comm = await connect(address, timeout=_ANSWER_SECONDS, **settings)
    await comm.close()


@contextmanager
def the_cluster_at(
    address: str, witness: Path, libraries: tuple[str, ...], progress: Progress
) -> Iterator[Any]:
    """A Dask client of the scheduler at ``address``.

    Parameters
    ----------
    witness : a file of the project that every worker must see.
    libraries : distributions that every worker must have in the same version.

    Raises
    ------
    InputError
        When it does not answer or has no workers, or they do not see the project folder or
        have other versions of the libraries, and so would give another result.
    """
    from distributed import Client

    try:
        with ThreadPoolExecutor(1) as apart:
            apart.submit(asyncio.run, _answer(address)).result()
        client = Client(address, timeout=_ANSWER_SECONDS)
    except (OSError, ValueError) as error:
        raise InputError(
            "The Dask scheduler does not answer",
            expected="an address like tcp://host:8786",
            found=f"{address}: {error}",
            fix="start it with `dask scheduler`, or leave --cluster out",
        ) from error
    with client:
        try:
            client.wait_for_workers(1, timeout=_ANSWER_SECONDS)
        except TimeoutError as error:
            raise InputError(
                "The Dask scheduler has no workers",
                found=address,
                fix=f"start some with `dask worker {address}`",
            ) from error
        _check_workers(client, witness, libraries)
        client.run(load_in_main_thread, libraries)
        progress.line(f"  dashboard: {client.dashboard_link}")
        yield client


def worker_facts(witness: str, libraries: tuple[str, ...]) -> dict[str, Any]:
    """What a worker sees of the project and which versions it has."""
    return {"project": Path(witness).is_file(), "has": library_versions(libraries)}


def _check_workers(client: Any, witness: Path, libraries: tuple[str, ...]) -> None:
    try:
        facts = client.run(worker_facts, str(witness), libraries)
    except ImportError as error:
        raise InputError(
            "The workers cannot run the workbench",
            found=str(error),
            fix="install this version of the workbench where the workers run",
        ) from error
    here = library_versions(libraries)
    for worker, fact in facts.items():
        if not fact["project"]:
            raise InputError(
                "A worker does not see the project folder",
                file=witness,
                found=worker,
                fix="keep the project on a disk that all workers have at the same path",
            )
        for name, version in here.items():
            if fact["has"].get(name) != version:
                raise InputError(
                    f"A worker has another version of {name} and could give another result",
                    expected=version,
                    found=f"{fact['has'].get(name)} on {worker}",
                    fix="install the same versions where the workers run",
                )


def results_of(
    client: Any, run: Callable[[str, Any], Any], items: Mapping[str, Any], memory_bytes: int = 0
) -> Iterator[tuple[str, Any]]:
    """``(name, run(name, item))`` of every item, as they come.

    Raises
    ------
    WorkbenchError
        An item whose workers died again and again; ``memory_bytes`` is what was announced that
        it takes, 0 where nothing was.
    """
    from distributed import as_completed
    from distributed.client import FutureCancelledError
    from distributed.scheduler import KilledWorker

    futures = {client.submit(run, name, item, pure=False): name for name, item in items.items()}
    for future in as_completed(futures):
        name = futures[future]
        try:
            yield name, future.result()
        except (KilledWorker, FutureCancelledError) as error:
            announced = f"about {memory_bytes / 2**30:.1f} GiB" if memory_bytes else None
            raise WorkbenchError(
                f"The workers died while at work on {name}",
                expected=announced and f"{announced} of memory for a worker, as announced",
                found=str(error),
                fix="most often memory ran out: take fewer --workers, or workers with more of it",
            ) from error


def mapper_at(
    address: str, libraries: tuple[str, ...], progress: Progress
) -> Callable[[Path, Callable[[str, Any], Any], Mapping[str, Any]], Iterator[tuple[str, Any]]]:
    """``results_of`` over the scheduler at ``address``, which is asked when it is needed.

    Returns
    -------
    A function of a file that every worker must see, of what is to be run, and of the items.
    """

    def mapped(
        witness: Path, run: Callable[[str, Any], Any], items: Mapping[str, Any]
    ) -> Iterator[tuple[str, Any]]:
        if items:
            with the_cluster_at(address, witness, libraries, progress) as client:
                yield from results_of(client, run, items)

    return mapped
