"""Running the real command line on real and simulated projects."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from stages.main import PIPELINE
from workbench.cli import run_cli
from workbench.formats.surface_files import write_surface_ply

#: Far from the origin, as georeferenced models are.
PLACE = np.array([4_000_000.0, 2_500_000.0, 300.0])


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


@pytest.fixture
def cli(capsys):
    """Run a command in this process; returns the one JSON object it answers with."""

    def call(*arguments, expect: int = 0):
        code = run_cli(PIPELINE, [*map(str, arguments), "--json"])
        out, err = capsys.readouterr()
        assert code == expect, err
        return json.loads(out)

    return call


@pytest.fixture
def ball_project(cli, tmp_path, sphere) -> Path:
    """A project around a ball of radius 1 at `PLACE`, made elsewhere, blue below."""
    mesh = sphere(center=PLACE, subdivisions=4)
    low = mesh.vertices[:, 2:] < PLACE[2]
    color = np.where(low, [[20, 40, 200]], [[220, 210, 40]]).astype(np.uint8)
    write_surface_ply(tmp_path / "ball.ply", mesh.with_attributes(color=color))
    cli("new", tmp_path / "ball", "--geometry", tmp_path / "ball.ply")
    return tmp_path / "ball"
