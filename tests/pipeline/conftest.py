from __future__ import annotations

import io
import sys
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
