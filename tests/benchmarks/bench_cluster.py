"""How photographs spread over workers of a Dask scheduler, and where more of them stop to help.

    python -m tests.benchmarks.bench_cluster OUT --photos 24

simulates photographs of a statue, develops them on a scheduler with one worker and with two, each
a process of its own, and prints the seconds, what is sent for an item and what this process
itself does for each: it hashes the products and writes a note. Workers beyond the knee, the time
of an item over that of this process, wait for it.
"""

from __future__ import annotations

import argparse
import json
import pickle
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from statistics import median
from tempfile import TemporaryDirectory
from typing import Any

import psutil

from stages.main import PIPELINE
from tests.faults.scene import make_scene
from workbench.formats.atomic import replacing
from workbench.pipeline import tasks
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.hashing import FileHashes
from workbench.project.project import Project
from workbench.project.simulated import simulate_project


@contextmanager
def running_cluster(folder: Path, workers: int) -> Iterator[str]:
    """The address of a scheduler with so many workers, each a process on a core of its own."""
    file = folder / f"scheduler-{workers}.json"
    file.unlink(missing_ok=True)
    dask = [sys.executable, "-m"]
    quiet = {"stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL}
    scheduler = [*dask, "distributed.cli.dask_scheduler", "--port", "0", "--host", "127.0.0.1"]
    worker = [*dask, "distributed.cli.dask_worker", "--nthreads", "1", "--no-nanny"]
    started = []
    for command in [scheduler, *[worker] * workers]:
        command = [*command, "--no-dashboard", "--scheduler-file", str(file)]
        started.append(subprocess.Popen(command, cwd=folder, **quiet))  # type: ignore[call-overload]
    # Libraries with threads of their own would let one worker take the cores of two.
    for core, process in enumerate(started[1:]):
        psutil.Process(process.pid).cpu_affinity([core % psutil.cpu_count()])
    try:
        from distributed import Client

        while not file.exists():
            time.sleep(0.05)
        with Client(scheduler_file=str(file)) as client:
            client.wait_for_workers(workers, timeout=120)
        yield json.loads(file.read_text("utf-8"))["address"]
    finally:
        # Asked to end at once, workers may wait for each other.
        for process in started:
            process.kill()
            process.wait()


def developed(project: Path, address: str | None) -> tuple[float, list[float]]:
    """Seconds of `develop`, done anew, and those of each photograph."""
    request = RunRequest(only="develop", force=True, workers=1, cluster=address)
    begun = time.perf_counter()
    run_pipeline(PIPELINE, Project(project), request, Progress(quiet=True))
    seconds = time.perf_counter() - begun
    notes = (project / "work/develop/items/develop_photo").glob("*.json")
    told = [json.loads(path.read_text("utf-8"))["summary"]["seconds"] for path in notes]
    return seconds, told


def own_seconds(project: Path) -> float:
    """What this process does for a photograph that a worker developed, seconds."""
    spent = []
    for path in Project(project).store.paths("developed_photos"):
        begun = time.perf_counter()
        content = FileHashes(project / "work" / "none.json", project).of_file(path)
        with replacing(project / "note.json") as temporary:
            temporary.write_text(content, encoding="utf-8")
        spent.append(time.perf_counter() - begun)
    (project / "note.json").unlink()
    return median(spent)


def bytes_sent(out: Path) -> dict[str, int]:
    """The most bytes that an item of each function would take to a worker; all per-item stages."""
    sent: dict[str, int] = {}
    run_item = tasks.run_item

    def weighed(*arguments: Any) -> Any:
        function = arguments[-3].__name__
        sent[function] = max(sent.get(function, 0), len(pickle.dumps(arguments)))
        return run_item(*arguments)

    with TemporaryDirectory(dir=out) as folder:
        project = make_scene(Path(folder))
        tasks.run_item = weighed
        try:
            request = RunRequest(last="texture", workers=1)
            run_pipeline(PIPELINE, Project(project), request, Progress(quiet=True))
        finally:
            tasks.run_item = run_item
    return sent


def main() -> None:
    """Measure, print and keep."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("out", type=Path)
    parser.add_argument("--photos", type=int, default=24)
    given = parser.parse_args()
    given.out.mkdir(parents=True, exist_ok=True)
    project = given.out / "statue"
    if not project.exists():
        simulate_project(
            project,
            given={"scene": "statue", "seed": 7, "photos": given.photos, "scans": 4},
            progress=Progress(),
        )
    sent = bytes_sent(given.out)
    measured: dict[str, Any] = {"bytes": sent}
    print(", ".join(f"{name} {size} bytes" for name, size in sent.items()), flush=True)
    for workers in (1, 2):
        with running_cluster(given.out, workers) as address:
            developed(project, address)  # libraries are loaded, kernels compiled
            seconds, items = developed(project, address)
        measured[f"seconds_{workers}"], measured["item_seconds"] = seconds, median(items)
        print(f"{workers} worker{'s' * (workers > 1)}: {seconds:.1f} s", flush=True)
    measured["own_seconds"] = own_seconds(project)
    measured["knee"] = measured["item_seconds"] / measured["own_seconds"]
    print(
        f"a photograph: {measured['item_seconds']:.2f} s in a worker, "
        f"{1000 * measured['own_seconds']:.1f} ms here; the knee is at "
        f"{measured['knee']:.0f} workers"
    )
    text = json.dumps(measured, indent=1) + "\n"
    (given.out / "cluster.json").write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
