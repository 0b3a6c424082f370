from __future__ import annotations

import io
import json
import os
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

# Importable by name, for the workers of a cluster import the items' functions by name.
sys.path.insert(0, str(Path(__file__).parent))

from fake_pipeline import PIPELINE, fake_project

from workbench.pipeline.planner import make_plan
from workbench.pipeline.progress import Progress
from workbench.pipeline.runner import RunRequest, run_pipeline
from workbench.project.project import Project

# As configs/cluster says it: an item whose worker dies is tried three times in all.
ALLOWED = "DASK_DISTRIBUTED__SCHEDULER__ALLOWED_FAILURES"


@pytest.fixture
def project(tmp_path: Path) -> Project:
    return fake_project(tmp_path)


@pytest.fixture
def run() -> Callable[..., dict[str, dict[str, Any]]]:
    """Run a fake project; returns stage name → outcome."""

    def run_it(project: Project, pipeline=PIPELINE, progress=None, **request):
        # Opened anew, as every command does.
        request.setdefault("workers", 1)
        outcomes = run_pipeline(
            pipeline,
            Project(project.root),
            RunRequest(**request),
            progress or Progress(io.StringIO()),
        )
        return {outcome["name"]: outcome for outcome in outcomes}

    return run_it


@pytest.fixture
def plan() -> Callable[..., dict[str, tuple[str, str]]]:
    """Stage name → (action, reason)."""

    def plan_it(project: Project, pipeline=PIPELINE, overrides=None):
        made = make_plan(pipeline, Project(project.root), overrides)
        return {planned.stage.name: (planned.action, planned.reason) for planned in made}

    return plan_it


@pytest.fixture
def done(run) -> Callable[..., list[str]]:
    """Run a fake project; returns the names of the stages that worked."""

    def names(project: Project, pipeline=PIPELINE, **request):
        outcomes = run(project, pipeline, **request)
        return [name for name, outcome in outcomes.items() if outcome["action"] == "run"]

    return names


@pytest.fixture
def scheduler(tmp_path):
    """The address of a Dask scheduler of its own, and a function that gives it a worker."""
    file = tmp_path / "scheduler.json"
    started = []

    def start(*arguments: str) -> None:
        path = os.pathsep.join([str(Path(__file__).parent), os.environ.get("PYTHONPATH", "")])
        process = subprocess.Popen(
            [sys.executable, "-m", *arguments, "--scheduler-file", str(file)],
            env=os.environ | {"PYTHONPATH": path, ALLOWED: "2"},
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
        )
        started.append(process)

    def worker() -> None:
        folder = str(tmp_path)
        # Without a nanny, which would start a worker that was killed again.
        start("distributed.cli.dask_worker", "--nthreads", "1", "--no-dashboard", "--no-nanny",
              "--local-directory", folder)  # fmt: skip

    start("distributed.cli.dask_scheduler", "--port", "0", "--host", "127.0.0.1", "--no-dashboard")
    for _ in range(1500):
        if file.exists() and file.read_text().strip().endswith("}"):
            break
        started[0].poll()
        time.sleep(0.01)
    yield json.loads(file.read_text())["address"], worker
    for process in reversed(started):
        process.kill()
    for process in started:
        process.wait(timeout=20)
