"""A killed run loses at most the item under way, and workers do not change the result."""

import hashlib
import random
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

from tests.stages.conftest import workbench

# Fine enough to take its time, coarse enough for a test.
QUICK = ("--set", "infill.depth=6")


def product_hashes(project: Path) -> dict[str, str]:
    """Path → hash of every product; records and the report hold times and are left out."""
    found = {}
    for path in sorted([*project.glob("work/*/**/*"), *project.glob("exports/*")]):
        told = path.name in ("record.json", "running.json") or "items" in path.parts
        if path.is_file() and not told:
            name = str(path.relative_to(project))
            found[name] = hashlib.sha256(path.read_bytes()).hexdigest()
    return found


@pytest.fixture(scope="module")
def undisturbed(simulated):
    project = simulated("--scene", "sphere", "--seed", "9", "--scans", "4")
    fresh = project.with_name("fresh")
    shutil.copytree(project, fresh)
    started = time.monotonic()
    workbench("run", project, *QUICK, "--workers", "1")
    return product_hashes(project), fresh, time.monotonic() - started


def test_ten_kills_at_random_moments_change_nothing(undisturbed, tmp_path):
    expected, fresh, seconds = undisturbed
    project = tmp_path / "killed"
    shutil.copytree(fresh, project)
    moments = random.Random(3)
    killed = 0
    for _ in range(10):
        run = subprocess.Popen(
            [sys.executable, "-m", "stages.main", "run", str(project), *QUICK],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        time.sleep(moments.uniform(0.1, 0.7) * seconds)
        if run.poll() is None:
            run.send_signal(signal.SIGKILL)
            killed += 1
        else:
            # The machine was quicker than foretold: a run with nothing to do proves nothing.
            shutil.rmtree(project / "work")
        run.wait()
    assert killed >= 3
    after = workbench("run", project, *QUICK)
    assert {stage["action"] for stage in after["stages"]} <= {"run", "fresh", "left out"}
    assert product_hashes(project) == expected
    assert not list(project.rglob("*.partial"))


def test_two_workers_give_the_bytes_of_one(undisturbed, tmp_path):
    expected, fresh, _ = undisturbed
    project = tmp_path / "two"
    shutil.copytree(fresh, project)
    workbench("run", project, *QUICK, "--workers", "2")
    assert product_hashes(project) == expected
