"""Running the real command line on real and simulated projects."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest


def workbench(*arguments: str | Path) -> dict[str, Any]:
    """Run a command with ``--json``; returns its object and fails on any error."""
    command = [sys.executable, "-m", "stages.main", *map(str, arguments), "--json"]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout)


def metrics_of(project: Path, stage: str) -> dict[str, Any]:
    """Metric name → value of one stage."""
    record = json.loads((project / "work" / stage / "record.json").read_text())
    return {metric["name"]: metric["value"] for metric in record["metrics"]}


@pytest.fixture(scope="session")
def simulated(tmp_path_factory):
    """A function from simulation options to a fresh simulated project, not yet run."""

    def make(*options: str) -> Path:
        project = tmp_path_factory.mktemp("simulated") / "project"
        workbench("simulate", project, *options)
        return project

    return make
