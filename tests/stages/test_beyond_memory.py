"""Samples on disk and a surface in blocks, from the command line."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

from tests.stages.conftest import metrics_of
from workbench.geometry.samples import Samples
from workbench.project.project import Project
from workbench.surface.block_plan import BlockPlan
from workbench.verification.distances import distance_to_surface

SETTINGS = ("fuse.memory_samples=6000", "infill.block_samples=6000")


def run(project: Path, workers: int, *settings: str) -> str:
    """Run a project; returns what was written to standard error."""
    changes = [word for setting in settings for word in ("--set", setting)]
    command = [sys.executable, "-m", "stages.main", "run", str(project)]
    command += ["--workers", str(workers), *changes]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    return done.stderr


@pytest.fixture(scope="module")
def project(simulated) -> Path:
    return simulated(
        *("--scene", "sphere", "--seed", "3", "--scans", "6"),
        *("--set", "scanner.rows=70", "--set", "scanner.cols=70"),
    )


@pytest.fixture(scope="module")
def in_blocks(project: Path) -> Path:
    copy = project.with_name("blocks")
    shutil.copytree(project, copy)
    told = run(copy, 2, *SETTINGS)
    # A library that ends its process badly would say so here.
    assert "malloc" not in told
    assert "Abort" not in told
    return copy


def test_what_does_not_fit_is_kept_on_disk_and_solved_in_blocks(in_blocks: Path) -> None:
    fuse, infill = metrics_of(in_blocks, "fuse"), metrics_of(in_blocks, "infill")
    assert fuse["on_disk"] == 1
    assert fuse["samples"] > 6_000
    assert infill["blocks"] >= 4
    assert infill["watertight"]
    assert metrics_of(in_blocks, "verify")["exported_watertight"]
    names = {path.name for path in (in_blocks / "work" / "fuse").iterdir() if path.is_file()}
    assert "samples.npz" not in names
    assert not list((in_blocks / "work" / "infill").glob("parts/*.npz"))


@pytest.mark.slow
def test_the_surface_is_as_good_as_in_one_piece(project: Path, in_blocks: Path) -> None:
    run(project, 1)
    assert metrics_of(project, "fuse")["on_disk"] == 0
    assert metrics_of(project, "infill")["blocks"] == 1
    one, many = metrics_of(project, "verify"), metrics_of(in_blocks, "verify")
    assert many["accuracy_measured_rms"] < 1.1 * one["accuracy_measured_rms"]
    assert many["seen_flagged_infilled"] < one["seen_flagged_infilled"] + 0.5


@pytest.mark.slow
def test_workers_change_nothing(in_blocks: Path) -> None:
    surface = in_blocks / "work" / "infill" / "surface.npz"
    with np.load(surface) as before:
        arrays = {name: before[name] for name in before.files}
    run(in_blocks, 1, *SETTINGS, "infill.refine_rounds=1")
    run(in_blocks, 1, *SETTINGS)
    with np.load(surface) as after:
        for name, values in arrays.items():
            np.testing.assert_array_equal(after[name], values)


@pytest.mark.slow
def test_a_cut_through_the_statue_shows_no_seam(simulated) -> None:
    """The samples lie no further from the surface where blocks meet than elsewhere."""
    statue = simulated("--scene", "statue", "--seed", "7", "--scans", "12")
    run(statue, 2, "infill.block_samples=140000")
    store = Project(statue).store
    plan = BlockPlan.from_dict(store.load("block_plan"))
    assert len(plan.blocks) >= 4
    samples = Samples(**store.load("samples"))
    distance = distance_to_surface(samples.points, store.load("surface")).distance_m
    edge = plan.block_bricks * plan.lattice.brick_m
    place = (samples.points - plan.lattice.low) / edge
    to_face = edge * np.abs(place - np.round(place)).min(axis=1)
    spacing = float(np.median(samples.radius_m))
    near, far = distance[to_face < spacing], distance[to_face > 6 * spacing]
    assert len(near) > 2000
    assert np.median(near) < 1.1 * np.median(far)
    assert np.sqrt(np.mean(near**2)) < 1.05 * np.sqrt(np.mean(far**2))
