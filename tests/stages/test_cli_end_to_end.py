"""The installed command and the real pipeline on a small simulated scene."""

from __future__ import annotations

import json
import resource
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

# Coarse, for it is the way that is tested here and not the model.
COARSE = [
    *("--set", "infill.depth=6"),
    *("--set", "verify.samples=2000"),
    *("--set", "verify.picture_width_px=120"),
]
WORKBENCH = Path(sys.executable).with_name("workbench")

# Runs the pipeline with every stage watched: which files it opens, from Python.
WATCHED = """
import json, os, sys
from dataclasses import replace
from stages.main import PIPELINE
from workbench.cli import run_cli

log, truth, arguments = sys.argv[1], os.path.realpath(sys.argv[2]), sys.argv[3:]
current, opened = [""], set()

def hook(event, values):
    if event in ("open", "os.listdir", "os.scandir") and isinstance(values[0], (str, bytes)):
        path = os.path.realpath(os.fsdecode(values[0]))
        if path == truth or path.startswith(truth + os.sep):
            opened.add(current[0])

def watched(stage):
    def run(job):
        current[0] = stage.name
        try:
            return stage.run(job)
        finally:
            current[0] = ""
    return replace(stage, run=run)

sys.addaudithook(hook)
code = run_cli(tuple(map(watched, PIPELINE)), arguments)
with open(log, "w") as file:
    json.dump(sorted(opened), file)
sys.exit(code)
"""


def workbench(*arguments: object, expect: int = 0) -> dict:
    """Run the command; returns the one JSON object it prints."""
    done = subprocess.run(
        [str(WORKBENCH), *map(str, arguments), "--json"], capture_output=True, text=True
    )
    assert done.returncode == expect, done.stderr
    assert done.stdout.count("\n") == 1
    return json.loads(done.stdout)


def contents(project: Path, *folders: str) -> dict[str, bytes]:
    found = (path for name in folders for path in sorted((project / name).rglob("*")))
    return {
        str(path.relative_to(project)): path.read_bytes()
        for path in found
        if path.is_file() and path.name not in ("record.json", "hashes.json", ".lock")
    }


# A plane without photographs has nothing to develop, mask, orient, colour or texture with.
LEFT_OUT = {"develop", "mask", "densify", "orient", "color", "texture"}


def actions_of(answer: dict) -> set[str]:
    """What is done with the stages that this scene needs."""
    actions = {stage["name"]: stage["action"] for stage in answer["stages"]}
    assert {name for name, action in actions.items() if action == "left out"} == LEFT_OUT
    return {action for name, action in actions.items() if name not in LEFT_OUT}


@pytest.fixture(scope="module")
def simulated(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("end to end") / "plane"
    answer = workbench("simulate", folder, "--scene", "plane", "--seed", "1", "--scans", "3")
    assert Path(answer["truth"]).is_dir()
    assert answer["project"] == str(folder)
    return folder


@pytest.fixture(scope="module")
def ran(simulated, tmp_path_factory) -> tuple[Path, list[str], dict]:
    """The project after its run, the stages that opened the truth, and what the run printed."""
    log = tmp_path_factory.mktemp("log") / "opened.json"
    done = subprocess.run(
        [sys.executable, "-c", WATCHED, str(log), str(simulated / "truth"),
         "run", str(simulated), *COARSE, "--workers", "1", "--json"],
        capture_output=True, text=True,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    return simulated, json.loads(log.read_text()), json.loads(done.stdout)


def test_a_run_makes_the_model_and_says_what_it_took(ran):
    project, _, answer = ran
    assert actions_of(answer) == {"run"}
    for stage in answer["stages"]:
        if stage["name"] in LEFT_OUT:
            continue
        assert stage["seconds"] > 0
        assert stage["peak_rss_bytes"] > 50_000_000
        assert stage["metrics"]
        record = json.loads((project / "work" / stage["name"] / "record.json").read_text())
        assert {key: record[key] for key in stage} == stage
        for entry in record["inputs"] + record["outputs"]:
            assert (project / entry["path"]).stat().st_size == entry["bytes"]
    for made in ("exports/surface.ply", "report/report.html", "provenance.json"):
        assert (project / made).stat().st_size > 0


def test_no_stage_but_verify_opens_the_truth(ran):
    _, opened, _ = ran
    # The empty name is the planner, which hashes what verify will read.
    assert set(opened) == {"", "verify"}


def test_the_truth_changes_no_product(ran, tmp_path):
    """And neither does the place, the time, or a second process."""
    project, _, _ = ran
    blind = tmp_path / "blind"
    blind.mkdir()
    shutil.copy(project / "project.toml", blind)
    shutil.copytree(project / "scans", blind / "scans")
    workbench("run", blind, *COARSE, "--to", "export", "--workers", "2")
    folders = [f"work/{name}" for name in ("ingest", "register", "fuse", "infill")] + ["exports"]
    made, expected = contents(blind, *folders), contents(project, *folders)
    # Item notes hold the key of the item, and with it the path of its scan.
    made, expected = (
        {name: content for name, content in tree.items() if "/items/" not in name}
        for tree in (made, expected)
    )
    assert made.keys() == expected.keys()
    assert [name for name in made if made[name] != expected[name]] == []


def test_nothing_to_do_is_known_soon(ran):
    """In processor time beside that of the command's own start, on however slow a machine."""
    project, _, _ = ran

    def seconds(*arguments: object) -> tuple[float, str]:
        before = resource.getrusage(resource.RUSAGE_CHILDREN)
        done = subprocess.run([str(WORKBENCH), *map(str, arguments)], capture_output=True)
        after = resource.getrusage(resource.RUSAGE_CHILDREN)
        assert done.returncode == 0, done.stderr
        return after.ru_utime - before.ru_utime, done.stdout.decode()

    started = min(seconds("--help")[0] for _ in range(3))
    runs = [seconds("run", project, *COARSE, "--json") for _ in range(3)]
    assert all(actions_of(json.loads(told)) == {"fresh"} for _, told in runs)
    assert min(taken for taken, _ in runs) < 1.8 * started


def test_one_can_look_at_what_is_there(ran):
    project, _, _ = ran
    states = {stage["name"]: stage for stage in workbench("status", project)["stages"]}
    assert states["ingest"]["state"] == "fresh"
    # Made with --set, and the project file says otherwise.
    assert states["infill"]["state"] == "stale"
    assert states["infill"]["reason"].startswith("options changed: depth from 6 to auto")
    answer = workbench("verify", project, *COARSE)
    assert Path(answer["report"]).is_file()
    assert {"ingest", "register", "verify"} <= {metric["stage"] for metric in answer["metrics"]}
    for metric in answer["metrics"]:
        assert {"stage", "name", "value", "unit", "description"} <= set(metric)


def test_a_moved_project_is_still_fresh(ran, tmp_path):
    project, _, _ = ran
    moved = tmp_path / "moved to Größe"
    shutil.copytree(project, moved)
    plan = workbench("plan", moved, *COARSE)
    assert actions_of(plan) == {"fresh"}


def test_the_doctor_finds_this_machine_sound():
    answer = workbench("doctor")
    assert answer["ok"] is True
    assert {"numpy", "open3d", "distributed"} <= {part["name"] for part in answer["parts"]}


def test_the_real_options_are_listed():
    names = {option["name"] for option in workbench("options")["options"]}
    assert {"ingest.scan_unit", "infill.depth", "verify.samples"} <= names
    assert "error" in workbench("options", "nothing", expect=2)
