"""Sweeping a simulated project, with its truth and without, beside what is finished."""

from __future__ import annotations

import hashlib
import json
import shutil
from pathlib import Path

import pytest

from tests.stages.conftest import workbench


def content(project: Path) -> dict[str, str]:
    """Hash of every file but those of sweeps and of what is remembered of hashes."""
    return {
        str(path.relative_to(project)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in sorted(project.rglob("*"))
        if path.is_file()
        and "sweep" not in path.relative_to(project).parts
        and path.name not in ("hashes.json", "lock.json")
    }


@pytest.fixture(scope="module")
def fused(simulated) -> Path:
    """A small simulation whose scans are fused."""
    project = simulated("--scene", "statue", "--scans", "4", "--seed", "3")
    workbench("run", project, "--to", "fuse")
    return project


def swept(project: Path, *more: str) -> dict:
    return workbench("sweep", project, "--knob", "fuse.thinning=0.0,4.0", "--repeats", "1", *more)


def test_settings_are_tried_beside_the_finished_project_and_never_twice(fused: Path):
    before = content(fused)
    told = swept(fused)
    points = {point["knobs"]["thinning"]: point for point in told["points"]}
    assert set(points) == {0.0, "auto", 4.0}
    assert points["auto"]["default"]
    # Half a millimetre of noise; fewer samples tell the surface less well.
    assert 1e-4 < points[0.0]["error"] < points[4.0]["error"] < 0.01
    assert all(point["wall_s"] > 0 and point["peak_rss_bytes"] > 2**26 for point in points.values())
    assert sum(point["recommended"] for point in told["points"]) == 1
    (advice,) = told["recommended"]
    assert advice["how"] == "knee"
    assert content(fused) == before
    assert not (fused / "work" / "sweep" / "scratch").exists()
    kept = {path: path.stat().st_mtime_ns for path in (fused / "work/sweep/points").iterdir()}
    # One is lost: it alone is run again.
    lost = sorted(kept)[0]
    lost.unlink()
    again = swept(fused, "--error-budget", str(points[4.0]["error"]))
    now = {path: path.stat().st_mtime_ns for path in (fused / "work/sweep/points").iterdir()}
    assert set(now) == set(kept)
    assert [path for path in kept if now[path] != kept[path]] == [lost]
    assert [p["error"] for p in again["points"]] == [p["error"] for p in told["points"]]
    assert again["recommended"][0]["how"] == "error budget"
    assert json.loads((fused / "work/sweep/sweep.json").read_text()) == again


def test_without_a_truth_a_scan_is_left_out(fused: Path, tmp_path: Path):
    project = tmp_path / "project"
    shutil.copytree(fused, project, ignore=shutil.ignore_patterns("truth", "sweep"))
    workbench("run", project, "--to", "fuse")
    before = content(project)
    told = swept(project)
    assert all("left-out scan" in point["told"] for point in told["points"])
    assert all(0 < point["error"] < 0.01 for point in told["points"])
    assert content(project) == before


def test_a_project_that_is_not_up_to_date_is_not_swept(fused: Path, cli):
    told = cli("sweep", fused, "--stage", "infill", expect=2)
    assert "workbench run" in told["error"]["fix"]
    told = cli("sweep", fused, "--error-budget", "1", expect=2)
    assert "one --stage" in told["error"]["expected"]


def test_advice_is_checked_on_other_seeds(fused: Path):
    before = content(fused)
    told = swept(fused, "--seeds", "2", "--error-budget", "0.01")
    for point in told["points"]:
        seeds = point["seeds"]
        assert seeds["count"] == 2
        assert seeds["error_std"] > 0
        # The project's own error is one of the two that the mean is of.
        other = 2 * seeds["error_mean"] - point["error"]
        assert other > 0
        assert abs(other - point["error"]) == pytest.approx(2**0.5 * seeds["error_std"])
    (advice,) = told["recommended"]
    (checked,) = advice["checked"]
    assert checked["seed"] == 4
    assert checked["holds"] is True
    other = fused / "work" / "sweep" / "seeds" / "seed-4"
    assert json.loads((other / "truth" / "simulation.json").read_text())["options"]["seed"] == 4
    assert content(fused) == before


def test_a_project_without_a_truth_has_no_other_seeds(fused: Path, tmp_path: Path, cli):
    project = tmp_path / "project"
    shutil.copytree(fused, project, ignore=shutil.ignore_patterns("truth", "sweep"))
    workbench("run", project, "--to", "fuse")
    told = cli("sweep", project, "--knob", "fuse.thinning=0.0,4.0", "--seeds", "2", expect=2)
    assert "--seeds" in told["error"]["fix"]
